"""Sixel bytes, decoded again, are the palette picture, and that is near the frame."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pictures import frame_of, photo, psnr

from tsplat.presenters import sixel
from tsplat.presenters.base import Terminal
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
    """What encode does is quantize, then exact; also for odd sizes, long runs and many bands."""
    image = photo(width, height)
    shown = percent(SIXEL.encode(frame_of(image), ROOM, None))
    palette, rows = sixel.quantize(image, 256)
    np.testing.assert_array_equal(shown, palette[rows])


def test_quality_of_a_photo():
    """A photo-like frame comes out at 32.5 dB or more, in less bytes than libsixel's 184 kB."""
    image = photo()
    data = SIXEL.encode(frame_of(image), ROOM, None)
    assert psnr(decoders.sixel(data, ROOM).picture, image) > 32.5
    assert len(data) < 184_000


def test_dithering_pays_off_when_seen_from_afar():
    """Mean over 8x8 px: the dithered picture is nearer than the nearest palette colours are."""
    image = photo(noise=0)
    palette, rows = sixel.quantize(image, 64)
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
