"""Block characters, each cell the one that shows it best: octants, sextants, or quadrants and
eighths, as ``Terminal.glyphs`` says.

In 24 bits a cell has its two best colours. With fewer colours it has two of the palette: near
those two where they differ, else the pair that makes their mixture, dithered within the cell.
"""

from __future__ import annotations

import numpy as np

from tsplat.core.types import Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters import halfblock
from tsplat.presenters.base import Presenter, Terminal
from tsplat.presenters.cells import (
    PLAIN,
    SPACE,
    TRUECOLOR,
    Drawn,
    Index,
    Numbers,
    Spots,
    mixer,
    numbered,
    packed,
    room,
    show,
)
from tsplat.presenters.mosaic import WIDE, Mosaic, fit, mosaic

HALVES = "halves"


def grid(terminal: Terminal) -> tuple[int, int]:
    """Px a cell (width, height)."""
    if terminal.glyphs == HALVES:
        return 1, 2
    return WIDE, mosaic(terminal.glyphs).height


def size(terminal: Terminal) -> tuple[int, int]:
    """Px of all rows but the last."""
    return room(terminal, *grid(terminal))


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The cells that differ from ``previous``, or all. What does not fit is cut off."""
    colors = terminal.colors

    def draw(spots: Spots) -> Drawn:
        if terminal.glyphs == HALVES:
            return halfblock.draw(spots, colors)
        chars = mosaic(terminal.glyphs)
        if colors == PLAIN:
            return _dithered(spots, chars, colors)
        if colors < TRUECOLOR:
            return _mixed(spots, chars, colors)
        best = fit(spots.pixels, chars)
        inks, papers = packed(np.rint(best.inks)), packed(np.rint(best.papers))
        return _placed(best.splits, chars, inks, papers)

    return show(frame, terminal, previous, *grid(terminal), draw)


def _placed(splits: Index, chars: Mosaic, inks: Numbers, papers: Numbers) -> Drawn:
    """The split's character, or its complement with the colours exchanged.

    Where there are both, the larger number is the ink, so that neighbours of the same two colours
    need no SGR between them.
    """
    plain, exchanged = chars.glyphs[splits], chars.complements[splits]
    turn = (plain == 0) | ((exchanged != 0) & (inks < papers))
    flat = inks == papers
    glyphs = np.where(flat, np.uint32(SPACE), np.where(turn, exchanged, plain))
    return Drawn(glyphs, np.where(turn, papers, inks), np.where(turn, inks, papers))


def _mixed(spots: Spots, chars: Mosaic, colors: int) -> Drawn:
    """Cells in colours of the palette.

    Where a cell varies less than dots of the palette's two nearest colours would, it is dithered.
    """
    palette = mixer(colors)
    pixels = spots.pixels.reshape(3, -1, spots.pixels.shape[3])
    means = pixels.mean(1, dtype=np.float32)
    first, second = (palette.palette.T.take(rows, 1) for rows in palette.pair(palette.bins(means)))
    variance = ((pixels - means[:, None]) ** 2).sum((0, 1)) / pixels.shape[1]
    smooth = variance <= ((second - first) ** 2).sum(0) / 4
    count = len(smooth)
    drawn = Drawn(np.empty(count, np.uint32), np.empty(count, np.int32), np.empty(count, np.int32))
    for way, cells in ((_dithered, smooth), (_edged, ~smooth)):
        some = np.flatnonzero(cells)
        if not len(some):
            continue
        part = way(_some(spots, some), chars, colors)
        drawn.glyphs[some], drawn.inks[some], drawn.papers[some] = (
            part.glyphs,
            part.inks,
            part.papers,
        )
    return drawn


def _edged(spots: Spots, chars: Mosaic, colors: int) -> Drawn:
    """Cells of two colours, each near one of the palette; they are dithered from cell to cell."""
    palette = mixer(colors)
    best = fit(spots.pixels, chars)
    places = spots.thresholds(2, 1)[:, 0]
    inks = numbered(palette.mix(best.inks, places[0]), colors)
    papers = numbered(palette.mix(best.papers, places[1]), colors)
    return _placed(best.splits, chars, inks, papers)


def _some(spots: Spots, which: Index) -> Spots:
    return Spots(spots.pixels.take(which, 3), spots.rows[which], spots.columns[which])


def _dithered(spots: Spots, chars: Mosaic, colors: int) -> Drawn:
    """Cells whose dots mix the two colours of the palette that make the cell's mean."""
    palette = mixer(colors)
    high, wide, count = spots.pixels.shape[1:]
    squares = spots.pixels.reshape(3, chars.grid, high // chars.grid, wide, count)
    dots = squares.mean(2, dtype=np.float32).reshape(3, -1, count)
    places = spots.thresholds(chars.grid, wide).reshape(-1, count)
    if colors == PLAIN:
        patterns = np.packbits(palette.mix(dots, places), axis=0, bitorder="little")[0]
        nothing = np.zeros(count, np.int32)
        return Drawn(chars.dots[patterns], nothing, nothing)
    bins = palette.bins(spots.pixels.reshape(3, -1, count).mean(1, dtype=np.float32))
    second = places < palette.level(bins, dots)
    patterns = np.packbits(second, axis=0, bitorder="little")[0]
    papers, inks = palette.pair(bins)
    inks = np.where(patterns == 0, papers, inks)
    papers = np.where(patterns == len(chars.dots) - 1, inks, papers)
    glyphs = np.where(inks == papers, np.uint32(SPACE), chars.dots[patterns])
    return Drawn(glyphs, numbered(inks, colors), numbered(papers, colors))


def pixel(terminal: Terminal) -> tuple[float, float]:
    """Screen px that one px covers."""
    wide, high = grid(terminal)
    return terminal.cell_width / wide, terminal.cell_height / high


def unsupported(terminal: Terminal) -> str | None:
    """None, or why not."""
    if not terminal.tty:
        return "the output is not a terminal"
    if not terminal.draws_blocks:
        return "the terminal is not known to draw blocks itself, and fonts leave gaps"
    return None


BLOCKS = Presenter(
    name="blocks",
    summary="quadrants and eighths, sextants or octants, the best for each cell",
    encode=encode,
    size=size,
    unsupported=unsupported,
    pixel=pixel,
    samples=3,
    rank=15,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The blocks presenter."""
    return [BLOCKS]
