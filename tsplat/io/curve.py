"""Moving a scene's rows to their places along the curve of ``core/curve.py``."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tsplat.core.types import I32

ROWS_MIN = 1 << 14
"""Scenes of fewer rows stay as they are: caches hold them."""

PIECE = 1 << 16
"""Rows at a time; with fewer, threads spend their time on waiting for each other."""

_T = TypeVar("_T", bound=np.generic)


def taken(array: NDArray[_T], rows: I32, pool: ThreadPoolExecutor) -> NDArray[_T]:
    """``array[rows]`` by several threads."""
    out = np.empty((len(rows), *array.shape[1:]), array.dtype)
    source, target = _whole_rows(array), _whole_rows(out)

    def work(first: int) -> None:
        piece = slice(first, first + PIECE)
        # clip, since the default would write to a buffer first
        np.take(source, rows[piece], out=target[piece], mode="clip")

    list(pool.map(work, range(0, len(rows), PIECE)))
    return out


def _whole_rows(array: NDArray[np.generic]) -> NDArray[np.void]:
    """[N] rows as single items, which NumPy takes twice as fast as rows of three."""
    size = array.dtype.itemsize * array[0].size
    return array.reshape(len(array), -1).view(np.dtype((np.void, size)))[:, 0]
