"""Niantic's SPZ, versions 2 to 4: planes of bytes, compressed.

Layout: see :mod:`tsplat.io.spz`. What is rounded to which value is as in nianticlabs/spz
``src/cc/load-spz.cc``, ``packGaussians``: harmonics of degree 1 keep 5 bits and higher ones 4, as
multiples of a power of two around 128, so that 0 stays 0. Two things are chosen by least error:
fractional bits, of which Niantic's library always writes 12, and of version 2 quaternions, whose
fourth component follows from the rounded three, the best of the eight roundings.

Axes become right, up, back (RUB): y and z change sign, quaternions and harmonics with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tsplat.core.errors import OutputError, ParamsError
from tsplat.core.types import F32, U8, UPWARDS
from tsplat.io.spz import (
    ANTIALIASED,
    DEFAULT,
    ENTRY,
    HEADER,
    HEADER_4,
    MAGIC,
    NO_ZSTD,
    PLANES,
    zstd_module,
)
from tsplat.io.turn import Turn, axes
from tsplat.io.write.base import (
    Clipped,
    WriteOptions,
    Written,
    logs,
    option,
    parts,
    smallest_three,
    unsaid,
)
from tsplat.io.write.gzip import Gzip
from tsplat.io.write.source import Source

VERSIONS = (2, 3, 4)
VERSION = 3
"""Read by every reader of SPZ met so far, and its quaternions are three times as exact as 2's."""

FRACTION = 12
"""Niantic's fractional bits: steps of 1/4096."""

FIXED_MAX = 2**23 - 1
FINE = 32
"""Times a typical Gaussian's size: steps may be no coarser, if the range allows."""

SH_BITS = 5, 4
LEVEL = 6
"""zlib's default, as in Niantic's library."""

LEVEL_4 = 12
"""zstd's, as in Niantic's library."""

CORNERS = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)], np.float64)


class Planes:
    """What is written of a source, plane by plane, in pieces."""

    def __init__(
        self, source: Source, version: int, fraction: int, sh_bits: tuple[int, int]
    ) -> None:
        self._source = source
        self._version = version
        self._fraction = fraction
        self._sh_bits = sh_bits
        self._turn = Turn(axes(DEFAULT))
        self.clipped = Clipped()

    def plane(self, name: str) -> Iterator[tuple[slice, NDArray[np.uint8]]]:
        """The bytes of one of PLANES; which Gaussians, and what they have there."""
        encode: Callable[[slice], U8] = getattr(self, f"_{name}")
        for part in parts(len(self._source)):
            yield part, np.ascontiguousarray(encode(part))

    def _positions(self, part: slice) -> U8:
        means = self._turn.means(self._source.means(part).astype(np.float64))
        fixed = np.rint(means * 2.0**self._fraction).astype("<i4")
        return fixed[..., None].view(np.uint8)[..., :3]

    def _alphas(self, part: slice) -> U8:
        return np.asarray(np.rint(self._source.opacities(part) * 255.0).astype(np.uint8))

    def _colors(self, part: slice) -> U8:
        found = self._source.sh(part)[:, 0].astype(np.float64) * (0.15 * 255) + 127.5
        what = "base coefficients are beyond 3.33 and clipped"
        self.clipped.see(what, (np.abs(found - 127.5) - 127.5) / (0.15 * 255), 0.5 / (0.15 * 255))
        return np.clip(np.rint(found), 0, 255).astype(np.uint8)

    def _scales(self, part: slice) -> U8:
        found = logs(self._source.scales(part))
        self.clipped.see("scales are below e^-10 and raised", -10 - found, 1 / 32)
        self.clipped.see("scales are above e^5.94 and clipped", found - 5.9375, 1 / 32)
        return np.clip(np.rint((found + 10) * 16), 0, 255).astype(np.uint8)

    def _rotations(self, part: slice) -> U8:
        quats: Any = self._turn.quats(self._source.quats(part))
        return _first_three(quats) if self._version < 3 else _smallest_three(quats)

    def _sh(self, part: slice) -> U8:
        """[n, 3 (K - 1)], coefficient by coefficient."""
        found = self._turn.sh(self._source.sh(part).copy())[:, 1:]
        what = "coefficients are beyond 1 and clipped"
        self.clipped.see(what, np.abs(found) - np.float32(1), 1 / 32)
        out = np.empty(found.shape, np.uint8)
        for bands, bits in zip((slice(0, 3), slice(3, None)), self._sh_bits, strict=True):
            bucket = np.float32(1 << (8 - bits))
            steps = np.rint(np.clip(found[:, bands], -2, 2) * (128 / bucket)) * bucket
            out[:, bands] = np.clip(steps + 128, 0, 255)
        return out.reshape(len(out), -1)


def _smallest_three(quats: F32) -> U8:
    """[n, 4]: which of x, y, z, w is the largest, then sign and nine bits of each other."""
    small, largest = smallest_three(quats, (1, 2, 3, 0))
    sizes = np.rint(np.abs(small) * (511 / math.sqrt(0.5))).astype(np.uint32)
    ten = np.minimum(sizes, 511) | (small < 0).astype(np.uint32) << 9
    words = largest.astype(np.uint32) << 30 | ten @ np.array([1 << 20, 1 << 10, 1], np.uint32)
    return np.asarray(words.astype("<u4")[:, None].view(np.uint8))


def _first_three(quats: F32) -> U8:
    """[n, 3]: x, y, z of b / 127.5 - 1, where w, which follows from them, is not negative.

    Where w is small, rounding the others to nearest moves it far: the best of all eight is taken.
    """
    wide = quats.astype(np.float64)
    wide *= np.where(wide[:, :1] < 0, -1.0, 1.0)
    low = np.clip(np.floor(wide[:, 1:] * 127.5 + 127.5), 0, 254)
    best, found = np.full(len(wide), -1.0), low.copy()
    for corner in CORNERS:
        thirds = (low + corner) / 127.5 - 1
        square = (thirds * thirds).sum(1)
        w = np.sqrt(np.maximum(1 - square, 0))
        near = ((thirds * wide[:, 1:]).sum(1) + w * wide[:, 0]) / np.sqrt(square + w * w)
        better = near > best
        found[better] = low[better] + corner
        best = np.maximum(best, near)
    return found.astype(np.uint8)


def fraction_bits(source: Source, asked: int | None) -> tuple[int, tuple[str, ...]]:
    """How many fractional bits positions get, and what there is to say about it.

    Raises:
        OutputError: positions do not fit, or only with steps larger than the Gaussians.
    """
    reach, size = source.reach(), source.typical_scale()
    room = math.floor(math.log2(FIXED_MAX / reach)) if reach > 0 else 23
    fine = math.ceil(math.log2(FINE / size)) if size > 0 else 0
    bits = asked if asked is not None else min(max(FRACTION, fine), room, 23)
    hint = "leave strays out with --crop, or write .ply"
    if bits > room:
        raise OutputError(
            f"positions up to {reach:.6g} do not fit into 24 bits with {bits} fractional ones, "
            f"which reach {FIXED_MAX / 2**bits:.6g}; ask for fewer, " + hint
        )
    if bits < 0 or (asked is None and 2.0**-bits > size > 0 and bits < FRACTION):
        raise OutputError(
            f"positions up to {reach:.6g} take steps of {2.0 ** -max(bits, 0):.3g} in 24 bits, a "
            f"typical Gaussian has a size of {size:.3g}; " + hint
        )
    if asked is None and bits < FRACTION:
        return bits, (
            f"{bits} fractional bits instead of {FRACTION}, because positions reach {reach:.6g}",
        )
    return bits, ()


def write(source: Source, out: BinaryIO, options: WriteOptions) -> Written:
    """See :class:`tsplat.io.write.base.Write`."""
    version = VERSION if options.version is None else options.version
    if version not in VERSIONS:
        raise ParamsError(
            f"{option('version')}: SPZ is written in versions 2, 3 and 4, got {version}"
        )
    if version > 3:
        try:
            zstd_module()
        except ImportError as error:
            raise OutputError(f"{NO_ZSTD}; or write version 3") from error
    fraction, notes = fraction_bits(source, options.fractional_bits)
    planes = Planes(source, version, fraction, options.sh_bits or SH_BITS)
    names = [name for name in PLANES if name != "sh" or source.degree]
    flags = ANTIALIASED if source.antialias else 0
    streams = len(names) if version > 3 else 0
    head = HEADER.pack(MAGIC, version, len(source), source.degree, fraction, flags, streams)
    done = 0

    def fill(sink: Any, name: str) -> int:
        nonlocal done
        size = 0
        for part, content in planes.plane(name):
            sink.write(content.tobytes())
            size += content.nbytes
            done += part.stop - part.start
            options.progress(done, len(names) * len(source))
        return size

    if version > 3:
        out.write(head + HEADER_4.to_bytes(4, "little") + bytes(HEADER_4 - HEADER.size - 4))
        out.write(bytes(ENTRY.size * streams))
        table = b""
        for name in names:
            start = out.tell()
            sink = _Zstd(out)
            size = fill(sink, name)
            sink.close()
            table += ENTRY.pack(out.tell() - start, size)
        out.seek(HEADER_4)
        out.write(table)
    else:
        with Gzip(out, LEVEL) as stream:
            stream.write(head)
            for name in names:
                fill(stream, name)
    notes += (*unsaid(source, "an SPZ file", antialias=True, up=UPWARDS),)
    if source.antialias is None:
        notes += ("it says that the scene was trained without antialiasing, as SPZ must say",)
    about = f"SPZ {version}, SH {source.degree}, {fraction} fractional bits"
    return Written(about, None, (*notes, *planes.clipped.notes()))


class _Zstd:
    """A zstd stream in ``out``."""

    def __init__(self, out: BinaryIO) -> None:
        self._out = out
        self._stream = zstd_module().ZstdCompressor(level=LEVEL_4)

    def write(self, data: bytes) -> None:
        self._out.write(self._stream.compress(data))

    def close(self) -> None:
        self._out.write(self._stream.flush())
