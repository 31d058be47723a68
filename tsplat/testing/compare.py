"""Two pictures of the same thing: how far apart, and whether the contract allows it.

Compared: rgb, transmittance and depth of every pixel, against the contract's picture in float64.
Not compared: anything below 1e-4, which float32 may spend; and pixels that sit on one of the two
thresholds, which may fall either way. Those are counted, must be few and unbiased, and must
really be crossings: the reference notes for each pixel how near a test came to its threshold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tsplat.core.types import F64, Frame
from tsplat.quality.measure import decibels

TOLERANCE = 1e-4
"""What a float32 backend may differ by in a channel."""

CROSSING = 1e-4
"""Relative distance from a threshold within which a pixel may flip."""

FLIPS_MAX = 1e-3
"""Share of pixels that may flip; one pixel always may."""


@dataclass(frozen=True)
class Comparison:
    """The verdict on a frame."""

    max_error: float  # largest difference outside flipped pixels
    psnr: float  # dB, of rgb clipped to 0..1
    flips: int  # pixels that differ and sit on a threshold
    faults: tuple[str, ...]  # empty if the contract holds

    @property
    def passed(self) -> bool:
        """Whether the contract holds."""
        return not self.faults


def psnr(got: Frame, want: Frame) -> float:
    """Peak signal-to-noise ratio of rgb clipped to 0..1, in dB; inf for equal pictures."""
    a, b = (np.clip(f.rgb.astype(np.float64), 0, 1) for f in (got, want))
    mse = float(((a - b) ** 2).mean())
    return decibels(mse)


def _differences(got: Frame, want: Frame) -> F64:
    """Largest signed difference [H, W] among the channels; depth in units of the farthest."""
    layers = [got.rgb - want.rgb, (got.transmittance - want.transmittance)[..., None]]
    if want.depth is not None and got.depth is not None:
        scale = max(float(want.depth.max()), 1e-30)
        layers.append(((got.depth - want.depth) / scale)[..., None])
    stacked = np.concatenate(layers, axis=2)
    largest = abs(stacked).argmax(axis=2)[..., None]
    return np.take_along_axis(stacked, largest, axis=2)[..., 0].astype(np.float64)


def flips_allowed(pixels: int) -> int:
    """How many of a picture's ``pixels`` may flip."""
    return max(1, math.ceil(FLIPS_MAX * pixels))


def compare_frames(
    got: Frame,
    want: Frame,
    margins: F64,
    tolerance: float = TOLERANCE,
    crossing: float = CROSSING,
    of: int | None = None,
    pictures: int = 1,
) -> Comparison:
    """``got`` against ``want``, the reference's float64 picture with its ``margins`` [H, W].

    ``of``, if these are only a part of a picture, is the number of all its pixels: as many may
    flip as in the whole, and whether flips lean is left to who sees all of them.
    With ``pictures=2``, ``want`` is a backend's too, so both may err: twice as far and as often.
    ``crossing`` is the relative distance from a threshold within which a pixel may flip.
    """
    faults = []
    tolerance *= pictures
    for name in ("rgb", "transmittance", "depth"):
        mine, theirs = getattr(got, name), getattr(want, name)
        if theirs is None:
            continue
        if mine is None or mine.shape != theirs.shape:
            came = "nothing" if mine is None else list(mine.shape)
            return Comparison(
                math.inf, 0.0, 0, (f"Frame.{name}: expected {list(theirs.shape)}, got {came}",)
            )
        if not np.isfinite(mine).all():
            faults.append(f"Frame.{name} is not finite everywhere")
    if faults:
        return Comparison(math.inf, 0.0, 0, tuple(faults))
    signed = _differences(got, want)
    error = abs(signed)
    over = error > tolerance
    on_threshold = margins < crossing
    flipped, wrong = over & on_threshold, over & ~on_threshold
    flips = int(flipped.sum())
    rest = float(error[~flipped].max(initial=0))
    if wrong.any():
        y, x = np.unravel_index(np.argmax(np.where(wrong, error, 0)), error.shape)
        faults.append(
            f"{int(wrong.sum())} pixels off by more than {tolerance:g} that sit on no threshold; "
            f"the worst, ({x}, {y}), by {error[y, x]:.3g}"
        )
    allowed = pictures * flips_allowed(of or error.size)
    if flips > allowed:
        faults.append(f"{flips} pixels flipped on a threshold; at most {allowed} may")
    # Fair coins: the surplus of one side stays within 4 standard deviations.
    surplus = abs(int((signed[flipped] > 0).sum()) * 2 - flips)
    if of is None and surplus > 4 * math.sqrt(flips) + 1:
        faults.append(f"flips lean to one side: {surplus} more than the other of {flips}")
    return Comparison(rest, psnr(got, want), flips, tuple(faults))
