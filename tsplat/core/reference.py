"""The four stages in plain NumPy: the contract, written to be read beside the papers.

Kerbl et al. 2023, "3D Gaussian Splatting for Real-Time Radiance Field Rendering", is [3DGS];
Zwicker et al. 2001, "EWA Volume Splatting", is [EWA]. docs/contract.md states every rule with
its reason. Geometry is float64 throughout; ``params.float64`` decides what is handed on and how
pixels are summed. Nothing here is optimised beyond whole-array arithmetic.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tsplat.core.camera import Camera
from tsplat.core.constants import (
    ALPHA_FLOOR,
    ALPHA_MAX,
    CLAMP_MARGIN,
    OFFSCREEN_MAX,
    RADIUS_PAD,
    RADIUS_SLACK,
    SH_C0,
    SH_C1,
    SH_C2,
    SH_C3,
    VARIANCE_MAX,
)
from tsplat.core.params import RenderParams
from tsplat.core.ties import break_ties
from tsplat.core.types import F32, F64, I32, Bins, Floats, Frame, Scene, Splats
from tsplat.core.workspace import Workspace

TILE_SIZE = 16
ROWS = 1 << 15  # Gaussians at a time, so that intermediate arrays stay in the cache
DEEP = 256  # splats at a time in one tile


def rotations(quats: NDArray[np.floating]) -> F64:
    """Rotation matrices [..., 3, 3] of unit quaternions [..., 4] (w, x, y, z)."""
    w, x, y, z = np.moveaxis(quats.astype(np.float64), -1, 0)
    matrix = np.empty((*w.shape, 3, 3))
    matrix[..., 0, 0] = 1 - 2 * (y * y + z * z)
    matrix[..., 0, 1] = 2 * (x * y - w * z)
    matrix[..., 0, 2] = 2 * (x * z + w * y)
    matrix[..., 1, 0] = 2 * (x * y + w * z)
    matrix[..., 1, 1] = 1 - 2 * (x * x + z * z)
    matrix[..., 1, 2] = 2 * (y * z - w * x)
    matrix[..., 2, 0] = 2 * (x * z - w * y)
    matrix[..., 2, 1] = 2 * (y * z + w * x)
    matrix[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return matrix


def sh_basis(directions: F64, degree: int) -> F64:
    """Real spherical harmonics Y [..., (degree + 1)^2] at unit ``directions`` [..., 3].

    Order and signs are INRIA's (diff-gaussian-rasterization forward.cu, computeColorFromSH).
    """
    x, y, z = np.moveaxis(directions, -1, 0)
    basis = np.empty((*x.shape, (degree + 1) ** 2))
    basis[..., 0] = SH_C0
    if degree >= 1:
        basis[..., 1] = -SH_C1 * y
        basis[..., 2] = SH_C1 * z
        basis[..., 3] = -SH_C1 * x
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        basis[..., 4] = SH_C2[0] * (x * y)
        basis[..., 5] = SH_C2[1] * (y * z)
        basis[..., 6] = SH_C2[2] * (2 * zz - xx - yy)
        basis[..., 7] = SH_C2[3] * (x * z)
        basis[..., 8] = SH_C2[4] * (xx - yy)
    if degree >= 3:
        basis[..., 9] = SH_C3[0] * y * (3 * xx - yy)
        basis[..., 10] = SH_C3[1] * (x * y) * z
        basis[..., 11] = SH_C3[2] * y * (4 * zz - xx - yy)
        basis[..., 12] = SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy)
        basis[..., 13] = SH_C3[4] * x * (4 * zz - xx - yy)
        basis[..., 14] = SH_C3[5] * z * (xx - yy)
        basis[..., 15] = SH_C3[6] * x * (xx - 3 * yy)
    return basis


def camera_space(scene: Scene, camera: Camera, rows: slice) -> tuple[F64, F64]:
    """World-axis offsets d = mean - centre [N, 3] and camera coordinates p = R d [N, 3].

    The subtraction and the products are float64 in one fixed order without fused operations, so
    that every backend gets the same bits of depth, and with them the same order and ties.
    """
    d = scene.means[rows].astype(np.float64) - (camera.centre - scene.origin)
    r = camera.rotation
    p = np.empty_like(d)
    for i in range(3):
        p[:, i] = (r[i, 0] * d[:, 0] + r[i, 1] * d[:, 1]) + r[i, 2] * d[:, 2]
    return d, p


def _project_rows(
    scene: Scene, camera: Camera, params: RenderParams, rows: slice
) -> tuple[dict[str, NDArray[np.floating] | I32], int]:
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    threshold = max(params.alpha_threshold, ALPHA_FLOOR)
    d, p = camera_space(scene, camera, rows)
    opacity = scene.opacities[rows].astype(np.float64)
    # Not behind the camera, not beyond far, and opaque enough to reach the threshold at all.
    seen = np.flatnonzero((p[:, 2] > camera.near) & (p[:, 2] < camera.far) & (opacity >= threshold))
    d, (x, y, z), opacity = d[seen], p[seen].T, opacity[seen]
    slope_x, slope_y = x / z, y / z
    mean_x, mean_y = fx * slope_x + cx, fy * slope_y + cy

    # Jacobian of the projection at p, [EWA] eq. 29, with its slopes held near the picture: far
    # outside it the linear approximation would blow a Gaussian up to any size.
    margin_x, margin_y = (
        CLAMP_MARGIN * camera.width / (2 * fx),
        CLAMP_MARGIN * camera.height / (2 * fy),
    )
    u = np.clip(slope_x, -cx / fx - margin_x, (camera.width - cx) / fx + margin_x)
    v = np.clip(slope_y, -cy / fy - margin_y, (camera.height - cy) / fy + margin_y)
    # A = J R Rq S [2, 3] by rows: columns are the Gaussian's own axes on the image plane, px.
    axes = camera.rotation @ rotations(scene.quats[rows][seen])
    axes *= scene.scales[rows][seen, None, :]
    a1 = (fx / z)[:, None] * (axes[:, 0] - u[:, None] * axes[:, 2])
    a2 = (fy / z)[:, None] * (axes[:, 1] - v[:, None] * axes[:, 2])

    # covar2d = A A^T + eps2d I, [3DGS] eq. 5 with [EWA]'s low-pass filter. Its determinant is
    # summed from positive terms: the textbook's a c - b^2 cancels for every needle.
    xx, yy, xy = (a1 * a1).sum(1), (a2 * a2).sum(1), (a1 * a2).sum(1)
    det_sharp = (np.cross(a1, a2) ** 2).sum(1)
    det = det_sharp + params.low_pass * (xx + yy) + params.low_pass**2
    if params.antialias:
        opacity = opacity * np.sqrt(det_sharp / det)
    var_x, var_y = xx + params.low_pass, yy + params.low_pass

    fits = (
        (xx + yy <= VARIANCE_MAX) & (abs(mean_x) <= OFFSCREEN_MAX) & (abs(mean_y) <= OFFSCREEN_MAX)
    )
    overflowed = len(fits) - int(fits.sum())
    # alpha >= threshold inside the ellipse sigma <= ln(opacity / threshold); this is its box.
    reach = 2 * np.log(np.maximum(opacity / threshold, 1))
    radius_x = np.sqrt(reach * var_x) * (1 + RADIUS_SLACK) + RADIUS_PAD
    radius_y = np.sqrt(reach * var_y) * (1 + RADIUS_SLACK) + RADIUS_PAD
    touches = (opacity >= threshold) & (
        (mean_x + radius_x >= 0.5) & (mean_x - radius_x <= camera.width - 0.5)
    )
    touches &= (mean_y + radius_y >= 0.5) & (mean_y - radius_y <= camera.height - 0.5)
    kept = np.flatnonzero(fits & touches)

    # Upper Cholesky factor of the inverse, again without a subtraction.
    u11 = np.sqrt(var_y / det)
    u12 = -xy / np.sqrt(var_y * det)
    u22 = 1 / np.sqrt(var_y)
    d = d[kept]
    degree = min(params.sh_degree, scene.sh_degree)
    basis = sh_basis(d / np.linalg.norm(d, axis=1, keepdims=True), degree)
    used = scene.sh[rows][seen[kept], : basis.shape[1]]
    colors = np.maximum(0.5 + np.einsum("nk,nkc->nc", basis, used.astype(np.float64)), 0)
    columns = {
        "means2d": np.stack([mean_x, mean_y], 1)[kept],
        "factors": np.stack([u11, u12, u22], 1)[kept],
        "depths": rounded_depths(z[kept], params),
        "opacities": opacity[kept],
        "colors": colors,
        "radii": np.stack([radius_x, radius_y], 1)[kept],
        "gaussian_ids": (seen[kept] + rows.start).astype(np.int32),
    }
    return cast("dict[str, NDArray[np.floating] | I32]", columns), overflowed


def rounded_depths(z: F64, params: RenderParams) -> F32:
    """Depths as they are compared: float32, in ``params.depth_bits``."""
    depths = z.astype(np.float32)
    wide = depths * np.float32(params.depth_split)
    return np.asarray(wide - (wide - depths), np.float32)


def project(
    scene: Scene, camera: Camera, params: RenderParams, workspace: Workspace | None = None
) -> Splats:
    """See :class:`tsplat.core.stages.Project`."""
    dtype = np.float64 if params.float64 else np.float32
    parts, overflowed = [], 0
    # What overflows is dropped and counted; what underflows is 0 to float32 as well.
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        for start in range(0, max(len(scene), 1), ROWS):
            part, over = _project_rows(
                scene, camera, params, slice(start, min(start + ROWS, len(scene)))
            )
            parts.append(part)
            overflowed += over
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        for name in ("factors", "opacities", "colors", "radii"):
            columns[name] = columns[name].astype(dtype)
    return Splats(
        **columns, width=camera.width, height=camera.height, overflowed=overflowed,
        numbers=scene.numbers_of(columns["gaussian_ids"]),
    )  # fmt: skip


def sort(splats: Splats, workspace: Workspace | None = None) -> I32:
    """See :class:`tsplat.core.stages.Sort`."""
    order = np.argsort(splats.depths, kind="stable").astype(np.int32)
    return break_ties(order, splats.depths, splats.numbers)


def pixel_boxes(splats: Splats) -> tuple[I32, I32]:
    """First and last pixel [M, 2] whose centre lies in each splat's box, inside the picture."""
    mean, radius = splats.means2d, splats.radii.astype(np.float64)
    last = np.array([splats.width - 1, splats.height - 1])
    low = np.clip(np.ceil(mean - radius - 0.5), 0, last + 1)
    high = np.clip(np.floor(mean + radius - 0.5), -1, last)
    return low.astype(np.int32), high.astype(np.int32)


def bin(
    splats: Splats, order: I32, workspace: Workspace | None = None, tile_size: int = TILE_SIZE
) -> Bins:
    """See :class:`tsplat.core.stages.Bin`. Lists every tile that a splat's box touches."""
    columns, rows = -(-splats.width // tile_size), -(-splats.height // tile_size)
    low, high = pixel_boxes(splats)
    empty = np.any(low > high, axis=1)
    first, last = (low // tile_size)[order], (high // tile_size)[order]
    across, down = (last - first + 1).T.astype(np.int64)
    counts = np.where(empty[order], 0, across * down)
    owner = np.repeat(np.arange(len(order)), counts)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    tiles = (first[owner, 1] + within // across[owner]) * columns + (
        first[owner, 0] + within % across[owner]
    )
    by_tile = np.argsort(tiles, kind="stable")  # stable: near to far within a tile
    offsets = np.zeros(columns * rows + 1, np.int64)
    np.cumsum(np.bincount(tiles, minlength=columns * rows), out=offsets[1:])
    return Bins(offsets, order[owner[by_tile]], tile_size)


def tiles(splats: Splats, bins: Bins) -> Iterator[tuple[slice, slice, I32]]:
    """Pixel rows, pixel columns and splat rows of every tile that lists a splat."""
    size = bins.tile_size
    columns = -(-splats.width // size)
    for tile in np.flatnonzero(np.diff(bins.tile_offsets)):
        y, x = divmod(int(tile), columns)
        yield (
            slice(y * size, min((y + 1) * size, splats.height)),
            slice(x * size, min((x + 1) * size, splats.width)),
            bins.splat_ids[bins.tile_offsets[tile] : bins.tile_offsets[tile + 1]],
        )


def composite(
    splats: Splats,
    bins: Bins,
    params: RenderParams,
    workspace: Workspace | None = None,
    margins: F64 | None = None,
) -> Frame:
    """See :class:`tsplat.core.stages.Composite`; [3DGS] eq. 3.

    ``margins`` [H, W], if given, is filled with how near each pixel came to one of the two
    thresholds: the least relative distance of an alpha or a transmittance that was tested.
    """
    dtype = np.float64 if params.float64 else np.float32
    shape = splats.height, splats.width
    rgb = np.zeros((*shape, 3), dtype)
    transmittance = np.ones(shape, dtype)
    depth = np.zeros(shape, dtype) if params.depth else None
    if margins is not None:
        margins[:] = np.inf
    # An alpha far from its splat, and light behind many layers, underflow to 0, as they should.
    with np.errstate(under="ignore"):
        _composite_tiles(splats, bins, params, rgb, transmittance, depth, margins)
    return Frame(cast(Floats, rgb), cast(Floats, transmittance), cast("Floats | None", depth))


def _composite_tiles(
    splats: Splats, bins: Bins, params: RenderParams, rgb: NDArray[np.floating],
    transmittance: NDArray[np.floating], depth: NDArray[np.floating] | None, margins: F64 | None,
) -> None:  # fmt: skip
    """Adds every tile's splats to the picture."""
    dtype = rgb.dtype.type
    for rows, columns, ids in tiles(splats, bins):
        y = np.arange(rows.start, rows.stop)[:, None] + 0.5
        x = np.arange(columns.start, columns.stop)[None, :] + 0.5
        t = transmittance[rows, columns]  # a view: written through
        stopped = np.zeros(t.shape, bool)
        for start in range(0, len(ids), DEEP):
            k = ids[start : start + DEEP]
            mean_x, mean_y = splats.means2d[k].T[:, :, None, None]
            u11, u12, u22 = splats.factors[k].astype(dtype).T[:, :, None, None]
            opacity = splats.opacities[k].astype(dtype)[:, None, None]
            dx, dy = (x - mean_x).astype(dtype), (y - mean_y).astype(dtype)
            sigma = ((u11 * dx + u12 * dy) ** 2 + (u22 * dy) ** 2) / 2
            alpha = np.minimum(opacity * np.exp(-sigma), dtype(ALPHA_MAX))
            reached = alpha >= params.alpha_threshold
            # Transmittance before and after every splat; a splat out of reach changes nothing.
            after = np.where(reached, 1 - alpha, 1)
            after[0] *= t
            np.multiply.accumulate(after, axis=0, out=after)
            before = np.concatenate([t[None], after[:-1]])
            # after never rises, so the splats before the stopping one are a prefix.
            drawn = (after > params.transmittance_min) & ~stopped
            weight = np.where(drawn & reached, before * alpha, 0)
            rgb[rows, columns] += np.einsum("kyx,kc->yxc", weight, splats.colors[k].astype(dtype))
            if depth is not None:
                depth[rows, columns] += np.einsum(
                    "kyx,k->yx", weight, splats.depths[k].astype(dtype)
                )
            if margins is not None:
                _note_margins(margins[rows, columns], alpha, before, after, stopped, params)
            t[:] = np.minimum(t, np.where(drawn, after, 1).min(axis=0))  # after the last one drawn
            stopped |= ~drawn[-1]
            if stopped.all():
                break


def _note_margins(
    margins: F64, alpha: Floats, before: Floats, after: Floats, stopped: NDArray[np.bool_],
    params: RenderParams,
) -> None:  # fmt: skip
    """Lowers ``margins`` by the tests that this run of splats decided."""
    open_ = (before > params.transmittance_min) & ~stopped
    if params.alpha_threshold > 0:
        off = np.where(open_, abs(alpha / params.alpha_threshold - 1), np.inf)
        np.minimum(margins, off.min(axis=0), out=margins)
    if params.transmittance_min > 0:
        off = np.where(open_, abs(after / params.transmittance_min - 1), np.inf)
        np.minimum(margins, off.min(axis=0), out=margins)


def render(scene: Scene, camera: Camera, params: RenderParams, margins: F64 | None = None) -> Frame:
    """The picture, by the four stages above; with :data:`IDEAL` as params, the true one."""
    splats = project(scene, camera, params)
    return composite(splats, bin(splats, sort(splats)), params, margins=margins)
