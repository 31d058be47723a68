"""Pictures made of characters: which cells changed, and the bytes that show them.

A presenter says how many px a cell has and draws cells, each by itself: a character, the colour of
its ink and that of its paper. The rest is here: only cells whose px changed are drawn, and written
with the shortest cursor moves and with SGR for what the cell before did not set. Sequences:
https://invisible-island.net/xterm/ctlseqs/ctlseqs.html (CUP, CUF, SGR).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsplat.core.types import F32, U8, Frame
from tsplat.presenters.base import Terminal, pixels
from tsplat.presenters.dither import THRESHOLDS, Mixer

CSI = b"\x1b["
RESET = CSI + b"m"  # SGR 0
FOREGROUND, BACKGROUND = 0, 10  # SGR: a background's number is the foreground's and ten
TRUECOLOR = 1 << 24
PLAIN = 2  # Terminal.colors: none, NO_COLOR
LIMIT = 999  # rows and columns; no terminal has more, and a number then has three digits
REDRAWN = 60_000  # px at most that are drawn as they were before, too, to find equal cells: 8 ms

# The sixteen colours as xterm has them; themes change them, so a picture is never exact
ANSI = np.array(
    [
        [0, 0, 0], [205, 0, 0], [0, 205, 0], [205, 205, 0],
        [0, 0, 238], [205, 0, 205], [0, 205, 205], [229, 229, 229],
        [127, 127, 127], [255, 0, 0], [0, 255, 0], [255, 255, 0],
        [92, 92, 255], [255, 0, 255], [0, 255, 255], [255, 255, 255],
    ],
    np.float32,
)  # fmt: skip
FIRST_FIXED = 16  # of the 256 colours; the sixteen before it are the theme's
CUBE = np.array([0, 95, 135, 175, 215, 255], np.float32)  # 16 to 231: r, g, b
GREYS = np.arange(8, 239, 10, dtype=np.float32)  # 232 to 255

Index = NDArray[np.intp]
Numbers = NDArray[np.int32]  # colours as SGR has them: r << 16 | g << 8 | b, or a number
Tokens = NDArray[np.uint32]  # up to four bytes each, the first in the lowest byte, rest 0


@dataclass(frozen=True, eq=False)
class Spots:
    """N cells of a picture; the cells are the last axis, along which NumPy is quick."""

    pixels: U8  # [3, h, w, N]
    rows: Index  # [N]
    columns: Index  # [N]

    def thresholds(self, height: int, width: int) -> U8:
        """Bayer's, [height, width, N], for so many dots a cell; they stand still on the screen."""
        size = len(THRESHOLDS)
        dots: U8 = _dots(height, width).take(self.rows % size * size + self.columns % size, 2)
        return dots


@cache
def _dots(height: int, width: int) -> U8:
    """Thresholds of a cell [height, width, 64], by its row and column; they repeat every 8."""
    size = len(THRESHOLDS)
    y = (np.arange(height)[:, None] + np.arange(size) * height) % size  # [height, row]
    x = (np.arange(width)[:, None] + np.arange(size) * width) % size
    dots: U8 = THRESHOLDS[y[:, None, :, None], x[None, :, None, :]].reshape(height, width, -1)
    return dots


@dataclass(frozen=True, eq=False)
class Drawn:
    """What N cells show. Where ink and paper are one colour the character does not matter."""

    glyphs: Tokens  # [N] UTF-8
    inks: Numbers  # [N]
    papers: Numbers  # [N]


Draw = Callable[[Spots], Drawn]
"""Cells to characters. Each depends on its own px and place alone, so that what did not change need
not be drawn again."""


def token(text: str | bytes) -> int:
    """``text``, at most four bytes, as one of :data:`Tokens`."""
    data = text.encode() if isinstance(text, str) else text
    return int.from_bytes(data, "little")


def tokens(texts: str | list[str]) -> Tokens:
    """A token for each of ``texts``."""
    return np.array([token(text) for text in texts], np.uint32)


SPACE, FULL = token(" "), token("█")


@cache
def palette(colors: int) -> F32:
    """RGB [K, 3], 0..255: 240 fixed ones of the 256 colours, 16, or black and white."""
    if colors == PLAIN:
        return np.array([[0, 0, 0], [255, 255, 255]], np.float32)
    if colors == 16:
        return ANSI
    cube = np.stack(np.meshgrid(CUBE, CUBE, CUBE, indexing="ij"), -1).reshape(-1, 3)
    return np.concatenate([cube, np.repeat(GREYS[:, None], 3, 1)])


@cache
def mixer(colors: int) -> Mixer:
    """Mixes the palette of ``colors``, 256 or fewer."""
    return Mixer(palette(colors))


def packed(rgb: NDArray[Any]) -> Numbers:
    """[3, ...], 0..255, as 24-bit numbers."""
    r, g, b = (plane.astype(np.int32) for plane in rgb)
    numbers: Numbers = r << 16 | g << 8 | b
    return numbers


def numbered(rows: NDArray[np.integer], colors: int) -> Numbers:
    """Rows of :func:`palette` as SGR numbers."""
    return rows.astype(np.int32) + np.int32(FIRST_FIXED if colors == 256 else 0)


def room(terminal: Terminal, wide: int, high: int) -> tuple[int, int]:
    """Px (width, height) of all rows but the last, with ``wide`` x ``high`` px a cell."""
    return (
        wide * min(max(1, terminal.columns), LIMIT),
        high * min(max(1, terminal.rows - 1), LIMIT),
    )


def show(
    frame: Frame, terminal: Terminal, previous: Frame | None, wide: int, high: int, draw: Draw
) -> bytes:
    """The cells that differ from ``previous``, or all. What does not fit is cut off."""
    image = _whole(frame, terminal, wide, high)
    rows, columns = len(image) // high, image.shape[1] // wide
    before = None
    changed = np.ones((rows, columns), bool)
    if previous is not None and previous.rgb.shape == frame.rgb.shape:
        before = _whole(previous, terminal, wide, high)
        lines = (image != before).reshape(rows, high, -1).any(1)
        changed = lines.reshape(rows, columns, -1).any(-1)
    row, column = np.nonzero(changed)
    if not len(row):
        return b""
    drawn = draw(_spots(image, row, column, wide, high))
    few = len(row) * wide * high <= REDRAWN
    if before is not None and terminal.colors < TRUECOLOR and few:  # other px, often the same cell
        old = draw(_spots(before, row, column, wide, high))
        differs = (drawn.glyphs != old.glyphs) | (drawn.inks != old.inks)
        keep = np.flatnonzero(differs | (drawn.papers != old.papers))
        if not len(keep):
            return b""
        row, column = row[keep], column[keep]
        drawn = Drawn(drawn.glyphs[keep], drawn.inks[keep], drawn.papers[keep])
    return write(row, column, drawn, terminal.colors)


def _whole(frame: Frame, terminal: Terminal, wide: int, high: int) -> U8:
    """The picture that fits, in whole cells; px that are missing are black."""
    width, height = room(terminal, wide, high)
    image = pixels(frame)[:height, :width]
    more = -len(image) % high, -image.shape[1] % wide
    return np.pad(image, ((0, more[0]), (0, more[1]), (0, 0))) if any(more) else image


def _spots(image: U8, row: Index, column: Index, wide: int, high: int) -> Spots:
    rows, columns = len(image) // high, image.shape[1] // wide
    cells = image.reshape(rows, high, columns, wide, 3).transpose(4, 1, 3, 0, 2)
    pixels = cells.reshape(3, high, wide, -1)
    if len(row) < pixels.shape[3]:
        pixels = pixels.take(row * columns + column, 3)
    return Spots(pixels, row, column)


def lit(spots: Spots, glyphs: Tokens, share: F32, colors: int) -> Drawn:
    """``glyphs`` [N] on black in the cell's mean colour; their ink fills ``share`` [N] of it.

    The less ink there is, the brighter, as far as colours go.
    """
    count = len(glyphs)
    if colors == PLAIN:
        nothing = np.zeros(count, np.int32)
        return Drawn(glyphs, nothing, nothing)
    means = spots.pixels.reshape(3, -1, count).mean(1, dtype=np.float32)
    bright = np.where(share > 0, np.rint(means / np.where(share > 0, share, 1)), 0).clip(0, 255)
    if colors >= TRUECOLOR:
        inks, black = packed(bright), np.zeros(count, np.int32)
    else:
        inks = numbered(mixer(colors).mix(bright, spots.thresholds(1, 1)[0, 0]), colors)
        black = np.full(count, numbered(np.array(0), colors), np.int32)
    inks = np.where(glyphs == SPACE, black, inks)
    return Drawn(np.where(inks == black, np.uint32(SPACE), glyphs), inks, black)


# --- bytes


def write(row: Index, column: Index, drawn: Drawn, colors: int) -> bytes:
    """Bytes that write the cells at ``row`` and ``column``, in reading order, from home on."""
    parts = [_moves(row, column)]
    if colors == PLAIN:
        parts.append(drawn.glyphs[:, None])
    else:
        parts += _colored(drawn, colors)
    data = np.concatenate(parts, 1).astype("<u4").tobytes().translate(None, b"\0")
    return data if colors == PLAIN else data + RESET


def _moves(row: Index, column: Index) -> Tokens:
    """Cursor moves, [N, 4], the shortest: nothing to the next cell, CUF over a gap, CR LF and CUF
    into the next row, CUP further. After the last column the cursor waits there for either.
    """
    down = np.diff(row, prepend=0)
    gap = np.diff(column, prepend=-1) - 1
    gap = np.where(down > 0, column, gap)
    moves = np.zeros((len(row), 4), np.uint32)
    far = np.flatnonzero((down > 0) | (gap > 0))  # most cells are next to the one before
    moves[far] = _far_moves(row[far], column[far], down[far], gap[far])
    return moves


def _far_moves(row: Index, column: Index, down: Index, gap: Index) -> Tokens:
    jumps = down > 1
    skips = ~jumps & (gap > 0)
    moves = np.zeros((len(row), 4), np.uint32)
    moves[down == 1, 0] = token("\r\n")
    escape = np.where(down == 1, token("\r\n" + CSI.decode()), token(CSI))
    moves[skips, 0] = escape[skips]
    moves[skips, 1] = _numbers("%dC", np.where(gap > 1, gap, 0))[skips]
    moves[skips & (gap == 1), 1] = token("C")
    moves[jumps, 0] = token(CSI)
    moves[jumps, 1] = _numbers("%d", row[jumps] + 1)
    moves[jumps, 2] = np.where(column[jumps] > 0, _numbers(";%d", column[jumps] + 1), np.uint32(0))
    moves[jumps, 3] = token("H")
    return moves


def _colored(drawn: Drawn, colors: int) -> list[Tokens]:
    """SGR for what the cells before did not set, and the characters."""
    inks, papers = drawn.inks, drawn.papers
    flat = inks == papers
    glyphs = np.where(flat, np.uint32(SPACE), drawn.glyphs)
    if colors < TRUECOLOR:  # neighbours share colours: a block in the ink that is set costs no SGR
        last = _before(~flat)
        glyphs = np.where(flat & (last >= 0) & (inks == inks[last]), np.uint32(FULL), glyphs)
    set_ink = _sets(inks, glyphs != SPACE)
    set_paper = _sets(papers, glyphs != FULL)
    any_set = set_ink | set_paper

    def where(flags: NDArray[np.bool_], text: bytes) -> Tokens:
        return np.where(flags, np.uint32(token(text)), np.uint32(0))[:, None]

    return [
        where(any_set, CSI),
        np.where(set_ink[:, None], _color(inks, colors, FOREGROUND), np.uint32(0)),
        where(set_ink & set_paper, b";"),
        np.where(set_paper[:, None], _color(papers, colors, BACKGROUND), np.uint32(0)),
        where(any_set, b"m"),
        glyphs[:, None],
    ]


def _before(flags: NDArray[np.bool_]) -> Index:
    """For each cell the last one before it that is flagged, or -1."""
    last = np.maximum.accumulate(np.where(flags, np.arange(len(flags)), -1))
    return np.concatenate([[-1], last[:-1]])


def _sets(numbers: Numbers, needed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which cells need a colour that is not the one set last."""
    last = _before(needed)
    sets: NDArray[np.bool_] = needed & ((last < 0) | (numbers != numbers[last]))
    return sets


def _color(numbers: Numbers, colors: int, layer: int) -> Tokens:
    """SGR parameters: 38;2;r;g;b, 38;5;n, or 30 to 37 and 90 to 97, [N, 4, 2 or 1]."""
    if colors == 16:
        return _numbers("%d", np.where(numbers < 8, 30, 90 - 8) + numbers + layer)[:, None]
    if colors == 256:
        kind = token(b"%d;5" % (38 + layer))
        return np.stack([np.full(len(numbers), kind, np.uint32), _numbers(";%d", numbers)], 1)
    kind = token(b"%d;2" % (38 + layer))
    channels = [_numbers(";%d", numbers >> shift & 255) for shift in (16, 8, 0)]
    return np.stack([np.full(len(numbers), kind, np.uint32), *channels], 1)


def _numbers(form: str, numbers: NDArray[np.integer]) -> Tokens:
    result: Tokens = _table(form)[numbers]
    return result


@cache
def _table(form: str) -> Tokens:
    return tokens([form % n for n in range(LIMIT + 1)])
