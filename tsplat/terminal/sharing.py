"""Frames handed to a terminal on the same machine without passing through the tty.

kitty's protocol (https://sw.kovidgoyal.net/kitty/graphics-protocol/#the-transmission-medium) can
name POSIX shared memory (t=s) or a temporary file (t=t) instead of carrying the bytes; the
terminal reads and deletes it. Whether it can is asked with an object of that kind, whose name
nobody can guess: a terminal at the other end of a network does not find it.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import tempfile
import time
from base64 import b64encode
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from tsplat.presenters.base import Buffer, Shared, Terminal

MARK = "tty-graphics-protocol"  # kitty deletes a file only with this in its name
PREFIX = f"{MARK}-tsplat-"
SHARED_MEMORY = Path("/dev/shm")  # where Linux keeps POSIX shared memory
KEPT = 3  # objects the terminal has not taken yet; older ones are given up
STALE_SECONDS = 60.0
PIXEL = bytes(3)  # what the questions hand over
QUESTION_IDS = {"s": 32, "t": 33}


def is_remote(environ: Mapping[str, str]) -> bool:
    """Whether a network is between us and the terminal, by what sshd and mosh leave behind."""
    return any(environ.get(name) for name in ("SSH_CONNECTION", "SSH_TTY", "SSH_CLIENT"))


class Sharing:
    """Objects for the terminal to read. ``close`` removes those it has not taken; use goes on.

    A process that is killed leaves at most ``KEPT``; the next one to start removes them.
    """

    def __init__(self, environ: Mapping[str, str], memory: Path = SHARED_MEMORY) -> None:
        self._folders = {"t": Path(tempfile.gettempdir())}
        if memory.is_dir():
            self._folders["s"] = memory
        self._remote = is_remote(environ)
        self._waiting: deque[Path] = deque()
        self._asked: dict[str, Path] = {}
        self._id = secrets.token_hex(8)
        self._count = 0

    def questions(self) -> list[bytes]:
        """Queries (a=q, nothing is stored), one for each medium that there is; [] over ssh."""
        if self._remote:
            return []
        self.sweep()
        for old in self._asked.values():
            _remove(old)
        queries = []
        for medium, folder in sorted(self._folders.items()):
            if path := self._write(folder, PIXEL):
                self._asked[medium] = path
                keys = b"i=%d,s=1,v=1,a=q,t=%s,f=24" % (QUESTION_IDS[medium], medium.encode())
                queries.append(b"\x1b_G" + keys + b";" + self._name(medium, path) + b"\x1b\\")
        return queries

    def shared_by(self, terminal: Terminal) -> Terminal:
        """``terminal``, which takes what it said it can read. It must have deleted it, too."""
        for medium in "st":
            path = self._asked.get(medium)
            if medium in terminal.media and path is not None and not path.exists():
                return replace(terminal, share=partial(self.put, medium))
        return replace(terminal, share=None)

    def put(self, medium: str, data: Buffer) -> Shared | None:
        """A new object that holds ``data``; None if there is no room."""
        while len(self._waiting) >= KEPT:
            _remove(self._waiting.popleft())
        path = self._write(self._folders[medium], data)
        if path is None:
            return None
        self._waiting.append(path)
        return Shared(medium, self._name(medium, path))

    def close(self) -> None:
        """Removes all that the terminal has not taken."""
        for path in (*self._waiting, *self._asked.values()):
            _remove(path)
        self._waiting.clear()

    def sweep(self) -> None:
        """Removes what killed processes left. A minute old: what is younger may be under way."""
        for folder in self._folders.values():
            with contextlib.suppress(OSError):
                for path in folder.glob(PREFIX + "*"):
                    pid = path.name.removeprefix(PREFIX).partition("-")[0]
                    age = time.time() - path.stat().st_mtime
                    if pid.isdecimal() and age > STALE_SECONDS and not _lives(int(pid)):
                        _remove(path)

    def _write(self, folder: Path, data: Buffer) -> Path | None:
        """By write, not mmap: a full /dev/shm is an error then, not a SIGBUS."""
        self._count += 1
        path = folder / f"{PREFIX}{os.getpid()}-{self._id}-{self._count}"
        try:
            fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        except OSError:
            return None
        try:
            rest = memoryview(data).cast("B")
            while rest:
                rest = rest[os.write(fd, rest) :]
        except OSError:
            _remove(path)
            return None
        except BaseException:  # a signal
            _remove(path)
            raise
        finally:
            os.close(fd)
        return path

    @staticmethod
    def _name(medium: str, path: Path) -> bytes:
        return b64encode(os.fsencode(f"/{path.name}" if medium == "s" else path))


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
