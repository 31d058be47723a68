"""``tsplat view``: the scene in this terminal."""

from __future__ import annotations

import argparse
import os

from tsplat.commands.common import calibrated, load, params
from tsplat.core.errors import TerminalError
from tsplat.plan import make_plan
from tsplat.plugins import plugins
from tsplat.terminal import Screen
from tsplat.viewer.controls import View
from tsplat.viewer.loop import Viewer
from tsplat.views import FOV, frame_orbit, frame_scene

CALIBRATED = 640, 360
"""px: the picture that ``--max-error`` is measured on; the terminal's size is not known yet."""


def run(arguments: argparse.Namespace) -> int:
    """Loads first, so that a scene that cannot be read leaves the terminal untouched."""
    if not (os.isatty(0) and os.isatty(1)):
        raise TerminalError(
            "tsplat view needs a terminal on standard input and output; "
            "without one, `tsplat render SCENE -o out.png` makes a picture"
        )
    registry = plugins()
    if arguments.presenter != "auto":
        registry.find("presenter", arguments.presenter)
    background = arguments.background or (0.0, 0.0, 0.0)
    scene = load(arguments)
    wanted, _ = calibrated(arguments, scene, frame_scene(scene, *CALIBRATED), params(arguments))
    plan = make_plan(scene, backend=arguments.backend, threads=arguments.threads, params=wanted)
    with Screen() as screen:
        orbit = frame_orbit(scene, *screen.terminal.pixels, FOV)
        view = View(orbit, orbit, FOV)
        Viewer(
            screen, scene, plan, view, registry.presenters, arguments.presenter, background
        ).run()
    return 0
