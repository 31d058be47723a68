"""Sorting by depth and binning into tiles; both count first, then place."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tsplat.backends.numba_kernels.jit import kernel
from tsplat.core.types import F32, F64, I32, I64

U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]

DIGIT_BITS = 11
RADIX = 1 << DIGIT_BITS
SHIFTS = (32, 43, 54)  # of a key's three digits in a pair
TILE = 16  # px
_MASK = np.uint64(RADIX - 1)
_HIGH = np.uint64(32)


@kernel
def make_pairs(first: int, last: int, bits: U32, pairs: U64) -> None:
    """Depth bits above row numbers. Depths are positive, so their bits order as they do."""
    for i in range(first, last):
        pairs[i] = (np.uint64(bits[i]) << _HIGH) | np.uint64(i)


@kernel
def count_digits(first: int, last: int, pairs: U64, shift: int, histogram: I64) -> None:
    """How often each digit occurs in a run."""
    by = np.uint64(shift)
    histogram[:] = 0
    for i in range(first, last):
        histogram[(pairs[i] >> by) & _MASK] += 1


@kernel
def first_places(histograms: I64) -> int:
    """Turns counts [runs, RADIX] into first places, run by run; returns the largest digit count."""
    at, most = 0, 0
    for digit in range(histograms.shape[1]):
        before = at
        for run in range(histograms.shape[0]):
            count = histograms[run, digit]
            histograms[run, digit] = at
            at += count
        most = max(most, at - before)
    return most


@kernel
def place_pairs(first: int, last: int, pairs: U64, shift: int, places: I64, out: U64) -> None:
    """Moves a run of pairs to the places of their digits, in order."""
    by = np.uint64(shift)
    for i in range(first, last):
        pair = pairs[i]
        digit = (pair >> by) & _MASK
        out[places[digit]] = pair
        places[digit] += 1


@kernel
def take_rows(first: int, last: int, pairs: U64, order: I32) -> None:
    """The row numbers of sorted pairs."""
    for i in range(first, last):
        order[i] = np.int32(pairs[i])


@kernel
def count_tiles(
    first: int, last: int, order: I32, means2d: F64, radii: F32, width: int, height: int,
    boxes: I32, counts: I64,
) -> bool:  # fmt: skip
    """Boxes of tiles [M, 4] and splats per tile of one run of the order; False for a bad row.

    A box holds the first tile's column and row, then the last one's; the last is before the
    first where no pixel's centre is inside.
    """
    across = (width + TILE - 1) // TILE
    counts[:] = 0
    for i in range(first, last):
        k = order[i]
        if k < 0 or k >= len(order):
            return False
        mean_x, mean_y = means2d[k, 0], means2d[k, 1]
        radius_x, radius_y = np.float64(radii[k, 0]), np.float64(radii[k, 1])
        x0 = max(math.ceil(max(mean_x - radius_x - 0.5, -1.0)), 0)
        y0 = max(math.ceil(max(mean_y - radius_y - 0.5, -1.0)), 0)
        x1 = math.floor(max(min(mean_x + radius_x - 0.5, width - 1.0), -1.0))
        y1 = math.floor(max(min(mean_y + radius_y - 0.5, height - 1.0), -1.0))
        if x0 > x1 or y0 > y1:
            boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = 0, 0, -1, -1
            continue
        left, top, right, bottom = x0 // TILE, y0 // TILE, x1 // TILE, y1 // TILE
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = left, top, right, bottom
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                counts[y * across + x] += 1
    return True


@kernel
def first_slots(counts: I64, offsets: I64) -> None:
    """Turns counts [runs, T] into first slots, tile by tile, and writes offsets [T + 1]."""
    at = 0
    for tile in range(counts.shape[1]):
        offsets[tile] = at
        for run in range(counts.shape[0]):
            count = counts[run, tile]
            counts[run, tile] = at
            at += count
    offsets[counts.shape[1]] = at


@kernel
def fill_tiles(
    first: int, last: int, order: I32, boxes: I32, across: int, slots: I64, ids: I32
) -> None:
    """Lists a run of splats in their tiles."""
    for i in range(first, last):
        k = order[i]
        for y in range(boxes[i, 1], boxes[i, 3] + 1):
            for x in range(boxes[i, 0], boxes[i, 2] + 1):
                tile = y * across + x
                ids[slots[tile]] = k
                slots[tile] += 1
