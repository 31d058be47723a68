"""Fewer Gaussians, fewer bits, fewer pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tsplat
from tests.conftest import straight
from tsplat.core import reference
from tsplat.core.camera import look_at
from tsplat.core.params import RenderParams
from tsplat.core.types import Frame
from tsplat.core.workspace import Workspace
from tsplat.plugins import load_backend, plugins
from tsplat.quality.lighter import lighter
from tsplat.quality.thin import chances, thin
from tsplat.quality.upscale import reduced, upscale
from tsplat.testing.strategies import make_scene

DUST = make_scene(3, 3000, 1, frozenset())
DUST = replace(DUST, opacities=DUST.opacities * np.float32(0.2), scales=DUST.scales * 0.5)


def test_about_that_share_is_kept_and_always_the_same():
    """A share is a share, to 2 % of the scene."""
    for share in (0.75, 0.5, 0.1):
        few = thin(replace(DUST), share)
        assert len(few) == pytest.approx(share * len(DUST), abs=0.02 * len(DUST))
        again = thin(replace(DUST), share)
        assert np.array_equal(few.means, again.means)
    assert thin(DUST, 1.0) is DUST
    assert thin(DUST, 0.5) is thin(DUST, 0.5)


def test_chances_are_in_proportion_up_to_one():
    """Their mean is the share, and what covers most is certain to stay."""
    weights = np.array([1.0] * 98 + [1000.0, 3000.0])
    p = chances(weights, 0.5)
    assert p.mean() == pytest.approx(0.5)
    assert (p[-2:] == 1).all()
    assert np.allclose(p[:98], 48 / 98)
    assert np.allclose(chances(np.zeros(4), 0.25), 0.25)


def test_what_stays_blocks_as_much_light():
    """With what is missing made up for, a picture is nearer the whole scene's than without."""
    camera = look_at((0, 0, -6), (0, 0, 0), (0, -1, 0), 50, 48, 40)
    few = thin(replace(DUST), 0.5)
    want = reference.render(DUST, camera, RenderParams()).transmittance
    got = reference.render(few, camera, RenderParams()).transmittance
    where = [int(np.flatnonzero((DUST.means == m).all(1))[0]) for m in few.means]
    plain = replace(few, opacities=DUST.opacities[where], scales=DUST.scales[where])
    less = reference.render(plain, camera, RenderParams()).transmittance
    assert want.mean() < 0.9
    assert abs(got.mean() - want.mean()) < 0.25 * abs(less.mean() - want.mean())


def test_half_keeps_what_float16_can_hold():
    """Coefficients are rounded; those beyond its range become its largest number."""
    sh = DUST.sh.copy()
    sh[0, 0, 0] = 1e6
    light = lighter(replace(DUST, sh=sh), RenderParams(half=True))
    assert light.sh.dtype == np.float16
    assert light.sh[0, 0, 0] == np.finfo(np.float16).max
    np.testing.assert_allclose(light.sh[1:], sh[1:], rtol=2.0**-11, atol=2.0**-24)


def test_a_plan_without_shortcuts_leaves_scene_and_camera_alone():
    """The contract's picture is made of the scene itself."""
    assert lighter(DUST, RenderParams()) is DUST


def test_a_grey_stays_grey_and_a_ramp_a_ramp():
    """Interpolation reproduces what is linear, away from the border."""
    x = (np.arange(40) + 0.5) / 40
    small = np.broadcast_to(x[None, :, None], (10, 40, 3)).astype(np.float32)
    ones = np.ones((10, 40), np.float32)
    big = upscale(Frame(small, ones, None), 80, 20, Workspace(2))
    want = (np.arange(80) + 0.5) / 80
    assert big.rgb.shape == (20, 80, 3)
    np.testing.assert_allclose(big.rgb[:, 8:-8, 1], np.tile(want[8:-8], (20, 1)), atol=1e-6)
    assert np.array_equal(big.transmittance, np.ones((20, 80), np.float32))


def test_overshoot_is_cut_off():
    """Beside an edge a cubic swings below 0 and above 1."""
    rgb = np.zeros((8, 8, 3), np.float32)
    rgb[:, 4:] = 1
    big = upscale(Frame(rgb, rgb[..., 0].copy(), rgb[..., 1].copy()), 32, 32, Workspace(1))
    assert big.rgb.min() == 0
    assert big.rgb.max() > 1.01
    assert big.transmittance.max() == 1
    assert big.depth is not None
    assert big.depth.shape == (32, 32)


def test_a_smooth_picture_survives_half_the_pixels():
    """Large splats at scale 0.5 are within two levels of the whole picture, and in place."""
    scene = replace(make_scene(5, 40, 0, frozenset()), scales=np.full((40, 3), 1.5, np.float32))
    camera = look_at((0, 0, -6), (0, 0, 0), (0, -1, 0), 50, 64, 48)
    want = tsplat.render(scene, camera)
    rough = tsplat.make_plan(scene, params=RenderParams(scale=0.5)).run(scene, camera)
    assert rough.frame.rgb.shape == want.rgb.shape
    assert "upscale" in rough.seconds
    inside = (slice(4, -4), slice(4, -4))
    assert abs(rough.frame.rgb - want.rgb)[inside].max() < 2 / 255
    shifted = np.roll(want.rgb, 1, axis=1)
    assert abs(shifted - want.rgb)[inside].max() > 4 / 255  # a pixel's shift would show


def test_reduced_cameras_have_a_pixel_at_least():
    """1x1 stays 1x1."""
    small = reduced(straight(1, 1), 0.25)
    assert (small.width, small.height) == (1, 1)


def test_a_plan_says_what_is_left_out_because_it_was_asked_for():
    """Each shortcut that changes the picture is listed, and none that was not asked for."""
    params = RenderParams(
        scale=0.5, share=0.5, half=True, depth_bits=20, sh_degree=0, alpha_threshold=0.02,
        transmittance_min=0.01,
    )  # fmt: skip
    said = [item.what for item in tsplat.make_plan(DUST, params=params).left_out]
    for word in ("75% of the pixels", "50% of the Gaussians", "SH beyond float16", "12 bits",
                 "SH beyond degree 0", "alphas below 0.02", "through 0.01"):  # fmt: skip
        assert any(word in what for what in said), word
    plain = tsplat.make_plan(DUST).left_out
    assert not any("tsplat bench" in item.effect for item in plain)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (7, 3), (64, 48), (129, 50)])
@pytest.mark.parametrize("threads", [1, 3])
def test_the_c_kernel_interpolates_alike(width, height, threads):
    """Any size, up or down, with depth or without."""
    stages = load_backend(plugins().backends["cffi"])
    rng = np.random.default_rng(width)
    for h, w in ((1, 1), (2, 5), (24, 32)):
        rgb = rng.uniform(0, 2, (h, w, 3)).astype(np.float32)
        layer = rng.uniform(0, 1, (2, h, w)).astype(np.float32)
        frame = Frame(rgb, layer[0], layer[1] if h > 1 else None)
        want = upscale(frame, width, height, Workspace(threads))
        got = stages.upscale(frame, width, height, Workspace(threads))
        for name in ("rgb", "transmittance", "depth"):
            mine, theirs = getattr(got, name), getattr(want, name)
            assert (mine is None) == (theirs is None)
            if mine is not None:
                np.testing.assert_allclose(mine, theirs, atol=1e-5)
