"""A terminal to talk to: the master side of a pty, answered by a thread."""

import contextlib
import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
import threading
import time

from tests.conftest import hear_signals

DA1 = b"\x1b[?62;4;22c"


class FakeTerminal:
    """Notes what is written to it, answers DA1 after ``delay`` s (None: never) and DSR.

    ``fd`` is the slave side. ``extra`` is sent before the DA1 answer.
    """

    def __init__(self, delay=0.0, extra=b"", reports=True, size=(24, 80, 800, 480), da1=DA1):
        self.master, self.fd = pty.openpty()
        self.resize(*size)
        self.saved = termios.tcgetattr(self.fd)
        self.output = b""
        self.delay, self.extra, self.reports, self.da1 = delay, extra, reports, da1
        self.reading = threading.Event()
        self.reading.set()
        self._due = []
        self._stop = False
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def resize(self, rows, columns, xpixel=0, ypixel=0):
        fcntl.ioctl(self.fd, termios.TIOCSWINSZ, struct.pack("4H", rows, columns, xpixel, ypixel))

    def type(self, data):
        os.write(self.master, data)

    def close(self):
        self.reading.set()
        self._stop = True
        self._thread.join()
        for fd in (self.master, self.fd):
            with contextlib.suppress(OSError):
                os.close(fd)

    def hang_up(self):
        """Closes the master: the kernel hangs up on everybody."""
        self._stop = True
        self._thread.join()
        os.close(self.fd)
        os.close(self.master)

    def wait_for(self, text, seconds=5.0):
        """Until ``text`` was written."""
        end = time.monotonic() + seconds
        while text not in self.output:
            assert time.monotonic() < end, f"{text!r} not in {self.output[-200:]!r}"
            time.sleep(0.005)

    def settle(self):
        """Until nothing more is written."""
        size = -1
        while size != len(self.output):
            size = len(self.output)
            time.sleep(0.05)

    def mode(self):
        return termios.tcgetattr(self.fd)

    def _serve(self):
        seen = 0
        while not self._stop:
            self.reading.wait()
            if select.select([self.master], [], [], 0.01)[0]:
                try:
                    self.output += os.read(self.master, 65536)
                except OSError:
                    return
            for at in range(seen, len(self.output)):
                if self.output[at - 1 : at] == b"\x1b":
                    continue  # an ESC doubled for what is around tmux
                if self.output.startswith(b"\x1b[c", at) and self.delay is not None:
                    self._due.append((time.monotonic() + self.delay, self.extra + self.da1))
                if self.output.startswith(b"\x1b[5n", at) and self.reports:
                    self._due.append((0.0, b"\x1b[0n"))
            seen = max(seen, len(self.output) - 2)
            for item in list(self._due):
                if item[0] <= time.monotonic():
                    self._due.remove(item)
                    os.write(self.master, item[1])

    def spawn(self, code):
        """A Python process with this terminal as its controlling one."""

        def take_control():
            hear_signals()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        return subprocess.Popen(
            [sys.executable, "-W", "error", "-c", code],
            stdin=self.fd,
            stdout=self.fd,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=take_control,  # noqa: PLW1509 - one ioctl, before exec
            env={**os.environ, "TERM": "xterm"},
        )
