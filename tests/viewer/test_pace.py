"""How many pixels a moving picture has, on scenes and links made of numbers and a clock."""

from __future__ import annotations

import pytest

from tsplat.viewer.pace import LEVELS, PREVIEW, SHORTEST, STALE_SECONDS, Pace

SIZE = 1000, 640
FULL = SIZE[0] * SIZE[1]


class World:
    """Stages that take a fixed time and one in proportion to the pixels; a link of so many bytes/s.

    Frames are shown one after another; ``level`` of those shown last is what the tests look at.
    """

    def __init__(self, fixed=0.0, full=0.010, encode=0.0, rate=1e9, fps=30.0, size=SIZE):
        self.fixed, self.full, self.encode, self.rate = fixed, full, encode, rate
        self.now = 100.0
        self.pace = Pace(size, fps, lambda: self.now)

    def show(self, frames=1, level=None):
        """Levels of ``frames`` frames."""
        levels = []
        for _ in range(frames):
            chosen = self.pace.level if level is None else level
            width, height = self.pace.size(chosen)
            share = width * height / FULL
            sent = round(width * height * 0.5)
            flight = sent / self.rate + 0.001
            self.pace.note(
                chosen, self.fixed + self.full * share, self.encode * share, flight, sent
            )
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
    """Half blocks of 100x66 px are not made of 12x8."""
    pace = Pace((100, 66), 30.0)
    sizes = [pace.size(n) for n in range(len(pace._levels))]
    assert len(sizes) > 1
    assert min(map(min, sizes)) >= SHORTEST
    assert [Pace((1, 1), 30.0).size(0), Pace((40, 20), 30.0).finer(0)] == [(1, 1), None]
