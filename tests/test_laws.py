"""The laws of tsplat.testing.laws hold for every built-in backend; and what they are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import ROOT, gaussians, straight
from tsplat.core import reference
from tsplat.core.camera import look_at
from tsplat.core.params import RenderParams
from tsplat.core.stages import Backend, Stages
from tsplat.core.workspace import Workspace
from tsplat.plugins import load_backend, plugins
from tsplat.testing import laws
from tsplat.testing.checks import Case
from tsplat.testing.strategies import make_scene

BACKENDS = [plugins().backends[name] for name in ("numpy", "numba", "cffi")]


@pytest.mark.parametrize(
    "check", [check for b in BACKENDS for check in laws.law_checks(b, 20)], ids=str
)
def test_laws(check):
    """The backend obeys this law."""
    check()


def test_a_backend_of_one_stage_is_held_to_every_law():
    """What it does not offer the reference fills in; and its own stage is the one that is used."""
    calls = []

    def sort(splats, workspace):
        calls.append(len(splats))
        return reference.sort(splats)

    sorter = Backend("sorter", "sorts only", lambda: Stages(sort=sort), stages=("sort",))
    checks = laws.law_checks(sorter, max_examples=3)
    assert [str(check) for check in checks] == [f"sorter-{name}" for name in laws.LAWS]
    for check in checks:
        check()
    assert len(calls) > 3 * len(checks)


@pytest.mark.parametrize("backend", BACKENDS[1:], ids=lambda b: b.name)
@pytest.mark.parametrize("size", [32, 48])
def test_tiles_of_whole_patches_have_the_same_bits(backend, size):
    """Tiles are cut into patches of 16 px from their corner: multiples of that change nothing."""
    composite = load_backend(backend).composite
    scene = make_scene(1, 400, 1, frozenset({"opaque", "needles", "faint"}))
    case = Case(scene, look_at((0, 0, -6), (0, 0, 0), (0, -1, 0), 50, 70, 53))
    frames = [
        composite(case.splats, reference.bin(case.splats, case.order, tile_size=tile),
                  case.params, Workspace(2))
        for tile in (16, size)
    ]  # fmt: skip
    assert laws.same_bits(*frames, "tiles") == []
    assert (frames[0].transmittance < 0.5).mean() > 0.1


def a_rotation(seed):
    """Any rotation matrix."""
    quat = np.random.default_rng(seed).normal(size=4)
    return reference.rotations(quat / np.linalg.norm(quat))


def test_coefficients_of_degree_1_turn_like_a_vector():
    """0.49 (-y, z, -x) . (s1, s2, s3) is the product of v with (-s3, -s1, s2), which turns."""
    rotation = a_rotation(1)
    sh = np.array([0.3, 0.5, -0.2, 0.7])
    vector = rotation @ [-sh[3], -sh[1], sh[2]]
    by_hand = [sh[0], -vector[1], vector[2], -vector[0]]
    np.testing.assert_allclose(laws.sh_rotation(rotation, 1) @ sh, by_hand, atol=1e-13)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_turned_coefficients_look_to_a_turned_direction_as_before(degree):
    """Y(R v) . M s = Y(v) . s at directions that M was not solved from; and M is orthogonal."""
    rotation, rng = a_rotation(degree), np.random.default_rng(7)
    turn = laws.sh_rotation(rotation, degree)
    v = rng.normal(size=(20, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    sh = rng.normal(size=(degree + 1) ** 2)
    turned = reference.sh_basis(v @ rotation.T, degree) @ (turn @ sh)
    np.testing.assert_allclose(turned, reference.sh_basis(v, degree) @ sh, atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(len(sh)), atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), signs=st.tuples(*[st.sampled_from((1, -1))] * 3))
def test_flipping_is_exact(seed, signs):
    """Covariances become D C D, colours stay, and only signs change."""
    scene = make_scene(seed, 5, 3, frozenset())
    flipped, d = laws.flipped(scene, signs), np.diag(signs)
    assert (abs(flipped.quats) == abs(scene.quats)).all()
    assert (flipped.means == scene.means * np.array(signs)).all()
    before, after = (
        reference.rotations(s.quats) * s.scales[:, None, :].astype(np.float64)
        for s in (scene, flipped)
    )
    want = d @ before @ before.transpose(0, 2, 1) @ d
    np.testing.assert_allclose(after @ after.transpose(0, 2, 1), want, rtol=1e-12)
    v = np.array([[0.6, -0.48, 0.64]])
    np.testing.assert_allclose(
        reference.sh_basis(v * np.array(signs), 3) @ flipped.sh,
        reference.sh_basis(v, 3) @ scene.sh, atol=1e-12,
    )  # fmt: skip


def test_a_moved_camera_sees_moved_points_where_they_were():
    """A point turned and shifted has the camera coordinates it had."""
    camera = replace(straight(), viewmat=np.eye(4))
    camera = laws.moved(camera, a_rotation(3), np.array([4.0, 5, 6]))
    turn, shift = a_rotation(5), np.array([1.0, -2, 30])
    points = np.random.default_rng(0).normal(size=(9, 3))
    scene = replace(gaussians(points), origin=np.array([1.0, 2, 3]))
    moved = laws.moved(camera, turn, shift)
    _, p = reference.camera_space(scene, camera, slice(0, 9))
    world = (scene.means + scene.origin) @ turn.T + shift
    got = (world - moved.centre) @ moved.rotation.T
    np.testing.assert_allclose(got, p, atol=1e-12)


def test_placed_balls_are_where_they_should_be():
    """At their pixel and depth, in their colour, or behind the camera through its centre."""
    camera = laws.moved(straight(), a_rotation(2), np.array([1.0, 2, 3]))
    like = make_scene(0, 1, 2, frozenset({"far origin"}))
    camera = laws.moved(camera, np.eye(3), like.origin)
    balls = laws.placed(like, camera, [[5, 7], [5, 7]], [3, -3], 0.1, 0.9, (0.1, 0.6, 1.2))
    splats = reference.project(balls, camera, RenderParams())
    np.testing.assert_allclose(splats.means2d, [[5, 7]], atol=1e-4)
    np.testing.assert_allclose(splats.depths, [3], atol=1e-5)
    np.testing.assert_allclose(splats.colors, [[0.1, 0.6, 1.2]], atol=1e-6)
    np.testing.assert_allclose(laws.camera_depths(balls, camera), [3, -3], atol=1e-5)


def test_joined_rows_keep_the_order_that_each_scene_had():
    """Rows are merged, not shuffled; new numbers come after the old."""
    rng = np.random.default_rng(0)
    old, new = (make_scene(seed, 20, 1, frozenset()) for seed in (1, 2))
    both = laws.joined(old, new, rng)
    ours = np.array([np.flatnonzero((both.means == m).all(axis=1))[0] for m in old.means])
    assert (np.diff(ours) > 0).all()
    assert (np.diff(ours) > 1).any()
    assert both.numbers is None
    numbered = replace(old, numbers=np.arange(20, dtype=np.int32)[::-1].copy())
    both = laws.joined(numbered, new, rng)
    assert sorted(both.numbers) == list(range(40))
    assert [n for n in both.numbers if n < 20] == list(range(19, -1, -1))


def test_the_page_names_every_law():
    """docs/backends.md lists each law by its name, and no other."""
    text = (ROOT / "docs" / "backends.md").read_text()
    section = text.split("\n## Laws\n")[1].split("\n## ")[0]
    named = [line.split("`")[1] for line in section.splitlines() if line.startswith("- `")]
    assert named == list(laws.LAWS)
