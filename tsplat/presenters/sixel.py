"""Sixel graphics (https://vt100.net/docs/vt3xx-gp/chapter14.html).

A band is six rows; for each colour of a band a line of characters says which of the six pixels of
each column have it. Several lines go over the band at once where each begins behind the last.

A moving picture is not dithered and its runs are drawn out a little: less bytes, and less error.
One that stays is dithered. Of a picture that is known only the rows are sent that changed.

The lines are made without a loop: one number per pixel that sorts by band, colour, column and row;
equal columns of that order are one character, equal characters a run. Or by C.
"""

from __future__ import annotations

from bisect import bisect_left
from functools import lru_cache
from math import lcm

import numpy as np
from numpy.typing import NDArray

from tsplat.core.types import I32, I64, U8, Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters import native
from tsplat.presenters.base import Presenter, Terminal, changed_rows, pixels
from tsplat.presenters.dither import Colors, adaptive_palette, distinct, dither, steady
from tsplat.presenters.enlarge import edges

DCS = b"\x1bP"  # Device Control String
ST = b"\x1b\\"
PARAMETERS = b"0;1;0q"  # P2=1: no background first, it would flash; WezTerm needs P1 for that
BAND = 6  # px
EMPTY = 0x3F  # "?": none of the six
COLORS = 256  # at most, whatever the terminal has: a register is a byte
WIDTH_MAX = 9999  # px; a run's length then has four digits at most
# While the picture moves: colours, and by how much the error of a pixel, in squared levels, may
# grow so that a run goes on. The demo scene at 640x360: 108 kB at 36.4 dB, remote 64 kB at 32.3.
# Where a pixel covers four or more each way, that costs more likeness than half the colours do.
NEAR, NEAR_COARSE = (COLORS, 100), (COLORS // 2, 200)
REMOTE, REMOTE_COARSE = (64, 200), (32, 400)
COARSE = 4

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
    """What differs from ``previous``, or all, in at most 256 colours of its own.

    What does not fit into :func:`size` is cut off.
    """
    width, height = size(terminal)
    return _encode(frame, terminal, previous, min(frame.width, width), min(frame.height, height))


def fill(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame with its pixels repeated until they cover :func:`size`.

    Sixel has no scaling that terminals agree on: xterm, mlterm, foot 1.13 and xterm.js take no
    notice of the aspect that the raster attributes give, foot 1.28 and Konsole do.
    """
    return _encode(frame, terminal, previous, *size(terminal))


def rest(frame: Frame, terminal: Terminal) -> bytes:
    """The frame dithered, in as many colours as there are."""
    width, height = size(terminal)
    palette, rows = dithered(pixels(frame)[:height, :width], terminal.sixel_registers)
    return sixel(palette, rows)


def _encode(
    frame: Frame, terminal: Terminal, previous: Frame | None, width: int, height: int
) -> bytes:
    """``frame`` shown at ``width`` x ``height`` px, each of its pixels once or more."""
    image = pixels(frame)[:height, :width]
    downs, columns = _row_edges(len(image), height), edges(image.shape[1], width)
    changed = changed_rows(image, previous)
    if changed is None:
        return b""
    top, end = _strip(int(downs[changed.start]), int(downs[changed.stop]), height, terminal)
    source = np.repeat(np.arange(len(image), dtype=np.int32), np.diff(downs))[top:end]
    first = int(source[0])
    coarse = height >= COARSE * len(image)
    ways = (REMOTE, REMOTE_COARSE) if terminal.remote else (NEAR, NEAR_COARSE)
    colors, tolerance = ways[coarse]
    picture = distinct(image[first : source[-1] + 1])
    palette = percents(picture, min(colors, terminal.sixel_registers))
    rows = steady(picture, levels(palette), tolerance)
    move = b"\x1b[%dH" % (top / terminal.cell_height + 1) if top else b""
    return move + sixel(palette, rows, columns, source - np.int32(first))


def _row_edges(few: int, many: int) -> I64:
    """As :func:`edges`, but with bands where it can be: then a band has less to say.

    Of rows of 8 px or more a band has one, of rows of 4 or more its upper and its lower half each
    have one. No row is moved by more than half of it, so its middle stays.
    """
    rows = edges(few, many)
    for step in (BAND, BAND // 2):
        if many >= (step + step // 3) * few:
            rows = (rows + step // 2) // step * step
            rows[-1] = many
            break
    return rows


def _strip(top: int, end: int, height: int, terminal: Terminal) -> tuple[int, int]:
    """Rows to send if those from ``top`` to ``end`` changed, of ``height``.

    They begin with a cell. They end with a cell and a band, or with the picture, so that no cell is
    drawn in part: what a terminal makes of its rest is its own business. tmux, which draws again
    from pictures that it keeps, gets whole ones.
    """
    if terminal.multiplexer or not float(terminal.cell_height).is_integer():
        return 0, height
    step = lcm(BAND, int(terminal.cell_height))
    return top - top % step, min(height, end + -end % step)


def percents(picture: Colors, registers: int) -> U8:
    """A palette [K, 3] for ``picture`` in percent, as sixel has it."""
    shades = adaptive_palette(picture, max(2, min(registers, COLORS)))
    r, g, b = np.rint(shades / 2.55).astype(np.int32).T
    numbers = np.unique(r << 16 | g << 8 | b)
    return np.stack([numbers >> 16, numbers >> 8, numbers], 1).astype(np.uint8)


def levels(palette: U8) -> U8:
    """What a palette in percent looks like, 0..255."""
    values: U8 = np.rint(palette * 2.55).astype(np.uint8)
    return values


def dithered(image: U8, registers: int) -> tuple[U8, U8]:
    """A palette [K, 3] in percent, and the row of each pixel [H, W]."""
    picture = distinct(image)
    palette = percents(picture, registers)
    return palette, dither(picture, levels(palette))


def sixel(palette: U8, rows: U8, columns: I64 | None = None, source: I32 | None = None) -> bytes:
    """A picture: ``palette`` [K, 3] in percent, ``rows`` [H, W] of it. Defines what it uses.

    ``columns`` [W + 1] are where each column begins and the last ends, if they are to be wider,
    ``source`` which of ``rows`` each row of the picture is, if there are to be more.
    """
    height, width = rows.shape
    columns = np.arange(width + 1) if columns is None else columns
    source = np.arange(height, dtype=np.int32) if source is None else source
    if native.lib is not None:
        lines, counts = native.lines(rows, source, columns.astype(np.int32))
    else:
        lines = _lines(rows[source], len(palette), columns)
        counts = np.bincount(rows.ravel()).astype(bool)
    used = np.flatnonzero(counts)
    registers = b"".join(
        b"#%d;2;%d;%d;%d" % (n, r, g, b)
        for n, (r, g, b) in zip(used.tolist(), palette[used].tolist(), strict=True)
    )
    raster = b'"1;1;%d;%d' % (columns[-1], len(source))
    return DCS + PARAMETERS + raster + registers + lines + ST


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

    # Lines in the order of _chained, their runs with them
    of_line = np.flatnonzero(np.diff(line, prepend=-1) != 0)
    band, color = np.divmod(line[of_line], colors)
    ends = np.append(of_line[1:], len(line)) - 1
    order, marks, pens = _chained(band, color, column[of_line], (column + length)[ends])
    rank = np.empty(len(order), np.intp)
    rank[order] = np.arange(len(order))
    runs = np.argsort(np.repeat(rank, np.diff(of_line, append=len(line))), kind="stable")
    line, column, character, length = line[runs], column[runs], character[runs], length[runs]

    # Three tokens a run: where a line begins its colour, the gap before it, the run
    fresh = np.diff(line, prepend=-1) != 0
    gap = column.copy()
    gap[1:] -= (column[:-1] + length[:-1]).astype(gap.dtype)
    gap[fresh] = column[fresh] - pens
    blanks, heads, factors, select = _tables(int(columns[-1]))
    tokens = np.zeros((len(runs), 3), "<u8")
    tokens[fresh, 0] = select[marks, color[order]]
    tokens[:, 1] = blanks[gap]
    tokens[:, 2] = heads[length] + factors[length] * character.astype(np.uint64)
    return tokens.tobytes().translate(None, b"\0")


def _chained(
    band: NDArray[np.integer], color: NDArray[np.integer], start: I64, end: I64
) -> tuple[list[int], list[int], list[int]]:
    """The order of the lines of a picture: their rows, what is written before each, from where.

    Before a line comes nothing, ``$`` or ``-``: 0, 1 or 2. In each pass over a band that line is
    next which begins first, not before the last one's end.
    """
    by_start = np.lexsort((color, start, band))
    order: list[int] = []
    marks: list[int] = []
    pens: list[int] = []
    for rows in np.split(by_start, np.flatnonzero(np.diff(band[by_start])) + 1):
        left = rows.tolist()
        starts, mark = start[rows].tolist(), 2 if order else 0
        while left:
            at = n = 0
            while (n := bisect_left(starts, at, n)) < len(left):
                order.append(left.pop(n))
                marks.append(mark)
                pens.append(at)
                at, mark = int(end[order[-1]]), 0
                del starts[n]
            mark = 1
    return order, marks, pens


def _changes(values: NDArray[np.signedinteger]) -> NDArray[np.intp]:
    """Where sorted ``values`` are not what they were before, the first included."""
    return np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))


def _token(text: bytes) -> int:
    return int.from_bytes(text, "little")


@lru_cache(maxsize=4)
def _tables(width: int) -> tuple[Tokens, Tokens, Tokens, Tokens]:
    """For runs of 0 to ``width``: blanks; head and factor that make a token of a character.

    Up to three are spelled out, as they are no longer than ``!3~``: the factor 0x010101 repeats
    the character. Then the selection of each colour: alone, after ``$`` (back to the band's begin)
    and after ``-`` (next band).
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
    select = [[_token(b"%b#%d" % (mark, n)) for n in range(256)] for mark in (b"", b"$", b"-")]
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
    rest=rest,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The sixel presenter."""
    return [SIXEL]
