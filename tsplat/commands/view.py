"""``tsplat view``: the scene in this terminal."""

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from tsplat.commands.common import calibrated, load, params, say, terminal_environ
from tsplat.core.camera import Camera
from tsplat.core.errors import ParamsError, TerminalError
from tsplat.paths import load_path
from tsplat.plan import make_plan
from tsplat.plugins import plugins
from tsplat.terminal import Screen
from tsplat.viewer.controls import View
from tsplat.viewer.loop import Drawn, Encoded, Picture, Viewer
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
    background = arguments.background or (0.0, 0.0, 0.0)
    scene = load(arguments)
    verifier: Verifier | None = None
    with contextlib.ExitStack() as stack:
        if arguments.verify:
            from tsplat.viewer.verify import Worker

            worker = stack.enter_context(Worker(scene, params(arguments)))
        wanted, _ = calibrated(arguments, scene, frame_scene(scene, *CALIBRATED), params(arguments))
        plan = make_plan(scene, backend=arguments.backend, threads=arguments.threads, params=wanted)
        if arguments.verify:
            from tsplat.viewer.breaches import BreachLog
            from tsplat.viewer.verify import Verifier

            names = dict.fromkeys(plan.backends.values())
            log = BreachLog(lambda camera, pose: check_command(arguments, names, camera, pose))
            verifier = Verifier(worker, log)
            stack.callback(_report, verifier)
        # Before the screen: its threads are waited for when the terminal is given back already
        pipeline: Pipeline[Picture, Drawn, Encoded] = stack.enter_context(Pipeline())
        screen = stack.enter_context(Screen(environ=environ))
        screen.max_rate = arguments.max_rate / 8 if arguments.max_rate else None
        orbit = frame_orbit(scene, *screen.terminal.pixels, FOV)
        view = View(orbit, orbit, FOV)
        if path is not None:
            view = view.playing(path)
        Viewer(
            screen, scene, plan, view, registry.presenters, wanted_presenter, background,
            verifier, pipeline=pipeline, fps=arguments.fps,
        ).run()  # fmt: skip
    return 1 if verifier is not None and verifier.broken else 0


def _report(verifier: Verifier) -> None:
    """What is to be said of a session, when its screen is left."""
    for line in verifier.log.report():
        say(line)
    if verifier.failure:
        say(f"frames were not verified to the end: {verifier.failure}")


def check_command(
    arguments: argparse.Namespace, backends: Iterable[str], camera: Camera, pose: Path
) -> str:
    """The shell command that compares ``camera``'s picture with the reference again.

    ``pose`` is the file that holds the camera. Of several backends each is checked by itself.
    """
    words = ["tsplat", "check"]
    if arguments.scene is not None:
        words.append(str(Path(arguments.scene).absolute()))
    spec = f"{pose}#0" if "#" in str(pose) else str(pose)
    words += ["--camera", spec, "--size", f"{camera.width}x{camera.height}"]
    for name in ("max_splats", "threads"):
        if getattr(arguments, name) is not None:
            words += [f"--{name.replace('_', '-')}", str(getattr(arguments, name))]
    for name in ("raw_opacity", "sh_float32", "antialias"):
        if getattr(arguments, name):
            words.append(f"--{name.replace('_', '-')}")
    words += ["--sh-degree", str(arguments.sh_degree)]
    isa = os.environ.get("TSPLAT_ISA")
    before = f"TSPLAT_ISA={shlex.quote(isa)} " if isa else ""
    return " && ".join(before + shlex.join([*words, "--backend", name]) for name in backends)
