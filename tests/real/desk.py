"""Real terminals, each on an X server of its own that no one sees: typed into, photographed.

The X server is Xvfb; keys and window sizes go through xdotool, that is the XTEST extension, as a
keyboard's would; Pillow takes the photographs. A terminal starts as its package leaves it: a home
of its own, no settings of the user's, a fixed font, no cursor that blinks. Nothing here sleeps for
a fixed time to be in step: what is waited for is looked at until it is there.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageGrab, features

PATIENCE = 60.0  # s; for a machine that has much else to do
REST = 0.5  # s; a terminal that has something to show shows it before
GAP = 0.03  # s between two looks at the same thing
SCREEN = 1100, 700  # px of the X server; windows are smaller
FONT = "DejaVu Sans Mono"
PASSES = 0, 28  # kitty's version that first knew the cells that stand for pictures in tmux
KEPT = ("PATH", "PYTHONPATH", "PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX", "TMPDIR", "USER")

RC = r"""
PS1='$ '
bind 'set enable-bracketed-paste off'
n=0
PROMPT_COMMAND='echo $((n += 1)) >"$STATE/prompts"'
facts() { stty -a >"$STATE/stty.$1"; "$PYTHON" -IS "$STATE/modes.py" >"$STATE/modes.$1"; }
note() { echo $? >"$STATE/code"; facts after; }
c() { printf '\033[H\033[2J'; cat "$STATE/text"; }
v() { facts before; ./program; note; }
f() { fg; note; }
cd "$STATE"
echo $$ >shell.pid
tty >tty
"""
"""What bash knows in the terminal: C shows a text, V runs ./program, F goes on with it."""

NO_BARS = '<!DOCTYPE gui SYSTEM "kpartgui.dtd"><gui name="{}" version="9999"></gui>'

MODES = r"""
import os, re, select, termios, tty
modes = 1, 7, 12, 25, 47, 1000, 1002, 1003, 1004, 1006, 1016, 1047, 1049, 2004, 2026, 2031, 2048
saved = termios.tcgetattr(0)
tty.setraw(0)
try:
    questions = "".join(f"\033[?{mode}$p" for mode in modes) + "\033[?u\033[?4m\033[c"
    os.write(2, questions.encode())
    said = b""
    while not re.search(rb"\033\[\?[0-9;]*c", said) and select.select([0], [], [], 20)[0]:
        said += os.read(0, 4096)
finally:
    termios.tcsetattr(0, termios.TCSADRAIN, saved)
print(said)
"""
"""Asks the terminal for its modes, its keyboard's (kitty, xterm), and DA1, which ends the wait."""

TEXT = (
    "The screen as it was: \x1b[31mred\x1b[m, \x1b[1;34mbold\x1b[m, \x1b[7mreversed\x1b[m\n"
    + "".join(f"line {i} {'=' * (5 * i)}\n" for i in range(2, 9))
)
"""What is on the screen before a program starts."""


def await_(what: str, look: Callable[[], object], seconds: float = PATIENCE) -> object:
    """What ``look`` returns, once that is true; ``what`` names it if it never is."""
    deadline = time.monotonic() + seconds
    while not (found := look()):
        assert time.monotonic() < deadline, f"not there after {seconds} s: {what}"
        time.sleep(GAP)
    return found


def kitty_version() -> tuple[int, ...]:
    """(0, 0) if it is not installed."""
    needs(KITTY.programs[0])
    said = subprocess.run([*KITTY.programs, "--version"], capture_output=True, check=True).stdout
    return tuple(map(int, said.split()[1].split(b".")))


def needs(*programs: str) -> None:
    """Skips the test where one of these is not installed."""
    missing = [program for program in programs if shutil.which(program) is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)}")
    if not features.check("xcb"):
        pytest.skip("this Pillow was built without XCB, which takes the photographs")


def tsplat() -> list[str]:
    """The installed program's command."""
    program = shutil.which("tsplat", path=str(Path(sys.executable).parent))
    return [program] if program else [sys.executable, "-m", "tsplat"]


def alive(pid: int) -> bool:
    """Whether the process runs, or would: a dead one that nobody has buried does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@dataclass(frozen=True)
class Make:
    """A terminal that can be started."""

    name: str
    programs: tuple[str, ...]  # to be installed
    command: Callable[[Path, str, int, int], list[str]]  # home, shell, columns, rows
    tmux: bool = False  # with tmux in between


def kitty(home: Path, shell: str, columns: int, rows: int) -> list[str]:
    options = {
        "font_family": FONT, "font_size": 12, "cursor_blink_interval": 0, "shell_integration":
        "disabled", "remember_window_size": "no", "initial_window_width": f"{columns}c",
        "initial_window_height": f"{rows}c", "placement_strategy": "top-left",
        "window_padding_width": 0, "update_check_interval": 0, "enable_audio_bell": "no",
        "confirm_os_window_close": 0, "sync_to_monitor": "no", "linux_display_server": "x11",
    }  # fmt: skip
    words = [word for name, value in options.items() for word in ("-o", f"{name}={value}")]
    return [os.environ.get("TSPLAT_KITTY", "kitty"), "--config", "NONE", *words, shell]


def xterm(home: Path, shell: str, columns: int, rows: int) -> list[str]:
    resources = {"maxGraphicSize": "2000x2000", "cursorBlink": "false", "allowWindowOps": "true"}
    words = [word for name, value in resources.items() for word in ("-xrm", f"*{name}: {value}")]
    return [
        "xterm", *words, "-ti", "vt340", "-u8", "-b", "0", "-bw", "0", "+sb", "-fa", FONT,
        "-fs", "12", "-bg", "black", "-fg", "gray90", "-geometry", f"{columns}x{rows}+0+0",
        "-e", shell,
    ]  # fmt: skip


def mlterm(home: Path, shell: str, columns: int, rows: int) -> list[str]:
    return [
        "mlterm", "-g", f"{columns}x{rows}", "--fontsize", "16", "--sb=false", "--border=0",
        "--lborder=0", "--bg=black", "--fg=gray90", "--blink=false", "-e", shell,
    ]  # fmt: skip


def konsole(home: Path, shell: str, columns: int, rows: int) -> list[str]:
    """It has no options for most of this: a profile, and no bars."""
    files = {
        ".config/konsolerc": "[Desktop Entry]\nDefaultProfile=test.profile\n[KonsoleWindow]\n"
        "RememberWindowSize=false\nShowMenuBarByDefault=false\n"
        "[TabBar]\nTabBarVisibility=AlwaysHideTabBar\n",
        ".data/konsole/test.profile": "[General]\nName=test\nParent=FALLBACK/\n"
        f"TerminalColumns={columns}\nTerminalRows={rows}\nTerminalMargin=0\n"
        "TerminalCenter=false\nShowTerminalSizeHint=false\nDimWhenInactive=false\n"
        f"[Appearance]\nFont={FONT},12\nColorScheme=test\n[Scrolling]\nScrollBarPosition=2\n"
        "HighlightScrolledLines=false\n",
        ".data/konsole/test.colorscheme": "[Background]\nColor=0,0,0\n"
        "[Foreground]\nColor=229,229,229\n[General]\nOpacity=1\n",
        ".data/kxmlgui5/konsole/konsoleui.rc": NO_BARS.format("konsoleui"),
        ".data/kxmlgui5/konsole/sessionui.rc": NO_BARS.format("sessionui"),
    }
    for name, text in files.items():
        (home / name).parent.mkdir(parents=True, exist_ok=True)
        (home / name).write_text(text)
    return ["dbus-run-session", "--", "konsole", "--nofork", "--hide-menubar", "--hide-tabbar",
            "-e", shell]  # fmt: skip


KITTY = Make("kitty", (os.environ.get("TSPLAT_KITTY", "kitty"),), kitty)
KONSOLE = Make("konsole", ("konsole", "dbus-run-session"), konsole)
XTERM = Make("xterm", ("xterm",), xterm)
MLTERM = Make("mlterm", ("mlterm",), mlterm)


def in_tmux(make: Make) -> Make:
    """tmux in ``make``, with colours and pictures let through."""
    return replace(make, name=f"tmux-in-{make.name}", programs=(*make.programs, "tmux"), tmux=True)


@dataclass
class Terminal:
    """One that runs, with bash in it."""

    make: Make
    state: Path
    display: str
    environment: dict[str, str]
    process: subprocess.Popen[bytes]
    window: str = ""
    prompts: int = 0
    screens: dict[tuple[str, str], list[np.ndarray]] = field(default_factory=dict)

    # --- the window

    def xdo(self, *words: object) -> str:
        return subprocess.run(
            ["xdotool", *map(str, words)], env=self.environment, check=True, capture_output=True,
            text=True,
        ).stdout  # fmt: skip

    def focus(self) -> None:
        """Finds the window, and sends it what is typed."""

        def windows() -> list[tuple[int, str]]:
            found = []
            with contextlib.suppress(subprocess.CalledProcessError):
                for window in self.xdo(
                    "search", "--maxdepth", 1, "--onlyvisible", "--name", ".*"
                ).split():
                    width, height = self.area(window)
                    if (width, height) != SCREEN:
                        found.append((width * height, window))
            return sorted(found)

        self.window = await_(f"{self.make.name}'s window", windows)[-1][1]
        self.xdo("mousemove", SCREEN[0] - 1, SCREEN[1] - 1)
        self.xdo("windowfocus", self.window)

    def area(self, window: str) -> tuple[int, int]:
        words = self.xdo("getwindowgeometry", "--shell", window).split()
        facts = dict(word.split("=") for word in words)
        return int(facts["WIDTH"]), int(facts["HEIGHT"])

    def press(self, *keys: str) -> None:
        """Keys by their X11 names, one after the other."""
        self.xdo("key", "--delay", 5, *keys)

    def photograph(self) -> np.ndarray:
        """The window, uint8 [H, W, 3]."""
        image = np.asarray(ImageGrab.grab(xdisplay=self.display).convert("RGB"))
        width, height = self.area(self.window)
        return image[:height, :width]

    def at_rest(self) -> np.ndarray:
        """The window, once it has not changed for ``REST`` s."""
        last, since = self.photograph(), time.monotonic()

        def still() -> bool:
            nonlocal last, since
            before, last = last, self.photograph()
            if not np.array_equal(before, last):
                since = time.monotonic()
            return time.monotonic() - since > REST

        await_("a screen at rest", still)
        return last

    def shows(self, what: str, wanted: np.ndarray, seconds: float = PATIENCE) -> None:
        """Waits until every pixel of the window is as ``wanted``."""
        try:
            await_(what, lambda: np.array_equal(self.photograph(), wanted), seconds)
        except AssertionError as error:
            raise AssertionError(f"{error}; {self.keep(self.photograph(), wanted)}") from None

    def keep(self, seen: np.ndarray | None, wanted: np.ndarray) -> str:
        """Writes both into files; says where."""
        for name, picture in (("seen", seen), ("wanted", wanted)):
            if picture is not None:
                Image.fromarray(picture).save(self.state / f"{name}.png")
        return f"see {self.state}/seen.png and wanted.png"

    def resize(self, width: int, height: int) -> None:
        """The window, px."""
        self.xdo("windowsize", self.window, width, height)

    # --- the tty

    def attributes(self) -> list[object]:
        with self.tty() as fd:
            return termios.tcgetattr(fd)

    @contextlib.contextmanager
    def tty(self) -> Iterator[int]:
        fd = os.open((self.state / "tty").read_text().strip(), os.O_RDWR | os.O_NOCTTY)
        try:
            yield fd
        finally:
            os.close(fd)

    def cells(self) -> tuple[int, int]:
        """Columns and rows that bash has."""
        with self.tty() as fd:
            size = struct.unpack("4H", fcntl.ioctl(fd, termios.TIOCGWINSZ, bytes(8)))
        return size[1], size[0]

    # --- the shell in it

    def ready(self) -> None:
        """Waits for a prompt that was not there at the last call."""

        def prompted() -> bool:
            with contextlib.suppress(OSError, ValueError):
                if int((self.state / "prompts").read_text()) > self.prompts:
                    return not self.attributes()[3] & termios.ICANON  # type: ignore[operator]
            return False

        await_("bash's prompt", prompted)
        self.prompts = int((self.state / "prompts").read_text())

    def type(self, letter: str) -> None:
        """A command of one letter."""
        self.press(letter, "Return")

    def program(self, script: str) -> None:
        """What V runs."""
        path = self.state / "program"
        path.write_text(f"#!/bin/sh\necho $$ >pid\n{script}\n")
        path.chmod(0o755)

    def fresh(self) -> None:
        """The text is on the screen, the prompt under it."""
        self.type("c")
        self.ready()

    def view(self, *words: object, errors: str = "") -> None:
        """Starts ``tsplat view``; what it says at its end goes to the file ``errors``, if any."""
        command = shlex.join(["exec", *tsplat(), "view", *map(str, words)])
        self.program(command + (f" 2>{errors}" if errors else ""))
        self.type("v")

    def changed(self) -> list[str]:
        """What is another after the last program than before: words for people."""
        found = []
        for what in ("stty", "modes"):
            before, after = (self.state / f"{what}.{when}" for when in ("before", "after"))
            assert before.stat().st_size > 5
            if before.read_text() != after.read_text():
                found.append(f"{what}: {before.read_text()} became {after.read_text()}")
        return found

    def pid(self) -> int:
        """Of the program that V runs."""
        return int((self.state / "pid").read_text())

    def code(self) -> int:
        return int((self.state / "code").read_text())

    def close(self) -> None:
        if self.make.tmux:
            subprocess.run(
                ["tmux", "-S", self.state / "tmux", "kill-server"], check=False,
                capture_output=True,
            )  # fmt: skip
        end(self.process)


def end(process: subprocess.Popen[bytes]) -> None:
    """Ends it and all that it has started."""
    for signum in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signum)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(5)
            return


@contextlib.contextmanager
def opened(make: Make, folder: Path, columns: int = 80, rows: int = 24) -> Iterator[Terminal]:
    """``make``, running, its text on the screen. The test is skipped where it is not installed."""
    needs("Xvfb", "xdotool", "bash", "stty", *make.programs)
    if make.name == "tmux-in-kitty" and kitty_version() < PASSES:
        pytest.skip("kitty before 0.28 shows no pictures in tmux; $TSPLAT_KITTY may name another")
    home, state = folder / "home", folder / "state"
    for path in (home / "run", state):
        path.mkdir(parents=True)
    (home / "run").chmod(0o700)
    (state / "rc").write_text(RC)
    (state / "text").write_text(TEXT)
    (state / "modes.py").write_text(MODES)
    environment = {name: os.environ[name] for name in KEPT if name in os.environ} | {
        "HOME": str(home), "XDG_RUNTIME_DIR": str(home / "run"), "LANG": "C.UTF-8",
        "LIBGL_ALWAYS_SOFTWARE": "1", "STATE": str(state), "SHELL": "/bin/bash",
        "PYTHON": sys.executable,
        "PYTHONPATH": os.pathsep.join(
            [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
        ),
    }  # fmt: skip
    for name, place in (("CONFIG", ".config"), ("DATA", ".data"), ("CACHE", ".cache")):
        environment[f"XDG_{name}_HOME"] = str(home / place)
    shell = state / "shell"
    bash = f"{shutil.which('bash')} --noprofile --rcfile {state}/rc -i"
    if make.tmux:
        (state / "tmux.conf").write_text(
            "set -g status off\nset -g escape-time 10\nset -g default-terminal tmux-256color\n"
            "set -as terminal-features ',*:RGB'\nset -g allow-passthrough on\n"
        )
        bash = f"env COLORTERM=truecolor {bash}"  # tmux does not say what is around it
        bash = f"tmux -S {state}/tmux -f {state}/tmux.conf new-session '{bash}'"
    shell.write_text(f"#!/bin/sh\nexport STATE={state} HOME={home}\nexec {bash}\n")
    shell.chmod(0o755)
    with contextlib.ExitStack() as stack:
        log = stack.enter_context((folder / "log").open("wb"))

        # What this process starts goes with it, even if it is killed
        with_us = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []

        def start(command: list[str], **kwargs: object) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(
                [*with_us, *command], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                start_new_session=True, cwd=home, **kwargs,
            )  # fmt: skip
            stack.callback(end, process)
            return process

        reading, writing = os.pipe()
        size = "x".join(map(str, SCREEN))
        with os.fdopen(reading) as answer:
            start(
                ["Xvfb", "-displayfd", str(writing), "-screen", "0", f"{size}x24", "-dpi", "96",
                 "-nolisten", "tcp", "-noreset"], pass_fds=(writing,),
            )  # fmt: skip
            os.close(writing)
            number = answer.readline().strip()
        if not number:
            pytest.skip("Xvfb does not start: " + (folder / "log").read_text()[-500:])
        environment["DISPLAY"] = f":{number}"
        command = make.command(home, str(shell), columns, rows)
        process = start(command, env=environment)
        terminal = Terminal(make, state, f":{number}", environment, process)
        stack.callback(terminal.close)
        await_(
            f"{make.name}'s shell",
            lambda: (state / "tty").exists() or process.poll() is not None,
        )
        assert process.poll() is None, (folder / "log").read_text()[-1000:]
        terminal.focus()
        terminal.ready()
        terminal.fresh()
        yield terminal
