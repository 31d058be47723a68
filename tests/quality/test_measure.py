"""Measures of error, on pictures whose error is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tsplat.core.types import Frame
from tsplat.quality.measure import SSIM_C1, measure, over_all, ssim


def flat(value, height=20, width=30):
    """A picture of one grey."""
    rgb = np.full((height, width, 3), value, np.float32)
    return Frame(rgb, np.zeros((height, width), np.float32))


def test_equal_pictures():
    """No error by any measure."""
    error = measure(flat(0.3), flat(0.3))
    assert (error.worst, error.p999, error.psnr) == (0, 0, math.inf)
    assert error.ssim == pytest.approx(1)


def test_one_level_everywhere():
    """Off by 1/255: one level, and 20 log10(255) dB."""
    error = measure(flat(0.5 + 1 / 255), flat(0.5))
    assert error.worst == pytest.approx(1, abs=1e-4)
    assert error.p999 == pytest.approx(1, abs=1e-4)
    assert error.psnr == pytest.approx(20 * math.log10(255), abs=1e-3)


def test_a_few_bad_pixels_are_the_worst_and_not_the_percentile():
    """Of 2,000 pixels one is black: 0.05 %."""
    want = flat(1.0, 40, 50)
    got = flat(1.0, 40, 50)
    got.rgb[3, 4, 1] = 0
    error = measure(got, want)
    assert error.worst == 255
    assert error.p999 == 0
    assert 0.9 < error.ssim < 1


def test_what_a_screen_cuts_off_does_not_count():
    """Colours beyond 1 are shown as 1."""
    assert measure(flat(1.7), flat(1.2)).worst == 0


def test_ssim_of_two_greys_is_its_luminance_term():
    """Without structure only the means are left: (2 a b + C1) / (a^2 + b^2 + C1)."""
    a, b = np.full((20, 20, 3), 0.25), np.full((20, 20, 3), 0.75)
    want = (2 * 0.25 * 0.75 + SSIM_C1) / (0.25**2 + 0.75**2 + SSIM_C1)
    assert ssim(a, b) == pytest.approx(want)


def test_ssim_falls_with_noise_and_turns_negative_for_a_negative():
    """More noise is less alike; an inverted texture is its opposite."""
    rng = np.random.default_rng(0)
    image = rng.uniform(0.2, 0.8, (40, 40, 3))
    noisy = [ssim(image, image + rng.normal(0, s, image.shape)) for s in (0.01, 0.05, 0.2)]
    assert noisy == sorted(noisy, reverse=True)
    assert ssim(image, 1 - image) < 0


def test_small_pictures_have_a_smaller_window():
    """One pixel is enough."""
    assert ssim(np.full((1, 1, 3), 0.5), np.full((1, 1, 3), 0.5)) == pytest.approx(1)


def test_over_all_takes_the_worst_and_the_mean_square():
    """Two pictures, one of them perfect: half the mean square error, 3 dB less."""
    bad, good = measure(flat(0.5 + 1 / 255), flat(0.5)), measure(flat(0.5), flat(0.5))
    both = over_all([bad, good])
    assert both.worst == bad.worst
    assert both.psnr == pytest.approx(bad.psnr + 10 * math.log10(2))
