"""What is in C against the NumPy that takes over where it was not built: the same bytes."""

import os
import random

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pictures import frame_of, photo

from tests.backends.test_guard_pages import FAULTS, child
from tsplat.core.errors import KernelError
from tsplat.core.types import Frame
from tsplat.presenters import native, sixel
from tsplat.presenters.base import Terminal, pixels
from tsplat.presenters.dither import BINS, THRESHOLDS, adaptive_palette, distinct, dither, steady
from tsplat.presenters.enlarge import edges
from tsplat.testing.presenting import KINDS, make_pixels

SIDES = st.integers(1, 40)


def without_c(function, *arguments):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "lib", None)
        return function(*arguments)


def assert_same(function, *arguments):
    """The same by both; returns it."""
    got, expected = function(*arguments), without_c(function, *arguments)
    if isinstance(got, bytes):
        assert got == expected
    else:
        np.testing.assert_array_equal(got, expected)
        assert got.dtype == expected.dtype
    return got


def test_it_is_there():
    """The compiler of this machine has made the encoder."""
    assert native.lib is not None
    assert native.lib.TSPLAT_BINS == BINS
    assert THRESHOLDS.shape == (native.lib.TSPLAT_SIDE,) * 2


@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(KINDS),
    width=SIDES,
    height=SIDES,
    count=st.sampled_from([1, 2, 3, 16, 100, 256]),
    tolerance=st.sampled_from([0, 1, 100, 10_000]),
)
def test_palettes_and_dithering(seed, kind, width, height, count, tolerance):
    """Colours, palette, and the row of each pixel, dithered and not, of any picture."""
    image = make_pixels(seed, kind, width, height, 1 << 24)
    picture, plain = distinct(image), without_c(distinct, image)
    for name in ("bins", "colors", "counts"):
        np.testing.assert_array_equal(getattr(picture, name), getattr(plain, name))
    assert picture.counts.sum() == width * height
    palette = np.rint(assert_same(adaptive_palette, picture, count)).astype(np.uint8)
    assert 1 <= len(palette) <= count
    assert_same(dither, picture, palette)
    assert_same(steady, picture, palette, tolerance)


@given(
    rows=hnp.arrays(np.uint8, st.tuples(SIDES, SIDES), elements=st.integers(0, 255)),
    wider=st.integers(0, 50),
    taller=st.integers(0, 50),
)
@example(rows=np.repeat(np.arange(256, dtype=np.uint8), 39)[None], wider=0, taller=0)
@example(rows=np.zeros((1, 1), np.uint8), wider=9998, taller=0)
def test_sixels(rows, wider, taller):
    """Any rows, repeated down and across, any number of times."""
    height, width = rows.shape
    columns = edges(width, width + max(wider, 0))
    source = np.repeat(np.arange(height, dtype=np.int32), np.diff(edges(height, height + taller)))
    palette = np.random.default_rng(0).integers(0, 101, (256, 3)).astype(np.uint8)
    assert_same(sixel.sixel, palette, rows, columns, source)


@given(
    hnp.arrays(
        np.float32, st.tuples(SIDES, SIDES, st.just(3)),
        elements=st.floats(width=32, allow_nan=False),
    )
)  # fmt: skip
@example(np.array([-0.0, np.inf, -np.inf], np.float32).reshape(1, 1, 3))
@example((np.arange(3 * 511, dtype=np.float32) / 510 / 3).reshape(-1, 1, 3))
def test_levels(values):
    """Any numbers, also those half way between two levels."""
    frame = Frame(values, np.zeros(values.shape[:2], np.float32))
    np.testing.assert_array_equal(pixels(frame), frame.to_uint8())
    turned = Frame(values[::-1, ::-1], frame.transmittance)
    np.testing.assert_array_equal(pixels(turned), turned.to_uint8())


@pytest.mark.parametrize("remote", [False, True])
def test_pictures(remote):
    """A photo-like frame, moving, of fewer pixels, in strips, and at rest."""
    terminal = Terminal(40, 21, 10, 20, sixel=True, remote=remote)
    image = photo(400, 396)
    other = image.copy()
    other[200:210] += 9
    frame, small = frame_of(image), frame_of(photo(100, 99))
    for before in (None, frame_of(other)):
        assert assert_same(sixel.encode, frame, terminal, before)
    assert_same(sixel.fill, small, terminal, frame)
    assert_same(sixel.rest, frame, terminal)


def test_what_is_out_of_range_is_refused():
    """An error, not a write or a read beyond the arrays."""
    rows, color = np.zeros((2, 2), np.uint8), np.zeros((1, 3), np.uint8)
    source, columns = np.arange(2, dtype=np.int32), np.arange(3, dtype=np.int32)
    refused = [
        (native.lines, rows, source + 1, columns),
        (native.lines, rows, source - 1, columns),
        (native.lines, rows, source[:0], columns),
        (native.lines, rows, source, columns[::-1].copy()),
        (native.lines, rows, source, columns + 1),
        (native.lines, rows, source, columns * 5000),
        (native.nearest, color, np.zeros((0, 3), np.uint8)),
        (native.nearest, color, np.zeros((257, 3), np.uint8)),
        (native.partners, color, color, np.ones(1, np.uint8), 0.3),
        (native.partners, color, color, np.zeros(1, np.uint8), -1.0),
        (native.adaptive_palette, color, np.ones(1, np.int64), 0),
        (native.adaptive_palette, color, np.ones(1, np.int64), 257),
        (native.adaptive_palette, color[:0], np.ones(0, np.int64), 9),
    ]
    for function, *arguments in refused:
        with pytest.raises(KernelError, match="out of range"):
            function(*arguments)


@pytest.mark.skipif(os.name != "posix", reason="guard pages need mmap and mprotect")
@pytest.mark.parametrize("side", ["begin", "end"])
def test_it_stays_within_its_arrays(side):
    """With a guard page at this side of every array, the bytes are the same as without."""
    args = "encode", side, random.randrange(2**32)
    run = child(*args, tests="presenters")
    assert run.returncode == 0, f"{args}: exit code {run.returncode}\n{run.stderr[-4000:]}"


@pytest.mark.skipif(os.name != "posix", reason="guard pages need mmap and mprotect")
def test_a_pixel_too_many_dies():
    """The guard is real: told of one row more than there is, the encoder ends the process."""
    assert child("overrun", tests="presenters").returncode in FAULTS
