"""Projection: Gaussians to splats, eight at a time.

Geometry is float64: a needle's tilt must be right to the last bit of the float32 it ends in.
Roots and quotients are float32, taken of sums that hold no cancellation.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tsplat.backends.numba_kernels.jit import kernel
from tsplat.backends.numba_kernels.simd import (
    bits,
    column,
    convert,
    fma,
    item,
    load,
    log2,
    popcount,
    put,
    store,
)
from tsplat.core.constants import (
    OFFSCREEN_MAX,
    RADIUS_PAD,
    RADIUS_SLACK,
    SH_C0,
    SH_C1,
    SH_C2,
    SH_C3,
    VARIANCE_MAX,
)
from tsplat.core.types import F32, F64, I32

LANES = 8  # Gaussians projected at a time

# Entries of the camera's numbers.
CENTRE, FX, FY, CX, CY, NEAR, FAR, LEFT, RIGHT, TOP, BOTTOM, WIDTH, HEIGHT, SPLIT, LOW_PASS = (
    9, *range(12, 26)
)  # fmt: skip
VIEW = 26

# What a group of Gaussians leaves for its splats: vectors of each, float64 and float32.
MEAN_X, MEAN_Y = 0, LANES
U11, U12, U22, Z, OPACITY, RADIUS_X, RADIUS_Y = (LANES * i for i in range(7))
BASIS = LANES * 7  # 16 vectors of spherical harmonics
SPACE = LANES * 23

# Typed, because numba computes float32 with a bare Python number in float64.
ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
SLACK, MARGIN = np.float32(1 + RADIUS_SLACK), np.float32(RADIUS_PAD)
C0, C1 = np.float32(SH_C0), np.float32(SH_C1)
C20, C21, C22, C23, C24 = (np.float32(c) for c in SH_C2)
C30, C31, C32, C33, C34, C35, C36 = (np.float32(c) for c in SH_C3)
TWO, THREE, FOUR = np.float32(2), np.float32(3), np.float32(4)
TWO_LN_2 = np.float32(2 * np.log(2))


@kernel
def _store_basis(degree: int, x: Any, y: Any, z: Any, space: F32) -> None:
    """Real spherical harmonics along unit directions x, y, z; see reference.sh_basis."""
    store(space, BASIS + LANES, y * -C1)
    store(space, BASIS + 2 * LANES, z * C1)
    store(space, BASIS + 3 * LANES, x * -C1)
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        store(space, BASIS + 4 * LANES, x * y * C20)
        store(space, BASIS + 5 * LANES, y * z * C21)
        store(space, BASIS + 6 * LANES, (zz * TWO - xx - yy) * C22)
        store(space, BASIS + 7 * LANES, x * z * C23)
        store(space, BASIS + 8 * LANES, (xx - yy) * C24)
        if degree >= 3:
            store(space, BASIS + 9 * LANES, y * C30 * (xx * THREE - yy))
            store(space, BASIS + 10 * LANES, x * y * z * C31)
            store(space, BASIS + 11 * LANES, y * C32 * (zz * FOUR - xx - yy))
            store(space, BASIS + 12 * LANES, z * C33 * (zz * TWO - xx * THREE - yy * THREE))
            store(space, BASIS + 13 * LANES, x * C34 * (zz * FOUR - xx - yy))
            store(space, BASIS + 14 * LANES, z * C35 * (xx - yy))
            store(space, BASIS + 15 * LANES, x * C36 * (xx - yy * THREE))


@kernel
def _project_group(
    row: int, means: F32, quats: F32, scales: F32, opacities: F32, view_: F64, degree: int,
    antialias: bool, threshold: float, space: F32, space64: F64,
) -> tuple[int, int]:  # fmt: skip
    """Projects LANES Gaussians from ``row`` on into space and space64; returns two masks: which
    are visible, and which overflow.
    """
    r00, r01, r02, r10, r11, r12 = view_[0], view_[1], view_[2], view_[3], view_[4], view_[5]
    r20, r21, r22 = view_[6], view_[7], view_[8]
    dx = convert(column(means, row, 0, 3, LANES), np.float64) - view_[CENTRE]
    dy = convert(column(means, row, 1, 3, LANES), np.float64) - view_[CENTRE + 1]
    dz = convert(column(means, row, 2, 3, LANES), np.float64) - view_[CENTRE + 2]
    # In this order and without fused operations: see core.stages.Project.
    depth = (dx * r20 + dy * r21) + dz * r22
    opacity = load(opacities, row, LANES)
    ahead = (depth > view_[NEAR]) & (depth < view_[FAR])
    ahead = ahead & (convert(opacity, np.float64) >= threshold)
    if not bits(ahead):
        return 0, 0
    inverse = 1.0 / depth
    slope_x = ((dx * r00 + dy * r01) + dz * r02) * inverse
    slope_y = ((dx * r10 + dy * r11) + dz * r12) * inverse
    mean_x = fma(slope_x, view_[FX], view_[CX])
    mean_y = fma(slope_y, view_[FY], view_[CY])
    # The Jacobian's slopes are held near the picture; see reference._project_rows.
    u = max(min(slope_x, view_[RIGHT]), view_[LEFT])
    v = max(min(slope_y, view_[BOTTOM]), view_[TOP])
    scale_x, scale_y = inverse * view_[FX], inverse * view_[FY]

    # Rows of J R: what one unit along each world axis is on the image plane.
    j00, j01, j02 = fma(-u, r20, r00), fma(-u, r21, r01), fma(-u, r22, r02)
    j10, j11, j12 = fma(-v, r20, r10), fma(-v, r21, r11), fma(-v, r22, r12)
    qw = convert(column(quats, row, 0, 4, LANES), np.float64)
    qx = convert(column(quats, row, 1, 4, LANES), np.float64)
    qy = convert(column(quats, row, 2, 4, LANES), np.float64)
    qz = convert(column(quats, row, 3, 4, LANES), np.float64)
    x2, y2, z2 = qx + qx, qy + qy, qz + qz
    wx, wy, wz = qw * x2, qw * y2, qw * z2
    t00, t01, t02 = 1.0 - fma(qy, y2, qz * z2), fma(qx, y2, -wz), fma(qx, z2, wy)
    t10, t11, t12 = fma(qx, y2, wz), 1.0 - fma(qx, x2, qz * z2), fma(qy, z2, -wx)
    t20, t21, t22 = fma(qx, z2, -wy), fma(qy, z2, wx), 1.0 - fma(qx, x2, qy * y2)
    s0 = convert(column(scales, row, 0, 3, LANES), np.float64)
    s1 = convert(column(scales, row, 1, 3, LANES), np.float64)
    s2 = convert(column(scales, row, 2, 3, LANES), np.float64)
    a10 = fma(j00, t00, fma(j01, t10, j02 * t20)) * s0 * scale_x
    a11 = fma(j00, t01, fma(j01, t11, j02 * t21)) * s1 * scale_x
    a12 = fma(j00, t02, fma(j01, t12, j02 * t22)) * s2 * scale_x
    a20 = fma(j10, t00, fma(j11, t10, j12 * t20)) * s0 * scale_y
    a21 = fma(j10, t01, fma(j11, t11, j12 * t21)) * s1 * scale_y
    a22 = fma(j10, t02, fma(j11, t12, j12 * t22)) * s2 * scale_y

    xx = fma(a10, a10, fma(a11, a11, a12 * a12))
    yy = fma(a20, a20, fma(a21, a21, a22 * a22))
    xy = fma(a10, a20, fma(a11, a21, a12 * a22))
    fits = (xx + yy <= VARIANCE_MAX) & (abs(mean_x) <= OFFSCREEN_MAX)
    fits = fits & (abs(mean_y) <= OFFSCREEN_MAX)
    seen = bits(ahead & fits)
    overflowed = bits(ahead) & ~seen
    d0, d1 = fma(a11, a22, -(a12 * a21)), fma(a12, a20, -(a10 * a22))
    d2 = fma(a10, a21, -(a11 * a20))
    det_sharp = fma(d0, d0, fma(d1, d1, d2 * d2))
    eps = view_[LOW_PASS]
    var_x, var_y = xx + eps, yy + eps
    det = det_sharp + fma(xx + yy, eps, (xx - xx) + eps * eps)

    width_x, width_y = math.sqrt(convert(var_x, np.float32)), math.sqrt(convert(var_y, np.float32))
    root = math.sqrt(convert(det, np.float32))
    if antialias:
        opacity = opacity * (math.sqrt(convert(det_sharp, np.float32)) / root)
    least = np.float32(threshold)
    # alpha reaches the threshold where sigma <= ln(opacity / threshold).
    reach = math.sqrt(log2(max(opacity / least, ONE)) * TWO_LN_2)
    radius_x = fma(reach * width_x, SLACK, MARGIN)
    radius_y = fma(reach * width_y, SLACK, MARGIN)
    x, y = convert(mean_x, np.float32), convert(mean_y, np.float32)
    touches = (x + radius_x >= HALF) & (x - radius_x <= np.float32(view_[WIDTH] - 0.5))
    touches = touches & (y + radius_y >= HALF)
    touches = touches & (y - radius_y <= np.float32(view_[HEIGHT] - 0.5)) & (opacity >= least)
    seen &= bits(touches)

    # u11 and u12 share one factor, so that their quotient, the tilt, is rounded only at the end.
    share = convert(ONE / (width_y * root), np.float64)
    store(space64, MEAN_X, mean_x)
    store(space64, MEAN_Y, mean_y)
    store(space, U11, convert(var_y * share, np.float32))
    store(space, U12, convert(-xy * share, np.float32))
    store(space, U22, ONE / width_y)
    z = convert(depth, np.float32)
    wide = z * np.float32(view_[SPLIT])
    store(space, Z, wide - (wide - z))
    store(space, OPACITY, opacity)
    store(space, RADIUS_X, radius_x)
    store(space, RADIUS_Y, radius_y)
    if degree > 0:
        inverse = 1.0 / math.sqrt(fma(dx, dx, fma(dy, dy, dz * dz)))
        _store_basis(
            degree, convert(dx * inverse, np.float32), convert(dy * inverse, np.float32),
            convert(dz * inverse, np.float32), space,
        )  # fmt: skip
    return seen, overflowed


@kernel
def project_rows(
    first: int, last: int, to: int, means: F32, quats: F32, scales: F32, opacities: F32, sh: F32,
    view_: F64, degree: int, antialias: bool, threshold: float, space: F32, space64: F64,
    means2d: F64, factors: F32, depths: F32, opacities2d: F32, colors: F32, radii: F32,
    gaussian_ids: I32,
) -> tuple[int, int]:  # fmt: skip
    """Projects Gaussians ``first`` to ``last`` to rows of the splats from ``to`` on; returns
    how many are visible, and how many overflowed.

    The scene has at least LANES rows. space [SPACE] and space64 [2 LANES] are lent.
    """
    terms = (degree + 1) * (degree + 1)
    overflowed = 0
    k = to
    for start in range(first, last, LANES):
        row = min(start, len(means) - LANES)  # the last group overlaps the one before it
        fresh = (1 << min(last - row, LANES)) - (1 << (start - row))
        seen, over = _project_group(
            row, means, quats, scales, opacities, view_, degree, antialias, threshold, space,
            space64,
        )  # fmt: skip
        overflowed += popcount(over & fresh)
        seen &= fresh
        for lane in range(LANES):
            if not seen >> lane & 1:
                continue
            i = row + lane
            put(means2d, 2 * k, item(space64, MEAN_X + lane))
            put(means2d, 2 * k + 1, item(space64, MEAN_Y + lane))
            put(factors, 3 * k, item(space, U11 + lane))
            put(factors, 3 * k + 1, item(space, U12 + lane))
            put(factors, 3 * k + 2, item(space, U22 + lane))
            put(depths, k, item(space, Z + lane))
            put(opacities2d, k, item(space, OPACITY + lane))
            put(radii, 2 * k, item(space, RADIUS_X + lane))
            put(radii, 2 * k + 1, item(space, RADIUS_Y + lane))
            put(gaussian_ids, k, np.int32(i))
            at = i * sh.shape[1] * 3
            red, green = HALF + C0 * item(sh, at), HALF + C0 * item(sh, at + 1)
            blue = HALF + C0 * item(sh, at + 2)
            for term in range(1, terms):
                basis = item(space, BASIS + term * LANES + lane)
                red += basis * item(sh, at + 3 * term)
                green += basis * item(sh, at + 3 * term + 1)
                blue += basis * item(sh, at + 3 * term + 2)
            put(colors, 3 * k, max(red, ZERO))
            put(colors, 3 * k + 1, max(green, ZERO))
            put(colors, 3 * k + 2, max(blue, ZERO))
            k += 1
    return k - to, overflowed
