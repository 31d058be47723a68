"""Words on the screen: the status line and the help page, as bytes for a terminal."""

from __future__ import annotations

import unicodedata

from tsplat.core.errors import printable
from tsplat.presenters.base import Terminal
from tsplat.viewer.controls import HELP

PLAIN = b"\x1b[m"
REVERSE = b"\x1b[7m"  # SGR 7: seen in any colours, and in none
CLEAR_LINE = b"\x1b[K"
CLEAR_SCREEN = b"\x1b[2J\x1b[H"


def _cup(row: int, column: int = 1) -> bytes:
    """CUP: the cursor to a cell, counted from 1."""
    return b"\x1b[%d;%dH" % (row, column)


def fitted(text: str, cells: int) -> str:
    """``text``, printable, cut to at most ``cells`` columns; wide characters take two."""
    out, used = "", 0
    for character in printable(text, 4 * cells + 1):
        wide = 2 if unicodedata.east_asian_width(character) in "WF" else 1
        if used + wide > cells:
            break
        out, used = out + character, used + wide
    return out


def status_line(text: str, terminal: Terminal, alarm: bool = False) -> bytes:
    """``text`` on the last row, which presenters leave alone; the cursor cannot wrap.

    That there is advice about the terminal is said first; the help page has it.
    """
    if text and terminal.advice:
        text = f"no pictures in {terminal.multiplexer}: ?  {text}"
    shown = fitted(text, terminal.columns - 1).encode()
    if alarm:
        shown = REVERSE + shown + PLAIN
    return PLAIN + _cup(terminal.rows) + shown + CLEAR_LINE


def help_page(terminal: Terminal) -> bytes:
    """The keys, on a cleared screen; as much as fits."""
    advice = ["", terminal.advice] if terminal.advice else []
    lines = ["tsplat", "", *HELP.splitlines(), *advice][: terminal.rows - 1]
    top = max(0, (terminal.rows - len(lines)) // 2)
    left = max(0, (terminal.columns - max(map(len, lines))) // 2)
    rows = [
        _cup(top + i + 1, left + 1) + fitted(line, terminal.columns - left).encode()
        for i, line in enumerate(lines)
    ]
    return PLAIN + CLEAR_SCREEN + b"".join(rows)
