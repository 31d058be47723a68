"""Sixel bytes, decoded again, are the palette picture, and that is near the frame."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pictures import frame_of, photo, psnr

from tsplat.presenters import sixel
from tsplat.presenters.base import Terminal
from tsplat.presenters.dither import distinct, steady
from tsplat.presenters.enlarge import edges
from tsplat.presenters.sixel import SIXEL
from tsplat.testing import decoders

ROOM = Terminal(columns=400, rows=100, sixel=True)


def percent(data, terminal=ROOM):
    """[H, W, 3] of one picture that breaks no rule."""
    assert data.startswith(b"\x1bP0;1;0q")
    assert data.endswith(b"\x1b\\")
    faults = []
    picture = decoders.sixel_percent(data[2:-2], terminal, faults)
    assert faults == []
    return picture


@given(
    rows=hnp.arrays(np.uint8, st.tuples(st.integers(1, 20), st.integers(1, 40)),
                    elements=st.integers(0, 4)),
    palette=hnp.arrays(np.uint8, (5, 3), elements=st.integers(0, 100)),
)  # fmt: skip
def test_any_palette_picture_decodes_to_itself(rows, palette):
    """Runs, gaps, bands and partial last bands: the decoder sees exactly the rows given."""
    np.testing.assert_array_equal(percent(sixel.sixel(palette, rows)), palette[rows])


@pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 7), (640, 360), (1100, 25), (5, 600)])
def test_a_frame_decodes_to_its_palette_picture(width, height):
    """Colours are chosen, then all is exact; also for odd sizes, long runs and many bands."""
    image = photo(width, height)
    palette, rows = sixel.dithered(image, 256)
    shown = percent(SIXEL.rest(frame_of(image), ROOM))
    np.testing.assert_array_equal(shown, palette[rows])
    picture = distinct(image)
    rows = steady(picture, sixel.levels(palette), sixel.NEAR[1])
    shown = percent(SIXEL.encode(frame_of(image), ROOM, None))
    np.testing.assert_array_equal(shown, palette[rows])


@pytest.mark.parametrize(
    ("encode", "remote", "least", "most"),
    [
        (lambda f, t: SIXEL.encode(f, t, None), False, 34.0, 78_000),
        (lambda f, t: SIXEL.encode(f, t, None), True, 29.0, 35_000),
        (SIXEL.rest, False, 33.0, 141_000),
        (SIXEL.rest, True, 33.0, 141_000),
    ],
)
def test_quality_and_size_of_a_photo(encode, remote, least, most):
    """dB at least and bytes at most; libsixel without diffusion: 32.1 dB, 119 kB."""
    image, terminal = photo(), replace(ROOM, remote=remote)
    data = encode(frame_of(image), terminal)
    assert psnr(decoders.sixel(data, terminal).picture, image) > least
    assert len(data) < most


def strips(data):
    """(row of cells, height in px) of each picture."""
    found = re.findall(rb'(?:\x1b\[(\d+)H)?\x1bP0;1;0q"1;1;\d+;(\d+)', data)
    return [(int(row or 1), int(height)) for row, height in found]


@pytest.mark.parametrize(
    ("changed", "height", "sent"),
    [
        ([200], 20, [(10, 60)]),  # rows 180 to 239
        ([0], 20, [(1, 60)]),
        ([179, 180], 20, [(7, 120)]),
        ([3, 350], 20, [(1, 360)]),
        ([359], 20, [(16, 60)]),
        ([200], 19, [(7, 114)]),  # 114 to 227; of 19 px a cell
        ([359], 19, [(19, 18)]),  # 342 to the end, in the middle of a cell
        ([200], 18.5, [(1, 360)]),
        ([], 20, []),
    ],
)
def test_only_the_rows_that_changed_are_sent(changed, height, sent):
    """From a cell's first row to one that ends a cell and a band.

    All if cells have fractions, and in tmux.
    """
    terminal = Terminal(30, -(-360 // int(height)) + 3, 10, height, sixel=True)
    image = photo(200, 360)
    after = image.copy()
    after[changed] ^= 255
    data = SIXEL.encode(frame_of(after), terminal, frame_of(image))
    assert strips(data) == sent
    before = SIXEL.encode(frame_of(image), terminal, None)
    past_tmux = replace(terminal, multiplexer="tmux")
    whole = SIXEL.encode(frame_of(after), past_tmux, frame_of(image))
    assert strips(whole) == ([(1, 360)] if changed else [])
    shown = decoders.sixel(before + b"\x1b[H" + data, terminal)
    assert shown.faults == ()
    if changed:
        assert psnr(shown.picture, after) > 30
    if sent and sent != [(1, 360)]:
        assert len(data) < len(before) * 0.7


def test_a_change_in_few_pixels_is_sent_where_they_are_shown():
    """Row 5 of 36, shown in rows 50 to 59 of 360: the first 60 rows."""
    terminal = Terminal(30, 19, 10, 20, sixel=True)
    image = photo(30, 36)
    after = image.copy()
    after[5] ^= 255
    data = SIXEL.fill(frame_of(after), terminal, frame_of(image))
    assert strips(data) == [(1, 60)]


@pytest.mark.parametrize("many", [6, 60, 360, 456])
def test_rows_begin_with_bands_and_keep_their_middles(many):
    """From 8 px on with a band, from 4 px on with half of one; less than that where they are."""
    for few in range(1, many + 1):
        rows, exact = sixel._row_edges(few, many), edges(few, many)
        assert (rows[0], rows[-1]) == (0, many)
        middles = (2 * np.arange(few) + 1) * many // (2 * few)
        assert (rows[:-1] <= middles).all()
        assert (middles < rows[1:]).all()
        if many >= 8 * few:
            assert not (rows[:-1] % 6).any()
        elif many >= 4 * few:
            assert not (rows[:-1] % 3).any()
        else:
            np.testing.assert_array_equal(rows, exact)


def test_runs_go_on_only_as_far_as_the_tolerance():
    """Of two greys 5 levels apart the left one goes on, 6 apart not: 100 squared levels."""
    for step, colors in ((5, 1), (6, 2)):
        image = np.full((6, 40, 3), 100, np.uint8)
        image[:, 20:] += np.uint8(step)
        palette = np.array([[100] * 3, [100 + step] * 3], np.uint8)
        rows = steady(distinct(image), palette, 100)
        assert len(np.unique(rows)) == colors


def test_several_colours_go_over_a_band_at_once():
    """One after the other from left to right they need no ``$``; what lies over others does."""
    palette = np.array([[n * 9] * 3 for n in range(10)], np.uint8)
    apart = np.repeat(np.arange(10, dtype=np.uint8), 5)[None].repeat(6, 0)
    assert b"$" not in sixel.sixel(palette, apart)
    apart[0, 0] = 9
    assert sixel.sixel(palette, apart).count(b"$") == 1


def test_dithering_pays_off_when_seen_from_afar():
    """Mean over 8x8 px: the dithered picture is nearer than the nearest palette colours are."""
    image = photo(noise=0)
    palette, rows = sixel.dithered(image, 64)
    colors = np.rint(palette * 2.55)
    distance = (np.square(image[:, :, None].astype(float) - colors)).sum(-1)
    nearest = colors[distance.argmin(-1)]

    def afar(picture):
        return picture.reshape(45, 8, 80, 8, 3).mean((1, 3))

    dithered = psnr(afar(colors[rows]), afar(image))
    assert dithered > psnr(afar(nearest), afar(image)) + 2


def test_flat_areas_keep_their_colour():
    """A picture of a few colours keeps them to half a percent: sixel has 101 steps a channel."""
    image = np.zeros((12, 12, 3), np.uint8)
    image[3:9, 3:9] = 255, 128, 7
    shown = decoders.sixel(SIXEL.encode(frame_of(image), ROOM, None), ROOM).picture
    assert np.abs(shown.astype(int) - image).max() <= 2


@pytest.mark.parametrize("registers", [2, 16, 256, 4096])
def test_registers_are_not_exceeded(registers):
    """No more registers are defined than the terminal has, nor more than 256."""
    terminal = Terminal(columns=400, rows=100, sixel=True, sixel_registers=registers)
    data = SIXEL.encode(frame_of(photo(60, 40)), terminal, None)
    numbers = re.findall(rb"#(\d+);2;", data)
    assert len(numbers) == len(set(numbers)) <= min(registers, 256)
    assert percent(data, terminal).min() >= 0


def test_no_carriage_return_after_the_registers():
    """Konsole forgets a register whose definition is followed by ``$``."""
    data = SIXEL.encode(frame_of(photo(60, 40)), ROOM, None)
    assert re.search(rb"#\d+;2;\d+;\d+;\d+#\d+[^;]", data)
    assert not re.search(rb"#\d+;2;\d+;\d+;\d+\$", data)


@pytest.mark.parametrize(("name", "free"), [("foot(1.28.0)", 1), ("Konsole 22.12.3", 2)])
def test_size_leaves_rows_free(name, free):
    """Whole bands, and the last row untouched: two rows in Konsole, whose cursor goes further."""
    terminal = Terminal(90, 30, 10.0, 19.0, sixel=True, name=name)
    width, height = SIXEL.size(terminal)
    assert width == 900
    assert height % 6 == 0
    assert (30 - free) * 19 - 6 < height <= (30 - free) * 19


def test_size_obeys_the_largest_picture():
    """As vt340, xterm cuts at 1000x1000 px; a larger frame is cut before it is sent."""
    terminal = Terminal(200, 60, 10.0, 20.0, sixel=True, sixel_max=(1000, 1000))
    assert SIXEL.size(terminal) == (1000, 996)
    small = Terminal(4, 3, 10.0, 20.0, sixel=True)
    shown = percent(SIXEL.encode(frame_of(photo(64, 64)), small, None))
    assert shown.shape == (36, 40, 3)


def test_an_unchanged_picture_costs_nothing():
    """Frames equal at 8 bits send nothing."""
    image = photo(20, 10)
    assert SIXEL.encode(frame_of(image), ROOM, frame_of(image)) == b""


@pytest.mark.parametrize(
    ("terminal", "reason"),
    [
        (Terminal(), "attributes"),
        (Terminal(sixel=True, tty=False), "not a terminal"),
    ],
)
def test_unsupported_says_why(terminal, reason):
    """Only a terminal that lists sixel is sent it."""
    assert reason in SIXEL.unsupported(terminal)
    assert SIXEL.unsupported(ROOM) is None
