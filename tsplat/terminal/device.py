"""Bytes to and from a tty, and the probe: what kind of terminal is at the other end."""

from __future__ import annotations

import contextlib
import os
import select
import struct
import termios
import time
import tty
from collections.abc import Iterator, Mapping
from typing import Any

from tsplat.presenters.base import Terminal
from tsplat.terminal.answers import (
    DA1,
    DA1_ANSWER,
    QUESTIONS,
    Winsize,
    parse_answers,
    split_answers,
)
from tsplat.terminal.sharing import Sharing

PROBE_SECONDS = 0.15
ENTER_ALTERNATE = b"\x1b[?1049h"
LEAVE_ALTERNATE = b"\x1b[?1049l"
READ_SIZE = 1 << 16

Attributes = list[Any]  # what termios.tcgetattr returns


def can_show(fd_in: int, fd_out: int, environ: Mapping[str, str]) -> bool:
    """Whether escape sequences may be sent at all: two ttys and a TERM that is not dumb."""
    try:
        ttys = os.isatty(fd_in) and os.isatty(fd_out)
    except OSError:
        return False
    return ttys and environ.get("TERM", "") not in ("", "dumb")


def window_size(fd: int) -> Winsize:
    """Rows, columns and px of the tty (ioctl TIOCGWINSZ); zeros for what it does not know."""
    import fcntl

    try:
        answer = fcntl.ioctl(fd, termios.TIOCGWINSZ, bytes(8))
    except OSError:
        return 0, 0, 0, 0
    rows, columns, xpixel, ypixel = struct.unpack("4H", answer)
    return rows, columns, xpixel, ypixel


def set_raw(fd: int) -> None:
    """Raw mode from now on; what was typed ahead stays readable."""
    tty.setraw(fd, termios.TCSADRAIN)


def set_attributes(fd: int, saved: Attributes) -> None:
    """``saved`` again, and unread input (late answers, a key held down) thrown away.

    This is TCSAFLUSH without its wait for the output to drain, which would never end on a
    terminal that stopped reading.
    """
    with contextlib.suppress(termios.error):
        termios.tcflush(fd, termios.TCIFLUSH)
        termios.tcsetattr(fd, termios.TCSANOW, saved)


def write_all(fd: int, data: bytes, seconds: float | None = None) -> bool:
    """Writes ``data``, in as many parts as the tty wants; a full non-blocking tty is waited for.

    With ``seconds`` it gives up then, and says so by False.

    Raises:
        OSError: the terminal is gone.
    """
    rest = memoryview(data)
    end = None if seconds is None else time.monotonic() + seconds
    while rest:
        if end is not None:
            left = max(0.0, end - time.monotonic())
            if not select.select([], [fd], [], left)[1]:
                return False
        try:
            rest = rest[os.write(fd, rest) :]
        except InterruptedError:
            continue
        except BlockingIOError:
            select.select([], [fd], [])
    return True


def read_answers(fd: int, seconds: float) -> bytes:
    """All that comes until a DA1 answer is among it, or ``seconds`` have passed."""
    data, end = b"", time.monotonic() + seconds
    while not DA1_ANSWER.search(data):
        left = end - time.monotonic()
        if left <= 0 or not select.select([fd], [], [], left)[0]:
            break
        try:
            got = os.read(fd, READ_SIZE)
        except BlockingIOError:
            continue
        except OSError:
            break
        if not got:
            break
        data += got
    return data


def ask(fd_in: int, fd_out: int, sharing: Sharing, seconds: float) -> bytes:
    """What a raw tty sends back when asked all questions at once, typed keys included."""
    write_all(fd_out, QUESTIONS + sharing.question() + DA1, seconds)
    return read_answers(fd_in, seconds)


def probe(
    fd_in: int, fd_out: int, environ: Mapping[str, str], timeout: float = PROBE_SECONDS
) -> tuple[Terminal, bytes]:
    """The terminal's facts, and what was typed while it was asked.

    Takes ``timeout`` s at most, a round trip as a rule. Happens on the alternate screen, which
    is left again: a terminal that prints a question's text takes it away with the screen. The
    tty's mode is restored. What is not a terminal is not written to.

    Raises:
        OSError: the terminal is gone.
    """
    if not can_show(fd_in, fd_out, environ):
        return Terminal(tty=False), b""
    with raw_mode(fd_in), contextlib.closing(Sharing(environ)) as sharing:
        write_all(fd_out, ENTER_ALTERNATE)
        try:
            data = ask(fd_in, fd_out, sharing, timeout)
        finally:
            write_all(fd_out, LEAVE_ALTERNATE)
    answers, typed = split_answers(data)
    return parse_answers(answers, environ, window_size(fd_out)), typed


@contextlib.contextmanager
def raw_mode(fd: int) -> Iterator[None]:
    """Raw mode for a while, typed keys kept."""
    saved = termios.tcgetattr(fd)
    set_raw(fd)
    try:
        yield
    finally:
        termios.tcsetattr(fd, termios.TCSANOW, saved)
