"""A session on the terminal that leaves no trace, however it ends.

Synchronized output: https://github.com/contour-terminal/vt-extensions ; modes 1049, 25, 1002, 1004,
1006 and 1016, and DSR (``CSI 5 n``): https://invisible-island.net/xterm/ctlseqs/ctlseqs.html ;
releases of keys: https://sw.kovidgoyal.net/kitty/keyboard-protocol/ ; mode 2048:
https://gist.github.com/rockorager/e695fb2924d36b2bcf1fff4a3704bd83
"""

from __future__ import annotations

import atexit
import contextlib
import math
import os
import re
import select
import signal
import termios
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import FrameType, TracebackType
from typing import Any, Self

from tsplat.core.errors import TerminalError
from tsplat.presenters.base import Terminal
from tsplat.presenters.placeholders import through_tmux
from tsplat.terminal import device
from tsplat.terminal.answers import DA1, DA1_ANSWER, resized, told_size
from tsplat.terminal.device import (
    ENTER_ALTERNATE,
    LEAVE_ALTERNATE,
    PLAIN,
    READ_SIZE,
    STRING_END,
    cleared,
    scrolled_out,
)
from tsplat.terminal.events import Decoder, Event
from tsplat.terminal.link import Flight, Link, joined
from tsplat.terminal.sharing import Sharing

BEGIN_UPDATE = b"\x1b[?2026h"  # BSU: unknown to some, harmless to all; Konsole has it untold
END_UPDATE = b"\x1b[?2026l"  # ESU
HOME = b"\x1b[H"
HIDE_CURSOR, SHOW_CURSOR = b"\x1b[?25l", b"\x1b[?25h"
# Kitty's keyboard protocol, on a stack that each screen has of its own: 2 tells releases, 8 those
# of letters, too; 16 tells the text, 4 the letter with Shift, 1 is what these are built upon
KEYS = b"\x1b[>31u", b"\x1b[<u"
PIXELS = b"\x1b[?1016h", b"\x1b[?1016l"  # the mouse in px; after 1006, which it takes the place of
MOUSE = b"\x1b[?1002h\x1b[?1006h", b"\x1b[?1006l\x1b[?1002l"  # buttons and drags, told as SGR
FOCUS = b"\x1b[?1004h", b"\x1b[?1004l"  # unknown to some, harmless to all
SIZES = b"\x1b[?2048h", b"\x1b[?2048l"  # told in-band, at once and when they change
STATUS_REPORT = b"\x1b[5n"  # DSR, answered CSI 0 n once all before it is done

ESCAPE_SECONDS = 0.05  # a lone ESC older than this is the Escape key
FRAME_SECONDS = 1.0  # a frame is given up that a terminal has not acknowledged which never did
SLOWEST = 5e3  # bytes/s: for each 5 kB of such a frame a second more
PASSED = 1e5  # likewise, of one that answers past tmux on this machine; tmux may lose either
PATIENCE_SECONDS = 20.0  # and of one that did: the line is slow, or the network away for a while
PARTED = 4  # parts, or it is not worth while to have them answered one by one
PART_BEGINS = re.compile(rb"(?<!\x1b)\x1b[\[_P\]]")  # where a sequence does, within none
BURST_SECONDS = 0.01  # what ``max_rate`` allows in that time goes at once
PIECE = 256  # bytes; a tty that can be written to takes so many without a long wait
LEAVE_SECONDS = 0.15  # for what is still under way when we leave
BUSY_SECONDS = 3.0  # likewise, of a terminal that has answered before: it will, when it gets to it
NUDGES_SECONDS = 0.02, 0.1, 0.5, 2.0  # the later ones for a terminal that has no time to draw
GIVE_UPS = 3  # unanswered frames in a row before we stop to ask

_DEADLY = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)


def in_parts(payload: bytes, size: float) -> list[bytes]:
    """``payload`` cut where its sequences begin, each part of ``size`` bytes or a little more.

    Whole if there would be fewer than ``PARTED``.
    """
    parts, begin = [], 0
    if len(payload) >= PARTED * size:
        least = max(1, int(size))
        while found := PART_BEGINS.search(payload, begin + least, len(payload) - least):
            parts.append(payload[begin : found.start()])
            begin = found.start()
    return [*parts, payload[begin:]]


class Terminated(SystemExit):
    """A deadly signal came. Goes up like SystemExit and ends the process with 128 + signal."""

    def __init__(self, signum: int) -> None:
        super().__init__(128 + signum)
        self.signum = signum


@dataclass
class _Update:
    """A tracked frame, of so many parts that are answered."""

    parts: int
    flights: list[Flight] = field(default_factory=list)  # of those that were
    begun: float = 0.0  # s, monotonic: the first of them


class Screen:
    """The alternate screen in raw mode, cursor hidden, mouse and focus told; a context manager.

    Where the terminal is known to have them, releases of keys, the mouse in px and sizes are told,
    too; ``mouse`` False asks for none of these.

    All is restored on normal exit, exceptions, SIGTERM, SIGHUP, SIGINT and, as a last resort, at
    interpreter exit. A signal's handler takes note and wakes the reader; the call of this class
    that waits, or the next one, then raises :class:`Terminated`, so that ``with`` blocks unwind;
    a second signal raises it wherever the program is. Use it in the main thread.

    ``terminal`` None: the terminal is asked on entering, and given ``timeout`` s to begin to
    answer (None: as the link needs, see :func:`~tsplat.terminal.device.patience`); later answers
    still come in, as the event "terminal". ``cleanup`` is written before the screen is left; a
    presenter's ``clear`` belongs there.

    Frames are written while events are waited for, as fast as the tty takes them: a slow terminal
    keeps nobody waiting, and what it has not taken can be taken back.

    Raises:
        TerminalError: on entering, when there is no terminal.
    """

    def __init__(
        self,
        fd_in: int = 0,
        fd_out: int = 1,
        environ: Mapping[str, str] | None = None,
        terminal: Terminal | None = None,
        mouse: bool = True,
        timeout: float | None = None,
    ) -> None:
        self.terminal = terminal or Terminal()
        self.cleanup = b""
        self.max_rate: float | None = None  # bytes/s of frames at most
        self.watched: int | None = None  # descriptor; the event "watched" while it can be read
        self._asked = terminal is not None
        self._in, self._out, self._mouse = fd_in, fd_out, mouse
        self._on: tuple[tuple[bytes, bytes], ...] = ()  # modes, in the order they are undone
        self._environ = os.environ if environ is None else environ
        self._timeout = device.patience(self._environ) if timeout is None else timeout
        self._sharing = Sharing(self._environ)
        self._decoder = Decoder()
        self._queue: list[Event] = []
        self._heard_first = device.Heard(b"")
        self._said = b""  # answers so far, kept while the last is missing
        self._answering = terminal is not None  # the terminal answers queries
        self._saved: device.Attributes | None = None  # the tty's mode before us; None: not ours
        self._pid = 0
        self._handlers: dict[int, Any] = {}
        self._wake: tuple[int, int] | None = None  # pipe: signal handlers write, select sees it
        self._signal = 0  # deadly, noted
        self._noted: set[int] = set()  # SIGWINCH, SIGTSTP, SIGCONT to be dealt with
        self._waiting = False  # in a call that a signal may interrupt
        self._leaving = False
        self._unanswered = self._overdue = self._given_up = 0  # status reports
        self._sent = self._heard = 0.0  # s, monotonic: last output of a tracked frame, last input
        self._answered = False  # a status report, ever
        self._lost = False  # one past tmux, since the last key
        self.link = Link()
        self.flights: deque[Flight] = deque()  # of frames acknowledged, until somebody takes them
        self._updates: deque[_Update] = deque()  # tracked, on their way
        self._to_tell = False  # a tracked frame was drawn, and no "ready" has come since
        self._nudges: deque[float] = deque()  # s, monotonic, when something harmless is sent
        self._patient: int | None = None  # writes to it do not block
        self._rest: deque[memoryview] = deque()  # output that the tty has not taken yet
        self._free_at = 0.0  # s, monotonic: when ``max_rate`` lets more of it go
        self._posted: deque[Event] = deque()  # by other threads

    # --- entering and leaving

    def __enter__(self) -> Self:
        if not device.can_show(self._in, self._out, self._environ):
            raise TerminalError(
                "expected a terminal as input and output, got "
                + ("TERM=dumb" if os.isatty(self._out) else "a pipe or file")
                + ". Write pictures to files instead, or run it in a terminal."
            )
        self._pid = os.getpid()
        self._wake = os.pipe()
        for end in self._wake:
            os.set_blocking(end, False)
        atexit.register(self._restore)
        self._install_handlers()
        try:
            self._take()
            self._patient = device.open_patient(self._out)
            if not self._asked:
                self._ask()
            self.terminal = resized(self.terminal, device.window_size(self._out))
            self._set_modes()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._restore()
        self._remove_handlers()
        atexit.unregister(self._restore)
        if self._patient is not None:
            os.close(self._patient)
            self._patient = None
        if self._wake is not None:
            for end in self._wake:
                os.close(end)
            self._wake = None
        if self._signal and error is None:
            raise Terminated(self._signal)

    def _take(self) -> None:
        """Raw mode and the alternate screen."""
        self._saved = termios.tcgetattr(self._in)
        device.set_raw(self._in)
        device.write_all(self._out, ENTER_ALTERNATE)

    def _set_modes(self) -> None:
        device.write_all(self._out, HIDE_CURSOR + self._switched() + cleared(self.terminal))

    def _wanted(self) -> tuple[tuple[bytes, bytes], ...]:
        """The modes that this terminal is to have, in the order in which they are undone."""
        if not self._mouse:
            return ()
        facts = self.terminal
        modes = (
            (KEYS, facts.keyboard), (PIXELS, facts.pixel_mouse), (MOUSE, True), (FOCUS, True),
            (SIZES, facts.in_band_resize),
        )  # fmt: skip
        return tuple(mode for mode, wanted in modes if wanted)

    def _switched(self) -> bytes:
        """What makes the modes that are on those that are wanted. Never is one on twice."""
        off, self._on = self._undone(), self._wanted()
        self._decoder.keyboard = KEYS in self._on
        return off + b"".join(on for on, _ in reversed(self._on))

    def _undone(self) -> bytes:
        """What switches the modes off."""
        off, self._on = b"".join(off for _, off in self._on), ()
        self._decoder.keyboard = False
        return off

    def _ask(self) -> None:
        begun = time.monotonic()
        heard = device.ask(self._in, self._out, self._environ, self._sharing, self._timeout)
        self._heard_first = heard
        self._said = heard.answers
        self._answering = DA1_ANSWER.search(self._said) is not None
        if self._answering:
            self.link.pinged(time.monotonic() - begun, heard.asked)
        self._understand()
        self._queue += self._decoder.feed(heard.typed)

    def _understand(self) -> None:
        """The terminal's facts from what it has said so far."""
        heard = replace(self._heard_first, answers=self._said)
        size = device.window_size(self._out)
        self.terminal = self._sharing.shared_by(heard.terminal(self._environ, size))
        self.link.remote = self.terminal.remote
        if self._answering:
            self._sharing.close()  # of what was asked, all that will be taken has been

    def _restore(self) -> None:
        """Everything as it was; harmless when it is already, and in a forked child."""
        if self._saved is None or os.getpid() != self._pid:
            return
        self._leaving = True
        saved, self._saved = self._saved, None
        undo = STRING_END if self._rest else b""  # of a picture that is sent in part
        self._rest.clear()
        undo += END_UPDATE + STRING_END + self.cleanup + self._undone()
        undo += scrolled_out(self.terminal)  # else the next program there would be slow
        undo += PLAIN + SHOW_CURSOR + LEAVE_ALTERNATE
        seconds = BUSY_SECONDS if self._answered and self._answering else LEAVE_SECONDS
        try:
            if device.write_all(self._writable, undo + DA1, seconds) and self._answering:
                device.read_answers(self._in, seconds)  # else the shell would get them
        except OSError:
            pass  # the terminal is gone
        finally:
            self._sharing.close()
            device.set_attributes(self._in, saved)
            self._leaving = False

    def suspend(self) -> None:
        """Gives the terminal back and stops the process group, as Ctrl+Z does outside raw mode.

        Returns when the shell continues us: then the screen is ours again, cleared, and the event
        "resize" asks for a full redraw.
        """
        self._restore()
        previous = signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        try:
            os.kill(0, signal.SIGTSTP)
        finally:
            signal.signal(signal.SIGTSTP, previous)
        self._noted.clear()
        self._take()
        self._again()

    def _again(self) -> None:
        """Sets the modes and asks for a redraw: who knows what happened meanwhile."""
        self._set_modes()
        self._unanswered = self._overdue = 0
        self.link.lost()
        self._updates.clear()
        self._resize()

    def _resize(self) -> None:
        self.terminal = resized(self.terminal, device.window_size(self._out))
        self._queue.append(Event("resize"))

    # --- signals

    def _install_handlers(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            return  # Python allows it nowhere else
        for signum in _DEADLY:
            if signal.getsignal(signum) is signal.SIG_IGN:
                continue  # nohup and the like
            self._handlers[signum] = signal.signal(signum, self._on_deadly)
        for signum in (signal.SIGWINCH, signal.SIGTSTP, signal.SIGCONT):
            self._handlers[signum] = signal.signal(signum, self._on_note)

    def _remove_handlers(self) -> None:
        for signum, handler in self._handlers.items():
            signal.signal(signum, signal.SIG_DFL if handler is None else handler)
        self._handlers.clear()

    def _on_deadly(self, signum: int, frame: FrameType | None) -> None:
        again, self._signal = bool(self._signal), signum
        self._wake_up()
        if not self._leaving and (again or self._waiting):
            raise Terminated(signum)

    def _on_note(self, signum: int, frame: FrameType | None) -> None:
        self._noted.add(signum)
        self._wake_up()

    def _wake_up(self) -> None:
        if self._wake is not None:
            with contextlib.suppress(OSError):
                os.write(self._wake[1], b"\0")

    @contextlib.contextmanager
    def _interruptible(self) -> Any:
        self._waiting = True  # before the check, so that no signal falls in between
        try:
            if self._signal:
                raise Terminated(self._signal)
            yield
        except OSError as error:
            raise Terminated(signal.SIGHUP) from error  # EIO: the terminal is gone
        finally:
            self._waiting = False

    # --- output

    def write(self, data: bytes) -> None:
        """All of ``data``, now, after what is still to be written.

        Raises:
            Terminated: a deadly signal came, or the terminal is gone.
        """
        with self._interruptible():
            self._rest.append(memoryview(data))
            while self._rest:
                waits = self._held_until < math.inf  # no answer is heard here
                self._pump(waits)
                if self._rest and waits and time.monotonic() < self._held_until:
                    time.sleep(BURST_SECONDS)
                elif self._rest:
                    select.select([], [self._writable], [])

    def _send(self, data: bytes) -> None:
        """What the tty takes of ``data`` now; the rest goes while events are waited for."""
        with self._interruptible():
            self._rest.append(memoryview(data))
            self._pump()

    @property
    def _writable(self) -> int:
        return self._out if self._patient is None else self._patient

    def _pump(self, waits: bool = True) -> None:
        """Writes what the tty takes without being waited for, or a piece of it if it must be.

        What is to wait only if it ``waits``.
        """
        while self._rest:
            now = time.monotonic()
            if waits and now < self._held_until:
                return
            part = int(max(PIECE, min(len(self._rest[0]), self.link.room(now))))
            if self.max_rate:
                part = min(part, max(PIECE, int(self.max_rate * BURST_SECONDS)))
            first = self._rest.popleft()
            if self._patient is not None:
                taken = device.write_some(self._patient, first[:part])
            elif select.select([], [self._out], [], 0)[1]:
                taken = device.write_some(self._out, first[: min(part, PIECE)])
            else:
                taken = 0
            if taken < len(first):
                self._rest.appendleft(first[taken:])
            if not taken:
                return
            self.link.wrote(now, taken)
            if self.max_rate:
                self._free_at = max(self._free_at, now - BURST_SECONDS) + taken / self.max_rate

    @property
    def _held_until(self) -> float:
        """When more may be written, in monotonic s."""
        return max(self._free_at, self.link.opens)

    def abandon(self) -> bool:
        """Ends the frame that is being written where it is. False if all is written already.

        The screen then shows who knows what; the terminal's answer is waited for as ever.
        """
        if not self._rest:
            return False
        self._rest.clear()
        dropped = self.link.cut()  # None: its question has been sent
        if dropped:
            self._unanswered -= dropped
            self._updates[-1].parts -= dropped
        self._send(STRING_END + END_UPDATE + PLAIN + STATUS_REPORT * (dropped is not None))
        return True

    def post(self, event: Event) -> None:
        """Puts ``event`` among those that are read, and ends a wait for them. From any thread."""
        self._posted.append(event)
        self._wake_up()

    def clear(self) -> None:
        """Nothing on the screen, cursor at its top left. Pictures of kitty's go, too."""
        self._send(cleared(self.terminal))

    def draw(self, payload: bytes, track: bool = True) -> None:
        """One synchronized update, from the top left cell on; b"" writes nothing.

        Where the link is slow a large picture, if it is of many sequences, is several of them.

        Returns at once; what the tty does not take now is written while events are read. With
        ``track`` the terminal is asked to report when it is through: see ``busy`` and ``flight``.

        Raises:
            Terminated: a deadly signal came, or the terminal is gone.
        """
        if not payload:
            return
        data = BEGIN_UPDATE + HOME + payload + END_UPDATE
        now = time.monotonic()
        if not track:
            self._send(data)
        elif self._answering:
            # tmux would answer at once, however far behind the terminal around it is
            question = through_tmux(STATUS_REPORT) if self._passed else STATUS_REPORT
            parts = [
                BEGIN_UPDATE + part + END_UPDATE + question
                for part in in_parts(HOME + payload, self.link.part)
            ]
            self._sent, self._to_tell = now, True
            self._unanswered += len(parts)
            self._updates.append(_Update(len(parts)))
            behind = sum(map(len, self._rest))
            for part in parts:
                self.link.begin(now, len(part), behind)
                behind += len(part)
            self._send(b"".join(parts))
        else:
            self._queue.append(Event("ready"))
            self._send(data)
        # kitty 0.48 shows a window's first picture only when something follows once it has drawn
        now = time.monotonic()
        self._nudges = deque(now + s for s in NUDGES_SECONDS if self.terminal.kitty)

    @property
    def busy(self) -> bool:
        """Whether a tracked frame sent now would only queue up behind those on their way."""
        return bool(self._rest) or self.free_in > 0

    @property
    def far(self) -> bool:
        """Whether a network is in between, as far as is known."""
        return self.terminal.remote or self.link.far

    @property
    def waiting(self) -> bool:
        """Whether any tracked frame is to be answered yet."""
        return self._unanswered > 0

    @property
    def free_in(self) -> float:
        """Seconds until another tracked frame may go, as far as is known; infinite at worst."""
        if not self._unanswered:
            return 0.0
        now = time.monotonic()
        wait = self.link.wait(now, sum(map(len, self._rest)))
        return max(0.0, min(self._sent + self._limit - now, wait))

    @property
    def _passed(self) -> bool:
        """Whether pictures, and questions about them, go past a tmux, which may lose them.

        It was seen to, now and then (3.3a); and answers go to the pane that keys go to. So after a
        loss tmux itself is asked, until a key comes.
        """
        return self.terminal.kitty and bool(self.terminal.around) and not self._lost

    @property
    def _limit(self) -> float:
        if self._answered:
            local = self._passed and not self.far
            return FRAME_SECONDS + self.link.under_way / PASSED if local else PATIENCE_SECONDS
        return FRAME_SECONDS + self.link.under_way / SLOWEST

    # --- input

    def read_events(self, timeout: float | None) -> list[Event]:
        """Events, as soon as there are any; [] after ``timeout`` s (0: do not wait; None: do).

        Raises:
            Terminated: a deadly signal came, or the terminal is gone.
        """
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            with self._interruptible():
                self._wait(0.0 if self._queue else end)
            if self._noted:
                self._deal_with_notes()
            self._on_time()
            if self._queue or (end is not None and time.monotonic() >= end):
                events, self._queue = self._queue, []
                return events

    def _wait(self, end: float | None) -> None:
        """Until input, a signal, ``end`` or the next thing to do by the clock."""
        ends = [*self._nudges, *([] if end is None else [end])]
        if self._unanswered:
            ends.append(self._sent + self._limit)
            if self._to_tell and not self._rest:
                ends.append(time.monotonic() + self.free_in)
        if self._decoder.pending:
            ends.append(self._heard + ESCAPE_SECONDS)
        opens = self._held_until
        held_back = bool(self._rest) and time.monotonic() < opens
        writable = [self._writable] if self._rest and not held_back else []
        held_back = held_back and opens < math.inf  # else an answer comes first
        if held_back:
            ends.append(opens)
        limit = max(0.0, min(ends) - time.monotonic()) if ends else None
        wake = self._wake[0] if self._wake is not None else self._in
        watched = [] if self.watched is None else [self.watched]
        readable, writable, _ = select.select([self._in, wake, *watched], writable, [], limit)
        if wake in readable and wake != self._in:
            with contextlib.suppress(BlockingIOError):
                os.read(wake, READ_SIZE)
        while self._posted:
            self._queue.append(self._posted.popleft())
        if writable or held_back:
            self._pump()
            if not self._rest and not self._unanswered:
                self._queue.append(Event("ready"))
            self._sent = time.monotonic()  # the terminal's time begins when it has everything
        if self._in in readable:
            with contextlib.suppress(BlockingIOError):
                data = os.read(self._in, READ_SIZE)
                if not data:
                    raise Terminated(signal.SIGHUP)
                self._heard, facts = time.monotonic(), self.terminal
                cell = facts.cell_width, facts.cell_height
                self._decoder.cell = cell if PIXELS in self._on else None
                self._take_in(self._decoder.feed(data))
        if self.watched in readable:
            self._queue.append(Event("watched"))

    def _take_in(self, events: list[Event]) -> None:
        for event in events:
            if event.kind == "resize":
                self._take_size(event)
                continue
            self._lost &= event.kind not in ("key", "mouse")
            if event.kind != "ready":
                self._queue.append(event)
            elif self._overdue:
                self._overdue -= 1  # of a frame given up: it is slow, but it answers
                self._answered = self._answering = True
                self._given_up = 0
            elif self._unanswered:
                self._unanswered, self._given_up = self._unanswered - 1, 0
                self._answered = True
                if flight := self.link.answered(self._heard):
                    self._take_flight(flight)
                if not self.busy:
                    self._to_tell = False
                    self._queue.append(event)
        if answers := bytes(self._decoder.answers):
            self._decoder.answers.clear()
            if not self._answering:
                self._said += answers
                if DA1_ANSWER.search(self._said):  # at last
                    self._answering = True
                    self._understand()
                    self._queue.append(Event("terminal"))

    def _take_flight(self, flight: Flight) -> None:
        """A part got through, and by that perhaps all of them."""
        update = self._updates[0]
        if not update.flights:
            update.begun = self._heard - flight.seconds
        update.flights.append(flight)
        if len(update.flights) == update.parts:
            self._updates.popleft()
            self.flights.append(joined(update.flights, self._heard - update.begun))

    def _take_size(self, told: Event) -> None:
        """A size told in-band, if it is one, and news: SIGWINCH may have been here before."""
        assert told.size is not None
        facts, self.terminal = self.terminal, told_size(self.terminal, told.size)
        if self.terminal != facts:
            self._queue.append(told)

    def _on_time(self) -> None:
        now = time.monotonic()
        if self._on != self._wanted() and not self._rest:  # late answers; never amid a frame
            self.write(self._switched())
        if self._decoder.pending and now >= self._heard + ESCAPE_SECONDS:
            self._queue += self._decoder.flush()
            self._heard = now
        if self._unanswered and now >= self._sent + self._limit and self._passed:
            self._lost = True
            self._give_up()  # it does not come any more, nor may the picture have come
            self._queue.append(Event("resize"))
        elif self._unanswered and now >= self._sent + self._limit:
            self._overdue += self._unanswered
            self._given_up += 1
            self._answering = self._given_up < GIVE_UPS
            self._give_up()
            self._queue.append(Event("ready"))
        elif self._to_tell and not self.busy:
            self._to_tell = False
            self._queue.append(Event("ready"))
        if self._nudges and now >= self._nudges[0]:
            while self._nudges and now >= self._nudges[0]:
                self._nudges.popleft()
            self._send(PLAIN)

    def _give_up(self) -> None:
        """Waits no longer for the answers to frames that are on their way."""
        self._unanswered = 0
        self._updates.clear()
        self.link.lost()
        self._to_tell = False

    def _deal_with_notes(self) -> None:
        noted, self._noted = self._noted, set()
        if signal.SIGTSTP in noted:
            self.suspend()
        elif signal.SIGCONT in noted:  # after a SIGSTOP, which nobody can catch
            device.set_raw(self._in)
            device.write_all(self._out, (STRING_END if self._rest else b"") + ENTER_ALTERNATE)
            self._rest.clear()
            self._again()
        elif signal.SIGWINCH in noted:
            size = device.window_size(self._out)
            if SIZES not in self._on or resized(self.terminal, size) != self.terminal:
                self._resize()
