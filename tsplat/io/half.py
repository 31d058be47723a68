"""float32 coefficients -> float16, and how far that can move a colour.

NumPy's own cast takes 5 ns a number, and 80 ns where a number is below float16's normal range:
longer than everything else that NumPy does in loading. This one takes 3 ns and at most 20, with
the bound of the error 4 and 22 (4,096 rows of degree 3, one core). The decoder in C does the same.
"""

from __future__ import annotations

import math
import threading
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tsplat.core.constants import SH_C0, SH_C1, SH_C2, SH_C3
from tsplat.core.types import F16, F32

U16 = NDArray[np.uint16]

SH_PEAKS = (
    SH_C0,
    *(SH_C1,) * 3,
    *(SH_C2[0] / 2,) * 2,
    SH_C2[2] * 2,
    SH_C2[0] / 2,
    SH_C2[4],
    -SH_C3[0],
    SH_C3[1] * 27**-0.5,
    -SH_C3[2] * (256 / 135) ** 0.5,
    SH_C3[3] * 2,
    -SH_C3[4] * (256 / 135) ** 0.5,
    SH_C3[5] * (4 / 27) ** 0.5,
    -SH_C3[6],
)
"""Largest |Y_k| over all directions, in the order of the coefficients. With s and c the sine and
cosine of the angle to an axis: xy, yz, xz reach 1/2; 2zz - xx - yy = 3cc - 1 reaches 2; xx - yy
reaches 1; y(3xx - yy) = sss sin(3 phi) reaches 1; xyz reaches 1/sqrt(27) and z(xx - yy) =
ssc cos(2 phi) twice that; y(4zz - xx - yy) reaches s(4 - 5ss) at ss = 4/15, which is
sqrt(256/135); z(2zz - 3xx - 3yy) = c(5cc - 3) reaches 2."""

SH_ERROR_MAX = 0.25 / 255.0
"""Coefficients are kept in float16 only where no colour moves by this, a quarter of one of the 255
levels that a screen shows."""

BLOCK = 48 << 12
"""Numbers rounded at a time: 4096 rows of degree 3, a chunk of what is loaded."""

PRODUCT = 1024
"""Rows multiplied at a time: too few for OpenBLAS to set threads of its own on them."""

NORMAL = np.float32(2.0**-14)
"""The smallest number that float16 holds with all its bits; below, its steps are of one size."""

EXPONENTS = 112 << 23
"""What float32's exponents, as they are stored, are more than float16's."""

HALF = np.float32(0.5)
"""The last bit of numbers from here on is float16's least step: what is added is rounded to it."""

OVERFLOW = np.float32(65520)
"""Half a step beyond float16's largest number, and ..."""

INFINITY = 0x7C00
"""... the bits of what it becomes."""

RELATIVE = 2.0**-11
"""Rounding is off by at most this share of a number, or by half of ..."""

LEAST_STEP = 2.0**-24
"""... this, whichever is more."""

SLACK = 1 + 1e-5
"""Times what float32 sums to, so that it is not below the exact sum of 48 terms."""


class _Room(threading.local):
    """Scratch memory, each thread its own: fresh pages would cost as much as the arithmetic."""

    def __init__(self) -> None:
        self.sizes = np.empty(BLOCK, np.float32)
        self.bits = np.empty(BLOCK, np.uint32)
        self.signs = np.empty(BLOCK, np.uint32)


_room = _Room()


def to_half(values: F32, out: F16) -> float:
    """Rounds ``values`` [n, K, 3] to nearest; returns a bound of what that does to a colour.

    No colour moves by more, whatever the direction; in units of the picture's full range. Per
    Gaussian and channel that is ``sum_k max|Y_k| |out_k - values_k|``, or what is certainly more
    as long as it stays below ``SH_ERROR_MAX``. Numbers beyond float16's range, and what is not
    finite, make it far more than that. Ties go to even. Both arrays are C-contiguous.
    """
    weights = _weights(values.shape[1])
    rows = BLOCK // len(weights)
    blocks = [slice(i, i + rows) for i in range(0, len(values), rows)]
    with np.errstate(under="ignore"):  # which is how numbers are rounded here
        for block in blocks:
            _round(values[block].reshape(-1), out[block].view(np.uint16).reshape(-1))
    return max((_error(values[b], out[b], weights) for b in blocks), default=0.0)


def _round(values: F32, out: U16) -> None:
    """As NumPy's cast and the processor's instruction do, but for what is not a number."""
    n = values.size
    sizes, bits, signs = _room.sizes[:n], _room.bits[:n], _room.signs[:n]
    np.abs(values, out=sizes)
    pattern = sizes.view(np.uint32)
    np.right_shift(pattern, 13, out=bits)
    bits &= 1  # 13 bits are cut off; what is added before makes that rounding
    bits += 0x0FFF - EXPONENTS & 0xFFFFFFFF
    bits += pattern
    bits >>= 13
    if not sizes.max() < OVERFLOW:
        np.minimum(bits, INFINITY, out=bits)
    small = np.flatnonzero(sizes < NORMAL)
    bits[small] = (sizes[small] + HALF).view(np.uint32) - HALF.view(np.uint32)
    np.right_shift(values.view(np.uint32), 16, out=signs)
    signs &= 0x8000
    bits |= signs
    np.copyto(out, bits, casting="unsafe")


def _error(values: F32, halves: F16, weights: F32) -> float:
    """See :func:`to_half`."""
    sizes = _room.sizes[: values.size]
    np.abs(values.reshape(-1), out=sizes)
    rows = sizes.reshape(-1, len(weights))
    channels = np.empty((len(rows), 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):  # what overflows is doubtful
        for i in range(0, len(rows), PRODUCT):
            np.matmul(rows[i : i + PRODUCT], weights, out=channels[i : i + PRODUCT])
        channels *= RELATIVE * SLACK
        channels += LEAST_STEP * float(weights[:, 0].sum())
        most = float(channels.max())
        if most < SH_ERROR_MAX:
            return most
        doubtful = ~(channels < SH_ERROR_MAX).all(1)
        off = np.abs(halves[doubtful].astype(np.float64) - values[doubtful])
        exact = float((off.reshape(len(off), -1) @ weights.astype(np.float64)).max())
    most = float(channels[~doubtful].max(initial=0))
    return max(most, exact) if exact < math.inf else math.inf


@cache
def _weights(coefficients: int) -> F32:
    """[3 K, 3]: sizes of a Gaussian's coefficients times this are the most of its channels."""
    peaks = np.array(SH_PEAKS[:coefficients], np.float32)
    return np.kron(peaks[:, None], np.eye(3, dtype=np.float32))
