"""Framing: the content fills the picture, strays do not count, and any scene can be framed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.conftest import DATA
from tsplat.core.camera import Camera, look_at
from tsplat.core.errors import CameraError
from tsplat.core.types import Scene, Up
from tsplat.io import load_scene, scene_from_arrays
from tsplat.views import (
    FOV,
    UP,
    YAW,
    clip_planes,
    frame_orbit,
    frame_scene,
    scene_extent,
    up_of,
    up_of_cameras,
)


def scene_of(points, opacities=1.0, scale=1e-3, origin=(0, 0, 0)) -> Scene:
    """Small round Gaussians at ``points``."""
    n = len(points)
    return scene_from_arrays(
        np.asarray(points, np.float32).reshape(n, 3),
        np.tile([1.0, 0, 0, 0], (n, 1)),
        np.full((n, 3), scale),
        np.broadcast_to(opacities, n),
        np.zeros((n, 3)),
        origin=origin,
    )


def ball(n=3000, radius=10.0, seed=0):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1)[:, None] * radius * rng.uniform(0, 1, (n, 1))


def on_picture(scene: Scene, camera: Camera) -> np.ndarray:
    """[N, 2] in half pictures from the middle: within -1..1 is inside; NaN behind near."""
    p = (scene.means.astype(np.float64) + scene.origin - camera.centre) @ camera.rotation.T
    uv = p @ camera.K.T / np.where(p[:, 2:] > camera.near, p[:, 2:], np.nan)
    return uv[:, :2] / [camera.width / 2, camera.height / 2] - 1


@settings(max_examples=40, deadline=None)
@given(
    size=st.sampled_from([(320, 200), (100, 900), (1, 1), (80, 24), (2000, 50)]),
    fov=st.floats(5, 120),
    stretch=st.tuples(*[st.sampled_from([0.0, 0.1, 1.0, 8.0])] * 3),
    yaw=st.floats(-7, 7),
    pitch=st.floats(-1.5, 1.5),
    scale=st.sampled_from([1e-4, 1.0, 1e5]),
)
def test_content_is_inside_and_fills_the_picture(size, fov, stretch, yaw, pitch, scale):
    """Of any shape, size and direction: 97 % of the Gaussians are in the picture."""
    points = ball(500) * stretch * scale
    scene = scene_of(points, scale=1e-3 * scale)
    camera = frame_scene(scene, *size, fov=fov, yaw=yaw, pitch=pitch)
    where = on_picture(scene, camera)
    assert (np.abs(where) <= 1).all(1).mean() >= 0.97  # NaN, behind the camera, is not inside


@pytest.mark.parametrize("size", [(320, 200), (200, 320)])
def test_a_ball_fills_the_tighter_direction(size):
    """A round scene reaches at least 80 % of the way to the nearer border, and not past it."""
    scene = scene_of(ball())
    where = np.abs(on_picture(scene, frame_scene(scene, *size)))
    tight = 1 if size[0] > size[1] else 0
    assert 0.8 < np.quantile(where[:, tight], 0.999) < 1


@pytest.mark.parametrize("stray", [1000.0, 2e7, -3e30])
def test_strays_do_not_count(stray):
    """One opaque Gaussian at 1000, 2e7 or 3e30 moves the camera by less than 2 % of the content."""
    points = ball()
    plain = scene_extent(scene_of(points))
    extent = scene_extent(scene_of(np.vstack([points, [[stray, 0, 0]]])))
    assert np.abs(extent.centre - plain.centre).max() < 0.2
    assert abs(extent.radius - plain.radius) < 0.2


def test_a_shell_far_around_does_not_count():
    """5 % of all Gaussians on a sky shell of radius 240, as Scaniverse writes them, are strays."""
    shell = ball(150, seed=1)
    shell *= 240 / np.linalg.norm(shell, axis=1)[:, None]
    extent = scene_extent(scene_of(np.vstack([ball(), shell])))
    assert extent.radius < 15


def test_opacity_counts():
    """A cloud of nearly transparent Gaussians next to the content is not content."""
    points = np.vstack([ball(1000), np.add(ball(3000), [500, 0, 0])])
    opacities = np.concatenate([np.full(1000, 1.0), np.full(3000, 0.002)])
    extent = scene_extent(scene_of(points, opacities))
    assert np.abs(extent.centre).max() < 1


@pytest.mark.parametrize(
    ("points", "scale"),
    [
        ([], 1.0),
        ([[1, 2, 3]], 0.5),
        ([[1, 2, 3]], 0.0),
        ([[1, 2, 3]] * 50, 0.25),
        ([[1, 2, 3], [1, 2, 9]], 0.0),
    ],
)
def test_scenes_of_nearly_nothing(points, scale):
    """None, one, and coincident Gaussians, of no size too: a camera that has them in its middle."""
    scene = scene_of(points, scale=scale, origin=(5e6, 0, 0))
    camera = frame_scene(scene, 64, 48)
    extent = scene_extent(scene)
    assert extent.radius > 0
    ahead = camera.rotation @ (extent.centre - camera.centre)
    np.testing.assert_allclose(ahead[:2], 0, atol=1e-6)
    assert ahead[2] > extent.radius
    assert camera.near < ahead[2] - extent.radius
    if len(points) == 1 and scale:
        assert 3 < 48 / 2 / (camera.K[1, 1] * scale / ahead[2]) * 2 < 12  # a tenth to a third


def test_all_transparent_scenes_can_be_framed():
    """Where no Gaussian has opacity, all count the same."""
    assert scene_extent(scene_of(ball(), 0.0)).radius > 5


def test_origin_is_part_of_the_place():
    """A scene at 4e6 is framed as at 0, moved."""
    here, there = scene_of(ball()), scene_of(ball(), origin=(4e6, -1e6, 7))
    a, b = frame_scene(here, 80, 60), frame_scene(there, 80, 60)
    np.testing.assert_allclose(b.centre - a.centre, [4e6, -1e6, 7], atol=1e-6)


def test_up_is_up_and_default_is_minus_y():
    """What is farther along up is higher in the picture, whatever up is."""
    points = ball(200)
    for up in (UP.direction, (0, 1, 0), (0, 0, 1), (3, -4, 5)):
        scene = scene_of(points)
        camera = frame_scene(scene, 64, 64, up=up)
        axis = np.array(up) / np.linalg.norm(up)
        assert (camera.rotation @ axis)[1] < -0.9
    assert (frame_scene(scene_of(points), 64, 64).rotation @ [0, 1, 0])[1] > 0.9


def test_up_is_what_the_file_says():
    """What a scene says is up is up in its picture, unless another is asked for."""
    scene = replace(scene_of(ball(200)), up=Up((0.0, 0.0, 1.0), "the file says"))
    assert (frame_scene(scene, 64, 64).rotation @ [0, 0, 1])[1] < -0.9
    assert (frame_scene(scene, 64, 64, up=(1, 0, 0)).rotation @ [1, 0, 0])[1] < -0.9
    assert up_of(scene).direction == (0, 0, 1)
    assert up_of(scene_of(ball(200))) == UP


def test_up_of_cameras_is_their_mean():
    """Cameras round a tilted scene that look down at it: what is up in all of them is up."""
    up = np.array([0.3, -0.2, 0.9]) / np.linalg.norm([0.3, -0.2, 0.9])
    side = np.cross(up, [1, 0, 0])
    side /= np.linalg.norm(side)
    other = np.cross(up, side)
    turns = np.linspace(0, 2 * math.pi, 12, endpoint=False)
    cameras = [
        look_at(3 * (math.cos(t) * side + math.sin(t) * other + 0.6 * up), (0, 0, 0), up, 60, 9, 9)
        for t in turns
    ]
    found = up_of_cameras(np.stack([c.rotation for c in cameras]), "a.json")
    np.testing.assert_allclose(found.direction, up, atol=1e-6)
    assert found.why == "upwards in the 12 pictures of a.json"
    around = [look_at((0, 0, 0), (0, 0, 1), (math.cos(t), math.sin(t), 0), 60, 9, 9) for t in turns]
    assert up_of_cameras(np.stack([c.rotation for c in around]), "a.json") is None


@pytest.mark.parametrize("begin", [YAW, math.pi / 2])
def test_an_orbit_keeps_the_content_in_the_picture_all_round(begin):
    """A wide, flat scene stays inside at every yaw, not only where the orbit begins."""
    scene = scene_of(ball() * [5, 0.3, 0.5])
    orbit = frame_orbit(scene, 100, 200, yaw=begin)
    assert orbit.yaw == begin
    for yaw in np.linspace(0, 2 * math.pi, 37):
        camera = replace(orbit, yaw=float(yaw)).camera(FOV, 100, 200)
        where = on_picture(scene, camera)
        assert (np.abs(where) <= 1).all(1).mean() > 0.97


def test_frame_scene_is_where_the_orbit_begins():
    """Picture and viewer start from the same place."""
    scene = scene_of(ball())
    camera = frame_scene(scene, 320, 200)
    again = frame_orbit(scene, 320, 200).camera(FOV, 320, 200)
    np.testing.assert_array_equal(camera.viewmat, again.viewmat)


def test_clip_planes_follow_the_unit():
    """Near is far nearer than content of any unit, and far beyond it."""
    for distance in (1e-6, 1.0, 1e12):
        near, far = clip_planes(distance)
        assert near <= distance * 1e-3
        assert far >= distance * 1e3


def test_the_same_scene_gives_the_same_view():
    """A scene larger than the sample is framed the same on every run, and fast enough to bear."""
    scene = scene_of(ball(100_000))
    a, b = frame_scene(scene, 320, 200), frame_scene(scene, 320, 200)
    np.testing.assert_array_equal(a.viewmat, b.viewmat)


@pytest.mark.parametrize("up", [(0, 0, 0), (1, 2), (0, math.nan, 1)])
def test_bad_up(up):
    """An up that is no direction is refused."""
    with pytest.raises(CameraError, match="up: expected three finite numbers"):
        frame_scene(scene_of(ball(9)), 64, 48, up=up)


@pytest.mark.parametrize(("fov", "size"), [(0, (9, 9)), (180, (9, 9)), (50, (0, 9))])
def test_bad_fov_and_size(fov, size):
    """No camera can be made of these."""
    with pytest.raises(CameraError):
        frame_scene(scene_of(ball(9)), *size, fov=fov)


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no real files: $TSPLAT_DATA or {DATA} is absent")
@pytest.mark.parametrize(
    "name",
    [
        "formats/leica-8k-sh3/leica-8k-sh3.gf.ply",
        "formats/plant-114k-sh0/plant-114k-sh0.st.ply",
        "formats/playbot-31k-sh2/playbot-31k-sh2.st.ply",
        "large/playbot-125k-sh2.ply",
        "gaussforge/tiny_gauss.ply",
        "gausplat-renderer/sixstars.3dgs.ply",
        "splatapult/test.ply",
        "jsplat/unitCube-ascii.ply",
        "epfl-web/pc_short.ply",
    ],
)
def test_real_scenes_are_in_the_picture(name):
    """Nine real files: 95 % of the opacity is inside the picture and spans 0.4 of it or more."""
    scene = load_scene(DATA / name)
    where = np.abs(on_picture(scene, frame_scene(scene, 320, 200)))
    inside = (where <= 1).all(1)
    assert scene.opacities[inside].sum() >= 0.95 * scene.opacities.sum()
    assert where[inside].max() > 0.4
