"""Sixel graphics (https://vt100.net/docs/vt3xx-gp/chapter14.html).

A band is six rows; for each colour of a band a line of characters says which of the six pixels of
each column have it. The lines are made without a loop: one number per pixel that sorts by band,
colour, column and row; equal columns of that order are one character, equal characters a run.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tsplat.core.types import F32, I64, U8, Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters.base import Presenter, Terminal, changed
from tsplat.presenters.dither import adaptive_palette, distinct, dither
from tsplat.presenters.enlarge import edges

DCS = b"\x1bP"  # Device Control String
ST = b"\x1b\\"
PARAMETERS = b"0;1;0q"  # P2=1: no background first, it would flash; WezTerm needs P1 for that
BAND = 6  # px
EMPTY = 0x3F  # "?": none of the six
COLORS = 256  # at most, whatever the terminal has: a register is a byte
WIDTH_MAX = 9999  # px; a run's length then has four digits at most

Tokens = NDArray[np.uint64]  # up to eight characters each, the first in the lowest byte, rest 0


def size(terminal: Terminal) -> tuple[int, int]:
    """The largest picture after which nothing scrolls, in px; the height is whole bands.

    A sixel picture leaves the cursor in its last row or the one below, so one row stays free;
    Konsole (22.12 to 26.08) puts it two below.
    """
    free = 2 if terminal.name.startswith("Konsole") else 1
    width = int(terminal.columns * terminal.cell_width)
    height = int(max(1, terminal.rows - free) * terminal.cell_height)
    most_wide, most_high = terminal.sixel_max
    width = min(width, most_wide or WIDTH_MAX, WIDTH_MAX)
    height = min(height, most_high or height)
    return max(1, width), max(BAND, height - height % BAND)


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame in at most 256 colours of its own; b"" if it looks like ``previous``.

    What does not fit into :func:`size` is cut off.
    """
    image = frame.to_uint8()
    if not changed(image, previous):
        return b""
    width, height = size(terminal)
    palette, rows = quantize(image[:height, :width], terminal.sixel_registers)
    return sixel(palette, rows)


def fill(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame with its pixels repeated until they cover :func:`size`.

    Sixel has no scaling that terminals agree on. Rows are repeated before the lines are made of
    them, columns after: runs only get longer.
    """
    image = frame.to_uint8()
    if not changed(image, previous):
        return b""
    width, height = size(terminal)
    palette, rows = quantize(image, terminal.sixel_registers)
    tall = np.repeat(rows, np.diff(edges(frame.height, height)), axis=0)
    return sixel(palette, tall, edges(frame.width, width))


def quantize(image: U8, registers: int) -> tuple[U8, U8]:
    """A palette [K, 3] in percent, as sixel has it, and the row of each pixel [H, W]."""
    colors = distinct(image)
    shades = adaptive_palette(colors, max(2, min(registers, COLORS)))
    percent = np.unique(np.rint(shades / np.float32(2.55)), axis=0)
    shown: F32 = np.rint(percent * np.float32(2.55))
    return percent.astype(np.uint8), dither(colors, shown)


def sixel(palette: U8, rows: U8, columns: I64 | None = None) -> bytes:
    """A picture: ``palette`` [K, 3] in percent, ``rows`` [H, W] of it. Defines what it uses.

    ``columns`` [W + 1] are where each column begins and the last ends, if they are to be wider.
    """
    height, width = rows.shape
    columns = np.arange(width + 1) if columns is None else columns
    used = np.flatnonzero(np.bincount(rows.ravel(), minlength=len(palette)))
    registers = b"".join(
        b"#%d;2;%d;%d;%d" % (n, *color) for n, color in zip(used, palette[used], strict=True)
    )
    raster = b'"1;1;%d;%d' % (columns[-1], height)
    return DCS + PARAMETERS + raster + registers + _lines(rows, len(palette), columns) + ST


def _lines(rows: U8, colors: int, columns: I64) -> bytes:
    height, width = rows.shape
    # Who has which pixel: a line is a colour of a band, a place a column of a line
    y = np.arange(height)[:, None]
    lines = -(-height // BAND) * colors
    kind = np.int32 if lines * width << 3 < 1 << 31 else np.int64
    base = ((y // BAND * colors * width + np.arange(width)) << 3 | y % BAND).astype(kind)
    key = np.sort((base + rows * kind(width << 3)).ravel())
    place = key >> 3
    first = _changes(place)
    bits = np.array([1 << n for n in range(8)], np.uint8)[key & 7]
    character = np.add.reduceat(bits, first) + np.uint8(EMPTY)
    place = place[first]

    # Runs: neighbours in the same line with the same character
    line = place // kind(width)
    column = place - line * kind(width)
    begins = np.diff(place, prepend=kind(-2)) != 1
    begins[1:] |= character[1:] != character[:-1]
    begins |= column == 0
    start = np.flatnonzero(begins)
    length = np.diff(start, append=len(place))
    line, column, character = line[start], column[start], character[start]
    length, column = columns[column + length] - columns[column], columns[column]

    # Three tokens a run: where a line begins its colour, the gap before it, the run
    fresh = np.diff(line, prepend=-1) != 0
    gap = column.copy()
    gap[1:] -= np.where(fresh[1:], 0, column[:-1] + length[:-1]).astype(gap.dtype)
    blanks, heads, factors, select = _tables(int(columns[-1]))
    tokens = np.zeros((len(start), 3), "<u8")
    color = line[fresh] % colors
    next_band = np.diff(line[fresh] // colors, prepend=0) != 0
    tokens[fresh, 0] = np.where(next_band, select[1, color], select[0, color])
    tokens[0, 0] >>= 8  # no "$" after the registers: Konsole would forget the last of them
    tokens[:, 1] = blanks[gap]
    tokens[:, 2] = heads[length] + factors[length] * character.astype(np.uint64)
    return tokens.tobytes().translate(None, b"\0")


def _changes(values: NDArray[np.signedinteger]) -> NDArray[np.intp]:
    """Where sorted ``values`` are not what they were before, the first included."""
    return np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))


def _token(text: bytes) -> int:
    return int.from_bytes(text, "little")


@lru_cache(maxsize=4)
def _tables(width: int) -> tuple[Tokens, Tokens, Tokens, Tokens]:
    """For runs of 0 to ``width``: blanks; head and factor that make a token of a character.

    Up to three are spelled out, as they are no longer than ``!3~``: the factor 0x010101 repeats
    the character. Then the selection of each colour: after ``$`` (back to the band's begin) and
    after ``-`` (next band).
    """
    blanks, heads, factors = [0], [0], [0]
    for n in range(1, width + 1):
        if n <= 3:
            heads.append(0)
            factors.append(_token(b"\1" * n))
        else:
            heads.append(_token(b"!%d" % n))
            factors.append(1 << 8 * len(b"!%d" % n))
        blanks.append(heads[-1] + factors[-1] * EMPTY)
    select = [[_token(b"%c#%d" % (mark, n)) for n in range(256)] for mark in b"$-"]
    blank, head, factor = (np.array(t, np.uint64) for t in (blanks, heads, factors))
    return blank, head, factor, np.array(select, np.uint64)


def unsupported(terminal: Terminal) -> str | None:
    """None, or why not."""
    if not terminal.tty:
        return "the output is not a terminal"
    if not terminal.sixel:
        return "the terminal does not list sixel among its attributes"
    return None


SIXEL = Presenter(
    name="sixel",
    summary="sixel graphics, up to 256 colours of the frame's own",
    encode=encode,
    size=size,
    unsupported=unsupported,
    rank=20,
    fill=fill,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The sixel presenter."""
    return [SIXEL]
