"""Two formulas that most renderers use, for comparison: both are right in exact arithmetic.

Each is the reference with one step done in float32 as textbooks write it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tsplat.core import reference
from tsplat.core.camera import Camera
from tsplat.core.constants import ALPHA_MAX
from tsplat.core.params import RenderParams
from tsplat.core.stages import Stages
from tsplat.core.types import Bins, Frame, Scene, Splats
from tsplat.core.workspace import Workspace


def project_conics(
    scene: Scene, camera: Camera, params: RenderParams, workspace: Workspace
) -> Splats:
    """Splats whose ``factors`` are conics: the inverse by ``a c - b^2``, all of it in float32.

    What has no positive determinant is left out, as gsplat does.
    """
    splats = reference.project(scene, camera, replace(params, float64=True))
    u11, u12, u22 = splats.factors.T
    c = 1 / u22**2
    det = c / u11**2
    b = -u12 * np.sqrt(c * det)
    a = (det + b * b) / c
    a32, b32, c32 = (part.astype(np.float32) for part in (a, b, c))
    with np.errstate(all="ignore"):
        det32 = a32 * c32 - b32 * b32
        conics = np.stack([c32 / det32, -b32 / det32, a32 / det32], 1)
    keep = np.flatnonzero((det32 > 0) & np.isfinite(conics).all(axis=1))
    float32 = {
        name: getattr(splats, name)[keep].astype(np.float32)
        for name in ("depths", "opacities", "colors", "radii")
    }
    return replace(
        splats, means2d=splats.means2d[keep], factors=np.ascontiguousarray(conics[keep]), **float32,
        gaussian_ids=splats.gaussian_ids[keep],
        numbers=scene.numbers_of(splats.gaussian_ids[keep]),
    )  # fmt: skip


def composite_conics(
    splats: Splats, bins: Bins, params: RenderParams, workspace: Workspace
) -> Frame:
    """INRIA's loop over pixels, for a whole tile at a time; ``power > 0`` is skipped."""
    shape = splats.height, splats.width
    rgb, t = np.zeros((*shape, 3), np.float32), np.ones(shape, np.float32)
    depth = np.zeros(shape, np.float32) if params.depth else None
    with np.errstate(all="ignore"):
        for rows, columns, ids in reference.tiles(splats, bins):
            y = np.arange(rows.start, rows.stop)[:, None] + 0.5
            x = np.arange(columns.start, columns.stop)[None, :] + 0.5
            left, stopped = t[rows, columns], np.zeros(t[rows, columns].shape, bool)
            for k in ids:
                dx = (x - splats.means2d[k, 0]).astype(np.float32)
                dy = (y - splats.means2d[k, 1]).astype(np.float32)
                a, b, c = splats.factors[k]
                power = np.float32(-0.5) * (a * dx * dx + c * dy * dy) - b * dx * dy
                alpha = np.minimum(np.float32(ALPHA_MAX), splats.opacities[k] * np.exp(power))
                drawn = (power <= 0) & (alpha >= params.alpha_threshold) & ~stopped
                after = left * (1 - alpha)
                stopped |= drawn & (after <= params.transmittance_min)
                drawn &= ~stopped
                weight = np.where(drawn, left * alpha, 0)
                rgb[rows, columns] += weight[..., None] * splats.colors[k]
                if depth is not None:
                    depth[rows, columns] += weight * splats.depths[k]
                left[drawn] = after[drawn]
                if stopped.all():
                    break
    return Frame(rgb, t, depth)


def project_from_float32(
    scene: Scene, camera: Camera, params: RenderParams, workspace: Workspace
) -> Splats:
    """Camera coordinates as ``R mean + t`` in float32, means in the world's coordinates."""
    with np.errstate(all="ignore"):
        world = (scene.means + scene.origin).astype(np.float32)
        view = camera.viewmat.astype(np.float32)
        p = world @ view[:3, :3].T + view[:3, 3]
        offsets = (p.astype(np.float64) @ camera.rotation).astype(np.float32)
    offsets[~np.isfinite(offsets).all(axis=1)] = 0  # in the camera: not drawn
    at_origin = np.eye(4)
    at_origin[:3, :3] = camera.rotation
    moved = replace(scene, means=np.ascontiguousarray(offsets), origin=np.zeros(3))
    return reference.project(moved, replace(camera, viewmat=at_origin), params)


CONIC = Stages(project_conics, reference.sort, reference.bin, composite_conics)
FLOAT32 = Stages(project_from_float32, reference.sort, reference.bin, reference.composite)
