"""A session leaves no trace, however it ends, and frames and events pass as promised."""

import math
import os
import re
import signal
import threading
import time

import pytest
from fakes import DA1, FakeTerminal

from tests.modes import TELLS, left_on
from tsplat.core.errors import TerminalError
from tsplat.presenters.base import Terminal
from tsplat.terminal import Event, Screen, screen
from tsplat.terminal.link import _Sample
from tsplat.viewer.text import help_page

ENVIRON = {"TERM": "xterm"}
# The last is a question: its answer is the last thing to come
MODES_OFF = b"\x1b[<u\x1b[?1016l\x1b[?1006l\x1b[?1002l\x1b[?1004l\x1b[?2048l"
MODES_ON = b"\x1b[?2048h\x1b[?1004h\x1b[?1002h\x1b[?1006h\x1b[?1016h\x1b[>31u"
UNDO = b"\x1b[?2026l\x1b\\CLEANUP" + MODES_OFF + b"\x1b[m\x1b[?25h\x1b[?1049l\x1b[c"

SESSION = """
import sys, time
from tsplat.terminal import Screen
with Screen() as screen:
    screen.cleanup = b"CLEANUP"
    screen.write(b"READY")
    {body}
"""


def session(fake, **options):
    return Screen(fake.fd, fake.fd, ENVIRON, **options)


def check_restored(terminal):
    """The mode is what it was, and the last bytes put the screen right."""
    terminal.settle()
    assert terminal.mode() == terminal.saved
    assert terminal.output.endswith(UNDO)
    assert left_on(terminal.output) == set()


def test_what_is_left_on_is_seen():
    """The check above catches what is not undone, undone on the other screen, or on twice."""
    enter, leave, push, pop = b"\x1b[?1049h", b"\x1b[?1049l", b"\x1b[>31u", b"\x1b[<u"
    assert left_on(enter + push + pop + leave) == set()
    assert left_on(enter + push + leave) == {"keys 31 (alternate)"}
    assert left_on(enter + push + leave + pop) == {"keys 31 (alternate)"}
    assert left_on(push + enter + pop + leave) == {"keys 31"}
    assert left_on(enter + push + push + pop + leave) == {"keys 31 (alternate)"}
    assert left_on(b"\x1b[?1002h\x1b[?1016h\x1b[?1002l") == {"1016"}
    assert left_on(enter) == {"alternate"}


@pytest.mark.parametrize(
    ("body", "code"), [("pass", 0), ("1 / 0", 1), ("sys.exit(3)", 3)], ids=["end", "error", "exit"]
)
def test_restored_at_the_end(body, code):
    """On a normal end, an exception and sys.exit."""
    with FakeTerminal(extra=TELLS) as terminal:
        process = terminal.spawn(SESSION.format(body=body))
        errors = process.communicate(timeout=20)[1]
        assert process.returncode == code, errors
        assert terminal.output.startswith(b"\x1b[?1049h")
        assert b"\x1b[?25l" + MODES_ON in terminal.output
        check_restored(terminal)


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
@pytest.mark.parametrize("body", ["screen.read_events(None)", "time.sleep(0.3); screen.clear()"])
def test_restored_on_deadly_signals(signum, body):
    """Waiting or working, the process unwinds, restores, and exits with 128 + signal."""
    with FakeTerminal(extra=TELLS) as terminal:
        process = terminal.spawn(SESSION.format(body=body))
        terminal.wait_for(b"READY")
        process.send_signal(signum)
        errors = process.communicate(timeout=20)[1]
        assert process.returncode == 128 + signum, errors
        assert errors == ""
        check_restored(terminal)


@pytest.mark.parametrize("name", ["XTerm(412)", "foot(1.28.0)"])
def test_an_xterm_is_rid_of_its_pictures(name):
    """Wherever the screen is cleared, and at the end, they are scrolled out; no other scrolls."""
    facts = Terminal(80, 24, sixel=True, name=name)
    with FakeTerminal() as terminal:
        with session(terminal, terminal=facts) as now:
            now.clear()
        terminal.settle()
        out, scroll, gone = terminal.output, b"\x1b[24S", b"\x1b[m\x1b[2J"
    if name.startswith("XTerm"):
        assert out.count(scroll + gone) == out.count(gone) == 2
        assert out.index(b"\x1b[?1049h") < out.index(scroll)
        assert out.rindex(gone) < out.rindex(scroll) < out.index(b"\x1b[?1049l")
        assert scroll + gone in help_page(facts)
    else:
        assert b"S" not in out
        assert scroll not in help_page(facts)


def test_what_tmux_loses_is_drawn_anew():
    """A frame that is not acknowledged past tmux soon is lost, and maybe its picture: all again."""
    facts = Terminal(kitty=True, multiplexer="tmux", around="kitty(0.48.2)", placeholders=True)

    def kinds(now, kind):
        heard, end = [], time.monotonic() + 10
        while kind not in heard:
            assert time.monotonic() < end
            heard += [event.kind for event in now.read_events(10)]
        return heard

    with FakeTerminal(reports=False) as terminal, session(terminal, terminal=facts) as now:
        past = b"\x1bPtmux;\x1b\x1b[5n\x1b\\"
        for i in range(2):
            now.draw(b"kept")
            terminal.wait_for(b"kept\x1b[?2026l" + past)
            terminal.type(b"\x1b[0n")
            assert kinds(now, "ready") == ["ready"]
            begun = time.monotonic()
            now.draw(b"lost")
            assert kinds(now, "resize") == ["resize"]
            assert time.monotonic() - begun < screen.PATIENCE_SECONDS / 2
            assert not now.busy
            assert not now.waiting
            now.draw(b"again %d" % i)  # in another pane its answer would be typed into a shell
            terminal.wait_for(b"again %d\x1b[?2026l\x1b[5n" % i)
            terminal.type(b"\x1b[0n")
            assert kinds(now, "ready") == ["ready"]
            terminal.type(b"k")
            assert kinds(now, "key") == ["key"]
            terminal.output = b""


def test_a_second_signal_interrupts_work(tmp_path):
    """The first is noted while the program computes, the second ends it there."""
    working = tmp_path / "working"  # it is out of the screen's calls, which a signal would end
    body = f"while True: open({str(working)!r}, 'w').close(); time.sleep(0.01)"
    with FakeTerminal(extra=TELLS) as terminal:
        process = terminal.spawn(SESSION.format(body=body))
        terminal.wait_for(b"READY")
        while not working.exists():
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        time.sleep(0.2)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 143
        process.stderr.close()
        check_restored(terminal)


def test_a_stuck_terminal_does_not_hold_us():
    """A write that blocks for good ends at the first signal; the mode is restored all the same."""
    with FakeTerminal() as terminal:
        body = "time.sleep(0.3); screen.write(bytes(10**7))"
        process = terminal.spawn(SESSION.format(body=body))
        terminal.wait_for(b"READY")
        terminal.reading.clear()
        time.sleep(0.6)
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=20)[1] == ""
        assert process.returncode == 128 + signal.SIGTERM
        assert terminal.mode() == terminal.saved


def test_a_late_answer_is_not_left_to_the_shell():
    """A terminal that has answered is waited for on the way out: it may be busy with a picture."""
    with FakeTerminal() as terminal:
        with session(terminal) as s:
            s.draw(b"frame")
            while s.busy:
                s.read_events(5.0)
            terminal.delay = 0.5
        time.sleep(0.7)
        assert terminal.output.endswith(b"\x1b[?1049l\x1b[c")  # and no answer, echoed


def test_restored_at_interpreter_exit():
    """Even when the ``with`` block is never left."""
    with FakeTerminal(extra=TELLS) as terminal:
        code = "from tsplat.terminal import Screen; s = Screen().__enter__(); s.cleanup=b'CLEANUP'"
        process = terminal.spawn(code)
        assert process.communicate(timeout=20)[1] == ""
        check_restored(terminal)


def test_hang_up():
    """When the terminal goes away, so does the program, without a traceback."""
    with FakeTerminal(extra=TELLS) as terminal:
        process = terminal.spawn(SESSION.format(body="while True: screen.read_events(None)"))
        terminal.wait_for(b"READY")
        terminal.hang_up()
        assert process.communicate(timeout=20)[1] == ""
        assert process.returncode == 128 + signal.SIGHUP


SHELL = """
import os, signal, sys
from tsplat.terminal import Screen
signal.signal(signal.SIGTTOU, signal.SIG_IGN)
job = os.fork()
if job == 0:
    os.setpgid(0, 0)
    os.tcsetpgrp(0, os.getpid())
    signal.signal(signal.SIGTTOU, signal.SIG_DFL)
    with Screen() as screen:
        screen.cleanup = b"CLEANUP"
        screen.write(b"READY")
        {body}
        assert "resize" in [e.kind for e in events]
        screen.write(b"AGAIN")
    sys.exit(7)
assert os.WIFSTOPPED(os.waitpid(job, os.WUNTRACED)[1])
os.tcsetpgrp(0, os.getpid())
os.write(1, b"STOPPED")
sys.stdin.readline()
os.tcsetpgrp(0, job)
os.killpg(job, signal.SIGCONT)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(job, 0)[1]))
"""


@pytest.mark.parametrize(
    "body",
    [
        "screen.suspend(); events = screen.read_events(0)",
        "os.kill(os.getpid(), signal.SIGTSTP); events = screen.read_events(5)",
    ],
    ids=["suspend", "SIGTSTP"],
)
def test_suspend_gives_the_terminal_back_and_takes_it_again(body):
    """The shell gets a restored screen; continued, all is ours again and to be redrawn."""
    with FakeTerminal(extra=TELLS) as terminal:
        process = terminal.spawn(SHELL.format(body=body))
        terminal.wait_for(b"STOPPED")
        assert terminal.output.endswith(UNDO + b"STOPPED")
        assert terminal.mode() == terminal.saved
        terminal.type(b"\n")
        errors = process.communicate(timeout=20)[1]
        assert process.returncode == 7, errors
        after = terminal.output.split(b"STOPPED")[1]
        assert b"\x1b[?1049h" in after
        assert after.index(MODES_ON) < after.index(b"AGAIN")
        assert left_on(terminal.output.split(b"STOPPED")[0]) == set()
        check_restored(terminal)


def test_no_mode_is_on_twice_after_a_stop():
    """Nobody can catch SIGSTOP: continued, modes that may be on are not pushed onto themselves."""
    body = "while 'resize' not in [e.kind for e in screen.read_events(None)]: pass"
    with FakeTerminal(extra=TELLS) as terminal:
        process = terminal.spawn(SESSION.format(body=body))
        terminal.wait_for(b"READY")
        process.send_signal(signal.SIGSTOP)
        process.send_signal(signal.SIGCONT)
        errors = process.communicate(timeout=20)[1]
        assert process.returncode == 0, errors
        assert terminal.output.count(MODES_ON) == 2
        check_restored(terminal)


def test_modes_are_set_only_where_they_were_confirmed():
    """A terminal that answers nothing of them gets the mouse in cells, and focus; none as asked."""
    with FakeTerminal() as terminal:
        with session(terminal):
            pass
        terminal.settle()
        sent = terminal.output
        assert b"\x1b[?25l\x1b[?1004h\x1b[?1002h\x1b[?1006h\x1b[m" in sent
        for word in (b"u", b"?1016h", b"?2048h"):
            assert b"\x1b[" + word not in sent
        assert b"\x1b[>31u" not in sent
    with FakeTerminal(extra=TELLS) as terminal:
        with session(terminal, mouse=False):
            terminal.settle()
            assert left_on(terminal.output) == {"alternate"}
        terminal.settle()
        assert left_on(terminal.output) == set()


def test_modes_are_set_when_answers_come_late():
    """With the event "terminal", not amid a frame; and undone as ever."""
    with FakeTerminal(delay=0.4, extra=TELLS) as terminal:
        with session(terminal, timeout=0.05) as open_screen:
            open_screen.cleanup = b"CLEANUP"
            terminal.settle()
            assert left_on(terminal.output) == {"alternate", "1002", "1006", "1004"}
            assert open_screen.read_events(3) == [Event("terminal")]
            terminal.wait_for(MODES_ON)
            terminal.type(b"\x1b[A\x1b[1;1:3A")
            press, release = read(open_screen, 2)
            assert (press.code, release.code, release.action) == ("up", "up", "release")
        check_restored(terminal)


def test_late_modes_wait_for_a_frame_to_be_written():
    """A frame that the tty has taken half of is not broken by them, and nobody waits for it."""
    with FakeTerminal(delay=None) as terminal:
        with session(terminal, timeout=0.05) as open_screen:
            terminal.settle()
            terminal.reading.clear()
            open_screen.draw(b"PICTURE" + b"x" * 100_000 + b"END", track=False)
            assert open_screen.busy
            terminal.type(TELLS + DA1)
            late = threading.Timer(1.0, terminal.reading.set)
            late.start()
            assert open_screen.read_events(3) == [Event("terminal")]
            assert not terminal.reading.is_set()
            late.join()
            while open_screen.busy:
                open_screen.read_events(0.1)
            terminal.wait_for(MODES_ON)
        frame = terminal.output[terminal.output.index(b"PICTURE") :]
        assert frame.index(b"END\x1b[?2026l") < frame.index(MODES_ON)


def read(open_screen, count, seconds=2):
    """So many events, or as many as come in that time."""
    events, end = [], time.monotonic() + seconds
    while len(events) < count and time.monotonic() < end:
        events += open_screen.read_events(0.1)
    return events


def test_the_mouse_is_told_in_pixels_of_a_cell():
    """Pixels become cells with fractions where mode 1016 is on; they are cells where it is not."""
    report = b"\x1b[<32;125;31M"
    with FakeTerminal(extra=TELLS) as terminal, session(terminal) as open_screen:
        terminal.type(report)
        (event,) = read(open_screen, 1)
        assert (event.x, event.y) == (pytest.approx(12.4), pytest.approx(1.5))  # cells of 10x20 px
    with FakeTerminal() as terminal, session(terminal) as open_screen:
        terminal.type(report)
        (event,) = read(open_screen, 1)
        assert (event.x, event.y) == (124, 30)


def test_a_size_told_by_the_terminal():
    """It is a resize if it is news, whichever of it and SIGWINCH comes first."""
    with FakeTerminal(extra=TELLS) as terminal, session(terminal) as open_screen:
        terminal.type(b"\x1b[48;24;80;480;800t")  # as soon as the mode is set
        assert read(open_screen, 1, 0.2) == []
        terminal.type(b"\x1b[48;50;132;1000;1320t")
        assert [event.kind for event in read(open_screen, 1)] == ["resize"]
        facts = open_screen.terminal
        assert (facts.rows, facts.columns, facts.cell_width) == (50, 132, 10)
        terminal.resize(50, 132, 1320, 1000)
        signal.raise_signal(signal.SIGWINCH)
        assert open_screen.read_events(0.1) == []
        terminal.resize(24, 80, 800, 480)
        signal.raise_signal(signal.SIGWINCH)
        assert open_screen.read_events(2) == [Event("resize")]
        terminal.type(b"\x1b[48;24;80;480;800t")
        assert read(open_screen, 1, 0.2) == []


def test_focus_is_told():
    """Gained and lost."""
    with FakeTerminal(extra=TELLS) as terminal, session(terminal) as open_screen:
        terminal.type(b"\x1b[O\x1b[I")
        assert read(open_screen, 2) == [Event("focus", action="out"), Event("focus", action="in")]


def test_a_frame_is_one_synchronized_update():
    """BSU, home, payload, ESU and the status question, in that order; nothing for nothing."""
    with FakeTerminal() as terminal, session(terminal) as open_screen:
        open_screen.draw(b"")
        assert not open_screen.busy
        open_screen.draw(b"PICTURE")
        assert open_screen.busy
        assert Event("ready") in open_screen.read_events(2)
        assert not open_screen.busy
        terminal.wait_for(b"\x1b[?2026h\x1b[HPICTURE\x1b[?2026l\x1b[5n")
        open_screen.draw(b"MORE", track=False)
        assert not open_screen.busy


def test_ready_means_the_last_frame():
    """With two frames under way the first answer is not "ready"."""
    with FakeTerminal() as terminal, session(terminal) as open_screen:
        open_screen.draw(b"ONE")
        open_screen.draw(b"TWO")
        terminal.wait_for(b"TWO")
        assert open_screen.read_events(2) == [Event("ready")]
        assert open_screen.read_events(0.1) == []


def test_unanswered_frames_are_given_up(monkeypatch):
    """After a while the next may go; after three in a row the terminal is not asked again."""
    monkeypatch.setattr(screen, "FRAME_SECONDS", 0.05)
    with FakeTerminal(reports=False) as terminal, session(terminal) as open_screen:
        for _ in range(3):
            open_screen.draw(b"PICTURE")
            assert open_screen.busy
            assert open_screen.read_events(2) == [Event("ready")]
            assert not open_screen.busy
        open_screen.draw(b"LAST")
        assert not open_screen.busy
        assert open_screen.read_events(0) == [Event("ready")]
        terminal.settle()
        assert terminal.output.count(b"\x1b[5n") == 3


def test_large_frames_arrive_whole():
    """Also when the terminal reads nothing for a while."""
    with FakeTerminal() as terminal, session(terminal) as open_screen:
        payload = bytes(range(0x20, 0x7F)) * 4000
        terminal.reading.clear()
        threading.Timer(0.2, terminal.reading.set).start()
        open_screen.write(payload)
        terminal.settle()
        assert payload in terminal.output


def test_what_was_typed_while_asking_is_read():
    """Keys that come between the answers are events."""
    with FakeTerminal(extra=b"q\x1b[A") as terminal, session(terminal) as open_screen:
        keys = [event.key for event in open_screen.read_events(1)]
        assert keys == ["q", "up"]


def test_facts_come_from_the_answers():
    """The terminal is asked on entering, unless its facts are given."""
    name = b"\x1bP>|foot(1.28.0)\x1b\\"
    with FakeTerminal(extra=name) as terminal, session(terminal) as open_screen:
        assert open_screen.terminal.name == "foot(1.28.0)"
        assert open_screen.terminal.sixel
    with FakeTerminal() as terminal:
        facts = Terminal(name="given", columns=1, rows=1)
        with session(terminal, terminal=facts) as open_screen:
            assert open_screen.terminal.name == "given"
            assert open_screen.terminal.columns == 80
            terminal.settle()
            assert b"\x1b[c" not in terminal.output


def test_late_answers_still_count():
    """A slow line: after 50 ms half-blocks, and what it can do when it has said so."""
    with FakeTerminal(delay=0.4) as terminal, session(terminal, timeout=0.05) as open_screen:
        assert not open_screen.terminal.sixel
        assert open_screen.read_events(3) == [Event("terminal")]
        assert open_screen.terminal.sixel


def test_resize():
    """SIGWINCH wakes the reader; the facts have the new size."""
    with FakeTerminal() as terminal, session(terminal) as open_screen:
        terminal.resize(50, 132, 1320, 1000)
        signal.raise_signal(signal.SIGWINCH)
        assert open_screen.read_events(2) == [Event("resize")]
        facts = open_screen.terminal
        assert (facts.rows, facts.columns, facts.cell_width) == (50, 132, 10)


def test_a_lone_escape_is_a_key():
    """After 50 ms, without any more input."""
    with FakeTerminal() as terminal, session(terminal) as open_screen:
        terminal.type(b"\x1b")
        assert open_screen.read_events(2) == [Event("key", "escape")]


def test_reading_returns_in_time():
    """No event: [] after the time given; 0 does not wait."""
    with FakeTerminal() as terminal, session(terminal) as open_screen:
        begun = time.monotonic()
        assert open_screen.read_events(0) == []
        assert open_screen.read_events(0.1) == []
        assert 0.1 <= time.monotonic() - begun < 0.5


def test_a_watched_descriptor_ends_a_wait():
    """As long as there is something to read; a key is an event of its own."""
    with FakeTerminal() as terminal, session(terminal, terminal=Terminal()) as open_screen:
        ours, theirs = os.pipe()
        open_screen.watched = ours
        os.write(theirs, b"x")
        assert open_screen.read_events(None) == [Event("watched")]
        assert open_screen.read_events(None) == [Event("watched")]
        os.read(ours, 1)
        assert open_screen.read_events(0.05) == []
        terminal.type(b"j")
        assert open_screen.read_events(2) == [Event("key", "j")]
        os.close(theirs)  # the end can be read, too
        assert open_screen.read_events(None) == [Event("watched")]
        os.close(ours)
        open_screen.watched = None
        assert open_screen.read_events(0) == []


def test_kitty_gets_nudges():
    """A window's first picture shows in kitty 0.48 only when something follows after it has drawn.

    When that is depends on what else the machine does: soon, and a few times later; then no more.
    """
    facts = Terminal(kitty=True)
    with FakeTerminal() as terminal, session(terminal, terminal=facts) as open_screen:
        open_screen.draw(b"PICTURE")
        open_screen.read_events(0.05)
        open_screen.read_events(0.05)
        terminal.settle()
        assert b"\x1b[5n\x1b[m" in terminal.output
        end = time.monotonic() + screen.NUDGES_SECONDS[-1] + 0.1
        while time.monotonic() < end:
            open_screen.read_events(end - time.monotonic())
        terminal.settle()
        assert terminal.output.endswith(b"\x1b[5n" + b"\x1b[m" * len(screen.NUDGES_SECONDS))
        assert not open_screen._nudges


def test_handlers_are_given_back():
    """Signals mean afterwards what they meant before."""
    signums = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGWINCH, signal.SIGTSTP)
    before = [signal.getsignal(s) for s in signums]
    with FakeTerminal() as terminal, session(terminal):
        assert [signal.getsignal(s) for s in signums] != before
    assert [signal.getsignal(s) for s in signums] == before


@pytest.mark.parametrize("environ", [{}, {"TERM": "dumb"}])
def test_no_escapes_for_a_dumb_terminal(environ):
    """Nothing is written, and the error says what was expected."""
    with FakeTerminal() as terminal:
        with (
            pytest.raises(TerminalError, match="expected a terminal"),
            Screen(terminal.fd, terminal.fd, environ),
        ):
            pass
        terminal.settle()
        assert terminal.output == b""


def test_a_pipe_is_no_terminal():
    """Output into a file or pipe is an error on entering."""
    null = os.open(os.devnull, os.O_RDWR)
    with pytest.raises(TerminalError, match="a pipe or file"):
        Screen(null, null, ENVIRON).__enter__()
    os.close(null)


def test_a_far_terminal_gets_the_next_frame_before_it_answers():
    """As soon as the link has room by what is known of it; the answers come one by one."""
    with FakeTerminal(reports=False) as terminal, session(terminal) as open_screen:
        open_screen.draw(b"NEAR")
        assert open_screen.busy
        open_screen.link.lost()
        open_screen._updates.clear()
        open_screen._unanswered = 0
        open_screen.link.latency = 5.0
        open_screen.link._samples += [_Sample(100_000, 1.0, 0.0)] * 3
        for n in range(3):
            open_screen.draw(b"ONE" * 1000)
            assert open_screen.read_events(2) == [Event("ready")]
            assert not open_screen.busy
            assert open_screen.waiting
            assert not open_screen.flights
            terminal.settle()
            assert terminal.output.count(b"\x1b[5n") == n + 2
        terminal.type(b"\x1b[0n" * 3)
        while len(open_screen.flights) < 3:
            assert open_screen.read_events(2)
        assert not open_screen.waiting
        assert all(flight.sent > 3000 for flight in open_screen.flights)


def test_a_frame_that_is_through_is_asked_about_once():
    """Text after it that is cut short was not the frame's."""
    with FakeTerminal() as terminal, session(terminal) as open_screen:
        terminal.settle()
        terminal.reading.clear()
        open_screen.draw(b"FRAME")
        open_screen.draw(bytes(100_000), track=False)
        assert open_screen.abandon()
        terminal.reading.set()
        terminal.settle()
        assert terminal.output.count(b"\x1b[5n") == 1
        open_screen.draw(bytes(200_000))
        assert open_screen.abandon()
        terminal.settle()
        assert open_screen.read_events(2) == [Event("ready")]
        terminal.settle()
        assert terminal.output.count(b"\x1b[5n") == 2


CHUNKS = b"".join(b"\x1b_Gm=1;%s\x1b\\" % (b"%04d" % n * 500) for n in range(40))


def test_parts_begin_where_sequences_do():
    """Together they are the picture; none of a string is cut, nor what is doubled for tmux."""
    cells = b"".join(b"\x1b[38;2;%d;0;0m\xe2\x96\x80" % (n % 256) for n in range(4000))
    inside = b"\x1bPtmux;" + CHUNKS.replace(b"\x1b", b"\x1b\x1b") + b"\x1b\\"
    for payload, several in [(CHUNKS, True), (cells, True), (inside, False), (b"\x1bPq1;", False)]:
        parts = screen.in_parts(payload, 6000)
        assert b"".join(parts) == payload
        assert (len(parts) > 5) == several
        if several:
            assert all(6000 <= len(part) < 16_000 for part in parts)
            assert all(re.match(rb"\x1b[\[_]", part) for part in parts)
    assert screen.in_parts(CHUNKS, math.inf) == [CHUNKS]
    assert screen.in_parts(CHUNKS, len(CHUNKS) / 3) == [CHUNKS]


def far_away(open_screen, rate=1e6):
    """A link of ``rate`` bytes/s that is known to be far."""
    open_screen.link.lost()
    open_screen.link.latency = 0.1
    open_screen.link._samples += [_Sample(int(rate), 1.0, 0.0)] * 8


def test_a_large_picture_is_answered_in_parts_and_counts_once():
    """Each an update of its own, with a report behind it; one flight, of all bytes."""
    with FakeTerminal() as terminal, session(terminal) as open_screen:
        far_away(open_screen, 200e3)
        open_screen.draw(CHUNKS)
        while open_screen.waiting or not open_screen.flights:
            assert open_screen.read_events(5)
        terminal.settle()
        asked = terminal.output.count(b"\x1b[5n")
        assert (
            asked
            == terminal.output.count(b"\x1b[?2026h")
            == len(screen.in_parts(screen.HOME + CHUNKS, 10_000))
        )
        assert asked > 4
        written = terminal.output[terminal.output.index(b"\x1b[?2026h") :]
        assert re.sub(rb"\x1b\[\?2026[hl]|\x1b\[5n|\x1b\[H", b"", written) == CHUNKS
        (flight,) = open_screen.flights
        assert flight.sent == len(written)


def test_a_picture_cut_short_between_its_parts_counts_once():
    """What was not begun is not waited for."""
    with FakeTerminal() as terminal, session(terminal) as open_screen:
        far_away(open_screen, 50e3)
        open_screen.draw(CHUNKS)
        assert open_screen.abandon()
        while open_screen.waiting:
            assert open_screen.read_events(5)
        assert len(open_screen.flights) == 1
        assert open_screen.flights[0].sent < len(CHUNKS) / 2
        terminal.settle()
        assert CHUNKS[-1000:] not in terminal.output
        assert not open_screen.busy
