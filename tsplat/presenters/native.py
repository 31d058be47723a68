"""The inner loops of ``dither.py`` and ``sixel.py`` by C, where that was built.

To the same bits as NumPy's and in a fraction of the time; meanwhile Python's other threads run.
Each function has its namesake there, which says what it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsplat.core.errors import KernelError
from tsplat.core.types import F64, I32, I64, U8

ffi: Any
lib: Any
try:
    import tsplat.presenters._encode as built

    ffi, lib = built.ffi, built.lib
except ImportError:  # no compiler when tsplat was installed
    ffi = lib = None


def pointer(array: NDArray[Any], ctype: str) -> Any:
    """The array's first element as a C pointer. The caller keeps the array."""
    return ffi.cast(f"{ctype} *", array.ctypes.data)


def _check(status: int, what: str) -> int:
    if status == lib.TSPLAT_REFUSED:
        raise KernelError(f"{what}: a count, a row or a column is out of range")
    return status


def to_uint8(values: NDArray[Any]) -> U8:
    """What Frame.to_uint8 makes of ``values`` [H, W, 3], float32."""
    values = np.ascontiguousarray(values)
    levels = np.empty(values.shape, np.uint8)
    lib.tsplat_levels(pointer(values, "float"), values.size, pointer(levels, "uint8_t"))
    return levels


def distinct(image: U8) -> tuple[I32, U8, I64]:
    """Bins, colours and counts of the pixels of ``image`` [H, W, 3]."""
    bins = np.empty(lib.TSPLAT_BINS, np.int32)
    colors = np.empty((lib.TSPLAT_BINS, 3), np.uint8)
    counts = np.empty(lib.TSPLAT_BINS, np.int64)
    sums = np.empty((lib.TSPLAT_BINS, 4), np.int64)
    image = np.ascontiguousarray(image)
    used = lib.tsplat_distinct(
        pointer(image, "uint8_t"), image.size // 3, pointer(bins, "int32_t"),
        pointer(colors, "uint8_t"), pointer(counts, "int64_t"), pointer(sums, "int64_t"),
    )  # fmt: skip
    return bins[:used], colors[:used], counts[:used]


def adaptive_palette(colors: U8, counts: I64, n: int) -> F64:
    """Of ``colors`` [C, 3] for ``counts`` [C] pixels."""
    groups, palette = np.empty(len(colors), np.uint8), np.empty((n, 3), np.float64)
    found = _check(
        lib.tsplat_adaptive_palette(
            pointer(colors, "uint8_t"), pointer(counts, "int64_t"), len(colors), n,
            pointer(groups, "uint8_t"), pointer(palette, "double"),
        ),
        "adaptive_palette",
    )  # fmt: skip
    return palette[:found]


def nearest(colors: U8, palette: U8) -> U8:
    """Rows [C] of ``palette`` [K, 3]."""
    first = np.empty(len(colors), np.uint8)
    status = lib.tsplat_nearest(
        pointer(colors, "uint8_t"), len(colors), pointer(palette, "uint8_t"), len(palette),
        pointer(first, "uint8_t"),
    )  # fmt: skip
    _check(status, "nearest")
    return first


def partners(colors: U8, palette: U8, first: U8, grain: float) -> U8:
    """Rows [C] of ``palette`` [K, 3]."""
    second = np.empty(len(colors), np.uint8)
    status = lib.tsplat_partners(
        pointer(colors, "uint8_t"), len(colors), pointer(palette, "uint8_t"), len(palette), grain,
        pointer(first, "uint8_t"), pointer(second, "uint8_t"),
    )  # fmt: skip
    _check(status, "partners")
    return second


def mixed(image: U8, table: NDArray[np.uint32], thresholds: U8) -> U8:
    """Rows [H, W] by ``table`` [32768]: first | second << 8 | level << 16."""
    image = np.ascontiguousarray(image)
    height, width = image.shape[:2]
    rows = np.empty((height, width), np.uint8)
    status = lib.tsplat_mixed(
        pointer(image, "uint8_t"), height, width, pointer(table, "uint32_t"),
        pointer(thresholds, "uint8_t"), pointer(rows, "uint8_t"),
    )  # fmt: skip
    _check(status, "mixed")
    return rows


def steady(image: U8, table: NDArray[np.uint32], palette: U8, tolerance: int) -> U8:
    """Rows [H, W] by ``table`` [32768]: first."""
    image = np.ascontiguousarray(image)
    height, width = image.shape[:2]
    rows = np.empty((height, width), np.uint8)
    status = lib.tsplat_steady(
        pointer(image, "uint8_t"), height, width, pointer(table, "uint32_t"),
        pointer(palette, "uint8_t"), tolerance, pointer(rows, "uint8_t"),
    )  # fmt: skip
    _check(status, "steady")
    return rows


def lines(rows: U8, source: I32, columns: I32) -> tuple[bytes, U8]:
    """Sixel data, and which colours are used.

    ``source`` [H] says which line of ``rows`` each row of the picture is, ``columns`` [W + 1] where
    each column begins and the last ends.
    """
    rows = np.ascontiguousarray(rows)
    count, width = rows.shape
    scratch = np.empty((width, lib.TSPLAT_SCRATCH), np.int32)
    used = np.empty(lib.TSPLAT_PALETTE, np.uint8)
    room = len(source) * width + 4096  # more than most take
    while True:
        out = np.empty(room, np.uint8)
        size = lib.tsplat_lines(
            pointer(rows, "uint8_t"), count, width, pointer(source, "int32_t"), len(source),
            pointer(columns, "int32_t"), pointer(scratch, "int32_t"), pointer(used, "uint8_t"),
            pointer(out, "uint8_t"), room,
        )  # fmt: skip
        if _check(size, "lines") != lib.TSPLAT_FULL:
            return out[:size].tobytes(), used
        room *= 4
