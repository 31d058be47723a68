"""Two pixels in each cell: U+2580 or U+2584, one half in the ink's colour, one in the paper's."""

from __future__ import annotations

import numpy as np

from tsplat.core.types import Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters.base import Presenter, Terminal
from tsplat.presenters.cells import (
    PLAIN,
    TRUECOLOR,
    Drawn,
    Spots,
    mixer,
    numbered,
    packed,
    room,
    show,
    token,
    tokens,
)

UPPER, LOWER = token("▀"), token("▄")
GLYPHS = tokens(" ▄▀█")  # by upper half, lower half


def size(terminal: Terminal) -> tuple[int, int]:
    """Two px a cell, in all rows but the last."""
    return room(terminal, 1, 2)


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The cells that differ from ``previous``, or all. What does not fit is cut off."""
    return show(frame, terminal, previous, 1, 2, lambda spots: draw(spots, terminal.colors))


def draw(spots: Spots, colors: int) -> Drawn:
    """Cells of one by two px. Fewer colours than 24 bits are dithered, each px at its place."""
    halves = spots.pixels[:, :, 0]  # [3, 2, N]
    if colors >= TRUECOLOR:
        numbers = packed(halves)
    else:
        rows = mixer(colors).mix(halves, spots.thresholds(2, 1)[:, 0])
        numbers = numbered(rows, colors)
    upper, lower = numbers
    if colors == PLAIN:
        return Drawn(GLYPHS[2 * upper + lower], upper, lower)
    # The same two colours are the same ink and paper, whichever is above: fewer SGR
    return Drawn(
        np.where(upper > lower, np.uint32(UPPER), np.uint32(LOWER)),
        np.maximum(upper, lower),
        np.minimum(upper, lower),
    )


def unsupported(terminal: Terminal) -> str | None:
    """None, or why not."""
    return None if terminal.tty else "the output is not a terminal"


HALFBLOCK = Presenter(
    name="halfblock",
    summary="half blocks, two pixels a cell, any terminal",
    encode=encode,
    size=size,
    unsupported=unsupported,
    pixel=lambda terminal: (terminal.cell_width, terminal.cell_height / 2),
    samples=4,
    rank=10,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The half-block presenter."""
    return [HALFBLOCK]
