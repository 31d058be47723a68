"""mkkellogg's .ksplat 0.1: sections of Gaussians, plain (level 0) or quantised (levels 1 and 2).

Layout: mkkellogg/GaussianSplats3D ``src/loaders/SplatBuffer.js``. Little-endian: a header of
4096 bytes, headers of 1024 bytes for as many sections as it says, then each section: lengths of
its partly filled buckets, centres of all its buckets, Gaussians. A Gaussian is a position, three
standard deviations (linear), a quaternion w, x, y, z, colour and opacity in 255ths, and spherical
harmonics of degree 0 to 2, band by band, in each red, green and blue one after the other. Level 0
has float32. From level 1 on, positions are 16-bit steps from the centre of a bucket, and the rest
is float16; level 2 has bytes for harmonics, between two numbers in the header.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsplat.core.types import F32, F64, I32, I64, Floats, Scene
from tsplat.hookspecs import hookimpl
from tsplat.io.base import Read, Reader, ReadOptions, refuse, refuse_raw_opacity
from tsplat.io.clean import SceneBuilder, median
from tsplat.io.sweeps import Bytes, scene_of
from tsplat.io.table import COLORS, DC, LEVELS, MEAN, OPACITY, QUAT, REST, SCALE, Tables
from tsplat.io.unpack import look_up

HEADER = np.dtype(
    {
        "names": ["major", "minor", "sections", "count", "level", "sh_range"],
        "formats": ["u1", "u1", "<u4", "<u4", "<u2", ("<f4", 2)],
        "offsets": [0, 1, 4, 16, 20, 36],
        "itemsize": 4096,
    }
)
SECTION = np.dtype(
    {
        "names": [
            "count", "room", "bucket_size", "buckets", "block_size", "bucket_bytes", "range",
            "full", "partial", "degree",
        ],
        "formats": ["<u4", "<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 32, 36, 40],
        "itemsize": 1024,
    }
)  # fmt: skip

USED = 44
"""Bytes of the header that mean something."""

SECTIONS_MAX = 4096
"""Sections in a file; writers make one a scene or one a step of loading."""

SH_RANGE = 1.5
"""Harmonics of level 2 are in this range on both sides of zero, if the header says zero."""

RANGE = 32767
"""Steps from a bucket's centre to its side, if a section says zero."""

REST_COUNTS = (0, 9, 24)
"""Harmonics beyond the first of degree 0 to 2."""


def _places(rest: int) -> NDArray[np.intp]:
    """[rest / 3, 3] which number of a row's harmonics is which coefficient of r, g and b."""
    runs = [np.arange(3 * a, 3 * b).reshape(3, b - a).T for a, b in ((0, 3), (3, 8))]
    return np.concatenate(runs)[: rest // 3]


@dataclass(frozen=True)
class Section:
    """Gaussians that are stored alike."""

    first: int  # the number of its first Gaussian among all
    count: int
    at: int  # byte of its first Gaussian
    row: np.dtype[np.void]
    step: float  # world units
    middle: int  # the number of steps that is a bucket's centre
    ends: I64  # [buckets]  number of the first Gaussian behind each
    centers: F32  # [buckets, 3]

    def means(self, rows: NDArray[np.void], first: int) -> Floats:
        """[n, 3] of its Gaussians ``first``, first + 1, ..., as they are stored in ``rows``."""
        if not len(self.centers):
            stored: F32 = rows["means"]
            return stored
        last = first + len(rows)
        low = int(np.searchsorted(self.ends, first, "right"))
        high = int(np.searchsorted(self.ends, last, "left")) + 1
        ends = np.minimum(self.ends[low:high], last)
        counts = ends - np.maximum(np.append(first, ends[:-1]), first)
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            means: F64 = (rows["means"] - np.float64(self.middle)) * self.step
            means += np.repeat(self.centers[low:high], counts, axis=0)
        return means


def _row(level: int, degree: int) -> np.dtype[np.void]:
    """Of a Gaussian in the file."""
    position, number, rest = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))[
        level
    ]
    return np.dtype(
        [
            ("means", position, 3), ("scales", number, 3), ("quats", number, 4), ("rgba", "u1", 4),
            ("rest", rest, REST_COUNTS[degree]),
        ]
    )  # fmt: skip


class Rows:
    """Gaussians of all sections, one after the other, with their positions."""

    def __init__(self, file: Bytes, sections: list[Section]) -> None:
        self._file = file
        self._sections = sections
        self._firsts = np.array([section.first for section in sections])
        self.wide = _beyond_float32(sections)
        largest = max((section.row for section in sections), key=lambda row: row.itemsize)
        self.degree = REST_COUNTS.index(largest["rest"].shape[0])
        self.dtype = np.dtype(
            [
                ("means", "<f8" if self.wide else "<f4", 3),
                *((name, largest[name]) for name in ("scales", "quats", "rgba", "rest")),
                ("known", "u1"),  # harmonics that the section has
            ]
        )

    def __len__(self) -> int:
        last = self._sections[-1]
        return last.first + last.count

    def read(self, start: int, stop: int, room: NDArray[np.void]) -> NDArray[np.void]:
        """See :class:`tsplat.io.sweeps.FileRows`."""
        rows = room[: stop - start]
        index = int(np.searchsorted(self._firsts, start, "right")) - 1
        at = start
        while at < stop:
            section = self._sections[index]
            first = at - section.first
            size = min(stop - at, section.count - first)
            stored = np.empty(size, section.row)
            self._file.fill(stored, section.at + first * section.row.itemsize)
            part = rows[at - start : at - start + size]
            with np.errstate(over="ignore", invalid="ignore", under="ignore"):
                part["means"] = section.means(stored, first)
            for name in ("scales", "quats", "rgba"):
                part[name] = stored[name]
            rest = stored["rest"].shape[1]
            part["rest"][:, :rest] = stored["rest"]
            part["rest"][:, rest:] = 0
            part["known"] = rest
            at += size
            index += 1
        return rows


def _beyond_float32(sections: list[Section]) -> bool:
    """Whether float32 may be coarser than half a step at a typical bucket."""
    with np.errstate(over="ignore"):  # the mean of two centres at float32's end
        return any(
            median(np.abs(section.centers).max(1)) * 2.0**-24 > section.step / 2
            for section in sections
            if len(section.centers)
        )


class Layout:
    """See :class:`tsplat.io.sweeps.Layout`."""

    def __init__(self, rows: Rows, sh_range: tuple[float, float]) -> None:
        """``sh_range`` is of harmonics that are bytes."""
        rest = rows.dtype["rest"].shape[0]
        self.coefficients = 1 + rest // 3
        self.wide = rows.wide
        self._tables = Tables(_places(rest))
        low, high = sh_range
        self._low, self._step = np.float32(low), np.float32((high - low) / 255)

    def means(self, rows: NDArray[np.void]) -> Floats:
        """[n, 3] the positions of ``rows``."""
        means: Floats = rows["means"]
        return means

    def add(
        self, builder: SceneBuilder, to: slice | I32, rows: NDArray[np.void], raw_opacity: bool
    ) -> None:
        """Decodes ``rows``."""
        rgba, rest = rows["rgba"], rows["rest"]
        table = self._tables.room(len(rows))
        with np.errstate(over="ignore", invalid="ignore"):
            table[:, MEAN] = rows["means"]
            table[:, SCALE], table[:, QUAT] = rows["scales"], rows["quats"]
            look_up(rgba[:, 3:], LEVELS, table[:, OPACITY])
            look_up(rgba[:, :3], COLORS, table[:, DC])
            if rest.dtype == np.uint8:
                np.multiply(rest, self._step, out=table[:, REST])
                table[:, REST] += self._low
                columns = np.arange(rest.shape[1])
                if rows["known"].min(initial=len(columns)) < len(columns):
                    table[:, REST][columns >= rows["known"][:, None]] = 0
            else:
                table[:, REST] = rest
        self._tables.put(builder, to, table, rows["means"] if self.wide else None)


def _sections(path: Path, file: Bytes, size: int, header: NDArray[np.void]) -> list[Section]:
    """The sections that have Gaussians in them.

    Raises:
        SceneError: a header says what cannot be, or more than the file of ``size`` bytes holds.
    """
    count, level = int(header["sections"]), int(header["level"])
    if not 1 <= count <= SECTIONS_MAX:
        refuse(
            path,
            f"ksplat header, byte 4: {count} sections, expected 1 to {SECTIONS_MAX}; "
            "the file is damaged",
        )
    at = HEADER.itemsize + count * SECTION.itemsize
    _check_size(path, size, at, f"headers of {count} sections")
    headers = np.empty(count, SECTION)
    file.fill(headers, HEADER.itemsize)
    sections = []
    first = 0
    for index, head in enumerate(headers):
        where = f"ksplat section {index} (header at byte {HEADER.itemsize + 1024 * index})"
        section, at = _section(path, file, size, where, level, head, first, at)
        if section.count:
            sections.append(section)
            first += section.count
    if not sections:
        refuse(path, f"holds no Gaussians (ksplat of {count} sections, all empty)")
    if int(header["count"]) not in (0, first):
        refuse(
            path,
            f"ksplat header, byte 16: {int(header['count'])} Gaussians, but its sections have "
            f"{first}; the file is damaged",
        )
    return sections


def _section(
    path: Path, file: Bytes, size: int, where: str, level: int, head: np.void, first: int, at: int
) -> tuple[Section, int]:
    """The section that ``head`` describes and that begins at byte ``at``, and where it ends."""
    said = {name: int(head[name]) for name in SECTION.names or () if name != "block_size"}
    count, degree, full, partial = (said[n] for n in ("count", "degree", "full", "partial"))
    if degree >= len(REST_COUNTS):
        refuse(path, f"{where}: spherical harmonics of degree {degree}, expected 0 to 2")
    room = said["room"] or count  # some writers leave the room of a full section out
    if count > room:
        refuse(path, f"{where}: {count} Gaussians in room for {room}; the file is damaged")
    row = _row(level, degree)
    bucket_bytes = said["bucket_bytes"] * said["buckets"]
    data = at + 4 * partial + bucket_bytes
    _check_size(path, size, data + count * row.itemsize, where)
    ends, centers = np.empty(0, np.int64), np.empty((0, 3), np.float32)
    block_size = float(head["block_size"])
    bucket_size = said["bucket_size"] if level else 0
    if level and count:
        if said["bucket_bytes"] != 12:
            refuse(
                path, f"{where}: buckets of {said['bucket_bytes']} bytes, expected 12 (3 floats)"
            )
        if not bucket_size or not 0 < block_size < np.inf:
            refuse(
                path,
                f"{where}: buckets of {bucket_size} Gaussians and size {block_size:g}, expected "
                "more than 0 of both; the file is damaged",
            )
        if full + partial > said["buckets"]:
            refuse(
                path,
                f"{where}: {full} full and {partial} other buckets, expected "
                f"{said['buckets']}; the file is damaged",
            )
        lengths = np.empty(full + partial, "<u4")
        lengths[:full] = bucket_size
        file.fill(lengths[full:], at)
        ends = np.cumsum(lengths, dtype=np.int64)
        held = int(ends[-1]) if len(ends) else 0
        if held < count:
            refuse(
                path,
                f"{where}: buckets for {held} Gaussians, expected {count}; the file is damaged",
            )
        centers = np.empty((full + partial, 3), "<f4")
        file.fill(centers, at + 4 * partial)
    middle = said["range"] or RANGE
    step = block_size / 2 / middle
    section = Section(first, count, data, row, step, middle, ends, centers)
    return section, data + room * row.itemsize


def _check_size(path: Path, size: int, needed: int, what: str) -> None:
    if needed > size:
        refuse(
            path,
            f"truncated: {what} ends at byte {needed}, the file has {size}; "
            "copy or download it again",
        )


def read(path: Path, options: ReadOptions) -> Scene:
    """See :class:`tsplat.io.base.Read`."""
    refuse_raw_opacity(path, options, "ksplat")
    size = path.stat().st_size
    with Bytes(path) as file:
        _check_size(path, size, HEADER.itemsize, "its header")
        header = np.empty((), HEADER)
        file.fill(header, 0)
        level = int(header["level"])
        if level > 2:
            refuse(path, f"ksplat header, byte 20: compression level {level}, expected 0, 1 or 2")
        low, high = (
            float(end) or default
            for end, default in zip(header["sh_range"], (-SH_RANGE, SH_RANGE), strict=True)
        )
        rows = Rows(file, _sections(path, file, size, header))
        layout = Layout(rows, (low, high))
        about = f"ksplat level {level}, SH {rows.degree}"
        return scene_of(path, rows, layout, options, about=about)


def recognises(start: bytes) -> bool:
    """Whether a file begins like a ksplat: version 0.1 and nothing where nothing has a meaning."""
    if len(start) < HEADER.itemsize or any(start[USED : HEADER.itemsize]):
        return False
    header = np.frombuffer(start, HEADER, 1)[0]
    return bool(
        header["major"] == 0
        and header["minor"] >= 1
        and not any(start[2:4])
        and header["sections"] > 0
        and np.isfinite(np.frombuffer(start, "<f4", 5, 24)).all()  # centre, range of harmonics
    )


def _load() -> Read:
    return read


KSPLAT = Reader(
    name="ksplat",
    summary="mkkellogg's .ksplat, levels 0 to 2, spherical harmonics of degree 0 to 2",
    recognises=recognises,
    load=_load,
)


@hookimpl
def tsplat_readers() -> list[Reader]:
    """See :func:`tsplat.hookspecs.tsplat_readers`."""
    return [KSPLAT]
