"""The demo's light: a low sun, a rising moon, lanterns; and gloss as spherical harmonics.

A colour that depends only on the angle between the view and some axis is a *zonal* function. Its
Legendre series, times the harmonics at the axis, is the function's projection onto them (the
addition theorem), so highlights of any direction cost one product per coefficient.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial.legendre import legfit, leggauss, legvander
from numpy.typing import ArrayLike

from tsplat.core.constants import SH_C0
from tsplat.core.reference import sh_basis
from tsplat.core.types import F32, F64
from tsplat.demo.parts import UP, smooth, unit

SUN = unit([-0.86, -0.42, -0.30])
SUN_COLOUR = np.array([1.18, 0.66, 0.36])
MOON = unit([0.80, -0.50, 0.62])
MOON_COLOUR = np.array([0.26, 0.38, 0.72])
SKY = np.array([0.33, 0.29, 0.50])
BELOW = np.array([0.10, 0.10, 0.23])
LANTERN_COLOUR = np.array([1.0, 0.52, 0.16])
CRYSTAL_COLOUR = np.array([0.10, 0.75, 0.95])

_DEGREE = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3])
_ROUND = 4 * np.pi / (2 * _DEGREE + 1)
_COSINE, _WEIGHT = leggauss(32)
_SERIES = (legvander(_COSINE, 3) * _WEIGHT[:, None]).T * (np.arange(4)[:, None] + 0.5)


def flat(rgb: ArrayLike) -> F32:
    """Harmonics [N, 16, 3] of colours that look the same from everywhere."""
    rgb = np.atleast_2d(np.asarray(rgb, np.float32))
    sh = np.zeros((len(rgb), 16, 3), np.float32)
    sh[:, 0] = (rgb - np.float32(0.5)) / np.float32(SH_C0)
    return sh


def zonal(axes: F64, colour: Callable[[F64], F64], amount: ArrayLike = 1.0) -> F32:
    """Harmonics [N, 16, 3] of ``colour`` (of the cosine between view and axis; [M] to [M, 3]).

    The view points from the eye to the Gaussian.
    """
    series = _SERIES @ colour(_COSINE)
    weights = (series[_DEGREE] * _ROUND[:, None]).astype(np.float32)
    basis = sh_basis(np.atleast_2d(axes), 3) * np.atleast_1d(amount)[:, None]
    return np.asarray(basis.astype(np.float32)[:, :, None] * weights, np.float32)


def lobe(axes: F64, colour: ArrayLike, sharpness: float, amount: ArrayLike = 1.0) -> F32:
    """Harmonics of a soft spot of light, seen by those who look along ``axes``."""
    return zonal(
        axes,
        lambda c: np.exp(sharpness * (c - 1))[:, None] * np.asarray(colour, np.float64),
        amount,
    )


def glint(normals: F64, light: F64, colour: ArrayLike, sharpness: float) -> F32:
    """Harmonics of ``light`` mirrored at surfaces with ``normals``."""
    facing = normals @ light
    return lobe(light - 2 * facing[:, None] * normals, colour, sharpness, smooth(-0.1, 0.3, facing))


def opal(normals: F64, shift: F64) -> F32:
    """Harmonics of a thin film's colours, which run through the rainbow towards the rim.

    Fitted where the surface faces the eye; its back is never seen.
    """
    cosine = np.linspace(0, 1, 48)
    total = np.zeros((len(normals), 16, 3), np.float32)
    basis = sh_basis(-normals, 3)
    for part in (np.cos, np.sin):
        wave = 2 * np.pi * (1.25 * cosine[:, None] + np.array([0.0, 0.30, 0.62]))
        series = legfit(cosine, part(wave), 3)
        weighted = basis * (part(shift) if part is np.cos else -np.sin(shift))[:, None]
        total += (weighted[:, :, None] * (series[_DEGREE] * _ROUND[:, None])).astype(np.float32)
    return total


class Lights:
    """What shines on the garden: the sky's lights, and small ones that stand in it."""

    def __init__(self, lanterns: F64, crystals: F64, crown: F64, crown_radii: F64) -> None:
        self.lanterns = lanterns
        self.crystals = crystals
        self._crown = crown
        self._radii = crown_radii

    def shade(
        self, points: F64, normals: F64, albedo: ArrayLike, open_: ArrayLike = 1.0,
        wrap: float = 0.15, shadow: float = 0.0,
    ) -> F64:  # fmt: skip
        """Colours [N, 3] of a dull surface.

        Args:
            points: [N, 3].
            normals: [N, 3].
            albedo: [N, 3] its own colour.
            open_: [N] share of the sky that it sees.
            wrap: how far light creeps round to its back; 1 for leaves.
            shadow: how much of the sun the tree's crown takes away.
        """
        sun = np.clip((normals @ SUN + wrap) / (1 + wrap), 0, 1)
        moon = np.clip((normals @ MOON + wrap) / (1 + wrap), 0, 1)
        if shadow:
            sun = sun * (1 - shadow * self._shadow(points))
        sky = 0.5 + 0.5 * (normals @ UP)
        share = np.broadcast_to(np.asarray(open_, np.float64), len(points))[:, None]
        light = share * (BELOW + sky[:, None] * (SKY - BELOW))
        light += (0.3 + 0.7 * share) * (sun[:, None] * SUN_COLOUR + moon[:, None] * MOON_COLOUR)
        light += self._near(points, normals, self.lanterns, 0.30, wrap)[:, None] * LANTERN_COLOUR
        light += self._near(points, normals, self.crystals, 0.34, 0.3)[:, None] * CRYSTAL_COLOUR
        return np.asarray(light * albedo, np.float64)

    def _near(self, points: F64, normals: F64, lamps: F64, reach: float, wrap: float) -> F64:
        """Light of lamps that fades with distance and ends at 4.5 times ``reach``."""
        end = 4.5 * reach
        touching = (lamps > points.min(0) - end) & (lamps < points.max(0) + end)
        x, y, z = np.ascontiguousarray(points.T, np.float32)
        a, b, c = np.ascontiguousarray(normals.T, np.float32)
        total = np.zeros(len(points), np.float32)
        for i, j, k in lamps[touching.all(1)].tolist():
            near = np.flatnonzero((np.abs(x - i) < end) & (np.abs(z - k) < end))
            dx, dy, dz = i - x[near], j - y[near], k - z[near]
            square = dx * dx + dy * dy + dz * dz
            cosine = (dx * a[near] + dy * b[near] + dz * c[near]) / np.sqrt(square + 1e-9)
            lit = np.clip((cosine + wrap) / (1 + wrap), 0, 1)
            far = square / reach**2
            total[near] += lit * np.maximum(1 - far / 4.5**2, 0) / ((1 + far) * np.sqrt(1 + far))
        return 1.5 * total.astype(np.float64)

    def _shadow(self, points: F64) -> F64:
        """How deep in the shadow of the crown: an ellipsoid, made round to meet the sun's rays."""
        away = (self._crown - points) / self._radii
        ray = unit(SUN / self._radii)
        ahead = away @ ray
        off = np.sqrt(np.maximum(np.einsum("ni,ni->n", away, away) - ahead * ahead, 0))
        return (1 - smooth(0.55, 1.1, off)) * smooth(0.0, 0.5, ahead)
