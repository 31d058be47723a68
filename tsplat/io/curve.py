"""Places of a file's rows along the curve of ``core/curve.py``, found before they are decoded."""

from __future__ import annotations

import numpy as np

from tsplat.core.curve import curve_order
from tsplat.core.types import I32, Floats
from tsplat.io import native
from tsplat.io.clean import median

ROWS_MIN = 1 << 14
"""Scenes of fewer rows stay as they are: caches hold them."""


def rows_along_curve(means: Floats) -> I32:
    """Rows [N] of ``means`` [N, 3] along the curve; some may not be finite, and lie anywhere."""
    if means.dtype == np.float64:  # far from zero float32 would see few places
        middle = [median(column) for column in means.T]
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            means = means - middle
    with np.errstate(over="ignore", under="ignore"):
        return curve_order(np.ascontiguousarray(means, np.float32), native.curve_keys)


def inverse(rows: I32) -> I32:
    """[N] the place of each row in ``rows``."""
    places = np.empty_like(rows)
    places[rows] = np.arange(len(rows), dtype=np.int32)
    return places
