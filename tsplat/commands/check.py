"""``tsplat check``: every stage of every available backend against the reference, on a scene."""

from __future__ import annotations

import argparse
import math
from typing import Any

from tsplat.commands.common import camera_from_file, load, params, print_json, say
from tsplat.core.camera import Camera
from tsplat.core.errors import ParamsError, PluginError
from tsplat.core.stages import STAGES, Backend, Stages
from tsplat.core.workspace import default_threads
from tsplat.io.progress import progress_bar
from tsplat.plan import why_not
from tsplat.plugins import load_backend, plugins
from tsplat.testing.checks import FUNCTIONS, Case, Verdict, check_stages
from tsplat.views import frame_scene

SIZE = 320, 200
SIDE_MAX = 640
"""px. Without --size a photograph's camera is brought below this: float64 takes its time."""


def run(arguments: argparse.Namespace) -> int:
    """Loads, checks, reports; 1 if the contract is broken anywhere."""
    if arguments.full or arguments.presenter is not None:
        from tsplat.commands import prove

        return prove.run(arguments)
    for option in ("examples", "expect_fail", "decode"):
        if getattr(arguments, option) is not None:
            name = option.replace("_", "-")
            raise ParamsError(f"--{name} is for drawn examples: with --full or --presenter")
    registry = plugins()
    if arguments.backend is None:
        rows = sorted(registry.backends.values(), key=lambda b: b.rank)
    else:
        rows = [registry.find("backend", arguments.backend)]
    scene = load(arguments)
    if arguments.camera is None:
        camera = frame_scene(scene, *(arguments.size or SIZE))
    else:
        camera = _handy(camera_from_file(arguments.camera, arguments.size), arguments.size)
    case = Case(scene, camera, params(arguments, scene), arguments.threads or default_threads())
    loaded: list[tuple[Backend, Stages]] = []
    skipped: dict[str, str] = {}
    for row in rows:
        reason = why_not(row, scene, case.params)
        if reason is None:
            loaded.append((row, load_backend(row)))
        elif arguments.backend is not None:
            raise PluginError(f"backend {row.name!r} cannot be used: {reason}")
        else:
            skipped[row.name] = reason
    verdicts: list[tuple[str, Verdict]] = []
    total = sum(len(row.stages) + len(FUNCTIONS) - len(STAGES) for row, _ in loaded)
    with progress_bar("checking") as progress:
        for row, stages in loaded:
            for verdict in check_stages(stages, case):
                verdicts.append((row.name, verdict))
                progress(len(verdicts), total)
    passed = all(verdict.passed for _, verdict in verdicts)
    if arguments.json:
        print_json(
            {
                "scene": scene.name,
                "gaussians": len(scene),
                "width": camera.width,
                "height": camera.height,
                "passed": passed,
                "checks": [_facts(name, verdict) for name, verdict in verdicts],
                "skipped": skipped,
            }
        )
    else:
        _show(verdicts, skipped, f"{scene.name}, {len(scene):,} Gaussians, "
              f"{camera.width}x{camera.height}")  # fmt: skip
    return 0 if passed else 1


def _handy(camera: Camera, size: tuple[int, int] | None) -> Camera:
    factor = max(camera.width, camera.height) / SIDE_MAX
    if size is not None or factor <= 1:
        return camera
    return camera.resized(max(1, int(camera.width / factor)), max(1, int(camera.height / factor)))


def _facts(name: str, verdict: Verdict) -> dict[str, Any]:
    compared = verdict.comparison
    return {
        "backend": name,
        "check": verdict.check,
        "passed": verdict.passed,
        "max_error": compared and compared.max_error,
        "psnr": compared and compared.psnr,
        "flips": compared and compared.flips,
        "faults": list(verdict.faults),
    }


def _show(verdicts: list[tuple[str, Verdict]], skipped: dict[str, str], title: str) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title), title_justify="left")
    for heading in ("backend", "check", "max error", "PSNR dB", "flips", "verdict"):
        table.add_column(heading, justify="right" if heading[0] in "mPf" else "left")
    before = None
    for name, verdict in verdicts:
        if before not in (None, name):
            table.add_section()
        before = name
        compared = verdict.comparison
        numbers = ("", "", "")
        if compared is not None:
            level = "exact" if math.isinf(compared.psnr) else f"{compared.psnr:.1f}"
            numbers = (f"{compared.max_error:.1e}", level, f"{compared.flips:,}")
        word = "[green]holds[/green]" if verdict.passed else "[red bold]BROKEN[/red bold]"
        table.add_row(name, verdict.check, *numbers, word)
    Console().print(table)
    for name, verdict in verdicts:
        for fault in verdict.faults:
            say(f"{name}, {verdict.check}: {fault}")
    for name, reason in skipped.items():
        say(f"{name} was not checked: {reason}")
