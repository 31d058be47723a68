"""Words of the command line -> values; ``argparse`` tells what it expected of those it refuses."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from contextlib import suppress


def pair(text: str) -> tuple[int, int]:
    """Width and height of a picture, ``1280x720``."""
    match = re.fullmatch(r"([0-9]{1,6})[xX]([0-9]{1,6})", text)
    if not match or not int(match[1]) or not int(match[2]):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT, such as 1280x720, got {text!r}")
    return int(match[1]), int(match[2])


def vector(text: str) -> tuple[float, float, float]:
    """Three finite numbers, ``0,-1,2.5``."""
    try:
        x, y, z = (float(part) for part in text.split(","))
        if not all(abs(value) < 1e30 for value in (x, y, z)):
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"expected three finite numbers, such as 0,-1,2.5, got {text!r}"
        ) from None
    return x, y, z


def up(text: str) -> tuple[float, float, float]:
    """A direction: an axis such as ``-y``, or three numbers."""
    axis = re.fullmatch(r"([-+]?)([xyz])", text.lower())
    if axis:
        sign = -1.0 if axis[1] == "-" else 1.0
        x, y, z = (sign * (name == axis[2]) + 0.0 for name in "xyz")
        return x, y, z
    if re.fullmatch(r"[a-zA-Z]+", text):
        raise argparse.ArgumentTypeError(
            f"expected x, -x, y, -y, z, -z or three numbers such as 0,-1,0, got {text!r}"
        )
    return vector(text)


def color(text: str) -> tuple[float, float, float] | None:
    """R, G, B, each 0 to 1; None for ``none``."""
    if text == "none":
        return None
    color = vector(text)
    if not all(0 <= channel <= 1 for channel in color):
        raise argparse.ArgumentTypeError(f"expected 'none' or R,G,B from 0 to 1, got {text!r}")
    return color


def count(text: str) -> int:
    """A whole number from 1 on."""
    return _upto(text, 10**12 - 1)


def _upto(text: str, most: int) -> int:
    if not re.fullmatch(r"[0-9]{1,12}", text) or not 1 <= int(text) <= most:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1 to {most}, got {text!r}")
    return int(text)


def cells(text: str) -> int:
    """A number of columns or rows of a terminal."""
    return _upto(text, 999)


def number(text: str, fits: Callable[[float], bool], expected: str) -> float:
    """A number that ``fits``; else ``expected`` is what was."""
    with suppress(ValueError):
        value = float(text)
        if fits(value):
            return value
    raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")


def positive(text: str) -> float:
    """A finite number above 0."""
    return number(text, lambda value: 0 < value < float("inf"), "a finite number above 0")


def share(text: str) -> float:
    """0 to 1."""
    return number(text, lambda value: 0 <= value <= 1, "0 to 1")


def percentile(text: str) -> float:
    """0 to 49, from each end."""
    return number(text, lambda value: 0 <= value <= 49, "a percentile from 0 to 49")


def factor(text: str) -> float:
    """0 to 10."""
    return number(text, lambda value: 0 <= value <= 10, "a number from 0 to 10")


def box(text: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Two corners, the lower one first."""
    corners = text.split(",")
    try:
        if len(corners) != 6:
            raise ValueError
        low, high = vector(",".join(corners[:3])), vector(",".join(corners[3:]))
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(
            f"expected six finite numbers, two corners such as -1,-1,-1,1,1,1, got {text!r}"
        ) from None
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise argparse.ArgumentTypeError(f"expected the lower corner first, got {text!r}")
    return low, high


def bits(text: str) -> float:
    """Bits/s from a number with k, M or G behind it."""
    match = re.fullmatch(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)([kMG]?)", text)
    rate = float(match[1]) * {"": 1, "k": 1e3, "M": 1e6, "G": 1e9}[match[2]] if match else 0
    if rate < 1000:
        raise argparse.ArgumentTypeError(
            f"expected bits/s from 1k on, such as 500k or 2M, got {text!r}"
        )
    return rate


def sh_bits(text: str) -> tuple[int, int]:
    """Bits of the first band of harmonics, and of the others."""
    match = re.fullmatch(r"([1-8])(?:,([1-8]))?", text)
    if not match:
        raise argparse.ArgumentTypeError(f"expected 1 to 8, or two of these as 5,4, got {text!r}")
    return int(match[1]), int(match[2] or match[1])


def fraction(text: str) -> int:
    """Fractional bits of SPZ's positions."""
    return int(number(text, lambda v: v in range(24), "a whole number from 0 to 23"))


def threads(text: str) -> int:
    """How many threads."""
    return _upto(text, 256)
