"""The rows of a large file come along a space-filling curve, with the places they had in it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.io.plywriter import raw_columns, write_ply
from tests.io.test_ply_variants import as_stored, assert_scene
from tsplat.core.curve import curve_order
from tsplat.io import curve, load_scene, scene_from_arrays, sweeps
from tsplat.io.base import sample_rows

N = 500


@pytest.fixture
def small(monkeypatch):
    """A few hundred rows are many, 20 a chunk and 60 a piece."""
    monkeypatch.setattr(curve, "ROWS_MIN", N // 10)
    monkeypatch.setattr(sweeps, "CHUNK", 20)
    monkeypatch.setattr(sweeps, "PIECE", 60)


def in_file_order(scene):
    """``scene`` as it was before its rows were moved; the numbers are a permutation."""
    rows = np.argsort(scene.numbers)
    np.testing.assert_array_equal(scene.numbers[rows], np.arange(len(scene)))
    return scene.take(rows)


def test_ordered_by_number_rows_are_the_files(tmp_path, small):
    """Every array has been moved alike, and nothing is lost."""
    columns = raw_columns(N, 2)
    scene = load_scene(write_ply(tmp_path / "a.ply", columns), sh_float32=True)
    assert (np.diff(scene.numbers) < 0).any()
    assert_scene(in_file_order(scene), as_stored(columns, {}))


@pytest.mark.parametrize("types", [{}, dict.fromkeys("xyz", "double")])
def test_rows_that_are_dropped_have_no_number(tmp_path, small, types):
    """Numbers count what is left, in the file's order; positions may be in double precision."""
    columns = raw_columns(N, 0)
    bad = np.random.default_rng(0).random(N) < 0.3
    columns["opacity"][bad] = np.nan
    scene = load_scene(write_ply(tmp_path / "a.ply", columns, types=types), sh_float32=True)
    good = {name: column[~bad] for name, column in columns.items()}
    assert_scene(in_file_order(scene), as_stored(good, types))
    assert dict(scene.dropped) == {"opacity not a number": bad.sum()}


def test_a_sample_is_even_in_the_file(tmp_path, small):
    """max_splats picks the rows it picked before any was moved."""
    columns = raw_columns(10 * N, 0)
    scene = load_scene(write_ply(tmp_path / "a.ply", columns), max_splats=N, sh_float32=True)
    rows = sample_rows(10 * N, N)
    picked = {name: column[rows] for name, column in columns.items()}
    assert_scene(in_file_order(scene), as_stored(picked, {}))


def test_small_files_and_arrays_stay_as_they_are(tmp_path, monkeypatch):
    """Rows that caches hold are not worth moving; a caller's own arrays keep their order."""
    columns = raw_columns(N, 0)
    assert load_scene(write_ply(tmp_path / "a.ply", columns)).numbers is None
    monkeypatch.setattr(curve, "ROWS_MIN", 1)
    ones = np.ones((3, 3))
    assert scene_from_arrays(ones, np.ones((3, 4)), ones, np.ones(3), ones).numbers is None


def morton(cell):
    """The bits of three coordinates in turn, x lowest."""
    return sum((int(c) >> bit & 1) << 3 * bit + k for bit in range(10) for k, c in enumerate(cell))


def test_the_order_is_mortons(small):
    """On a grid of whole cells, codes rise; in one cell, rows keep their order."""
    rng = np.random.default_rng(1)
    cells = rng.integers(0, 8, (N, 3))
    means = cells.astype(np.float32)
    order = curve_order(means)
    assert order.dtype == np.int32
    codes = [morton(cell * 1023 // 7) for cell in cells]
    assert order.tolist() == sorted(range(N), key=lambda row: (codes[row], row))


@pytest.mark.parametrize(
    "means",
    [
        np.zeros((9, 3)),
        np.full((9, 3), -3e38),
        np.array([[3e38, -3e38, 0]] * 3 + [[-3e38, 3e38, 1]] * 3),
        np.array([[0, 0, 0]] * 500 + [[3e38, -3e38, 3e38]]),
        np.zeros((1, 3)),
        np.full((9, 3), np.nan),
        np.array([[np.nan, 0, 1]] * 5 + [[np.inf, -np.inf, 0]] * 5 + [[0, 1, 2]] * 5),
    ],
)
def test_extreme_positions_give_some_order(means):
    """In one place, beyond float32's differences, not finite: a permutation, and no warning."""
    for dtype in (np.float32, np.float64):
        order = curve.rows_along_curve(means.astype(dtype))
        assert sorted(order.tolist()) == list(range(len(means)))


def test_rows_that_are_dropped_do_not_spoil_the_order():
    """Whatever is not finite among many, the others lie along the curve as they do without."""
    means = np.random.default_rng(4).uniform(-1, 1, (9000, 3)).astype(np.float32)
    bad = np.arange(9000) % 3 == 0
    means[bad] = np.random.default_rng(5).choice([np.nan, np.inf, -np.inf], (3000, 3))
    order = curve_order(means)
    steps = np.abs(np.diff(means[order[~bad[order]]], axis=0)).sum(1)
    alone = means[~bad]
    assert np.median(steps) < 1.1 * np.median(
        np.abs(np.diff(alone[curve_order(alone)], axis=0)).sum(1)
    )


def test_positions_far_from_zero_have_an_order_too():
    """In double precision, neighbours that float32 could not tell apart are told apart."""
    near = np.random.default_rng(6).uniform(-1, 1, (2000, 3))
    np.testing.assert_array_equal(
        curve.rows_along_curve(near + 2.0**40), curve.rows_along_curve(near + 2.0**40 - 2.0**40)
    )
    steps = np.abs(np.diff(near[curve.rows_along_curve(near + 2.0**40)], axis=0)).sum(1)
    assert np.median(steps) < 0.5
