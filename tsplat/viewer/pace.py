"""How many pixels a moving picture has, and how often a new one is begun.

A level is a share of the pixels each way, and for links that are slow so many shades of each colour
channel. What a frame takes is remembered by level, for each stage by itself: render, encode and
flight (how long it keeps the terminal or the link busy). Each is a fixed time and one in proportion
to the pixels. A frame's load is that of the slowest stage, or half of all three if that is more. If
it is no more than a frame's time, the stages keep up with each other, and a key's picture is there
within three frames' time, one until the next frame is begun, two for the stages; and the way there
and back, which no level makes shorter.

Pixels are given up for a frame's time only as far as they are what it takes: splats are projected
and cells are painted however few pixels a picture has.

Over a network there are more levels, beyond the coarsest that one likes to look at. They come in
only where frames would take longer than ``SLOW``: what is slower does not look like motion.
"""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from statistics import median_high, median_low

LEVELS = (1.0, 0.75, 0.5, 0.375, 0.25, 0.1875, 0.125)
SHORTEST = 32  # px: none of them makes a side shorter that is not so already
DEAR = (2, 4, 8, 16, 32)  # where bytes are dear: one px for so many each way, with each of SHADES
DEAR_SHORTEST = 8  # px
SHADES = {16: 0.4, 8: 0.26}  # how many of a channel: what is left of the bytes, kitty's and cells'
SLOW = 0.1  # s a frame
PREVIEW = 80_000  # px of the first picture, when nothing is known of link and scene
SAMPLES = 5  # of a level: their median counts, so that one hiccup does not
STALE_SECONDS = 5.0  # for what was measured before: another view, another load
FAR_STALE_SECONDS = 30.0  # over a network, where to try what is too slow costs more
FORGOTTEN = 5  # times as old
HEADROOM = 0.8  # of a frame's time, at which a finer level is tried
GAIN = 1.45  # a level is left for coarser ones only if it takes so much longer than the coarsest
REGAIN = 1.3  # and come back to if it takes no more than that
PATIENCE = 0.5  # s, for the next step of a picture that stands still
LINK_SAMPLES = 8
NEAR = 0.5  # octaves of pixels: a level so far away counts half as much

Stages = tuple[float, float, float]  # s of render, encode and flight


@dataclass
class _Level:
    share: float
    shades: int | None  # None: all
    block: int | None  # px of the full size that one stands for, each way; None: in no such raster
    pixels: float  # as many as take the same time
    taken: deque[Stages] = field(default_factory=lambda: deque(maxlen=SAMPLES))
    noted: float = 0.0  # s, of the clock

    @property
    def stages(self) -> Stages:
        """The medians."""
        render, encode, flight = zip(*self.taken, strict=True)
        return median_low(render), median_low(encode), median_low(flight)


@dataclass(frozen=True)
class _Point:
    """What is known of a level."""

    pixels: float
    stages: Stages
    count: int  # of frames


def _line(points: Sequence[_Point], stage: int, pixels: float) -> float:
    """Seconds that ``stage`` should take for so many ``pixels``.

    A fixed time and one for each pixel, neither below 0, as fits best: what is like in its pixels
    counts most. All of it is in proportion to them if there is only one point.
    """
    octaves = [math.log2(point.pixels / pixels) / NEAR for point in points]
    weights = [point.count / (1 + n * n) for point, n in zip(points, octaves, strict=True)]

    def mean(values: Iterable[float]) -> float:
        return sum(w * value for w, value in zip(weights, values, strict=True)) / sum(weights)

    x, y = [p.pixels / pixels for p in points], [p.stages[stage] for p in points]
    middle, height = mean(x), mean(y)
    spread = mean((n - middle) ** 2 for n in x)
    if not spread:
        return height / middle
    each = mean((n - middle) * (s - height) for n, s in zip(x, y, strict=True)) / spread
    if each > 0 and height < each * middle:
        return mean(s / n for n, s in zip(x, y, strict=True))
    return height + max(0.0, each) * (1 - middle)


def _bytes_line(points: Sequence[_Point], pixels: float) -> float:
    """Seconds that a link which is short of bytes should be busy with so many ``pixels``.

    On the line through the two nearest points; in proportion to the pixels if there are no two, and
    below the coarsest that is known. There bytes can always be given up, so nothing is fixed.
    """
    known = sorted((point.pixels, point.stages[2]) for point in points)
    if len(known) == 1 or pixels < known[0][0]:
        return known[0][1] * pixels / known[0][0]
    near = sorted(sorted(known, key=lambda point: abs(point[0] - pixels))[:2])
    (few, fast), (many, slow) = near
    slope = max(0.0, (slow - fast) / (many - few))
    return max(0.0, fast + slope * (pixels - few))


def _load(stages: Stages) -> float:
    return max(*stages, sum(stages) / 2)


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
        self._made.append(render + encode)
        row = self._levels[level]
        if self._age(row) > 1:
            row.taken.clear()
        row.taken.append((render, encode, flight))
        row.noted = self._clock()
        self._link.append((sent, flight, flight if way is None else way))
        self._choose(level)

    def _age(self, row: _Level) -> float:
        """How often what is known of ``row`` went stale."""
        return (self._clock() - row.noted) / self._stale

    def _known(self) -> list[_Point]:
        """What is known of levels.

        What was measured long ago of finer levels is believed less and less, so that they are
        tried again; of coarser ones it is forgotten.
        """
        rows = [row for row in self._levels if row.taken]
        last = max(rows, key=lambda row: row.noted, default=None)
        known = []
        for row in rows:
            stages, stale = row.stages, self._age(row) - 1
            if last is not None and row is not last and stale > 0:
                if row.pixels < last.pixels and stale >= FORGOTTEN:
                    continue
                if row.pixels > last.pixels:
                    render, encode, flight = (
                        now + max(0.0, then - now) * 0.5**stale
                        for then, now in zip(stages, last.stages, strict=True)
                    )
                    stages = render, encode, flight
            known.append(_Point(row.pixels, stages, len(row.taken)))
        return known

    def _stages(self, level: int, known: Sequence[_Point] | None = None) -> Stages:
        """What a frame at ``level`` should take."""
        known, pixels = self._known() if known is None else known, self._levels[level].pixels
        if not known:
            return 0.0, 0.0, 0.0
        far = self._fine < len(self._levels)
        flight = _bytes_line(known, pixels) if far else _line(known, 2, pixels)
        return _line(known, 0, pixels), _line(known, 1, pixels), flight

    def load(self, level: int) -> float:
        """Seconds from one frame at ``level`` to the next that the stages should need."""
        return _load(self._stages(level))

    def flight(self, level: int) -> float:
        """Seconds that a frame at ``level`` should keep the link busy."""
        return self._stages(level)[2]

    def _choose(self, noted: int) -> None:
        """The next level, now that a frame at the level ``noted`` was shown."""
        known = self._known()
        stages = [self._stages(n, known) for n in range(len(self._levels))]
        loads = [_load(row) for row in stages]
        level = self._finest(loads[: self._fine], self.period)
        if self._fine < len(loads):  # it is the link that those are for, not a slow machine
            level = max(level, self._finest([flight for *_, flight in stages], SLOW))
        if level < self.level and not self._fresh(level):
            # what finer ones take is a guess: one step, and no other before that one is known
            level = self.level - (noted == self.level)
        self.level = level

    def _fresh(self, level: int) -> bool:
        row = self._levels[level]
        return bool(row.taken) and self._age(row) <= 1

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
        return made if made < self.flight(level) else None

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
