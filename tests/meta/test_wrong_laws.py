"""Tests of the laws: each catches backends that are wrong on purpose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.meta.wrong import REFERENCE, WRONG
from tsplat.core import reference
from tsplat.core.errors import ContractError
from tsplat.core.stages import Backend
from tsplat.core.types import Bins
from tsplat.testing.laws import LAWS, law_checks


def _near_of_its_own(scene, camera, params, workspace):
    """Nothing nearer than 0.2 is drawn, whatever the unit (INRIA auxiliary.h, in_frustum)."""
    return reference.project(scene, replace(camera, near=max(camera.near, 0.2)), params)


def _through_the_lens(scene, camera, params, workspace):
    """What is behind the camera appears in front of it, upside down: z divided by, not tested."""
    z = reference.camera_space(scene, camera, slice(0, len(scene)))[1][:, 2]
    d = scene.means - (camera.centre - scene.origin)
    means = np.where(z[:, None] < 0, scene.means - 2 * d, scene.means)
    return reference.project(replace(scene, means=means.astype(np.float32)), camera, params)


def _no_threshold(scene, camera, params, workspace):
    return reference.project(scene, camera, replace(params, alpha_threshold=0.0))


def _untested(splats, bins, params, workspace):
    return reference.composite(splats, bins, replace(params, alpha_threshold=0.0))


def _one_harmonic(scene, camera, params, workspace):
    """The sign of y alone; of all of degree 1, the scene would be another, but a right one."""
    sh = scene.sh.copy()
    sh[:, 1:2] *= -1
    return reference.project(replace(scene, sh=sh), camera, params)


def _filter_in_world_units(scene, camera, params, workspace):
    """Gaussians made larger in the scene in place of splats in the picture."""
    scales = np.sqrt(scene.scales**2 + np.float32(0.1))
    return reference.project(replace(scene, scales=scales), camera, params)


def _small_footprint(splats, order, workspace):
    """No splat is drawn farther from its middle than 16 px."""
    return reference.bin(replace(splats, radii=np.minimum(splats.radii, 16)), order)


def _full_tiles_only(splats, order, workspace):
    """The last row of tiles is forgotten where the picture cuts it."""
    bins = reference.bin(splats, order)
    if splats.height % bins.tile_size == 0:
        return bins
    columns = -(-splats.width // bins.tile_size)
    offsets = bins.tile_offsets.copy()
    offsets[-columns:] = offsets[-columns - 1]
    return Bins(offsets, bins.splat_ids[: offsets[-1]], bins.tile_size)


def _short_lists(splats, bins, params, workspace):
    """A tile has room for eight splats."""
    counts = np.minimum(np.diff(bins.tile_offsets), 8)
    starts = bins.tile_offsets[:-1]
    ids = [bins.splat_ids[a : a + n] for a, n in zip(starts, counts, strict=True)]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return reference.composite(splats, Bins(offsets, np.concatenate(ids), bins.tile_size), params)


def _kept_by_size(splats, bins, params, workspace):
    """The last frame of this size is shown again."""
    key = splats.width, splats.height
    frame = reference.composite(splats, bins, params)
    return workspace.known.setdefault(str(key), frame)


def _exclusive(splats, bins, params, workspace):
    """Splats are drawn side by side, none behind another: T is 1 less the sum of alphas."""
    frame = reference.composite(splats, bins, params)
    return replace(frame, transmittance=np.maximum(1 + np.log(frame.transmittance), 0))


def _weights_made_to_sum(splats, bins, params, workspace):
    """rgb divided by its weights, as if every pixel were opaque."""
    frame = reference.composite(splats, bins, params)
    return replace(frame, rgb=frame.rgb / np.maximum(1 - frame.transmittance, 1e-3)[..., None])


def _not_a_number(splats, bins, params, workspace):
    """T of pixels that nothing was drawn on is 0 / 0."""
    frame = reference.composite(splats, bins, params)
    t = np.where(frame.transmittance == 1, np.float32(np.nan), frame.transmittance)
    return replace(frame, transmittance=t)


NEW = {
    "near plane in units of its own": replace(REFERENCE, project=_near_of_its_own),
    "behind through the lens": replace(REFERENCE, project=_through_the_lens),
    "no threshold anywhere": replace(REFERENCE, project=_no_threshold, composite=_untested),
    "one harmonic's sign": replace(REFERENCE, project=_one_harmonic),
    "filter in world units": replace(REFERENCE, project=_filter_in_world_units),
    "footprint of 16 px": replace(REFERENCE, bin=_small_footprint),
    "full tiles only": replace(REFERENCE, bin=_full_tiles_only),
    "short tile lists": replace(REFERENCE, composite=_short_lists),
    "last frame of this size": replace(REFERENCE, composite=_kept_by_size),
    "splats side by side": replace(REFERENCE, composite=_exclusive),
    "T not a number": replace(REFERENCE, composite=_not_a_number),
    "weights made to sum to 1": replace(REFERENCE, composite=_weights_made_to_sum),
}
"""Wrong backends that break laws, beside those of tests/meta/wrong.py."""

ALL = {name: stages for name, (stages, _) in WRONG.items()} | NEW

CATCHES = {
    "rigid_motion": ("float32 camera subtraction",),
    "mirror": ("half a pixel off",),
    "uniform_scale": ("near plane in units of its own", "filter in world units"),
    "row_order": ("coarse keys", "last Gaussian dropped", "tiles not near to far"),
    "ties": ("ties by row", "unstable ties", "numbers lost"),
    "invisible": ("behind through the lens", "no threshold anywhere", "last Gaussian dropped"),
    "crop": ("mirrored", "full tiles only", "small boxes"),
    "resolution": ("half a pixel off", "footprint of 16 px"),
    "added_behind": (
        "stopping splat drawn",
        "alpha for transmittance",
        "weights made to sum to 1",
        "NaN where opaque",
        "T not a number",
    ),
    "added_in_front": ("alpha for transmittance", "short tile lists"),
    "product": ("splats side by side", "stop too early", "short tile lists", "T not a number"),
    "sh_turns": ("one harmonic's sign", "wrong SH order"),
    "energy": ("antialias ignored", "splats listed twice", "T not a number"),
    "background": ("alpha for transmittance", "alpha cap missing", "weights made to sum to 1"),
    "bits": ("threads differ", "runs differ", "last frame of this size"),
    "tiles": ("short tile lists",),
}
"""Law -> wrong backends that it must catch."""


def check(law, stages, examples=200):
    """The check of one law for a backend made of ``stages``."""
    backend = Backend("wrong", "wrong on purpose", lambda: stages)
    return next(c for c in law_checks(backend, examples) if c.name == law)


def test_every_law_has_something_to_catch():
    """No law is without a wrong backend, and none is named that is not there."""
    assert set(CATCHES) == set(LAWS)
    assert all(CATCHES.values())


@pytest.mark.parametrize(
    ("law", "name"), [(law, name) for law, names in CATCHES.items() for name in names]
)
def test_a_wrong_backend_is_caught(law, name):
    """The law finds an example that this backend gets wrong."""
    with pytest.raises(ContractError):
        check(law, ALL[name])()


@pytest.mark.parametrize("law", LAWS)
def test_the_reference_itself_is_never_caught(law):
    """The same machinery passes what is right."""
    check(law, REFERENCE, 5)()
