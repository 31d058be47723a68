"""A PLY file -> its vertex rows, through plyfile, once the header has been found to be true.

plyfile reads a header without end to the end of the file, allocates what a header promises, and
reads every element there is. So the header is cut out first (at most ``HEADER_MAX`` bytes), parsed
by plyfile with every count set to zero, and held against the file's size before anything is mapped
or allocated. Elements after ``vertex`` are then hidden from plyfile: in the header it is shown
their lines are comments of the same length, so offsets stay right.

Format: G. Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyListProperty, PlyParseError

from tsplat.core.errors import printable
from tsplat.io.base import one_line, refuse
from tsplat.io.sweeps import Bytes

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

HEADER_MAX = 1 << 17
"""Bytes. A header of 62 properties has 1,500; the rest is room for comments. plyfile takes two
microseconds a byte."""

ELEMENTS_MAX = 256
"""Elements in a file; splat files have one to eight."""

REFUSALS = (PlyParseError, ValueError, ArithmeticError, LookupError)
"""What plyfile raises of what it cannot read; some of it comes from NumPy and from decoding."""

ROWS_MAX = 1 << 16
"""Rows of lists, or of text, before the vertices: plyfile reads them one by one and keeps them."""

LINE_MAX = 1 << 20
"""Characters of a line of text; its words are Python's, twenty times as large."""


@dataclass(frozen=True)
class Element:
    """One line ``element name count``, with the properties below it."""

    name: str
    count: int
    properties: tuple[str, ...]
    lists: tuple[str, ...]  # the properties that are lists
    row: int  # bytes of a binary row, at least
    types: tuple[str, ...]  # of the properties, as NumPy names them; of a list, what it counts in


@dataclass(frozen=True)
class Header:
    """What a PLY file says of itself. Names are printable ASCII without spaces."""

    lines: tuple[bytes, ...]  # "ply" to "end_header"; other than printable bytes made spaces or "?"
    line_end: bytes
    text: bool  # ascii
    elements: tuple[Element, ...]

    def find(self, name: str) -> Element | None:
        """The element of that name."""
        return next((e for e in self.elements if e.name == name), None)

    @property
    def comments(self) -> list[str]:
        """What follows the word ``comment`` in each such line."""
        return [line[8:].decode("ascii") for line in self.lines if line.startswith(b"comment ")]

    def __len__(self) -> int:
        """Bytes, up to the first row."""
        return sum(map(len, self.lines)) + len(self.lines) * len(self.line_end)


def read_header(path: Path) -> Header:
    """The header of the file at ``path``.

    Raises:
        SceneError: it is not a PLY header, or promises more than the file holds.
    """
    with path.open("rb") as stream:
        start = stream.read(HEADER_MAX)
        size = stream.seek(0, io.SEEK_END)
    found = re.match(rb"ply(\r\n|\n|\r)", start)
    if not found:
        refuse(path, "not a PLY file: its first line is not 'ply'")
    line_end = found[1]
    end = start.find(line_end + b"end_header" + line_end)
    if end < 0:
        where = "anywhere" if size <= HEADER_MAX else f"in its first {HEADER_MAX} bytes"
        refuse(
            path,
            f"PLY header without an end_header line {where}; the file is damaged: "
            "copy or download it again",
        )
    lines = tuple(_plain(line) for line in start[: end + len(line_end)].split(line_end)[:-1])
    header = Header((*lines, b"end_header"), line_end, *_parsed(path, lines))
    _check_size(path, header, size)
    return header


def _plain(line: bytes) -> bytes:
    """A header line of the same length in ASCII without control characters."""
    return re.sub(rb"[^ -~]", b"?", line.translate(bytes.maketrans(b"\t\r\n", b"   ")))


def _parsed(path: Path, lines: tuple[bytes, ...]) -> tuple[bool, tuple[Element, ...]]:
    counts = []
    emptied = []
    for line in lines:
        words = line.split()
        if words[:1] == [b"element"] and len(words) > 2:
            counts.append(words[2])
            words[2] = b"0"
            emptied.append(b" ".join(words))
        else:
            emptied.append(line)
    if len(counts) > ELEMENTS_MAX:
        refuse(path, f"PLY header with {len(counts)} elements, expected at most {ELEMENTS_MAX}")
    for count in counts:
        if not re.fullmatch(rb"[0-9]{1,15}", count):
            shown = printable(count.decode("ascii"), 40)
            refuse(path, f"PLY header with an element count of {shown!r}; the file is damaged")
    try:
        # counts of zero: plyfile parses the whole header and neither reads nor allocates a row
        data = PlyData.read(io.BytesIO(b"\n".join([*emptied, b"end_header\n"])))
    except REFUSALS as error:
        refuse(path, f"PLY header that cannot be read: {one_line(error)}; it is damaged")
    order = data.byte_order
    elements = tuple(_element(e, int(c), order) for e, c in zip(data.elements, counts, strict=True))
    return bool(data.text), elements


def _element(element: Any, count: int, order: str) -> Element:
    lists = [p for p in element.properties if isinstance(p, PlyListProperty)]
    sizes = [
        p.list_dtype(order)[0] if isinstance(p, PlyListProperty) else p.dtype(order)
        for p in element.properties
    ]
    return Element(
        printable(element.name, 40),
        count,
        tuple(p.name for p in element.properties),
        tuple(p.name for p in lists),
        sum(np.dtype(s).itemsize for s in sizes),
        tuple(str(np.dtype(s).str) for s in sizes),
    )


def _check_size(path: Path, header: Header, size: int) -> None:
    """Refuses a file that is shorter than its header says."""
    promised = len(header)
    for element in header.elements:
        if element.count and not element.properties:
            refuse(
                path,
                f"PLY element {element.name} has {element.count} rows of no properties; damaged",
            )
        # a number in text is at least a digit and a space or line end
        promised += element.count * (2 * len(element.properties) if header.text else element.row)
    if header.text:
        promised -= 1  # the last line needs no end
    if size < promised:
        at_least = "at least " if header.text or any(e.lists for e in header.elements) else ""
        refuse(
            path,
            f"truncated: its header promises {at_least}{promised} bytes, the file has {size}; "
            "copy or download it again",
        )


class _Shown(io.FileIO):
    """The file, with another header of the same length; reports how far it has been read."""

    def __init__(self, path: Path, header: bytes, progress: Callable[[int, int], None]) -> None:
        super().__init__(path)
        self._header = header
        self._progress = progress
        self._total = path.stat().st_size

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        start = self.tell()
        count = super().readinto(buffer)
        other = self._header[start : start + count]
        memoryview(buffer).cast("B")[: len(other)] = other
        self._progress(start + count, self._total)
        return count


class _Bounded(io.BufferedReader):
    """Makes no room for more than the file has: lists say how long they are."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is None or size < 0:
            raise ValueError("a list of negative length")
        if size > 1 << 16:
            size = min(size, max(os.fstat(self.fileno()).st_size - self.tell(), 0))
        return super().read(size)


class _Lines(io.TextIOWrapper):
    """Text whose lines are not too long."""

    def readline(self, size: int = -1, /) -> str:  # type: ignore[override]
        line = super().readline(LINE_MAX if size < 0 else size)
        if len(line) >= LINE_MAX:
            raise ValueError(f"a line of {LINE_MAX} characters or more")
        return line


def _without_elements_after_vertex(header: Header) -> bytes:
    """The header with every line about a later element made a comment of the same length."""
    lines = []
    hidden = passed = False
    for line in header.lines:
        words = line.split()
        if words[:1] == [b"element"]:
            hidden = passed
            passed = passed or words[1] == b"vertex"
        if hidden and words[:1] in ([b"element"], [b"property"]):
            lines.append(line.replace(words[0], b"comment".ljust(len(words[0])), 1))
        else:
            lines.append(line)
    return b"".join(line + header.line_end for line in lines)


class Rows:
    """The N rows of element ``vertex``, to be read piece by piece.

    Threads may read at once.
    """

    def __init__(self, path: Path, table: NDArray[np.void]) -> None:
        """``table`` is all rows; if it is a map of the file, no more than its whereabouts."""
        self._count = len(table)
        self.dtype = table.dtype
        self._table = self._file = None
        if isinstance(table, np.memmap):
            self._offset = table.offset
            self._file = Bytes(path)
        else:
            self._table = table

    def __len__(self) -> int:
        return self._count

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._file is not None:
            self._file.__exit__(*exception)

    def read(self, start: int, stop: int, room: NDArray[np.void]) -> NDArray[np.void]:
        """See :class:`tsplat.io.sweeps.FileRows`."""
        if self._file is None:
            assert self._table is not None
            return self._table[start:stop]
        rows = room[: stop - start]
        self._file.fill(rows, self._offset + start * self.dtype.itemsize)
        return rows


def _vertices(source: io.TextIOWrapper | io.BufferedReader, header: Header) -> NDArray[np.void]:
    """Element ``vertex``, by plyfile."""
    with warnings.catch_warnings():
        if header.text:  # NumPy's, of a list of no numbers
            warnings.simplefilter("ignore", UserWarning)
        rows: NDArray[np.void] = PlyData.read(source, mmap="r")["vertex"].data
    return rows


def open_rows(path: Path, header: Header, progress: Callable[[int, int], None]) -> Rows:
    """The rows of element ``vertex``. ``progress`` is called while text is parsed.

    Raises:
        SceneError: plyfile cannot make sense of the rows.
    """
    for element in header.elements:
        if element.name == "vertex":
            break
        if (element.lists or header.text) and element.count > ROWS_MAX:
            kind = "lists" if element.lists else "text"
            refuse(
                path,
                f"PLY element {element.name} has {element.count} rows of {kind} before the "
                f"vertices, expected at most {ROWS_MAX}; write element vertex first",
            )
    shown = _without_elements_after_vertex(header)
    try:
        with _Bounded(_Shown(path, shown, progress), 1 << 16) as stream:
            # plyfile would wrap the bytes of a text file itself, and leave the wrapper open
            source = _Lines(stream, "ascii") if header.text else stream
            with source, np.errstate(over="ignore"):  # "1e99" is infinite in float32
                return Rows(path, _vertices(source, header))
    except REFUSALS as error:
        refuse(path, f"PLY rows that cannot be read: {one_line(error)}; the file is damaged")
