"""`tsplat view` in a pseudo-terminal: it draws, obeys keys, and gives the terminal back."""

from __future__ import annotations

import fcntl
import json
import os
import select
import signal
import struct
import termios
import time

import pytest

from tests.viewer.session import CELL, COLOR, Session
from tsplat.core.camera import look_at
from tsplat.io.cameras import camera_to_json


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
        assert COLOR in session.output[before:]
    assert b"demo" in session.output
    session.press(b"q")
    session.end(0)


def test_a_path_is_played_until_a_key_is_pressed(tmp_path):
    """Frames come by themselves; after a key they stop, and keys do what they always do."""
    eyes = ((0, -1, -9), (3, -1, -8), (6, -2, -6), (0, -1, -9))
    cameras = [look_at(eye, (0, 0, 0), (0, -1, 0), 50, 64, 48) for eye in eyes]
    file = tmp_path / "path.json"
    file.write_text(json.dumps([camera_to_json(camera) for camera in cameras]))
    made = Session("--presenter", "halfblock", "--max-splats", "1000", "--play", str(file))
    try:
        made.pump(lambda: made.frames() >= 4)
        made.press(b"x")
        made.pump(lambda: not select.select([made.master], [], [], 0.3)[0])
        before = made.frames()
        time.sleep(0.3)
        made.pump(lambda: True)
        assert made.frames() == before
        made.send(b"j")
        made.press(b"q")
        made.end(0)
    finally:
        made.close()


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
    assert COLOR in session.output[before:]
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
    line = session.output.split(b"demo")[1][:40]
    session.press(b"q")
    session.end(0)
    session.close()
    first = line.split()[0]
    assert first == words[1].encode() if words else first.replace(b",", b"").isdigit()
