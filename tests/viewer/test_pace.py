"""How many pixels a moving picture has, on scenes and links made of numbers and a clock."""

from __future__ import annotations

import itertools
import random
import statistics

import pytest

from tsplat.viewer import pace as module
from tsplat.viewer.pace import (
    DEAR_SHORTEST,
    LEVELS,
    PREVIEW,
    SHADES,
    SHORTEST,
    SLOW,
    STALE_SECONDS,
    Pace,
)

SIZE = 1000, 640
FULL = SIZE[0] * SIZE[1]


class World:
    """Stages that take a fixed time and one in proportion to the pixels; a link of so many bytes/s.

    ``terminal`` is what each picture takes there, however small it is.

    Frames are shown one after another; ``level`` of those shown last is what the tests look at.
    """

    def __init__(
        self,
        fixed=0.0,
        full=0.010,
        encode=0.0,
        rate=1e9,
        fps=30.0,
        size=SIZE,
        far=False,
        terminal=0.001,
        noise=0.0,
        kind=Pace,
    ):
        self.fixed, self.full, self.encode, self.rate = fixed, full, encode, rate
        self.terminal, self.noise, self.random = terminal, noise, random.Random(1)
        self.now = 100.0
        self.pace = kind(size, fps, lambda: self.now, far)

    def taken(self, seconds):
        """As a machine with other work has it: up to ``noise`` times longer."""
        return seconds * (1 + self.noise * self.random.random())

    def show(self, frames=1, level=None):
        """Levels of ``frames`` frames."""
        levels = []
        for _ in range(frames):
            chosen = self.pace.level if level is None else level
            width, height = self.pace.size(chosen)
            share = width * height / FULL
            sent = round(width * height * 0.5 * SHADES.get(self.pace.shades(chosen), 1.0))
            flight = self.taken(sent / self.rate + self.terminal)
            render = self.taken(self.fixed + self.full * share)
            self.pace.note(chosen, render, self.taken(self.encode * share), flight, sent)
            self.now += self.pace.interval(chosen)
            levels.append(chosen)
        return levels


def test_the_first_picture_is_a_preview():
    """Nothing is known: few pixels, if there are many; all of a small picture."""
    width, height = World().pace.size(World().pace.level)
    assert PREVIEW / 4 < width * height <= PREVIEW
    assert World(size=(100, 66)).pace.level == 0


def test_all_pixels_where_there_is_time():
    """10 ms of 33: full size soon, and for good."""
    assert World(full=0.010).show(20)[10:] == [0] * 10


@pytest.mark.parametrize("full", [0.05, 0.1, 0.3, 1.0])
def test_pixels_follow_the_frame_rate(full):
    """In proportion to the pixels: the finest level within a frame's time, never one that is not.

    After a while to find it: it does not go up and down.
    """
    world = World(full=full)
    last = world.show(40)[20:]
    (level,) = set(last)
    assert world.pace.load(level) <= world.pace.period
    width, height = world.pace.size(level - 1)
    assert full * width * height / FULL > 0.8 * world.pace.period


def test_no_pixels_are_given_up_for_nothing():
    """60 ms whatever the size and 20 ms for all pixels: few pixels would not make it smooth."""
    world = World(fixed=0.060, full=0.020)
    assert set(world.show(40)[20:]) <= {0, 1}


class Proportional(Pace):
    """A wrong one: all that a frame takes is in proportion to its pixels."""

    def _stages(self, level, known=None):
        known = self._known() if known is None else known
        if not known:
            return 0.0, 0.0, 0.0
        pixels = self._levels[level].pixels
        near = min(known, key=lambda point: abs(point.pixels - pixels))
        return tuple(s * pixels / near.pixels for s in near.stages)


class Unheeding(Pace):
    """A wrong one: no frame is too slow."""

    def _finest(self, loads, limit):
        return 0


def shows(kind, **world):
    """Levels of 60 frames of a picture whose first ones were a preview and the full one."""
    world = World(kind=kind, **world)
    world.show()
    world.show(level=0)
    return world, world.show(60)


def keeps_all_pixels(kind):
    """A terminal that paints its cells in 28 ms, whatever the picture; and a busy machine."""
    _, levels = shows(kind, full=0.010, encode=0.004, terminal=0.028, noise=0.6)
    assert set(levels) == {0}


def test_a_terminals_fixed_time_costs_no_pixels():
    """Fewer would gain nothing, though some frames take longer than a frame's time."""
    keeps_all_pixels(Pace)
    with pytest.raises(AssertionError):
        keeps_all_pixels(Proportional)


def keeps_most_pixels(kind):
    """38 ms for the splats, 45 more for all of the pixels: 30 a second are not to be had."""
    world, levels = shows(kind, fixed=0.038, full=0.045, terminal=0.030, noise=0.3)
    levels = levels[20:]
    assert len(set(levels)) == 1
    assert world.pace.size(levels[0])[0] >= 500


def test_a_scenes_fixed_time_costs_few_pixels():
    """None are given up down to a size at which they are hardly what a frame takes."""
    keeps_most_pixels(Pace)
    with pytest.raises(AssertionError):
        keeps_most_pixels(Proportional)


def meets_the_rate(kind, rate):
    """Bytes in proportion to the pixels, and 5 ms for each picture."""
    world, levels = shows(kind, rate=rate, terminal=0.005, noise=0.1)
    levels = levels[20:]
    sizes = [world.pace.size(level) for level in levels]
    seconds = statistics.median(w * h * 0.5 / rate + 0.005 for w, h in sizes)
    assert seconds <= world.pace.period
    w, h = world.pace.size(min(levels) - 1)
    assert w * h * 0.5 / rate + 0.005 > 0.7 * world.pace.period


@pytest.mark.parametrize("rate", [1e6, 3e6, 8e6])
def test_a_terminals_time_for_each_pixel_is_heeded(rate):
    """As many pixels as it takes in a frame's time, no more and not much fewer."""
    meets_the_rate(Pace, rate)
    with pytest.raises(AssertionError):
        meets_the_rate(Unheeding, rate)


def test_what_is_not_known_is_tried_step_by_step():
    """A machine that gets ten times quicker: one level finer at a time, each of them measured."""
    world = World(full=0.5)
    world.show(30)
    world.full = 0.010
    world.now += 10 * STALE_SECONDS
    levels = world.show(20)
    assert levels[-1] == 0
    assert max(a - b for a, b in itertools.pairwise(levels)) == 1


def test_a_slow_link_is_not_fed_faster_than_it_takes():
    """125 kB/s: the coarsest level, and no more frames begun than get through."""
    world = World(rate=125e3)
    level = world.show(20)[-1]
    assert level == len(LEVELS) - 1
    width, height = world.pace.size(level)
    assert world.pace.interval(level) >= width * height * 0.5 / 125e3
    assert world.pace.link.rate == pytest.approx(125e3, rel=0.05)


def test_three_stages_of_a_frames_time_are_too_slow():
    """30 ms each: they keep up, but a key's picture would come after more than three frames."""
    world = World(full=0.030, encode=0.030, rate=FULL * 0.5 / 0.030)
    level = world.show(20)[-1]
    assert level > 0
    assert world.pace.load(level) <= world.pace.period


def test_one_hiccup_changes_nothing():
    """A frame ten times as slow as the others."""
    world = World(full=0.025)
    world.show(10)
    world.full = 0.25
    world.show()
    world.full = 0.025
    assert world.show(3) == [0, 0, 0]


def test_what_was_slow_is_tried_again():
    """A machine that was busy for a while: afterwards all pixels, once that is stale."""
    world = World(full=0.5)
    assert world.show(30)[-1] > 2
    world.full = 0.010
    end = world.now + 6 * STALE_SECONDS
    while world.now < end:
        levels = world.show()
    assert levels[-1] == 0


def test_a_still_picture_is_refined():
    """At once if that is soon done; in steps over a slow link, each of them finer, to the end."""
    quick = World(full=0.1)
    quick.show(5)
    assert quick.pace.finer(4) == 0
    assert quick.pace.finer(0) is None
    slow = World(rate=125e3)
    slow.show(5)
    level, steps = slow.pace.level, []
    while (finer := slow.pace.finer(level)) is not None:
        assert finer < level
        level = finer
        steps.append(slow.show(level=level)[0])
    assert steps[-1] == 0
    assert len(steps) > 2


def test_no_side_gets_too_short():
    """Half blocks of 100x66 px are not made of 12x8; where bytes are dear, of 13x9 at least."""
    for far, shortest in ((False, SHORTEST), (True, DEAR_SHORTEST)):
        pace = Pace((100, 66), 30.0, far=far)
        sizes = [pace.size(n) for n in range(len(pace._levels))]
        assert len(sizes) > 1
        assert shortest <= min(map(min, sizes)) < 2 * shortest
    assert [Pace((1, 1), 30.0).size(0), Pace((40, 20), 30.0).finer(0)] == [(1, 1), None]


def test_over_a_network_the_first_picture_is_small():
    """The coarsest that one likes to look at: nothing is known of the link."""
    pace = World(far=True).pace
    assert pace.size(pace.level) == World().pace.size(len(LEVELS) - 1)
    assert pace.shades(pace.level) is None


@pytest.mark.parametrize("rate", [10e3, 25e3, 40e3])
def test_dear_bytes_cost_shades(rate, monkeypatch):
    """Where all shades would be too slow for motion there are fewer, and no fewer than needed."""
    world = World(rate=rate, far=True)
    level = world.show(30)[-1]
    assert world.pace.shades(level) is not None
    assert world.pace.load(level) <= SLOW
    finer = world.pace.flight(level - 1)
    assert finer > 0.8 * SLOW
    monkeypatch.setattr(module, "SLOW", 100.0)
    wrong = World(rate=rate, far=True)
    assert wrong.pace.load(wrong.show(30)[-1]) > SLOW


class Fitting(Pace):
    """Believes that a link, too, has a time which no level makes shorter."""

    def _stages(self, level, known=None):
        known, pixels = self._known() if known is None else known, self._levels[level].pixels
        return (
            tuple(module._line(known, stage, pixels) for stage in range(3)) if known else (0,) * 3
        )


def slow_cells(kind):
    """Cells are as many bytes at every level but those of few shades, where blocks are alike."""
    pace = kind((1000, 660), 30.0, far=True)
    coarsest = pace._levels[pace._fine - 1].pixels
    stood = [*range(pace._fine)] * 2  # it was refined before it moves
    for said in [*stood, *[None] * 40]:
        level = pace.level if said is None else said
        flight = 0.4 * min(1.0, pace._levels[level].pixels / coarsest)
        pace.note(level, 0.01, 0.01, flight, int(flight * 125e3))
    return flight


def test_a_link_is_relieved_by_levels_that_were_not_tried():
    """What was alike at all known levels may be less at others: motion is worth trying them."""
    assert slow_cells(Pace) <= SLOW < slow_cells(Fitting)


def test_only_a_link_costs_shades():
    """Not a link that is fast enough, not a slow machine, and not a terminal on this one."""
    for world in (
        World(rate=125e3, far=True),
        World(full=20.0, rate=125e3, far=True),
        World(rate=10e3),
    ):
        assert {world.pace.shades(level) for level in world.show(30)} == {None}


def test_dear_levels_are_whole_blocks():
    """All of the picture is covered, by less than a block too much: cells end where blocks do."""
    pace = Pace((100, 66), 30.0, far=True)
    for level in range(len(pace._levels)):
        (width, height), covered = pace.size(level), pace.covered(level)
        if pace.shades(level) is None:
            assert covered == (100, 66)
            continue
        block = covered[0] // width
        assert covered == (width * block, height * block)
        assert all(0 <= there - n < block for there, n in zip(covered, (100, 66), strict=True))


def test_a_picture_for_a_slow_link_is_begun_late():
    """As long before the link is free as making it takes; at once if that takes longer."""
    world = World(full=0.1, rate=40e3, far=True)
    level = world.show(20)[-1]
    width, height = world.pace.size(level)
    assert world.pace.head_start(level) == pytest.approx(0.1 * width * height / FULL, rel=0.5)
    assert World(far=True).pace.head_start(0) is None
    slow = World(full=20.0, rate=125e3, far=True)
    assert slow.pace.head_start(slow.show(20)[-1]) is None
    near = World(rate=40e3)
    assert near.pace.head_start(near.show(20)[-1]) is None
