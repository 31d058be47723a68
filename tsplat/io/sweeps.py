"""Rows of a file -> a scene: in pieces, by threads, sampled, and along a space-filling curve.

What a format has to say is in two things: ``FileRows``, which reads a run of its Gaussians as
rows of one NumPy type, and ``Layout``, which decodes such rows. The rest is the same for all. Of a
format whose Gaussians are in memory once it is unpacked, the rows are their numbers; see
:mod:`tsplat.io.gather`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from tsplat.core.errors import printable
from tsplat.core.types import I32, Floats, Scene, Up
from tsplat.core.workspace import default_threads
from tsplat.io import curve
from tsplat.io.base import SAMPLED, ReadOptions, refuse, sample_rows
from tsplat.io.clean import CHUNK, OPACITY_RANGE, REASONS, THREADS, SceneBuilder
from tsplat.io.half import SH_ERROR_MAX

PIECE = 4 * CHUNK
"""Rows that a thread decodes before it takes the next."""


class FileRows(Protocol):
    """The Gaussians of a file, one a row, to be read piece by piece; threads may read at once."""

    @property
    def dtype(self) -> np.dtype[Any]: ...

    def __len__(self) -> int: ...

    def read(self, start: int, stop: int, room: NDArray[Any]) -> NDArray[Any]:
        """Rows ``start`` to ``stop``; ``room`` holds as many, and is where they may be put.

        Raises:
            SceneError: the file has become too short.
        """


class Layout(Protocol):
    """What rows of a file mean."""

    coefficients: int  # K: 1, 4, 9 or 16
    wide: bool  # positions need float64

    def means(self, rows: NDArray[Any]) -> Floats:
        """[n, 3] the positions of ``rows``, some of which may not be finite."""

    def add(
        self, builder: SceneBuilder, to: slice | I32, rows: NDArray[Any], raw_opacity: bool
    ) -> None:
        """Decodes ``rows`` into rows ``to`` of ``builder``."""


class Bytes:
    """A file, to be read in stretches by any thread.

    It is not mapped: pages of a map would count as this process's memory, and a file that is cut
    short meanwhile would end it (SIGBUS).
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("rb", buffering=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def fill(self, room: NDArray[Any], at: int) -> None:
        """Fills ``room``, which is contiguous, with what begins at byte ``at``.

        Raises:
            SceneError: the file has become too short.
        """
        left = room.reshape(-1).view(np.uint8).data
        while left:
            got = os.preadv(self._file.fileno(), [left], at)
            if not got:
                refuse(
                    self.path,
                    f"ended at byte {at} while it was read, expected {len(left)} more; "
                    "wait until it is written, or copy it again",
                )
            left, at = left[got:], at + got


class Sweeps:
    """Goes through all rows, or an even sample of ``options.max_splats``, as often as needed."""

    def __init__(self, rows: FileRows, options: ReadOptions) -> None:
        self._rows = rows
        self._progress = options.progress
        total = len(rows)
        self.count = min(options.max_splats or total, total)
        self.left_out = total - self.count
        self._picked = sample_rows(total, self.count) if self.left_out else None

    def _place(self, row: int) -> int:
        """Where ``row`` of the file, or the first one behind it that is picked, goes."""
        return row if self._picked is None else int(np.searchsorted(self._picked, row))

    def sweep(self, work: Callable[[slice, NDArray[Any]], bool], before: int, goal: int) -> None:
        """Calls ``work`` in threads with a slice of 0..count and its rows, until one says False.

        Progress goes from ``before`` to ``before + count`` of ``goal``.
        """
        rows, total = self._rows, len(self._rows)
        more = True
        workers = min(default_threads(), THREADS) if total > PIECE else 1
        # Made here: what a thread of a pool allocates for itself stays the process's, by and large.
        rooms: SimpleQueue[NDArray[Any]] = SimpleQueue()
        for _ in range(workers):
            rooms.put(np.empty(min(CHUNK, total), rows.dtype))

        def piece(first: int) -> int:
            """Works on PIECE rows; returns where the rows behind them go."""
            nonlocal more
            end = min(first + PIECE, total)
            room = rooms.get()
            try:
                for start in range(first, end, CHUNK):
                    if not more:
                        break
                    stop = min(start + CHUNK, end)
                    part = slice(self._place(start), self._place(stop))
                    if part.start == part.stop:
                        continue
                    chunk = rows.read(start, stop, room)
                    if self._picked is not None:
                        chunk = chunk[self._picked[part] - start]
                    if not work(part, chunk):
                        more = False
            finally:
                rooms.put(room)
            return self._place(end)

        self._progress(before, goal)
        if total <= PIECE:  # a pool would have nothing to share
            self._progress(before + piece(0), goal)
            return
        with ThreadPoolExecutor(workers, "tsplat-read") as pool:
            for done in pool.map(piece, range(0, total, PIECE)):
                self._progress(before + done, goal)


def decode(sweeps: Sweeps, layout: Layout, options: ReadOptions) -> tuple[SceneBuilder, I32 | None]:
    """All rows, and which of them stands where if they are many: along a space-filling curve.

    Places are found in a sweep of its own that reads nothing but positions: reading a file twice
    takes less time than moving rows, and less memory. SH is in float16 if that will do, which is
    known at the end. If not, all is read again: keeping float32 as well until then would take more
    memory than the file.
    """
    numbers = places = None
    before, goal = 0, sweeps.count
    if sweeps.count >= curve.ROWS_MIN:
        before, goal = goal, 2 * goal
        numbers = _numbers(sweeps, layout, goal)
        places = curve.inverse(numbers)

    def decoded(half: bool) -> SceneBuilder:
        builder = SceneBuilder(sweeps.count, layout.coefficients, wide=layout.wide, half=half)
        if sweeps.left_out:
            builder.dropped[SAMPLED] = sweeps.left_out

        def add(part: slice, rows: NDArray[Any]) -> bool:
            to = part if places is None else places[part]
            layout.add(builder, to, rows, options.raw_opacity)
            return builder.sh_error < SH_ERROR_MAX

        sweeps.sweep(add, before, goal)
        return builder

    builder = None if options.sh_float32 else decoded(half=True)
    if builder is None or builder.sh_error >= SH_ERROR_MAX:
        del builder  # its memory is needed
        builder = decoded(half=False)
    return builder, numbers


def _numbers(sweeps: Sweeps, layout: Layout, goal: int) -> I32:
    """Rows along the curve."""
    means = np.empty((sweeps.count, 3), np.float64 if layout.wide else np.float32)

    def keep(part: slice, rows: NDArray[Any]) -> bool:
        means[part] = layout.means(rows)
        return True

    sweeps.sweep(keep, 0, goal)
    return curve.rows_along_curve(means)


def scene_of(
    path: Path,
    rows: FileRows,
    layout: Layout,
    options: ReadOptions,
    *,
    about: str = "",
    antialias: bool | None = None,
    up: Up | None = None,
) -> Scene:
    """The scene of all ``rows`` of the file at ``path``, or of ``options.max_splats`` of them.

    ``about`` becomes ``Scene.source``.

    Raises:
        SceneError: none of them can be drawn, or opacities are logits that were said not to be.
    """
    builder, numbers = decode(Sweeps(rows, options), layout, options)
    if options.raw_opacity and builder.dropped[OPACITY_RANGE] > len(builder):
        refuse(
            path,
            f"{builder.dropped[OPACITY_RANGE]} opacities lie outside 0..1, so they are logits; "
            "read the file without raw_opacity (--raw-opacity)",
        )
    if not len(builder):
        # by place, not by which thread met one first
        found = [(r, builder.dropped[r]) for r in REASONS if builder.dropped[r]]
        reasons = ", ".join(f"{r}: {n}" for r, n in found)
        refuse(path, f"none of its Gaussians can be drawn ({reasons})")
    scene = builder.build(printable(path.name), numbers=numbers)
    return replace(scene, source=about, antialias=antialias, up=up)
