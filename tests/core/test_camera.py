"""Cameras: what they see, and which are refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsplat.core.camera import Camera, Fly, Orbit, intrinsics, look_at
from tsplat.core.errors import CameraError

FLOATS = st.floats(-3, 3)


def seen_at(camera, point):
    """Where a world point lands in the picture, px."""
    p = camera.viewmat[:3, :3] @ (np.asarray(point) - camera.centre)
    return (camera.K @ p / p[2])[:2]


def test_look_at_puts_the_target_in_the_middle_and_up_upwards():
    """The target is seen at the picture's centre; a point above it is seen above it."""
    camera = look_at((3, -2, -5), (1, 1, 1), (0, -1, 0), 50, 200, 100)
    np.testing.assert_allclose(seen_at(camera, (1, 1, 1)), (100, 50), atol=1e-9)
    x, y = seen_at(camera, (1, 0.9, 1))
    assert abs(x - 100) < 1e-9
    assert y < 50
    np.testing.assert_allclose(camera.centre, (3, -2, -5), atol=1e-12)


def test_fov_is_the_vertical_field_of_view():
    """A point at half the field's angle lies on the picture's edge."""
    camera = look_at((0, 0, 0), (0, 0, 1), (0, -1, 0), 60, 320, 200)
    edge = (0, np.tan(np.radians(30)), 1)
    np.testing.assert_allclose(seen_at(camera, edge), (160, 200), atol=1e-9)


@given(yaw=FLOATS, pitch=st.floats(-1.5, 1.5), distance=st.floats(0.1, 100))
def test_orbit_is_a_rotation_that_keeps_its_target_in_the_middle(yaw, pitch, distance):
    """Any yaw and pitch give a proper rotation, the target centred at the given distance."""
    orbit = Orbit(np.array([1.0, 2.0, 3.0]), distance, yaw, pitch, np.array([0.0, -1.0, 0.0]))
    camera = orbit.camera(50, 64, 48)
    np.testing.assert_allclose(seen_at(camera, orbit.target), (32, 24), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(camera.centre - orbit.target), distance, rtol=1e-9)
    above = camera.rotation @ orbit.up  # up has no sideways part: the horizon is level
    assert abs(above[0]) < 1e-9
    assert above[1] <= 1e-9


@pytest.mark.parametrize("up", [(0, -1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0), (1, -2, 3)])
@pytest.mark.parametrize("pitch", [-np.pi / 2, 0.0, np.pi / 2])
def test_orbit_works_at_the_poles_and_for_any_up(up, pitch):
    """Looking straight down is no special case; positive pitch looks down from above."""
    orbit = Orbit(np.zeros(3), 2.0, 0.4, pitch, np.array(up, float))
    camera = orbit.camera(50, 64, 48)
    height = camera.centre @ np.array(up) / np.linalg.norm(up)
    np.testing.assert_allclose(height, 2 * np.sin(pitch), atol=1e-12)


def test_panning_moves_the_target_along_the_cameras_axes():
    """Panned right, what was in the middle is seen to the left; panned up, below."""
    orbit = Orbit(np.zeros(3), 5.0, 0.7, 0.3, np.array([0.0, -1.0, 0.0]))
    x, y = seen_at(orbit.panned(1, 0).camera(50, 100, 100), (0, 0, 0))
    assert x < 50
    assert abs(y - 50) < 1e-9
    assert seen_at(orbit.panned(0, 1).camera(50, 100, 100), (0, 0, 0))[1] > 50


def test_fly_stands_where_it_is_put_and_moves_forward():
    """The eye is the camera's centre; moving forward goes along the line of sight."""
    fly = Fly(np.array([1.0, 2.0, 3.0]), 0.3, 0.2, np.array([0.0, -1.0, 0.0]))
    camera = fly.camera(50, 64, 48)
    np.testing.assert_allclose(camera.centre, fly.eye, atol=1e-12)
    ahead = fly.moved(0, 0, 2.0)
    np.testing.assert_allclose(ahead.eye - fly.eye, 2 * camera.rotation[2], atol=1e-12)


def test_resizing_scales_k_per_axis():
    """Twice as wide: fx and cx double; the same points lie at the same share of the picture."""
    camera = look_at((0, 0, -5), (0, 0, 0), (0, -1, 0), 50, 100, 80)
    wide = camera.resized(200, 80)
    np.testing.assert_allclose(seen_at(wide, (1, 1, 1)), seen_at(camera, (1, 1, 1)) * [2, 1])


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"viewmat": np.diag([-1.0, 1, 1, 1])}, "reflection"),
        ({"viewmat": np.diag([2.0, 1, 1, 1])}, "orthonormal"),
        ({"viewmat": np.diag([1e200, 1, 1, 1])}, "orthonormal"),
        ({"viewmat": np.eye(4).T + np.eye(4, k=-3)}, "last row"),
        ({"viewmat": np.full((4, 4), np.nan)}, "finite"),
        ({"viewmat": np.eye(3)}, "4 x 4"),
        ({"K": np.array([[1, 0.1, 0], [0, 1, 0], [0, 0, 1]])}, "skew"),
        ({"K": np.diag([-1.0, 1, 1])}, "focal"),
        ({"width": 0}, "size"),
        ({"width": 1 << 20, "height": 1 << 20}, "size"),
        ({"near": 2.0, "far": 1.0}, "near"),
        ({"near": float("nan")}, "near"),
        ({"far": float("nan")}, "near"),
        ({"near": 2e31, "far": float("inf")}, "near"),
    ],
)
def test_impossible_cameras_are_refused_with_the_reason(change, word):
    """Each kind of impossible camera has an error that names what is wrong with it."""
    good = {"viewmat": np.eye(4), "K": intrinsics(10, 10, 50), "width": 10, "height": 10}
    with pytest.raises(CameraError, match=word):
        Camera(**{**good, **change})


def test_the_far_plane_is_within_float32():
    """An infinite one is taken for 1e31: farther depths would be infinite in Frame.depth."""
    camera = Camera(np.eye(4), intrinsics(10, 10, 50), 10, 10, far=float("inf"))
    assert camera.far == 1e31


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (((0, 0, 0), (0, 0, 0), (0, 1, 0), 50), "differ"),
        (((0, 0, 0), (0, 1, 0), (0, 2, 0), 50), "line of sight"),
        (((0, 0, 0), (0, 0, 1), (0, 0, 0), 50), "up"),
        (((0, 0, 0), (0, 0, 1), (0, 1, 0), 180), "fov"),
        (((0, 0, float("inf")), (0, 0, 1), (0, 1, 0), 50), "differ"),
    ],
)
def test_look_at_refuses_what_has_no_answer(arguments, word):
    """Same eye and target, up along the line of sight, no field of view."""
    with pytest.raises(CameraError, match=word):
        look_at(*arguments, 10, 10)
