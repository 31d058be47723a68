"""3D Gaussian Splatting scenes in a terminal, on a CPU.

    import tsplat

    scene = tsplat.load_scene("garden.ply")
    camera = tsplat.frame_scene(scene, 1280, 720)
    frame = tsplat.render(scene, camera, tsplat.make_plan(scene, backend="auto", threads=2))
    tsplat.save_image(frame, "garden.png")

Names are imported when first used, so ``import tsplat`` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from tsplat._version import __version__

if TYPE_CHECKING:
    from tsplat.core.camera import Camera, Fly, Orbit, look_at
    from tsplat.core.errors import TsplatError
    from tsplat.core.params import IDEAL, RenderParams
    from tsplat.core.stages import Backend, Counts, Stages
    from tsplat.core.ties import break_ties
    from tsplat.core.types import Bins, Frame, Scene, Splats
    from tsplat.core.workspace import Workspace
    from tsplat.demo import demo_scene
    from tsplat.hookspecs import hookimpl
    from tsplat.io import load_cameras, load_scene, save_image, save_scene, scene_from_arrays
    from tsplat.io.base import Reader, ReadOptions
    from tsplat.io.write.base import WriteOptions, Writer, Written
    from tsplat.plan import Plan, make_plan, render
    from tsplat.presenters.base import Presenter, Terminal
    from tsplat.views import frame_scene

_HOMES = {
    "tsplat.core.camera": ("Camera", "Fly", "Orbit", "look_at"),
    "tsplat.core.errors": ("TsplatError",),
    "tsplat.core.params": ("IDEAL", "RenderParams"),
    "tsplat.core.stages": ("Backend", "Counts", "Stages"),
    "tsplat.core.ties": ("break_ties",),
    "tsplat.core.types": ("Bins", "Frame", "Scene", "Splats"),
    "tsplat.core.workspace": ("Workspace",),
    "tsplat.demo": ("demo_scene",),
    "tsplat.hookspecs": ("hookimpl",),
    "tsplat.io": (
        "load_cameras",
        "load_scene",
        "save_image",
        "save_scene",
        "scene_from_arrays",
    ),
    "tsplat.io.base": ("ReadOptions", "Reader"),
    "tsplat.io.write.base": ("WriteOptions", "Writer", "Written"),
    "tsplat.plan": ("Plan", "make_plan", "render"),
    "tsplat.presenters.base": ("Presenter", "Terminal"),
    "tsplat.views": ("frame_scene",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "IDEAL",
    "Backend",
    "Bins",
    "Camera",
    "Counts",
    "Fly",
    "Frame",
    "Orbit",
    "Plan",
    "Presenter",
    "ReadOptions",
    "Reader",
    "RenderParams",
    "Scene",
    "Splats",
    "Stages",
    "Terminal",
    "TsplatError",
    "Workspace",
    "WriteOptions",
    "Writer",
    "Written",
    "__version__",
    "break_ties",
    "demo_scene",
    "frame_scene",
    "hookimpl",
    "load_cameras",
    "load_scene",
    "look_at",
    "make_plan",
    "render",
    "save_image",
    "save_scene",
    "scene_from_arrays",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'tsplat' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
