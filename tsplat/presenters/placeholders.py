"""kitty's pictures inside tmux: cells of text that stand for parts of a picture.

The picture goes past tmux, which then sees nothing but characters: U+10EEEE, whose colour says
which picture, and whose combining marks say which row and column of it. They scroll, split and
are covered as text is. https://sw.kovidgoyal.net/kitty/graphics-protocol/#unicode-placeholders ;
tmux's pass-through: https://github.com/tmux/tmux/wiki/FAQ .
"""

from __future__ import annotations

from functools import lru_cache

PLACEHOLDER = "\U0010eeee"
COLORS = 240  # of 256, so that they get through where 24 bits would be rounded: the id's low byte
FIRST_COLOR = 16  # below are those that themes, and old ways to say them, change
TOPS = 126  # the id's top byte, told by a third mark, from 1 on; the two in the middle are 0
IDS = COLORS * TOPS

# rowcolumn-diacritics.txt of kitty: marks above the base (class 230) of Unicode 6.0 that neither
# decompose nor melt into letters, as (first, count)
_RUNS = (
    (0x305, 1), (0x30D, 2), (0x310, 1), (0x312, 1), (0x33D, 3), (0x346, 1), (0x34A, 3),
    (0x350, 3), (0x357, 1), (0x35B, 1), (0x363, 13), (0x483, 5), (0x592, 4), (0x597, 3),
    (0x59C, 6), (0x5A8, 2), (0x5AB, 2), (0x5AF, 1), (0x5C4, 1), (0x610, 8), (0x657, 5),
    (0x65D, 2), (0x6D6, 7), (0x6DF, 4), (0x6E4, 1), (0x6E7, 2), (0x6EB, 2), (0x730, 1),
    (0x732, 2), (0x735, 2), (0x73A, 1), (0x73D, 1), (0x73F, 3), (0x743, 1), (0x745, 1),
    (0x747, 1), (0x749, 2), (0x7EB, 7), (0x7F3, 1), (0x816, 4), (0x81B, 9), (0x825, 3),
    (0x829, 5), (0x951, 1), (0x953, 2), (0xF82, 2), (0xF86, 2), (0x135D, 3), (0x17DD, 1),
    (0x193A, 1), (0x1A17, 1), (0x1A75, 8), (0x1B6B, 1), (0x1B6D, 7), (0x1CD0, 3), (0x1CDA, 2),
    (0x1CE0, 1), (0x1DC0, 2), (0x1DC3, 7), (0x1DCB, 2), (0x1DD1, 22), (0x1DFE, 1), (0x20D0, 2),
    (0x20D4, 4), (0x20DB, 2), (0x20E1, 1), (0x20E7, 1), (0x20E9, 1), (0x20F0, 1), (0x2CEF, 3),
    (0x2DE0, 32), (0xA66F, 1), (0xA67C, 2), (0xA6F0, 2), (0xA8E0, 18), (0xAAB0, 1), (0xAAB2, 2),
    (0xAAB7, 2), (0xAABE, 2), (0xAAC1, 1), (0xFE20, 7), (0x10A0F, 1), (0x10A38, 1),
    (0x1D185, 5), (0x1D1AA, 4), (0x1D242, 3),
)  # fmt: skip
MARKS = "".join(chr(first + n) for first, count in _RUNS for n in range(count))
"""The mark that means 0, 1, ...; no picture has more rows or columns."""

ESC = b"\x1b"


def through_tmux(data: bytes) -> bytes:
    """``data``, for the terminal around tmux: one sequence of 1 MB at most."""
    return ESC + b"Ptmux;" + data.replace(ESC, ESC + ESC) + ESC + b"\\"


def image_id(number: int) -> int:
    """That of the picture ``number`` of :data:`IDS`: below 2^31, as all of ours."""
    return 1 + number // COLORS << 24 | FIRST_COLOR + number % COLORS


@lru_cache(maxsize=4)
def cells(columns: int, rows: int, image: int) -> bytes:
    """The cells of the picture with the id ``image`` from the top left on.

    Each has all three marks, although a cell takes missing ones from its left neighbour: that
    neighbour may be under a window of tmux's.
    """
    top = MARKS[image >> 24]
    lines = []
    for row in range(rows):
        line = "".join(PLACEHOLDER + MARKS[row] + MARKS[column] + top for column in range(columns))
        lines.append(b"\x1b[%d;1H" % (row + 1) + line.encode())
    return b"\x1b[38;5;%dm" % (image & 0xFF) + b"".join(lines) + b"\x1b[m"
