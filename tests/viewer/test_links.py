"""`tsplat view` over slow links, simulated by a terminal that reads little at a time.

Latency is counted in bytes that pass the link between a key and its picture: divided by the link's
rate they are seconds, whatever this machine is busy with.
"""

from __future__ import annotations

import fcntl
import os
import re
import select
import signal
import struct
import termios
import time

import pytest

from tests.viewer.session import CELL, DSR, LEAVE, Session

RATE = 100e3  # bytes/s
PIECE = 1000  # bytes
PICTURE = rb"\x1bP[^\x1b]*\x1b\\"
TTY = 16e3  # bytes that a pty of Linux holds: 8 kB before the line discipline, 4 kB behind, rounded


class SlowSession(Session):
    """A terminal with sixel, 500x340 px, that reads 100 kB/s."""

    da1 = b"\x1b[?62;4;22c"
    size = 18, 50, 500, 360

    def read(self):
        time.sleep(PIECE / RATE)
        return os.read(self.master, PIECE)

    def pictures(self):
        """(width, height as raster attributes have them, bytes) of the pictures so far."""
        return re.findall(rb'\x1bP0;1;0q"1;1;(\d+);(\d+)[^\x1b]*\x1b\\', self.output)


@pytest.fixture
def slow():
    """Its first picture, of few pixels, is there, and 20 kB of the finer one after it."""
    made = SlowSession("--presenter", "sixel", "--max-splats", "3000")
    made.pump(lambda: made.frames() == 1)
    made.pump(lambda: len(made.output) - made.output.rindex(DSR) > 20e3)
    yield made
    made.close()


def test_a_move_does_not_wait_for_the_refined_picture(slow):
    """Half written, the large picture gives way: what the tty holds is all that still comes."""
    frames, before = slow.frames(), len(slow.output)
    slow.press(b"l")
    slow.pump(lambda: slow.frames() >= frames + 2)  # the end of what was begun, and the new one
    passed = len(slow.output) - before
    new = re.findall(PICTURE, slow.output[before:])
    assert passed < TTY + 1.2 * len(new[-1]) + 10e3
    slow.press(b"q")
    slow.end(0)


def test_keys_that_come_faster_than_pictures_are_not_queued(slow):
    """Forty keys, far fewer pictures, and soon after the last key no more but refinements."""
    frames = slow.frames()
    for _ in range(40):
        slow.press(b"j")
        slow.listen(0.02)
    assert slow.frames() - frames < 20
    before = len(slow.output)
    slow.press(b"l")
    frames = slow.frames()
    slow.pump(lambda: slow.frames() >= frames + 3)  # one in the tty, one behind it, the key's own
    assert len(slow.output) - before < TTY + 3 * 60e3
    slow.press(b"q")
    slow.end(0)


def test_quitting_does_not_wait_for_the_picture(slow):
    """Q in the middle of a picture: its end is not sent, and the string that it is in is closed."""
    before = len(slow.output)
    slow.press(b"q")
    slow.end(0)
    rest = slow.output[before:]
    assert len(rest) < TTY + 10e3
    assert b"\x1b\\\x1b[?2026l" in rest[: rest.index(LEAVE)]


def test_max_rate_holds():
    """With 80 kbit/s the terminal gets 10 kB/s, however fast it reads; keys get through."""
    session = Session("--presenter", "halfblock", "--max-splats", "300", "--max-rate", "80k")
    session.pump(lambda: session.frames() >= 1 and CELL in session.output)
    begun, before = time.monotonic(), len(session.output)
    for _ in range(15):
        session.press(b"j")
        session.listen(0.1)
    seconds, passed = time.monotonic() - begun, len(session.output) - before
    assert passed <= 10e3 * seconds + 3e3
    assert passed > 1e3
    session.press(b"q")
    session.end(0)
    session.close()


def test_a_resize_in_the_middle_of_a_picture(slow):
    """What was begun is closed; the next pictures are of the new size."""
    fcntl.ioctl(slow.master, termios.TIOCSWINSZ, struct.pack("4H", 12, 40, 400, 240))
    os.killpg(slow.process.pid, signal.SIGWINCH)
    slow.pump(lambda: slow.pictures()[-1] == (b"400", b"216"))
    slow.press(b"q")
    slow.end(0)


class FarSession(Session):
    """A terminal that answers everything late, over a link that takes all bytes at once."""

    late = 0.8  # s; no picture takes so long to make

    def __init__(self, *words, **options):
        self.due = []
        self.together = self.reports = 0
        super().__init__(*words, **options)

    def pump(self, done, seconds=30.0):
        deadline = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < deadline, self.output[-400:]
            if select.select([self.master], [], [], 0.01)[0]:
                try:
                    self.output += self.read()
                except OSError:
                    break
            asked = re.findall(rb"\x1b\[5n|\x1b\[c", self.output)
            for question in asked[self.answered :]:
                self.due.append((time.monotonic() + self.late, question))
            self.answered = len(asked)
            self.together = max(self.together, sum(q == DSR for _, q in self.due))
            while self.due and self.due[0][0] <= time.monotonic():
                question = self.due.pop(0)[1]
                os.write(self.master, b"\x1b[0n" if question == DSR else self.da1)


ONE_AT_A_TIME = """
import sys
from tsplat import cli
from tsplat.terminal.link import Link
Link.far = False
sys.exit(cli.main(["view", "--presenter", "halfblock", "--max-splats", "300"]))
"""


@pytest.mark.parametrize(("code", "more"), [(None, True), (("-c", ONE_AT_A_TIME), False)])
def test_pictures_do_not_wait_for_answers_that_are_far(code, more, monkeypatch):
    """Before one is answered others are sent, though never a heap; not so one at a time."""
    monkeypatch.setenv("SSH_CONNECTION", "192.0.2.1 1 192.0.2.2 22")
    if code is None:
        session = FarSession("--presenter", "halfblock", "--max-splats", "300")
    else:
        session = FarSession(code=code)
    session.pump(lambda: session.frames() >= 1 and not session.due)
    session.together = 0
    for _ in range(60):
        session.press(b"j")
        session.listen(0.05)
    assert (session.together > 1) == more
    assert session.together <= 9
    session.press(b"q")
    session.end(0)
    session.close()


FAILING = """
import sys
from dataclasses import replace
from tsplat.presenters import halfblock
from tsplat import cli, plan

def fail(*_):
    raise {error}

if "{stage}" == "encode":
    halfblock.HALFBLOCK = replace(halfblock.HALFBLOCK, encode=fail)
else:
    plan.Plan.run = fail
sys.exit(cli.main(["view", "--presenter", "halfblock", "--max-splats", "300"]))
"""


@pytest.mark.parametrize(
    ("stage", "error", "told"),
    [
        ("encode", "ValueError('no ink')", b"'halfblock' failed: ValueError: no ink"),
        ("render", "plan.PluginError('no brush')", b"tsplat: no brush"),
    ],
)
def test_an_error_in_a_thread_ends_the_session(stage, error, told):
    """The terminal is given back, and the error is one line."""
    session = Session(code=("-c", FAILING.format(stage=stage, error=error)))
    assert told in session.end(1)
    session.close()
