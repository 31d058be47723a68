"""What several commands do: load a scene, build settings, choose a camera, print."""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import Any

from tsplat.core.camera import Camera, look_at
from tsplat.core.constants import FAR, NEAR
from tsplat.core.errors import CameraError
from tsplat.core.params import RenderParams
from tsplat.core.types import Scene

DEFAULT_SIZE = 1280, 720


def load(arguments: argparse.Namespace, *, exact: bool = False) -> Scene:
    """The scene named on the command line, or the demo scene; a progress bar if it takes long.

    ``exact`` keeps colours in float32, as ``--sh-float32`` does.
    """
    if arguments.scene is None:
        from tsplat.demo import demo_scene

        return demo_scene()
    from tsplat.io import load_scene
    from tsplat.io.progress import progress_bar

    with progress_bar(f"reading {arguments.scene}") as progress:
        return load_scene(
            arguments.scene,
            max_splats=arguments.max_splats,
            raw_opacity=arguments.raw_opacity,
            sh_float32=arguments.sh_float32 or exact,
            progress=progress,
        )


def params(arguments: argparse.Namespace) -> RenderParams:
    """The settings that ``--antialias`` and ``--sh-degree`` name."""
    return RenderParams(sh_degree=arguments.sh_degree, antialias=arguments.antialias)


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
    from dataclasses import replace

    from tsplat.views import FOV, UP, frame_orbit, frame_scene, scene_extent

    free = [n for n in ("eye", "target", "up", "fov") if getattr(arguments, n) is not None]
    if arguments.camera is not None:
        if free:
            raise CameraError(f"--camera says all of that: leave out --{free[0]}")
        camera = camera_from_file(arguments.camera, arguments.size)
    else:
        width, height = arguments.size or DEFAULT_SIZE
        fov = arguments.fov if arguments.fov is not None else FOV
        up = arguments.up or UP
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
