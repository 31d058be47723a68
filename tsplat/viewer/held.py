"""Stand-in."""

from __future__ import annotations

import math

from tsplat.terminal import Event


class Held:
    """Keys down."""

    def __init__(self) -> None:
        self._keys: dict[str, tuple[str, float, float]] = {}

    def after(self, event: Event, now: float) -> None:
        if event.kind != "key":
            return
        code = event.code or event.key
        if event.action == "release":
            if code in self._keys:
                key, begin, _ = self._keys[code]
                self._keys[code] = key, begin, max(begin + 0.1, now)
        else:
            begin = (
                self._keys[code][1] if code in self._keys and self._keys[code][2] >= now else now
            )
            self._keys[code] = event.key, begin, math.inf if event.code else now + 0.1

    def active(self, since: float, now: float) -> dict[str, float]:
        out = {}
        for key, begin, end in self._keys.values():
            if (end > now and begin <= now) or min(now, end) > max(since, begin):
                out[key] = max(0.0, min(now, end) - max(since, begin))
        return out
