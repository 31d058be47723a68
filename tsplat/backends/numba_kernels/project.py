"""Projection: Gaussians to splats, in float64, rounded once at the end."""

from __future__ import annotations

import math

import numpy as np

from tsplat.backends.numba_kernels.jit import kernel
from tsplat.core.constants import (
    EPS2D,
    OFFSCREEN_MAX,
    RADIUS_PAD,
    RADIUS_SLACK,
    SH_C0,
    SH_C1,
    SH_C2,
    SH_C3,
    VARIANCE_MAX,
)
from tsplat.core.types import F32, F64, I32, I64

RECORD = 16  # floats of scratch per Gaussian
CHUNK = 2048  # Gaussians that are projected in one go; splats of a chunk stay together

# Entries of the camera's numbers.
CENTRE, FX, FY, CX, CY, NEAR, FAR, LEFT, RIGHT, TOP, BOTTOM, WIDTH, HEIGHT = 9, *range(12, 24)
VIEW = 24


@kernel
def _basis(degree: int, x: float, y: float, z: float, basis: F64) -> None:
    """Real spherical harmonics along the unit direction x, y, z; see reference.sh_basis."""
    basis[0] = SH_C0
    if degree >= 1:
        basis[1] = -SH_C1 * y
        basis[2] = SH_C1 * z
        basis[3] = -SH_C1 * x
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        basis[4] = SH_C2[0] * (x * y)
        basis[5] = SH_C2[1] * (y * z)
        basis[6] = SH_C2[2] * (2 * zz - xx - yy)
        basis[7] = SH_C2[3] * (x * z)
        basis[8] = SH_C2[4] * (xx - yy)
        if degree >= 3:
            basis[9] = SH_C3[0] * y * (3 * xx - yy)
            basis[10] = SH_C3[1] * (x * y) * z
            basis[11] = SH_C3[2] * y * (4 * zz - xx - yy)
            basis[12] = SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy)
            basis[13] = SH_C3[4] * x * (4 * zz - xx - yy)
            basis[14] = SH_C3[5] * z * (xx - yy)
            basis[15] = SH_C3[6] * x * (xx - 3 * yy)


@kernel
def project_chunks(
    first: int, last: int, means: F32, quats: F32, scales: F32, opacities: F32, sh: F32,
    view: F64, degree: int, antialias: bool, threshold: float, scratch: F32, scratch_ids: I32,
    counts: I32,
) -> int:  # fmt: skip
    """Projects chunks ``first`` to ``last``; returns how many Gaussians overflowed.

    view [VIEW]; scratch and scratch_ids [N, RECORD] are the same memory; a chunk's splats stand
    at its beginning, and counts [chunks] says how many there are.
    """
    n = len(means)
    r00, r01, r02, r10, r11, r12 = view[0], view[1], view[2], view[3], view[4], view[5]
    r20, r21, r22 = view[6], view[7], view[8]
    c0, c1, c2 = view[CENTRE], view[CENTRE + 1], view[CENTRE + 2]
    fx, fy, cx, cy, near, far = view[FX], view[FY], view[CX], view[CY], view[NEAR], view[FAR]
    left, right, top, bottom = view[LEFT], view[RIGHT], view[TOP], view[BOTTOM]
    width, height = view[WIDTH], view[HEIGHT]
    terms = (degree + 1) * (degree + 1)
    basis = np.empty(16, np.float64)
    basis[0] = SH_C0
    overflowed = 0
    for chunk in range(first, last):
        k = chunk * CHUNK
        for i in range(chunk * CHUNK, min(n, (chunk + 1) * CHUNK)):
            dx = np.float64(means[i, 0]) - c0
            dy = np.float64(means[i, 1]) - c1
            dz = np.float64(means[i, 2]) - c2
            # In this order and without fused operations: see core.stages.Project.
            z = (r20 * dx + r21 * dy) + r22 * dz
            opacity = np.float64(opacities[i])
            if not (z > near and z < far and opacity >= threshold):
                continue
            x = (r00 * dx + r01 * dy) + r02 * dz
            y = (r10 * dx + r11 * dy) + r12 * dz
            inverse = 1 / z
            slope_x, slope_y = x / z, y / z
            mean_x, mean_y = fx * slope_x + cx, fy * slope_y + cy
            # The Jacobian's slopes are held near the picture; see reference._project_rows.
            u, v = max(left, min(slope_x, right)), max(top, min(slope_y, bottom))
            scale_x, scale_y = fx * inverse, fy * inverse

            # Rows of J R: what one unit along each world axis is on the image plane.
            j00, j01, j02 = (
                scale_x * (r00 - u * r20),
                scale_x * (r01 - u * r21),
                scale_x * (r02 - u * r22),
            )
            j10, j11, j12 = (
                scale_y * (r10 - v * r20),
                scale_y * (r11 - v * r21),
                scale_y * (r12 - v * r22),
            )
            qw, qx = np.float64(quats[i, 0]), np.float64(quats[i, 1])
            qy, qz = np.float64(quats[i, 2]), np.float64(quats[i, 3])
            s0, s1 = np.float64(scales[i, 0]), np.float64(scales[i, 1])
            s2 = np.float64(scales[i, 2])
            t00, t01, t02 = (
                1 - 2 * (qy * qy + qz * qz),
                2 * (qx * qy - qw * qz),
                2 * (qx * qz + qw * qy),
            )
            t10, t11, t12 = (
                2 * (qx * qy + qw * qz),
                1 - 2 * (qx * qx + qz * qz),
                2 * (qy * qz - qw * qx),
            )
            t20, t21, t22 = (
                2 * (qx * qz - qw * qy),
                2 * (qy * qz + qw * qx),
                1 - 2 * (qx * qx + qy * qy),
            )
            a10 = s0 * (j00 * t00 + j01 * t10 + j02 * t20)
            a11 = s1 * (j00 * t01 + j01 * t11 + j02 * t21)
            a12 = s2 * (j00 * t02 + j01 * t12 + j02 * t22)
            a20 = s0 * (j10 * t00 + j11 * t10 + j12 * t20)
            a21 = s1 * (j10 * t01 + j11 * t11 + j12 * t21)
            a22 = s2 * (j10 * t02 + j11 * t12 + j12 * t22)

            xx = a10 * a10 + a11 * a11 + a12 * a12
            yy = a20 * a20 + a21 * a21 + a22 * a22
            xy = a10 * a20 + a11 * a21 + a12 * a22
            if not (
                xx + yy <= VARIANCE_MAX
                and abs(mean_x) <= OFFSCREEN_MAX
                and abs(mean_y) <= OFFSCREEN_MAX
            ):
                overflowed += 1
                continue
            d0, d1, d2 = a11 * a22 - a12 * a21, a12 * a20 - a10 * a22, a10 * a21 - a11 * a20
            det_sharp = d0 * d0 + d1 * d1 + d2 * d2
            det = det_sharp + EPS2D * (xx + yy) + EPS2D * EPS2D
            if antialias:
                opacity *= math.sqrt(det_sharp / det)
                if not opacity >= threshold:
                    continue
            var_x, var_y = xx + EPS2D, yy + EPS2D
            reach = 2 * math.log(opacity / threshold)
            root_y = math.sqrt(var_y)
            radius_x = math.sqrt(reach * var_x) * (1 + RADIUS_SLACK) + RADIUS_PAD
            radius_y = math.sqrt(reach) * root_y * (1 + RADIUS_SLACK) + RADIUS_PAD
            if not (
                mean_x + radius_x >= 0.5
                and mean_x - radius_x <= width - 0.5
                and mean_y + radius_y >= 0.5
                and mean_y - radius_y <= height - 0.5
            ):
                continue

            root_det = math.sqrt(det)
            share = 1 / (root_y * root_det)
            scratch[k, 0], scratch[k, 1] = mean_x, mean_y
            scratch[k, 13] = mean_x - np.float64(scratch[k, 0])  # what float32 has left over
            scratch[k, 14] = mean_y - np.float64(scratch[k, 1])
            scratch[k, 2] = var_y * share
            scratch[k, 3] = -xy * share
            scratch[k, 4] = root_det * share
            scratch[k, 5] = z
            scratch[k, 6] = opacity
            if degree > 0:
                length = 1 / math.sqrt(dx * dx + dy * dy + dz * dz)
                _basis(degree, dx * length, dy * length, dz * length, basis)
            red, green, blue = 0.5, 0.5, 0.5
            for term in range(terms):
                red += basis[term] * np.float64(sh[i, term, 0])
                green += basis[term] * np.float64(sh[i, term, 1])
                blue += basis[term] * np.float64(sh[i, term, 2])
            scratch[k, 7] = max(red, 0.0)
            scratch[k, 8] = max(green, 0.0)
            scratch[k, 9] = max(blue, 0.0)
            scratch[k, 10] = radius_x
            scratch[k, 11] = radius_y
            scratch_ids[k, 12] = i
            k += 1
        counts[chunk] = k - chunk * CHUNK
    return overflowed


@kernel
def gather_chunks(
    first: int, last: int, scratch: F32, scratch_ids: I32, counts: I32, starts: I64,
    means2d: F64, factors: F32, depths: F32, opacities: F32, colors: F32, radii: F32,
    gaussian_ids: I32,
) -> None:  # fmt: skip
    """Copies the splats of chunks ``first`` to ``last`` to their rows; starts [chunks]."""
    for chunk in range(first, last):
        for j in range(counts[chunk]):
            i, k = chunk * CHUNK + j, starts[chunk] + j
            means2d[k, 0] = np.float64(scratch[i, 0]) + np.float64(scratch[i, 13])
            means2d[k, 1] = np.float64(scratch[i, 1]) + np.float64(scratch[i, 14])
            factors[k, 0], factors[k, 1], factors[k, 2] = (
                scratch[i, 2],
                scratch[i, 3],
                scratch[i, 4],
            )
            depths[k], opacities[k] = scratch[i, 5], scratch[i, 6]
            colors[k, 0], colors[k, 1], colors[k, 2] = scratch[i, 7], scratch[i, 8], scratch[i, 9]
            radii[k, 0], radii[k, 1] = scratch[i, 10], scratch[i, 11]
            gaussian_ids[k] = scratch_ids[i, 12]
