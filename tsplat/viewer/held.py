"""Which keys are held down, and for how long; pure, so that it can be tested without a terminal.

A camera that moves by speed times seconds is as smooth as the frames are, whatever the keyboard's
repeat rate. Terminals with kitty's keyboard protocol tell when a key is let go
(https://sw.kovidgoyal.net/kitty/keyboard-protocol/#event-types); for others a key is down a little
after its press, and a little longer when it is pressed again and again, as one held down is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tsplat.terminal import Event

TAP_SECONDS = 0.1  # a key is down at least, so that a tap does not depend on luck
REPEAT_SECONDS = 0.15  # and at most after each press, where nobody tells that it is let go
MORE = 2.0  # of the interval between repeats, until the next is missed; they are not that regular
PATIENCE = 0.9  # an interval is forgotten so fast: over a network some come late, then two at once
# Where releases are told, how long a key stays down when nothing is heard of any
LOST_SECONDS = 2.0  # that should repeat: its release was lost
SILENT_SECONDS = 10.0  # when it does not: another that was pressed later has ended its repeats
UNPROVEN_SECONDS = 1.0  # as long as neither a release nor a repeat was ever told
AGAIN_SECONDS = 0.02  # Konsole 26 tells repeats as a release and a press a millisecond or two later
KEEP_SECONDS = 5.0  # what is longer ago is forgotten


@dataclass(frozen=True)
class Span:
    """Seconds for which one key was down, or will be."""

    key: str  # what it made when pressed
    code: str  # what it is known by
    begin: float
    until: float  # begin <= until; in the future while it is down
    pressed: float  # last, where releases are not told; first, where they are
    open: bool = False  # its release will be told and was not yet
    interval: float = 0.0  # s between repeats; 0 for not known


@dataclass(frozen=True)
class Held:
    """The keys as the events so far tell; ``after`` makes the next. Times are in s, of one clock.

    An event changes nothing before its time, so that ``active`` of two intervals with it in between
    is what ``active`` of both together would be.
    """

    spans: tuple[Span, ...] = ()
    told: bool = False  # a release or a repeat, ever
    repeats: bool = False  # a repeat, ever

    def after(self, event: Event, now: float) -> Held:
        """The keys after ``event``: of those that are known, none is before ``now``."""
        if event.kind == "resize" or (event.kind == "focus" and event.action == "out"):
            return self._ended(now)
        if event.kind != "key":
            return self
        kept = tuple(span for span in self.spans if span.until > now - KEEP_SECONDS)
        held = replace(self, spans=kept)
        if event.action != "press":
            held = replace(held, told=True, repeats=self.repeats or event.action == "repeat")
        if event.action == "release":
            return held._released(event.code, now)
        return held._pressed(event, now) if event.code else held._typed(event.key, now)

    def active(self, since: float, now: float) -> dict[str, float]:
        """Key -> seconds for which it was down between; without those that were not at all.

        ``since`` is at most ``KEEP_SECONDS`` before the last event.
        """
        seconds: dict[str, float] = {}
        for key in {span.key: None for span in self.spans}:
            end, total = since, 0.0
            for span in sorted((s for s in self.spans if s.key == key), key=lambda s: s.begin):
                until = min(span.until, now)
                total += max(0.0, until - max(span.begin, end))
                end = max(end, until)
            if total > 0:
                seconds[key] = total
        return seconds

    def down(self, now: float) -> frozenset[str]:
        """The keys that are down at ``now``; none: nothing will move without an event."""
        return frozenset(span.key for span in self.spans if span.begin <= now < span.until)

    def _ended(self, now: float) -> Held:
        """All let go."""
        spans = (replace(s, until=min(s.until, now), open=False) for s in self.spans)
        return replace(self, spans=tuple(spans))

    def _released(self, code: str, now: float) -> Held:
        """One let go; if it is none that was pressed, all.

        Konsole 26 tells Shift and = as the key "+", and as "=" once Shift is up; a layout may have
        been switched.
        """
        every = not any(span.open and span.code == code for span in self.spans)

        def changed(span: Span) -> Span:
            if not span.open:
                return span
            if every or span.code == code:
                return replace(span, until=max(now, span.pressed + TAP_SECONDS), open=False)
            return replace(span, until=now + SILENT_SECONDS)

        return replace(self, spans=tuple(map(changed, self.spans)))

    def _pressed(self, event: Event, now: float) -> Held:
        """One whose release will be told is down. All that are stay so."""
        limit = LOST_SECONDS if self.repeats else SILENT_SECONDS if self.told else UNPROVEN_SECONDS
        spans = [replace(s, until=now + limit) if s.open else s for s in self.spans]
        last = self._last(event.code)
        if last is not None and last.open and last.key == event.key:
            return replace(self, spans=tuple(spans))
        pressed = now if event.action == "press" else -math.inf  # a repeat is no tap
        if last is not None and (last.open or _again(last, now)):
            pressed = last.pressed
        if last is not None and last.open:  # Shift makes something else of it now
            at = self.spans.index(last)
            spans[at] = replace(last, until=now, open=False)
        spans.append(Span(event.key, event.code, now, now + limit, pressed, open=True))
        return replace(self, spans=tuple(spans))

    def _typed(self, key: str, now: float) -> Held:
        """One whose release nobody will tell was pressed, or repeated."""
        code = "typed " + (key.rpartition("+")[2] or key).lower()
        last = self._last(code)
        interval, spans = 0.0, list(self.spans)
        if last is not None and now - last.pressed <= REPEAT_SECONDS:
            interval = max(now - last.pressed, PATIENCE * last.interval)
        until = now + (min(MORE * interval, REPEAT_SECONDS) if interval else TAP_SECONDS)
        begin = now
        if last is not None and last.until >= now:
            at = spans.index(last)
            if last.key == key:
                begin, until = last.begin, max(last.until, until)
                del spans[at]
            else:
                spans[at] = replace(last, until=now)
        spans.append(Span(key, code, begin, until, now, interval=interval))
        return replace(self, spans=tuple(spans))

    def _last(self, code: str) -> Span | None:
        """What was heard last of a key."""
        return next((span for span in reversed(self.spans) if span.code == code), None)


def _again(last: Span, now: float) -> bool:
    """Whether a key was let go so shortly ago that it was not; a tap's time may end any time."""
    tapped = last.until <= last.pressed + TAP_SECONDS
    return not tapped and now - last.until < AGAIN_SECONDS
