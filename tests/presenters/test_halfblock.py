"""Half blocks: an emulated screen shows the frame, also when only changes are sent."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pictures import frame_of, photo

from tsplat.presenters.base import Terminal
from tsplat.presenters.cells import ANSI, FIRST_FIXED, palette
from tsplat.presenters.halfblock import HALFBLOCK
from tsplat.testing import decoders
from tsplat.testing.stream import area_faults

TRUECOLOR = 1 << 24
TONES = st.sampled_from([0, 40, 255])  # few, so that neighbours and frames often agree


def show(terminal, *payloads):
    """A screen, all but its last row, after these payloads."""
    screen = decoders.Cells(terminal.columns, terminal.rows - 1)
    for payload in payloads:
        assert area_faults(payload, terminal) == ()
        screen.feed(payload)
    return screen.pixels


@st.composite
def pairs(draw):
    """Two frames of a size, and a terminal they just fit on."""
    height, width = draw(st.integers(1, 9)), draw(st.integers(1, 12))
    images = [draw(hnp.arrays(np.uint8, (height, width, 3), elements=TONES)) for _ in range(2)]
    for x in range(draw(st.integers(0, width))):
        images[1][:, x] = images[0][:, x]
    colors = draw(st.sampled_from([TRUECOLOR, 256, 16, 2]))
    terminal = Terminal(columns=width, rows=(height + 1) // 2 + 1, colors=colors)
    return *(frame_of(image) for image in images), terminal


@pytest.mark.parametrize(("width", "height"), [(1, 1), (5, 7), (100, 56), (999, 2)])
def test_truecolour_is_exact(width, height):
    """In 24-bit colour each half cell is the pixel; a missing last row is black."""
    image = photo(width, height)
    terminal = Terminal(columns=width, rows=(height + 1) // 2 + 1)
    shown = show(terminal, HALFBLOCK.encode(frame_of(image), terminal, None))
    expected = np.zeros((height + height % 2, width, 3), int)
    expected[:height] = image
    np.testing.assert_array_equal(shown, expected)


@given(pairs())
def test_increments_show_the_same_as_all_anew(pair):
    """On a screen showing a, the bytes from a to b give the screen that b's own bytes give."""
    a, b, terminal = pair
    whole = HALFBLOCK.encode(b, terminal, None)
    step = HALFBLOCK.encode(b, terminal, a)
    first = HALFBLOCK.encode(a, terminal, None)
    assert show(terminal, first, step).tolist() == show(terminal, whole).tolist()


def test_only_changed_cells_are_sent():
    """One pixel changed: one cell is sent, after one jump; none changed: nothing is."""
    image = photo(40, 20)
    terminal = Terminal(columns=40, rows=11)
    other = image.copy()
    other[13, 7] ^= 255
    data = HALFBLOCK.encode(frame_of(other), terminal, frame_of(image))
    assert data.startswith(b"\x1b[7;8H\x1b[")
    text = data.decode()
    assert text.count("▀") + text.count("▄") == 1
    assert HALFBLOCK.encode(frame_of(image), terminal, frame_of(image)) == b""


def test_colours_are_set_only_when_they_change():
    """A flat picture is spaces with the background set once."""
    terminal = Terminal(columns=6, rows=2)
    data = HALFBLOCK.encode(frame_of(np.full((2, 6, 3), 9)), terminal, None)
    assert data == b"\x1b[48;2;9;9;9m      \x1b[m"


@pytest.mark.parametrize(("colors", "first"), [(256, FIRST_FIXED), (16, 0)])
def test_fewer_colours_are_dithered(colors, first):
    """Seen from afar, mixed palette colours are nearer the picture than the nearest alone.

    Of 256 colours the first sixteen belong to themes.
    """
    image = photo(120, 80, noise=0)
    terminal = Terminal(columns=120, rows=41, colors=colors)
    data = HALFBLOCK.encode(frame_of(image), terminal, None)
    shown = show(terminal, data).astype(float)
    table = palette(colors)
    numbers = [int(n) for n in re.findall(rb"[34]8;5;(\d+)", data)]
    assert bool(numbers) == (colors == 256)
    assert min(numbers, default=first) >= first
    distance = np.square(image[:, :, None].astype(float) - table).sum(-1)

    def afar(picture):
        return picture.reshape(10, 8, 15, 8, 3).mean((1, 3))

    mixed = np.square(afar(shown) - afar(image.astype(float))).mean()
    alone = np.square(afar(table[distance.argmin(-1)]) - afar(image.astype(float))).mean()
    assert mixed < alone / 2


def test_without_colour_the_blocks_themselves_are_dithered():
    """NO_COLOR: no SGR at all; grey is every other pixel set."""
    terminal = Terminal(columns=16, rows=9, colors=2)
    data = HALFBLOCK.encode(frame_of(np.full((16, 16, 3), 127)), terminal, None)
    text = data.decode()
    assert "m" not in text
    ink = sum({"▀": 1, "▄": 1, "█": 2}.get(c, 0) for c in text)
    assert ink == pytest.approx(128, abs=8)


def test_palettes():
    """The 240 fixed colours are xterm's: cube levels 0, 95 to 255 and greys 8 to 238."""
    assert palette(256).shape == (240, 3)
    assert palette(256)[[0, 1, 6, 215, 216, 239]].tolist() == [
        [0, 0, 0], [0, 0, 95], [0, 95, 0], [255, 255, 255], [8, 8, 8], [238, 238, 238],
    ]  # fmt: skip
    assert palette(16) is ANSI


def test_size_and_what_does_not_fit():
    """Two px a cell in all rows but the last; a larger frame is cut off, not wrapped."""
    terminal = Terminal(columns=10, rows=4)
    assert HALFBLOCK.size(terminal) == (10, 6)
    image = photo(14, 9)
    cut = HALFBLOCK.encode(frame_of(image[:6, :10]), terminal, None)
    assert HALFBLOCK.encode(frame_of(image), terminal, None) == cut


def test_any_terminal_will_do():
    """Only the lack of a terminal is a reason against it."""
    assert HALFBLOCK.unsupported(Terminal(colors=16)) is None
    assert "not a terminal" in HALFBLOCK.unsupported(replace(Terminal(), tty=False))
