"""What a link to a terminal takes, learnt from frames and the terminal's answers.

Nothing here reads a clock or writes: times are given, in s. A link is a bottleneck of so many
bytes/s and a way of so many s, and the two are told apart, as BBR does (Cardwell and others, "BBR:
congestion-based congestion control", ACM Queue 14(5), 2016): the way costs a frame time, but keeps
no other waiting.

Behind another frame, one keeps the bottleneck busy from that one's answer to its own: the way is
in neither. Of a frame that finds nothing else on its way it is known how much longer it took than
what was answered soonest, and how many more bytes it has. An answer that comes late makes its frame
seem slow, and as much too quick those that were under way by then: they are measured together.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

FAR = 0.020  # s of latency from which a terminal counts as far; on this machine it takes less
AHEAD = 0.015  # s before the bottleneck runs dry the next frame may go: timers are not exact
PACED = 0.050  # s of bytes that are given to it at a time: what a key may find in its way
PIECE_SECONDS = 0.01  # s of bytes that are worth writing
SAMPLES = 8  # that the rate is of
LEAST_PART = 4096  # bytes; a report for less is not worth while
LEAST = 1000  # bytes; what takes no time on the way says nothing about the rate
STALLED = 0.7  # of the others' rate: what is slower was held up by something else
GROWTH = 1.5  # of the rate at most, where the link was faster than believed
HASTE = 4  # times as much growth as before, where it was so again
SLOWEST = 1e3  # bytes/s; no link is believed to be slower
SHORTEST = 1e-4  # s that a frame takes; clocks are not better


@dataclass(frozen=True)
class Flight:
    """How a tracked frame got through."""

    sent: int  # bytes
    seconds: float  # from the first byte's write until the terminal's answer was here
    occupied: float  # of these the link was busy with it, and with no other


def joined(flights: Sequence[Flight], seconds: float) -> Flight:
    """Of a frame whose parts got through one after another, in so many ``seconds``."""
    return Flight(sum(f.sent for f in flights), seconds, sum(f.occupied for f in flights))


@dataclass
class _Frame:
    begun: float  # when its first byte was written; before that, when it was to be
    size: int
    behind: int  # bytes, no frame's, to be written before it
    left: int  # bytes of it to be written
    ended: float = math.inf  # when the last of them was

    @property
    def written(self) -> int:
        return self.size - self.left


@dataclass
class _Sample:
    """So many bytes in so many s."""

    size: int
    seconds: float
    answered: float  # when the first of its frames was

    @property
    def rate(self) -> float:
        return self.size / self.seconds


def _mean(samples: Sequence[_Sample]) -> float:
    return sum(s.size for s in samples) / sum(s.seconds for s in samples)


class Link:
    """Frames on their way, and when there is room for another."""

    def __init__(self) -> None:
        self.latency: float | None = None  # s, the shortest way there and back; None: unknown
        self.remote = False  # known to be far, whatever the latency
        self._least = 0  # bytes that took only ``latency``
        self._flying: deque[_Frame] = deque()
        self._answered = -math.inf  # the last answer
        self._samples: deque[_Sample] = deque(maxlen=SAMPLES)
        self._small: _Sample | None = None  # the last, if it was too small for one
        self._hungry = 0  # frames in a row that the bottleneck had to wait for
        # When the bottleneck has sent what it was given, if ``rate`` is right
        self._drained = -math.inf

    @property
    def far(self) -> bool:
        """Whether a second frame may be sent while the first is on its way."""
        return self.latency is not None and (self.remote or self.latency >= FAR)

    @property
    def rate(self) -> float | None:
        """Bytes/s, over the last samples but one that was held up; None: unknown."""
        if not self._samples:
            return None
        slowest, *others = sorted(self._samples, key=lambda sample: sample.rate)
        if len(others) > 1 and slowest.rate < STALLED * _mean(others):
            return max(SLOWEST, _mean(others))
        return max(SLOWEST, _mean(self._samples))

    def pinged(self, seconds: float, size: int = 0) -> None:
        """So many bytes were answered after ``seconds``."""
        if self.latency is None or seconds < self.latency:
            self.latency, self._least = seconds, size

    # --- what is written

    def begin(self, now: float, size: int, behind: int = 0) -> None:
        """A frame that will be answered is to be written, behind so many bytes."""
        frames = sum(frame.behind + frame.left for frame in self._flying)
        self._flying.append(_Frame(now, size, max(0, behind - frames), size))

    def wrote(self, now: float, count: int) -> None:
        """The tty took so many bytes."""
        left = count
        for frame in self._flying:
            before = min(left, frame.behind)
            frame.behind, left = frame.behind - before, left - before
            part = min(left, frame.left)
            if not part:
                continue
            if not frame.written:
                frame.begun = now
            frame.left, left = frame.left - part, left - part
            if not frame.left:
                frame.ended = now
        if self.rate:
            self._drained = max(self._drained, now) + count / self.rate

    def cut(self) -> int | None:
        """The frame that is being written ends where it is, and none that is behind it will come.

        How many these are. None if all had ended.
        """
        place = next((n for n, frame in enumerate(self._flying) if frame.left), None)
        if place is None:
            return None
        frame, dropped = self._flying[place], len(self._flying) - place - 1
        frame.size, frame.behind, frame.left = frame.written, 0, 0
        for _ in range(dropped):
            self._flying.pop()
        return dropped

    def answered(self, now: float) -> Flight | None:
        """The oldest frame has been taken in; None if there is none."""
        if not self._flying:
            return None
        frame = self._flying.popleft()
        seconds, occupied = now - frame.begun, self._measure(frame, now)
        if self.latency is not None:  # frames alone do not tell it from their own length
            self.pinged(seconds, frame.size)
        self._answered = now
        if rate := self.rate:  # what is under way by now is on its way to be answered, or waits
            rest = now + self.under_way / rate
            self._drained = min(max(self._drained, rest - (self.latency or 0.0)), rest)
        return Flight(frame.size, seconds, max(occupied, SHORTEST))

    def _measure(self, frame: _Frame, now: float) -> float:
        """Seconds that the bottleneck was busy with ``frame``, answered now. Takes a sample."""
        latency = self.latency if self.far and self.latency is not None else 0.0
        small, self._small = self._small, None
        if latency and frame.begun + latency > self._answered:
            size, seconds = frame.size - self._least, now - frame.begun - latency
            self._take(frame, size, seconds, now)
            rate = self.rate
            return seconds + (min(self._least, frame.size) / rate if rate else 0.0)
        size, seconds = frame.size, now - max(frame.begun, self._answered)
        if small is not None:
            self._take(frame, size + small.size, seconds + small.seconds, now)
        elif not self._together(frame, seconds):
            self._take(frame, size, seconds, now)
        return seconds

    def _together(self, frame: _Frame, seconds: float) -> bool:
        """Adds ``frame`` to the sample before it, if a late answer is why it seems the quicker."""
        if not self.far or not self._samples:
            return False
        last = self._samples[-1]
        if frame.begun >= last.answered or frame.size <= last.rate * seconds:
            return False
        last.size, last.seconds = last.size + frame.size, last.seconds + seconds
        return True

    def _take(self, frame: _Frame, size: int, seconds: float, now: float) -> None:
        """``size`` bytes, ``frame`` the last of them, took the bottleneck so many ``seconds``."""
        sample = _Sample(max(0, size), max(seconds, SHORTEST), now)
        if size < LEAST or seconds <= 0:
            self._small = sample if self.far else None
            if size >= LEAST and not self._samples:  # as quick as the least: no slower than this
                self._samples.append(_Sample(frame.size, now - frame.begun, now))
            return
        if self._starved(frame, now):
            # it takes more than it was given: PACED s of bytes, at least, in that time
            share = PACED / (frame.ended - frame.begun) * HASTE**self._hungry
            sample.seconds /= min(GROWTH, 1 + share)
            self._hungry += 1
            self._samples.clear()  # they say what it was
        else:
            self._hungry = 0
        self._samples.append(sample)

    def _starved(self, frame: _Frame, now: float) -> bool:
        """Whether the bottleneck waited for what :attr:`opens` held back: it takes more than that.

        At the right rate it has ``PACED`` s to do when the end of a frame is written.
        """
        held_back = self.far and PACED < frame.ended - frame.begun < math.inf
        return held_back and now - frame.ended - (self.latency or 0.0) < PIECE_SECONDS

    def lost(self) -> None:
        """No answers come to what is under way, and nobody knows what has become of it."""
        self._flying.clear()
        self._drained = -math.inf

    # --- what may be

    @property
    def under_way(self) -> int:
        """Bytes written and not answered."""
        return sum(frame.written for frame in self._flying)

    def wait(self, now: float, more: int = 0) -> float:
        """Seconds until another frame may go; infinite: not before an answer.

        ``more`` bytes are still to be written before it.

        It may when the bottleneck is about to have nothing to do. If answers fail to come, no more
        than fits into the way, and a frame, is under way.
        """
        if not self._flying:
            return 0.0
        rate = self.rate
        if not self.far or not rate or self.latency is None:
            return math.inf
        flying = sum(frame.written > 0 for frame in self._flying)
        if flying > len(self._samples):  # the more is known, the more may go
            return math.inf
        frame = self.under_way / max(1, flying)
        if self.under_way > rate * (self.latency + AHEAD) + frame:
            return math.inf
        return max(0.0, max(self._drained, now) + more / rate - AHEAD - now)

    def room(self, now: float) -> float:
        """Bytes that may be written now, so that what follows can still be taken back."""
        if not self.far or not self.rate:
            return math.inf
        paced = (PACED - max(0.0, self._drained - now)) * self.rate
        return max(0.0, min(paced, self._unasked))

    @property
    def _unasked(self) -> float:
        """Bytes that may be written before the next answer.

        As many as fit into the way, if that is as long as it was, and one frame.
        """
        rate = self.rate
        if not self._flying or self._flying[0].left or not rate or self.latency is None:
            return math.inf
        fits = rate * (self.latency + PACED + AHEAD) + self._flying[0].size
        return fits - self.under_way

    @property
    def opens(self) -> float:
        """When there is room for a piece worth writing; infinite: not before an answer."""
        rate = self.rate
        if not self.far or not rate:
            return -math.inf
        if self._unasked < PIECE_SECONDS * rate:
            return math.inf
        return self._drained - PACED + PIECE_SECONDS

    @property
    def part(self) -> float:
        """Bytes of a large picture that are to be answered for themselves.

        So that what it finds on its way is heard of before it is all sent.
        """
        return max(LEAST_PART, PACED * self.rate) if self.far and self.rate else math.inf
