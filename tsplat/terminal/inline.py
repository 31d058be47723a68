"""Pictures among the text of a terminal's main screen, where they scroll away with it.

The cursor is saved and restored by DECSC and DECRC (``ESC 7``, ``ESC 8``):
https://invisible-island.net/xterm/ctlseqs/ctlseqs.html
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import termios
import time
import tty
from collections.abc import Iterator, Mapping

from tsplat.presenters.base import Terminal
from tsplat.terminal.answers import DA1_ANSWER
from tsplat.terminal.device import (
    PLAIN,
    STRING_END,
    ask,
    can_show,
    raw_mode,
    read_answers,
    set_attributes,
    window_size,
    write_all,
)
from tsplat.terminal.sharing import Sharing

ASK_SECONDS = 1.0
"""For all answers: a picture can be drawn in one way only."""

LATE_SECONDS = 4.0
"""For answers that come too late to be of use, by when tmux may be expected to have passed them."""

SPARE_ROWS = 2
"""Free below a picture: a sixel picture leaves the cursor one row below itself, Konsole's two."""

SAVE_CURSOR, RESTORE_CURSOR = b"\x1b7", b"\x1b8"
ERASE_BELOW = b"\x1b[J"
NEW_LINE = b"\r\n"
NUDGE_SECONDS = 0.02

_HELD = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)


@contextlib.contextmanager
def asked_here(
    fd_in: int, fd_out: int, environ: Mapping[str, str], seconds: float = ASK_SECONDS
) -> Iterator[Terminal]:
    """The terminal's facts, asked for without leaving its main screen.

    What it prints of a question that it does not understand is erased again. The tty's mode is
    restored whatever happens: signals wait until then. Of keys typed meanwhile Ctrl-C counts;
    others are lost. Answers that are late are taken in during the ``with`` block, or a shell would
    get them; those that tmux owes are waited for until ``LATE_SECONDS`` after the question.

    Raises:
        KeyboardInterrupt: Ctrl-C was typed.
        OSError: the terminal is gone.
    """
    if not can_show(fd_in, fd_out, environ):
        yield Terminal(tty=False)
        return
    begun = time.monotonic()
    with _signals_held(), raw_mode(fd_in):
        write_all(fd_out, SAVE_CURSOR, seconds)
        sharing = Sharing(environ)
        try:
            heard = ask(fd_in, fd_out, environ, sharing, seconds)
        finally:
            sharing.close()
            write_all(fd_out, RESTORE_CURSOR + ERASE_BELOW, seconds)
    if b"\x03" in heard.typed:
        raise KeyboardInterrupt
    facts = heard.terminal(environ, window_size(fd_out))
    if DA1_ANSWER.search(heard.answers) and not heard.owed:
        yield facts
        return
    saved = termios.tcgetattr(fd_in)
    tty.setcbreak(fd_in, termios.TCSANOW)  # nothing is echoed; Ctrl-C still ends us
    try:
        yield facts
        for _ in range(heard.owed):
            read_answers(fd_in, begun + LATE_SECONDS - time.monotonic())
    finally:
        set_attributes(fd_in, saved)


@contextlib.contextmanager
def _signals_held() -> Iterator[None]:
    """Those that would end or stop the process come later. There must be one thread only."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _HELD)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# --- text

_PART = re.compile(
    rb"\x1b\[(?P<sgr>[0-9;:]*)m|\x1b\[(?P<cup>[0-9;]*)H|\x1b\[(?P<cuf>[0-9]*)C"
    rb"|(?P<line>\r?\n)|(?P<text>[^\x00-\x1f\x7f]+)"
)


def text_lines(payload: bytes) -> list[bytes] | None:
    """A picture of characters as lines that can go anywhere, each in its own colours; else None.

    ``payload`` is what a presenter draws from the top left cell on: characters, SGR, CUP, CUF and
    line feeds. Anything else makes it None.
    """
    lines: list[bytes] = []
    pen: dict[str, bytes] = {}
    row = at = 0
    fresh = True  # nothing was written in this row yet

    def put(data: bytes) -> None:
        nonlocal fresh
        while len(lines) <= row:
            lines.append(b"")
        if fresh:
            lines[row] += _sgr(pen)
            fresh = False
        lines[row] += data

    while at < len(payload):
        part = _PART.match(payload, at)
        if part is None:
            return None
        at = part.end()
        if part["sgr"] is not None:
            _set(pen, part["sgr"])
            if not fresh:
                put(part.group())
        elif part["cup"] is not None:
            y, x = (int(n or 1) for n in [*part["cup"].split(b";"), b"", b""][:2])
            row, fresh = y - 1, True
            if x > 1:
                put(b"\x1b[%dC" % (x - 1))
        elif part["line"] is not None:
            row, fresh = row + 1, True
        else:
            put(part.group())
    return [line if line.endswith(PLAIN) or b"\x1b" not in line else line + PLAIN for line in lines]


def _sgr(pen: Mapping[str, bytes]) -> bytes:
    return b"\x1b[" + b";".join(pen.values()) + b"m" if pen else b""


def _set(pen: dict[str, bytes], parameters: bytes) -> None:
    """What a cell looks like after SGR ``parameters``: foreground, background and the rest."""
    words = parameters.split(b";")
    while words:
        word = words.pop(0)
        number = int(word.partition(b":")[0] or 0)
        taken = [word]
        if number in (38, 48) and b":" not in word and words:
            count = 4 if words[0] == b"2" else 2
            taken, words = [word, *words[:count]], words[count:]
        if number == 0:
            pen.clear()
        elif number in (39, 49):
            pen.pop("fg" if number == 39 else "bg", None)
        elif 30 <= number <= 38 or 90 <= number <= 97:
            pen["fg"] = b";".join(taken)
        elif 40 <= number <= 48 or 100 <= number <= 107:
            pen["bg"] = b";".join(taken)
        else:
            pen[f"rest {number}"] = word


# --- pictures


def placed(payload: bytes, rows: int) -> bytes:
    """A picture of ``rows`` rows at the beginning of the cursor's line; then the line below it.

    Rows are made first, by line feeds that scroll what is there, so that nothing scrolls while the
    picture is drawn and the saved cursor stays right.
    """
    below = rows + SPARE_ROWS
    return b"".join(
        (
            b"\r", b"\n" * below, b"\x1b[%dA" % below, SAVE_CURSOR,
            payload,
            RESTORE_CURSOR, PLAIN, b"\x1b[%dB\r" % rows,
        )
    )  # fmt: skip


def show(fd: int, data: bytes, nudge: bool = False) -> None:
    """Writes ``data``; if that is cut short, what the terminal was in the middle of is ended.

    With ``nudge`` something harmless follows after a moment: kitty 0.48 shows a window's first
    picture only then.

    Raises:
        OSError: the terminal is gone.
    """
    try:
        write_all(fd, data)
    except BaseException:
        with contextlib.suppress(OSError):
            write_all(fd, STRING_END + PLAIN + NEW_LINE, NUDGE_SECONDS)
        raise
    if nudge:
        time.sleep(NUDGE_SECONDS)
        write_all(fd, PLAIN)


def open_input() -> int | None:
    """A descriptor to read a terminal's answers from: standard input, or /dev/tty beside it."""
    if os.isatty(0):
        return 0
    with contextlib.suppress(OSError):
        return os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY)
    return None
