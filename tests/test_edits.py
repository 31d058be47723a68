"""Edits: the picture is that of a scene whose file had been so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tsplat.core import reference
from tsplat.core.camera import look_at
from tsplat.core.errors import ParamsError, SceneError
from tsplat.core.params import RenderParams
from tsplat.core.workspace import Workspace
from tsplat.edits import LUMA, NOTHING, Box, Edits, edited, filtered
from tsplat.io.clean import SH_MAX
from tsplat.plan import make_plan
from tsplat.testing.strategies import make_scene

CAMERA = look_at((0.5, -1, -4), (0, 0, 0), (0, -1, 0), 60, 60, 45)


@pytest.fixture(scope="module")
def scene():
    """A few hundred Gaussians of degree 2, away from the world's origin."""
    made = make_scene(seed=5, n=300, degree=2, oddities=frozenset())
    return replace(made, origin=np.array([100.0, 0.0, -50.0]))


def picture(scene):
    camera = look_at(
        scene.origin + (0.5, -1, -4), scene.origin, (0, -1, 0), 60, CAMERA.width, CAMERA.height
    )
    return make_plan(scene, backend="numpy").run(scene, camera, Workspace(1)).frame.rgb


def test_nothing_to_change_is_the_same_scene(scene):
    """No copy is made."""
    assert edited(scene, NOTHING) is scene


def test_a_crop_leaves_those_inside(scene):
    """The picture is that of the rows whose means, in the world, are in the box."""
    world = scene.means.astype(np.float64) + scene.origin
    low, high = (100.0, -0.4, -51.0), (101.0, 0.6, -49.5)
    inside = ((world >= low) & (world <= high)).all(axis=1)
    assert 0 < inside.sum() < len(scene)
    cropped = edited(scene, Edits(crop=Box(low, high)))
    assert ((cropped.opacities > 0) == (inside & (scene.opacities > 0))).all()
    np.testing.assert_array_equal(picture(cropped), picture(scene.take(inside)))


def test_faint_ones_are_left_out(scene):
    """Those of the least opacity asked for stay."""
    least = float(np.median(scene.opacities))
    kept = scene.opacities >= np.float32(least)
    np.testing.assert_array_equal(
        picture(edited(scene, Edits(min_opacity=least))), picture(scene.take(kept))
    )


def test_splats_grow(scene):
    """Standard deviations are multiplied; nothing else changes."""
    grown = edited(scene, Edits(splat_scale=1.5))
    np.testing.assert_array_equal(grown.scales, scene.scales * np.float32(1.5))
    np.testing.assert_array_equal(grown.opacities, scene.opacities)
    assert grown.sh is scene.sh


def test_giants_stay_within_float32(scene):
    """A scale that would overflow is held, so that the scene stays one that can be drawn."""
    huge = replace(scene, scales=np.full_like(scene.scales, 1e38))
    assert np.isfinite(edited(huge, Edits(splat_scale=100.0)).scales).all()


def test_colours_are_mixed_with_their_luma(scene):
    """Where no channel was clipped at 0, each colour is factor * rgb + (1 - factor) * luma."""
    for factor in (0.0, 0.5, 2.0):
        before = reference.project(scene, _camera(scene), RenderParams()).colors
        after = reference.project(
            edited(scene, Edits(saturation=factor)), _camera(scene), RenderParams()
        ).colors
        want = factor * before + (1 - factor) * (before @ LUMA)[:, None]
        inside = (before > 1e-6).all(axis=1)
        assert inside.sum() > 50
        np.testing.assert_allclose(after[inside], np.maximum(want[inside], 0), atol=2e-6)


def _camera(scene):
    return look_at(scene.origin + (0.5, -1, -4), scene.origin, (0, -1, 0), 60, 60, 45)


def test_logits_that_were_none(scene):
    """raw_opacity takes back the sigmoid: 0..1 come out as they were in the file."""
    raw = np.linspace(-0.5, 1.5, len(scene), dtype=np.float32)
    read = replace(scene, opacities=(1 / (1 + np.exp(-raw.astype(np.float64)))).astype(np.float32))
    back = edited(read, Edits(raw_opacity=True)).opacities
    np.testing.assert_allclose(back, np.clip(raw, 0, 1), atol=1e-6)
    certain = replace(scene, opacities=np.ones_like(scene.opacities))
    assert (edited(certain, Edits(raw_opacity=True)).opacities == 1).all()


def test_colours_too_large_to_mix_are_clipped(scene):
    """Without a warning, to the largest that a colour can be made of."""
    large = replace(scene, sh=np.full_like(scene.sh, SH_MAX))
    assert np.abs(edited(large, Edits(saturation=10.0)).sh).max() <= SH_MAX


def test_colours_that_are_off_stay_within_what_is_said(scene):
    """sh_error grows with the mix: it bounds how far off any colour may be."""
    half = replace(scene, sh=scene.sh.astype(np.float16), sh_error=1e-3)
    assert edited(half, Edits(saturation=3.0)).sh_error >= 3e-3


@pytest.mark.parametrize(
    "edits",
    [
        Edits(min_opacity=0.5), Edits(max_scale=0.2), Edits(trim=10.0),
        Edits(crop=Box((99.0, -1.0, -51.0), (101.0, 1.0, -49.0))),
        Edits(min_opacity=0.3, max_scale=0.4, trim=1.0, splat_scale=2.0, saturation=0.5),
    ],
    ids=lambda edits: edits.text(),
)  # fmt: skip
def test_filtered_is_edited_without_the_rest(scene, edits):
    """The same picture to the bit, of the rows that are drawn alone; the others are counted."""
    made, kept = edited(scene, edits), filtered(scene, edits)
    np.testing.assert_array_equal(picture(made), picture(kept))
    assert 0 < len(kept) < len(scene)
    assert len(kept) == ((made.opacities > 0) | (scene.opacities == 0)).sum()
    assert sum(kept.dropped.values()) - sum(scene.dropped.values()) == len(scene) - len(kept)


def test_large_ones_and_strays_are_left_out(scene):
    """max_scale looks at the largest of three sizes, trim at each axis from both ends."""
    largest = scene.scales.max(axis=1)
    most = float(np.median(largest))
    drawn = edited(scene, Edits(max_scale=most)).opacities > 0
    assert (drawn == ((largest <= np.float32(most)) & (scene.opacities > 0))).all()
    drawn = edited(scene, Edits(trim=5.0)).opacities > 0
    low, high = np.percentile(scene.means, (5, 95), axis=0)
    within = ((scene.means >= low) & (scene.means <= high)).all(axis=1)
    assert (drawn == (within & (scene.opacities > 0))).all()
    assert 0.6 * len(scene) < within.sum() < 0.9 * len(scene)


def test_one_stray_is_trimmed(scene):
    """One Gaussian at 2e7 goes with the least trim, and the box of the rest is that of the rest."""
    means = scene.means.copy()
    means[7] = 2e7
    kept = filtered(replace(scene, means=means), Edits(trim=0.5))
    assert np.abs(kept.means).max() < 100


def test_nothing_left_is_said(scene):
    """An empty scene is an error that names the edits."""
    with pytest.raises(SceneError, match=r"nothing is left of 300 Gaussians \(max_scale=1e-30\)"):
        filtered(scene, Edits(max_scale=1e-30))


@pytest.mark.parametrize(
    "wrong",
    [
        {"splat_scale": -1.0}, {"splat_scale": float("nan")}, {"saturation": 11.0},
        {"min_opacity": 1.5}, {"max_scale": -1.0}, {"max_scale": float("nan")}, {"trim": 50.0},
    ],
)  # fmt: skip
def test_what_cannot_be(wrong):
    """A value outside its range is refused by name."""
    with pytest.raises(ParamsError, match=next(iter(wrong))):
        Edits(**wrong)


def test_a_box_has_a_lower_corner():
    """Corners the wrong way round, or not finite, are refused."""
    with pytest.raises(ParamsError, match="crop: expected y"):
        Box((0, 1, 0), (1, 0, 1))
    with pytest.raises(ParamsError, match="crop: expected x"):
        Box((float("nan"), 0, 0), (1, 1, 1))
