"""How a frame is made: on how many threads, and in which memory."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from tsplat.core.errors import ParamsError

THREADS_MAX = 256


class Workspace:
    """Threads and buffers a caller lends to the stages.

    A buffer keeps its memory between frames and only grows, so a steady view allocates nothing.
    What a stage returns may live in the workspace: it is good until the stage's next call with
    the same workspace. Two frames that must exist at once need two workspaces.

    Raises:
        ParamsError: ``threads`` is not 1 to 256.
    """

    def __init__(self, threads: int = 1) -> None:
        if not 1 <= threads <= THREADS_MAX:
            raise ParamsError(f"threads: expected 1 to {THREADS_MAX}, got {threads}")
        self.threads = threads
        self._buffers: dict[str, NDArray[Any]] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """A C-contiguous array, 64-byte aligned; its contents are whatever was there before."""
        wanted = np.dtype(dtype)
        size = math.prod(shape) * wanted.itemsize
        buffer = self._buffers.get(name)
        if buffer is None or buffer.nbytes < size:
            room = size if buffer is None else size + size // 4  # grows by steps, not by drips
            raw = np.empty(room + 64, np.uint8)
            start = -raw.ctypes.data % 64
            buffer = self._buffers[name] = raw[start : start + room]
        return buffer[:size].view(wanted).reshape(shape)

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(b.nbytes for b in self._buffers.values())
