"""Pictures among text: what is asked leaves no trace, lines stand alone, nothing scrolls midway."""

from __future__ import annotations

import os
import re
import signal
import threading

import numpy as np
import pytest
from fakes import FakeTerminal

from tests.presenters.pictures import frame_of, photo
from tsplat.presenters.base import Terminal
from tsplat.presenters.halfblock import HALFBLOCK
from tsplat.presenters.iterm2 import ITERM2
from tsplat.presenters.kitty import KITTY
from tsplat.presenters.sixel import SIXEL
from tsplat.terminal import device
from tsplat.terminal.answers import KITTY_QUESTION, QUESTIONS
from tsplat.terminal.inline import SPARE_ROWS, asked_here, placed, show, text_lines
from tsplat.testing.decoders import halfblock, kitty, kitty_commands

ENVIRON = {"TERM": "xterm"}
PICTURE = photo(37, 22)


def drawn(colors=1 << 24, picture=PICTURE):
    """A half-block picture's bytes and its terminal."""
    height, width = picture.shape[:2]
    terminal = Terminal(columns=width, rows=height // 2 + 1, colors=colors)
    return HALFBLOCK.encode(frame_of(picture), terminal, None), terminal


# --- asking


def test_asking_stays_on_the_main_screen():
    """The viewer's questions between a saved and a restored cursor; the tty's mode is back."""
    with FakeTerminal(extra=b"\x1b_Gi=31;OK\x1b\\") as terminal:
        with asked_here(terminal.fd, terminal.fd, ENVIRON) as facts:
            assert (facts.kitty, facts.sixel, facts.columns, facts.rows) == (True, True, 80, 24)
            assert terminal.mode() == terminal.saved
        terminal.settle()
        begin, end = b"\x1b7" + KITTY_QUESTION, QUESTIONS + b"\x1b[c\x1b8\x1b[J"
        assert terminal.output.startswith(begin)
        assert terminal.output.endswith(end)
        assert terminal.mode() == terminal.saved


def test_no_answer_means_no_pictures():
    """After the time given; an answer that is late does not stay for a shell to read."""
    with FakeTerminal(delay=None) as terminal:
        terminal.type(b"\x1b]1337;Report")
        with asked_here(terminal.fd, terminal.fd, ENVIRON, seconds=0.1) as facts:
            assert (facts.tty, facts.kitty, facts.sixel) == (True, False, False)
            terminal.type(b"\x1b[?62;4c")
        nothing_left(terminal, b"62;4")


def nothing_left(terminal, late):
    """The mode is back, there is nothing to read, and what was ``late`` was not echoed."""
    assert terminal.mode() == terminal.saved
    os.set_blocking(terminal.fd, False)
    with pytest.raises(BlockingIOError):
        os.read(terminal.fd, 99)
    terminal.settle()
    assert late not in terminal.output


@pytest.mark.parametrize("wait", [0.0, 0.4])
def test_what_tmux_owes_is_waited_for(wait, monkeypatch):
    """An answer from past tmux that comes during the picture, or after it, is nobody's."""
    environ = {"TERM": "tmux-256color", "TMUX": "/tmp/x"}
    monkeypatch.setattr(device, "ask_tmux", lambda environ: device.Tmux(passes=True))
    late = b"\x1b_Gi=31;OK\x1b\\\x1b[?62;52;c"
    with FakeTerminal(extra=b"\x1bP>|tmux 3.3a\x1b\\", da1=b"\x1b[?1;2c") as terminal:
        timer = threading.Timer(wait, terminal.type, [late])
        with asked_here(terminal.fd, terminal.fd, environ, seconds=0.1) as facts:
            assert not facts.kitty
            timer.start()
            timer.join(0.0 if wait else None)
            assert timer.is_alive() is bool(wait)
        timer.join()
        nothing_left(terminal, b"62;52")


def test_what_tmux_keeps_back_is_not_waited_for(monkeypatch):
    """Where it says that it lets nothing through it is asked nothing that it would not answer."""
    environ = {"TERM": "tmux-256color", "TMUX": "/tmp/x"}
    monkeypatch.setattr(device, "ask_tmux", lambda environ: device.Tmux(passes=False))
    with FakeTerminal(extra=b"\x1bP>|tmux 3.3a\x1b\\", da1=b"\x1b[?1;2c") as terminal:
        with asked_here(terminal.fd, terminal.fd, environ) as facts:
            assert "allow-passthrough" in facts.advice
        assert b"\x1bPtmux;" not in terminal.output


def test_ctrl_c_while_asking_is_heard():
    """In raw mode it is a byte like others; it interrupts all the same, the mode restored."""
    with FakeTerminal(extra=b"\x03") as terminal:
        with pytest.raises(KeyboardInterrupt), asked_here(terminal.fd, terminal.fd, ENVIRON):
            pass
        assert terminal.mode() == terminal.saved


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_while_asking_waits_for_the_mode(signum):
    """A deadly signal in the middle of the questions ends the process, the tty's mode restored."""
    code = (
        "import os; from tsplat.terminal.inline import asked_here; "
        "asked_here(0, 1, os.environ).__enter__()"
    )
    with FakeTerminal(delay=None) as terminal:
        process = terminal.spawn(code)
        terminal.wait_for(QUESTIONS)
        raw = terminal.mode()
        process.send_signal(signum)
        process.wait(20)
        process.stderr.close()
        assert raw != terminal.saved
        assert terminal.mode() == terminal.saved
        assert process.returncode == -signum


def test_what_is_no_terminal_is_not_asked():
    """A dumb one gets no byte."""
    with FakeTerminal() as terminal:
        with asked_here(terminal.fd, terminal.fd, {"TERM": "dumb"}) as facts:
            assert facts.tty is False
        terminal.settle()
        assert terminal.output == b""


# --- text


@pytest.mark.parametrize("colors", [1 << 24, 256, 16, 2])
def test_lines_show_the_picture(colors):
    """Each at its row, they are the presenter's picture."""
    payload, terminal = drawn(colors)
    lines = text_lines(payload)
    assert len(lines) == len(PICTURE) // 2
    moved = b"".join(b"\x1b[%d;1H" % (i + 1) + line for i, line in enumerate(lines))
    np.testing.assert_array_equal(halfblock(moved, terminal), halfblock(payload, terminal))


@pytest.mark.parametrize("colors", [1 << 24, 256, 16])
def test_a_line_alone_is_its_row(colors):
    """No line needs the colours of the one before, and none leaves its own to the next."""
    flat = PICTURE.copy()
    flat[4:8] = flat[4, 0]  # rows that continue in the colour before
    payload, terminal = drawn(colors, flat)
    whole = halfblock(payload, terminal)
    for i, line in enumerate(text_lines(payload)):
        assert line.endswith(b"\x1b[m")
        assert b"\x1b[m" not in line[:-3]
        alone = halfblock(line, Terminal(terminal.columns, 2))
        np.testing.assert_array_equal(alone, whole[2 * i : 2 * i + 2])
    parts = re.split(rb"\x1b\[[0-9;]*H|\r\n", payload)
    cut = halfblock(parts[3], Terminal(terminal.columns, 2))
    assert (cut != whole[6:8]).any()  # the presenter's own third row is another one


def test_line_feeds_gaps_and_attributes():
    """CR LF begins a row; a column is reached by CUF; bold goes on into the next row."""
    lines = text_lines(b"\x1b[1;31mab\r\ncd\x1b[39me\x1b[4;3Hf\x1b[48;5;7m\x1b[0;38;2;1;2;3mg")
    assert lines == [
        b"\x1b[1;31mab\x1b[m", b"\x1b[1;31mcd\x1b[39me\x1b[m", b"",
        b"\x1b[1m\x1b[2Cf\x1b[48;5;7m\x1b[0;38;2;1;2;3mg\x1b[m",
    ]  # fmt: skip
    assert text_lines(b"ab\ncd") == [b"ab", b"cd"]


@pytest.mark.parametrize("presenter", [KITTY, ITERM2, SIXEL], ids=lambda p: p.name)
def test_pictures_are_no_lines(presenter):
    """Graphics cannot be taken apart by rows."""
    terminal = Terminal(kitty=True, iterm2=True, sixel=True)
    assert text_lines(presenter.encode(frame_of(PICTURE), terminal, None)) is None
    assert text_lines(b"ab\x1b[2Jcd") is None


# --- pictures


class Cursor:
    """Where the cursor is on a screen of some rows, and how often that has scrolled."""

    def __init__(self, rows, row):
        self.rows, self.row, self.column, self.scrolled = rows, row, 5, 0
        self.saved = None
        self.drawn = None  # (row, column, scrolled) where the picture was drawn

    def feed(self, data, leaves_below):
        """The picture, "P", leaves the cursor ``leaves_below`` rows below its first row."""
        for part in re.finditer(rb"\x1b\[(\d*)([ABm])|\x1b([78])|(\r)|(\n)|(P)", data):
            count, letter, save, cr, lf, picture = part.groups()
            if letter == b"A":
                self.row = max(0, self.row - int(count))
            elif letter == b"B":
                self.row = min(self.rows - 1, self.row + int(count))
            elif save == b"7":
                self.saved = self.row, self.column
            elif save == b"8":
                self.row, self.column = self.saved
            elif cr:
                self.column = 0
            elif lf:
                self.down(1)
            elif picture:
                self.drawn = self.row, self.column, self.scrolled
                self.down(leaves_below)

    def down(self, count):
        for _ in range(count):
            self.scrolled += self.row == self.rows - 1
            self.row = min(self.row + 1, self.rows - 1)


@pytest.mark.parametrize("row", [0, 5, 17, 23])
@pytest.mark.parametrize("below", [0, 1, 2], ids="rows {}".format)
def test_nothing_scrolls_while_a_picture_is_drawn(row, below):
    """Wherever the cursor begins and wherever a picture leaves it, the text goes on right below."""
    rows = 9
    data = placed(b"P", rows)
    cursor = Cursor(24, row)
    cursor.feed(data, rows - 1 + below)
    top, column, scrolled = cursor.drawn
    assert column == cursor.column == 0
    assert cursor.scrolled == scrolled
    assert cursor.row == top + rows
    assert top == row - scrolled  # it begins in the line where the cursor was
    assert top + rows + SPARE_ROWS <= 24


def test_the_model_sees_what_scrolls():
    """Without rows made first, a picture at the bottom moves what is there."""
    cursor = Cursor(24, 20)
    cursor.feed(b"\x1b7P\x1b8\x1b[9B", 9)
    assert cursor.scrolled > cursor.drawn[2]


def test_kittys_still_pictures_do_not_replace_each_other():
    """Without an id a second one leaves the first; each is the frame, the cursor left alone."""
    data = KITTY.still(frame_of(PICTURE), Terminal(kitty=True))
    ((keys, _),) = kitty_commands(data, faults := [])
    assert not {"i", "p"} & set(keys)
    assert (keys["C"], keys["q"], faults) == ("1", "2", [])
    terminal = Terminal(columns=80, rows=24, kitty=True)
    np.testing.assert_array_equal(kitty(data, terminal).picture, PICTURE)
    again = KITTY.encode(frame_of(PICTURE), Terminal(kitty=True), None)
    assert "i" in kitty_commands(again, [])[0][0]


def test_a_picture_cut_short_is_ended(monkeypatch):
    """Interrupted in the middle, the terminal is told so: what follows is text again."""
    from tsplat.terminal import inline

    real, calls = inline.write_all, []

    def some(fd, data, seconds=None):
        calls.append(data)
        if len(calls) == 1:
            real(fd, data[:20])
            raise KeyboardInterrupt
        return real(fd, data, seconds)

    monkeypatch.setattr(inline, "write_all", some)
    with FakeTerminal() as terminal:
        with pytest.raises(KeyboardInterrupt):
            show(terminal.fd, b"\x1bP0;1;0q" + b"~" * 500 + b"\x1b\\")
        terminal.settle()
        assert terminal.output == b"\x1bP0;1;0q" + b"~" * 12 + b"\x1b\\\x1b[m\r\r\n"
