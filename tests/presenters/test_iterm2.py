"""iTerm2's bytes hold a JPEG of the frame at its own size, or, if it stays, a PNG."""

import io
import math
from dataclasses import replace

import pytest
from pictures import frame_of, photo, psnr
from PIL import Image

from tsplat.presenters.base import Terminal
from tsplat.presenters.iterm2 import ITERM2
from tsplat.testing import decoders

ROOM = Terminal(columns=400, rows=100, iterm2=True)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (7, 5), (640, 360)])
def test_jpeg_of_the_same_size(width, height):
    """A JPEG of the frame's size, shown pixel for pixel; its length is declared (VS Code)."""
    image = photo(width, height)
    data = ITERM2.encode(frame_of(image), ROOM, None)
    [(keys, file)] = decoders.iterm2_files(data)
    assert Image.open(io.BytesIO(file)).format == "JPEG"
    assert (keys["width"], keys["height"]) == (f"{width}px", f"{height}px")
    assert (keys["inline"], keys["doNotMoveCursor"]) == ("1", "1")
    shown = decoders.iterm2(data, ROOM)
    assert shown.faults == ()
    assert shown.picture.shape == image.shape


def test_quality():
    """A photo-like frame comes out at 35 dB or more, in a tenth of its raw size."""
    image = photo()
    data = ITERM2.encode(frame_of(image), ROOM, None)
    assert psnr(decoders.iterm2(data, ROOM).picture, image) > 35
    assert len(data) < image.size / 10


def test_quality_over_a_network():
    """A third fewer bytes, and still 33 dB."""
    image = photo()
    here = ITERM2.encode(frame_of(image), ROOM, None)
    there = ITERM2.encode(frame_of(image), replace(ROOM, remote=True), None)
    assert len(there) < 0.7 * len(here)
    assert psnr(decoders.iterm2(there, ROOM).picture, image) > 33


def test_a_picture_that_stays_is_exact():
    """A PNG; over a network a JPEG of 40 dB, in less than half of that."""
    image = photo()
    here = ITERM2.rest(frame_of(image), ROOM)
    assert (decoders.iterm2(here, ROOM).picture == image).all()
    there = ITERM2.rest(frame_of(image), replace(ROOM, remote=True))
    assert psnr(decoders.iterm2(there, ROOM).picture, image) > 40
    assert len(there) < len(here) / 2


def test_where_every_picture_is_kept_there_are_few_and_small_ones():
    """iTerm2 keeps all: 10 a second at most, of two thirds of the bytes; a whole one at rest."""
    image = photo()
    keeps = replace(ROOM, name="iTerm2 3.5.0")
    assert ITERM2.fps(keeps) == 10
    assert ITERM2.fps(ROOM) == math.inf
    here = ITERM2.encode(frame_of(image), ROOM, None)
    there = ITERM2.encode(frame_of(image), keeps, None)
    assert len(there) < len(here) * 0.67
    assert ITERM2.rest(frame_of(image), keeps) == ITERM2.rest(frame_of(image), ROOM)


@pytest.mark.parametrize("name", ["", "Konsole 26.08.2"])
def test_cells_say_the_size_where_nobody_told_how_large_they_are(name):
    """All columns, and all rows but the last; the aspect gives way."""
    terminal = replace(ROOM, columns=9, rows=7, cell_told=False, name=name)
    for encode in (ITERM2.encode, ITERM2.fill):
        data = encode(frame_of(photo(90, 120)), terminal, None)
        [(keys, _)] = decoders.iterm2_files(data)
        assert (keys["width"], keys["height"]) == ("9", "6")
        assert keys["preserveAspectRatio"] == ("1" if name else "0")


def test_an_unchanged_picture_costs_nothing():
    """Frames equal at 8 bits send nothing."""
    image = photo(20, 10)
    assert ITERM2.encode(frame_of(image), ROOM, frame_of(image)) == b""


@pytest.mark.parametrize(
    ("terminal", "reason"),
    [
        (Terminal(), "OSC 1337"),
        (Terminal(iterm2=True, multiplexer="tmux"), "tmux"),
        (Terminal(iterm2=True, tty=False), "not a terminal"),
    ],
)
def test_unsupported_says_why(terminal, reason):
    """Only a terminal known to take such pictures, with nothing in between, gets them."""
    assert reason in ITERM2.unsupported(terminal)
    assert ITERM2.unsupported(ROOM) is None
