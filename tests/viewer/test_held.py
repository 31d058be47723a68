"""Which keys are held, on keyboards made of numbers: what is told of them, and what follows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from tsplat.terminal import Event
from tsplat.viewer.held import (
    KEEP_SECONDS,
    LOST_SECONDS,
    REPEAT_SECONDS,
    SILENT_SECONDS,
    TAP_SECONDS,
    UNPROVEN_SECONDS,
    Held,
)

NEAR = 1e-6  # s, of sums
SECONDS = 4.0  # that a story lasts: less than KEEP_SECONDS


@dataclass(frozen=True)
class Stroke:
    """A key down from ``begin`` to ``end``, in s."""

    key: str
    begin: float
    end: float

    @property
    def seconds(self):
        return self.end - self.begin


def told(strokes, delay, interval, terminal):
    """[(s, event)]: what a terminal tells of ``strokes``, in order.

    Only the key pressed last repeats, and none after its release. "kitty" tells all as it is,
    "konsole" (26.08) a release and a press for most repeats, "plain" only presses.
    """
    events = []
    for stroke in strokes:
        code = "" if terminal == "plain" else stroke.key
        events.append((stroke.begin, Event("key", stroke.key, code=code)))
        if code:
            events.append((stroke.end, Event("key", stroke.key, "release", code=code)))
        others = [s.begin for s in strokes if s.begin > stroke.begin]
        end, number = min([stroke.end, *others]), 0
        while (at := stroke.begin + delay + number * interval) < end:
            number += 1
            if terminal == "konsole" and at + 0.002 < end:
                action = "press" if number % 4 == 0 else "repeat"
                events.append((at, Event("key", stroke.key, "release", code=code)))
                events.append((at + 0.002, Event("key", stroke.key, action, code=code)))
            elif terminal != "konsole":
                action = "press" if terminal == "plain" else "repeat"
                events.append((at, Event("key", stroke.key, action, code=code)))
    return sorted(events, key=lambda item: item[0])


def heard(events, start=None):
    """The keys after ``events``."""
    keys = start or Held()
    for now, event in events:
        keys = keys.after(event, now)
    return keys


times = st.integers(0, 4000).map(lambda ms: ms / 1000)


@st.composite
def stories(draw):
    """Strokes of up to three keys within SECONDS; one key's do not overlap."""
    strokes = []
    for key in draw(st.sets(st.sampled_from("wad"), min_size=1)):
        edges = sorted(draw(st.sets(times, min_size=2, max_size=6)))
        pairs = zip(edges[::2], edges[1::2], strict=False)
        strokes += [Stroke(key, begin, end) for begin, end in pairs]
    return strokes


delays = st.integers(200, 660).map(lambda ms: ms / 1000)
intervals = st.integers(20, 90).map(lambda ms: ms / 1000)


def tried(run, start):
    """Runs a law; of wrong keys nobody wants the smallest example."""
    few = settings(max_examples=60)
    if start is not None:
        few = settings(max_examples=200, phases=[Phase.generate], database=None)
    few(run)()


# Each law is run with the keys as they are, and with wrong ones, which must break it.


def law_never_longer_than_the_key_was_down(start):
    """But for a tap's time where releases are told, and a repeat's where they are not."""

    @given(stories(), delays, intervals, st.sampled_from(["kitty", "konsole", "plain"]))
    def run(strokes, delay, interval, terminal):
        seconds = heard(told(strokes, delay, interval, terminal), start).active(0.0, 100.0)
        more = REPEAT_SECONDS if terminal == "plain" else TAP_SECONDS
        for key in "wad":
            own = [s for s in strokes if s.key == key]
            true = sum(s.seconds for s in own)
            assert seconds.get(key, 0.0) <= true + more * len(own) + NEAR

    tried(run, start)


def law_as_long_as_the_key_was_down(start):
    """Where releases are told: all of the time, and a tap's time at least."""

    @given(stories(), delays, intervals, st.sampled_from(["kitty", "konsole"]))
    def run(strokes, delay, interval, terminal):
        events = told(strokes, delay, interval, terminal)
        seconds = heard(events, start).active(0.0, 100.0)
        lost = 0.002 * len(events) if terminal == "konsole" else 0.0
        for key in "wad":
            true = sum(s.seconds for s in strokes if s.key == key)
            assert seconds.get(key, 0.0) >= true - lost - NEAR

    tried(run, start)


def law_a_tap_is_a_tap(start):
    """However short, it moves the same; longer ones by their time."""

    @given(st.integers(1, 300), st.sampled_from(["kitty", "konsole", "plain"]), times)
    def run(ms, terminal, begin):
        stroke = Stroke("w", begin, begin + ms / 1000)
        seconds = heard(told([stroke], 0.5, 0.04, terminal), start).active(0.0, 100.0)
        expected = TAP_SECONDS if terminal == "plain" else max(TAP_SECONDS, stroke.seconds)
        assert seconds == {"w": pytest.approx(expected)}

    tried(run, start)


def law_nothing_drifts_on(start):
    """Soon after the last event nothing is down; later if releases were lost, but not for ever."""

    @given(
        stories(), delays, intervals, st.sampled_from(["kitty", "konsole", "plain"]),
        st.sampled_from(["none", "some", "all"]), st.sets(st.integers(0, 40)),
    )  # fmt: skip
    def run(strokes, delay, interval, terminal, lost, some):
        events = told(strokes, delay, interval, terminal)
        kept = [
            item for i, item in enumerate(events)
            if lost == "none" or (i not in some if lost == "some" else item[1].action != "release")
        ]  # fmt: skip
        keys, last = heard(kept, start), kept[-1][0] if kept else 0.0
        more = REPEAT_SECONDS if terminal == "plain" else TAP_SECONDS
        more = more if lost == "none" else SILENT_SECONDS
        assert keys.down(last + more + NEAR) == frozenset()
        assert keys.active(last + more + NEAR, last + 100.0) == {}

    tried(run, start)


def law_a_lost_release_ends_soon(start):
    """Of a key that repeats; and when the focus is lost or the window changes, at once."""

    @given(delays, intervals, st.integers(1, 90))
    def run(delay, interval, count):
        events = told([Stroke("w", 0.0, delay + count * interval)], delay, interval, "kitty")[:-1]
        keys, last = heard(events, start), events[-1][0]
        assert keys.down(last + LOST_SECONDS - NEAR)
        assert not keys.down(last + LOST_SECONDS + NEAR)
        for event in (Event("focus", action="out"), Event("resize")):
            gone = keys.after(event, last + 0.01)
            assert not gone.down(last + 0.01)
            before = keys.active(last, last + 0.01)
            assert gone.active(last, last + 100.0) == pytest.approx(before)

    tried(run, start)


def law_polling_does_not_matter(start):
    """Sums over any pieces, asked for as time goes by, are the sum over all."""

    @given(
        stories(), delays, intervals, st.sampled_from(["kitty", "konsole", "plain"]),
        st.sets(times, max_size=9), st.none() | times,
    )  # fmt: skip
    def run(strokes, delay, interval, terminal, polls, away):
        events = told(strokes, delay, interval, terminal)
        if away is not None:
            events.append((away, Event("focus", action="out")))
            events.sort(key=lambda item: item[0])
        keys, since, sums = start or Held(), 0.0, {}
        steps = [(now, event) for now, event in events]
        steps += [(now, None) for now in (*polls, SECONDS + 1)]
        for now, event in sorted(steps, key=lambda item: item[0]):
            if event is not None:
                keys = keys.after(event, now)
                continue
            for key, seconds in keys.active(since, now).items():
                sums[key] = sums.get(key, 0.0) + seconds
            since = now
        assert sums == pytest.approx(keys.active(0.0, SECONDS + 1), abs=NEAR)

    tried(run, start)


def law_holding_is_continuous(start):
    """Without releases, too: from the first repeat on, also when some come late or in pairs."""

    @given(delays, intervals, st.integers(10, 30), st.lists(st.integers(0, 30), min_size=1))
    def run(delay, interval, count, late):
        end = delay + count * interval
        events = told([Stroke("w", 0.0, end)], delay, interval, "plain")
        keys = heard(
            [(now + interval * late[i % len(late)] / 100, e) for i, (now, e) in enumerate(events)],
            start,
        )
        second = delay + 1.3 * interval
        if interval <= TAP_SECONDS / 1.3:
            assert keys.active(second, end) == {"w": pytest.approx(end - second)}

    tried(run, start)


def law_releases_are_found(start):
    """Though Shift is up before the letter: "A" pressed, "a" released."""
    events = [(0.0, Event("key", "A", code="a")), (0.5, Event("key", "a", "release", code="a"))]
    keys = heard([(-1.0, Event("key", "x", "release", code="x")), *events], start)
    assert keys.active(0.0, 100.0) == {"A": pytest.approx(0.5)}


def law_no_time_counts_twice(start):
    """Two keys that make the same, as the keypad's and another, are one."""

    @given(times, times, times)
    def run(first, second, third):
        begin, middle, end = sorted((first, second, third))
        events = [
            (begin, Event("key", "+", code="keypad +")), (middle, Event("key", "+", code="+")),
            (end, Event("key", "+", "release", code="+")),
            (end, Event("key", "+", "release", code="keypad +")),
        ]  # fmt: skip
        seconds = heard(events, start).active(0.0, 100.0).get("+", 0.0)
        assert seconds <= end - begin + TAP_SECONDS + NEAR

    tried(run, start)


LAWS = {name: law for name, law in globals().items() if name.startswith("law_")}


class Drifts(Held):
    """Hears no release."""

    def _released(self, code, now):
        return self


class ByName(Held):
    """Looks a release up by what the key makes, not by what it is."""

    def after(self, event, now):
        return super().after(replace(event, code=event.code and event.key), now)

    def _released(self, code, now):
        return super()._released(code, now) if self._last(code) else self


class Blind(Held):
    """Does not hear of focus and sizes."""

    def after(self, event, now):
        return super().after(event, now) if event.kind == "key" else self


class PerPoll(Held):
    """A key moves a fixed step whenever it is asked for."""

    def active(self, since, now):
        return dict.fromkeys(super().active(since, now), 0.033)


class Double(Held):
    """Counts a key twice whose times overlap."""

    def active(self, since, now):
        return {
            key: sum(max(0.0, min(s.until, now) - max(s.begin, since))
                     for s in self.spans if s.key == key)
            for key in super().active(since, now)
        }  # fmt: skip


class Retroactive(Held):
    """Takes back what was already moved."""

    def _ended(self, now):
        return replace(self, spans=())


class Trusting(Held):
    """Waits for a release as long as it takes."""

    def _pressed(self, event, now):
        keys = super()._pressed(event, now)
        return replace(
            keys, spans=tuple(replace(s, until=1e9) if s.open else s for s in keys.spans)
        )


class Exact(Held):
    """A tap is as long as the key was down."""

    def _released(self, code, now):
        keys = super()._released(code, now)
        return replace(
            keys, spans=tuple(s if s.open else replace(s, until=min(s.until, now))
                              for s in keys.spans)
        )  # fmt: skip


class Sticky(Held):
    """A press lasts a second where no release is told."""

    def _typed(self, key, now):
        keys = super()._typed(key, now)
        return replace(keys, spans=(*keys.spans[:-1], replace(keys.spans[-1], until=now + 1.0)))


class Jerky(Held):
    """A press lasts no longer than repeats are apart."""

    def _typed(self, key, now):
        keys = super()._typed(key, now)
        last = keys.spans[-1]
        end = now + (min(last.interval, TAP_SECONDS) if last.interval else TAP_SECONDS)
        return replace(keys, spans=(*keys.spans[:-1], replace(last, until=end)))


WRONG = {
    "law_never_longer_than_the_key_was_down": [Drifts, Sticky],
    "law_no_time_counts_twice": [Double],
    "law_as_long_as_the_key_was_down": [PerPoll],
    "law_a_tap_is_a_tap": [Exact, Sticky, PerPoll],
    "law_nothing_drifts_on": [Drifts, Sticky, Trusting],
    "law_a_lost_release_ends_soon": [Blind, Trusting, Retroactive],
    "law_polling_does_not_matter": [PerPoll, Retroactive],
    "law_holding_is_continuous": [Jerky, PerPoll],
    "law_releases_are_found": [Drifts, ByName],
}


@pytest.mark.parametrize("name", LAWS)
def test_laws(name):
    """Each holds."""
    LAWS[name](None)


@pytest.mark.parametrize(("name", "wrong"), [(n, w) for n, ws in WRONG.items() for w in ws])
def test_laws_catch_what_is_wrong(name, wrong):
    """Each is broken by keys that are wrong in the way that it is about."""
    with pytest.raises(AssertionError):
        LAWS[name](wrong())
    assert set(WRONG) == set(LAWS)


def test_two_keys_at_once():
    """Both move while both are down, though only the later one repeats."""
    strokes = [Stroke("w", 0.0, 3.0), Stroke("a", 1.0, 2.0)]
    for terminal in ("kitty", "konsole"):
        seconds = heard(told(strokes, 0.5, 0.04, terminal)).active(0.0, 9.0)
        assert seconds == {"w": pytest.approx(3.0, abs=0.1), "a": pytest.approx(1.0, abs=0.1)}
    seconds = heard(told(strokes, 0.5, 0.04, "plain")).active(0.0, 9.0)
    assert 0.3 < seconds["a"] < 1.0
    assert 0.3 < seconds["w"] < 1.0  # its repeats ended with the press of the other


def test_silence_of_a_key_that_does_not_repeat():
    """W is held on while A is tapped: W stays down, but not for ever should its release be lost."""
    events = told([Stroke("w", 0.0, 60.0), Stroke("a", 1.0, 1.2)], 0.5, 0.04, "kitty")
    keys = heard(events[:-1])
    assert keys.down(1.2 + LOST_SECONDS + 1.0) == {"w"}
    assert not keys.down(1.2 + SILENT_SECONDS + NEAR)
    assert heard(events).active(30.0, 99.0) == {}


def test_a_terminal_that_tells_no_releases_though_it_was_to():
    """Until a release or repeat was seen none is believed in for long."""
    keys = heard([(0.0, Event("key", "up", code="up"))])
    assert keys.down(UNPROVEN_SECONDS - NEAR)
    assert not keys.down(UNPROVEN_SECONDS + NEAR)


def test_a_release_that_fits_no_press_ends_all():
    """Konsole 26 tells Shift and = as the key "+", and its release as that of "="."""
    keys = heard([
        (0.0, Event("key", "w", code="w")),
        (0.5, Event("key", "+", code="+")),
        (1.0, Event("key", "=", "release", code="=")),
    ])  # fmt: skip
    assert keys.active(0.0, 99.0) == {"w": pytest.approx(1.0), "+": pytest.approx(0.5)}


def test_shift_pressed_meanwhile():
    """The repeats of W then make another key; the time is divided between the two."""
    keys = heard([
        (0.0, Event("key", "w", code="w")),
        (0.5, Event("key", "w", "repeat", code="w")),
        (0.9, Event("key", "W", "repeat", code="w")),
        (1.5, Event("key", "W", "release", code="w")),
    ])  # fmt: skip
    assert keys.active(0.0, 99.0) == {"w": pytest.approx(0.9), "W": pytest.approx(0.6)}
    assert keys.down(1.2) == {"W"}
    plain = heard([(0.0, Event("key", "w")), (0.04, Event("key", "W"))])
    assert plain.active(0.0, 99.0)["w"] == pytest.approx(0.04)


def test_text_has_no_release():
    """What an input method made is a tap, also where releases are told."""
    keys = heard([(0.0, Event("key", "x", "release", code="x")), (1.0, Event("key", "w"))])
    assert keys.active(0.0, 99.0) == {"w": pytest.approx(TAP_SECONDS)}


def test_other_events_are_nothing():
    """The mouse and the terminal's answers hold no key; nor is the past kept for ever."""
    keys = Held()
    for kind in ("mouse", "ready", "terminal", "made"):
        assert keys.after(Event(kind), 1.0) is keys
    assert keys.after(Event("focus", action="in"), 1.0) is keys
    for number in range(1000):
        keys = keys.after(Event("key", "w"), float(number))
    assert len(keys.spans) <= KEEP_SECONDS + 1
    assert keys.active(995.5, 2000.0) == {"w": pytest.approx(4 * TAP_SECONDS)}
