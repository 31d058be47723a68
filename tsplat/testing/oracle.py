"""The contract's picture by another way: slow, plain, and in twice float64's precision.

What :mod:`tsplat.core.reference` does with care, this does with digits: textbook formulas, which
cancel, on numbers that can afford it (:mod:`tsplat.testing.wide`). It shares no arithmetic with
the reference and the backends, apart from what docs/contract.md defines to the bit: camera z, and
with it order and ties.

=====================  =====================================  ==================================
what                   reference, backends                    here
=====================  =====================================  ==================================
camera coordinates     R (mean - centre), float64             R (mean + origin) + t, wide
covariance             A A^T of A = J R Rq S                  J R (Rq S S Rq^T) R^T J^T, wide
determinant            a sum of positive terms                a c - b^2, wide
exponent               squares of the Cholesky factor's rows  the conic's quadratic form, wide
spherical harmonics    polynomials of forward.cu              Legendre's functions, powers of x+iy
compositing            blocks, running products               one splat after the other, float64
=====================  =====================================  ==================================

It is good for middles up to 1e8 px from the picture; farther out the quadratic form runs out of
digits too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tsplat.core.camera import Camera
from tsplat.core.constants import (
    ALPHA_FLOOR,
    ALPHA_MAX,
    CLAMP_MARGIN,
    EPS2D,
    OFFSCREEN_MAX,
    VARIANCE_MAX,
)
from tsplat.core.params import RenderParams
from tsplat.core.types import F32, F64, I64, Frame, Scene
from tsplat.testing.wide import Wide

Matrix = list[list[Wide]]

BATCH = 32
"""Splats whose alphas are worked out at a time."""

NEARLY = 0.999
"""Of the alpha threshold: fainter Gaussians cannot be drawn, nor come near being drawn."""


class Oracle(NamedTuple):
    """A picture, and what must be known to compare with it."""

    frame: Frame  # float64
    margins: F64  # [H, W]  how near a pixel came to a threshold, relative; see compare_frames
    overflowed: int  # Gaussians too large or near for float32


class _Drawn(NamedTuple):
    """Splats near to far."""

    mean: tuple[Wide, Wide]
    cov: tuple[Wide, Wide, Wide]  # a, b, c: [[a, b], [b, c]], px^2
    det: Wide
    opacity: F64
    color: F64  # [M, 3]
    depth: F32


def _product(a: Matrix, b: Matrix) -> Matrix:
    columns = list(zip(*b, strict=True))
    return [[_sum(x * y for x, y in zip(row, c, strict=True)) for c in columns] for row in a]


def _sum(terms: object) -> Wide:
    total = Wide.of(0.0)
    for term in terms:  # type: ignore[attr-defined]
        total = total + term
    return total


def _transposed(a: Matrix) -> Matrix:
    return [list(column) for column in zip(*a, strict=True)]


def contract_depth(scene: Scene, camera: Camera) -> F64:
    """Camera z [N] as rule 1 of the contract says, to the bit."""
    d = scene.means.astype(np.float64) - (camera.centre - scene.origin)
    r20, r21, r22 = camera.rotation[2]
    return np.asarray((r20 * d[:, 0] + r21 * d[:, 1]) + r22 * d[:, 2])


def _covariance(quats: F32, scales: F32) -> Matrix:
    """Rq S S Rq^T; quaternions as they are, for float32 ones are never quite of unit length."""
    w, x, y, z = (Wide.of(q) for q in quats.T)
    turn = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    squares = [Wide.of(s) * Wide.of(s) for s in scales.T]
    stretched = [[t * s for t, s in zip(row, squares, strict=True)] for row in turn]
    return _product(stretched, _transposed(turn))


def harmonics(direction: F64, degree: int) -> F64:
    """Real spherical harmonics [N, (degree + 1)^2] with Condon and Shortley's sign, by definition.

    Y_l^m = sqrt(2) K P_l^m(z) Re (x + iy)^m, and Im for -m, where P_l^m is the m-th derivative of
    Legendre's polynomial, and K^2 = (2 l + 1) / (4 pi) (l - m)! / (l + m)!.
    """
    x, y, z = direction.T
    columns = []
    for band in range(degree + 1):
        legendre = np.polynomial.Legendre.basis(band).convert(kind=np.polynomial.Polynomial)
        for order in range(-band, band + 1):
            m = abs(order)
            norm = (2 * band + 1) * math.factorial(band - m) / math.factorial(band + m)
            size = math.sqrt(norm / (4 * math.pi) * (2 if m else 1)) * (-1) ** m
            wave = (x + 1j * y) ** m
            columns.append(size * legendre.deriv(m)(z) * (wave.imag if order < 0 else wave.real))
    return np.stack(columns, 1)


def _colors(scene: Scene, camera: Camera, rows: I64, degree: int) -> F64:
    d = scene.means[rows].astype(np.float64) - (camera.centre - scene.origin)
    d /= abs(d).max(axis=1, keepdims=True)  # squares of 1e-200 would be 0
    basis = harmonics(d / np.linalg.norm(d, axis=1, keepdims=True), degree)
    used = scene.sh[rows, : basis.shape[1]].astype(np.float64)
    return np.asarray(np.maximum(0.5 + (basis[:, :, None] * used).sum(1), 0))


def _project(scene: Scene, camera: Camera, params: RenderParams) -> tuple[_Drawn, int]:
    threshold = max(params.alpha_threshold, ALPHA_FLOOR)
    depth = contract_depth(scene, camera)
    seen = (depth > camera.near) & (depth < camera.far) & (scene.opacities >= NEARLY * threshold)
    rows = np.flatnonzero(seen)
    numbers = np.arange(len(scene)) if scene.numbers is None else scene.numbers
    compared = depth[rows].astype(np.float32)
    if params.depth_split != 1:  # to the bit as docs/contract.md has it
        wide = compared * np.float32(params.depth_split)
        compared = wide - (wide - compared)
    order = np.lexsort((numbers[rows], compared))
    rows, compared = rows[order], compared[order]

    world = [Wide.of(m) + o for m, o in zip(scene.means[rows].T, scene.origin, strict=True)]
    view = [[Wide.of(number) for number in row] for row in camera.viewmat]
    x, y, z = (_sum(r * w for r, w in zip(row, world, strict=False)) + row[3] for row in view[:3])
    k, size = camera.K, (camera.width, camera.height)
    slopes = x / z, y / z
    mean = Wide.of(k[0, 0]) * slopes[0] + k[0, 2], Wide.of(k[1, 1]) * slopes[1] + k[1, 2]
    jacobian: Matrix = []
    for axis, slope in enumerate(slopes):
        focal, centre = Wide.of(k[axis, axis]), k[axis, 2]
        margin = CLAMP_MARGIN * size[axis] / 2
        low, high = (-centre - margin) / focal, (size[axis] - centre + margin) / focal
        held = _held(slope, low, high)
        row = [Wide.of(0.0)] * 3
        row[axis], row[2] = focal / z, -(focal * held) / z
        jacobian.append(row)
    to_pixels = _product(jacobian, [row[:3] for row in view[:3]])
    sharp = _product(
        _product(to_pixels, _covariance(scene.quats[rows], scene.scales[rows])),
        _transposed(to_pixels),
    )
    (a, b), c = sharp[0], sharp[1][1]
    wide_a, wide_c = a + EPS2D, c + EPS2D
    det = wide_a * wide_c - b * b
    opacity = scene.opacities[rows].astype(np.float64)
    fits = (
        ((a + c).float64() <= VARIANCE_MAX)
        & (abs(mean[0].float64()) <= OFFSCREEN_MAX)
        & (abs(mean[1].float64()) <= OFFSCREEN_MAX)
    )
    overflowed = int((~fits & (opacity >= threshold)).sum())
    if params.antialias:
        sharpness = ((a * c - b * b) / det).float64()
        opacity = opacity * np.sqrt(np.maximum(sharpness, 0))
    keep = np.flatnonzero(fits)
    degree = min(params.sh_degree, scene.sh_degree)
    drawn = _Drawn(
        (mean[0][keep], mean[1][keep]), (wide_a[keep], b[keep], wide_c[keep]), det[keep],
        opacity[keep], _colors(scene, camera, rows[keep], degree),
        compared[keep],
    )  # fmt: skip
    return drawn, overflowed


def _held(slope: Wide, low: Wide, high: Wide) -> Wide:
    """``slope`` within low..high."""
    below, above = (slope - low).float64() < 0, (slope - high).float64() > 0
    return Wide(
        np.where(below, low.high, np.where(above, high.high, slope.high)),
        np.where(below, low.low, np.where(above, high.low, slope.low)),
    )


def _alphas(drawn: _Drawn, rows: slice, width: int, height: int) -> F64:
    """Alpha [rows, H, W], opacity exp(-d^T covar2d^-1 d / 2), not yet capped."""
    pixel = slice(rows.start, rows.stop), None, None
    dx = (np.arange(width) + 0.5)[None, None, :] - drawn.mean[0][pixel]
    dy = (np.arange(height) + 0.5)[None, :, None] - drawn.mean[1][pixel]
    a, b, c = (part[pixel] for part in drawn.cov)
    form = (c * (dx * dx) - 2 * (b * (dx * dy)) + a * (dy * dy)) / drawn.det[pixel]
    return np.asarray(drawn.opacity[pixel] * np.exp(-form.float64() / 2))


def draw(scene: Scene, camera: Camera, params: RenderParams) -> Oracle:
    """The contract's picture of ``scene``. ``params.float64`` makes no difference."""
    with np.errstate(all="ignore"):  # what overflows here is dropped by the contract as well
        drawn, overflowed = _project(scene, camera, params)
        frame, margins = _composite(drawn, camera.width, camera.height, params)
    return Oracle(frame, margins, overflowed)


def _composite(
    drawn: _Drawn, width: int, height: int, params: RenderParams
) -> tuple[Frame, NDArray[np.float64]]:
    rgb, depth = np.zeros((height, width, 3)), np.zeros((height, width))
    t, margins = np.ones((height, width)), np.full((height, width), np.inf)
    open_ = np.ones((height, width), np.bool_)
    stop = params.transmittance_min
    least = max(params.alpha_threshold, ALPHA_FLOOR)
    for start in range(0, len(drawn.opacity), BATCH):
        rows = slice(start, min(start + BATCH, len(drawn.opacity)))
        for k, alphas in enumerate(_alphas(drawn, rows, width, height), start):
            alpha = np.minimum(alphas, ALPHA_MAX)
            np.minimum(margins, abs(alpha / least - 1), out=margins, where=open_)
            reached = open_ & (alpha >= least)
            after = t * (1 - alpha)
            if stop > 0:
                np.minimum(margins, abs(after / stop - 1), out=margins, where=reached)
            stops = reached & (after <= stop)
            reached &= ~stops
            weight = np.where(reached, t * alpha, 0)
            rgb += weight[..., None] * drawn.color[k]
            depth += weight * np.float64(drawn.depth[k])
            t = np.where(reached, after, t)
            open_ &= ~stops
        if not open_.any():
            break
    return Frame(rgb, t, depth if params.depth else None), margins
