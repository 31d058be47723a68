"""What a link takes, and when a frame may go, on links made of numbers and a clock.

Each rule is also broken on purpose, and the fact that it is there for then fails.
"""

from __future__ import annotations

import math
import random

import pytest

from tsplat.terminal import link as module
from tsplat.terminal.link import AHEAD, FAR, PACED, PIECE_SECONDS, Link

LATENCY, RATE = 0.1, 125e3
STEP = 0.001  # s of the clock
PIECE = 256  # bytes written at least


class World:
    """A bottleneck of ``rate`` bytes/s and a way of ``latency`` s, fed as Screen feeds it."""

    def __init__(self, link=None, rate=RATE, latency=LATENCY, pinged=True):
        self.link, self.rate, self.latency = link or Link(), rate, latency
        if pinged:
            self.link.pinged(latency)
        self.now = 50.0
        self.rest = 0  # bytes of the frame that is being written
        self.free_at = 0.0  # when the bottleneck has sent what it has
        self.answers = []  # when
        self.deaf = False  # answers get lost
        self.begun = self.answered = 0  # frames
        self.sent = 0  # bytes
        self.queues, self.flights, self.together = [], [], 0

    @property
    def queue(self):
        """Seconds that what the bottleneck has will take it."""
        return max(0.0, self.free_at - self.now)

    def write(self):
        while self.rest and self.now >= self.link.opens:
            part = int(min(self.rest, max(PIECE, self.link.room(self.now))))
            self.link.wrote(self.now, part)
            self.free_at = max(self.free_at, self.now) + part / self.rate
            self.rest -= part
            self.sent += part
            if not self.rest:
                self.answers.append(self.free_at + self.latency)

    def run(self, seconds, size=0):
        """Time passes; frames of ``size`` bytes are begun whenever they may."""
        end = self.now + seconds
        while self.now < end:
            while self.answers and self.answers[0] <= self.now:
                self.answers.pop(0)
                if not self.deaf:
                    self.flights.append(self.link.answered(self.now))
                    self.answered += 1
            self.write()
            if size and not self.rest and not self.link.wait(self.now):
                self.queues.append(self.queue)
                self.link.begin(self.now, size)
                self.begun += 1
                self.rest = size
                self.write()
            self.together = max(self.together, self.begun - self.answered)
            self.now += STEP

    def share(self, seconds, size):
        """Of what the link can carry in ``seconds``, how much is carried, once it is known."""
        self.run(1.0, size)
        self.sent = 0
        self.queues.clear()
        self.run(seconds, size)
        return self.sent / (self.rate * seconds)


class OneAtATime(Link):
    far = False


class Unheeding(Link):
    def wait(self, now, more=0):
        return 0.0


class LatencyAsWork(Link):
    """Takes the whole way for time that the link was busy."""

    def answered(self, now):
        self.latency, latency = 0.0, self.latency
        flight = super().answered(now)
        self.latency = latency
        return flight


@pytest.mark.parametrize("size", [3000, 6000, 12000])
def test_the_link_is_kept_busy(size):
    """More than one frame is on its way, though each is answered only after the way's time."""
    world = World()
    assert world.share(5.0, size) > 0.9
    assert world.together > 1
    assert World(OneAtATime()).share(5.0, size) < 0.6


@pytest.mark.parametrize("size", [3000, 6000, 12000, 60000])
def test_a_frame_never_queues_behind_frames(size):
    """When one is begun the bottleneck has next to nothing to do before it."""
    world = World()
    world.share(5.0, size)
    assert max(world.queues) < AHEAD + 2 * STEP
    wrong = World(Unheeding())
    wrong.run(2.0, size)
    assert max(wrong.queues) > 2 * AHEAD


@pytest.mark.parametrize("size", [3000, 12000, 60000])
def test_rate_and_latency_are_told_apart(size):
    """Whatever the frames' size, from frames that are on their way at the same time."""
    world = World()
    world.run(4.0, size)
    assert world.link.rate == pytest.approx(RATE, rel=0.06)
    assert world.link.latency == pytest.approx(LATENCY, abs=2 * STEP)
    flight = world.flights[-1]
    assert flight.occupied == pytest.approx(size / RATE, rel=0.1)
    assert flight.seconds >= LATENCY + size / RATE - 2 * STEP
    wrong = World(LatencyAsWork())
    wrong.run(4.0, size)
    assert wrong.flights[0].occupied > size / RATE + 0.9 * LATENCY


def test_the_shortest_way_counts():
    """A terminal that was slow to answer at the start: the first small frame tells better."""
    world = World(pinged=False)
    world.link.pinged(2.5 * LATENCY)
    world.run(1.0, 1500)
    assert world.link.latency == pytest.approx(LATENCY + 1500 / RATE, abs=3 * STEP)


def test_without_a_ping_there_is_one_at_a_time():
    """Of the first frame's time nobody knows how much was the way."""
    world = World(pinged=False)
    world.link.remote = True
    world.run(2.0, 20000)
    assert world.together == 1
    assert world.link.rate == pytest.approx(20000 / (LATENCY + 20000 / RATE), rel=0.05)


def test_a_link_that_gets_slower():
    """A fifth of the rate: what is on its way is late, and after that nothing queues again."""
    world = World()
    world.run(3.0, 6000)
    world.rate = RATE / 5
    world.run(3.0, 6000)
    world.queues.clear()
    world.run(5.0, 6000)
    assert max(world.queues) < AHEAD + PACED
    assert world.link.rate == pytest.approx(RATE / 5, rel=0.1)


@pytest.mark.parametrize("size", [6000, 60000])
def test_a_link_that_gets_faster(size, monkeypatch):
    """Five times the rate is found, also by frames that were held back at the old one."""
    world = World(rate=RATE / 5)
    world.run(6.0, size)
    world.rate = RATE
    world.run(12.0, size)
    assert world.link.rate > 0.9 * RATE
    if size / RATE > PACED:
        monkeypatch.setattr(module, "GROWTH", 1.0)
        wrong = World(rate=RATE / 5)
        wrong.run(6.0, size)
        wrong.rate = RATE
        wrong.run(12.0, size)
        assert wrong.link.rate < 0.5 * RATE


def test_one_stall_changes_little():
    """A frame that took two seconds among others: the slowest does not count."""
    world = World()
    world.run(3.0, 6000)
    world.free_at = world.now + 2.0
    world.run(2.5, 6000)
    assert world.link.rate > 0.8 * RATE


def test_answers_that_fail_to_come():
    """No more goes out than fits on the way and a frame; after they are given up, one may."""
    world = World()
    world.run(3.0, 6000)
    world.deaf, world.sent = True, 0
    world.run(5.0, 6000)
    assert world.sent <= RATE * (LATENCY + AHEAD) + 2 * 6000
    assert world.link.wait(world.now) == math.inf
    world.link.lost()
    assert world.link.wait(world.now) == 0.0


@pytest.mark.parametrize("seconds", [0.02, 0.1, 0.4, 1.0])
def test_of_a_large_frame_little_is_out_of_reach(seconds):
    """Cut short anywhere: what a key's picture finds in its way takes ``PACED`` s at most."""
    world = World()
    world.run(2.0, 6000)
    world.run(1.0)
    world.link.begin(world.now, 500_000)
    world.begun += 1
    world.rest = 500_000
    world.run(seconds)
    assert world.queue <= PACED + 2 * STEP
    assert world.rest > 0
    assert world.link.cut() == 0
    assert world.link.cut() is None
    assert world.link.wait(world.now) <= PACED
    world.answers.append(max(world.free_at, world.now) + LATENCY)
    world.rest = 0
    world.run(1.0)
    assert world.flights[-1].sent < 500_000
    assert world.link.rate == pytest.approx(RATE, rel=0.1)


def test_a_terminal_on_this_machine_gets_one_at_a_time():
    """As long as it answers quickly; its tty holds the writer back better than any estimate."""
    world = World(latency=FAR / 4)
    world.run(1.0, 60000)
    assert world.together == 1
    assert world.link.room(world.now) == math.inf
    assert world.link.opens == -math.inf
    slow = Link()  # nothing is known of the way
    slow.begin(1.0, 6000)
    slow.wrote(1.0, 6000)
    assert slow.wait(1.0) == math.inf


def test_a_piece_is_worth_writing():
    """When there is room for more there is room for a piece of some ms."""
    world = World()
    world.run(2.0, 6000)
    world.link.begin(world.now, 100_000)
    world.rest = 100_000
    world.write()
    assert world.rest
    opens = world.link.opens
    assert opens > world.now
    assert world.link.room(opens) == pytest.approx(PIECE_SECONDS * world.link.rate, rel=0.01)


class Unsteady(World):
    """Frames of all ``sizes`` and pauses; answers up to ``late`` s too late, in their order."""

    def __init__(self, link, sizes, late, seed):
        super().__init__(link, pinged=False)
        self.rng, self.sizes, self.late = random.Random(seed), sizes, late
        self.link.pinged(self.latency + 300 / self.rate, 300)

    def write(self):
        known = len(self.answers)
        super().write()
        if len(self.answers) > known:
            due = self.answers[-1] + self.rng.random() ** 3 * self.late
            self.answers[-1] = max([due, *self.answers[:-1]])

    def beliefs(self, seconds):
        """Shares of the link's rate that it is believed to be, after the first 3 s."""
        found, known, end = [], self.now + 3.0, self.now + seconds
        while self.now < end:
            self.run(self.rng.choice([0.2, 0.5, 1.0]), self.rng.choice(self.sizes))
            while self.rest:
                self.run(0.01)
            self.run(self.rng.choice([0.0, 0.0, 1.0]))
            if self.now > known:
                found.append(self.link.rate / self.rate)
        return found


class DropsTheSlow(Link):
    """Each frame for itself: a late answer is forgotten, the quick ones after it are not."""

    def _together(self, frame, seconds):
        return False


class TakesTheLeastForTheWay(Link):
    """What took only the latency took no time beyond it, so the link would be infinitely fast."""

    def pinged(self, seconds, size=0):
        super().pinged(seconds)


MIXES = [[1500], [1500, 8000], [8000], [1200, 3000, 12000], [8000, 24000, 300_000]]


@pytest.mark.parametrize("sizes", MIXES, ids=str)
def test_the_rate_is_known_from_any_mix(sizes):
    """Answers in time: never believed to be 3 % more than it is, nor a sixth less."""
    beliefs = [b for seed in range(3) for b in Unsteady(Link(), sizes, 0.0, seed).beliefs(20.0)]
    assert 5 / 6 < min(beliefs) <= max(beliefs) < 1.03


def test_the_least_frame_says_how_much_it_was():
    """Small frames alone: if its bytes are left out, the others seem too quick."""
    wrong = Unsteady(TakesTheLeastForTheWay(), [1500, 3000], 0.0, 1).beliefs(10.0)
    assert max(wrong) > 1.1


@pytest.mark.parametrize("sizes", MIXES, ids=str)
def test_late_answers_do_not_make_a_link_fast(sizes):
    """Up to 20 ms late, then several at once: believed to be 5 % more at most, a third less."""
    beliefs = [b for seed in range(3) for b in Unsteady(Link(), sizes, 0.02, seed).beliefs(20.0)]
    assert 2 / 3 < min(beliefs) <= max(beliefs) < 1.05


def test_of_late_answers_the_quick_ones_are_not_counted_alone():
    """Each frame for itself: a link that is not there."""
    wrong = Unsteady(DropsTheSlow(), [1500], 0.02, 0).beliefs(20.0)
    assert max(wrong) > 1.2


class GrowsByHalf(Link):
    """Whatever was missed."""

    def _starved(self, frame, now):
        hungry = super()._starved(frame, now)
        self._hungry += 9 * hungry
        return hungry


@pytest.mark.parametrize(("link", "held"), [(Link, True), (GrowsByHalf, False)])
def test_growth_is_what_was_missed(link, held):
    """A long frame at whose end the link had to wait: that is little more than was believed."""
    world = World(link())
    world.run(3.0, 6000)
    world.run(1.0)
    world.rate = 1.03 * RATE
    most = 0.0
    for _ in range(400):
        world.run(0.05, 500_000)
        most = max(most, world.link.rate / world.rate)
    assert (most < 1.1) == held


class InParts(World):
    """Large frames of parts, each answered, over a link that may stop."""

    def send(self, size, part):
        """A frame of ``size`` bytes."""
        behind = 0
        for _ in range(size // part):
            self.link.begin(self.now, part, behind)
            behind += part
        self.rest, self.part, self.done = size, part, 0

    def write(self):
        while self.rest and self.now >= self.link.opens:
            count = int(min(self.rest, max(PIECE, self.link.room(self.now))))
            self.link.wrote(self.now, count)
            for _ in range(count):
                self.free_at = max(self.free_at, self.now) + 1 / self.rate
                self.done += 1
                if self.done % self.part == 0:
                    self.answers.append(self.free_at + self.latency)
            self.rest -= count


@pytest.mark.parametrize("part", [6000, 600_000])
def test_a_stall_within_a_large_picture_is_heard_of(part):
    """0.3 s: what queued up is gone soon after; not so if only its end is answered."""
    world = InParts()
    world.run(0.0)
    for _ in range(10):  # what the rate is known from
        world.send(6000, 6000)
        world.run(0.3)
    world.send(600_000, part)
    world.run(1.0)
    world.free_at += 0.3
    world.run(1.0)
    assert world.rest > 0
    assert (world.queue <= PACED + 0.02) == (part == 6000)


def test_what_is_unanswered_is_bounded():
    """Parts whose answers fail to come: what the way holds, and a part; then nothing more goes."""
    world = InParts()
    world.run(0.0)
    for _ in range(10):
        world.send(6000, 6000)
        world.run(0.3)
    world.send(600_000, 6000)
    world.run(1.0)
    world.deaf = True
    world.run(5.0)
    assert world.rest > 0
    assert world.link.under_way <= world.link.rate * (LATENCY + PACED + AHEAD) + 6000 + PIECE
    assert world.link.opens == math.inf
    left = world.link.cut()
    assert left is not None
    assert left > 10
    assert world.link.under_way > 0


def test_parts_are_counted_from_their_first_byte():
    """Bytes go to the frames in their order, text before one to none."""
    link = Link()
    link.begin(1.0, 100)
    link.begin(1.0, 200, 150)  # 50 bytes of text in between
    link.wrote(2.0, 120)
    assert link.under_way == 100
    link.wrote(3.0, 40)
    assert link.under_way == 110
    assert link.cut() == 0
    assert link.cut() is None
    assert link.answered(5.0).seconds == pytest.approx(3.0)
    flight = link.answered(6.0)
    assert (flight.sent, flight.seconds) == (10, pytest.approx(3.0))
