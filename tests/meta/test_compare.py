"""The comparison's own rules: what may flip, how often, and which way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tsplat.core.types import Frame
from tsplat.testing.compare import compare_frames, flips_allowed, psnr

SHAPE = 40, 50


def flat(value=0.5):
    """A grey frame."""
    return Frame(np.full((*SHAPE, 3), value), np.full(SHAPE, 0.25))


def far():
    """Margins of pixels that are near no threshold."""
    return np.full(SHAPE, 1.0)


def test_within_the_tolerance_is_equal_enough():
    """9e-5 passes and is reported; 2e-4 does not."""
    assert compare_frames(flat(0.5 + 9e-5), flat(), far()).passed
    result = compare_frames(flat(0.5 + 2e-4), flat(), far())
    assert not result.passed
    assert "2000 pixels off" in result.faults[0]
    np.testing.assert_allclose(result.max_error, 2e-4, rtol=1e-6)


def bumped(count, signs):
    """A frame with ``count`` pixels off by 0.004, and margins that call them crossings."""
    rgb, margins = flat().rgb.copy(), far()
    for i, sign in zip(range(count), signs, strict=False):
        rgb[i // 50, i % 50] += 0.004 * sign
        margins[i // 50, i % 50] = 1e-6
    return replace(flat(), rgb=rgb), margins


def test_a_crossing_may_flip_and_is_counted_apart():
    """A flipped pixel is counted and does not enter the error."""
    got, margins = bumped(2, (1, -1))
    result = compare_frames(got, flat(), margins)
    assert result.passed
    assert result.flips == 2
    assert result.max_error == 0


def test_a_difference_that_is_no_crossing_fails():
    """The same differences away from a threshold break the contract."""
    got, _ = bumped(2, (1, -1))
    assert not compare_frames(got, flat(), far()).passed


def test_flips_must_be_few_and_unbiased():
    """Of 2000 pixels two may flip; and many flips to one side are no rounding."""
    got, margins = bumped(3, (1, -1, 1))
    assert "at most 2" in compare_frames(got, flat(), margins).faults[0]
    got, margins = bumped(60, [1] * 60)
    assert any("lean" in fault for fault in compare_frames(got, flat(), margins).faults)


def test_a_part_of_a_picture_may_have_the_whole_pictures_flips():
    """Three in a part of 2000 pixels are too many there, not in 3000; leaning is not judged."""
    got, margins = bumped(3, (1, -1, 1))
    assert not compare_frames(got, flat(), margins, of=2000).passed
    result = compare_frames(got, flat(), margins, of=2001)
    assert result.passed
    assert result.flips == 3
    assert flips_allowed(2001) == 3
    got, margins = bumped(60, [1] * 60)
    assert compare_frames(got, flat(), margins, of=60_000).passed
    got, _ = bumped(3, (1, -1, 1))
    assert not compare_frames(got, flat(), far(), of=60_000).passed


def test_two_pictures_of_a_backend_may_differ_twice_as_far_and_as_often():
    """1.8e-4 passes and 2.2e-4 does not; of 2000 pixels four may flip and not five."""
    assert compare_frames(flat(0.5 + 1.8e-4), flat(), far(), pictures=2).passed
    assert not compare_frames(flat(0.5 + 2.2e-4), flat(), far(), pictures=2).passed
    for count in (4, 5):
        got, margins = bumped(count, (1, -1, 1, -1, 1))
        assert compare_frames(got, flat(), margins, pictures=2).passed == (count == 4)


def test_wrong_shapes_and_nan_are_faults():
    """A frame of another size, or one that is not finite, is never compared as equal."""
    assert (
        "expected"
        in compare_frames(Frame(np.zeros((1, 1, 3)), np.zeros((1, 1))), flat(), far()).faults[0]
    )
    bad = flat()
    bad.rgb[3, 3] = math.nan
    assert "finite" in compare_frames(bad, flat(), far()).faults[0]


def test_psnr_of_a_known_error():
    """A constant error of 0.1 is 20 dB; none is infinite."""
    np.testing.assert_allclose(psnr(flat(0.6), flat(0.5)), 20.0)
    assert psnr(flat(), flat()) == math.inf
