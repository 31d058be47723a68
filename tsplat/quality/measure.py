"""How wrong a picture is: against the ideal one, in the units in which eyes and papers count."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tsplat.core.types import F64, Frame

LEVELS = 255
"""8-bit levels between black and white."""

SHARE = 0.999
"""Of pixels, for the percentile."""

WINDOW, SIGMA = 11, 1.5
"""px: SSIM's Gaussian window."""

SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2
"""SSIM's constants for a range of 1."""


@dataclass(frozen=True)
class Error:
    """Distances of a picture over black, clipped to 0..1, from the ideal one."""

    worst: float  # 8-bit levels, of the channel that is farthest off
    p999: float  # 8-bit levels: all but one pixel in a thousand are nearer
    psnr: float  # dB; inf for equal pictures
    ssim: float  # -1..1; 1 for equal pictures


def decibels(mse: float) -> float:
    """Peak signal-to-noise ratio of a mean square error, for a range of 1; inf for none."""
    return math.inf if mse == 0 else -10 * math.log10(mse)


def levels_text(value: float) -> str:
    """A number of levels, two digits of it, without an exponent from 0.0001 on."""
    return f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"


def measure(got: Frame, ideal: Frame) -> Error:
    """``got`` against ``ideal``, both without background."""
    a, b = (np.clip(frame.rgb.astype(np.float64), 0, 1) for frame in (got, ideal))
    off = abs(a - b)
    worst = off.max(axis=2) * LEVELS
    mse = float((off * off).mean())
    return Error(
        worst=float(worst.max()),
        p999=float(np.quantile(worst, SHARE, method="higher")),
        psnr=decibels(mse),
        ssim=ssim(a, b),
    )


def over_all(errors: Sequence[Error]) -> Error:
    """The worst of several pictures' largest errors, and the means of the others' measures."""
    mse = float(np.mean([10 ** (-e.psnr / 10) for e in errors]))
    return Error(
        worst=max(e.worst for e in errors),
        p999=max(e.p999 for e in errors),
        psnr=decibels(mse),
        ssim=float(np.mean([e.ssim for e in errors])),
    )


def ssim(a: F64, b: F64) -> float:
    """Mean structural similarity of two pictures [H, W, C] in 0..1.

    Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli, "Image Quality Assessment: From Error
    Visibility to Structural Similarity", 2004, eq. 13, with its Gaussian window of 11 px (less in
    a smaller picture), where the window lies within the picture; the mean of the channels.
    """
    mean_a, mean_b = _blurred(a), _blurred(b)
    var_a, var_b = _blurred(a * a) - mean_a**2, _blurred(b * b) - mean_b**2
    both = _blurred(a * b) - mean_a * mean_b
    alike = (2 * mean_a * mean_b + SSIM_C1) * (2 * both + SSIM_C2)
    size = (mean_a**2 + mean_b**2 + SSIM_C1) * (var_a + var_b + SSIM_C2)
    return float((alike / size).mean())


def _blurred(image: F64) -> F64:
    """[H, W, C] -> [H', W', C]: weighted means of the windows that lie within ``image``."""
    for axis in (0, 1):
        length = min(WINDOW, image.shape[axis])
        x = np.arange(length) - (length - 1) / 2
        weights = np.exp(-(x**2) / (2 * SIGMA**2))
        weights /= weights.sum()
        count = image.shape[axis] - length + 1
        parts = (w * image.take(range(i, i + count), axis) for i, w in enumerate(weights.tolist()))
        image = np.asarray(sum(parts), np.float64)
    return image
