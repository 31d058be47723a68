"""From a file's axes to tsplat's: Gaussians turned, mirrored, scaled and shifted, colours too.

A Gaussian whose covariance is R S S R^T becomes M R S S R^T M^T. Where M mirrors, -M turns and
makes the same covariance of it. Colours follow the direction from which they are seen: what was
seen from d is seen from M d then. The real spherical harmonics of one degree turn into each
other, by a matrix that is found by least squares from their values in enough directions.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsplat.core.constants import SH_DEGREE_MAX
from tsplat.core.types import F32, F64, Floats, Scene, Up

DIRECTIONS = 64
"""Where harmonics are compared; 16 would do if they were evenly spread."""

EXACT = 1e-12
"""Entries of the matrix this near to -1, 0 or 1 are that: rounding of the least squares."""

AXES = {
    "R": (1, 0, 0), "L": (-1, 0, 0), "D": (0, 1, 0), "U": (0, -1, 0), "F": (0, 0, 1),
    "B": (0, 0, -1),
}  # fmt: skip
"""Right, left, down, up, front, back in tsplat's world, which is COLMAP's and a PLY file's."""


def axes(letters: str) -> F64:
    """[3, 3] from axes named by where x, y and z point: ``RUB`` is right, up, back."""
    return np.array([AXES[letter] for letter in letters], np.float64).T


def _unit_directions() -> F64:
    """[DIRECTIONS, 3] spread evenly: a spiral of golden angles."""
    z = 1 - (2 * np.arange(DIRECTIONS) + 1) / DIRECTIONS
    angle = np.arange(DIRECTIONS) * math.pi * (3 - math.sqrt(5))
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], 1)


def _quaternion(matrix: F64) -> F64:
    """[4] w, x, y, z of a rotation matrix: the row of the sum that is largest, normalised."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    rows = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    row = rows[np.argmax(np.diagonal(rows))]
    return np.asarray(row / np.linalg.norm(row), np.float64)


def _like(values: F64, other: NDArray[Any]) -> Any:
    """``values`` in the type of ``other``."""
    return values.astype(other.dtype)


@lru_cache(maxsize=64)
def _harmonics(turn: tuple[float, ...]) -> F64:
    """[16, 16] what the 3 x 3 numbers of an orthogonal matrix do to coefficients."""
    from tsplat.core.reference import sh_basis

    seen, matrix = _unit_directions(), np.reshape(turn, (3, 3))
    basis = sh_basis(seen, SH_DEGREE_MAX)
    turned = np.linalg.lstsq(basis, sh_basis(seen @ matrix, SH_DEGREE_MAX), rcond=None)[0]
    nearest = np.round(turned)
    return np.where(np.abs(turned - nearest) < EXACT, nearest, turned)


class Turn:
    """p -> scale * matrix @ p + shift."""

    def __init__(self, matrix: ArrayLike, scale: float = 1.0, shift: ArrayLike = (0, 0, 0)) -> None:
        """``matrix`` [3, 3] is orthogonal, ``scale`` > 0, ``shift`` [3] in world units."""
        self.matrix = np.asarray(matrix, np.float64)
        self.scale = scale
        self.shift = np.asarray(shift, np.float64)
        diagonal = np.diagonal(self.matrix)
        self._flips = diagonal if np.array_equal(np.diag(diagonal), self.matrix) else None
        self._moves = bool(scale != 1 or self.shift.any())

    def means(self, means: Floats) -> Floats:
        """[n, 3]; float64 where it is shifted or scaled."""
        if self._flips is not None:
            turned: Floats = means * _like(self._flips, means)
        else:
            turned = means.astype(np.float64) @ self.matrix.T
        return turned.astype(np.float64) * self.scale + self.shift if self._moves else turned

    def quats(self, quats: Floats) -> Floats:
        """[n, 4] w, x, y, z of any length."""
        if self._flips is not None:  # M R M has the same covariance as M R
            x, y, z = self._flips
            return np.asarray(quats * _like(np.array([1, y * z, x * z, x * y]), quats))
        a, b, c, d = _quaternion(self.matrix * np.sign(np.linalg.det(self.matrix)))
        left = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
        return np.asarray(quats.astype(np.float64) @ left.T)

    def scales(self, scales: Floats) -> Floats:
        """[n, 3] linear."""
        return scales if self.scale == 1 else scales * self.scale

    @cached_property
    def signs(self) -> F32 | None:
        """[59] what it does to 3 numbers of a mean, 4 of a quaternion, 3 of scales, an opacity and
        48 of 16 coefficients, if it only flips some of them.
        """
        if self._flips is None or self._moves:
            return None
        ones = np.ones((1, 48), np.float32)
        flipped = self.means(ones[:, :3]), self.quats(ones[:, :4])
        sh = self.sh(ones.reshape(1, 16, 3).copy()).reshape(1, 48)
        row = np.concatenate([*flipped, ones[:, :4], sh], 1, dtype=np.float32)
        return np.asarray(row[0])

    @cached_property
    def _signs(self) -> NDArray[np.uint16]:
        """[48] the sign bits to flip of a Gaussian's coefficients, in float16."""
        return np.repeat(np.where(np.diagonal(self._harmonics) < 0, 0x8000, 0), 3).astype(np.uint16)

    @cached_property
    def _harmonics(self) -> F64:
        """[16, 16] turned coefficients from coefficients."""
        return _harmonics(tuple(self.matrix.reshape(-1).tolist()))

    def sh(self, sh: NDArray[Any]) -> NDArray[Any]:
        """[n, K, 3], C-contiguous; float16 only if signs are all it flips. May change ``sh``."""
        k = sh.shape[1]
        if k == 1:
            return sh
        if self._flips is None:
            return np.asarray(np.matmul(_like(self._harmonics[:k, :k], sh), sh))
        rows = sh.reshape(len(sh), 3 * k)  # whole rows: NumPy's loops over three numbers are slow
        if sh.dtype == np.float16:
            bits = rows.view(np.uint16)
            bits ^= self._signs[: 3 * k]
        else:
            rows *= np.repeat(_like(np.diagonal(self._harmonics)[:k], sh), 3)
        return sh


def half_turned(scene: Scene) -> Scene:
    """``scene`` turned over: what stood on its head stands up, and no mirror.

    By 180 degrees about an axis across its up, x where that is across; so what is said to be up is.
    """
    up = scene.up
    direction = np.array((0.0, -1.0, 0.0) if up is None else up.direction)
    direction /= np.linalg.norm(direction)
    start = np.eye(3)[2 if abs(direction[0]) > 0.9 else 0]
    axis = start - (start @ direction) * direction
    axis /= np.linalg.norm(axis)
    turn = Turn(np.round(2 * np.outer(axis, axis) - np.eye(3), 15))
    sh = scene.sh.copy() if turn.signs is not None else scene.sh.astype(np.float32)
    if up is not None:
        up = Up(up.direction, f"{up.why}; turned over")
    return replace(
        scene, means=np.asarray(turn.means(scene.means), np.float32),
        quats=np.asarray(turn.quats(scene.quats), np.float32, order="C"),
        sh=np.ascontiguousarray(turn.sh(sh)), origin=turn.matrix @ scene.origin, up=up,
    )  # fmt: skip
