"""Rows along a space-filling curve (Morton's): neighbours in space become neighbours in memory.

Stages visit Gaussians row by row and need few of them all; along the curve these lie together.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tsplat.core.types import F32, I32

Keys = Callable[[F32, F32, F32], NDArray[np.uint64]]
"""What :func:`curve_keys` does."""

SAMPLE = 4096
"""Rows that the grid is guessed from."""

PIECE = 1 << 16
"""Rows at a time, so that what is between two steps stays in the caches."""

CELLS = 1024
"""Of the grid along each axis: 30 bits."""


def _spread() -> NDArray[np.uint64]:
    """The bits of each number below CELLS, two zeros after each."""
    number, spread = np.arange(CELLS, dtype=np.uint64), np.zeros(CELLS, np.uint64)
    for bit in range(CELLS.bit_length() - 1):
        spread |= (number >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit)
    return spread


def curve_keys(means: F32, low: F32, scale: F32) -> NDArray[np.uint64]:
    """[N] where each of ``means`` is along the curve, in the upper 32 bits; below them, its row.

    ``low`` [3] is where cell 0 begins, ``scale`` [3] is cells per world unit.
    """
    tables = [_spread() << np.uint64(32 + axis) for axis in range(3)]
    keys = np.arange(len(means), dtype=np.uint64)
    for start in range(0, len(means), PIECE):
        piece = slice(start, start + PIECE)
        for axis, table in enumerate(tables):
            with np.errstate(over="ignore", invalid="ignore", under="ignore"):
                cell = (means[piece, axis] - low[axis]) * scale[axis]
            cell = np.fmin(np.fmax(cell, 0), CELLS - 1)  # what overflowed, too
            keys[piece] |= table[cell.astype(np.intp)]
    return keys


def curve_order(means: F32, keys: Keys = curve_keys) -> I32:
    """Rows [N] of ``means`` [N, 3] along the curve; of those in one cell, the first comes first.

    Means that are not finite are somewhere on it.
    """
    n = len(means)
    if not n:
        return np.empty(0, np.int32)
    sample = means[:: max(n // SAMPLE, 1)].astype(np.float64)
    sample = sample[np.isfinite(sample).all(1)]
    if not len(sample):
        return np.arange(n, dtype=np.int32)
    sample.sort(0)  # np.quantile would import numpy.ma
    strays = len(sample) // 100  # they would leave the bulk few cells
    low, high = sample[strays], sample[-1 - strays]
    scale = (CELLS - 1) / np.where(high > low, high - low, np.inf)
    with np.errstate(over="ignore", under="ignore"):  # a world of 1e-40 units has one cell
        found = keys(means, low.astype(np.float32), scale.astype(np.float32))
    found.sort()  # vectorised in NumPy: several times as fast as a stable sort of codes
    return found.astype(np.uint32).view(np.int32)
