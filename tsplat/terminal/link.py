"""What a link to a terminal takes, learnt from frames and the terminal's answers.

Nothing here reads a clock or writes: times are given, in s. A link is a bottleneck of so many
bytes/s and a way of so many s, and the two are told apart, as BBR does (Cardwell and others, "BBR:
congestion-based congestion control", ACM Queue 14(5), 2016): the way costs a frame time, but keeps
no other waiting. A frame keeps the bottleneck busy from the answer to the one before it, or from
when its own first bytes can have been answered, to its answer.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

FAR = 0.020  # s of latency from which a terminal counts as far; on this machine it takes less
AHEAD = 0.015  # s before the bottleneck runs dry the next frame may go: timers are not exact
PACED = 0.050  # s of bytes that are given to it at a time: what a key may find in its way
PIECE_SECONDS = 0.01  # s of bytes that are worth writing
SAMPLES = 8  # frames that the rate is of
LEAST = 1000  # bytes; what takes no time on the way says nothing about the rate
GROWTH = 1.5  # of the rate, where the link was faster than believed
SLOWEST = 1e3  # bytes/s; no link is believed to be slower
SHORTEST = 1e-4  # s that a frame takes; clocks are not better


@dataclass(frozen=True)
class Flight:
    """How a tracked frame got through."""

    sent: int  # bytes
    seconds: float  # from the first byte's write until the terminal's answer was here
    occupied: float  # of these the link was busy with it, and with no other


@dataclass
class _Frame:
    begun: float
    size: int
    left: int  # bytes to be written until its end is
    ended: float = math.inf  # when that was written

    @property
    def written(self) -> int:
        return self.size - min(self.size, self.left)


class Link:
    """Frames on their way, and when there is room for another."""

    def __init__(self) -> None:
        self.latency: float | None = None  # s, the shortest way there and back; None: unknown
        self.remote = False  # known to be far, whatever the latency
        self._flying: deque[_Frame] = deque()
        self._answered = -math.inf  # the last answer
        self._samples: deque[tuple[int, float]] = deque(maxlen=SAMPLES)  # bytes, s
        # When the bottleneck has sent what it was given, if ``rate`` is right
        self._drained = -math.inf

    @property
    def far(self) -> bool:
        """Whether a second frame may be sent while the first is on its way."""
        return self.latency is not None and (self.remote or self.latency >= FAR)

    @property
    def rate(self) -> float | None:
        """Bytes/s, over the last frames but the slowest; None: unknown."""
        counted = sorted(self._samples, key=lambda sample: sample[0] / sample[1])
        counted = counted[len(counted) > 2 :]
        seconds = sum(sample[1] for sample in counted)
        return max(SLOWEST, sum(sample[0] for sample in counted) / seconds) if counted else None

    def pinged(self, seconds: float) -> None:
        """Something small was answered after ``seconds``."""
        self.latency = seconds if self.latency is None else min(self.latency, seconds)

    # --- what is written

    def begin(self, now: float, size: int, behind: int = 0) -> None:
        """A frame that will be answered is to be written, behind so many bytes."""
        self._flying.append(_Frame(now, size, behind + size))

    def wrote(self, now: float, count: int) -> None:
        """The tty took so many bytes."""
        if self._flying and self._flying[-1].left:
            last = self._flying[-1]
            last.left = max(0, last.left - count)
            last.ended = math.inf if last.left else now
        if self.rate:
            self._drained = max(self._drained, now) + count / self.rate

    def cut(self) -> bool:
        """The frame begun last ends where it is. False if it had ended already."""
        if not self._flying or not self._flying[-1].left:
            return False
        last = self._flying[-1]
        last.size, last.left, last.ended = last.written, 0, math.inf
        return True

    def answered(self, now: float) -> Flight | None:
        """The oldest frame has been taken in; None if there is none."""
        if not self._flying:
            return None
        frame = self._flying.popleft()
        seconds = now - frame.begun
        if self.latency is not None:  # frames alone do not tell it from their own length
            self.pinged(seconds)
        free = frame.begun + (self.latency or 0.0) if self.far else frame.begun
        occupied = max(now - max(free, self._answered), SHORTEST)
        self._answered = now
        if self.far and self._starved(frame, now):
            occupied /= GROWTH
            self._samples.clear()  # they say what it was
        if frame.size >= LEAST:
            self._samples.append((frame.size, occupied))
        if self.rate:  # what is under way by now is on its way to be answered, or still waits
            rest = now + self.under_way / self.rate
            self._drained = min(max(self._drained, rest - (self.latency or 0.0)), rest)
        return Flight(frame.size, seconds, occupied)

    def _starved(self, frame: _Frame, now: float) -> bool:
        """Whether the bottleneck waited for what :attr:`opens` held back: it takes more than that.

        At the right rate it has ``PACED`` s to do when the end of a frame is written.
        """
        held_back = PACED < frame.ended - frame.begun < math.inf
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
        if len(self._flying) > len(self._samples):  # the more is known, the more may go
            return math.inf
        frame = self.under_way / len(self._flying)
        if self.under_way > rate * (self.latency + AHEAD) + frame:
            return math.inf
        return max(0.0, max(self._drained, now) + more / rate - AHEAD - now)

    def room(self, now: float) -> float:
        """Bytes that may be written now, so that what follows can still be taken back."""
        if not self.far or not self.rate:
            return math.inf
        return max(0.0, (PACED - max(0.0, self._drained - now)) * self.rate)

    @property
    def opens(self) -> float:
        """When there is room for a piece worth writing."""
        return self._drained - PACED + PIECE_SECONDS if self.far else -math.inf
