"""``tsplat render --path``: a film of the way a camera goes, and what it took."""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import time
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from tsplat._version import __version__
from tsplat.commands.common import (
    calibrated,
    load,
    pose,
    print_json,
    say,
    sized,
    unwinding,
    upwards,
)
from tsplat.commands.render import wanted
from tsplat.core.camera import Camera
from tsplat.core.errors import CameraError, ParamsError, printable
from tsplat.core.params import settings_text
from tsplat.core.types import Frame, Scene
from tsplat.core.workspace import Workspace
from tsplat.io.cameras import camera_to_json
from tsplat.io.films import Film, Glyphs, Written, check_film, is_sequence, write_film
from tsplat.io.progress import progress_bar
from tsplat.paths import TURN_SECONDS, load_path, turned
from tsplat.plan import Plan, make_plan
from tsplat.plugins import plugins
from tsplat.presenters.base import Terminal, proportions, sampling
from tsplat.presenters.enlarge import averaged

RATE = 25.0
"""Frames a second: 4 hundredths of a second each, which GIF has."""
CELLS = 80, 24

Way = Callable[[int], Camera]
"""The camera of each frame."""


def run(arguments: argparse.Namespace) -> int:
    """Loads, renders frame by frame, writes, reports."""
    output: str = arguments.output
    rate = arguments.fps or RATE
    if arguments.repeat > 1:
        raise ParamsError("--repeat times one picture: leave out --path or --repeat")
    check_film(output, rate, arguments.background)
    glyphs = _glyphs(arguments)
    begin = time.perf_counter()
    scene = load(arguments, exact=arguments.ideal or arguments.float64)
    loaded = time.perf_counter() - begin
    way, count = _way(arguments, scene, rate)
    samples = 1
    if glyphs is not None:
        way, samples = _in_cells(way, glyphs), sampling(glyphs.presenter, glyphs.terminal)
    settings, _ = calibrated(arguments, scene, way(0), wanted(arguments, scene))
    plan = make_plan(
        scene, backend=arguments.backend, threads=arguments.threads, params=settings,
        everything=arguments.everything,
    )  # fmt: skip
    size = way(0).width // samples, way(0).height // samples
    film = Film(count, rate, size, _no_shot, arguments.background)
    if is_sequence(output):
        film = replace(film, notes=_notes(arguments, scene, plan, way))
    seconds: list[float] = []
    with unwinding(), progress_bar(f"filming {output}") as progress:
        shoot = _shooting(plan, scene, way, seconds)

        def shot(index: int) -> Frame:
            progress(index, count)
            if samples == 1:
                return shoot(index)
            return averaged(shoot(index).over(arguments.background or (0.0, 0.0, 0.0)), samples)

        try:
            done = write_film(
                output, replace(film, shot=shot), force=arguments.force, glyphs=glyphs
            )
        except KeyboardInterrupt:
            if is_sequence(output):
                say(f"{printable(output)}: what is done is kept; the same command goes on")
            raise
    times = {"load": loaded, "render": sum(seconds), "total": time.perf_counter() - begin}
    if arguments.json:
        print_json(_facts(output, film, done, plan, scene, times))
    else:
        _tell(output, film, done, times)
    return 0


def _no_shot(index: int) -> Frame:
    raise AssertionError(index)


def _shooting(plan: Plan, scene: Scene, way: Way, seconds: list[float]) -> Callable[[int], Frame]:
    """Renders frames; two workspaces in turn, so that a frame outlives the making of the next."""
    workspaces = [Workspace(plan.threads), Workspace(plan.threads)]

    def shoot(index: int) -> Frame:
        workspaces.reverse()
        rendered = plan.run(scene, way(index), workspaces[0])
        seconds.append(rendered.seconds["total"])
        return rendered.frame

    return shoot


def _way(arguments: argparse.Namespace, scene: Scene, rate: float) -> tuple[Way, int]:
    """The camera of each frame, and how many there are."""
    if arguments.path == "orbit":
        return _orbit(arguments, scene, arguments.frames or max(1, round(TURN_SECONDS * rate)))
    named = [n for n in ("camera", "eye", "target", "up", "fov") if getattr(arguments, n)]
    if named:
        raise CameraError(f"--path FILE says all of that: leave out --{named[0]}")
    path = load_path(arguments.path)
    first = path.camera(0.0)
    if not arguments.output.lower().endswith(".cast"):
        first = sized(first, arguments.size)  # and a warning, once
    steps = round(path.seconds * rate)
    count: int = arguments.frames or max(1, steps if path.closed else steps + 1)
    # one that goes round does not show its first pose twice
    last = count if path.closed else max(1, count - 1)
    near, far = arguments.near, arguments.far

    def way(index: int) -> Camera:
        camera = path.camera(path.seconds * index / last).resized(first.width, first.height)
        return replace(camera, near=near or camera.near, far=far or camera.far)

    return way, count


def _orbit(arguments: argparse.Namespace, scene: Scene, count: int) -> tuple[Way, int]:
    """Once round the target or the scene's middle, from the view that ``render`` alone gives."""
    from tsplat.views import scene_extent

    options = argparse.Namespace(**vars(arguments))
    if arguments.output.lower().endswith(".cast"):
        options.size = None  # of cells
    begin = pose(options, scene)
    middle = arguments.target or scene_extent(scene).centre
    up = upwards(arguments, scene)
    return (lambda index: turned(begin, middle, up, math.tau * index / count)), count


# --- recordings


def _glyphs(arguments: argparse.Namespace) -> Glyphs | None:
    """What draws a ``.cast``; None for other films."""
    if not arguments.output.lower().endswith(".cast"):
        if arguments.presenter:
            raise ParamsError("--presenter is for .cast; other films have pixels")
        return None
    columns, rows = arguments.size or CELLS
    presenter = plugins().find("presenter", arguments.presenter or "halfblock")
    return Glyphs(Terminal(columns=columns, rows=rows + 1), presenter)


def _in_cells(way: Way, glyphs: Glyphs) -> Way:
    """The same way in the presenter's pixels, which need not be square, and their samples."""
    samples = sampling(glyphs.presenter, glyphs.terminal)
    size = glyphs.presenter.size(glyphs.terminal)
    pixel = glyphs.presenter.pixel(glyphs.terminal)
    width, height = proportions(size, pixel)
    return lambda index: way(index).reframed(width, height).resized(*(n * samples for n in size))


# --- what a frame depends on


def _notes(
    arguments: argparse.Namespace, scene: Scene, plan: Plan, way: Way
) -> Callable[[int], str]:
    """A digest for each frame: of the scene, the settings, the background and its camera."""
    digest = 0
    for array in (scene.means, scene.quats, scene.scales, scene.opacities, scene.sh, scene.origin):
        digest = zlib.crc32(array.data, digest)
    common = [__version__, digest, repr(plan.asked), arguments.background]

    def note(index: int) -> str:
        text = json.dumps([*common, camera_to_json(way(index))])
        return hashlib.sha256(text.encode()).hexdigest()

    return note


# --- what is told


def _facts(
    output: str, film: Film, done: Written, plan: Plan, scene: Scene, times: dict[str, float]
) -> dict[str, Any]:
    return {
        "output": output,
        "format": "png" if is_sequence(output) else Path(output).suffix.lower()[1:],
        "frames": film.count,
        "rendered": done.rendered,
        "kept": done.kept,
        "fps": film.rate,
        "width": film.size[0],
        "height": film.size[1],
        "bytes": done.size,
        "gaussians": len(scene),
        "backend": dict(plan.backends),
        "threads": plan.threads,
        "settings": settings_text(plan.asked),
        "seconds": times,
    }


def _tell(output: str, film: Film, done: Written, times: dict[str, float]) -> None:
    shown = printable(output)
    if done.kept:
        say(f"{shown}: {done.kept} of {film.count} frames were there and are kept; "
            "--force makes them again")  # fmt: skip
    each = f", {times['render'] / done.rendered * 1e3:.1f} ms each" if done.rendered else ""
    say(
        f"{shown}: {done.rendered} frames rendered, {film.size[0]}x{film.size[1]}{each}; "
        f"{film.count / film.rate:.1f} s at {film.rate:g} a second, {done.size / 1e6:.1f} MB, "
        f"in {times['total']:.1f} s"
    )
