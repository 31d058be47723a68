"""What several commands do: load a scene, build settings, choose a camera, print."""

from __future__ import annotations

import argparse
import itertools
import json
import math
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from tsplat.core.camera import Camera, look_at
from tsplat.core.constants import FAR, NEAR
from tsplat.core.errors import CameraError, ParamsError
from tsplat.core.params import PRESETS, RenderParams, parse_settings, settings_text
from tsplat.core.types import Scene, Up

if TYPE_CHECKING:
    from tsplat.edits import Edits
    from tsplat.plan import Plan
    from tsplat.quality.calibrate import Calibration

DEFAULT_SIZE = 1280, 720

DEADLY = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""What ends a process from outside; Windows has no SIGHUP."""


def load(arguments: argparse.Namespace, *, exact: bool = False) -> Scene:
    """The scene named on the command line, or the demo scene; a progress bar if it takes long.

    ``exact`` keeps colours in float32, as ``--sh-float32`` does. Edits are made to it; what they
    leave out is not in it.
    """
    from tsplat.edits import filtered

    return filtered(load_unedited(arguments, exact=exact), edits(arguments))


def edits(arguments: argparse.Namespace) -> Edits:
    """The edits that the command line names."""
    from tsplat.edits import Box, Edits

    crop = getattr(arguments, "crop", None)
    return Edits(
        splat_scale=getattr(arguments, "splat_scale", 1.0),
        min_opacity=getattr(arguments, "min_opacity", 0.0),
        max_scale=getattr(arguments, "max_scale", None),
        trim=getattr(arguments, "trim", 0.0),
        saturation=getattr(arguments, "saturation", 1.0),
        crop=Box(*crop) if crop else None,
    )


def load_unedited(arguments: argparse.Namespace, *, exact: bool = False) -> Scene:
    """:func:`load` without the edits."""
    if arguments.scene is None:
        from tsplat.demo import demo_scene
        from tsplat.io.base import sampled

        return sampled(demo_scene(), arguments.max_splats)
    from tsplat.io import load_scene
    from tsplat.io.progress import progress_bar

    with progress_bar(f"reading {arguments.scene}") as progress:
        scene = load_scene(
            arguments.scene,
            max_splats=arguments.max_splats,
            raw_opacity=arguments.raw_opacity,
            sh_float32=arguments.sh_float32 or exact,
            progress=progress,
        )
    if scene.up or getattr(arguments, "up", None) is not None:
        return scene
    return replace(scene, up=_up_beside(Path(arguments.scene)))


def _up_beside(scene: Path) -> Up | None:
    """What the cameras that lie beside a scene say of its up; nothing if they cannot be read."""
    from tsplat.io.cameras import cameras_beside, load_rotations
    from tsplat.views import up_of_cameras

    try:
        beside = cameras_beside(scene)
        return up_of_cameras(load_rotations(beside), beside.name) if beside else None
    except (CameraError, OSError):
        return None


def params(arguments: argparse.Namespace, scene: Scene) -> RenderParams:
    """The settings that the command line names, without what ``--max-error`` may choose.

    Whether to antialias is for the scene's file to say where the command line does not.
    """
    preset = PRESETS[getattr(arguments, "quality", None) or "contract"]
    made = parse_settings(getattr(arguments, "set", None) or "", preset)
    degree = min(made.sh_degree, arguments.sh_degree)
    asked = arguments.antialias
    antialias = bool(scene.antialias) if asked is None else asked
    return replace(made, sh_degree=degree, antialias=antialias)


def calibrated(
    arguments: argparse.Namespace, scene: Scene, camera: Camera, asked: RenderParams
) -> tuple[RenderParams, Calibration | None]:
    """``asked``, or what ``--max-error`` makes of it for this scene and camera; says so."""
    if arguments.max_error is None:
        return asked, None
    if arguments.quality or arguments.set:
        raise ParamsError("--max-error chooses the settings: leave out --quality and --set")
    from tsplat.io.progress import progress_bar
    from tsplat.plan import make_plan
    from tsplat.quality.calibrate import calibrate, parse_bound

    bound = parse_bound(arguments.max_error)

    def plan_of(settings: RenderParams) -> Plan:
        return make_plan(
            scene, backend=arguments.backend, threads=arguments.threads, params=settings
        )

    with progress_bar("calibrating") as progress:
        steps = itertools.count(1)
        found = calibrate(
            scene, camera, bound, plan_of, asked, lambda: progress(next(steps), STEPS)
        )
    picked, contract = found.picked, found.contract
    say(
        f"--max-error {arguments.max_error}: {settings_text(picked.params)}; measured on "
        f"{found.cameras} cameras: 99.9 % of pixels within {picked.error.p999:.2g} levels, the "
        f"worst {picked.error.worst:.2g} off; {contract.seconds / picked.seconds:.2f} times the "
        "contract's speed"
    )
    return picked.params, found


STEPS = 60
"""About as many pictures as calibrating takes, for its progress bar."""


def sized(camera: Camera, size: tuple[int, int] | None) -> Camera:
    """``camera`` at ``size``; a warning if that stretches the picture."""
    if size is None:
        return camera
    width, height = size
    stretch = width * camera.height / (height * camera.width)
    if abs(math.log(stretch)) > 0.02:
        say(
            f"warning: the camera is {camera.width}x{camera.height}; "
            f"--size {width}x{height} stretches its picture by {stretch:.3g}"
        )
    return camera.resized(width, height)


def camera_from_file(spec: str, size: tuple[int, int] | None) -> Camera:
    """The camera that ``FILE#INDEX`` names, at ``size`` if given."""
    from tsplat.io.cameras import load_camera

    return sized(load_camera(spec), size)


def pose(arguments: argparse.Namespace, scene: Scene) -> Camera:
    """The camera that the options of ``render`` describe."""
    from tsplat.views import FOV, frame_orbit, frame_scene, scene_extent

    free = [n for n in ("eye", "target", "up", "fov") if getattr(arguments, n) is not None]
    if arguments.camera is not None:
        if free:
            raise CameraError(f"--camera says all of that: leave out --{free[0]}")
        camera = camera_from_file(arguments.camera, arguments.size)
    else:
        width, height = arguments.size or DEFAULT_SIZE
        fov = arguments.fov if arguments.fov is not None else FOV
        up = upwards(arguments, scene)
        if arguments.eye is not None:
            target = arguments.target or scene_extent(scene).centre
            camera = look_at(arguments.eye, target, up, fov, width, height, NEAR, FAR)
        elif arguments.target is not None:
            orbit = replace(frame_orbit(scene, width, height, fov, up), target=arguments.target)
            camera = orbit.camera(fov, width, height)
        else:
            camera = frame_scene(scene, width, height, fov=fov, up=up)
    near = arguments.near if arguments.near is not None else camera.near
    far = arguments.far if arguments.far is not None else camera.far
    return replace(camera, near=near, far=far)


def upwards(arguments: argparse.Namespace, scene: Scene) -> tuple[float, float, float]:
    """Which way is up: as the command line says, or as it is known of the scene."""
    from tsplat.views import up_of

    if arguments.up is not None and arguments.flip_y:
        raise CameraError("--up and --flip-y both say which way is up: leave one out")
    up: tuple[float, float, float] = arguments.up or up_of(scene).direction
    x, y, z = up
    return (-x, -y, -z) if arguments.flip_y else up


def say(text: str) -> None:
    """A line for the person, on stderr."""
    print(f"tsplat: {text}", file=sys.stderr)


def print_json(value: Any) -> None:
    """One JSON object on stdout; infinities as null, since JSON has none."""
    print(json.dumps(_finite(value), indent=2))


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def dropped_text(scene: Scene) -> str:
    """``left out 2 (non-finite mean), 1 (...)``, or nothing."""
    if not scene.dropped:
        return ""
    return "left out " + ", ".join(f"{n:,} ({reason})" for reason, n in scene.dropped.items())


@contextmanager
def unwinding() -> Iterator[None]:
    """SIGTERM and SIGHUP go up like Ctrl-C, so that nothing half-written is left.

    What is ignored, as under nohup, still is.
    """

    def leave(signum: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + signum)

    deadly = [s for s in DEADLY if signal.getsignal(s) is not signal.SIG_IGN]
    before = {number: signal.signal(number, leave) for number in deadly}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def terminal_environ(spec: str | None) -> dict[str, str]:
    """The environment, with ``--terminal``'s words where they are given.

    Raises:
        TerminalError: the words are not understood.
    """
    import os

    from tsplat.presenters.base import Terminal
    from tsplat.terminal.profiles import overridden

    environ = dict(os.environ)
    if spec is not None:
        environ["TSPLAT_TERMINAL"] = spec
    overridden(Terminal(), environ.get("TSPLAT_TERMINAL", ""))  # before the screen is touched
    return environ
