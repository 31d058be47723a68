"""Two pixels in each cell: U+2580, its upper half in the foreground's colour, the lower in the
background's. Colours are SGR 38/48 and 30-37, 90-97, 40-47, 100-107:
https://invisible-island.net/xterm/ctlseqs/ctlseqs.html . Only cells that changed are written.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tsplat.core.types import F32, I64, U8, Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters.base import Presenter, Terminal
from tsplat.presenters.dither import distinct, dither

CSI = b"\x1b["
UPPER, LOWER, FULL = "▀".encode(), "▄".encode(), "█".encode()
RESET = CSI + b"m"  # SGR 0
FOREGROUND, BACKGROUND = 0, 10  # SGR: a background's number is the foreground's and ten

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
LIMIT = 999  # rows and columns; no terminal has more, and a number then has three digits
FIRST_FIXED = 16  # of the 256 colours; the sixteen before it are the theme's
CUBE = np.array([0, 95, 135, 175, 215, 255], np.float32)  # 16 to 231: r, g, b
GREYS = np.arange(8, 239, 10, dtype=np.float32)  # 232 to 255

Tokens = NDArray[np.uint32]  # up to four characters each, the first in the lowest byte, rest 0


def size(terminal: Terminal) -> tuple[int, int]:
    """Two px a cell, in all rows but the last."""
    return min(max(1, terminal.columns), LIMIT), 2 * min(max(1, terminal.rows - 1), LIMIT)


@cache
def palette(colors: int) -> F32:
    """RGB [K, 3], 0..255: 240 fixed ones of the 256 colours, 16, or black and white."""
    if colors == 2:
        return np.array([[0, 0, 0], [255, 255, 255]], np.float32)
    if colors == 16:
        return ANSI
    cube = np.stack(np.meshgrid(CUBE, CUBE, CUBE, indexing="ij"), -1).reshape(-1, 3)
    return np.concatenate([cube, np.repeat(GREYS[:, None], 3, 1)])


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The cells that differ from ``previous``, or all. What does not fit is cut off."""
    width, height = size(terminal)
    upper, lower = _cells(frame.to_uint8()[:height, :width], terminal.colors)
    changed = np.ones(upper.shape, bool)
    if previous is not None and previous.rgb.shape == frame.rgb.shape:
        before = _cells(previous.to_uint8()[:height, :width], terminal.colors)
        changed = (upper != before[0]) | (lower != before[1])
    row, column = np.nonzero(changed)
    if not len(row):
        return b""
    parts = [_moves(row, column)]
    parts += _glyphs(upper[changed], lower[changed], terminal.colors)
    data = np.concatenate(parts, 1).astype("<u4").tobytes().translate(None, b"\0")
    return data if terminal.colors == 2 else data + RESET


def _cells(image: U8, colors: int) -> tuple[I64, I64]:
    """The upper and the lower colour of each cell: r << 16 | g << 8 | b, or a number."""
    if len(image) % 2:
        image = np.concatenate([image, np.zeros_like(image[:1])])
    if colors > 256:
        r, g, b = np.moveaxis(image.astype(np.int64), -1, 0)
        numbers = r << 16 | g << 8 | b
    else:
        numbers = dither(distinct(image), palette(colors)).astype(np.int64)
        numbers += FIRST_FIXED if colors == 256 else 0
    return numbers[0::2], numbers[1::2]


def _moves(row: NDArray[np.intp], column: NDArray[np.intp]) -> Tokens:
    """Cursor moves, [N, 3]: CUP into another row, CUF over a gap, nothing to the next cell.

    The cursor is at home at the start. After the last column it waits there: rows need CUP.
    """
    gap = np.diff(column, prepend=0)
    gap[1:] -= 1
    jumps = np.diff(row, prepend=0) != 0
    skips = ~jumps & (gap > 0)
    moves = np.zeros((len(row), 3), np.uint32)
    escape, number = _token(CSI), _numbers
    moves[jumps | skips, 0] = escape
    moves[skips, 1] = number("%d", gap[skips])
    moves[skips, 2] = _token(b"C")
    moves[jumps, 1] = number("%d;", row[jumps] + 1)
    moves[jumps, 2] = number("%dH", column[jumps] + 1)
    return moves


def _glyphs(upper: I64, lower: I64, colors: int) -> list[Tokens]:
    """SGR for what the cell before did not set, and the character."""
    if colors == 2:
        texts = np.array([_token(t) for t in (b" ", LOWER, UPPER, FULL)], np.uint32)
        return [texts[2 * upper + lower][:, None]]
    plain = upper == lower  # a space: its foreground does not matter, nor does it change
    set_lower = np.diff(lower, prepend=-1) != 0
    last = np.maximum.accumulate(np.where(plain, -1, np.arange(len(upper))))
    last = np.concatenate([[-1], last[:-1]])  # the cell that set the foreground last
    set_upper = ~plain & ((last < 0) | (upper != upper[last]))
    any_set = set_upper | set_lower
    both = set_upper & set_lower

    def where(flags: NDArray[np.bool_], text: bytes) -> Tokens:
        return np.where(flags, np.uint32(_token(text)), np.uint32(0))[:, None]

    return [
        where(any_set, CSI),
        np.where(set_upper[:, None], _color(upper, colors, FOREGROUND), np.uint32(0)),
        where(both, b";"),
        np.where(set_lower[:, None], _color(lower, colors, BACKGROUND), np.uint32(0)),
        where(any_set, b"m"),
        np.where(plain, np.uint32(_token(b" ")), np.uint32(_token(UPPER)))[:, None],
    ]


def _color(numbers: I64, colors: int, layer: int) -> Tokens:
    """SGR parameters: 38;2;r;g;b, 38;5;n, or 30 to 37 and 90 to 97, [N, 4, 2 or 1]."""
    if colors == 16:
        return _numbers("%d", np.where(numbers < 8, 30, 90 - 8) + numbers + layer)[:, None]
    if colors == 256:
        kind = _token(b"%d;5" % (38 + layer))
        return np.stack([np.full(len(numbers), kind, np.uint32), _numbers(";%d", numbers)], 1)
    kind = _token(b"%d;2" % (38 + layer))
    channels = [_numbers(";%d", numbers >> shift & 255) for shift in (16, 8, 0)]
    return np.stack([np.full(len(numbers), kind, np.uint32), *channels], 1)


def _token(text: bytes) -> int:
    return int.from_bytes(text, "little")


def _numbers(form: str, numbers: NDArray[np.integer]) -> Tokens:
    tokens: Tokens = _table(form)[numbers]
    return tokens


@cache
def _table(form: str) -> Tokens:
    return np.array([_token((form % n).encode()) for n in range(LIMIT + 1)], np.uint32)


def unsupported(terminal: Terminal) -> str | None:
    """None, or why not."""
    return None if terminal.tty else "the output is not a terminal"


HALFBLOCK = Presenter(
    name="halfblock",
    summary="U+2580 half blocks, two pixels a cell, any terminal",
    encode=encode,
    size=size,
    unsupported=unsupported,
    pixel=lambda terminal: (terminal.cell_width, terminal.cell_height / 2),
    rank=10,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The half-block presenter."""
    return [HALFBLOCK]
