"""The data that flow from stage to stage: frozen structs of C-contiguous arrays.

NumPy, a numba loop and a C pointer read the same memory. A *Gaussian* is a row of
:class:`Scene`; a *splat* is a row of :class:`Splats`. The comment after a field is its contract.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tsplat.core.constants import SH_DEGREE_MAX
from tsplat.core.errors import SceneError, check_array

F16 = NDArray[np.float16]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
Floats = NDArray[np.float32] | NDArray[np.float64]
"""float32 from every backend; float64 from the reference when it works in float64."""


def _zero_origin() -> F64:
    return np.zeros(3)


UPWARDS = (0.0, -1.0, 0.0)
"""Up in COLMAP's world, which INRIA's trainer keeps: y points down."""


class Up(NamedTuple):
    """Which way is up in a scene, and how that is known."""

    direction: tuple[float, float, float]  # world axes; any length but 0
    why: str  # for messages


@dataclass(frozen=True, eq=False)
class Scene:
    """N Gaussians, decoded: no logits, no logarithms, nothing that is not finite.

    ``means`` are relative to ``origin``, so a georeferenced scene keeps its detail in float32.
    Build one from arrays of any float type with :func:`tsplat.scene_from_arrays`, which
    normalises, drops what cannot be drawn, and counts it.

    Raises:
        SceneError: an array has another dtype, shape or layout than stated here.
    """

    means: F32  # [N, 3]     world units, relative to origin
    quats: F32  # [N, 4]     w, x, y, z; unit length
    scales: F32  # [N, 3]    world units, standard deviations along the Gaussian's own axes; >= 0
    opacities: F32  # [N]    0..1
    sh: (
        # [N, K, 3]  spherical harmonics, K in {1, 4, 9, 16}; display-referred RGB; within 2.1e37,
        # so that colours are finite
        F32 | F16
    )
    origin: F64 = field(default_factory=_zero_origin)  # [3]  world units
    name: str = "scene"  # for messages
    dropped: Mapping[str, int] = field(
        default_factory=dict
    )  # reason -> Gaussians the loader left out
    sh_error: float = 0.0  # 0..1: no colour is farther off for sh being float16, from anywhere
    # [N]  which place each row had in its source, if a loader moved them along a space-filling
    # curve; distinct, and only their order counts; None if that is the order of the rows
    numbers: I32 | None = None
    source: str = ""  # for messages: the format it was read from, and what matters of that
    antialias: bool | None = None  # trained with antialiasing, its file says; None: it does not say
    up: Up | None = None  # as its file says; None: it does not say

    def __post_init__(self) -> None:
        check_array("Scene.means", self.means, np.float32, ("N", 3))
        n = len(self.means)
        check_array(
            "Scene.quats", self.quats, np.float32, (n, 4), "Quaternions are stored w, x, y, z."
        )
        check_array("Scene.scales", self.scales, np.float32, (n, 3), "Linear, not logarithms.")
        check_array("Scene.opacities", self.opacities, np.float32, (n,), "In 0..1, not logits.")
        half = getattr(self.sh, "dtype", None) == np.float16
        check_array(
            "Scene.sh",
            self.sh,
            np.float16 if half else np.float32,
            (n, "K", 3),
            "Coefficient-major, RGB last; float16 will do too.",
        )
        check_array("Scene.origin", self.origin, np.float64, (3,))
        if self.numbers is not None:
            check_array("Scene.numbers", self.numbers, np.int32, (n,))
        if self.sh.shape[1] not in (1, 4, 9, 16):
            raise SceneError(
                f"Scene.sh: expected 1, 4, 9 or 16 coefficients (degree 0 to {SH_DEGREE_MAX}), "
                f"got {self.sh.shape[1]}."
            )

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree that ``sh`` has room for, 0 to 3."""
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.sh.shape[1]]

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Scene:
        """The Gaussians at ``rows`` (indices or a mask), in that order; they keep their numbers."""
        return replace(
            self,
            means=np.ascontiguousarray(self.means[rows]),
            quats=np.ascontiguousarray(self.quats[rows]),
            scales=np.ascontiguousarray(self.scales[rows]),
            opacities=np.ascontiguousarray(self.opacities[rows]),
            sh=np.ascontiguousarray(self.sh[rows]),
            numbers=self.numbers_of(rows),
        )

    def numbers_of(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> I32 | None:
        """``numbers[rows]``; None if there are none."""
        return None if self.numbers is None else np.ascontiguousarray(self.numbers[rows])


@dataclass(frozen=True, eq=False)
class Splats:
    """M visible Gaussians on the image plane, in the order of the scene's rows.

    The inverse 2D covariance is kept as its upper Cholesky factor U, so that the exponent is a
    sum of squares and never positive: ``sigma = ((u11 dx + u12 dy)^2 + (u22 dy)^2) / 2``.
    A conic's (a, b, c) in float32 has lost a needle's width already; its factor has not. Means are
    float64, because float32 at 1000 px is 3e-5 px off, which moves pixels across the threshold.
    """

    means2d: F64  # [M, 2]       px; the top-left pixel's centre is (0.5, 0.5)
    factors: Floats  # [M, 3]    u11, u12, u22: conic = U^T U, 1/px
    depths: F32  # [M]           camera z, > 0; computed in float64, compared as float32
    opacities: Floats  # [M]     0..1, after the antialias factor
    colors: Floats  # [M, 3]     RGB >= 0
    radii: (
        Floats  # [M, 2]      px; the box mean +- radii holds every pixel centre the splat reaches
    )
    gaussian_ids: I32  # [M]     row in Scene, increasing
    width: int  # px
    height: int  # px
    overflowed: int = 0  # Gaussians too large or near for float32, dropped
    numbers: I32 | None = None  # [M]  of equal depths the lowest is in front; None: by row

    def __len__(self) -> int:
        return len(self.gaussian_ids)


@dataclass(frozen=True, eq=False)
class Bins:
    """Which splats may reach which tile, near to far; tiles in rows from the top left."""

    tile_offsets: I64  # [T + 1]    tile t owns splat_ids[tile_offsets[t]:tile_offsets[t + 1]]
    splat_ids: I32  # [I]           row in Splats
    tile_size: int  # px

    def __len__(self) -> int:
        return len(self.splat_ids)


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture before its background. ``rgb + transmittance * background`` is what is shown."""

    rgb: Floats  # [H, W, 3]            premultiplied, display-referred, not clipped above
    transmittance: Floats  # [H, W]     1 where nothing was drawn
    depth: Floats | None = None  # [H, W]  sum of weight * camera z; divide by 1 - transmittance

    @property
    def width(self) -> int:
        return int(self.rgb.shape[1])

    @property
    def height(self) -> int:
        return int(self.rgb.shape[0])

    def over(self, background: tuple[float, float, float]) -> Frame:
        """The same picture with ``background`` (RGB, 0..1) behind it: opaque everywhere."""
        if any(background):
            rgb = self.rgb + self.transmittance[..., None] * np.asarray(background, self.rgb.dtype)
        else:
            rgb = self.rgb
        return Frame(rgb, np.zeros_like(self.transmittance), self.depth)

    def to_uint8(self) -> U8:
        """``floor(clip(rgb, 0, 1) * 255 + 0.5)``, [H, W, 3]; the background counts as black."""
        clipped: NDArray[Any] = np.clip(self.rgb, 0, 1)
        return np.asarray(clipped * 255 + 0.5).astype(np.uint8)  # Python's numbers keep float32
