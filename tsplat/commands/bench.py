"""``tsplat bench``: what every shortcut costs and saves on a scene, in every backend."""

from __future__ import annotations

import argparse
import csv
import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tsplat.commands import INTERRUPTED
from tsplat.commands.common import camera_from_file, load, print_json, say
from tsplat.core.camera import Camera
from tsplat.core.errors import OutputError, PluginError, TsplatError, printable
from tsplat.core.params import CONTRACT, PRESETS, RenderParams
from tsplat.core.stages import STAGES
from tsplat.core.types import Scene
from tsplat.core.workspace import default_threads
from tsplat.io.progress import progress_bar
from tsplat.plan import why_not
from tsplat.plugins import load_backend, plugins
from tsplat.quality.measure import levels_text
from tsplat.quality.sweep import Row, Sweep, make_sweep, mark_optimal, settings
from tsplat.testing.checks import Case, check_picture
from tsplat.views import ring

if TYPE_CHECKING:
    from rich.table import Table

SIZE = 320, 180
CAMERAS = 3
RUNS = 5
VERIFIED = 160, 90
"""px: the picture that a backend must get right before it is timed."""

WIDTH = 160
"""Columns of a table that goes into a file or a pipe."""

STAGES_WIDTH = 130
"""Columns of a terminal that has room for the time of each stage."""

DRAWN = (".png", ".svg")


def run(arguments: argparse.Namespace) -> int:
    """Verifies, measures errors, times, reports; what is done is reported on Ctrl-C too."""
    _check_outputs(arguments)
    scene = load(arguments, exact=True)
    threads = arguments.threads or default_threads()
    cameras = _cameras(arguments, scene)
    names, skipped = _backends(arguments, scene)
    _verify(scene, cameras[0], names)
    wanted = settings(scene, arguments.set or ())
    if arguments.presets:
        wanted = {name: wanted[name] for name in (*PRESETS, *(arguments.set or ()))}
    sweep = make_sweep(scene, cameras, names, wanted, threads, arguments.runs)
    interrupted = _measure(sweep)
    rows = [row for row in sweep.rows if row.done]
    if not rows:
        raise KeyboardInterrupt
    mark_optimal(rows)
    title = (
        f"{printable(scene.name)}, {len(scene):,} Gaussians, {cameras[0].width}x"
        f"{cameras[0].height}, {len(cameras)} cameras, {threads} threads"
    )
    _write(arguments, rows, title)
    if arguments.json:
        facts = [_facts(row) for row in rows]
        print_json({"title": title, "interrupted": interrupted, "skipped": skipped, "rows": facts})
    else:
        _show_table(rows, title)
        for name, reason in skipped.items():
            say(f"{name} was not measured: {reason}")
    if arguments.show:
        _show_diagram(rows, title)
    return INTERRUPTED if interrupted else 0


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Finds out before anything is measured whether it can be written."""
    from tsplat.quality import diagram

    for path in filter(None, (arguments.output, arguments.csv)):
        folder = Path(path).parent
        if not folder.is_dir() or not os.access(folder, os.W_OK):
            raise OutputError(f"{printable(path)}: cannot write in {printable(folder)}")
    if arguments.output and Path(arguments.output).suffix.lower() not in DRAWN:
        raise OutputError(f"{printable(arguments.output)}: expected a name in .png or .svg")
    if (arguments.output or arguments.show) and (reason := diagram.available()):
        raise TsplatError(reason)
    if arguments.show and not (os.isatty(0) and os.isatty(1)):
        raise TsplatError("--show needs a terminal on standard input and output")


def _cameras(arguments: argparse.Namespace, scene: Scene) -> list[Camera]:
    """Those of the files named, or some on the orbit that frames the scene."""
    if arguments.camera:
        cameras = [camera_from_file(spec, arguments.size) for spec in arguments.camera]
        if len({(c.width, c.height) for c in cameras}) > 1:
            raise TsplatError("the cameras take pictures of different sizes; choose one: --size")
        return cameras
    return ring(scene, arguments.cameras, *(arguments.size or SIZE))


def _backends(arguments: argparse.Namespace, scene: Scene) -> tuple[list[str], dict[str, str]]:
    """Names of those to measure, and why others are not."""
    registry = plugins()
    if arguments.backend:
        names = arguments.backend.split(",")
        for name in names:
            if reason := why_not(registry.find("backend", name), scene, CONTRACT):
                raise PluginError(f"backend {name!r} cannot be used: {reason}")
        return names, {}
    out, skipped = [], {}
    for row in sorted(registry.backends.values(), key=lambda b: -b.rank):
        if row.name == "numpy":
            skipped[row.name] = "it is the yardstick of right, not of fast; --backend numpy,..."
        elif reason := why_not(row, scene, CONTRACT):
            skipped[row.name] = reason
        else:
            out.append(row.name)
    return out, skipped


def _verify(scene: Scene, camera: Camera, names: Sequence[str]) -> None:
    """A backend that breaks the contract is not worth timing.

    Raises:
        PluginError: one does.
    """
    case = Case(scene, camera.resized(*VERIFIED))
    with progress_bar("verifying") as progress:
        for i, name in enumerate(names):
            verdict = check_picture(load_backend(plugins().find("backend", name)), case)
            if not verdict.passed:
                raise PluginError(f"backend {name!r} is wrong: {'; '.join(verdict.faults)}")
            progress(i + 1, len(names))


def _measure(sweep: Sweep) -> bool:
    """Whether it was interrupted."""
    with progress_bar("measuring") as progress:
        try:
            for done, _ in enumerate(sweep.steps(), 1):
                progress(done, len(sweep))
        except KeyboardInterrupt:
            return True
    return False


def _facts(row: Row) -> dict[str, Any]:
    least, median = row.seconds()
    error = row.error
    return {
        "backend": row.backend,
        "setting": row.setting,
        "params": _changes(row.params),
        "seconds": least,
        "seconds_median": median,
        "stages": {stage: row.seconds(stage)[0] for stage in row.stages},
        "worst": error.worst,
        "p999": error.p999,
        "psnr": error.psnr,
        "ssim": error.ssim,
        "optimal": row.optimal,
    }


def _changes(params: RenderParams) -> dict[str, Any]:
    return {k: v for k, v in vars(params).items() if v != getattr(CONTRACT, k)}


def _write(arguments: argparse.Namespace, rows: Sequence[Row], title: str) -> None:
    from tsplat.io.images import write_bytes
    from tsplat.quality.diagram import draw

    if arguments.output:
        suffix = Path(arguments.output).suffix.lower()
        write_bytes(arguments.output, draw(rows, title, suffix))
        say(f"{printable(arguments.output)}: the diagram")
    if arguments.csv:
        text = io.StringIO()
        facts = [_facts(row) for row in rows]
        flat = [{k: v for k, v in f.items() if not isinstance(v, dict)} for f in facts]
        writer = csv.DictWriter(text, flat[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(flat)
        write_bytes(arguments.csv, text.getvalue().encode())


def _show_table(rows: Sequence[Row], title: str) -> None:
    from rich.console import Console

    console = Console()
    wide = console if console.is_terminal else Console(width=WIDTH)  # nobody cuts a file's lines
    wide.print(_table(rows, title, STAGES if wide.width >= STAGES_WIDTH else ()))


def _table(rows: Sequence[Row], title: str, stages: Sequence[str]) -> Table:
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title), title_justify="left", caption_justify="left", padding=(0, 1),
                  caption="* best: nothing is both faster and nearer the ideal picture; "
                  "errors in 8-bit levels")  # fmt: skip
    for heading in ("", "backend", "setting"):
        table.add_column(heading, no_wrap=True, min_width=len(heading))
    for heading in ("ms", "median", *stages, "speed", "99.9 %", "worst", "PSNR", "SSIM"):
        table.add_column(heading, justify="right", no_wrap=True)
    base = {row.backend: row.seconds()[0] for row in rows if row.setting == "contract"}
    before = None
    for row in sorted(rows, key=lambda r: (r.backend != rows[0].backend, r.backend, r.seconds())):
        if before not in (None, row.backend):
            table.add_section()
        before = row.backend
        least, median = row.seconds()
        error = row.error
        speed = f"{base[row.backend] / least:.2f}" if row.backend in base else ""
        table.add_row(
            "*" if row.optimal else "", row.backend, row.setting, f"{least * 1e3:.1f}",
            f"{median * 1e3:.1f}", *(_stage(row, stage) for stage in stages), speed,
            levels_text(error.p999), levels_text(error.worst),
            f"{error.psnr:.1f}", f"{error.ssim:.5f}",
            style="bold" if row.optimal else None,
        )  # fmt: skip
    return table


def _stage(row: Row, stage: str) -> str:
    """Its least time; nothing where it is part of another."""
    return f"{row.seconds(stage)[0] * 1e3:.1f}" if stage in row.stages else ""


def _show_diagram(rows: Sequence[Row], title: str) -> None:
    """The diagram in this terminal, until a key is pressed."""
    from tsplat.quality.diagram import picture
    from tsplat.terminal import Screen, choose_presenter
    from tsplat.viewer.text import status_line

    with Screen(mouse=False) as screen:
        while True:
            presenter, _ = choose_presenter(plugins().presenters, screen.terminal, "auto")
            screen.cleanup = presenter.clear(screen.terminal)
            frame = picture(rows, title, *presenter.size(screen.terminal))
            payload = presenter.encode(frame, screen.terminal, None)
            screen.draw(payload + status_line("any key leaves", screen.terminal))
            if _key_pressed(screen):
                return


def _key_pressed(screen: Any) -> bool:
    """Waits; False if the screen has changed meanwhile."""
    while True:
        for event in screen.read_events(None):
            if event.kind == "key":
                return True
            if event.kind in ("resize", "terminal"):
                return False
