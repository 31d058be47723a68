"""PlayCanvas' compressed PLY: 16 bytes a Gaussian, quantised within chunks of 256.

Layout: playcanvas/splat-transform ``decompress-ply.ts`` and ``compressed-chunk.ts``. Element
``chunk`` has the range of positions and log scales of its 256 Gaussians, in newer files of
colours too. Element ``vertex`` has four packed numbers: position and log scale of 11, 10 and 11
bits (x highest), the quaternion's three smaller numbers of 10 bits below the index of the largest
(w, x, y, z), and r, g, b, opacity of 8 bits each (r highest). Element ``sh``, if there is one, has
a byte for each of ``f_rest_*``, channel-major: 0 is -4, 255 is 4, any other ``(b + 0.5) / 32 - 4``.

Opacities are 0..1, exactly as they are stored; a byte of 255 is 1.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tsplat.core.constants import SH_C0
from tsplat.core.types import F64, I32, Floats, Scene
from tsplat.hookspecs import hookimpl
from tsplat.io.base import Read, Reader, ReadOptions, refuse, refuse_raw_opacity
from tsplat.io.clean import SceneBuilder, median
from tsplat.io.says import says_antialias, says_up
from tsplat.io.sweeps import Bytes, scene_of
from tsplat.io.table import DC, LEVELS, MEAN, OPACITY, QUAT, REST, SCALE, Tables
from tsplat.io.unpack import PLACES, Parts, Ranges, in_ranges, look_up, smallest_three

if TYPE_CHECKING:
    from tsplat.io.plyrows import Element, Header

CHUNK = 256
"""Gaussians with a range of their own; the last chunk may have fewer."""

PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
POSITION_RANGE = ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z")
SCALE_RANGE = tuple(f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz")
COLOR_RANGE = ("min_r", "min_g", "min_b", "max_r", "max_g", "max_b")
REST_COUNTS = (0, 9, 24, 45)

VECTOR = Parts((21, 11, 0), (11, 10, 11))
COLOR = Parts((24, 16, 8), (8, 8, 8))

QUAT_STEP = 2**0.5 / 1023
QUATS = (np.arange(1024, dtype=np.float64) - 511.5) * QUAT_STEP
"""What ten bits of a quaternion mean."""

RESTS = ((np.arange(256)[None] + 0.5) / 32 - 4).astype(np.float32)
RESTS[0, [0, 255]] = -4, 4
"""What a byte of ``f_rest_*`` means."""


def packed(header: Header) -> bool:
    """Whether it is the header of a compressed PLY."""
    vertex = header.find("vertex")
    return vertex is not None and any(name in vertex.properties for name in PACKED)


class Rows:
    """Rows of ``vertex`` and ``sh`` side by side, each with its number."""

    def __init__(self, file: Bytes, vertex: Place, rest: Place | None) -> None:
        self._file = file
        self._vertex = vertex
        self._rest = rest
        count = 0 if rest is None else rest.columns
        self.dtype = np.dtype(
            [("row", np.int64), ("packed", np.uint32, 4), ("rest", np.uint8, count)]
        )

    def __len__(self) -> int:
        return self._vertex.count

    def read(self, start: int, stop: int, room: NDArray[np.void]) -> NDArray[np.void]:
        """See :class:`tsplat.io.sweeps.FileRows`."""
        rows = room[: stop - start]
        rows["row"] = np.arange(start, stop)
        vertex = self._vertex.read(self._file, start, stop)
        for i, name in enumerate(PACKED):
            rows["packed"][:, i] = vertex[name]
        if self._rest is not None:
            rest = self._rest.read(self._file, start, stop)
            if self._rest.in_order:
                rows["rest"] = rest.view(np.uint8).reshape(len(rest), -1)
            else:
                for i in range(self._rest.columns):
                    rows["rest"][:, i] = rest[f"f_rest_{i}"]
        return rows


class Place:
    """Where the rows of an element are in a file."""

    def __init__(self, element: Element, at: int) -> None:
        self.count = element.count
        self.columns = len(element.properties)
        self.dtype = np.dtype(list(zip(element.properties, element.types, strict=True)))
        self.in_order = element.properties == tuple(f"f_rest_{i}" for i in range(self.columns))
        self._at = at

    def read(self, file: Bytes, start: int, stop: int) -> NDArray[np.void]:
        """Rows ``start`` to ``stop``."""
        rows = np.empty(stop - start, self.dtype)
        file.fill(rows, self._at + start * self.dtype.itemsize)
        return rows


def _ranges(low: F64, high: F64, parts: Parts) -> Ranges:
    """From ``low`` to ``high`` [C, 3], in as many steps as ``parts`` has values."""
    return Ranges(low, (high - low) / [(1 << bits) - 1 for bits in parts.bits])


def _ends(chunks: NDArray[np.void], names: tuple[str, ...]) -> tuple[F64, F64]:
    """The lowest and highest numbers [C, 3] of the rows of element ``chunk``."""
    ends = np.stack([chunks[name] for name in names], 1).astype(np.float64)
    return ends[:, :3].copy(), ends[:, 3:].copy()


class Layout:
    """See :class:`tsplat.io.sweeps.Layout`."""

    def __init__(self, chunks: NDArray[np.void], rest: int) -> None:
        """``chunks`` is the rows of element ``chunk``, ``rest`` how many ``f_rest_*`` there are."""
        self._tables = Tables(np.arange(rest).reshape(3, rest // 3).T)
        self.coefficients = self._tables.coefficients
        self.rest = rest
        with np.errstate(over="ignore", invalid="ignore"):  # Gaussians of such ranges are dropped
            self._read_ranges(chunks)
        self.wide = self._beyond_float32()

    def _read_ranges(self, chunks: NDArray[np.void]) -> None:
        self._ends = _ends(chunks, POSITION_RANGE)
        self._positions = _ranges(*self._ends, VECTOR)
        self._logs = _ranges(*_ends(chunks, SCALE_RANGE), VECTOR)
        low, high = np.zeros((len(chunks), 3)), np.ones((len(chunks), 3))
        if COLOR_RANGE[0] in (chunks.dtype.names or ()):
            low, high = _ends(chunks, COLOR_RANGE)
        self._dc = _ranges((low - 0.5) / SH_C0, (high - 0.5) / SH_C0, COLOR)

    def _beyond_float32(self) -> bool:
        """Whether float32 may be coarser than half the steps that a typical chunk can tell apart.

        Whether that is coarse for the Gaussians is decided when their sizes are known.
        """
        low, high = self._ends
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is left out
            far = median(np.maximum(np.abs(low), np.abs(high)).max(1))
            step = median((high - low).max(1)) / 2047
        return far * 2.0**-24 > step / 2

    def means(self, rows: NDArray[np.void]) -> Floats:
        """[n, 3] the positions of ``rows``."""
        means = np.empty((len(rows), 3), np.float64 if self.wide else np.float32)
        in_ranges(rows["packed"][:, 0], VECTOR, rows["row"] // CHUNK, self._positions, means)
        return means

    def add(
        self, builder: SceneBuilder, to: slice | I32, rows: NDArray[np.void], raw_opacity: bool
    ) -> None:
        """Decodes ``rows``. Ranges and exp in float64: rounded once, to float32."""
        chunks = rows["row"] // CHUNK
        position, rotation, scale, color = rows["packed"].T
        table = self._tables.room(len(rows))
        means = np.empty((len(rows), 3)) if self.wide else table[:, MEAN]
        in_ranges(position, VECTOR, chunks, self._positions, means)
        smallest_three(rotation, (20, 10, 0), QUATS, 30, PLACES, table[:, QUAT])
        in_ranges(scale, VECTOR, chunks, self._logs, table[:, SCALE], exponent=True)
        look_up(color.astype(np.uint8)[:, None], LEVELS, table[:, OPACITY])  # the lowest
        in_ranges(color, COLOR, chunks, self._dc, table[:, DC])
        look_up(rows["rest"], RESTS, table[:, REST])
        self._tables.put(builder, to, table, means if self.wide else None)


def _check(path: Path, header: Header) -> tuple[Place, Place, Place | None]:
    """Where elements ``chunk``, ``vertex`` and ``sh`` are.

    Raises:
        SceneError: one is missing or is not as it should be.
    """
    if header.text:
        refuse(path, "compressed PLY in text (format ascii), expected binary; write it as binary")
    chunk, vertex, sh = (header.find(name) for name in ("chunk", "vertex", "sh"))
    assert vertex is not None  # packed() has found it
    if chunk is None:
        refuse(path, "compressed PLY without an element chunk; the file is damaged")
    colors = any(name in chunk.properties for name in COLOR_RANGE)
    rest = 0 if sh is None else len(sh.properties)
    if rest not in REST_COUNTS:
        refuse(
            path,
            f"compressed PLY whose element sh has {rest} properties, expected 9, 24 or 45: "
            "spherical harmonics of degree 1 to 3",
        )
    wanted = (
        (chunk, (*POSITION_RANGE, *SCALE_RANGE, *(COLOR_RANGE if colors else ())), "f4", "float"),
        (vertex, PACKED, "u4", "uint"),
        *([(sh, tuple(f"f_rest_{i}" for i in range(rest)), "u1", "uchar")] if sh else []),
    )
    for element, names, kind, called in wanted:
        types = dict(zip(element.properties, element.types, strict=True))
        for name in names:
            if types.get(name, "")[1:] != kind or name in element.lists:
                refuse(
                    path,
                    f"compressed PLY whose element {element.name} has no {called} {name}; "
                    "the file is damaged",
                )
    if not vertex.count:
        refuse(path, "holds no Gaussians (element vertex 0)")
    chunks = -(-vertex.count // CHUNK)
    if chunk.count != chunks:
        refuse(
            path,
            f"compressed PLY with {chunk.count} chunks, expected {chunks} for its {vertex.count} "
            f"Gaussians, one for {CHUNK}; the file is damaged",
        )
    if sh is not None and sh.count != vertex.count:
        refuse(
            path,
            f"compressed PLY whose element sh has {sh.count} rows, expected {vertex.count}, one a "
            "Gaussian; the file is damaged",
        )
    places: dict[str, Place] = {}
    at = len(header)
    for element in header.elements:
        if element.lists and element.count and len(places) < len(wanted):
            refuse(
                path,
                f"compressed PLY with rows of lists (element {element.name}) before its "
                "Gaussians; write element chunk first",
            )
        if element in (chunk, vertex, sh):
            places[element.name] = Place(element, at)
        at += element.count * element.row
    return places["chunk"], places["vertex"], places.get("sh")


def read(path: Path, options: ReadOptions) -> Scene:
    """See :class:`tsplat.io.base.Read`."""
    from tsplat.io.plyrows import read_header

    header = read_header(path)
    if not packed(header):
        refuse(path, "PLY header without packed_* properties of element vertex; it is damaged")
    refuse_raw_opacity(path, options, "compressed PLY")
    chunk, vertex, sh = _check(path, header)
    with Bytes(path) as file:
        chunks = chunk.read(file, 0, chunk.count)
        layout = Layout(chunks, 0 if sh is None else sh.columns)
        about = f"compressed PLY, {chunk.count} chunks, SH {REST_COUNTS.index(layout.rest)}"
        return scene_of(
            path, Rows(file, vertex, sh), layout, options, about=about,
            antialias=says_antialias(header.comments), up=says_up(header.comments),
        )  # fmt: skip


def recognises(start: bytes) -> bool:
    """Whether a file begins like a PLY file of packed numbers."""
    head = start.partition(b"end_header")[0]
    return re.match(rb"ply[\r\n]", head) is not None and any(
        re.search(rb"[\r\n]property [^\r\n]* %b[ \r\n]" % name.encode(), head) for name in PACKED
    )


def _load() -> Read:
    import tsplat.io.plyrows  # noqa: F401 - plyfile, and what is wrong with it, now

    return read


COMPRESSED = Reader(
    name="compressed-ply",
    summary="PlayCanvas' compressed PLY, spherical harmonics of degree 0 to 3",
    recognises=recognises,
    load=_load,
)


@hookimpl
def tsplat_readers() -> list[Reader]:
    """See :func:`tsplat.hookspecs.tsplat_readers`."""
    return [COMPRESSED]
