"""Backends that are wrong on purpose, each in one way, each with the checks that must catch it.

Each is the reference with one stage bent. A wrong backend that passes would mean that the checks
prove nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tsplat.core import constants, reference
from tsplat.core.stages import Stages
from tsplat.core.types import Bins, Frame

REFERENCE = Stages(reference.project, reference.sort, reference.bin, reference.composite)


def _splats(change):
    """A project stage whose splats are changed."""

    def project(scene, camera, params, workspace):
        return change(reference.project(scene, camera, params), scene, camera, params)

    return replace(REFERENCE, project=project)


def _mirrored(splats, scene, camera, params):
    means = splats.means2d.copy()
    means[:, 0] = camera.width - means[:, 0]
    return replace(splats, means2d=means)


def _half_pixel(splats, scene, camera, params):
    return replace(splats, means2d=splats.means2d + np.float32(0.5))


def _float32_subtraction(splats, scene, camera, params):
    """Camera and origin subtracted after rounding to float32: detail is lost far out."""
    centre = (camera.centre).astype(np.float32)
    world = scene.means + scene.origin.astype(np.float32)
    p = (world - centre)[splats.gaussian_ids] @ camera.rotation.astype(np.float32).T
    z = np.where(p[:, 2] > 0, p[:, 2], 1)
    k = camera.K.astype(np.float32)
    means = np.stack([k[0, 0] * p[:, 0] / z + k[0, 2], k[1, 1] * p[:, 1] / z + k[1, 2]], 1)
    return replace(splats, means2d=means.astype(np.float64))


def _cancelling_determinant(splats, scene, camera, params):
    """The textbook's a c - b^2 in float32; where it is not positive the splat is a point."""
    u11, u12, u22 = splats.factors.T
    inverse = np.zeros((len(splats), 2, 2))
    inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1] = u11, u12, u22
    factor = np.linalg.inv(inverse)
    cov = (factor @ factor.transpose(0, 2, 1)).astype(np.float32)
    a, b, c = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    det = np.maximum(a * c - b * b, np.float32(1e-6))
    return replace(
        splats, factors=np.stack([np.sqrt(c / det), -b / np.sqrt(c * det), 1 / np.sqrt(c)], 1)
    )


def _no_dilation(splats, scene, camera, params):
    """Without the low-pass filter a splat is too small by 0.3 px^2."""
    u11, u12, u22 = splats.factors.T
    return replace(splats, factors=np.stack([u11 * np.float32(1.05), u12, u22], 1))


def _no_antialias(splats, scene, camera, params):
    return reference.project(scene, camera, replace(params, antialias=False))


def _sh_sign(splats, scene, camera, params):
    sh = scene.sh.copy()
    sh[:, 1:4] *= -1
    return reference.project(replace(scene, sh=sh), camera, params)


def _sh_order(splats, scene, camera, params):
    """Channel-major coefficients read as coefficient-major."""
    k = scene.sh.shape[1]
    mixed = scene.sh.reshape(-1, 3, k).transpose(0, 2, 1)
    return reference.project(replace(scene, sh=np.ascontiguousarray(mixed)), camera, params)


def _negative_color(splats, scene, camera, params):
    return replace(splats, colors=np.where(splats.colors == 0, np.float32(-0.1), splats.colors))


def _clipped_color(splats, scene, camera, params):
    return replace(splats, colors=np.minimum(splats.colors, 1))


def _swapped_channels(splats, scene, camera, params):
    return replace(splats, colors=np.ascontiguousarray(splats.colors[:, ::-1]))


def _tight_radii(splats, scene, camera, params):
    """Three sigma, whatever the opacity: cuts what opaque splats still reach."""
    return replace(splats, radii=splats.radii * np.float32(0.9))


def _dropped_last(splats, scene, camera, params):
    keep = slice(0, max(len(splats) - 1, 0))
    names = ("means2d", "factors", "depths", "opacities", "colors", "radii", "gaussian_ids")
    kept = {n: getattr(splats, n)[keep] for n in names}
    return replace(splats, **kept, numbers=scene.numbers_of(kept["gaussian_ids"]))


def _no_numbers(splats, scene, camera, params):
    return replace(splats, numbers=None)


def _depth_rounded(splats, scene, camera, params):
    return replace(splats, depths=splats.depths.astype(np.float16).astype(np.float32))


def _depth_bits_kept(splats, scene, camera, params):
    return reference.project(scene, camera, replace(params, depth_bits=32))


def _radial_depth(splats, scene, camera, params):
    d, _ = reference.camera_space(scene, camera, slice(0, len(scene)))
    far = np.linalg.norm(d, axis=1)[splats.gaussian_ids]
    return replace(splats, depths=far.astype(np.float32))


def _unstable(splats, workspace):
    """Equal depths by falling row, whatever their numbers."""
    backwards = np.argsort(splats.depths[::-1], kind="stable").astype(np.int32)
    return (len(splats) - 1 - backwards).astype(np.int32)


def _ties_by_row(splats, workspace):
    return reference.sort(replace(splats, numbers=None))


def _coarse(splats, workspace):
    return reference.sort(replace(splats, depths=splats.depths.astype(np.float16)))


def _small_boxes(splats, order, workspace):
    return reference.bin(replace(splats, radii=splats.radii * np.float32(0.6)), order)


def _unordered_tiles(splats, order, workspace):
    bins = reference.bin(splats, order)
    ids = bins.splat_ids.copy()
    for begin, end in zip(bins.tile_offsets[:-1], bins.tile_offsets[1:], strict=True):
        ids[begin:end] = np.sort(ids[begin:end])
    return Bins(bins.tile_offsets, ids, bins.tile_size)


def _twice(splats, order, workspace):
    bins = reference.bin(splats, order)
    return Bins(bins.tile_offsets * 2, np.repeat(bins.splat_ids, 2), bins.tile_size)


def _composite(**numbers):
    """A composite stage with other numbers than the contract's."""

    def composite(splats, bins, params, workspace):
        return reference.composite(splats, bins, replace(params, **numbers))

    return replace(REFERENCE, composite=composite)


def _no_cap(splats, bins, params, workspace):
    before, reference.ALPHA_MAX = reference.ALPHA_MAX, 1.0
    try:
        return reference.composite(splats, bins, params)
    finally:
        reference.ALPHA_MAX = before


def _rough_exp(splats, bins, params, workspace):
    """Schraudolph's bit trick is up to 6 % off; here 3 % of opacity."""
    return reference.composite(
        replace(splats, opacities=splats.opacities * np.float32(0.97)), bins, params
    )


def _stopping_splat_drawn(splats, bins, params, workspace):
    return reference.composite(splats, bins, replace(params, transmittance_min=1e-9))


def _wrong_transmittance(splats, bins, params, workspace):
    frame = reference.composite(splats, bins, params)
    return Frame(frame.rgb, 1 - frame.transmittance, frame.depth)


def _normalised_depth(splats, bins, params, workspace):
    frame = reference.composite(splats, bins, params)
    if frame.depth is None:
        return frame
    return replace(frame, depth=frame.depth / np.maximum(1 - frame.transmittance, 1e-6))


def _nan(splats, bins, params, workspace):
    frame = reference.composite(splats, bins, params)
    return replace(frame, rgb=np.where(frame.transmittance[..., None] < 0.1, np.nan, frame.rgb))


def _thread_race(splats, bins, params, workspace):
    frame = reference.composite(splats, bins, params)
    noise = np.float32(1e-6 * (workspace.threads - 1))
    return replace(frame, rgb=frame.rgb + noise)


_state = {"calls": 0}


def _remembers(splats, bins, params, workspace):
    _state["calls"] += 1
    frame = reference.composite(splats, bins, params)
    return replace(frame, rgb=frame.rgb + np.float32(1e-6 * (_state["calls"] % 7)))


P = ("project", "picture")
C = ("composite", "picture")
WRONG = {
    "mirrored": (_splats(_mirrored), P),
    "half a pixel off": (_splats(_half_pixel), P),
    "float32 camera subtraction": (_splats(_float32_subtraction), P),
    "cancelling determinant": (_splats(_cancelling_determinant), P),
    "too narrow": (_splats(_no_dilation), P),
    "antialias ignored": (_splats(_no_antialias), P),
    "wrong SH sign": (_splats(_sh_sign), P),
    "wrong SH order": (_splats(_sh_order), P),
    "negative colour": (_splats(_negative_color), P),
    "colour clipped early": (_splats(_clipped_color), P),
    "swapped channels": (_splats(_swapped_channels), P),
    "tight radii": (_splats(_tight_radii), P),
    "last Gaussian dropped": (_splats(_dropped_last), P),
    "depths in float16": (_splats(_depth_rounded), P),
    "all bits of depths": (_splats(_depth_bits_kept), ("project",)),
    "numbers lost": (_splats(_no_numbers), P),
    "radial depth": (_splats(_radial_depth), P),
    "unstable ties": (replace(REFERENCE, sort=_unstable), ("sort", "picture")),
    "ties by row": (replace(REFERENCE, sort=_ties_by_row), ("sort", "picture")),
    "coarse keys": (replace(REFERENCE, sort=_coarse), ("sort", "picture")),
    "small boxes": (replace(REFERENCE, bin=_small_boxes), ("bin", "picture")),
    "tiles not near to far": (replace(REFERENCE, bin=_unordered_tiles), ("bin", "picture")),
    "splats listed twice": (replace(REFERENCE, bin=_twice), ("bin", "picture")),
    "threshold too high": (_composite(alpha_threshold=1 / 128), C),
    "no threshold": (_composite(alpha_threshold=0.0), C),
    "stop too early": (_composite(transmittance_min=1e-2), C),
    "stopping splat drawn": (replace(REFERENCE, composite=_stopping_splat_drawn), C),
    "alpha cap missing": (replace(REFERENCE, composite=_no_cap), C),
    "rough exp": (replace(REFERENCE, composite=_rough_exp), C),
    "alpha for transmittance": (replace(REFERENCE, composite=_wrong_transmittance), C),
    "normalised depth": (replace(REFERENCE, composite=_normalised_depth), C),
    "NaN where opaque": (replace(REFERENCE, composite=_nan), C),
    "threads differ": (replace(REFERENCE, composite=_thread_race), ("bits",)),
    "runs differ": (replace(REFERENCE, composite=_remembers), ("bits",)),
}
"""Name -> the stages, and the checks that must catch them."""

assert constants.ALPHA_MAX < 1.0
