"""Rows -> a scene's arrays by C, where that was built and can read such rows.

It does in one pass what ``ply.py``, ``clean.py`` and ``half.py`` do with NumPy, to the same bits,
in a quarter of the time; and leaves to them whatever is unusual.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsplat.core import curve
from tsplat.core.errors import KernelError
from tsplat.core.types import F16, F32, I32
from tsplat.io.half import SH_ERROR_MAX, SH_PEAKS

try:
    from tsplat.io._decode import ffi, lib
except ImportError:  # no compiler when tsplat was installed
    ffi = lib = None

FLOAT = np.dtype("<f4")


def pointer(array: NDArray[Any] | None, ctype: str) -> Any:
    """The array's first element as a C pointer; NULL for None. The caller keeps the array."""
    return ffi.NULL if array is None else ffi.cast(f"{ctype} *", array.ctypes.data)


class Decoder:
    """Decodes rows of one type. May be called by several threads at once."""

    def __init__(self, offsets: I32, stride: int, *, linear: bool = False) -> None:
        """``offsets`` [11 + 3 K] as tsplat_rows in decode.h has them, ``stride`` bytes of a row.

        ``linear``: scales are no logarithms, and opacities no logits.
        """
        self._offsets = offsets
        self._stride = stride
        self._linear = linear
        self._coefficients = (len(offsets) - lib.TSPLAT_SHAPE) // 3
        self._peaks = np.repeat(np.array(SH_PEAKS[: self._coefficients], np.float32), 3)

    def __call__(
        self,
        rows: NDArray[Any],
        means: F32,
        quats: F32,
        scales: F32,
        opacities: F32,
        sh: F32 | F16,
        to: slice | I32,
    ) -> float | None:
        """Decodes ``rows`` [n] to rows ``to`` of the other arrays, each [C, ...].

        Returns:
            A bound of what float16 does to a colour, as :func:`tsplat.io.half.to_half` does; None
            if some row cannot be drawn: then what stands in rows ``to`` is of no use.
        """
        # TSPLAT_ISA is for comparing; whether it names anything is for the backend to say
        plain = os.environ.get("TSPLAT_ISA") == "generic"
        rows = np.ascontiguousarray(rows)
        source = ffi.new(
            "tsplat_rows *",
            {
                "rows": pointer(rows, "uint8_t"), "count": len(rows), "stride": self._stride,
                "offsets": pointer(self._offsets, "int32_t"),
                "coefficients": self._coefficients, "linear": self._linear, "plain": plain,
            },
        )  # fmt: skip
        first, places = (to.start, None) if isinstance(to, slice) else (0, to)
        target = ffi.new(
            "tsplat_arrays *",
            {
                "places": pointer(places, "int32_t"), "first": first, "capacity": len(means),
                "means": pointer(means, "float"), "quats": pointer(quats, "float"),
                "scales": pointer(scales, "float"), "opacities": pointer(opacities, "float"),
                "sh": pointer(sh, "void"), "half": sh.dtype == np.float16,
                "peaks": pointer(self._peaks, "float"), "close": SH_ERROR_MAX,
            },
        )  # fmt: skip
        error = ffi.new("double *")
        status = lib.tsplat_decode(source, target, error)
        if status == lib.TSPLAT_BAD_ROWS:
            raise KernelError("decode: a count, a place or an offset is out of range")
        return None if status else float(error[0])


def curve_keys(means: F32, low: F32, scale: F32) -> NDArray[np.uint64]:
    """What :func:`tsplat.core.curve.curve_keys` makes, by C where that was built."""
    if lib is None:
        return curve.curve_keys(means, low, scale)
    keys = np.empty(len(means), np.uint64)
    lib.tsplat_curve_keys(
        pointer(means, "float"), len(means), pointer(low, "float"), pointer(scale, "float"),
        pointer(keys, "uint64_t"),
    )  # fmt: skip
    return keys


def decoder(dtype: np.dtype[np.void], names: tuple[str, ...]) -> Decoder | None:
    """What decodes rows of ``dtype``, with the properties ``names`` in the order of decode.h.

    None if there is nothing: no compiler when tsplat was installed, or numbers that are not
    little-endian float32.
    """
    if lib is None or sys.byteorder != "little":
        return None
    fields = [dtype.fields[name] for name in names]  # type: ignore[index]
    if any(field[0] != FLOAT for field in fields):
        return None
    return Decoder(np.array([field[1] for field in fields], np.int32), dtype.itemsize)


def table_decoder(columns: NDArray[np.integer]) -> Decoder | None:
    """What decodes tables of float32 with linear scales and opacities, as table.py has them.

    ``columns`` is in the order of decode.h. None if there is nothing.
    """
    if lib is None or sys.byteorder != "little":
        return None
    return Decoder(4 * columns.astype(np.int32), 4 * len(columns), linear=True)
