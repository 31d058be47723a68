"""Gaussians that a file has as whole columns -> a Scene: sampled, along the curve, without faults.

What every format shares whose numbers are in memory once it is unpacked: SPZ, SOG, glTF. A reader
says how to decode some rows; which rows, in what order and into what is decided here.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from tsplat.core.errors import printable
from tsplat.core.types import F16, F64, I32, I64, Floats, Scene
from tsplat.core.workspace import default_threads
from tsplat.io import curve
from tsplat.io.base import SAMPLED, ReadOptions, refuse, sample_rows
from tsplat.io.clean import CHUNK, OPACITY_RANGE, THREADS, SceneBuilder
from tsplat.io.half import SH_ERROR_MAX

COUNT_FREE = 1 << 18
"""Gaussians that a file may hold however small it is: some 45 MB once they are decoded."""

COUNT_RATE = 2
"""More of them for each byte of the file. Real files take 10 bytes a Gaussian and more; what claims
less than half of one was made to fill the memory."""


UNPACKING = 1 / 3
"""Of the time that a compressed file takes, about what passes before rows are decoded."""


class Gaussians(NamedTuple):
    """Some rows of a file, decoded as :meth:`tsplat.io.clean.SceneBuilder.add` wants them."""

    means: Floats  # [n, 3]
    quats: Floats  # [n, 4]  w, x, y, z; any length
    scales: Floats  # [n, 3]  linear
    opacities: Floats  # [n]
    sh: Floats | F16  # [n, K, 3]
    sh_error: float = 0.0  # what float16 has cost, as of Scene.sh_error


class Source(Protocol):
    """All Gaussians of a file, to be decoded a few rows at a time, by several threads at once."""

    count: int
    coefficients: int  # K
    wide: bool  # means need float64

    def means(self, rows: slice | I64) -> Floats:
        """[n, 3] the positions of increasing ``rows``, some of which may not be finite."""
        ...

    def gaussians(self, rows: slice | I64, half: bool) -> Gaussians:
        """Everything about increasing ``rows``; coefficients may be float16 if ``half``."""
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


def gather(
    path: Path,
    source: Source,
    options: ReadOptions,
    *,
    about: str,
    name: str | None = None,
    antialias: bool | None = None,
) -> Scene:
    """The Scene of all rows of ``source``, or of an even sample of ``options.max_splats``.

    ``about`` and ``antialias`` become ``Scene.source`` and ``Scene.antialias``; ``name`` is the
    file's unless given.

    Raises:
        SceneError: nothing can be drawn.
    """
    count = min(options.max_splats or source.count, source.count)
    picked = sample_rows(source.count, count) if count < source.count else None
    goal = count if count < curve.ROWS_MIN else 2 * count

    def rows_of(part: slice) -> slice | I64:
        return part if picked is None else picked[part]

    numbers = places = None
    if count >= curve.ROWS_MIN:
        means = np.empty((count, 3), np.float64 if source.wide else np.float32)

        def keep(part: slice) -> bool:
            with np.errstate(over="ignore", invalid="ignore", under="ignore"):
                means[part] = source.means(rows_of(part))
            return True

        _sweep(keep, count, lambda done: options.progress(done, goal))
        numbers = curve.rows_along_curve(means)
        places = curve.inverse(numbers)
        del means
    builder = None
    if not options.sh_float32:
        builder = _decoded(source, rows_of, count, places, options, goal, half=True)
    if builder is None or builder.sh_error >= SH_ERROR_MAX:
        del builder  # its memory is needed
        builder = _decoded(source, rows_of, count, places, options, goal, half=False)
    if picked is not None:
        builder.dropped[SAMPLED] = source.count - count
    if options.raw_opacity and builder.dropped[OPACITY_RANGE] > len(builder):
        refuse(
            path,
            f"{builder.dropped[OPACITY_RANGE]} opacities lie outside 0..1, so they are logits; "
            "read the file without raw_opacity (--raw-opacity)",
        )
    if not len(builder):
        reasons = ", ".join(f"{r}: {n}" for r, n in builder.dropped.items() if r != SAMPLED)
        refuse(path, f"none of its Gaussians can be drawn ({reasons})")
    scene = builder.build(printable(name or path.name), numbers=numbers)
    return replace(scene, source=about, antialias=antialias)


def _decoded(
    source: Source,
    rows_of: Callable[[slice], slice | I64],
    count: int,
    places: I32 | None,
    options: ReadOptions,
    goal: int,
    *,
    half: bool,
) -> SceneBuilder:
    builder = SceneBuilder(count, source.coefficients, wide=source.wide, half=half)

    def add(part: slice) -> bool:
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):  # builder drops those
            rows = source.gaussians(rows_of(part), half)
        to = part if places is None else places[part]
        builder.add(*rows[:5], to, rows.sh_error)
        return builder.sh_error < SH_ERROR_MAX

    _sweep(add, count, lambda done: options.progress(goal - count + done, goal))
    return builder


def _sweep(work: Callable[[slice], bool], count: int, progress: Callable[[int], None]) -> None:
    """Calls ``work`` in threads with slices of 0..count, until one says False."""
    more = True

    def piece(start: int) -> int:
        nonlocal more
        stop = min(start + CHUNK, count)
        if more and not work(slice(start, stop)):
            more = False
        return stop

    progress(0)
    with ThreadPoolExecutor(min(default_threads(), THREADS), "tsplat-gather") as pool:
        for done in pool.map(piece, range(0, count, CHUNK)):
            progress(done)


def stretch(options: ReadOptions, first: float, last: float) -> ReadOptions:
    """``options`` of one step of reading, whose progress goes from ``first`` to ``last`` of 1."""

    def progress(done: int, total: int) -> None:
        options.progress(round(1000 * (first + (last - first) * done / max(total, 1))), 1000)

    return replace(options, progress=progress)


def left_of_one(parts: F64) -> F64:
    """[n] the component that makes three others [n, 3] a unit quaternion; 0 if they are too long.

    In float64: of a small one float32 would leave few digits.
    """
    return np.asarray(np.sqrt(np.maximum(1 - np.square(parts).sum(1), 0)))


def no_raw_opacity(path: Path, options: ReadOptions, kind: str) -> None:
    """Refuses ``raw_opacity`` for a format that has no other opacities."""
    if options.raw_opacity:
        refuse(
            path,
            f"opacities of {kind} are always 0..1; leave out raw_opacity (--raw-opacity)",
        )
