"""Packed numbers -> columns of a table of float32: what formats have in common.

By C where that was built, else by NumPy, to the same bits. Rows may be any distance apart in
memory, the numbers of one row may not.
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tsplat.core.types import F32, F64, I64, U8, Floats

try:
    from tsplat.io._unpack import ffi, lib
except ImportError:  # no compiler when tsplat was installed
    ffi = lib = None

U32 = NDArray[np.uint32]
I8 = NDArray[np.int8]
Three = tuple[int, int, int]

WORDS = sys.byteorder == "little"
"""Whether C reads words as NumPy does: lowest byte first."""

PLACES = np.array(
    [[j for j in range(4) if j != largest] + [largest] for largest in range(4)], np.int8
)
"""[4, 4] where the three others and the largest of four components stand, by which it is."""

KINDS = {"int8_t": "i1", "int64_t": "i8", "float": "f4", "double": "f8"}
"""What C calls the numbers of arrays."""


class Parts(NamedTuple):
    """Where three numbers are in 32 bits."""

    shifts: Three
    bits: Three

    def of(self, words: U32) -> list[U32]:
        """The numbers, [n] each."""
        return [
            words >> np.uint32(shift) & np.uint32((1 << bits) - 1)
            for shift, bits in zip(self.shifts, self.bits, strict=True)
        ]


class Ranges(NamedTuple):
    """Ranges [C] of three numbers: ``low`` [C, 3], and ``step`` [C, 3] to the next value."""

    low: F64
    step: F64


def _pointer(array: NDArray[Any], ctype: str) -> Any:
    """Of an array in one piece; the caller keeps it."""
    assert array.dtype == KINDS[ctype]
    assert array.flags.c_contiguous
    return ffi.cast(f"{ctype} *", array.ctypes.data)


def _columns(rows: NDArray[Any], out: NDArray[Any]) -> Any:
    """``tsplat_columns`` from ``rows`` to ``out``; the caller keeps both."""
    for array in (rows, out):  # of an array that is empty, strides say nothing
        assert array.ndim == 1 or array.strides[1] == array.itemsize or array.size <= len(array)
    assert rows.dtype in ("u1", "<u4")
    assert out.dtype in ("f4", "f8")
    return ffi.new(
        "tsplat_columns *",
        {
            "from": ffi.cast("uint8_t *", rows.ctypes.data), "stride": rows.strides[0],
            "to": ffi.cast("float *", out.ctypes.data), "width": out.strides[0] // out.itemsize,
            "count": len(rows),
        },
    )  # fmt: skip


def look_up(numbers: U8, tables: F32, out: F32) -> None:
    """``out`` [n, B]: bytes ``numbers`` [n, B] by ``tables`` [B, 256], or by one [1, 256]."""
    one = len(tables) == 1
    if lib is not None:
        pointer = _pointer(tables, "float")
        lib.tsplat_look_up(_columns(numbers, out), numbers.shape[1], pointer, one)
    elif one:
        out[:] = tables[0][numbers]
    else:
        for column, table in enumerate(tables):
            out[:, column] = table[numbers[:, column]]


def fixed_24(raw: U8, factor: float, out: F32) -> None:
    """``out`` [n, 3]: three little-endian integers of 24 bits with a sign, ``raw`` [n, 9], times
    ``factor``, which is rounded to float32.
    """
    if lib is not None:
        lib.tsplat_fixed_24(_columns(raw, out), factor)
        return
    words = np.zeros((len(raw), 3, 4), np.uint8)
    words[..., 1:] = raw.reshape(-1, 3, 3)
    out[:] = (words.view("<i4")[..., 0] >> 8).astype(np.float32) * np.float32(factor)


def smallest_three(words: U32, shifts: Three, values: F64, tag: int, places: I8, out: F32) -> None:
    """``out`` [n, 4]: quaternions w, x, y, z whose largest component ``words`` [n] leave out.

    Each other one is in ``values``, at the bits from one of ``shifts`` on; the largest makes the
    quaternion one long, or is 0 if the others do. Bits from ``tag`` on say where they stand:
    ``places`` [2^(32 - tag), 4] has first the three, then the largest; a row of -1 means nothing,
    and becomes a quaternion of zeros. Worked out in float64: of a small one float32 would leave
    few digits.
    """
    bits = len(values).bit_length() - 1
    if lib is not None and WORDS:
        lib.tsplat_smallest_three(
            _columns(words, out), shifts, bits, _pointer(values, "double"), tag,
            _pointer(places, "int8_t"),
        )  # fmt: skip
        return
    parts = [values[part] for part in Parts(shifts, (bits, bits, bits)).of(words)]
    left = np.sqrt(np.maximum(1 - sum(part * part for part in parts), 0))
    whole = np.stack([*parts, left], 1).astype(np.float32)
    where = places[words >> np.uint32(tag)]
    whole[where[:, 0] < 0] = 0
    quats = np.empty_like(whole)
    np.put_along_axis(quats, np.where(where < 0, np.arange(4), where), whole, 1)
    out[:] = quats


def in_ranges(
    words: U32, parts: Parts, chunks: I64, ranges: Ranges, out: Floats, *, exponent: bool = False
) -> None:
    """``out`` [n, 3]: ``parts`` of ``words`` [n] within the ranges of ``chunks`` [n].

    e to that power if ``exponent``. Worked out in float64, which ``out`` may be; float32 is what
    float64 is rounded to.
    """
    if lib is not None and WORDS:
        wide = out.dtype == np.float64
        lib.tsplat_in_ranges(
            _columns(words, out), parts.shifts, parts.bits, _pointer(chunks, "int64_t"),
            _pointer(ranges.low, "double"), _pointer(ranges.step, "double"), exponent,
            _pointer(out, "double") if wide else ffi.NULL,
        )  # fmt: skip
        return
    values = np.stack(parts.of(words), 1).astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        values *= ranges.step.take(chunks, 0)
        values += ranges.low.take(chunks, 0)
        out[:] = np.exp(values) if exponent else values
