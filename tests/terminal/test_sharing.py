"""Frames that a terminal on the same machine reads from memory, and what is left of them."""

import os
import re
import signal
import time
from base64 import b64decode
from pathlib import Path

import pytest
from fakes import FakeTerminal

from tsplat.presenters.base import Terminal
from tsplat.terminal.sharing import KEPT, PREFIX, QUESTION_IDS, STALE_SECONDS, Sharing

DATA = bytes(range(256)) * 30


@pytest.fixture
def memory(tmp_path, monkeypatch):
    """A folder in place of /dev/shm, and one in place of /tmp."""
    for name in ("shm", "tmp"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    return tmp_path / "shm"


def left(memory):
    """Names of all objects there are."""
    return sorted(p.name for name in ("shm", "tmp") for p in (memory.parent / name).iterdir())


def take(question, memory, media="st"):
    """A terminal that reads ``media``: deletes what is asked about, as kitty does."""
    for medium, name in re.findall(rb",t=([st]),f=24;([^\x1b]*)", question):
        if medium.decode() in media:
            path = b64decode(name).decode()
            (memory / path[1:] if medium == b"s" else memory.parent / "tmp" / path).unlink()


def test_put(memory):
    """The object has the name told, holds the bytes, and nobody else may read it."""
    shared = Sharing({}, memory).put("s", memoryview(DATA))
    name = b64decode(shared.name).decode()
    assert shared.medium == "s"
    assert re.fullmatch(r"/tty-graphics-protocol-[^/]*", name)
    path = memory / name[1:]
    assert path.read_bytes() == DATA
    assert path.stat().st_mode & 0o777 == 0o600


def test_files_have_a_whole_path(memory):
    """A temporary file's name is its path, in the temporary folder and marked as kitty demands."""
    name = b64decode(Sharing({}, memory).put("t", DATA).name).decode()
    assert name.startswith(str(memory.parent / "tmp"))
    assert "tty-graphics-protocol" in name


def test_names_are_never_used_twice(memory):
    """Each frame has a name of its own, however many sessions there are."""
    one, two = Sharing({}, memory), Sharing({}, memory)
    assert len({s.put("s", b"x").name for s in (one, one, two, two)}) == 4


def test_a_terminal_that_takes_nothing_costs_little(memory):
    """At most ``KEPT`` objects wait; close removes them, and use may go on."""
    sharing = Sharing({}, memory)
    for _ in range(10):
        sharing.put("s", DATA)
    assert len(left(memory)) == KEPT
    sharing.close()
    assert left(memory) == []
    sharing.put("s", DATA)
    assert len(left(memory)) == 1


def test_no_room(memory, monkeypatch):
    """A full or missing folder is no error, and leaves nothing half written."""
    sharing = Sharing({}, memory)

    def full(fd, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.write", full)
    assert sharing.put("s", DATA) is None
    assert left(memory) == []
    monkeypatch.undo()
    memory.rmdir()
    assert sharing.put("s", DATA) is None


@pytest.mark.parametrize(
    ("said", "took", "medium"),
    [
        ("st", "st", "s"),
        ("t", "t", "t"),
        ("s", "t", None),  # says OK to what it cannot have seen
        ("st", "t", "t"),
        ("", "st", None),
        ("", "", None),
    ],
)
def test_believed_only_when_taken(memory, said, took, medium):
    """A medium is used if the terminal said OK and the object is gone; shared memory first."""
    sharing = Sharing({}, memory)
    take(b"".join(sharing.questions()), memory, took)
    share = sharing.shared_by(Terminal(media=said)).share
    assert (share(b"x").medium if share else None) == medium


def test_questions(memory):
    """Both are queries of their own id about one pixel that is there; none over ssh."""
    question = b"".join(Sharing({}, memory).questions())
    for medium, number in QUESTION_IDS.items():
        assert b"\x1b_Gi=%d,s=1,v=1,a=q,t=%s,f=24;" % (number, medium.encode()) in question
    assert len(left(memory)) == 2
    assert all(p.stat().st_size == 3 for p in memory.iterdir())
    assert Sharing({"SSH_TTY": "/dev/pts/3"}, memory).questions() == []
    assert len(left(memory)) == 2


def test_what_killed_processes_left_is_swept(memory):
    """The next start removes it: not that of a living process, not what is young, nothing else."""
    dead = os.spawnlp(os.P_WAIT, "true", "true")
    assert dead == 0
    pid = os.posix_spawnp("true", ["true"], os.environ)
    os.waitpid(pid, 0)
    old = time.time() - STALE_SECONDS - 9
    names = {
        f"{PREFIX}{pid}-a-1": (old, False),
        f"{PREFIX}{pid}-a-2": (time.time(), True),
        f"{PREFIX}{os.getpid()}-a-1": (old, True),
        "tty-graphics-protocol-other": (old, True),
        f"{PREFIX}x-a-1": (old, True),
    }
    for name, (age, _) in names.items():
        (memory / name).write_bytes(b"")
        os.utime(memory / name, (age, age))
    Sharing({}, memory).sweep()
    assert left(memory) == sorted(name for name, (_, stays) in names.items() if stays)


SESSION = """
import sys, time
from tsplat.terminal import Screen
with Screen() as screen:
    for _ in range(9):
        screen.write(b"NAME" + screen._sharing.put("s", bytes(9999)).name + b"END")
    screen.write(b"READY")
    {body}
"""


@pytest.mark.parametrize(
    ("body", "signum"),
    [
        ("pass", None),
        ("1 / 0", None),
        ("screen.read_events(None)", signal.SIGTERM),
        ("screen.read_events(None)", signal.SIGHUP),
    ],
    ids=["end", "error", "SIGTERM", "SIGHUP"],
)
def test_nothing_stays_in_shared_memory(body, signum):
    """Of a terminal that took no frame: at the end, after a crash, after a deadly signal."""
    with FakeTerminal() as terminal:
        process = terminal.spawn(SESSION.format(body=body))
        if signum:
            terminal.wait_for(b"READY")
            names = re.findall(rb"NAME(.*?)END", terminal.output)
            there = ["/dev/shm" + b64decode(n).decode() for n in names]
            assert sum(map(os.path.exists, there)) == KEPT
            process.send_signal(signum)
        process.communicate(timeout=20)
        terminal.settle()
        mark = f"{PREFIX}{process.pid}-"
        assert mark.encode() not in terminal.output  # names go as base64
        assert terminal.output.count(b"NAME") == 9
        assert list(Path("/dev/shm").glob(mark + "*")) == []
