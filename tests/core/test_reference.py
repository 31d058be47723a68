"""The reference against closed forms: pictures simple enough to work out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import gaussians, straight
from tsplat.core import reference
from tsplat.core.camera import Camera, look_at
from tsplat.core.constants import ALPHA_MAX, ALPHA_THRESHOLD, EPS2D
from tsplat.core.params import IDEAL, RenderParams
from tsplat.core.types import Scene

EXACT = RenderParams(float64=True)


def picture(scene, camera, params=EXACT):
    return reference.render(scene, camera, params)


def grid(camera):
    """Pixel centres x [W], y [H]."""
    return np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5


def test_one_gaussian_is_the_bell_of_its_variance():
    """alpha = o exp(-d^2 / 2(var + 0.3)) at pixel centres, cut at 1/255; colour times that."""
    camera = straight(31, 21)
    frame = picture(gaussians([0.03, -0.02, 5], scales=0.2, opacities=0.7), camera)
    x, y = grid(camera)
    mean = 100 * np.array([0.03, -0.02], np.float32).astype(float) / 5 + [15.5, 10.5]
    # On the optical axis the Jacobian's slopes are 0 but for these small offsets.
    slopes = (mean - [15.5, 10.5]) / 100
    focal = 100 / 5 * np.float32(0.2)
    a1 = focal * np.array([1, 0, -slopes[0]])
    a2 = focal * np.array([0, 1, -slopes[1]])
    cov = np.array([[a1 @ a1, a1 @ a2], [a1 @ a2, a2 @ a2]]) + EPS2D * np.eye(2)
    d = np.stack(np.broadcast_arrays(x[None, :] - mean[0], y[:, None] - mean[1]), -1)
    sigma = 0.5 * np.einsum("yxi,ij,yxj->yx", d, np.linalg.inv(cov), d)
    alpha = np.float32(0.7) * np.exp(-sigma)
    alpha[alpha < ALPHA_THRESHOLD] = 0
    assert 100 < (alpha > 0).sum() < alpha.size
    np.testing.assert_allclose(frame.transmittance, 1 - alpha, atol=1e-12)
    np.testing.assert_allclose(frame.rgb, alpha[..., None] * [1, 0.5, 0.25], atol=1e-7)


def test_two_gaussians_are_blended_front_to_back_whatever_their_order_in_the_file():
    """C = a1 c1 + (1 - a1) a2 c2 and T = (1 - a1)(1 - a2), nearest first."""
    camera = straight()
    far_first = gaussians(
        [[0, 0, 6], [0, 0, 4]], opacities=[0.5, 0.6], colors=[[1, 0, 0], [0, 1, 0]]
    )
    frame = picture(far_first, camera)
    np.testing.assert_allclose(frame.rgb[10, 10], [0.4 * 0.5, 0.6, 0], atol=1e-6)
    np.testing.assert_allclose(frame.transmittance[10, 10], 0.4 * 0.5, atol=1e-6)
    swapped = picture(far_first.take(np.array([1, 0])), camera)
    np.testing.assert_array_equal(frame.rgb, swapped.rgb)


def test_equal_depths_keep_the_order_of_the_file():
    """Of two Gaussians at one depth the first in the file is in front."""
    camera = straight()
    scene = gaussians([[0, 0, 5]] * 2, opacities=0.6, colors=[[1, 0, 0], [0, 0, 1]])
    rgb = picture(scene, camera).rgb[10, 10]
    np.testing.assert_allclose(rgb, [0.6, 0, 0.4 * 0.6], atol=1e-6)


@pytest.mark.parametrize("z", [-5.0, 0.0, 0.5, 8.0, 100.0])
def test_nothing_is_drawn_at_or_outside_the_near_and_far_planes(z):
    """near < z < far, strictly; behind the camera there is nothing."""
    frame = picture(gaussians([0, 0, z]), straight(near=0.5, far=8.0))
    assert (frame.transmittance == 1).all()
    assert (frame.rgb == 0).all()


def test_right_is_right_and_down_is_down():
    """+x of the camera is to the right in the picture and +y is downwards: not mirrored."""
    frame = picture(gaussians([[0.3, 0.1, 5]], scales=0.01), straight())
    y, x = np.unravel_index(frame.transmittance.argmin(), frame.transmittance.shape)
    assert (x, y) == (10 + 6, 10 + 2)


def test_a_gaussian_outside_the_border_still_reaches_in():
    """A mean outside the picture does not cull the tail that lies inside."""
    camera = straight()
    frame = picture(gaussians([-0.6, 0, 5], scales=0.1), camera)  # mean at x = -1.5
    assert frame.transmittance[10, 0] < 0.9
    assert frame.transmittance[10, 20] == 1


def test_a_one_pixel_picture_is_the_middle_pixel_of_a_larger_one():
    """Nothing depends on the picture's size but its edges."""
    scene = gaussians([[0, 0, 5], [0.01, 0, 6]], scales=0.05)
    large, small = picture(scene, straight(21, 21)), picture(scene, straight(1, 1))
    np.testing.assert_allclose(small.rgb[0, 0], large.rgb[10, 10], atol=1e-12)


def test_no_gaussians_give_an_empty_picture():
    """Zero Gaussians: rgb 0, transmittance 1, no error."""
    frame = picture(gaussians(np.zeros((0, 3)), sh=np.zeros((0, 1, 3))), straight())
    assert (frame.rgb == 0).all()
    assert (frame.transmittance == 1).all()


def test_alpha_is_capped_and_the_stopping_splat_is_not_drawn():
    """Opacity 1 covers 0.999; a second would leave 1e-6 <= 1e-4, so the pixel stops before it."""
    camera = straight()
    scene = gaussians([[0, 0, 4], [0, 0, 5]], scales=2, opacities=1, colors=[[1, 0, 0], [0, 1, 0]])
    frame = picture(scene, camera)
    np.testing.assert_allclose(frame.rgb[10, 10], [ALPHA_MAX, 0, 0], atol=1e-6)
    np.testing.assert_allclose(frame.transmittance[10, 10], 1 - ALPHA_MAX, atol=1e-12)
    ideal = picture(scene, camera, IDEAL)
    np.testing.assert_allclose(
        ideal.rgb[10, 10], [ALPHA_MAX, (1 - ALPHA_MAX) * ALPHA_MAX, 0], atol=1e-6
    )


def test_a_stopped_pixel_stays_stopped():
    """A faint splat behind the stopping one is not drawn, though it alone would not stop."""
    scene = gaussians(
        [[0, 0, 4], [0, 0, 5], [0, 0, 6]], scales=2, opacities=[1, 1, 0.1],
        colors=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    )  # fmt: skip
    assert picture(scene, straight()).rgb[10, 10, 2] == 0


def test_many_faint_layers_stop_in_the_middle_of_a_run():
    """300 layers of alpha 0.1 stop at the last whose transmittance stays above 1e-4."""
    n = 300
    scene = gaussians(
        np.stack([np.zeros(n), np.zeros(n), np.linspace(4, 6, n)], 1), scales=50, opacities=0.1,
        colors=(1, 1, 1),
    )  # fmt: skip
    frame = picture(scene, straight())
    layers = int(np.floor(np.log(1e-4) / np.log(0.9)))
    np.testing.assert_allclose(frame.transmittance[10, 10], 0.9**layers, rtol=1e-3)
    np.testing.assert_allclose(frame.rgb + frame.transmittance[..., None], 1, atol=1e-6)


@pytest.mark.parametrize(("factor", "drawn"), [(1.001, True), (0.999, False)])
def test_alpha_below_the_threshold_is_not_drawn(factor, drawn):
    """The cut is at 1/255, and only there."""
    scene = gaussians([0, 0, 5], opacities=ALPHA_THRESHOLD * factor)
    assert (picture(scene, straight()).transmittance[10, 10] < 1) is np.bool_(drawn)


def test_the_ideal_picture_has_the_tails_that_the_threshold_cuts():
    """Without a threshold alpha falls off to 1e-12 of itself, as the bell does."""
    camera = straight(101, 1)
    scene = gaussians([0, 0, 5], scales=0.3, opacities=0.9)
    cut, ideal = (picture(scene, camera, p) for p in (EXACT, IDEAL))
    x = grid(camera)[0] - 50.5
    want = np.float32(0.9) * np.exp(
        -(x**2) / 2 / ((100 / 5 * np.float64(np.float32(0.3))) ** 2 + EPS2D)
    )
    np.testing.assert_allclose(
        1 - ideal.transmittance[0], np.where(want > 1e-12, want, 0), atol=2e-12
    )
    assert (cut.transmittance[0] == 1).sum() > (ideal.transmittance[0] == 1).sum()


def test_colour_is_the_harmonic_series_in_the_direction_from_the_camera():
    """Degree 1: 0.5 + C0 sh0 + C1 (-y sh1 + z sh2 - x sh3), clamped below at 0, not above."""
    rng = np.random.default_rng(5)
    sh = rng.normal(0, 1, (1, 4, 3)).astype(np.float32)
    sh[0, :, 0] = [9, 0, 0, 0]
    sh[0, :, 1] = [-9, 0, 0, 0]
    mean = np.array([0.3, -0.4, 5])
    splats = reference.project(gaussians(mean, sh=sh), straight(), EXACT)
    stored = mean.astype(np.float32).astype(np.float64)
    x, y, z = stored / np.linalg.norm(stored)
    basis = np.array([0.28209479177387814, *(0.4886025119029199 * np.array([-y, z, -x]))])
    want = np.maximum(0.5 + basis @ sh[0].astype(float), 0)
    np.testing.assert_allclose(splats.colors[0], want, rtol=1e-12)
    assert splats.colors[0, 0] > 3
    assert splats.colors[0, 1] == 0


def test_harmonics_are_orthonormal():
    """The 16 functions are orthonormal over the sphere: no wrong constant, sign aside."""
    n = 40
    nodes, weights = np.polynomial.legendre.leggauss(n)
    phi = np.arange(2 * n) * np.pi / n
    s = np.sqrt(1 - nodes**2)
    directions = np.stack(
        np.broadcast_arrays(
            s[:, None] * np.cos(phi), s[:, None] * np.sin(phi), nodes[:, None]
        ), -1,
    )  # fmt: skip
    y = reference.sh_basis(directions, 3)
    gram = np.einsum("tpi,tpj,t->ij", y, y, weights) * np.pi / n
    np.testing.assert_allclose(gram, np.eye(16), atol=1e-12)


def test_antialiased_opacity_keeps_a_small_gaussians_energy():
    """opacity *= var / (var + 0.3) for a round one, so that opacity times area is kept."""
    camera = straight()
    scene = gaussians([0, 0, 5], scales=0.01, opacities=0.9)
    splats = reference.project(scene, camera, replace(EXACT, antialias=True))
    variance = (100 / 5 * np.float64(np.float32(0.01))) ** 2
    want = np.float32(0.9) * variance / (variance + EPS2D)
    np.testing.assert_allclose(splats.opacities, [want], rtol=1e-12)


def test_a_scene_far_from_the_origin_looks_as_it_does_at_the_origin():
    """Moved by 1e6 units with its camera, the picture stays the same to 1e-9."""
    near_scene = gaussians(np.random.default_rng(1).uniform(-1, 1, (40, 3)))
    shift = np.array([1e6, -2e6, 3e6])
    far_scene = replace(near_scene, origin=shift)
    eye = np.array([0.3, -1.0, -6.0])
    frames = [
        picture(scene, look_at(eye + offset, offset, (0, -1, 0), 50, 32, 24))
        for scene, offset in ((near_scene, np.zeros(3)), (far_scene, shift))
    ]
    np.testing.assert_allclose(frames[0].rgb, frames[1].rgb, atol=1e-7)


def test_what_overflows_float32_is_dropped_and_counted():
    """A Gaussian of 1e12 units at arm's length is not drawn as garbage but counted."""
    scene = gaussians([[0, 0, 1], [0, 0, 2]], scales=[1e12, 0.1])
    splats = reference.project(scene, straight(), EXACT)
    assert splats.overflowed == 1
    assert splats.gaussian_ids.tolist() == [1]


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.7853981, 1.2, 1.5707963])
@pytest.mark.parametrize("length", [1e1, 1e3, 1e5])
def test_the_factor_inverts_a_needles_covariance(length, angle):
    """U (A A^T + 0.3 I) U^T = I to 1e-9 for needles up to 1e5 px long, at any angle."""
    quat = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
    scene = gaussians([0, 0, 1], scales=[[length / 100, 1e-3, 1e-3]], quats=quat)
    splats = reference.project(scene, straight(), EXACT)
    u11, u12, u22 = splats.factors[0].astype(np.longdouble)
    turn = reference.rotations(scene.quats)[0].astype(np.longdouble)
    a = 100 * turn[:2] * scene.scales[0].astype(np.longdouble)
    cov = a @ a.T + EPS2D * np.eye(2, dtype=np.longdouble)
    # U cov U^T, worked out so that the oracle does not cancel either: rows of U A.
    u = np.array([[u11, u12], [0, u22]], np.longdouble)
    ua = u @ a
    got = ua @ ua.T + EPS2D * (u @ u.T)
    np.testing.assert_allclose(got.astype(float), np.eye(2), atol=1e-9)
    assert np.isfinite(cov.astype(float)).all()


def test_the_jacobian_is_held_at_the_border():
    """A Gaussian far off axis is not blown up: its slope ends 0.3 half fields past the edge."""
    camera = straight(20, 20, 10)  # half field of view: slope 1
    scene = gaussians([50, 0, 1], scales=1.0)
    splats = reference.project(
        scene, replace(camera, far=1e10), replace(EXACT, alpha_threshold=0.0)
    )
    assert len(splats) == 0  # it does not reach the picture
    near = reference.project(gaussians([3, 0, 1], scales=1.0), camera, EXACT)
    a1 = 10 * np.array([1, 0, -1.3])  # clamped from 3 to 1 + 0.3
    np.testing.assert_allclose(1 / near.factors[0, 2] ** 2, 100 + EPS2D, rtol=1e-12)
    var_x = near.factors[0, 2] ** 2  # 1 / var_y
    det = 1 / (near.factors[0, 0] ** 2 * var_x)
    np.testing.assert_allclose(det * var_x, a1 @ a1 + EPS2D, rtol=1e-12)


def test_bins_list_every_tile_of_any_size_and_the_picture_stays_the_same():
    """The tile size is not part of the picture: 1, 7, 16 and 64 px give the same to 1e-12."""
    rng = np.random.default_rng(3)
    scene = gaussians(
        rng.uniform(-1, 1, (60, 3)) + [0, 0, 6], scales=rng.uniform(0.01, 0.5, (60, 3))
    )
    splats = reference.project(scene, straight(45, 37), EXACT)
    order = reference.sort(splats)
    frames = [
        reference.composite(splats, reference.bin(splats, order, tile_size=size), EXACT)
        for size in (1, 7, 16, 64)
    ]
    for frame in frames[1:]:
        np.testing.assert_allclose(frame.rgb, frames[0].rgb, atol=1e-12)


def test_depth_is_weighted_like_colour():
    """Frame.depth = sum T alpha z: one Gaussian of alpha 0.8 at z = 5 gives 4."""
    params = replace(EXACT, depth=True)
    frame = reference.render(gaussians([0, 0, 5], scales=1.0), straight(), params)
    np.testing.assert_allclose(frame.depth[10, 10], 0.8 * 5, rtol=1e-6)


def test_float32_stays_within_1e_4_of_float64():
    """The reference in float32 is a backend like any other."""
    rng = np.random.default_rng(3)
    scene = gaussians(
        rng.uniform(-1, 1, (200, 3)) + [0, 0, 6], scales=rng.uniform(0.01, 0.5, (200, 3))
    )
    single, double = (picture(scene, straight(64, 48), p) for p in (RenderParams(), EXACT))
    assert single.rgb.dtype == np.float32
    assert abs(single.rgb - double.rgb).max() < 1e-4


def test_a_camera_may_be_anything_but_impossible():
    """An off-centre principal point outside the picture only moves the picture."""
    scene = gaussians([0, 0, 5], scales=0.2)
    camera = straight()
    k = camera.K.copy()
    k[0, 2] += 30
    moved = Camera(camera.viewmat, k, 61, 21)
    np.testing.assert_allclose(
        picture(scene, moved).rgb[:, 30:51], picture(scene, camera).rgb, atol=1e-12
    )


def test_underflow_is_no_error():
    """Alphas far away and light behind many layers are 0, even where NumPy is told to raise."""
    scene = gaussians([[0, 0, 4]] * 60, opacities=[1.0] * 60, scales=0.01)
    for float64 in (False, True):
        params = RenderParams(transmittance_min=0.0, float64=float64)
        with np.errstate(all="raise"):
            frame = picture(scene, straight(101, 101), params)
        assert frame.transmittance.min() < 1e-38
        assert frame.transmittance.max() == 1


def test_scene_rows_are_taken_in_order():
    """Scene.take keeps rows together; gaussian_ids say which row a splat came from."""
    scene = gaussians([[0, 0, 9], [0, 0, -1], [0, 0, 4]])
    splats = reference.project(scene, straight(), EXACT)
    assert splats.gaussian_ids.tolist() == [0, 2]
    assert isinstance(scene.take(np.array([2])), Scene)
