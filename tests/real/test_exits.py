"""However ``tsplat view`` ends in a real terminal, what was there before is there again.

The tty's modes are compared as ``stty -a`` prints them, the terminal's as it reports them itself
(DECRQM). The screen is photographed, and compared with one where a program that does nothing ended
in the same way: text, colours, prompt and cursor, every pixel.
"""

from __future__ import annotations

import os
import shlex
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.real.desk import (
    KITTY,
    KONSOLE,
    MLTERM,
    PATIENCE,
    XTERM,
    Make,
    Terminal,
    alive,
    await_,
    in_tmux,
)
from tests.real.desk import opened as open_terminal
from tests.real.pictures import psnr

SAME = 20.0  # dB; the text and the picture are 12 apart
TMUX = in_tmux(XTERM)

BREAKING = """
import os
from dataclasses import replace
from tsplat import hookimpl
from tsplat.presenters.{like} import {row}

def encode(frame, terminal, previous):
    if os.path.exists(os.environ["STATE"] + "/fail"):
        raise ValueError("no ink")
    return {row}.encode(frame, terminal, previous)

@hookimpl
def tsplat_presenters():
    return [replace({row}, name="breaking", encode=encode, fill=None, rest=None)]
"""
"""A presenter that fails once there is a file called ``fail``."""


@dataclass(frozen=True)
class Exit:
    """A way to end, what it prints, and the code."""

    name: str
    act: Callable[[Terminal], None]
    code: int
    words: tuple[str, ...] = ()
    says: str = ""

    def __str__(self) -> str:
        return self.name


def typed(*keys: str) -> Callable[[Terminal], None]:
    return lambda terminal: terminal.press(*keys)


def sent(signum: int) -> Callable[[Terminal], None]:
    return lambda terminal: os.kill(terminal.pid(), signum)


def broken(terminal: Terminal) -> None:
    """The presenter fails in the middle of moving pictures; nothing is typed into that."""
    first = terminal.photograph()
    terminal.press("o")
    await_("moves", lambda: (terminal.photograph() != first).any(axis=2).mean() > 0.1)
    (terminal.state / "fail").touch()


EXITS = (
    Exit("q", typed("q"), 0),
    Exit("ctrl-c", typed("ctrl+c"), 0),
    Exit("sigterm", sent(signal.SIGTERM), 128 + signal.SIGTERM),
    Exit("moving", typed("o", "Escape"), 0),
    Exit(
        "a failing plugin", broken, 1, ("--presenter", "breaking"),
        "tsplat: presenter 'breaking' failed: ValueError: no ink; try another with --presenter",
    ),
)  # fmt: skip


def plug_in(terminal: Terminal) -> None:
    """Installs the presenter that fails, made of the terminal's usual one."""
    like = {"kitty": "kitty", "xterm": "sixel"}.get(terminal.make.name, "halfblock")
    (terminal.state / "fail").unlink(missing_ok=True)
    folder = terminal.state.parent
    (folder / "breaking_plugin.py").write_text(BREAKING.format(like=like, row=like.upper()))
    info = folder / "breaking-1.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: breaking\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[tsplat]\nbreaking = breaking_plugin\n")


def shown(terminal: Terminal, before: np.ndarray) -> None:
    """Waits until a picture is on the screen: most of it is another than the text's."""
    await_("a picture", lambda: (terminal.photograph() != before).any(axis=2).mean() > 0.2)


def as_if(terminal: Terminal, script: str, letters: str = "v") -> list[np.ndarray]:
    """The screens after each command, if V's program does nothing but what ``script`` says."""
    if (script, letters) not in terminal.screens:
        terminal.fresh()
        terminal.program(script)
        screens = []
        for letter in letters:
            terminal.type(letter)
            terminal.ready()
            screens.append(terminal.at_rest())
        terminal.screens[script, letters] = screens
    terminal.fresh()
    return terminal.screens[script, letters]


def restored(terminal: Terminal, wanted: np.ndarray, seconds: float = PATIENCE) -> None:
    """The tty and the terminal's modes are as they were, and the screen becomes ``wanted``."""
    assert terminal.changed() == []
    terminal.shows("the screen as it was", wanted, seconds)


@pytest.mark.parametrize(
    ("trace", "fault"),
    [
        ("stty -ixon", "stty"),
        (r"printf '\033[?1000h'", "modes"),
        (r"printf '\033[?25l'", "modes"),
        (r"printf '\033[32m'", "not there"),
        (r"printf '\033[H \033[11H'", "not there"),
    ],
)
def test_traces_are_seen(trace: str, fault: str, terminal) -> None:
    """A mode of the tty or of the terminal, a colour, one letter less: each is found."""
    place = terminal(XTERM)
    (wanted,) = as_if(place, "exit 0")
    place.program(trace)
    place.type("v")
    place.ready()
    with pytest.raises(AssertionError, match=fault):
        restored(place, wanted, seconds=0.5)
    place.program(r"stty sane; printf '\033[?1000l\033[?25h\033[m'")
    place.type("v")
    place.ready()


@pytest.mark.parametrize(
    ("make", "leave"),
    [
        *[(KITTY, leave) for leave in EXITS],
        *[(make, leave) for make in (XTERM, TMUX) for leave in (EXITS[0], EXITS[-1])],
        *[(make, EXITS[0]) for make in (MLTERM, KONSOLE)],
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_exits_restore_the_terminal(make: Make, leave: Exit, terminal) -> None:
    """Code, tty and every pixel of the screen, however it ends."""
    place = terminal(make)
    plug_in(place)
    script = (f"echo {shlex.quote(leave.says)} >&2; " if leave.says else "") + f"exit {leave.code}"
    (wanted,) = as_if(place, script)
    before = place.photograph()
    place.view(*leave.words)
    shown(place, before)
    leave.act(place)
    place.ready()
    assert place.code() == leave.code
    restored(place, wanted)


@pytest.mark.parametrize("make", [KITTY, XTERM, TMUX], ids=lambda make: make.name)
def test_stopped_and_continued(make: Make, terminal) -> None:
    """Ctrl+Z gives the terminal back, fg takes it again and shows the picture, Q leaves."""
    place = terminal(make)
    stopped, ended = as_if(place, "kill -TSTP $$; exit 0", "vf")
    before = place.photograph()
    place.view()
    shown(place, before)
    picture = place.at_rest()
    place.press("ctrl+z")
    place.ready()
    assert place.code() == 128 + signal.SIGTSTP
    restored(place, stopped)
    place.type("f")
    rows = picture.shape[0] - picture.shape[0] // place.cells()[1]  # but the status line's
    await_("the picture again", lambda: psnr(place.photograph()[:rows], picture[:rows]) > SAME)
    place.press("q")
    place.ready()
    assert place.code() == 0
    restored(place, ended)


@pytest.mark.parametrize("make", [KITTY, XTERM], ids=lambda make: make.name)
def test_a_scene_that_does_not_load_leaves_the_screen_alone(make: Make, terminal) -> None:
    """One line and code 1."""
    place = terminal(make)
    (wanted,) = as_if(place, "echo 'tsplat: missing.ply: no such file' >&2; exit 1")
    place.view("missing.ply")
    place.ready()
    assert place.code() == 1
    restored(place, wanted)


@pytest.mark.parametrize("make", [KITTY, XTERM], ids=lambda make: make.name)
def test_a_closed_window_leaves_nothing_behind(make: Make, tmp_path: Path) -> None:
    """The program ends with its terminal; no process is left, and nothing in shared memory."""
    with open_terminal(make, tmp_path) as place:
        before = place.photograph()
        place.view()
        shown(place, before)
        place.type("o")
        pid, shell = place.pid(), int((place.state / "shell.pid").read_text())
        assert alive(pid)
        place.xdo("windowkill", place.window)
        await_("the program's end", lambda: not alive(pid))
        await_("the shell's end", lambda: not alive(shell))
    assert list(Path("/dev/shm").glob(f"*tsplat-{pid}-*")) == []
