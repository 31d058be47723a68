"""What scene_from_arrays makes of arrays: normalised, re-based, counted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsplat.core.errors import SceneError
from tsplat.io import scene_from_arrays
from tsplat.io.base import sample_rows
from tsplat.io.clean import CHUNK, DETAIL, SH_MAX, detail_origin
from tsplat.io.half import SH_PEAKS

ANY = [np.float16, np.float32, np.float64, np.longdouble]


def arrays(n: int, coefficients: int = 1, dtype=np.float32, seed: int = 0) -> dict:
    """Arguments that are right in every row."""
    rng = np.random.default_rng(seed)
    return {
        "means": rng.normal(size=(n, 3)).astype(dtype),
        "quats": rng.normal(size=(n, 4)).astype(dtype),
        "scales": rng.uniform(0.1, 1, (n, 3)).astype(dtype),
        "opacities": rng.uniform(0, 1, n).astype(dtype),
        "sh": rng.normal(size=(n, coefficients, 3)).astype(dtype),
    }


@pytest.mark.parametrize("dtype", ANY)
@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_any_float_type(dtype, coefficients):
    """Half, single, double and long double arrays become the same float32 Scene."""
    given_arrays = arrays(7, coefficients, np.float16)
    scene = scene_from_arrays(**{k: v.astype(dtype) for k, v in given_arrays.items()})
    for field in ("means", "scales", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(scene, field), given_arrays[field].astype(np.float32))
    assert not scene.origin.any()
    assert not scene.dropped


def test_lists_and_degree_zero_colours():
    """Nested lists of whole numbers and [N, 3] colours are taken too."""
    scene = scene_from_arrays([[1, 2, 3]], [[1, 0, 0, 0]], [[1, 1, 1]], [1], [[0, 1, 2]])
    assert scene.sh.tolist() == [[[0, 1, 2]]]
    assert scene.means.tolist() == [[1, 2, 3]]


def test_no_gaussians():
    """A Scene of nothing is legal."""
    assert len(scene_from_arrays(**arrays(0))) == 0
    assert len(scene_from_arrays(**arrays(0, dtype=np.float64))) == 0


def test_arguments_are_neither_kept_nor_changed():
    """Writing to an argument afterwards does not reach the Scene."""
    given_arrays = arrays(5)
    copies = {k: v.copy() for k, v in given_arrays.items()}
    scene = scene_from_arrays(**given_arrays)
    for key, value in given_arrays.items():
        np.testing.assert_array_equal(value, copies[key])
        assert not np.shares_memory(value, getattr(scene, key))


@given(
    exponent=st.integers(-300, 300),
    quat=st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(
        lambda q: max(map(abs, q)) > 1e-3
    ),
)
def test_quaternions_of_any_size_are_normalised(exponent, quat):
    """From 1e-300 to 1e300 a quaternion gives the same unit quaternion to float32."""
    unit = np.array(quat) / np.linalg.norm(quat)
    scaled = [np.array(quat) * 10.0**exponent]
    scene = scene_from_arrays([[0, 0, 0]], scaled, [[1, 1, 1]], [1], [[0, 0, 0]])
    np.testing.assert_allclose(scene.quats[0], unit, rtol=1e-6, atol=1e-12)


FAULTS = [
    ("means", np.nan, "mean not finite"),
    ("means", np.inf, "mean not finite"),
    ("means", 1e39, "mean not finite"),
    ("quats", np.nan, "quaternion not finite"),
    ("quats", -np.inf, "quaternion not finite"),
    ("quats", 0.0, "quaternion of length zero"),
    ("scales", np.nan, "scale not finite"),
    ("scales", np.inf, "scale not finite"),
    ("scales", -0.1, "negative scale"),
    ("opacities", np.nan, "opacity not a number"),
    ("opacities", np.inf, "opacity outside 0..1"),
    ("opacities", -0.1, "opacity outside 0..1"),
    ("opacities", 1.001, "opacity outside 0..1"),
    ("sh", np.nan, "colour not finite"),
    ("sh", np.inf, "colour not finite"),
    ("sh", 3e38, "colour not finite"),
    ("sh", -3e38, "colour not finite"),
]


@pytest.mark.parametrize(("field", "value", "reason"), FAULTS)
def test_a_fault_drops_its_row_alone(field, value, reason):
    """The row with the fault goes, counted once by reason; its neighbours keep place and bits."""
    given_arrays = arrays(CHUNK + 5, 4, np.float64)
    given_arrays[field][CHUNK] = value
    scene = scene_from_arrays(**given_arrays)
    assert dict(scene.dropped) == {reason: 1}
    rest = scene_from_arrays(**{k: np.delete(v, CHUNK, axis=0) for k, v in given_arrays.items()})
    for name in given_arrays:
        np.testing.assert_array_equal(getattr(scene, name), getattr(rest, name))


def test_a_row_with_two_faults_counts_once():
    """Reasons add up to the number of rows dropped, with what was dropped before."""
    given_arrays = arrays(4)
    given_arrays["means"][1] = np.nan
    given_arrays["sh"][1] = np.nan
    scene = scene_from_arrays(**given_arrays, dropped={"too far": 3})
    assert dict(scene.dropped) == {"too far": 3, "mean not finite": 1}
    assert len(scene) == 3


def test_no_colour_that_is_kept_can_overflow():
    """Sixteen coefficients as large as may be make a finite colour along every direction's peak."""
    assert 0.5 + SH_MAX * sum(SH_PEAKS) < np.finfo(np.float32).max
    given_arrays = arrays(3, 16)
    given_arrays["sh"][1] = SH_MAX
    given_arrays["sh"][2] = -np.nextafter(np.float32(SH_MAX), np.float32(np.inf))
    assert scene_from_arrays(**given_arrays).dropped == {"colour not finite": 1}


def test_underflow_is_no_error():
    """What is below float32 becomes 0, or close to it, even where NumPy is told to raise."""
    given_arrays = arrays(4, dtype=np.float64)
    given_arrays["quats"][:] = [1, 1e-200, 0, 0]
    given_arrays["scales"][0] = 1e-300
    given_arrays["sh"][1] = 1e-42
    given_arrays["means"][2] = 1e-320
    with np.errstate(all="raise"):
        scene = scene_from_arrays(**given_arrays)
    assert not scene.dropped
    assert not scene.scales[0].any()


def test_opacity_of_rounding_is_clipped():
    """One part in a million above 1 is rounding, not a fault."""
    given_arrays = arrays(2, dtype=np.float64)
    given_arrays["opacities"][:] = [1 + 5e-7, -5e-7]
    assert scene_from_arrays(**given_arrays).opacities.tolist() == [1, 0]


def test_float32_means_keep_their_bits():
    """However far out, float32 positions are neither moved nor rounded."""
    given_arrays = arrays(50)
    given_arrays["means"] += np.float32(4e6)
    scene = scene_from_arrays(**given_arrays)
    assert not scene.origin.any()
    np.testing.assert_array_equal(scene.means, given_arrays["means"])


@given(st.floats(-9, 9), st.floats(-6, 2), st.integers(0, 99))
def test_float64_means_lose_no_detail(place, size, seed):
    """Whatever place and size, float32 costs a typical Gaussian at most DETAIL of its size."""
    given_arrays = arrays(20, dtype=np.float64, seed=seed)
    means = given_arrays["means"] * 10**size + 10**place
    given_arrays["means"] = means
    given_arrays["scales"] *= 10**size
    scene = scene_from_arrays(**given_arrays)
    loss = np.abs(scene.means.astype(np.float64) + scene.origin - means).max()
    already_lost = 2 * np.spacing(10**place)  # float64 itself
    assert loss <= DETAIL * 10**size * 2 + already_lost


def test_origin_stays_zero_where_float32_is_enough():
    """A float64 scene of ordinary size has origin 0, so its coordinates stay what they were."""
    assert not detail_origin(np.full((5, 3), 100.0), np.full((5, 3), 1.0, np.float32)).any()
    assert (
        detail_origin(np.full((5, 3), 1e6), np.full((5, 3), 1.0, np.float32)).tolist() == [1e6] * 3
    )


def test_a_given_origin_is_added_to():
    """Means relative to an origin stay so; what re-basing finds is added."""
    given_arrays = arrays(9, dtype=np.float64)
    scene = scene_from_arrays(**given_arrays, origin=[1e7, 0, -5])
    assert scene.origin.tolist() == [1e7, 0, -5]
    given_arrays["means"] += 3e7
    scene = scene_from_arrays(**given_arrays, origin=[1e7, 0, -5])
    np.testing.assert_allclose(
        scene.means + scene.origin, given_arrays["means"] + [1e7, 0, -5], rtol=0, atol=1e-6
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"means": np.zeros((3, 2))}, r"means: expected \[N, 3\], got \[3, 2\]"),
        ({"quats": np.zeros((2, 4))}, r"quats: expected \[3, 4\], got \[2, 4\]"),
        ({"opacities": np.zeros((3, 1))}, r"opacities: expected \[3\], got \[3, 1\]"),
        ({"sh": np.zeros((3, 2, 3))}, "sh: expected 1, 4, 9 or 16 coefficients, got 2"),
        ({"sh": np.zeros((3, 3, 1, 1))}, r"sh: expected \[3, K, 3\], got \[3, 3, 1, 1\]"),
        ({"scales": np.array([["a"] * 3] * 3)}, "scales: expected numbers, got str"),
        ({"origin": [1, 2]}, r"origin: expected \[3\], got \[2\]"),
        ({"origin": [1, 2, np.nan]}, "origin: expected finite numbers"),
    ],
)
def test_shapes_are_checked(change, message):
    """The array's name, what was expected and what came."""
    with pytest.raises(SceneError, match=message):
        scene_from_arrays(**(arrays(3) | change))


@given(st.integers(1, 10**9), st.integers(1, 500))
def test_sample_rows_takes_one_of_each_stretch(total, keep):
    """Increasing, within range, and never two stretches apart by more than twice their length."""
    keep = min(keep, total)
    rows = sample_rows(total, keep)
    assert len(rows) == keep
    assert (np.diff(rows) > 0).all()
    assert rows[0] >= 0
    assert rows[-1] < total
    assert (np.diff(np.concatenate([[-1], rows, [total]])) <= 2 * -(-total // keep)).all()
