"""``tsplat cat``: a picture of each scene among the text of this terminal, or in a pipe."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

from tsplat.commands.common import calibrated, load, params, pose, say, unwinding
from tsplat.core.camera import Camera
from tsplat.core.errors import TerminalError, TsplatError, printable
from tsplat.core.types import Scene
from tsplat.core.workspace import Workspace
from tsplat.plan import make_plan
from tsplat.plugins import plugins
from tsplat.presenters.base import Presenter, Terminal, encoded, proportions, sampling
from tsplat.presenters.enlarge import averaged
from tsplat.terminal import choose_presenter, parse_answers
from tsplat.terminal.answers import wanted_samples
from tsplat.terminal.device import window_size
from tsplat.terminal.inline import (
    NEW_LINE,
    SPARE_ROWS,
    asked_here,
    open_input,
    placed,
    show,
    text_lines,
)

SPARE = SPARE_ROWS + 1
"""Rows of the screen that a picture cannot have: those below it, and one for the cursor."""


def run(arguments: argparse.Namespace) -> int:
    """One scene after the other; 1 if one of them could not be shown."""
    with unwinding(), _terminal(os.environ) as terminal:
        return _run(arguments, terminal)


def _run(arguments: argparse.Namespace, terminal: Terminal) -> int:
    wanted = arguments.presenter or os.environ.get("TSPLAT_PRESENTER") or "auto"
    if wanted == "auto" and not terminal.tty:
        wanted = "halfblock"
    presenter, _ = choose_presenter(plugins().presenters, terminal, wanted)
    scenes = arguments.scene or [None]
    failed = False
    for name in scenes:
        one = argparse.Namespace(**{**vars(arguments), "scene": name})
        try:
            data = _drawn(one, terminal, presenter, caption=len(scenes) > 1)
        except TsplatError as error:
            if len(scenes) == 1:
                raise
            say(printable(error, 1000))
            failed = True
        else:
            _write(data, terminal)
    return int(failed)


@contextmanager
def _terminal(environ: Mapping[str, str]) -> Iterator[Terminal]:
    """What pictures are drawn on. What is no terminal is not asked, and has 24-bit colours."""
    out = sys.stdout.fileno()
    if not os.isatty(out):
        columns, rows = (_number(environ.get(name)) for name in ("COLUMNS", "LINES"))
        colors = 2 if environ.get("NO_COLOR") else 1 << 24
        samples = wanted_samples(environ)
        yield Terminal(columns or 80, rows or 24, colors=colors, samples=samples, tty=False)
        return
    if environ.get("TERM", "") in ("", "dumb"):
        raise TerminalError(
            "TERM=dumb shows no picture; `tsplat render SCENE -o out.png` makes one"
        )
    source = open_input()
    if source is None:  # nowhere to read answers from
        yield parse_answers(b"", environ, window_size(out))
        return
    try:
        with asked_here(source, out, environ) as terminal:
            yield terminal
    finally:
        if source:
            os.close(source)


def _number(text: str | None) -> int:
    return int(text) if text and text.isdecimal() and len(text) < 4 else 0


def _drawn(
    arguments: argparse.Namespace, terminal: Terminal, presenter: Presenter, caption: bool
) -> bytes:
    """All that is written for one scene: the picture, the cursor below it, its name."""
    scene = load(arguments)
    area = _area(arguments, scene, terminal)
    size, pixel = presenter.size(area), presenter.pixel(area)
    samples = sampling(presenter, area)
    camera = _camera(arguments, scene, size, pixel).resized(*(n * samples for n in size))
    settings, _ = calibrated(arguments, scene, camera, params(arguments, scene))
    plan = make_plan(scene, backend=arguments.backend, threads=arguments.threads, params=settings)
    frame = plan.run(scene, camera, Workspace(plan.threads)).frame
    frame = averaged(frame.over(arguments.background or (0.0, 0.0, 0.0)), samples)
    payload = encoded(presenter, frame, area)
    end = NEW_LINE if terminal.tty else b"\n"
    lines = text_lines(payload)
    if lines is not None:
        data = b"".join(line + end for line in lines)
    else:
        rows = math.ceil(size[1] * pixel[1] / area.cell_height - 0.01)
        if terminal.tty and rows > terminal.rows - SPARE:
            raise TerminalError(
                f"{rows} rows of {presenter.name} would scroll away while they are drawn; "
                f"this terminal has room for --rows {max(terminal.rows - SPARE, 0)}, "
                "--presenter halfblock for any"
            )
        data = placed(payload, rows)
    return data + (printable(scene.name).encode() + end if caption else b"")


def _area(arguments: argparse.Namespace, scene: Scene, terminal: Terminal) -> Terminal:
    """``terminal`` cut to the picture's cells and the row that presenters leave alone.

    The picture is as large as it can be in the shape of the camera's own; --columns and --rows
    together make it just so.
    """
    columns, rows = arguments.columns, arguments.rows
    if not (columns and rows):
        seen = _pose(arguments, scene, None)
        columns = columns or terminal.columns
        rows = rows or max(1, terminal.rows - SPARE if terminal.tty else terminal.rows)
        width = columns * terminal.cell_width
        height = min(rows * terminal.cell_height, width * seen.height / seen.width)
        width = min(width, height * seen.width / seen.height)
        columns = max(1, round(width / terminal.cell_width))
        rows = max(1, round(height / terminal.cell_height))
    return replace(terminal, columns=columns, rows=rows + 1)


def _camera(
    arguments: argparse.Namespace, scene: Scene, size: tuple[int, int], pixel: tuple[float, float]
) -> Camera:
    """The camera for a picture of ``size`` px, each as wide and high on screen as ``pixel``."""
    width, height = proportions(size, pixel)
    seen = _pose(arguments, scene, None if arguments.camera else (width, height))
    return seen.reframed(width, height).resized(*size)


def _pose(arguments: argparse.Namespace, scene: Scene, size: tuple[int, int] | None) -> Camera:
    return pose(argparse.Namespace(**{**vars(arguments), "size": size}), scene)


def _write(data: bytes, terminal: Terminal) -> None:
    if terminal.tty:
        sys.stdout.flush()
        show(sys.stdout.fileno(), data, nudge=terminal.kitty)
    else:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()
