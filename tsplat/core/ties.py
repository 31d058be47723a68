"""Splats at the same depth: the one with the lower number is in front."""

from __future__ import annotations

import numpy as np

from tsplat.core.types import F32, I32


def break_ties(order: I32, depths: F32, numbers: I32 | None) -> I32:
    """``order``, its runs of equal depth put in the order of ``numbers``, in place.

    Args:
        order: [M] rows of depths and numbers, near to far; equal depths in order of row.
        depths: [M or more]
        numbers: [M or more] see Splats.numbers; None if they rise with the row.
    """
    if numbers is None:
        return order
    ordered = depths[order]
    equal = ordered[1:] == ordered[:-1]
    if equal.any():
        tied = np.zeros(len(order), np.bool_)
        tied[1:] = equal
        tied[:-1] |= equal
        rows = order[tied]
        order[tied] = rows[np.lexsort((numbers[rows], depths[rows]))]
    return order


def same_numbers(a: I32 | None, b: I32 | None) -> bool:
    """Whether two sets of splats have the same numbers, or both have none."""
    if a is None or b is None:
        return a is b
    return np.array_equal(a, b)
