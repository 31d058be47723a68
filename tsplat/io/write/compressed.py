"""PlayCanvas' compressed PLY: 16 bytes a Gaussian and one a coefficient, chunks of 256.

Layout: see :mod:`tsplat.io.compressed`. Each chunk has its own ranges, so Gaussians are put into an
order first in which chunks are compact in space. Every number is the nearest that the format has,
worked out in float64 from the ranges as they are in the file.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from tsplat.core.constants import SH_C0
from tsplat.core.types import F32, F64, I64
from tsplat.io.compressed import (
    CHUNK,
    COLOR_RANGE,
    PACKED,
    POSITION_RANGE,
    QUAT_STEP,
    SCALE_RANGE,
)
from tsplat.io.write.base import (
    ROWS,
    Clipped,
    WriteOptions,
    Written,
    comments,
    logs,
    parts,
    smallest_three,
)
from tsplat.io.write.order import compact_order
from tsplat.io.write.source import Source

LOGS_RANGE = 20.0
"""Below the largest scale of a chunk; e^-20 of it is flat, and a wider range is coarser for all."""

RANGES = (*POSITION_RANGE, *SCALE_RANGE, *COLOR_RANGE)
BITS_11_10_11 = np.array([2047.0, 1023.0, 2047.0])
BITS_8 = np.full(3, 255.0)
COARSE = 1.0, 2.0, 1.0
"""Of positions: y has a bit less."""

FEW = 0.75, 255.25
"""Where the nearest value changes at the ends: see :func:`_rest`."""


def header(source: Source) -> bytes:
    """All before the first row."""
    count, rest = len(source), 3 * (source.coefficients - 1)
    lines = ["ply", "format binary_little_endian 1.0", *comments(source)]
    lines += [f"element chunk {-(-count // CHUNK)}"]
    lines += [f"property float {name}" for name in RANGES]
    lines += [f"element vertex {count}", *(f"property uint {name}" for name in PACKED)]
    if rest:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(rest))]
    return "\n".join([*lines, "end_header", ""]).encode()


def write(source: Source, out: BinaryIO, options: WriteOptions) -> Written:
    """See :class:`tsplat.io.write.base.Write`."""
    count, rest = len(source), 3 * (source.coefficients - 1)
    order = compact_order(source, CHUNK, COARSE)
    head = header(source)
    out.write(head)
    ranges_at = len(head)
    packed_at = ranges_at + 4 * len(RANGES) * -(-count // CHUNK)
    rest_at = packed_at + 4 * len(PACKED) * count
    clipped = Clipped()
    for part in parts(count, ROWS):
        rows = order[part]
        ranges, packed = _packed(source, rows, clipped)
        out.seek(ranges_at + 4 * len(RANGES) * (part.start // CHUNK))
        out.write(ranges.data)
        out.seek(packed_at + 4 * len(PACKED) * part.start)
        out.write(packed.data)
        if rest:
            out.seek(rest_at + rest * part.start)
            out.write(_rest(source.sh(rows, 1), clipped).data)
        options.progress(part.stop, count)
    notes = [*clipped.notes()]
    if source.wide:
        notes.append("ranges far from zero: readers that work in float32 lose detail")
    return Written(f"compressed PLY, SH {source.degree}", order, tuple(notes))


def _packed(
    source: Source, rows: I64, clipped: Clipped
) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """[C, 18] the ranges of chunks and [n, 4] the packed numbers of ``rows``."""
    chunks = -(-len(rows) // CHUNK)
    ranges = np.empty((chunks, len(RANGES)), "<f4")
    packed = np.empty((len(rows), 4), "<u4")
    means = source.means(rows).astype(np.float64)
    packed[:, 0] = _quantised(means, BITS_11_10_11, ranges[:, 0:6]) @ [1 << 21, 1 << 11, 1]
    small, largest = smallest_three(source.quats(rows), (0, 1, 2, 3))
    steps = np.clip(np.rint(small / QUAT_STEP + 511.5), 0, 1023).astype(np.uint32)
    packed[:, 1] = largest.astype(np.uint32) << 30 | steps @ np.array([1 << 20, 1 << 10, 1], "<u4")
    sizes = logs(source.scales(rows))
    least = _chunked(sizes).max(2).T.repeat(CHUNK, 0)[: len(sizes)] - LOGS_RANGE
    clipped.see("scales are below e^-20 of their chunk's largest, and raised", least - sizes, 0)
    packed[:, 2] = _quantised(np.maximum(sizes, least), BITS_11_10_11, ranges[:, 6:12]) @ [
        1 << 21, 1 << 11, 1,
    ]  # fmt: skip
    colors = 0.5 + SH_C0 * source.sh(rows)[:, 0].astype(np.float64)
    packed[:, 3] = _quantised(colors, BITS_8, ranges[:, 12:18]) @ [1 << 24, 1 << 16, 1 << 8]
    packed[:, 3] |= np.rint(source.opacities(rows) * 255.0).astype(np.uint32)
    return ranges, packed


def _chunked(values: F64) -> F64:
    """[3, C, CHUNK] of [n, 3], each column by itself; the last chunk is filled with its last row.

    NumPy's minima along rows of 256 are several times as fast as those down rows of three.
    """
    over = -len(values) % CHUNK
    full = np.concatenate([values, values[-1:].repeat(over, 0)]) if over else values
    return np.ascontiguousarray(full.T).reshape(3, -1, CHUNK)


def _quantised(values: F64, steps: F64, ranges: F32) -> I64:
    """[n, 3] the nearest steps of the ranges, which are put into ``ranges`` [C, 6]."""
    full = _chunked(values)
    low, high = _below(full.min(2)), -_below(-full.max(2))
    ranges[:, :3], ranges[:, 3:] = low.T, high.T
    width = high.astype(np.float64) - low
    share = np.divide(steps[:, None], width, out=np.zeros_like(width), where=width > 0)
    full -= low[..., None]
    full *= share[..., None]
    return np.rint(full, out=full).reshape(3, -1).T[: len(values)].astype(np.int64)


def _below(values: F64) -> F32:
    """The largest float32 that are not above ``values``."""
    with np.errstate(under="ignore"):
        near = values.astype(np.float32)
    return np.where(near > values, np.nextafter(near, np.float32(-np.inf)), near)


def _rest(sh: F32, clipped: Clipped) -> NDArray[np.uint8]:
    """[n, 3 (K - 1)] bytes, channel-major.

    0 is -4, 255 is 4, and b between is (b + 1/2) / 32 - 4: from -4 to the next are 3/64, so the
    first and last step are cut at 3/4 of their width.
    """
    clipped.see("coefficients are beyond 4 and clipped", np.abs(sh) - np.float32(4), 1 / 64)
    place = (np.clip(sh, -4, 4) + np.float32(4)) * np.float32(32)
    found = np.clip(place, 1, 254).astype(np.uint8)
    found[place < FEW[0]] = 0
    found[place >= FEW[1]] = 255
    return np.ascontiguousarray(found.transpose(0, 2, 1)).reshape(len(sh), -1)
