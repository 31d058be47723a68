"""Sorting by depth and binning into tiles; both count first, then place."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tsplat.backends.numba_kernels.jit import kernel
from tsplat.backends.numba_kernels.simd import (
    column,
    convert,
    item,
    prefetch,
    put,
    select,
    store,
)
from tsplat.core.types import F32, F64, I32, I64

U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]

DIGIT_BITS = 12  # at most, of a key: a digit's histogram stays in the cache
TILE = 16  # px
LANES = 8  # splats whose boxes are found at a time
SIDE_BITS = 16  # of a tile's column or row in a box
TILES_MAX = (1 << SIDE_BITS) - 1  # across or down
LINE = 16  # ids, of a cache line
AHEAD = 32  # boxes that are asked for early, because they are reached through the order
KEY = 32  # lowest bit of the key in a pair


@kernel
def make_pairs(first: int, last: int, to: int, bits: U32, least: int, pairs: U64) -> None:
    """Keys above row numbers, from pair ``to`` on. Depths are positive, so their bits order as
    they do, and so do their distances from the least, which are shorter.
    """
    for i in range(first, last):
        key = np.uint64(item(bits, i) - np.uint32(least))
        put(pairs, to + i - first, key << np.uint64(KEY) | np.uint64(i))


@kernel
def count_digits(first: int, last: int, pairs: U64, shift: int, histogram: I64) -> None:
    """How often each digit, the bits from ``shift`` on, occurs in a run."""
    mask, by = np.uint64(len(histogram) - 1), np.uint64(shift)
    histogram[:] = 0
    for i in range(first, last):
        histogram[item(pairs, i) >> by & mask] += 1


@kernel
def first_places(histograms: I64) -> None:
    """Turns counts [runs, digits] into first places, run by run."""
    at = 0
    for digit in range(histograms.shape[1]):
        for run in range(histograms.shape[0]):
            count = histograms[run, digit]
            histograms[run, digit] = at
            at += count


@kernel
def place_pairs(first: int, last: int, pairs: U64, shift: int, places: I64, out: U64 | I32) -> None:
    """Moves a run of pairs to the places of their digits, in order; to int32, only their rows."""
    mask, by = np.uint64(len(places) - 1), np.uint64(shift)
    for i in range(first, last):
        pair = item(pairs, i)
        digit = pair >> by & mask
        out[np.uint64(places[digit])] = pair
        places[digit] += 1


@kernel
def box_tiles(
    first: int, last: int, means2d: F64, radii: F32, width: int, height: int, boxes: I64
) -> None:
    """Boxes of tiles around splats ``first`` to ``last``: those with a pixel's centre inside.

    A box is four numbers of SIDE_BITS: its left column, the column after its right one, its top
    row, the row after its bottom one. An empty box is 0. There are at least LANES splats.
    """
    for start in range(first, last, LANES):
        row = min(start, len(boxes) - LANES)  # the last group overlaps the one before it
        x = column(means2d, row, 0, 2, LANES) - 0.5
        y = column(means2d, row, 1, 2, LANES) - 0.5
        radius_x = convert(column(radii, row, 0, 2, LANES), np.float64)
        radius_y = convert(column(radii, row, 1, 2, LANES), np.float64)
        left = min(math.ceil(max(x - radius_x, 0.0)), width)
        top = min(math.ceil(max(y - radius_y, 0.0)), height)
        right = math.floor(max(min(x + radius_x, width - 1), -1.0))
        bottom = math.floor(max(min(y + radius_y, height - 1), -1.0))
        some = (left <= right) & (top <= bottom)
        low_x, low_y = convert(left / TILE, np.int64), convert(top / TILE, np.int64)
        high_x = convert(right / TILE + 1, np.int64)
        high_y = convert(bottom / TILE + 1, np.int64)
        box = low_x + (high_x << SIDE_BITS)
        box = box + (low_y << 2 * SIDE_BITS) + (high_y << 3 * SIDE_BITS)
        store(boxes, row, select(some, box, 0))


@kernel
def _sides(box: int) -> tuple[int, int, int, int]:
    """Left, right, top, bottom of a box; right and bottom are the first outside."""
    mask = (1 << SIDE_BITS) - 1
    return (
        box & mask,
        box >> SIDE_BITS & mask,
        box >> 2 * SIDE_BITS & mask,
        box >> 3 * SIDE_BITS & mask,
    )


@kernel
def count_tiles(
    first: int, last: int, order: I32, boxes: I64, across: int, down: int, ordered: I64,
    counts: I64,
) -> bool:  # fmt: skip
    """Splats per tile, counts [down + 1, across + 1], of one run of the order, whose boxes it
    copies to ``ordered``; False for a bad row.

    Every box leaves four marks at its corners; sums over rows and columns turn them into counts.
    """
    counts[:] = 0
    stride = across + 1
    for i in range(first, last):
        prefetch(boxes, item(order, min(i + AHEAD, last - 1)))
        k = np.int64(item(order, i))
        if k < 0 or k >= len(boxes):
            return False
        box = item(boxes, k)
        put(ordered, i, box)
        left, right, top, bottom = _sides(box)
        for row, first_mark in ((top * stride, 1), (bottom * stride, -1)):
            put(counts, row + left, item(counts, row + left) + first_mark)
            put(counts, row + right, item(counts, row + right) - first_mark)
    for y in range(down):
        for x in range(across):
            counts[y, x + 1] += counts[y, x]
    for y in range(1, down):
        for x in range(across):
            counts[y, x] += counts[y - 1, x]
    return True


@kernel
def first_slots(counts: I64, offsets: I64) -> None:
    """Turns counts [runs, down + 1, across + 1] into first slots, tile by tile; offsets [T + 1]."""
    runs, down, across = counts.shape
    at = tile = 0
    for y in range(down - 1):
        for x in range(across - 1):
            offsets[tile] = at
            tile += 1
            for run in range(runs):
                count = counts[run, y, x]
                counts[run, y, x] = at
                at += count
    offsets[tile] = at


@kernel
def fill_tiles(
    first: int, last: int, bands: int, order: I32, ordered: I64, slots: I64, ids: I32
) -> None:
    """Lists a run of splats in their tiles, one band of rows after the other: the ends of the
    lists that grow at a time should fit the cache.
    """
    down, across = slots.shape[0] - 1, slots.shape[1]
    for band in range(bands):
        begin, end = down * band // bands, down * (band + 1) // bands
        for i in range(first, last):
            left, right, top, bottom = _sides(item(ordered, i))
            k = item(order, i)
            for y in range(max(top, begin), min(bottom, end)):
                for tile in range(y * across + left, y * across + right):
                    slot = item(slots, tile)
                    prefetch(ids, slot + LINE)
                    put(ids, slot, k)
                    put(slots, tile, slot + 1)
