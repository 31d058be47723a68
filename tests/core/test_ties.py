"""Equal depths go by number, however many there are and wherever rows lie."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import gaussians, straight
from tsplat.core import reference
from tsplat.core.params import RenderParams
from tsplat.core.ties import break_ties
from tsplat.core.types import I32


@given(depths=st.lists(st.sampled_from((0.5, 1.0, 1.5, 7.0)), max_size=20), seed=st.integers(0, 99))
def test_runs_of_equal_depth_are_put_in_order(depths, seed):
    """The result is what sorting by (depth, number) gives, in the memory it was given."""
    near = np.array(depths, np.float32)
    numbers = np.random.default_rng(seed).permutation(len(near)).astype(np.int32)
    order = np.argsort(near, kind="stable").astype(np.int32)
    got = break_ties(order, near, numbers)
    assert got is order
    np.testing.assert_array_equal(got, np.lexsort((numbers, near)))


def test_without_numbers_the_order_stays():
    """None means that rows are in their order already."""
    order: I32 = np.array([1, 0], np.int32)
    assert break_ties(order, np.ones(2, np.float32), None).tolist() == [1, 0]


def test_numbers_follow_their_rows():
    """Scene.take and project keep them; the sort goes by them."""
    scene = gaussians([[0, 0, 5], [0, 0, -5], [0.1, 0, 5], [0.2, 0, 4]])
    moved = replace(scene, numbers=np.array([7, 5, 3, 9], np.int32))
    splats = reference.project(moved.take(np.array([3, 2, 1, 0])), straight(), RenderParams())
    assert splats.numbers.tolist() == [9, 3, 7]
    assert reference.sort(splats).tolist() == [0, 1, 2]
    splats = reference.project(moved, straight(), RenderParams())
    assert splats.numbers.tolist() == [7, 3, 9]
    assert reference.sort(splats).tolist() == [2, 1, 0]
