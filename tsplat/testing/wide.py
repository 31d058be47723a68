"""Numbers of twice float64's precision: each the unevaluated sum of two float64s.

Dekker 1971, "A floating-point technique for extending the available precision"; Knuth, TAOCP 2,
4.2.2, theorem B. NumPy's ``longdouble`` will not do: on some machines it is float64, on none has
it the 36 digits that ``a c - b^2`` of a needle's covariance cancels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

SPLIT = 2.0**27 + 1  # cuts a float64 into halves whose products are exact


def _two_sum(a: Any, b: Any) -> tuple[Any, Any]:
    """The sum, and what rounding took from it."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _halves(a: Any) -> tuple[Any, Any]:
    high = SPLIT * a
    high = high - (high - a)
    return high, a - high


def _two_product(a: Any, b: Any) -> tuple[Any, Any]:
    """The product, and what rounding took from it."""
    product = a * b
    (a1, a2), (b1, b2) = _halves(a), _halves(b)
    return product, ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2


@dataclass(frozen=True, eq=False)
class Wide:
    """Arrays of numbers ``high + low``, good to 2^-102 of themselves; they broadcast.

    Beyond 1e300, and below 1e-270 where what rounding takes is lost, they are not.
    """

    high: NDArray[np.float64]
    low: NDArray[np.float64]

    __array_ufunc__ = None  # so that array + Wide is a Wide, not an array of objects

    @staticmethod
    def of(value: Wide | ArrayLike) -> Wide:
        """``value`` as it is; anything narrower than float64 is exact."""
        if isinstance(value, Wide):
            return value
        high = np.asarray(value, np.float64)
        return Wide(high, np.zeros_like(high))

    def __add__(self, other: Wide | ArrayLike) -> Wide:
        b = Wide.of(other)
        high, low = _two_sum(self.high, b.high)
        tail, rest = _two_sum(self.low, b.low)
        high, low = _two_sum(high, low + tail)
        return Wide(*_two_sum(high, low + rest))

    def __neg__(self) -> Wide:
        return Wide(-self.high, -self.low)

    def __sub__(self, other: Wide | ArrayLike) -> Wide:
        return self + -Wide.of(other)

    def __mul__(self, other: Wide | ArrayLike) -> Wide:
        b = Wide.of(other)
        high, low = _two_product(self.high, b.high)
        return Wide(*_two_sum(high, low + (self.high * b.low + self.low * b.high)))

    def __truediv__(self, other: Wide | ArrayLike) -> Wide:
        b = Wide.of(other)
        quotient = Wide.of(self.high / b.high)
        for _ in range(2):
            quotient = quotient + (self - b * quotient).high / b.high
        return quotient

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self, other: ArrayLike) -> Wide:
        return Wide.of(other) - self

    def __rtruediv__(self, other: ArrayLike) -> Wide:
        return Wide.of(other) / self

    def __getitem__(self, rows: Any) -> Wide:
        return Wide(self.high[rows], self.low[rows])

    def float64(self) -> NDArray[np.float64]:
        """Rounded."""
        return np.asarray(self.high + self.low)
