"""Asking a terminal what it is takes one write, little time, and leaves nothing behind."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import threading
import time

import pytest
from fakes import DA1, FakeTerminal

from tests.conftest import ROOT
from tsplat.presenters.base import Terminal
from tsplat.terminal import probe
from tsplat.terminal.answers import KITTY_QUESTION, QUESTIONS
from tsplat.terminal.device import patience

ENVIRON = {"TERM": "xterm"}


def test_answers_and_typed_text():
    """Facts on the one hand, what was typed meanwhile on the other; the mode as before."""
    with FakeTerminal(extra=b"\x1bP>|foot(1.28.0)\x1b\\ls") as terminal:
        facts, typed = probe(terminal.fd, terminal.fd, ENVIRON)
        assert (facts.name, facts.sixel, facts.columns) == ("foot(1.28.0)", True, 80)
        assert typed == b"ls"
        terminal.settle()
        begin, end = b"\x1b[?1049h" + KITTY_QUESTION, QUESTIONS + b"\x1b[c\x1b[?1049l"
        assert terminal.output.startswith(begin)
        assert terminal.output.endswith(end)
        media = terminal.output[len(begin) : -len(end)]
        asked = re.findall(rb"\x1b_Gi=(?:32|33),[a-z0-9=,]*,t=([a-z]),f=24;", media)
        assert set(asked) <= {b"s", b"t"}
        assert terminal.mode() == terminal.saved


def test_a_silent_terminal_costs_150_ms():
    """No answer: half-blocks, after the time-out and no later."""
    with FakeTerminal(delay=None) as terminal:
        begun = time.monotonic()
        facts, typed = probe(terminal.fd, terminal.fd, ENVIRON)
        assert 0.1 < time.monotonic() - begun < 0.4
        assert (facts.kitty, facts.iterm2, facts.sixel) == (False, False, False)
        assert typed == b""
        assert terminal.mode() == terminal.saved


def test_an_answer_ends_the_wait():
    """DA1 is the last answer: what comes later is not waited for."""
    with FakeTerminal() as terminal:
        begun = time.monotonic()
        probe(terminal.fd, terminal.fd, ENVIRON, timeout=5)
        assert time.monotonic() - begun < 1


def test_no_terminal_is_not_written_to():
    """A pipe, or a TERM that is dumb or missing, gets nothing."""
    read, write = os.pipe()
    try:
        assert probe(read, write, ENVIRON) == (Terminal(tty=False), b"")
    finally:
        os.close(write)
        assert os.read(read, 9) == b""
        os.close(read)
    with FakeTerminal() as terminal:
        assert probe(terminal.fd, terminal.fd, {"TERM": "dumb"})[0].tty is False
        terminal.settle()
        assert terminal.output == b""


def test_the_fake_is_sane():
    """The fake's DA1 answer lists sixel, as the tests above assume."""
    assert b";4;" in DA1


TMUX = {"TERM": "tmux-256color"}
INNER = b"\x1bP>|tmux 3.3a\x1b\\"


def wrapped(data):
    """As tmux lets it through."""
    return b"\x1bPtmux;" + data.replace(b"\x1b", b"\x1b\x1b") + b"\x1b\\"


def test_tmux_lets_questions_through():
    """The terminal around tmux answers to wrapped questions; tmux itself gets no APC (a title)."""

    def around(terminal):
        terminal.wait_for(wrapped(b"\x1b[c"))
        os.write(
            terminal.master,
            b"\x1b_Gi=31;OK\x1b\\q\x1bP>|kitty(0.48.2)\x1b\\\x1b[?62;52;c",
        )

    with FakeTerminal(extra=INNER) as terminal:
        thread = threading.Thread(target=around, args=(terminal,))
        thread.start()
        facts, typed = probe(terminal.fd, terminal.fd, TMUX, timeout=5)
        thread.join()
        terminal.settle()
        assert (facts.name, facts.around, facts.kitty) == ("tmux 3.3a", "kitty(0.48.2)", True)
        assert typed == b"q"
        assert wrapped(KITTY_QUESTION) in terminal.output
        assert b"\x1b_" not in terminal.output.replace(b"\x1b\x1b_", b"")


def test_tmux_lets_nothing_through():
    """No answer past tmux: advice, after one more time-out and no later."""
    with FakeTerminal(extra=INNER, da1=b"\x1b[?1;2c") as terminal:
        begun = time.monotonic()
        facts, _ = probe(terminal.fd, terminal.fd, TMUX)
        assert 0.1 < time.monotonic() - begun < 0.5
        assert not facts.kitty
        assert "allow-passthrough" in facts.advice


EARLY = """
import os, sys
from tsplat.terminal import device
open(sys.argv[1] + "/started", "w").close()
heard = device.hear(0, 1, os.environ)
with open(sys.argv[1] + "/part", "wb") as file:
    file.write(heard.around)
os.rename(sys.argv[1] + "/part", sys.argv[1] + "/around")
"""


def known_to_tmux(terminal):
    """Answers what tmux asks first (DA2): before that it passes no answers on."""
    terminal.wait_for(b"\x1b[>c")
    terminal.type(b"\x1b[>41;379;0c")


def until(there, seconds=20.0):
    """Waits for it."""
    end = time.monotonic() + seconds
    while not there():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.skipif(shutil.which("tmux") is None, reason="tmux is not installed")
@pytest.mark.parametrize("comes", [True, False])
def test_a_session_that_is_not_in_a_terminal_yet(comes, tmp_path):
    """tmux's first program may be quicker than tmux: the terminal is waited for, not for ever."""
    tmux = ["tmux", "-S", str(tmp_path / "socket"), "-f", str(tmp_path / "conf")]
    (tmp_path / "conf").write_text("set -g allow-passthrough on\n")
    (tmp_path / "early.py").write_text(EARLY)
    program = shlex.join([sys.executable, str(tmp_path / "early.py"), str(tmp_path)])
    clean = {name: text for name, text in os.environ.items() if name != "TMUX"}
    environ = {**clean, "TERM": "xterm", "PYTHONPATH": str(ROOT)}
    with FakeTerminal() as terminal:
        subprocess.run([*tmux, "new-session", "-d", program], check=True, env=environ)
        try:
            until((tmp_path / "started").exists)
            time.sleep(0.3)  # until it asks, and finds nobody there
            if comes:
                attach = shlex.join(["exec", "env", "-u", "TMUX", *tmux, "attach"])
                client = f"import os; os.execvp('sh', ['sh', '-c', {attach!r}])"
                thread = threading.Thread(target=known_to_tmux, args=(terminal,))
                thread.start()
                terminal.spawn(client).communicate(timeout=60)  # it ends with the program
                thread.join()
            until((tmp_path / "around").exists)
            assert (DA1 in (tmp_path / "around").read_bytes()) is comes
        finally:
            subprocess.run([*tmux, "kill-server"], check=False, capture_output=True)


def test_a_window_opened_from_tmux():
    """TMUX is inherited, the name is not: kitty's questions are asked after all."""
    environ = {"TERM": "xterm-kitty", "TMUX": "/tmp/x"}
    extra = b"\x1b_Gi=31;OK\x1b\\\x1bP>|kitty(0.48.2)\x1b\\"
    with FakeTerminal(extra=extra) as terminal:
        facts, _ = probe(terminal.fd, terminal.fd, environ, timeout=5)
        assert (facts.kitty, facts.multiplexer) == (True, "")
        assert terminal.output.count(KITTY_QUESTION) == 1


def test_a_slow_link_is_waited_for():
    """Once an answer has begun to come the last may take longer than the first."""

    def slowly(terminal):
        terminal.wait_for(b"\x1b[c")
        os.write(terminal.master, b"\x1bP>|foot(1.28.0)\x1b\\")
        time.sleep(0.5)
        os.write(terminal.master, b"\x1b[?62;4;22c")

    with FakeTerminal(delay=None) as terminal:
        thread = threading.Thread(target=slowly, args=(terminal,))
        thread.start()
        facts, _ = probe(terminal.fd, terminal.fd, ENVIRON, timeout=0.3)
        thread.join()
        assert (facts.name, facts.sixel) == ("foot(1.28.0)", True)


def test_typing_is_no_answer():
    """Keys do not prolong the wait."""
    with FakeTerminal(delay=None) as terminal:
        terminal.type(b"\x1b[A\x1bOP")
        begun = time.monotonic()
        _, typed = probe(terminal.fd, terminal.fd, ENVIRON)
        assert time.monotonic() - begun < 1
        assert typed == b"\x1b[A\x1bOP"


def test_patience():
    """More of it over a network than on this machine."""
    assert patience({"SSH_CONNECTION": "1"}) > 1 > patience({}) > 0
