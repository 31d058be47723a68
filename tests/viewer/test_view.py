"""`tsplat view` in a pseudo-terminal: it draws, obeys keys, and gives the terminal back."""

from __future__ import annotations

import fcntl
import os
import select
import signal
import struct
import termios
import time

import pytest

from tests.viewer.session import CELL, Session


@pytest.fixture
def session():
    """The viewer on the demo scene, its first frame shown."""
    made = Session("--presenter", "halfblock", "--max-splats", "1000")
    made.pump(lambda: made.frames() >= 1 and CELL in made.output)
    yield made
    made.close()


def test_keys_move_the_camera_and_q_gives_the_terminal_back(session):
    """Each key draws a new picture; Q leaves with code 0 and every mode undone."""
    for key in (b"j", b"\x1b[A", b"+", b"u"):
        before = len(session.output)
        session.send(key)
        assert CELL in session.output[before:]
    assert b"demo" in session.output
    session.press(b"q")
    session.end(0)


def test_nothing_is_written_while_nothing_changes(session):
    """An idle view is silent, and rests: its threads take no processor time worth counting."""
    time.sleep(0.3)
    session.pump(lambda: not select.select([session.master], [], [], 0.1)[0])
    before, spent = session.output, session.cpu_seconds()
    time.sleep(0.5)
    assert session.cpu_seconds() - spent <= 0.05  # a thread that spins takes ten times as long
    assert not select.select([session.master], [], [], 0)[0]
    assert session.output == before
    session.press(b"q")
    session.end(0)


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_signals_give_the_terminal_back(session, signum):
    """A deadly signal ends with 128 + its number, the terminal restored."""
    session.process.send_signal(signum)
    session.end(128 + signum)


def test_ctrl_c_quits(session):
    """Ctrl-C is a key in raw mode, and quits."""
    session.press(b"\x03")
    session.end(0)


def test_a_resize_is_followed(session):
    """After SIGWINCH the status line is on the new last row."""
    fcntl.ioctl(session.master, termios.TIOCSWINSZ, struct.pack("4H", 12, 40, 0, 0))
    os.killpg(session.process.pid, signal.SIGWINCH)
    session.pump(lambda: b"\x1b[12;1H" in session.output)
    session.press(b"q")
    session.end(0)


def test_help_is_shown_and_left(session):
    """? shows the keys on a cleared screen; the next key brings the picture back."""
    session.send(b"?")
    assert b"upside up" in session.output
    before = len(session.output)
    session.send(b" ")
    assert CELL in session.output[before:]
    session.press(b"q")
    session.end(0)


def test_a_scene_that_cannot_be_read_leaves_the_terminal_untouched():
    """The error is one line on stderr; not a byte is written to the screen."""
    made = Session("missing.ply")
    made.pump(lambda: made.process.poll() is not None)
    assert made.process.returncode == 1
    assert made.process.stderr.read() == b"tsplat: missing.ply: no such file\n"
    assert made.output == b""
    made.close()


@pytest.mark.parametrize("words", [(), ("--quality", "fast"), ("--set", "share=0.5")])
def test_the_status_line_names_shortcuts(words):
    """With --quality or --set the picture is another, and the screen says so; else it does not."""
    session = Session("--presenter", "halfblock", "--max-splats", "300", *words)
    session.pump(lambda: session.frames() >= 1 and b" ms cffi" in session.output)
    line = session.output.split(b" ms cffi x")[1][1:12]
    session.press(b"q")
    session.end(0)
    session.close()
    assert line.split()[0] == (words[1].encode() if words else b"halfblock")
