"""Words on the screen: the status line and the help page, as bytes for a terminal."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence

from tsplat.core.errors import printable
from tsplat.presenters.base import Terminal
from tsplat.terminal.device import PLAIN, cleared
from tsplat.viewer.controls import HELP

BOLD = b"\x1b[1m"
REVERSE = b"\x1b[7m"  # SGR 7: seen in any colours, and in none
CLEAR_LINE = b"\x1b[K"
MORE = "up and down: more"
LONGEST = 1000  # characters that are wrapped
KEYS = 13  # columns of the help page before what the keys do
BESIDE = 20  # columns for that at least


def cup(row: int, column: int = 1) -> bytes:
    """CUP: the cursor to a cell, counted from 1."""
    return b"\x1b[%d;%dH" % (row, column)


def _columns(character: str) -> int:
    """That a printable character takes."""
    if unicodedata.category(character) in ("Mn", "Me"):  # upon the one before it
        return 0
    return 2 if unicodedata.east_asian_width(character) in "WF" else 1


def _plain(text: str) -> bool:
    """Whether each character is known to take a column; most texts are so, and quickly done."""
    return text.isascii() and text.isprintable()


def width(text: str) -> int:
    """Columns that ``text`` takes, when it is made printable."""
    if _plain(text):
        return len(text)
    return sum(map(_columns, printable(text, len(text))))


def fitted(text: str, cells: int) -> str:
    """``text``, printable, cut to at most ``cells`` columns; wide characters take two."""
    if _plain(text):
        return text[:cells]
    out, used = "", 0
    for character in printable(text, 4 * cells + 1):
        used += _columns(character)
        if used > cells:
            break
        out += character
    return out


def padded(text: str, cells: int) -> str:
    """``text``, printable, in exactly ``cells`` columns."""
    shown = fitted(text, cells)
    return shown + " " * (cells - width(shown))


def wrapped(text: str, cells: int) -> list[str]:
    """The words of ``text``, printable, in lines of ``cells`` columns; one line at least."""
    lines = [""]
    for given in printable(text, LONGEST).split():
        word = given
        longer = f"{lines[-1]} {word}" if lines[-1] else word
        if width(longer) <= cells:
            lines[-1] = longer
            continue
        while width(word) > cells:
            part = fitted(word, cells) or word[0]
            lines.append(part)
            word = word[len(part) :]
        lines.append(word)
    return [line for line in lines if line] or [""]


def joined(parts: Sequence[str], cells: int) -> str:
    """As many of ``parts``, the most important first, as fit whole; the first one in any case."""
    out = ""
    for part in filter(None, parts):
        longer = f"{out}  {part}" if out else part
        if out and width(longer) > cells:
            break
        out = longer
    return out


def status_line(parts: Sequence[str], terminal: Terminal, alarm: bool = False) -> bytes:
    """``parts`` on the last row, which presenters leave alone; the cursor cannot wrap.

    That there is advice about the terminal is said first; the help page has it.
    """
    if parts and terminal.advice:
        parts = (f"no pictures in {terminal.multiplexer}: ?", *parts)
    cells = terminal.columns - 1
    shown = fitted(joined(parts, cells), cells).encode()
    if alarm:
        shown = REVERSE + shown + PLAIN
    return PLAIN + cup(terminal.rows) + shown + CLEAR_LINE


def help_lines(terminal: Terminal) -> list[str]:
    """What the help page says, a line a row; below each other what does not fit beside."""
    advice = ["", *wrapped(terminal.advice, terminal.columns)] if terminal.advice else []
    lines = HELP.splitlines()
    if max(map(width, lines)) > terminal.columns:
        lines = [part for line in lines for part in _narrow(line, terminal.columns)]
    return ["tsplat", "", *lines, *advice]


def _narrow(line: str, columns: int) -> list[str]:
    """Keys, and what they do beside them or, where there is no room for that, below."""
    keys, words = line[:KEYS], line[KEYS:]
    if columns - KEYS >= BESIDE:
        first, *more = wrapped(words, columns - KEYS)
        return [keys + first, *(" " * KEYS + part for part in more)]
    return [keys.rstrip(), *(f"  {part}" for part in wrapped(words, max(1, columns - 2)))]


def help_page(terminal: Terminal, top: int = 0) -> bytes:
    """The keys, on a cleared screen, from line ``top`` on; as much as fits."""
    every, room = help_lines(terminal), terminal.picture_rows
    lines = every[top : top + room]
    above = max(0, (room - len(lines)) // 2)
    left = max(0, (terminal.columns - max(map(width, every))) // 2)
    rows = [
        cup(above + i + 1, left + 1) + fitted(line, terminal.columns - left).encode()
        for i, line in enumerate(lines)
    ]
    if len(every) > room:
        rows.append(cup(terminal.rows) + fitted(MORE, terminal.columns - 1).encode())
    return cleared(terminal) + b"".join(rows)


def help_top(top: int, terminal: Terminal) -> int:
    """``top``, kept to where the page still ends with its last line."""
    return min(max(top, 0), max(0, len(help_lines(terminal)) - terminal.picture_rows))
