"""The order in which neighbours in space are neighbours in a file."""

from __future__ import annotations

import numpy as np

from tsplat.core.types import F32, F64, I64
from tsplat.io.curve import rows_along_curve
from tsplat.io.write.base import ROWS
from tsplat.io.write.source import Source

STRAY = 1.0
"""Times the width of the bulk, beyond its ends: what is farther out is a stray."""

ROUNDS = 8
"""At most so many bulks, each among the strays of those before it."""


def compact_order(source: Source) -> I64:
    """[N] the Gaussians of ``source`` along space-filling curves, bulk first, then strays."""
    means = source.means(slice(0, len(source)))
    if means.dtype == np.float64:
        means = means - source.scene.origin
    left = np.arange(len(source))
    found = []
    for _ in range(ROUNDS):
        if len(left) <= 1:
            break
        bulk = _bulk(means[left])
        found.append(_along(left[bulk], means))
        left = left[~bulk]
    found.append(_along(left, means))
    return np.concatenate(found)


def _along(rows: I64, means: F32 | F64) -> I64:
    return rows[rows_along_curve(means[rows])] if len(rows) else rows


def _bulk(means: F32 | F64) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """[n] which rows are within the middle 98 %, widened; at least some are."""
    sample = np.sort(means[:: max(len(means) // ROWS, 1)].astype(np.float64), axis=0)
    edge = len(sample) // 100
    low, high = sample[edge], sample[-1 - edge]
    wide = STRAY * (high - low)
    inside: np.ndarray[tuple[int], np.dtype[np.bool_]] = (
        (means >= low - wide) & (means <= high + wide)
    ).all(1)
    return inside if inside.any() else ~inside
