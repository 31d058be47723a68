"""The viewer in a pseudo-terminal, for tests to type into and read from."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

from tests.conftest import ROOT, hear_signals

COLUMNS, ROWS = 60, 20
LEAVE = b"\x1b[?1049l"
CELL = "▀".encode()  # in most pictures; of few pixels, whole cells may do
COLOR = b"48;2;"  # SGR: of a cell, in any picture
DSR = b"\x1b[5n"


def parent_of(pid):
    """The process that started ``pid``; None if that is gone, or dead and not yet buried."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in "ZX" else int(fields[1])


class Session:
    """The program on a pty whose other end answers as a plain 24-bit terminal would."""

    da1 = b"\x1b[?62;22c"
    size = ROWS, COLUMNS, 0, 0  # and px

    def __init__(
        self, *words, python=sys.executable, code=("-m", "tsplat", "view"), size=None, cwd=ROOT,
        path=(),
    ):  # fmt: skip
        self.size = size or self.size
        self.master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("4H", *self.size))
        self.before = termios.tcgetattr(slave)
        self.slave = slave
        environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
        places = [*map(str, path), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment["PYTHONPATH"] = os.pathsep.join(places)
        self.process = subprocess.Popen(
            [python, *code, *words], stdin=slave, stdout=slave,
            stderr=subprocess.PIPE, cwd=cwd, env=environment, start_new_session=True,
            preexec_fn=hear_signals,  # noqa: PLW1509 - no threads here
        )  # fmt: skip
        self.output = b""
        self.answered = 0

    def pump(self, done, seconds=30.0):
        """Reads and answers until ``done()``."""
        deadline = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < deadline, self.output[-400:]
            if select.select([self.master], [], [], 0.05)[0]:
                try:
                    self.output += self.read()
                except OSError:
                    break
            for question in re.finditer(rb"\x1b\[5n|\x1b\[c", self.output[self.answered :]):
                os.write(self.master, b"\x1b[0n" if question[0] == DSR else self.da1)
            self.answered = max(self.output.rfind(DSR), self.output.rfind(b"\x1b[c")) + 1

    def read(self):
        """What the terminal takes at a time."""
        return os.read(self.master, 65536)

    def listen(self, seconds):
        """Reads and answers for so long."""
        end = time.monotonic() + seconds
        self.pump(lambda: time.monotonic() >= end, seconds + 30)

    def cpu_seconds(self):
        """Processor time of all the viewer's threads so far."""
        stat = Path(f"/proc/{self.process.pid}/stat").read_text()
        fields = stat.rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def frames(self):
        """Pictures asked to be acknowledged so far."""
        return self.output.count(DSR)

    def press(self, keys):
        """Types."""
        os.write(self.master, keys)

    def send(self, keys):
        """Types, and waits for the next frame."""
        frames = self.frames()
        self.press(keys)
        self.pump(lambda: self.frames() > frames)

    def wait_for(self, words, since=0):
        """Until ``words`` were written, at ``since`` bytes of output or later."""
        self.pump(lambda: words in self.output[since:])

    def rest(self, seconds=0.3):
        """Until nothing was written for so long."""
        seen = [-1, 0.0]

        def quiet():
            if len(self.output) != seen[0]:
                seen[:] = len(self.output), time.monotonic()
            return time.monotonic() > seen[1] + seconds

        self.pump(quiet)

    def end(self, code):
        """Waits for the exit; its code and that the terminal is as it was. What stderr says."""
        self.pump(lambda: self.process.poll() is not None)
        self.pump(lambda: not select.select([self.master], [], [], 0.1)[0])
        error = self.process.stderr.read()
        assert self.process.returncode == code, error
        assert b"Traceback" not in error
        assert termios.tcgetattr(self.slave) == self.before
        tail = self.output[self.output.rindex(LEAVE) - 120 :]
        for undo in (b"\x1b[?2026l", b"\x1b[?1002l", b"\x1b[?25h", LEAVE):
            assert undo in tail, undo
        return error

    def children(self):
        """Processes that the viewer has started and that are there."""
        pids = [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]
        return [pid for pid in pids if parent_of(pid) == self.process.pid]

    def close(self):
        """Leaves nothing behind, however the test went."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.process.stderr.close()
        os.close(self.master)
        os.close(self.slave)
