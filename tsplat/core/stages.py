"""The four stages, as contracts: what must hold, not how it is reached.

    splats = project(scene, camera, params, workspace)
    order = sort(splats, workspace)
    bins = bin(splats, order, workspace)
    frame = composite(splats, bins, params, workspace)

A stage is any callable that satisfies its Protocol. Tile size, culling, key packing and memory
layout are each backend's own business: none of them may change the picture, and neither may
the number of threads (``workspace.threads``): the same input gives the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from tsplat.core.camera import Camera
from tsplat.core.params import RenderParams
from tsplat.core.types import I32, Bins, Frame, Scene, Splats
from tsplat.core.workspace import Workspace

STAGES = ("project", "sort", "bin", "composite")


class Project(Protocol):
    """Gaussians -> splats, in the order of their rows, with their numbers.

    Must keep every Gaussian with near < z < far that reaches a pixel (alpha at or above the
    threshold); may keep others. Depths are camera z, evaluated in float64 as
    ``(r20 dx + r21 dy) + r22 dz`` without fused operations and rounded once to float32, then to
    ``params.depth_bits`` by ``params.depth_split``, so that every backend sees the same order and
    the same ties.
    """

    def __call__(
        self, scene: Scene, camera: Camera, params: RenderParams, workspace: Workspace
    ) -> Splats: ...


class Sort(Protocol):
    """Splats -> order [M] int32, near to far; equal depths by ``numbers``, or by row without.

    A stable sort by depth and :func:`tsplat.core.ties.break_ties` give just that.
    """

    def __call__(self, splats: Splats, workspace: Workspace) -> I32: ...


class Bin(Protocol):
    """Splats and their order -> which splats each tile must look at, near to far.

    May list a splat in vain; may never miss one that reaches a pixel of the tile.
    """

    def __call__(self, splats: Splats, order: I32, workspace: Workspace) -> Bins: ...


class Composite(Protocol):
    """Splats and bins -> the picture, front to back.

    A splat is drawn at a pixel where its alpha is at least ``params.alpha_threshold``, until the
    next one would take the pixel's transmittance to ``params.transmittance_min`` or below.
    """

    def __call__(
        self, splats: Splats, bins: Bins, params: RenderParams, workspace: Workspace
    ) -> Frame: ...


IDENTICAL = "the picture is the same to the bit"


@dataclass(frozen=True)
class LeftOut:
    """Work that is skipped."""

    what: str
    why: str
    effect: str = IDENTICAL


@dataclass(frozen=True)
class Counts:
    """What a fused frame did: its own seconds per stage (a stage merged into another has none)."""

    visible: int
    intersections: int
    overflowed: int
    seconds: Mapping[str, float]
    left_out: tuple[LeftOut, ...] = ()  # what this frame did not need


class Fused(Protocol):
    """The whole frame at once; the same picture as the four stages, to the bit.

    It may skip whatever does not change the picture, and says so, unless ``everything`` is to be
    done: that is how each cut is proved.
    """

    def __call__(
        self,
        scene: Scene,
        camera: Camera,
        params: RenderParams,
        workspace: Workspace,
        everything: bool = False,
    ) -> tuple[Frame, Counts]: ...


class Upscale(Protocol):
    """A frame -> the same at another size, as :func:`tsplat.quality.upscale.upscale` has it.

    No stage, and none has to offer it; within 1e-5 of what that function makes.
    """

    def __call__(self, frame: Frame, width: int, height: int, workspace: Workspace) -> Frame: ...


def _nothing(scene: Scene, params: RenderParams) -> tuple[LeftOut, ...]:
    return ()


@dataclass(frozen=True)
class Stages:
    """What a backend offers once loaded; ``None`` for a stage it leaves to another backend."""

    project: Project | None = None
    sort: Sort | None = None
    bin: Bin | None = None
    composite: Composite | None = None
    fused: Fused | None = None  # only beside all four
    upscale: Upscale | None = None
    # what fused leaves out of a scene's pictures, whatever the camera
    leaves_out: Callable[[Scene, RenderParams], tuple[LeftOut, ...]] = _nothing

    def offered(self) -> tuple[str, ...]:
        """Names of the stages that are there, in pipeline order."""
        return tuple(s for s in STAGES if getattr(self, s) is not None)


def _always() -> str | None:
    return None


def _anything(scene: Scene, params: RenderParams) -> str | None:
    return None


@dataclass(frozen=True)
class Backend:
    """A way to make frames: one row of the table that ``tsplat plugins`` prints.

    Making the row must be cheap. Heavy imports belong into ``load``, which is called once, on
    first use; ``unavailable`` is asked when backends are listed and must not import them either.
    """

    name: str
    summary: str  # one line
    load: Callable[[], Stages]
    stages: tuple[str, ...] = STAGES  # what load() will offer
    rank: int = -1  # "auto" takes the highest that is available; the reference has 0
    unavailable: Callable[[], str | None] = _always  # None, or why it cannot run here and a remedy
    cannot: Callable[[Scene, RenderParams], str | None] = _anything  # None, or why not this picture
