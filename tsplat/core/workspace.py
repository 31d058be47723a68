"""How a frame is made: on how many threads, and in which memory."""

from __future__ import annotations

import math
import os
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from tsplat.core.errors import ParamsError

THREADS_MAX = 256


def default_threads() -> int:
    """CPUs this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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
        self.known: dict[str, Any] = {}
        """What was worked out for the last frame and may serve the next, by whom it is for."""
        self._converted: tuple[Callable[[], object], NDArray[np.float32]]
        self._converted = (lambda: None), np.empty(0, np.float32)

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

    def float32(self, array: NDArray[np.floating]) -> NDArray[np.float32]:
        """``array`` itself if it is float32, else a copy that is kept until another is asked for.

        For kernels that read float32 only, of arrays that stay the same from frame to frame.
        """
        if array.dtype == np.float32:
            return array
        source, copy = self._converted
        if source() is not array:
            copy = array.astype(np.float32)
            self._converted = weakref.ref(array), copy
        return copy

    def forget(self) -> None:
        """Nothing of the last frame serves the next: for timing. The buffers stay."""
        self.known.clear()

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(b.nbytes for b in self._buffers.values()) + self._converted[1].nbytes
