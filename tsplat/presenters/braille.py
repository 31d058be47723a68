"""Two by four dots a cell, U+2800 to U+28FF, in one colour on black.

The dots are dithered by brightness. With colours more of them are set than that, and their common
colour is as much darker, so that the cell's mean is kept. A cell of one colour has as many dots as
any other one of it: what is their own then is only where the dots are, not the colour as well.
"""

from __future__ import annotations

import numpy as np

from tsplat.core.types import Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters.base import Presenter, Terminal
from tsplat.presenters.cells import (
    PLAIN,
    SPACE,
    TRUECOLOR,
    Drawn,
    Spots,
    lit,
    room,
    show,
    tokens,
)
from tsplat.presenters.dither import THRESHOLDS
from tsplat.presenters.halfblock import unsupported

WIDE, HIGH = 2, 4  # dots of a cell
DOTS = WIDE * HIGH
BITS = np.array(
    [0, 3, 1, 4, 2, 5, 6, 7], np.uint8
)  # dot's bit, by row and column; 7 and 8 came late
GLYPHS = tokens([chr(0x2800 + n) for n in range(256)])


def size(terminal: Terminal) -> tuple[int, int]:
    """Eight px a cell, in all rows but the last."""
    return room(terminal, WIDE, HIGH)


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The cells that differ from ``previous``, or all. What does not fit is cut off."""
    return show(frame, terminal, previous, WIDE, HIGH, lambda spots: draw(spots, terminal.colors))


def draw(spots: Spots, colors: int) -> Drawn:
    """Cells of two by four px."""
    count = spots.pixels.shape[3]
    brightness = spots.pixels.max(0).reshape(-1, count) / np.float32(255)
    share = brightness if colors == PLAIN else np.sqrt(brightness)
    if colors >= TRUECOLOR:
        flat = (spots.pixels == spots.pixels[:, :1, :1]).all((0, 1, 2))
        share[:, flat] = np.ceil(share[:, flat] * DOTS) / DOTS
    places = spots.thresholds(HIGH, WIDE).reshape(-1, count)
    dots = places < np.rint(share * THRESHOLDS.size)
    patterns = (dots.astype(np.uint8) << BITS[:, None]).sum(0, dtype=np.uint8)
    glyphs = np.where(patterns == 0, np.uint32(SPACE), GLYPHS[patterns])
    return lit(spots, glyphs, dots.mean(0, dtype=np.float32), colors)


BRAILLE = Presenter(
    name="braille",
    summary="braille dots, eight a cell, in one colour",
    encode=encode,
    size=size,
    unsupported=unsupported,
    pixel=lambda terminal: (terminal.cell_width / WIDE, terminal.cell_height / HIGH),
    samples=3,
    rank=4,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The braille presenter."""
    return [BRAILLE]
