"""Niantic's SPZ: a byte or two for each number, one plane after the other, compressed.

Layout: nianticlabs/spz, README.md and ``src/cc/load-spz.cc``; extensions: ``extensions/README.md``.
Versions 1 to 3 are a gzip stream of a header of 16 bytes and the planes positions, alphas, colors,
scales, rotations, sh. Version 4 is a plain header of 32 bytes, extensions, a table of two uint64 a
plane (compressed, uncompressed) and the planes as zstd streams.

Axes are right, up, back (RUB) by that README; the file itself does not say, but for an extension
of version 4. Some writers leave a PLY file's axes (right, down, front): their scenes stand on their
heads here, and ``--up 0,1,0`` rights them.
"""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tsplat.core.types import F32, I64, U8, UPWARDS, Floats, Scene, Up
from tsplat.hookspecs import hookimpl
from tsplat.io.base import (
    Read,
    Reader,
    ReadOptions,
    check_memory,
    one_line,
    refuse,
    refuse_raw_opacity,
)
from tsplat.io.gather import UNPACKING, check_count, gather, stretch
from tsplat.io.table import DC, LEVELS, MEAN, OPACITY, QUAT, REST, SCALE, turned
from tsplat.io.turn import Turn, axes
from tsplat.io.unpack import PLACES, fixed_24, look_up, smallest_three

if TYPE_CHECKING:
    from collections.abc import Iterator

MAGIC = b"NGSP"
GZIP = b"\x1f\x8b"
HEADER = struct.Struct("<4sIIBBBB")
"""magic, version, Gaussians, degree, fractional bits, flags; version 4: streams, else nothing."""

HEADER_4 = 32
"""Bytes: HEADER, the table's offset (uint32), zeros."""

ENTRY = struct.Struct("<QQ")
WINDOW_LOG_MAX = 23
"""8 MB: what zstd's level 19 uses, and all up to it."""

NO_ZSTD = (
    "SPZ version 4 is packed with zstd, which Python has from 3.14 on; for this one: "
    "pip install backports.zstd"
)

PIECE = 1 << 20
"""Bytes unpacked at a time."""

ANTIALIASED, EXTENSIONS = 1, 2
COORDINATES = 0xADBE0003
"""SPZ_ADOBE_coordinate_system; its payload is a uint32, which counts SYSTEMS from 1."""

SYSTEMS = (
    "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF",
    "LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU",
)  # fmt: skip
"""``include/spz/splat-types.h``, CoordinateSystem, from 1 on."""

DEFAULT = "RUB"
PLANES = ("positions", "alphas", "colors", "scales", "rotations", "sh")
FRACTION_MAX = 30
"""Bits; 12 is usual and 23 the most that Niantic's library writes."""

_BYTES = np.arange(256, dtype=np.float64)[None]
with np.errstate(under="ignore"):
    SCALES = np.exp(_BYTES / 16 - 10).astype(np.float32)
COLORS = ((_BYTES / 255 - 0.5) / 0.15).astype(np.float32)
SH = ((_BYTES - 128) / 128).astype(np.float32)
THIRDS = _BYTES[0] / 127.5 - 1
SMALLEST = np.where(np.arange(1024) & 512, -1, 1) * (np.arange(1024) & 511) / 511 * np.sqrt(0.5)
"""Ten bits, a sign and nine of size, of one of the smallest three components of a quaternion."""

COUNTED = (PLACES + np.int8(1)) % np.int8(4)
"""PLACES in w, x, y, z: files count x, y, z, w."""

XYZ = np.tile(np.array([1, 2, 3, 0], np.int8), (256, 1))
"""[256, 4] the same where w is left out, whatever follows the bytes of x, y, z."""


@dataclass(frozen=True)
class Head:
    """What a file says of itself."""

    version: int
    count: int
    degree: int
    fraction: int  # fractional bits
    antialiased: bool

    @property
    def sizes(self) -> tuple[int, ...]:
        """Bytes a Gaussian, plane by plane."""
        rotation = 3 if self.version < 3 else 4
        return (6 if self.version == 1 else 9, 1, 3, 3, rotation, 3 * ((self.degree + 1) ** 2 - 1))

    @property
    def about(self) -> str:
        """For ``Scene.source``."""
        smooth = ", antialiased" if self.antialiased else ""
        return f"spz {self.version}, SH {self.degree}{smooth}"


class Splats:
    """The planes of a file; see :class:`tsplat.io.gather.Source`."""

    wide = False  # 24 bits and float16 fit into float32

    def __init__(self, head: Head, planes: list[U8], turn: Turn) -> None:
        """``planes`` in the order of PLANES, each ``count * size`` bytes."""
        self.count = head.count
        self.coefficients = (head.degree + 1) ** 2
        self._head = head
        self._turn = turn
        shaped = [p.reshape(head.count, s) for p, s in zip(planes, head.sizes, strict=True)]
        self._positions, self._alphas, self._colors, self._scales, self._rotations = shaped[:5]
        self._sh = shaped[5]

    def means(self, rows: slice | I64) -> Floats:
        """See :class:`tsplat.io.gather.Source`."""
        raw = self._positions[rows]
        means = np.empty((len(raw), 3), np.float32)
        self._fill_means(raw, means)
        return self._turn.means(means)

    def fill(self, rows: slice | I64, table: F32) -> None:
        """See :class:`tsplat.io.gather.Source`."""
        self._fill_means(self._positions[rows], table[:, MEAN])
        self._fill_quats(self._rotations[rows], table[:, QUAT])
        look_up(self._scales[rows], SCALES, table[:, SCALE])
        look_up(self._alphas[rows], LEVELS, table[:, OPACITY])
        look_up(self._colors[rows], COLORS, table[:, DC])
        look_up(self._sh[rows], SH, table[:, REST])
        turned(table, self._turn)

    def _fill_means(self, raw: U8, out: F32) -> None:
        if self._head.version == 1:
            out[:] = np.ascontiguousarray(raw).view("<f2")
        else:
            fixed_24(raw, 2.0**-self._head.fraction, out)

    def _fill_quats(self, raw: U8, out: F32) -> None:
        if self._head.version < 3:
            four = np.zeros((len(raw), 4), np.uint8)
            four[:, :3] = raw
            smallest_three(four.view("<u4")[:, 0], (0, 8, 16), THIRDS, 24, XYZ, out)
        else:
            words = np.ascontiguousarray(raw).view("<u4")[:, 0]
            smallest_three(words, (20, 10, 0), SMALLEST, 30, COUNTED, out)


def _head(path: Path, raw: bytes, size: int) -> Head:
    """The header; nothing it says is beyond what a file of ``size`` bytes may say."""
    _, version, count, degree, fraction, flags, _ = HEADER.unpack_from(raw)
    if not 1 <= version <= 4:
        refuse(
            path,
            f"SPZ version {version} (byte 4), expected 1 to 4; "
            "update tsplat, or write it as PLY with the program that made it",
        )
    check_count(path, count, size, "SPZ header's number of points (byte 8)")
    if degree == 4:
        refuse(
            path,
            "SPZ of SH degree 4 (byte 12), expected 0 to 3; write it with degree 3, "
            "or as PLY without the last band",
        )
    if degree > 4:
        refuse(path, f"SPZ header's SH degree (byte 12) is {degree}, expected 0 to 3")
    if fraction > FRACTION_MAX:
        refuse(
            path,
            f"SPZ header's fractional bits (byte 13) are {fraction}, expected 0 to {FRACTION_MAX}; "
            "the file is damaged",
        )
    head = Head(version, count, degree, fraction, bool(flags & ANTIALIASED))
    check_memory(path, count, (degree + 1) ** 2, sum(head.sizes), size)
    return head


class _Unpacked:
    """Reads what a decompressor makes of the file, never more than is asked for."""

    def __init__(
        self,
        path: Path,
        content: memoryview,
        decompressor: Any,
        faults: tuple[type[Exception], ...],
        what: str,
    ) -> None:
        """``decompressor`` is one of zlib's or zstd's, which raises one of ``faults``."""
        self._path = path
        self._content = content
        self._decompressor = decompressor
        self._faults = faults
        self._what = what
        self._at = 0
        self._more = b""

    def _next(self, most: int) -> bytes:
        """At most ``most`` bytes; none at the end of the stream or of the file."""
        decompressor = self._decompressor
        while not decompressor.eof:
            start = self._at
            fed: Any = self._more
            if not fed and getattr(decompressor, "needs_input", True):
                fed = self._content[start : start + PIECE]
                self._at += len(fed)
                if not fed:
                    return b""
            try:
                made: bytes = decompressor.decompress(fed, most)
            except self._faults as error:
                text = one_line(error, 80)
                refuse(
                    self._path,
                    f"{self._what} cannot be unpacked near byte {start}: {text}; "
                    "the file is damaged: copy or download it again",
                )
            self._more = getattr(decompressor, "unconsumed_tail", b"")
            if made:
                return made
        return b""

    def read(self, size: int, what: str, progress: Callable[[int], None] | None = None) -> U8:
        """[size] bytes."""
        # Pages that nothing is written to cost nothing: what is claimed is not what is used
        out = np.empty(size, np.uint8)
        at = 0
        while at < size:
            piece = self._next(min(size - at, PIECE))
            if not piece:
                refuse(
                    self._path,
                    f"truncated: {what} needs {size} bytes, {self._what} has {at}; "
                    "copy or download it again",
                )
            out[at : at + len(piece)] = np.frombuffer(piece, np.uint8)
            at += len(piece)
            if progress is not None:
                progress(at)
        return out

    def end(self, what: str) -> None:
        """Reads to the end, so that the checksum is compared; there may be nothing more."""
        if self._next(1):
            refuse(self._path, f"{self._what} holds more than {what}; the file is damaged")
        if not self._decompressor.eof:
            refuse(
                self._path, f"truncated: {self._what} has no end; copy or download the file again"
            )


def zstd_module() -> Any:
    """Python's from 3.14 on, else what was backported.

    Raises:
        ImportError: there is neither.
    """
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd


def _zstd() -> tuple[Any, type[Exception]]:
    """A maker of zstd decompressors and what they raise.

    Raises:
        ImportError: there is no zstd.
    """
    zstd = zstd_module()
    # A stream may ask for a window of 128 MB, which is allocated before it is looked at
    options = {int(zstd.DecompressionParameter.window_log_max): WINDOW_LOG_MAX}
    return partial(zstd.ZstdDecompressor, options=options), zstd.ZstdError


def _planes_gzip(path: Path, content: bytes, options: ReadOptions) -> tuple[Head, list[U8], str]:
    """Versions 1 to 3; also without the gzip around it, which only splat-transform reads."""
    if content.startswith(MAGIC):
        return _planes_bare(path, content)
    what = "its gzip stream"
    source = _Unpacked(path, memoryview(content), zlib.decompressobj(wbits=31), (zlib.error,), what)
    raw = source.read(HEADER.size, "the SPZ header").tobytes()
    if not raw.startswith(MAGIC):
        refuse(path, f"gzip stream that begins with {raw[:4]!r}, not 'NGSP': no SPZ file")
    head = _head(path, raw, len(content))
    if head.version > 3:
        refuse(path, f"SPZ version {head.version} in a gzip stream, expected 1 to 3")
    total = sum(head.sizes) * head.count
    planes = source.read(
        total, f"SPZ of {head.count} Gaussians", lambda done: options.progress(done, total)
    )
    source.end(f"{head.count} Gaussians")
    return head, _split(head, planes), DEFAULT


def _planes_bare(path: Path, content: bytes) -> tuple[Head, list[U8], str]:
    """Versions 1 to 3 without the gzip around it, as splat-transform reads them too."""
    if len(content) < HEADER.size:
        refuse(path, f"truncated: SPZ header: expected {HEADER.size} bytes, got {len(content)}")
    head = _head(path, content, len(content))
    wanted = HEADER.size + sum(head.sizes) * head.count
    if len(content) != wanted:
        refuse(
            path,
            f"SPZ of {head.count} Gaussians without compression has {wanted} bytes, "
            f"the file {len(content)}; copy or download it again",
        )
    return head, _split(head, np.frombuffer(content, np.uint8, offset=HEADER.size)), DEFAULT


def _split(head: Head, planes: U8) -> list[U8]:
    ends = np.cumsum([size * head.count for size in head.sizes])
    return np.split(planes, ends[:-1])


def _planes_zstd(path: Path, content: bytes, options: ReadOptions) -> tuple[Head, list[U8], str]:
    """Version 4."""
    if len(content) < HEADER_4:
        refuse(path, f"truncated: SPZ 4 header: expected {HEADER_4} bytes, got {len(content)}")
    head = _head(path, content, len(content))
    flags, streams = content[14], content[15]
    (table,) = struct.unpack_from("<I", content, HEADER.size)
    kept = [i for i, size in enumerate(head.sizes) if size]
    if streams != len(kept):
        refuse(
            path,
            f"SPZ header's number of streams (byte 15) is {streams}, expected {len(kept)} "
            f"of SH degree {head.degree}",
        )
    start = table + streams * ENTRY.size
    if table < HEADER_4:
        refuse(path, f"SPZ header's table offset (byte 16) is {table}, expected {HEADER_4} or more")
    if start > len(content):
        refuse(
            path,
            f"truncated: the table of its streams ends at byte {start}, the file at "
            f"{len(content)}; copy or download it again",
        )
    system = DEFAULT
    if flags & EXTENSIONS:
        for kind, payload in _extensions(path, content[HEADER_4:table]):
            if kind == COORDINATES:
                system = _system(path, payload)
    try:
        maker, fault = _zstd()
    except ImportError:
        refuse(path, NO_ZSTD)
    entries = [ENTRY.unpack_from(content, table + i * ENTRY.size) for i in range(streams)]
    total = start + sum(packed for packed, _ in entries)
    if total != len(content):
        refuse(
            path,
            f"its streams end at byte {total}, the file at {len(content)}; "
            "copy or download it again",
        )
    planes = [np.empty(0, np.uint8)] * len(PLANES)
    for i, (packed, unpacked) in zip(kept, entries, strict=True):
        wanted = head.sizes[i] * head.count
        if unpacked != wanted:
            refuse(
                path,
                f"SPZ stream {PLANES[i]} promises {unpacked} bytes, expected {wanted} "
                f"of {head.count} Gaussians",
            )
        part = memoryview(content)[start : start + packed]
        source = _Unpacked(path, part, maker(), (fault, EOFError), f"stream {PLANES[i]}")
        planes[i] = source.read(wanted, f"{head.count} Gaussians")
        source.end(f"{head.count} Gaussians")
        start += packed
        options.progress(start, len(content))
    return head, planes, system


def _extensions(path: Path, records: bytes) -> Iterator[tuple[int, bytes]]:
    """(type, payload) of each: uint32 type, uint32 bytes, payload."""
    at = 0
    while len(records) - at >= 8:
        kind, size = struct.unpack_from("<II", records, at)
        if size > len(records) - at - 8:
            refuse(
                path,
                f"SPZ extension at byte {HEADER_4 + at} promises {size} bytes, "
                f"{len(records) - at - 8} are left; the file is damaged",
            )
        yield kind, records[at + 8 : at + 8 + size]
        at += 8 + size


def _system(path: Path, payload: bytes) -> str:
    value = int.from_bytes(payload, "little") if len(payload) == 4 else -1
    if not 0 <= value <= len(SYSTEMS):
        refuse(path, f"SPZ extension of axes: {value}, expected 0 to {len(SYSTEMS)}")
    return SYSTEMS[value - 1] if value else DEFAULT


def recognises(start: bytes) -> bool:
    """Whether a file begins like one: gzip of "NGSP", or that itself.

    Of a gzip stream whose own header (a file name) is longer than ``start``, it is supposed.
    """
    if not start.startswith(GZIP):
        return start.startswith(MAGIC)
    stream = zlib.decompressobj(wbits=31)
    try:
        made = stream.decompress(start, len(MAGIC))
    except zlib.error:
        return False
    return made == MAGIC or (not made and len(start) >= 4096)


def read(path: Path, options: ReadOptions) -> Scene:
    """See :class:`tsplat.io.base.Read`.

    Memory: the file, its planes (19 bytes a Gaussian, 65 of degree 3, which is 1.3 to 3 times the
    file) and the scene, which is 3 to 7 times as large as an SPZ file.
    """
    refuse_raw_opacity(path, options, "SPZ")
    content = path.read_bytes()
    plain = content.startswith(MAGIC) and int.from_bytes(content[4:8], "little") >= 4
    unpack = _planes_zstd if plain else _planes_gzip
    head, planes, system = unpack(path, content, stretch(options, 0, UNPACKING))
    del content
    options = stretch(options, UNPACKING, 1)
    turn = Turn(axes(system))
    about = head.about if system == DEFAULT else f"{head.about}, axes {system}"
    told = f"an SPZ file's axes are {system} (not every writer heeds that)"
    if system != DEFAULT:
        told = f"the file says that its axes are {system}"
    up = Up(UPWARDS, f"{told}; turned to x right, y down, z forward")
    return gather(
        path, Splats(head, planes, turn), options, about=about, antialias=head.antialiased, up=up
    )


def _load() -> Read:
    return read


SPZ = Reader(
    name="spz",
    summary="Niantic's SPZ, versions 1 to 4",
    recognises=recognises,
    load=_load,
)


@hookimpl
def tsplat_readers() -> list[Reader]:
    """See :func:`tsplat.hookspecs.tsplat_readers`."""
    return [SPZ]
