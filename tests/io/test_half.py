"""Spherical harmonics in float16: how they are rounded, what is promised of it, when it is done.

The promise is compared with colours in many directions, worked out in float64 by the reference's
own basis; the rounding with NumPy's. Not compared here: pictures, which conformance does.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from tests.io.plywriter import LITTLE, TEXT, raw_columns, write_ply
from tsplat.core.reference import sh_basis
from tsplat.io import load_scene
from tsplat.io.half import BLOCK, SH_ERROR_MAX, SH_PEAKS, to_half
from tsplat.plan import make_plan

LEVEL = 1 / 255


def directions(count: int, seed: int) -> np.ndarray:
    """Unit vectors [count + 26, 3]: random ones, and the axes and diagonals."""
    grid = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), -1).reshape(-1, 3)
    d = np.concatenate([np.random.default_rng(seed).normal(size=(count, 3)), grid[grid.any(1)]])
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def rounded(values: np.ndarray) -> tuple[np.ndarray, float]:
    out = np.empty(values.shape, np.float16)
    return out, to_half(values, out)


def coefficients(largest: float) -> st.SearchStrategy[np.ndarray]:
    """float32 [n, K, 3] of degree 0 to 3."""
    return st.tuples(st.integers(1, 5), st.sampled_from([1, 4, 9, 16])).flatmap(
        lambda shape: arrays.arrays(
            np.float32,
            (*shape, 3),
            elements=st.floats(-largest, largest, width=32, allow_subnormal=False),
        )
    )


def test_peaks_are_reached_and_not_exceeded():
    """Each peak is the least upper bound of its basis function, to 1 in 10,000."""
    largest = np.abs(sh_basis(directions(400_000, 1), 3)).max(0)
    peaks = np.array(SH_PEAKS)
    assert (largest <= peaks * (1 + 1e-12)).all()
    np.testing.assert_allclose(largest, peaks, rtol=1e-4)


@given(values=coefficients(20.0), seed=st.integers(0, 999))
@example(values=np.full((2, 16, 3), 1 + 2**-11, np.float32), seed=0)
@example(values=np.full((1, 4, 3), 3e-8, np.float32), seed=0)
def test_no_colour_moves_by_more_than_promised(values, seed):
    """In every direction, at every degree, the colour of what is kept is as near as promised."""
    halves, error = rounded(values)
    off = halves.astype(np.float64) - values
    for degree in range({1: 0, 4: 1, 9: 2, 16: 3}[values.shape[1]] + 1):
        basis = sh_basis(directions(200, seed), degree)
        moved = np.abs(np.einsum("dk,nkc->ndc", basis, off[:, : basis.shape[1]]))
        assert moved.max() <= error


def test_a_promise_near_the_limit_is_exact():
    """What a first estimate cannot promise is looked at closely: the worst case, and no more."""
    # 16 coefficients, each half a step from the nearest float16
    values = np.full((3, 16, 3), 0.75 + 2**-12, np.float32)
    exact = sum(SH_PEAKS) * 2**-12
    assert exact >= SH_ERROR_MAX
    assert rounded(values)[1] == pytest.approx(exact, rel=1e-5)
    values[:] = 0.75  # float16 has it: nothing moves, though the estimate cannot know
    values[0, :, 0] *= 4
    assert rounded(values)[1] < SH_ERROR_MAX


@given(st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=96))
@example([0, 0x80000000, 0x387FE000, 0x33000001, 0x477FEFFF, 0xC77FEFFF])
def test_rounding_is_numpys(patterns):
    """Every bit pattern that is finite becomes the float16 that NumPy's cast makes of it."""
    values = np.array(patterns, np.uint32).view(np.float32)
    values = values[np.isfinite(values)]
    padded = np.zeros((max(len(values), 1), 1, 3), np.float32)
    padded[: len(values), 0, 0] = values
    with np.errstate(over="ignore"):
        expected = padded.astype(np.float16)
    np.testing.assert_array_equal(rounded(padded)[0].view(np.uint16), expected.view(np.uint16))


def between_halves() -> np.ndarray:
    """float32 [n, 1, 3]: every finite float16, half-way points, their neighbours; both signs."""
    halves = np.arange(0x7C00, dtype=np.uint16).view(np.float16).astype(np.float32)
    middles = np.append((halves[:-1] + halves[1:]) / 2, np.float32(65520))
    sides = [np.nextafter(middles, np.float32(side)) for side in (0, np.inf)]
    values = np.concatenate([halves, middles, *sides])
    return np.concatenate([values, -values])[:, None, None].repeat(3, 2)


def test_all_borders_between_halves_are_numpys():
    """Ties go to even, and what is a bit nearer to one side goes there."""
    values = between_halves()
    with np.errstate(over="ignore"):
        expected = values.astype(np.float16)
    np.testing.assert_array_equal(rounded(values)[0].view(np.uint16), expected.view(np.uint16))


@pytest.mark.parametrize("value", [65520.0, 65536.0, 1e9, 3e38, np.inf, np.nan])
def test_what_float16_cannot_hold_is_never_promised(value):
    """One number out of range, anywhere, of either sign: the promise is worthless."""
    for sign in (1, -1):
        values = np.zeros((5, 4, 3), np.float32)
        values[3, 2, 1] = sign * value
        assert rounded(values)[1] > 1000 * SH_ERROR_MAX


def test_more_than_a_block():
    """Rows beyond the first block of scratch memory are rounded and judged like the first."""
    rng = np.random.default_rng(0)
    values = rng.normal(0, 0.2, (BLOCK // 48 + 5, 16, 3)).astype(np.float32)
    values[-1, 0, 0] = 40.0 + 2**-6  # half a step at 32 to 64
    halves, error = rounded(values)
    nearest = np.abs(values.astype(np.float16).astype(np.float64) - values)
    np.testing.assert_array_equal(np.abs(halves.astype(np.float64) - values), nearest)
    assert error == pytest.approx(SH_PEAKS[0] * 2**-6, rel=0.2)


def scene_file(tmp_path, size: float, fmt: str = LITTLE):
    """A file of 300 Gaussians of degree 3 whose coefficients are about ``size``."""
    columns = raw_columns(300, 3)
    for name in columns:
        if name.startswith("f_"):
            columns[name] *= size / 2
    return write_ply(tmp_path / "a.ply", columns, fmt=fmt)


@pytest.mark.parametrize("fmt", [LITTLE, TEXT])
def test_small_coefficients_are_kept_in_float16(tmp_path, fmt):
    """The scene says so and by how much; everything else is as in float32, bit by bit."""
    path = scene_file(tmp_path, 0.2, fmt)
    scene, full = load_scene(path), load_scene(path, sh_float32=True)
    assert scene.sh.dtype == np.float16
    assert 0 < scene.sh_error < LEVEL / 4
    assert full.sh.dtype == np.float32
    assert full.sh_error == 0
    np.testing.assert_array_equal(scene.sh, rounded(full.sh)[0])
    for name in ("means", "quats", "scales", "opacities", "origin"):
        np.testing.assert_array_equal(getattr(scene, name), getattr(full, name))


@pytest.mark.parametrize("row", [0, 150, 299])
@pytest.mark.parametrize("value", [30.1, 7e4])
def test_one_gaussian_that_would_change_keeps_all_in_float32(tmp_path, row, value):
    """A single colour that float16 would move by a quarter level, early or late in the file."""
    columns = raw_columns(300, 1)
    for name in columns:
        if name.startswith("f_"):
            columns[name] *= 0.1
    columns["f_dc_1"][row] = value
    path = write_ply(tmp_path / "a.ply", columns)
    scene, full = load_scene(path), load_scene(path, sh_float32=True)
    assert scene.sh.dtype == np.float32
    assert scene.sh_error == 0
    np.testing.assert_array_equal(scene.sh, full.sh)
    assert scene.sh[row, 0, 1] == np.float32(value)


def test_a_gaussian_that_is_dropped_has_no_say(tmp_path):
    """Colours that are not finite, or of a row left out, do not keep the others in float32."""
    columns = raw_columns(9, 0)
    for name in ("f_dc_0", "f_dc_1", "f_dc_2"):
        columns[name] *= 0.1
    columns["f_dc_0"][2] = np.nan
    columns["f_dc_1"][5] = 1e6
    columns["x"][5] = np.inf
    scene = load_scene(write_ply(tmp_path / "a.ply", columns))
    assert scene.sh.dtype == np.float16
    assert dict(scene.dropped) == {"mean not finite": 1, "colour not finite": 1}


def test_the_plan_says_what_is_left_out(tmp_path):
    """Keeping float16 is listed with its effect, which is not that pictures are the same."""
    path = scene_file(tmp_path, 0.2)
    scene = load_scene(path)
    items = {item.what: item for item in make_plan(scene).left_out}
    assert items["SH beyond float16"].effect == (
        f"no colour moves by more than {scene.sh_error * 255:.2g} of an 8-bit level"
    )
    full = make_plan(load_scene(path, sh_float32=True))
    assert "SH beyond float16" not in {item.what for item in full.left_out}


def test_a_selection_says_the_same(tmp_path):
    """``take`` keeps the type and the promise, which holds for any of the Gaussians."""
    scene = load_scene(scene_file(tmp_path, 0.2))
    some = scene.take(np.arange(7))
    assert some.sh.dtype == np.float16
    assert some.sh_error == scene.sh_error
