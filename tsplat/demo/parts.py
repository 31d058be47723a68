"""Bricks of the demo: batches of Gaussians, and surfaces covered with them without holes.

Everything is built where it will stand: x right, y down, z ahead. Heights are therefore negated
on the way in, by :func:`xyz`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsplat.core.types import F32, F64

GOLDEN = 0.6180339887498949
"""A lattice with this ratio stays even under any stretching along its axes."""

COVER = 0.68
"""Standard deviation of a surfel in units of the distance to its neighbours: closes the surface."""

UP = np.array([0.0, -1.0, 0.0])

Shape = Callable[[F64, F64], F64]
"""Points [N, 3] of a surface at parameters u, v [N] in 0..1; u may be periodic."""


@dataclass(frozen=True, eq=False)
class Part:
    """A batch of Gaussians, in float32 as in a :class:`~tsplat.core.types.Scene`."""

    means: F32  # [N, 3]
    quats: F32  # [N, 4]
    scales: F32  # [N, 3]
    opacities: F32  # [N]
    sh: F32  # [N, 16, 3]

    def __len__(self) -> int:
        return len(self.means)

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Part:
        """The Gaussians at ``rows``."""
        return Part(
            self.means[rows], self.quats[rows], self.scales[rows], self.opacities[rows],
            self.sh[rows],
        )  # fmt: skip


def join(parts: Sequence[Part]) -> Part:
    """All parts in one."""
    return Part(
        np.concatenate([p.means for p in parts]),
        np.concatenate([p.quats for p in parts]),
        np.concatenate([p.scales for p in parts]),
        np.concatenate([p.opacities for p in parts]),
        np.concatenate([p.sh for p in parts]),
    )


def xyz(x: ArrayLike, height: ArrayLike, z: ArrayLike) -> F64:
    """World points [..., 3] at ``height`` above the water."""
    return np.stack(np.broadcast_arrays(x, np.negative(height), z), -1).astype(np.float64)


def unit(v: ArrayLike) -> F64:
    """Vectors of length 1."""
    v = np.asarray(v, np.float64)
    return np.asarray(v / np.maximum(_lengths(v), 1e-12)[..., None], np.float64)


def smooth(edge0: float, edge1: float, x: ArrayLike) -> F64:
    """0 before ``edge0``, 1 after ``edge1``, with a soft passage."""
    t = (np.asarray(x, np.float64) - edge0) * (1 / (edge1 - edge0))
    t = np.minimum(np.maximum(t, 0), 1)
    return np.asarray(t * t * (3 - 2 * t), np.float64)


def mix(a: ArrayLike, b: ArrayLike, t: F64) -> F64:
    """Colours [N, 3] between ``a`` and ``b``."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return np.asarray(a + (b - a) * t[:, None], np.float64)


def noise(points: F64, frequency: float, octaves: int, seed: int) -> F64:
    """Smooth noise, about -1..1: waves in random directions, bent by one another.

    A wave is made of parabolas, as alike to a sine as is needed and the same on every machine.
    """
    rng = np.random.default_rng(seed)
    x, y, z = np.ascontiguousarray(points.T, np.float32)
    total = np.zeros(len(points), np.float32)
    for octave in range(octaves):
        waves = unit(rng.normal(size=(3, 3))) * (frequency * 1.9**octave / (2 * np.pi))
        bend, added = 0.24 * total, np.zeros_like(total)
        for (a, b, c), phase in zip(waves.tolist(), rng.uniform(0, 1, 3).tolist(), strict=True):
            turn = a * x + b * y + c * z + bend
            turn += phase
            turn -= np.rint(turn)  # -1/2..1/2
            added += turn * (1 - 2 * np.abs(turn))
        total += added * np.float32(8 * 0.42 / 1.8**octave)
    return total.astype(np.float64)


def facing(directions: F64) -> F64:
    """Quaternions [N, 4] that turn the z axis to ``directions`` by the shortest way."""
    x, y, z = directions.T
    quats = np.stack([1 + z, -y, x, np.zeros_like(z)], 1)
    quats[z < -1 + 1e-9] = 0, 1, 0, 0
    return unit(quats)


def gaussians(
    means: F64, axes: F64, across: ArrayLike, along: ArrayLike, opacity: ArrayLike, sh: F32
) -> Part:
    """Gaussians ``along`` their axis by one size and ``across`` it by another.

    Much longer than wide is a needle, much wider than long is a surfel.
    """
    n = len(means)
    scales = np.empty((n, 3), np.float32)
    scales[:, :2] = np.broadcast_to(np.asarray(across, np.float32), n)[:, None]
    scales[:, 2] = along
    return Part(
        means.astype(np.float32),
        facing(axes).astype(np.float32),
        scales,
        np.broadcast_to(np.asarray(opacity, np.float32), n).copy(),
        np.broadcast_to(sh, (n, 16, 3)),
    )


def surfels(points: F64, normals: F64, size: F64 | float, sh: F32, opacity: float = 0.995) -> Part:
    """Flat Gaussians that close the surface through ``points`` a distance ``size`` apart."""
    across = np.asarray(size) * COVER
    return gaussians(points, normals, across, 0.12 * across, opacity, sh)


def blobs(points: F64, size: F64 | float, opacity: ArrayLike, sh: F32) -> Part:
    """Round Gaussians."""
    axes = np.broadcast_to(UP, points.shape)
    return gaussians(points, axes, size, size, opacity, sh)


def lattice(n: int) -> tuple[F64, F64]:
    """u, v in 0..1: n points, evenly spread however the square is stretched."""
    i = np.arange(n)
    return np.asarray(i * GOLDEN % 1.0, np.float64), (i + 0.5) / n


def cover(shape: Shape, n: int) -> tuple[F64, F64, F64, F64, F64]:
    """Spreads n points evenly by area over ``shape``: points, normals, size, u, v.

    ``size`` is the distance to the neighbours. The normals point away from the points' middle.
    """
    bands, steps = 64, 16
    grid_u, grid_v = np.meshgrid(np.arange(steps + 1) / steps, np.arange(bands + 1) / bands)
    grid = shape(grid_u.ravel(), grid_v.ravel()).reshape(bands + 1, steps + 1, 3)
    du, dv = (grid[:, 1:] - grid[:, :-1])[1:], (grid[1:] - grid[:-1])[:, 1:]
    area = _lengths(np.cross(du, dv)).mean(1)
    area = np.maximum(area / area.mean(), 1e-6)
    share = np.concatenate([[0], np.cumsum(area)]) / area.sum()
    u, order = lattice(n)
    v = np.interp(order, share, np.arange(bands + 1) / bands)
    points = shape(u, v)
    e = np.where(v < 0.5, 2e-3, -2e-3)  # never past an end
    cross = np.cross(shape(u + 2e-3, v) - points, shape(u, v + e) - points) / e[:, None]
    stretch = _lengths(cross) / 2e-3
    normals = cross / np.maximum(stretch * 2e-3, 1e-12)[:, None]
    outward = np.einsum("ni,ni->", points - points.mean(0), normals)
    density = np.interp(v, (np.arange(bands) + 0.5) / bands, area)
    size = np.sqrt(np.maximum(stretch, 0.3 * np.median(stretch)) / (n * density))
    size = np.minimum(size, 1.7 * np.median(size))  # folds would be smeared
    return points, normals * np.sign(outward), size, u, v


def _lengths(vectors: F64) -> F64:
    return np.asarray(np.sqrt(np.einsum("...i,...i", vectors, vectors)), np.float64)


def sphere(centre: ArrayLike, radii: ArrayLike) -> Shape:
    """An ellipsoid."""

    def shape(u: F64, v: F64) -> F64:
        angle, height = 2 * np.pi * u, 1 - 2 * v
        ring = np.sqrt(np.maximum(1 - height * height, 0))
        at = xyz(ring * np.cos(angle), height, ring * np.sin(angle))
        return np.asarray(np.asarray(centre) + np.asarray(radii) * at, np.float64)

    return shape


def beam(
    path: Callable[[F64], F64], side: ArrayLike, over: ArrayLike, width: ArrayLike,
    height: ArrayLike, power: float = 2.0,
) -> Shape:  # fmt: skip
    """A rod along ``path`` (v in 0..1) with closed ends.

    Its cross-section spans ``width`` along ``side`` and ``height`` along ``over``: round if
    ``power`` is 2, boxy above.
    """

    def shape(u: F64, v: F64) -> F64:
        end = np.clip(np.minimum(v, 1 - v) / 0.02, 0, 1)
        closed = (1 - (1 - end) ** 4) ** 0.25
        c, s = np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)
        reach = closed * (np.abs(c) ** power + np.abs(s) ** power) ** (-1 / power)
        a = (reach * c * np.asarray(width))[:, None] * np.asarray(side)
        b = (reach * s * np.asarray(height))[:, None] * np.asarray(over)
        return np.asarray(path(np.clip((v - 0.02) / 0.96, 0, 1)) + a + b, np.float64)

    return shape


_MIRRORED = np.ones((16, 1), np.float32)
_MIRRORED[[1, 4, 5, 9, 10, 11]] = -1  # the harmonics that are odd in y


def mirrored(part: Part, tint: ArrayLike) -> Part:
    """``part`` upside down, reflected at height 0, its colours multiplied by ``tint``."""
    sh = part.sh * _MIRRORED
    sh[:, 0] += 0.5 / 0.28209479177387814
    sh *= np.asarray(tint, np.float32)
    sh[:, 0] -= 0.5 / 0.28209479177387814
    flip = np.array([1, -1, 1], np.float32)
    turn = np.array([1, -1, 1, -1], np.float32)
    return Part(part.means * flip, part.quats * turn, part.scales, part.opacities, sh)
