"""Camera paths: through the poses given, a rotation everywhere, smooth; an orbit is a circle."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.conftest import ROOT, straight
from tsplat.core.camera import Camera, Orbit, intrinsics, look_at
from tsplat.core.errors import CameraError
from tsplat.core.reference import rotations as matrix
from tsplat.io.cameras import camera_to_json
from tsplat.paths import Path, load_path, quaternion, slerp, turned

number = st.floats(-1.0, 1.0)
seeds = st.integers(0, 2**32 - 1)


def pose(rng, spread=0.8):
    """A camera somewhere near (0, 0, -5), turned and tilted, with a lens of its own."""
    quat = np.array([1, 0, 0, 0]) + rng.normal(0, spread, 4)
    viewmat = np.eye(4)
    viewmat[:3, :3] = matrix(quat / np.linalg.norm(quat))
    viewmat[:3, 3] = -viewmat[:3, :3] @ (rng.normal(0, 2, 3) - (0, 0, 5))
    K = intrinsics(64, 48, rng.uniform(30, 90))
    K[:2, 2] += rng.normal(0, 2, 2)
    return Camera(viewmat, K, 64, 48, 0.1 + rng.random(), 50 + rng.random())


def path_of(seed, count=5):
    """Random poses at uneven times."""
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.3, 2.0, count - 1))])
    return Path(tuple(pose(rng) for _ in range(count)), times)


def kink(way, time, step=1e-5):
    """How much the velocity of ``way`` (seconds -> array) jumps at ``time``."""
    before = (way(time) - way(time - step)) / step
    after = (way(time + step) - way(time)) / step
    return abs(after - before).max()


def at_place(path):
    return lambda time: path.camera(time).centre


def turning(path):
    return lambda time: path.camera(time).rotation


@settings(max_examples=30)
@given(seeds)
def test_every_pose_is_reached_to_the_bit(seed):
    """At its time the camera is the pose itself; before the begin and after the end it stays."""
    path = path_of(seed)
    for given_pose, time in zip(path.poses, path.times, strict=True):
        assert path.camera(float(time)).same(given_pose)
    assert path.camera(-1.0).same(path.poses[0])
    assert path.camera(path.seconds + 1).same(path.poses[-1])


@settings(max_examples=30)
@given(seeds, st.floats(0, 1))
def test_in_between_it_is_a_camera(seed, share):
    """A rotation to the last digits, a lens and planes between those of its neighbours."""
    path = path_of(seed)
    camera = path.camera(share * path.seconds)
    rotation = camera.rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-13)
    assert np.linalg.det(rotation) > 0
    for value in (lambda c: c.K[0, 0], lambda c: c.K[1, 1], lambda c: c.near, lambda c: c.far):
        values = [value(p) for p in path.poses]
        assert min(values) - 1e-9 <= value(camera) <= max(values) + 1e-9


@settings(max_examples=30)
@given(seeds)
def test_it_is_smooth_at_the_poses(seed):
    """Position and rotation arrive at a pose and next to it, and with one velocity."""
    path = path_of(seed)
    for way in (at_place(path), turning(path)):
        for time in map(float, path.times[1:-1]):
            assert abs(way(time + 1e-7) - way(time)).max() < 1e-5
            assert kink(way, time) < 1e-2  # a bend's part; it vanishes with the step


def test_the_measure_of_smoothness_sees_straight_legs():
    """Poses joined by straight lines, and by turns at a constant rate, have kinks."""
    path = path_of(3)
    time = float(path.times[2])

    def leg_by_leg(seconds):
        leg = 1 if seconds < time else 2
        begin, end = path.times[leg], path.times[leg + 1]
        share = (seconds - begin) / (end - begin)
        a, b = path.poses[leg], path.poses[leg + 1]
        quat = slerp(quaternion(a.rotation), quaternion(b.rotation), share)
        return np.vstack([(1 - share) * a.centre + share * b.centre, matrix(quat)])

    assert kink(lambda t: leg_by_leg(t)[0], time) > 0.1
    assert kink(lambda t: leg_by_leg(t)[1:], time) > 0.1


def test_a_parabola_is_followed_as_it_is():
    """Positions and angles that are quadratic in time: inner legs have them, at any knots."""
    times = np.array([0.0, 0.5, 1.5, 1.75, 3.0])

    def at(t):
        quat = np.array([math.cos(0.1 * t * t), 0, math.sin(0.1 * t * t), 0])
        viewmat = np.eye(4)
        viewmat[:3, :3] = matrix(quat)
        viewmat[:3, 3] = -viewmat[:3, :3] @ np.array([t, 2 * t * t, 1 - t * t])
        return Camera(viewmat, intrinsics(10, 10, 50), 10, 10)

    path = Path(tuple(at(t) for t in times), times)
    for t in np.linspace(0.5, 1.75, 23):
        np.testing.assert_allclose(path.camera(t).viewmat, at(t).viewmat, atol=1e-12)
    assert abs(path.camera(2.9).centre - at(2.9).centre).max() > 1e-3  # an end leg is another curve


def test_two_poses_make_a_straight_line_at_a_constant_rate():
    """Half of the time is half of the way, of the turn and of the change of the lens."""
    rng = np.random.default_rng(8)
    a, b = pose(rng), pose(rng)
    path = Path((a, b), np.array([0.0, 2.0]))
    middle, quarter = path.camera(1.0), path.camera(0.5)
    np.testing.assert_allclose(middle.centre, (a.centre + b.centre) / 2, atol=1e-12)
    np.testing.assert_allclose(quarter.centre, 0.75 * a.centre + 0.25 * b.centre, atol=1e-12)
    half = quarter.rotation @ a.rotation.T
    np.testing.assert_allclose(half @ half, middle.rotation @ a.rotation.T, atol=1e-12)
    np.testing.assert_allclose(half @ half @ half @ half, b.rotation @ a.rotation.T, atol=1e-12)

    def fov(camera):
        return math.atan(camera.height / 2 / camera.K[1, 1])

    assert math.isclose(fov(middle), (fov(a) + fov(b)) / 2)
    np.testing.assert_allclose(middle.K[:2, 2], (a.K[:2, 2] + b.K[:2, 2]) / 2)


def test_a_quaternion_and_its_negative_are_the_same_rotation():
    """The camera takes the short way round, whatever the sign that a matrix gives."""
    begin, end = (look_at((0, 0, 0), (math.sin(a), 0, math.cos(a)), (0, -1, 0), 50, 8, 8)
                  for a in (2.9, 3.5))  # fmt: skip
    forward = Path((begin, end), np.array([0.0, 1.0])).camera(0.5).rotation[2]
    np.testing.assert_allclose(forward, (math.sin(3.2), 0, math.cos(3.2)), atol=1e-12)


def test_a_pose_given_twice_is_a_pause():
    """Between the two nothing moves, and the camera comes to rest before."""
    rng = np.random.default_rng(1)
    a, b, c = pose(rng), pose(rng), pose(rng)
    path = Path((a, b, b, c), np.array([0.0, 1, 2, 3]))
    for time in (1.0, 1.2, 1.9):
        np.testing.assert_allclose(path.camera(time).viewmat, b.viewmat, atol=1e-12)
    assert kink(at_place(path), 1.0) < 1e-2
    assert kink(at_place(path), 2.0) < 1e-2


def test_a_path_that_ends_where_it_began_goes_round():
    """The velocity at the end is that of the begin, which that of an open path is not."""
    path = path_of(11)
    closed = Path((*path.poses, path.poses[0]), np.append(path.times, path.seconds + 1))
    assert closed.closed
    assert not path.closed
    step = 1e-6
    for way in (at_place(closed), turning(closed)):
        first = (way(step) - way(0.0)) / step
        last = (way(closed.seconds) - way(closed.seconds - step)) / step
        np.testing.assert_allclose(first, last, atol=1e-3)
    way = at_place(replace(closed, poses=(*closed.poses[:-1], pose(np.random.default_rng(0)))))
    assert abs((way(step) - way(0.0)) / step - first[0]).max() > 1e-2


def test_far_from_the_origin_it_is_as_smooth():
    """At 1e6 units positions keep what float64 has of them."""
    far = np.array([1e6, -2e6, 5e5])

    def moved(camera):
        viewmat = camera.viewmat.copy()
        viewmat[:3, 3] = -camera.rotation @ (camera.centre + far)
        return replace(camera, viewmat=viewmat)

    path = path_of(4)
    other = Path(tuple(map(moved, path.poses)), path.times)
    for time in np.linspace(0, path.seconds, 17):
        gap = other.camera(time).centre - far - path.camera(time).centre
        assert abs(gap).max() < 1e-8


@given(st.tuples(number, number, number, number).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_matrix_and_quaternion_are_inverses(numbers):
    """Up to the sign, for every rotation; a matrix that is slightly off gives the nearest."""
    quat = np.array(numbers) / np.linalg.norm(numbers)
    got = quaternion(matrix(quat) + 1e-6)
    assert abs(abs(got @ quat) - 1) < 1e-5
    np.testing.assert_allclose(matrix(quaternion(matrix(quat))), matrix(quat), atol=1e-12)


# --- files


def entries(path, times=()):
    """As a file has them."""
    listed = [camera_to_json(p) for p in path.poses]
    for entry, time in zip(listed, times, strict=False):
        entry["time"] = time
    return listed


def written(tmp_path, value):
    file = tmp_path / "path.json"
    file.write_text(json.dumps(value))
    return file


def test_a_file_with_times(tmp_path):
    """The times are the file's, counted from its first."""
    path = path_of(2)
    times = [3.0, 3.5, 5, 8, 8.25]
    read = load_path(written(tmp_path, entries(path, times)))
    assert read.times.tolist() == [0, 0.5, 2, 5, 5.25]
    assert all(a.same(b) for a, b in zip(read.poses, path.poses, strict=True))


def test_a_file_without_times_goes_by_distance(tmp_path):
    """Legs take as long as they are; one second on average; a pose given twice is left out."""
    places = [0.0, 1.0, 1.0, 4.0, 6.0]
    eyes = [replace(straight(), viewmat=np.array(look_at(
        (x, 0, 0), (x, 0, 1), (0, -1, 0), 50, 9, 9).viewmat)) for x in places]  # fmt: skip
    read = load_path(written(tmp_path, [camera_to_json(c) for c in eyes]))
    assert len(read.poses) == 4
    np.testing.assert_allclose(np.diff(read.times), np.array([1, 3, 2]) / 2)


def test_turning_on_the_spot_takes_time(tmp_path):
    """A full turn is as far as all of the way; where nothing else moves, angles alone count."""

    def looking(x, degrees):
        a = math.radians(degrees)
        return look_at((x, 0, 0), (x + math.sin(a), 0, math.cos(a)), (0, -1, 0), 50, 9, 9)

    way = [looking(0, 0), looking(4, 0), looking(4, 90)]
    read = load_path(written(tmp_path, [camera_to_json(c) for c in way]))
    assert math.isclose(read.times[2] - read.times[1], read.times[1] / 4)
    spot = [looking(0, 0), looking(0, 30), looking(0, 120)]
    read = load_path(written(tmp_path, [camera_to_json(c) for c in spot]))
    np.testing.assert_allclose(np.diff(read.times), [0.5, 1.5])


def test_inrias_cameras_are_a_path(tmp_path):
    """cameras.json as the trainer writes it; the first one's size is everybody's."""
    entry = {"id": 0, "img_name": "a", "width": 40, "height": 20, "position": [1, 2, 3],
             "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 30.0, "fy": 31}  # fmt: skip
    other = {**entry, "position": [2, 2, 3], "width": 80, "height": 40, "fx": 60.0, "fy": 62}
    read = load_path(written(tmp_path, [entry, other]))
    assert [(c.width, c.height, c.K[0, 0]) for c in read.poses] == [(40, 20, 30), (40, 20, 30)]
    np.testing.assert_allclose(read.camera(0.5).centre, (1.5, 2, 3))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda e: e[:1], "two poses"),
        (lambda e: [e[0], e[0]], "two poses that differ"),
        (lambda e: [{**e[0], "time": 1}, e[1]], "some have none"),
        (lambda e: [{**e[0], "time": 1}, {**e[1], "time": 1}], "times that increase"),
        (lambda e: [{**e[0], "time": "noon"}, e[1]], "camera 0: time: expected a number"),
        (lambda e: [{**e[0], "time": 0}, {**e[1], "time": math.inf}], "not JSON"),
        (lambda e: [], "an empty list"),
    ],
)
def test_what_is_no_path_is_refused(tmp_path, change, text):
    """One line with the file's name and what is wrong."""
    file = written(tmp_path, change(entries(path_of(5))))
    with pytest.raises(CameraError, match=text) as caught:
        load_path(file)
    assert str(file) in str(caught.value)


# --- once round, and other shapes of picture


def test_turned_is_an_orbit_of_higher_yaw():
    """The camera of an Orbit carried round its target is the Orbit's at that yaw."""
    orbit = Orbit(np.array([1.0, 2, 3]), 4.0, 0.3, 0.2, np.array([0, -1, 0.2]))
    camera = orbit.camera(50, 64, 48)
    for angle in (0.7, -2.0, 5.5):
        there = replace(orbit, yaw=orbit.yaw + angle).camera(50, 64, 48)
        got = turned(camera, orbit.target, orbit.up, angle)
        np.testing.assert_allclose(got.viewmat, there.viewmat, atol=1e-12)
    assert turned(camera, orbit.target, orbit.up, 0.0) is camera


def test_reframed_keeps_the_height_of_view():
    """A point on the axis or above it stays at its share of the height; pixels stay square."""
    camera = straight(64, 48, 50.0)
    other = camera.reframed(200, 96)
    assert (other.width, other.height) == (200, 96)
    assert other.K.tolist() == [[100, 0, 100], [0, 100, 48], [0, 0, 1]]
    assert camera.reframed(64, 48).same(camera)


def test_the_pages_path_is_one(tmp_path):
    """The example of docs/films.md can be read, and is what the page says."""
    (text,) = re.findall(r"```json\n(.*?)```", (ROOT / "docs" / "films.md").read_text(), re.S)
    file = tmp_path / "path.json"
    file.write_text(text)
    path = load_path(file)
    assert path.times.tolist() == [0, 2.5]
    np.testing.assert_allclose(path.poses[0].centre, (0, 0, -5))
    np.testing.assert_allclose(path.poses[1].centre, (3, -1, -4))
    np.testing.assert_allclose(path.poses[1].rotation[2], (-0.6, 0, 0.8))
