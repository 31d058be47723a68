"""How many pixels a moving picture has, and how often a new one is begun.

A level is a share of the pixels each way, and for links that are slow so many shades of each colour
channel. What a frame takes is remembered by level: of render,
encode and flight (how long it keeps the link busy) the slowest, or half of all three if that is
more. If it is no more than a frame's time, the stages keep up with each other, and a key's picture
is there within three frames' time, one until the next frame is begun, two for the stages; and the
way there and back, which no level makes shorter.

Over a network there are more levels, beyond the coarsest that one likes to look at. They come in
only where frames would take longer than ``SLOW``: what is slower does not look like motion.
"""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median_high, median_low

LEVELS = (1.0, 0.75, 0.5, 0.375, 0.25, 0.1875, 0.125)
SHORTEST = 32  # px: none of them makes a side shorter that is not so already
DEAR = (2, 4, 8, 16, 32)  # where bytes are dear: one px for so many each way, with each of SHADES
DEAR_SHORTEST = 8  # px
SHADES = {16: 0.4, 8: 0.26}  # how many of a channel: what is left of the bytes, kitty's and cells'
SLOW = 0.1  # s a frame
PREVIEW = 80_000  # px of the first picture, when nothing is known of link and scene
SAMPLES = 3  # of a level: their median counts, so that one hiccup does not
STALE_SECONDS = 5.0  # for what was measured before: another view, another load
FAR_STALE_SECONDS = 30.0  # over a network, where to try what is too slow costs more
FORGOTTEN = 5  # times as old
HEADROOM = 0.8  # of a frame's time, at which a finer level is tried
GAIN = 1.35  # a level is left for coarser ones only if it takes so much longer than the coarsest
REGAIN = 1.2  # and come back to if it takes no more than that
PATIENCE = 0.5  # s, for the next step of a picture that stands still
LINK_SAMPLES = 8


@dataclass
class _Level:
    share: float
    shades: int | None  # None: all
    block: int | None  # px of the full size that one stands for, each way; None: in no such raster
    pixels: float  # as many as take the same time
    loads: deque[float] = field(default_factory=lambda: deque(maxlen=SAMPLES))  # s
    flights: deque[float] = field(default_factory=lambda: deque(maxlen=SAMPLES))  # s, of these
    noted: float = 0.0  # s, of the clock


@dataclass(frozen=True)
class Link:
    """How frames got to the terminal."""

    seconds: float  # a frame, until the terminal answered
    rate: float  # bytes/s while the link was busy


class Pace:
    """The level of moving pictures of ``size`` px, so that there are ``fps`` of them in a second.

    0 is the full size. ``clock`` is in s. ``far``: a network is in between, so the first picture
    is a small one.
    """

    def __init__(
        self,
        size: tuple[int, int],
        fps: float,
        clock: Callable[[], float] = time.monotonic,
        far: bool = False,
    ) -> None:
        self.period, self._clock, self._size = 1 / fps, clock, size
        self._stale = FAR_STALE_SECONDS if far else STALE_SECONDS
        pixels = size[0] * size[1]
        fine = [s for s in LEVELS if s == 1 or min(size) * s >= SHORTEST]
        self._levels = [_Level(s, None, None, pixels * s * s) for s in fine]
        dear = [n for n in DEAR if min(size) >= DEAR_SHORTEST * n] if far else []
        for block, (shades, left) in itertools.product(dear, SHADES.items()):
            worth = pixels / block**2 * left
            if worth < self._levels[-1].pixels:
                self._levels.append(_Level(1 / block, shades, block, worth))
        self._fine = len(fine)
        self._link: deque[tuple[int, float, float]] = deque(maxlen=LINK_SAMPLES)
        self._made: deque[float] = deque(maxlen=LINK_SAMPLES)
        small = [n for n in range(len(fine)) if self._levels[n].pixels <= PREVIEW]
        self.level = small[0] if small and not far else self._fine - 1

    def size(self, level: int) -> tuple[int, int]:
        """(width, height) in px of a picture at ``level``."""
        row = self._levels[level]
        if row.block is not None:
            return -(-self._size[0] // row.block), -(-self._size[1] // row.block)
        width, height = (max(1, round(n * row.share)) for n in self._size)
        return width, height

    def covered(self, level: int) -> tuple[int, int]:
        """Px of the full size, or beyond it, that are shown if each one is a whole block.

        Cells that blocks end between cost the least.
        """
        block = self._levels[level].block
        if block is None:
            return self._size
        width, height = self.size(level)
        return width * block, height * block

    def shades(self, level: int) -> int | None:
        """How many of each channel a picture at ``level`` needs; None: all."""
        return self._levels[level].shades

    def note(
        self,
        level: int,
        render: float,
        encode: float,
        flight: float,
        sent: int,
        way: float | None = None,
    ) -> None:
        """A frame was shown: s of its stages, bytes sent. Chooses the level of the next.

        ``flight`` is how long the link was busy with it, ``way`` how long it took to be answered
        (None: the same).
        """
        stages = render, encode, flight
        self._made.append(render + encode)
        row = self._levels[level]
        if self._age(row) > 1:
            row.loads.clear()
            row.flights.clear()
        row.loads.append(max(*stages, sum(stages) / 2))
        row.flights.append(flight)
        row.noted = self._clock()
        self._link.append((sent, flight, flight if way is None else way))
        self._choose()

    def _age(self, row: _Level) -> float:
        """How often what is known of ``row`` went stale."""
        return (self._clock() - row.noted) / self._stale

    def _known(self, flights: bool) -> list[tuple[float, float]]:
        """(pixels, s) of the levels that something is known of, the fewest pixels first.

        The loads, or the flights alone.

        What was measured long ago of finer levels is believed less and less, so that they are
        tried again; of coarser ones it is forgotten.
        """
        rows = [row for row in self._levels if row.loads]
        last = max(rows, key=lambda row: row.noted, default=None)
        known = []
        for row in rows:
            seconds, stale = median_low(row.flights if flights else row.loads), self._age(row) - 1
            if last is not None and row is not last and stale > 0:
                if row.pixels < last.pixels:
                    if stale < FORGOTTEN:
                        known.append((row.pixels, seconds))
                    continue
                now = median_low(last.flights if flights else last.loads)
                seconds = now + max(0.0, seconds - now) * 0.5**stale
            known.append((row.pixels, seconds))
        return sorted(known)

    def load(self, level: int, flights: bool = False) -> float:
        """Seconds that a frame at ``level`` should take: on the line through the two nearest.

        Or its flight alone.

        In proportion to the pixels if there are no two, and below the coarsest that is known: what
        does not depend on the pixels shows only there.
        """
        known, pixels = self._known(flights), self._levels[level].pixels
        if not known:
            return 0.0
        if len(known) == 1 or pixels < known[0][0]:
            return known[0][1] * pixels / known[0][0]
        near = sorted(sorted(known, key=lambda point: abs(point[0] - pixels))[:2])
        (few, fast), (many, slow) = near
        slope = max(0.0, (slow - fast) / (many - few))
        return max(0.0, fast + slope * (pixels - few))

    def _choose(self) -> None:
        loads = [self.load(n) for n in range(len(self._levels))]
        level = self._finest(loads[: self._fine], self.period)
        if self._fine < len(loads):  # it is the link that those are for, not a slow machine
            flights = [self.load(n, flights=True) for n in range(len(loads))]
            level = max(level, self._finest(flights, SLOW))
        self.level = level

    def _finest(self, loads: list[float], limit: float) -> int:
        """The finest level that takes no more than ``limit`` s; or little more than the coarsest.

        A finer one than now has to do so with something to spare.
        """
        stays = max(limit, GAIN * loads[-1])
        rises = max(HEADROOM * limit, REGAIN * loads[-1])
        return next(n for n, s in enumerate(loads) if s <= (stays if n >= self.level else rises))

    def interval(self, level: int) -> float:
        """Seconds from one frame's begin to the next one's: no more are begun than get through."""
        return max(self.period, self.load(level))

    def head_start(self, level: int) -> float | None:
        """How long before the link is free the next frame is to be begun, in s.

        None: it is not the link that frames wait for. Where it is, an earlier one only grows old.
        """
        if not self._made or self._fine == len(self._levels):
            return None
        made = median_high(self._made)
        return made if made < self.load(level, flights=True) else None

    def finer(self, level: int) -> int | None:
        """What follows ``level`` in a picture that stands still; None after the full size.

        The full size if that is soon there, else what is; a finer one in any case.
        """
        if level == 0:
            return None
        return next((n for n in range(level) if self.load(n) <= PATIENCE), level - 1)

    @property
    def link(self) -> Link | None:
        """Of the last frames; None if nothing is known."""
        busy = sum(flight for _, flight, _ in self._link)
        if busy <= 0:
            return None
        way = sum(seconds for *_, seconds in self._link)
        return Link(way / len(self._link), sum(sent for sent, *_ in self._link) / busy)
