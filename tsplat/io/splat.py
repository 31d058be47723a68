"""antimatter15's .splat: rows of 32 bytes, and nothing else.

Layout: antimatter15/splat ``convert.py`` and ``main.js``. Little-endian: position 3 float32,
standard deviations 3 float32 (linear), colour r, g, b and opacity 4 bytes of 255ths, quaternion
w, x, y, z 4 bytes. What the colour bytes hold is ``0.5 + SH_C0 f_dc``: spherical harmonics of
degree 0. A quaternion's byte is ``128 q + 128``, cut off; ``main.js`` reads ``(byte - 128) / 128``
and so is done here (playcanvas/splat-transform reads ``byte / 127.5 - 1``, up to 0.9 degrees off).

There is no magic number. A file is taken for one if its first rows could be Gaussians, and only
if no other reader wants it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsplat.core.types import F32, I32, Floats, Scene
from tsplat.hookspecs import hookimpl
from tsplat.io.base import Read, Reader, ReadOptions, refuse, refuse_raw_opacity
from tsplat.io.clean import SceneBuilder
from tsplat.io.sweeps import Bytes, scene_of
from tsplat.io.table import COLORS, DC, LEVELS, MEAN, OPACITY, QUAT, SCALE, Tables
from tsplat.io.unpack import look_up

ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)])

LIKELY = 0.9
"""Of the rows seen, as many must have positions and scales of which scenes are made."""

UNIT = 0.5
"""Of the rows seen, as many must have quaternions of length 1: everybody who writes the format
normalises them, and rows of other floats that happen to be positive have them now and then."""

MEANS_RANGE = 1e-12, 1e8
SCALES_RANGE = 1e-12, 1e6
"""Sizes of what is not zero. As floats, text is either below or above, small integers are below."""

UNIT_RANGE = 0.9, 1.1
"""Lengths; bytes make them wrong by 1/64 at most."""


class Rows:
    """The rows of a file."""

    dtype = ROW

    def __init__(self, file: Bytes, count: int) -> None:
        self._file = file
        self._count = count

    def __len__(self) -> int:
        return self._count

    def read(self, start: int, stop: int, room: NDArray[np.void]) -> NDArray[np.void]:
        """See :class:`tsplat.io.sweeps.FileRows`."""
        rows = room[: stop - start]
        self._file.fill(rows, start * ROW.itemsize)
        return rows


class Layout:
    """See :class:`tsplat.io.sweeps.Layout`."""

    coefficients = 1
    wide = False  # positions are float32

    def __init__(self) -> None:
        self._tables = Tables()

    def means(self, rows: NDArray[np.void]) -> Floats:
        """[n, 3] the positions of ``rows``."""
        means: F32 = rows["means"]
        return means

    def add(
        self, builder: SceneBuilder, to: slice | I32, rows: NDArray[np.void], raw_opacity: bool
    ) -> None:
        """Decodes ``rows``."""
        rgba = rows["rgba"]
        table = self._tables.room(len(rows))
        table[:, MEAN], table[:, SCALE] = rows["means"], rows["scales"]
        np.subtract(rows["quats"], np.float32(128), out=table[:, QUAT])
        look_up(rgba[:, 3:], LEVELS, table[:, OPACITY])
        look_up(rgba[:, :3], COLORS, table[:, DC])
        self._tables.put(builder, to, table)


def read(path: Path, options: ReadOptions) -> Scene:
    """See :class:`tsplat.io.base.Read`."""
    refuse_raw_opacity(path, options, ".splat")
    size = path.stat().st_size
    count, over = divmod(size, ROW.itemsize)
    if over:
        refuse(
            path,
            f"truncated .splat: {size} bytes, which are {count} rows of {ROW.itemsize} and {over} "
            "over; copy or download it again",
        )
    with Bytes(path) as file:
        return scene_of(path, Rows(file, count), Layout(), options, about=".splat")


def recognises(start: bytes) -> bool:
    """Whether a file may be rows of Gaussians: its first ones could be, and it is no text."""
    count = len(start) // ROW.itemsize
    if not count or not _beyond_text(start):
        return False
    rows = np.frombuffer(start, ROW, count)
    with np.errstate(invalid="ignore", over="ignore"):
        likely = _within(rows["means"], MEANS_RANGE).all(1)
        likely &= (_within(rows["scales"], SCALES_RANGE) & (rows["scales"] >= 0)).all(1)
        likely &= (rows["scales"] > 0).any(1)
    lengths = np.linalg.norm(rows["quats"] / 128 - 1, axis=1)
    unit = (lengths >= UNIT_RANGE[0]) & (lengths <= UNIT_RANGE[1])
    return bool(likely.mean() >= LIKELY and unit.mean() >= UNIT)


def _beyond_text(start: bytes) -> bool:
    """Whether there are bytes that are in no text."""
    return bool(start.translate(None, bytes([*range(9, 14), *range(32, 127)])))


def _within(values: NDArray[np.float32], sizes: tuple[float, float]) -> NDArray[np.bool_]:
    """Where ``values`` are zero or of such a size."""
    found = np.abs(values)
    within: NDArray[np.bool_] = (found == 0) | ((found >= sizes[0]) & (found <= sizes[1]))
    return within


def _load() -> Read:
    return read


SPLAT = Reader(
    name="splat",
    summary="antimatter15's .splat: 32 bytes a Gaussian, colours without view dependence",
    recognises=recognises,
    load=_load,
    guesses=True,
)


@hookimpl
def tsplat_readers() -> list[Reader]:
    """See :func:`tsplat.hookspecs.tsplat_readers`."""
    return [SPLAT]
