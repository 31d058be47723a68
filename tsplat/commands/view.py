"""``tsplat view``: the scene in this terminal."""

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tsplat.commands.common import (
    calibrated,
    edits,
    load_unedited,
    params,
    pose,
    say,
    terminal_environ,
    upwards,
)
from tsplat.core.camera import Camera
from tsplat.core.errors import CameraError, ParamsError, TerminalError
from tsplat.core.params import PRESETS, RenderParams, settings_text
from tsplat.core.types import Scene
from tsplat.edits import NOTHING, Edits, edited
from tsplat.io.cameras import cameras_beside, load_cameras
from tsplat.paths import load_path
from tsplat.plan import make_plan, why_not
from tsplat.plugins import Registry, plugins
from tsplat.terminal import Screen
from tsplat.viewer.controls import View, orbit_of
from tsplat.viewer.engine import Engine
from tsplat.viewer.frames import Drawn, Encoded, Picture
from tsplat.viewer.keep import Keeper
from tsplat.viewer.look import Look
from tsplat.viewer.loop import Around, Viewer
from tsplat.viewer.pipeline import Pipeline
from tsplat.views import FOV, frame_orbit, frame_scene

if TYPE_CHECKING:
    from tsplat.viewer.verify import Verifier

CALIBRATED = 640, 360
"""px: the picture that ``--max-error`` is measured on; the terminal's size is not known yet."""


def run(arguments: argparse.Namespace) -> int:
    """Loads first, so that a scene that cannot be read leaves the terminal untouched.

    1 if ``--verify`` found the contract broken.
    """
    if not (os.isatty(0) and os.isatty(1)):
        raise TerminalError(
            "tsplat view needs a terminal on standard input and output; "
            "without one, `tsplat render SCENE -o out.png` makes a picture"
        )
    if arguments.verify and (
        arguments.quality not in (None, "contract") or arguments.set or arguments.max_error
    ):
        raise ParamsError(
            "--verify compares with the contract's picture: leave out --quality, --set, --max-error"
        )
    registry = plugins()
    wanted_presenter = arguments.presenter or os.environ.get("TSPLAT_PRESENTER") or "auto"
    if wanted_presenter != "auto":
        registry.find("presenter", wanted_presenter)
    environ = terminal_environ(arguments.terminal)
    path = load_path(arguments.play) if arguments.play else None
    unedited, changes = load_unedited(arguments), edits(arguments)
    scene = edited(unedited, changes)
    if arguments.antialias is None:  # what is said of the session then holds whatever the file says
        arguments.antialias = scene.antialias
    verifier: Verifier | None = None
    with contextlib.ExitStack() as stack:
        if arguments.verify:
            from tsplat.viewer.verify import Worker

            worker = stack.enter_context(Worker(scene, params(arguments, scene)))
        wanted, _ = calibrated(
            arguments, scene, frame_scene(scene, *CALIBRATED), params(arguments, scene)
        )
        plan = make_plan(scene, backend=arguments.backend, threads=arguments.threads, params=wanted)
        if arguments.verify:
            from tsplat.viewer.breaches import BreachLog
            from tsplat.viewer.verify import Verifier

            names = dict.fromkeys(plan.backends.values())
            log = BreachLog(lambda camera, pose: check_command(arguments, names, camera, pose))
            verifier = Verifier(worker, log)
            stack.callback(_report, verifier)
        look = Look(
            params=wanted, edits=changes, background=arguments.background or (0.0, 0.0, 0.0),
            backend=arguments.backend, threads=arguments.threads, presenter=wanted_presenter,
            fps=arguments.fps, max_rate=arguments.max_rate,
        )  # fmt: skip
        keeper = Keeper(partial(render_command, arguments))
        stack.callback(_report_kept, keeper)
        # Before the screen: its threads are waited for when the terminal is given back already
        pipeline: Pipeline[Picture, Drawn, Encoded] = stack.enter_context(Pipeline())
        screen = stack.enter_context(Screen(environ=environ))
        view = first_view(arguments, scene, screen.terminal.pixels, look)
        if path is not None:
            view = view.playing(path)
        around = Around(
            registry.presenters, usable_backends(registry, scene, wanted), keeper,
            partial(scene_cameras, arguments), verifier, arguments.raw_opacity,
        )  # fmt: skip
        Viewer(screen, Engine(unedited, plan, look), view, around, pipeline=pipeline).run()
    return 1 if verifier is not None and verifier.broken else 0


def first_view(
    arguments: argparse.Namespace, scene: Scene, pixels: tuple[int, int], look: Look
) -> View:
    """Where one begins: where the options say, or where the whole scene is in the picture."""
    fov = arguments.fov or FOV
    home = frame_orbit(scene, *pixels, fov, upwards(arguments, scene))
    view = View(home, home, fov, look)
    if arguments.camera is None and arguments.eye is None and arguments.target is None:
        return view
    arguments.size = pixels if arguments.camera is None else None
    camera = pose(arguments, scene)
    if arguments.camera is not None:
        return view.at(camera)
    orbit = orbit_of(camera, home)
    if arguments.target is not None or arguments.eye is not None:
        target = np.asarray(arguments.target or home.target, np.float64)
        distance = float((target - camera.centre) @ camera.rotation[2])
        orbit = replace(orbit, target=target, distance=distance)
    return replace(view, orbit=orbit, home=orbit)


def scene_cameras(arguments: argparse.Namespace) -> list[Camera]:
    """Those of ``--cameras``, or of the file that belongs to the scene.

    Raises:
        CameraError: there is none, or it cannot be read.
    """
    if arguments.cameras is not None:
        return load_cameras(arguments.cameras)
    beside = None if arguments.scene is None else cameras_beside(Path(arguments.scene))
    if beside is None:
        raise CameraError(
            "no cameras.json or transforms.json beside the scene or above it; --cameras names one"
        )
    return load_cameras(beside)


def usable_backends(registry: Registry, scene: Scene, wanted: RenderParams) -> list[str]:
    """Names of the backends that can draw ``scene`` here, the fastest first."""
    ranked = sorted(registry.backends.values(), key=lambda row: -row.rank)
    return [row.name for row in ranked if why_not(row, scene, wanted) is None]


def _report_kept(keeper: Keeper) -> None:
    """What was kept, and how to make it again."""
    keeper.wait()
    for line in keeper.said:
        say(line)


def _report(verifier: Verifier) -> None:
    """What is to be said of a session, when its screen is left."""
    for line in verifier.log.report():
        say(line)
    if verifier.failure:
        say(f"frames were not verified to the end: {verifier.failure}")


def scene_words(arguments: argparse.Namespace, look: Look) -> list[str]:
    """The options that say which scene it is and how it is drawn."""
    words = [str(arguments.scene)] if arguments.scene is not None else []
    if arguments.max_splats is not None:
        words += ["--max-splats", str(arguments.max_splats)]
    if arguments.raw_opacity or look.edits.raw_opacity:
        words.append("--raw-opacity")
    if arguments.sh_float32:
        words.append("--sh-float32")
    if look.params.antialias:
        words.append("--antialias")
    elif arguments.antialias is not None:
        words.append("--no-antialias")
    settings = settings_text(look.params)
    if settings in PRESETS:
        words += ["--quality", settings] if settings != "contract" else []
    else:
        words += ["--set", settings]
    return words + edit_words(look.edits)


def edit_words(edits: Edits) -> list[str]:
    """The options that make ``edits``."""
    words = []
    for name in ("splat_scale", "min_opacity", "max_scale", "trim", "saturation"):
        if (value := getattr(edits, name)) != getattr(NOTHING, name):
            words += [f"--{name.replace('_', '-')}", repr(value)]
    if edits.crop is not None:
        words.append("--crop=" + _numbers((*edits.crop.low, *edits.crop.high)))
    return words


def render_command(
    arguments: argparse.Namespace, view: View, camera: Camera, picture: str, pose: str | None
) -> str:
    """The shell command that makes ``camera``'s picture again; ``pose`` is its file, if any."""
    words = ["tsplat", "render", *scene_words(arguments, view.look), "-o", picture]
    words += ["--size", f"{camera.width}x{camera.height}"]
    if pose is not None:
        words += ["--camera", _camera_spec(pose)]
    else:
        for name, vector in (
            ("eye", camera.centre), ("target", view.orbit.target), ("up", view.orbit.up),
        ):  # fmt: skip
            words.append(f"--{name}=" + _numbers(vector))
        words += ["--fov", repr(float(view.fov)), "--near", repr(float(camera.near))]
        words += ["--far", repr(float(camera.far))]
    if any(view.look.background):
        words.append("--background=" + _numbers(view.look.background))
    if view.look.backend != "auto":
        words += ["--backend", view.look.backend]
    return " ".join(map(_quoted, words))


def _quoted(word: str) -> str:
    """For a shell; a name's control characters reach no screen, ``$'...'`` has them in letters."""
    if word.isprintable():
        return shlex.quote(word)
    return "$'" + "".join(map(_escaped, os.fsencode(word))) + "'"


def _escaped(byte: int) -> str:
    plain = chr(byte).isalnum() and byte < 128
    return chr(byte) if plain or chr(byte) in "/._- " else f"\\x{byte:02x}"


def _camera_spec(file: str) -> str:
    """For ``--camera``: the first camera of ``file``, whatever that is called."""
    return f"{file}#0" if "#" in file else file


def _numbers(values: Iterable[float]) -> str:
    return ",".join(repr(float(value)) for value in values)


def check_command(
    arguments: argparse.Namespace, backends: Iterable[str], camera: Camera, pose: Path
) -> str:
    """The shell command that compares ``camera``'s picture with the reference again.

    ``pose`` is the file that holds the camera. Of several backends each is checked by itself.
    """
    words = ["tsplat", "check"]
    if arguments.scene is not None:
        words.append(str(Path(arguments.scene).absolute()))
    words += ["--camera", _camera_spec(str(pose)), "--size", f"{camera.width}x{camera.height}"]
    for name in ("max_splats", "threads"):
        if getattr(arguments, name) is not None:
            words += [f"--{name.replace('_', '-')}", str(getattr(arguments, name))]
    for name in ("raw_opacity", "sh_float32", "antialias"):
        if getattr(arguments, name):
            words.append(f"--{name.replace('_', '-')}")
    if arguments.antialias is False:
        words.append("--no-antialias")
    words += ["--sh-degree", str(arguments.sh_degree), *edit_words(edits(arguments))]
    isa = os.environ.get("TSPLAT_ISA")
    before = f"TSPLAT_ISA={shlex.quote(isa)} " if isa else ""
    return " && ".join(before + shlex.join([*words, "--backend", name]) for name in backends)
