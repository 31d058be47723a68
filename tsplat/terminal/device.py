"""Bytes to and from a tty, and the probe: what kind of terminal is at the other end."""

from __future__ import annotations

import contextlib
import os
import select
import struct
import termios
import time
import tty
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from tsplat.presenters.base import Terminal
from tsplat.presenters.placeholders import through_tmux
from tsplat.terminal.answers import (
    DA1,
    DA1_ANSWER,
    KITTY_QUESTION,
    QUESTIONS,
    XTVERSION,
    Winsize,
    holds_answer,
    multiplexer,
    name_in,
    parse_answers,
    split_answers,
)
from tsplat.terminal.sharing import Sharing, is_remote

PROBE_SECONDS = 0.15  # for the first answer, on this machine
REMOTE_SECONDS = 1.5  # for the first answer over a network
ANSWERING_SECONDS = 2.0  # for the last answer, once there is a first
TMUX_SECONDS = 1.0  # for what tmux itself is asked by its command
ATTACH_SECONDS = 3.0  # for tmux to show a new session in its terminal
ATTACH_GAP = 0.05  # s between two looks at that
ENTER_ALTERNATE = b"\x1b[?1049h"
LEAVE_ALTERNATE = b"\x1b[?1049l"
STRING_END = b"\x1b\\"  # ST
PLAIN = b"\x1b[m"  # SGR 0
CLEAR = PLAIN + b"\x1b[2J\x1b[H"
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
            if end is None:
                select.select([], [fd], [])
    return True


def cleared(terminal: Terminal) -> bytes:
    """What leaves nothing on the screen, kitty's pictures included; the cursor at its top left."""
    return scrolled_out(terminal) + CLEAR


def scrolled_out(terminal: Terminal) -> bytes:
    """What takes sixel pictures off the screen of an xterm; b"" for others.

    xterm (379 and 412) keeps those that are covered or erased, and goes through their px for
    each character that it writes: 0.2 to 0.5 s a screenful. It passes by what has left the screen.
    """
    keeps = terminal.sixel and terminal.name.startswith("XTerm(")
    return b"\x1b[%dS" % terminal.rows if keeps else b""  # SU


def open_patient(fd: int) -> int | None:
    """The tty of ``fd`` opened anew, so that writes to it never block; None if it cannot be.

    O_NONBLOCK on ``fd`` itself would be everybody's who has the tty from the same shell, and
    would stay when we are killed.
    """
    try:
        new = os.open(os.ttyname(fd), os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return None
    if os.fstat(new).st_rdev != os.fstat(fd).st_rdev:  # a name of another /dev/pts
        os.close(new)
        return None
    return new


def write_some(fd: int, data: memoryview) -> int:
    """How much of ``data`` the tty took; 0 if it takes nothing just now.

    Raises:
        OSError: the terminal is gone.
    """
    taken = 0
    with contextlib.suppress(BlockingIOError, InterruptedError):
        while taken < len(data):
            taken += os.write(fd, data[taken:])
    return taken


def patience(environ: Mapping[str, str]) -> float:
    """How long a terminal may take to begin to answer, in s. What never does costs that."""
    return REMOTE_SECONDS if is_remote(environ) else PROBE_SECONDS


def read_answers(fd: int, seconds: float) -> bytes:
    """All that comes until a DA1 answer is among it.

    Gives up if no answer has begun after ``seconds``, else after ``ANSWERING_SECONDS``: over a slow
    link one answer may come long after another.
    """
    data, begun = b"", time.monotonic()
    end = begun + seconds
    while not DA1_ANSWER.search(data):
        if holds_answer(data):
            end = max(end, begun + ANSWERING_SECONDS)
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


@dataclass(frozen=True)
class Heard:
    """What came back when a terminal was asked."""

    answers: bytes
    typed: bytes = b""  # keys pressed meanwhile
    around: bytes = b""  # what the terminal around tmux said
    features: str = ""  # what tmux believes of it
    owed: int = 0  # answers to DA1 that have not come, though tmux lets that through
    asked: int = 0  # bytes of the questions

    def terminal(self, environ: Mapping[str, str], winsize: Winsize) -> Terminal:
        """The facts in it."""
        return parse_answers(self.answers, environ, winsize, self.around, self.features)


def ask(
    fd_in: int, fd_out: int, environ: Mapping[str, str], sharing: Sharing, seconds: float
) -> Heard:
    """What a raw tty sends back when asked all questions at once.

    Where the environment tells of a multiplexer, kitty's questions wait for the answer: tmux
    would take them for a title. Inside tmux the terminal around it is asked, past tmux; its answers
    are typed into this pane. Where tmux lets nothing through and does not say so, that costs
    ``seconds`` once more. The first program of a new session is quicker than tmux, which shows it
    in a terminal only later: that is waited for.
    """

    def exchange(questions: Iterable[bytes]) -> None:
        asked.append(b"".join(questions))
        write_all(fd_out, asked[-1], seconds)
        found, keys = split_answers(read_answers(fd_in, seconds))
        answers.append(found)
        typed.append(keys)

    asked: list[bytes] = []
    answers: list[bytes] = []
    typed: list[bytes] = []
    if not multiplexer("", environ):
        exchange((KITTY_QUESTION, *sharing.questions(), QUESTIONS, DA1))
    else:
        exchange((QUESTIONS, DA1))
    mux = multiplexer(name_in(answers[0]), environ)
    if mux == "tmux":
        through = KITTY_QUESTION, *sharing.questions(), XTVERSION, DA1
        begun = time.monotonic()
        first = now = ask_tmux(environ)
        while not now.attached and time.monotonic() < begun + ATTACH_SECONDS:
            time.sleep(ATTACH_GAP)
            now = ask_tmux(environ)
        if now.attached and now.passes is not False:
            exchange(map(through_tmux, through))
            if not first.attached and not DA1_ANSWER.search(answers[-1]):  # its first moments
                exchange(map(through_tmux, through))
        around = b"".join(answers[1:])
        late = sum(DA1_ANSWER.search(found) is None for found in answers)
        owed, size = late if now.passes else 0, sum(map(len, asked))
        return Heard(answers[0], b"".join(typed), around, now.features, owed, size)
    if not mux and multiplexer("", environ):  # a window that was opened from inside one
        exchange((KITTY_QUESTION, *sharing.questions(), DA1))
    return Heard(b"".join(answers), b"".join(typed), asked=sum(map(len, asked)))


@dataclass(frozen=True)
class Tmux:
    """What tmux says of our session; as it stands here where it cannot be asked."""

    attached: bool = True  # to a terminal
    passes: bool | None = None  # whether it lets questions through to that
    features: str = ""  # what it believes of it: "256,RGB,sixel,title" or so


def ask_tmux(environ: Mapping[str, str]) -> Tmux:
    """By its own command, which knows more than a tmux on another machine could tell."""
    if not environ.get("TMUX"):
        return Tmux()
    import subprocess

    facts = "#{session_attached},#{allow-passthrough},#{client_termfeatures}"
    try:
        said = subprocess.run(
            ("tmux", "display-message", "-p", facts), env=dict(environ), stdin=subprocess.DEVNULL,
            capture_output=True, text=True, timeout=TMUX_SECONDS, check=True,
        )  # fmt: skip
    except (OSError, ValueError, subprocess.SubprocessError):
        return Tmux()
    attached, passes, features = (said.stdout.strip() + ",,").split(",", 2)
    known = passes not in ("", "0", "off")  # 3.3: 0 or 1; later: off, on or all
    return Tmux(attached != "0", known if passes else None, features.rstrip(","))


def probe(
    fd_in: int, fd_out: int, environ: Mapping[str, str], timeout: float | None = None
) -> tuple[Terminal, bytes]:
    """The terminal's facts, and what was typed while it was asked. See :func:`hear`.

    Raises:
        OSError: the terminal is gone.
    """
    heard = hear(fd_in, fd_out, environ, timeout)
    if heard is None:
        return Terminal(tty=False), b""
    return heard.terminal(environ, window_size(fd_out)), heard.typed


def hear(
    fd_in: int, fd_out: int, environ: Mapping[str, str], timeout: float | None = None
) -> Heard | None:
    """Asks a terminal that is not in use; None, and nothing is written, if it is none.

    Takes a round trip as a rule; ``timeout`` s (None: see :func:`patience`) if nothing is answered.
    Happens on the alternate screen, which is left again: a terminal that prints a question's text
    takes it away with the screen. The tty's mode is restored.

    Raises:
        OSError: the terminal is gone.
    """
    if not can_show(fd_in, fd_out, environ):
        return None
    with raw_mode(fd_in), contextlib.closing(Sharing(environ)) as sharing:
        write_all(fd_out, ENTER_ALTERNATE)
        try:
            seconds = patience(environ) if timeout is None else timeout
            return ask(fd_in, fd_out, environ, sharing, seconds)
        finally:
            write_all(fd_out, LEAVE_ALTERNATE)


@contextlib.contextmanager
def raw_mode(fd: int) -> Iterator[None]:
    """Raw mode for a while, typed keys kept."""
    saved = termios.tcgetattr(fd)
    set_raw(fd)
    try:
        yield
    finally:
        termios.tcsetattr(fd, termios.TCSANOW, saved)
