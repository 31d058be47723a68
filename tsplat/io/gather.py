"""Gaussians that are in memory once their file is unpacked -> a Scene: SPZ, SOG, glTF.

A reader says how to decode some rows; which rows, in what order and into what is decided as for
every other format, in :mod:`tsplat.io.sweeps`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from tsplat.core.errors import printable
from tsplat.core.types import F32, I32, I64, Floats, Scene, Up
from tsplat.io.base import ReadOptions, refuse
from tsplat.io.clean import SceneBuilder
from tsplat.io.sweeps import scene_of
from tsplat.io.table import in_order

COUNT_FREE = 1 << 18
"""Gaussians that a file may hold however small it is: some 45 MB once they are decoded, colours in
float16 and of degree 0; of more, :func:`tsplat.io.base.check_memory` is the bound."""

COUNT_RATE = 2
"""More of them for each byte of the file. Real files take 10 bytes a Gaussian and more; what claims
less than half of one was made to fill the memory."""


UNPACKING = 1 / 3
"""Of the time that a compressed file takes, about what passes before rows are decoded."""


class Source(Protocol):
    """All Gaussians of a file, to be decoded a few rows at a time, by several threads at once."""

    count: int
    coefficients: int  # K
    wide: bool  # means need float64

    def means(self, rows: slice | I64) -> Floats:
        """[n, 3] the positions of increasing ``rows``, some of which may not be finite."""
        ...

    def fill(self, rows: slice | I64, table: F32) -> Floats | None:
        """Unpacks increasing ``rows`` into ``table``, one of :func:`tsplat.io.table.in_order`.

        Returns:
            [n, 3] their positions in float64 if these are ``wide``.
        """
        ...


def check_count(path: Path, count: int, size: int, where: str) -> int:
    """``count`` itself, if a file of ``size`` bytes may hold as many Gaussians.

    ``where`` names the field that says so. To be asked before anything is unpacked.
    """
    if not count:
        refuse(path, f"holds no Gaussians ({where} is 0)")
    limit = COUNT_FREE + COUNT_RATE * size
    if count > limit:
        refuse(
            path,
            f"{where} promises {count} Gaussians, a file of {size} bytes holds at most {limit}; "
            "the file is damaged, or made to fill the memory",
        )
    return count


class _Numbers:
    """The rows of a :class:`Source` are their numbers; see :class:`tsplat.io.sweeps.FileRows`."""

    dtype = np.dtype(np.int64)

    def __init__(self, count: int) -> None:
        self._count = count

    def __len__(self) -> int:
        return self._count

    def read(self, start: int, stop: int, room: I64) -> I64:
        """``start`` to ``stop``."""
        return np.arange(start, stop)


def _run(numbers: I64) -> slice | I64:
    """Increasing ``numbers`` as a slice if none is left out."""
    if not len(numbers):
        return slice(0, 0)
    first, last = int(numbers[0]), int(numbers[-1])
    return slice(first, last + 1) if last - first == len(numbers) - 1 else numbers


class _Layout:
    """A :class:`Source` decodes its own rows; see :class:`tsplat.io.sweeps.Layout`."""

    def __init__(self, source: Source) -> None:
        self.coefficients, self.wide = source.coefficients, source.wide
        self._source = source
        self._tables = in_order(source.coefficients)

    def means(self, rows: I64) -> Floats:
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            return self._source.means(_run(rows))

    def add(self, builder: SceneBuilder, to: slice | I32, rows: I64, raw_opacity: bool) -> None:
        table = self._tables.room(len(rows))
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):  # builder drops those
            means = self._source.fill(_run(rows), table)
        self._tables.put(builder, to, table, means)


def gather(
    path: Path,
    source: Source,
    options: ReadOptions,
    *,
    about: str,
    name: str | None = None,
    antialias: bool | None = None,
    up: Up | None = None,
) -> Scene:
    """See :func:`tsplat.io.sweeps.scene_of`; the scene's name is the file's unless given.

    Raises:
        SceneError: nothing can be drawn.
    """
    scene = scene_of(
        path, _Numbers(source.count), _Layout(source), options,
        about=about, antialias=antialias, up=up,
    )  # fmt: skip
    return replace(scene, name=printable(name)) if name else scene


def stretch(options: ReadOptions, first: float, last: float) -> ReadOptions:
    """``options`` of one step of reading, whose progress goes from ``first`` to ``last`` of 1."""

    def progress(done: int, total: int) -> None:
        options.progress(round(1000 * (first + (last - first) * done / max(total, 1))), 1000)

    return replace(options, progress=progress)
