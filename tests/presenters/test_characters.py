"""What holds for all presenters made of characters."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pictures import frame_of, photo, psnr

from tsplat.plugins import plugins
from tsplat.presenters import blocks
from tsplat.presenters.base import Terminal
from tsplat.presenters.cells import ANSI, palette
from tsplat.presenters.dither import Mixer, nearest
from tsplat.testing import decoders
from tsplat.testing.stream import tokens

TRUECOLOR = 1 << 24
CHARACTERS = ("halfblock", "blocks", "braille", "letters")
ROWS = [plugins().presenters[name] for name in CHARACTERS]
DECODERS = {name: getattr(decoders, name) for name in CHARACTERS}


def photo_on(row, terminal, seed=1):
    """A photo-like picture of the size that ``row`` wants."""
    return photo(*row.size(terminal), seed)


@pytest.mark.parametrize("colors", [TRUECOLOR, 256, 16, 2])
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_what_did_not_change_stands_still(row, colors):
    """A px that changes changes its cell at most: no dither moves, no palette is chosen anew."""
    terminal = Terminal(columns=20, rows=8, colors=colors)
    image = photo_on(row, terminal)
    before = row.encode(frame_of(image), terminal, None)
    other = image.copy()
    other[0, 0] = 255 - image[0, 0]
    after = row.encode(frame_of(other), terminal, None)
    shown = [DECODERS[row.name](data, terminal).astype(int) for data in (before, after)]
    rows, columns = np.nonzero((shown[0] != shown[1]).any(2))
    height, width = shown[0].shape[0] // 7, shown[0].shape[1] // 20
    assert (rows < height).all()
    assert (columns < width).all()
    assert len(row.encode(frame_of(other), terminal, frame_of(image))) < 60
    assert row.encode(frame_of(image), terminal, frame_of(image)) == b""


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_no_color(row):
    """NO_COLOR: no SGR; brightness rises from black, which is blank, to white."""
    terminal = Terminal(columns=16, rows=9, colors=2)
    width, height = row.size(terminal)
    ink = []
    for grey in (0, 64, 128, 192, 255):
        data = row.encode(frame_of(np.full((height, width, 3), grey)), terminal, None)
        assert not any(t.kind == "csi" and t.body.endswith(b"m") for t in tokens(data))
        ink.append(DECODERS[row.name](data, terminal).mean())
    assert ink[0] == 0
    assert ink == sorted(ink)
    assert len(set(ink)) == len(ink)


def test_rows_are_reached_in_two_bytes():
    """The next row is CR LF away, a cell in it CR LF and CUF; one further down takes CUP."""
    row = plugins().presenters["halfblock"]
    terminal = Terminal(columns=5, rows=5)
    image = np.zeros((8, 5, 3), np.uint8)
    other = image.copy()
    other[[0, 2, 4, 6], [0, 0, 1, 4]] = 9
    data = row.encode(frame_of(other), terminal, frame_of(image))
    moves = [t.body for t in tokens(data) if t.kind != "text" and not t.body.endswith(b"m")]
    assert moves == [b"\r", b"\n", b"\r", b"\n", b"C", b"\r", b"\n", b"4C"]
    other[:6] = 0
    assert row.encode(frame_of(other), terminal, frame_of(image)).startswith(b"\x1b[4;5H")


@pytest.mark.parametrize("colors", [256, 16])
def test_blocks_in_the_same_two_colours_need_one_sgr(colors):
    """Halves of two colours in any order, and cells of one of them: set once for the whole row."""
    row = plugins().presenters["halfblock"]
    terminal = Terminal(columns=6, rows=2, colors=colors)
    image = np.zeros((2, 6, 3), np.uint8)
    image[:, :, 0] = [[255, 0, 255, 255, 0, 255], [0, 255, 0, 255, 0, 0]]
    data = row.encode(frame_of(image), terminal, None).decode()
    assert data.count("m") == 2  # and the reset
    assert "▀▄▀█ ▀" in data


# --- blocks


@pytest.mark.parametrize(
    ("glyphs", "least"), [("quadrants", 27.0), ("sextants", 27.0), ("octants", 27.0)]
)
def test_blocks_show_more_than_half_blocks(glyphs, least):
    """Against a picture of 8 times as many px, each set is nearer than half blocks."""
    fine = photo(160, 192, noise=0).astype(float)

    def shown(name, terminal):
        row = plugins().presenters[name]
        width, height = row.size(terminal)
        steps = 192 // height, 160 // width
        image = fine.reshape(height, steps[0], width, steps[1], 3).mean((1, 3))
        data = row.encode(frame_of(np.rint(image)), terminal, None)
        return DECODERS[name](data, terminal).repeat(steps[0], 0).repeat(steps[1], 1)

    terminal = Terminal(columns=20, rows=9, glyphs=glyphs)
    better = psnr(shown("blocks", terminal), fine)
    assert better > psnr(shown("halfblock", terminal), fine) + 0.5


@pytest.mark.parametrize("glyphs", ["quadrants", "sextants", "octants"])
@pytest.mark.parametrize("colors", [256, 16])
def test_blocks_of_few_colours_are_dithered(glyphs, colors):
    """Seen from afar the picture is nearer than the palette's nearest colours are."""
    terminal = Terminal(columns=48, rows=25, colors=colors, glyphs=glyphs)
    row = plugins().presenters["blocks"]
    width, height = row.size(terminal)
    image = photo(width, height, noise=0)
    shown = decoders.blocks(row.encode(frame_of(image), terminal, None), terminal)
    colours = palette(colors)
    alone = colours[nearest(image.reshape(-1, 3).astype(np.float32), colours)].reshape(image.shape)

    def afar(picture):
        return picture.reshape(6, height // 6, 12, width // 12, 3).mean((1, 3))

    assert psnr(afar(shown), afar(image)) > psnr(afar(alone), afar(image)) + 1.5


@given(colors=st.sampled_from([TRUECOLOR, 256, 16]), glyphs=st.sampled_from(["octants", "halves"]))
def test_blocks_of_halves_are_half_blocks(colors, glyphs):
    """TSPLAT_GLYPHS=halves gives the very bytes of half blocks; octants do not."""
    terminal = Terminal(columns=9, rows=4, colors=colors, glyphs=glyphs)
    image = photo(*blocks.size(terminal))
    data = blocks.encode(frame_of(image), terminal, None)
    same = data == plugins().presenters["halfblock"].encode(frame_of(image), terminal, None)
    assert same == (glyphs == "halves")


@pytest.mark.parametrize(
    ("terminal", "reason"),
    [
        (Terminal(), "not known to draw"),
        (Terminal(draws_blocks=True, tty=False), "not a terminal"),
    ],
)
def test_blocks_say_why_not(terminal, reason):
    """Only where the characters are known to be drawn well are they chosen unasked."""
    assert reason in blocks.unsupported(terminal)
    assert blocks.unsupported(Terminal(draws_blocks=True)) is None


# --- one colour a cell


@pytest.mark.parametrize(("name", "scale"), [("braille", 1.0), ("letters", 0.61)])
def test_the_mean_of_a_cell_is_kept(name, scale):
    """Fewer dots are brighter, so that a flat picture has its colour; letters have 0.61 of it."""
    row = plugins().presenters[name]
    terminal = Terminal(columns=16, rows=9)
    width, height = row.size(terminal)
    for colour in ((90, 60, 30), (10, 80, 160), (200, 200, 200)):
        data = row.encode(frame_of(np.full((height, width, 3), colour)), terminal, None)
        mean = DECODERS[name](data, terminal).mean((0, 1))
        np.testing.assert_allclose(mean, np.array(colour) * scale, rtol=0.08)


def test_letters_follow_shapes():
    """Light at the left, right, top and bottom of cells gives letters with their ink there."""
    row = plugins().presenters["letters"]
    terminal = Terminal(columns=1, rows=2, colors=2)
    shown = {}
    for name, part in {
        "left": np.s_[:, :1], "right": np.s_[:, 1:], "low": np.s_[3:], "high": np.s_[:2],
    }.items():  # fmt: skip
        image = np.zeros((4, 2, 3), np.uint8)
        image[part] = 255
        data = row.encode(frame_of(image), terminal, None)
        ink = decoders.letter_coverage()[data.decode()]
        shown[name] = ink.sum() and (ink[part].mean() - ink.mean())
    assert all(more > 0 for more in shown.values()), shown


# --- fixed palettes


@pytest.mark.parametrize("colours", [palette(256), ANSI, palette(2)])
def test_a_colour_of_the_palette_is_shown_as_it_is(colours):
    """Whatever the place: each colour is mixed from itself alone."""
    mixer = Mixer(colours)
    for threshold in (0, 31, 63):
        rows = mixer.mix(colours.T.astype(np.uint8), np.full(len(colours), threshold))
        np.testing.assert_array_equal(colours[rows], colours)


def test_what_a_mixer_learnt_does_not_matter():
    """Its tables grow with the colours it meets; what it mixes does not depend on them."""
    rng = np.random.default_rng(3)
    colours = rng.integers(0, 256, (3, 500), dtype=np.uint8)
    thresholds = rng.integers(0, 64, 500)
    used = Mixer(palette(256))
    used.mix(rng.integers(0, 256, (3, 5000), dtype=np.uint8), np.zeros(5000))
    fresh = Mixer(palette(256))
    np.testing.assert_array_equal(used.mix(colours, thresholds), fresh.mix(colours, thresholds))
