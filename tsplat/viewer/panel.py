"""The panel: which row is chosen, how far it is scrolled, and its lines as bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from tsplat.terminal import Event
from tsplat.terminal.device import PLAIN
from tsplat.viewer.controls import View
from tsplat.viewer.layout import Area
from tsplat.viewer.settings import Facts, Row, sections
from tsplat.viewer.text import BOLD, REVERSE, cup, padded, width, wrapped

NAME = 19  # columns of a row's name, where there is room for
VALUE = 15  # columns of its value at least; else long ones have lines of their own
MARKS = 4  # columns of "< >" about the chosen value
NOTCH = 3  # lines that the wheel scrolls
MORE_ROWS = 4  # at least, for one of them to say that there are more
MORE = "  more below"
KEPT = 512  # rows, and lines, that are not worked out again; several times those of a panel


@dataclass(frozen=True)
class _Stop:
    """A row that can be chosen: one that can be set, or any of a section that only says."""

    key: str  # no other has it
    row: Row


_Sections = list[tuple[str, list[tuple[Row, _Stop | None]]]]


@dataclass(frozen=True)
class _Line:
    text: str
    key: str | None = None  # of the stop that it belongs to
    value: int | None = None  # column where the value begins; None: there is none on this line
    title: bool = False


@dataclass(frozen=True)
class Panel:
    """The chosen row is known by its key, as rows come and go; where it was helps if it is gone."""

    key: str = ""
    place: int = 0  # among rows that can be chosen
    top: int = 0  # lines above what is shown, as of the last event
    loose: bool = False  # scrolled by the wheel: what is chosen may be out of sight

    def after(
        self, event: Event, view: View, facts: Facts, area: Area
    ) -> tuple[Panel, View] | None:
        """Panel and view after an event; None if it is none of the panel's."""
        if event.kind == "key" and event.key in ("up", "down", "pageup", "pagedown"):
            page = max(1, area.rows - 2)
            by = {"up": -1, "down": 1, "pageup": -page, "pagedown": page}[event.key]
            stops = _stops(view, facts)
            place = min(max(self._chosen(stops)[0] + by, 0), len(stops) - 1)
            return self._at(stops, place).seen(view, facts, area), view
        if event.kind == "key" and event.key in ("left", "right", "enter"):
            return self._changed(view, facts, area, -1 if event.key == "left" else 1)
        if event.kind == "key" and event.key in ("backspace", "delete"):
            row = self._chosen(_stops(view, facts))[1].row
            after = row.first(view) if row.first else view
            return self.seen(after, facts, area), after
        if event.kind == "mouse" and area.has(event.x, event.y):
            return self._after_mouse(event, view, facts, area)
        return None

    def _after_mouse(
        self, event: Event, view: View, facts: Facts, area: Area
    ) -> tuple[Panel, View]:
        if event.action == "wheel" and event.button in ("up", "down"):
            by = -NOTCH if event.button == "up" else NOTCH
            return self._scrolled(by, view, facts, area), view
        if event.action != "press":
            return self, view
        lines, top, _ = self._shown(view, facts, area)
        row = int(event.y - area.top)
        if _more(lines, top, area) and row == area.rows - 1:
            return self._scrolled(max(1, area.rows - 2), view, facts, area), view
        line = lines[top + row] if top + row < len(lines) else None
        if line is None or line.key is None:
            return self, view
        stops = _stops(view, facts)
        place = [stop.key for stop in stops].index(line.key)
        there = replace(self._at(stops, place), top=top)
        across = event.x - area.left
        if line.value is None or across < line.value:
            return there.seen(view, facts, area), view
        backwards = event.button == "right" or across < (line.value + area.columns) / 2
        return there._changed(view, facts, area, -1 if backwards else 1)

    def seen(self, view: View, facts: Facts, area: Area) -> Panel:
        """Scrolled to where the chosen row is shown."""
        fixed = replace(self, loose=False)
        return replace(fixed, top=fixed._shown(view, facts, area)[1])

    def lines(self, view: View, facts: Facts, area: Area) -> list[bytes]:
        """``area.rows`` lines, each as wide as the area, without their places."""
        lines, top, chosen = self._shown(view, facts, area)
        out = [
            _bytes(line, area.columns, line.key == chosen.key)
            for line in lines[top : top + area.rows]
        ]
        out += [padded("", area.columns).encode()] * (area.rows - len(out))
        if _more(lines, top, area):
            out[-1] = padded(MORE, area.columns).encode()
        return out

    def chosen(self, view: View, facts: Facts) -> Row:
        """The row that keys set."""
        return self._chosen(_stops(view, facts))[1].row

    def _chosen(self, stops: Sequence[_Stop]) -> tuple[int, _Stop]:
        for place, stop in enumerate(stops):
            if stop.key == self.key:
                return place, stop
        place = min(self.place, len(stops) - 1)
        return place, stops[place]

    def _at(self, stops: Sequence[_Stop], place: int) -> Panel:
        return replace(self, key=stops[place].key, place=place)

    def _changed(self, view: View, facts: Facts, area: Area, by: int) -> tuple[Panel, View]:
        stops = _stops(view, facts)
        place, stop = self._chosen(stops)
        after = view if stop.row.step is None else stop.row.step(view, by, facts)
        return self._at(stops, place).seen(after, facts, area), after

    def _scrolled(self, by: int, view: View, facts: Facts, area: Area) -> Panel:
        lines, top, _ = self._shown(view, facts, area)
        most = max(0, len(lines) - area.rows)
        return replace(self, top=min(max(top + by, 0), most), loose=True)

    def _shown(self, view: View, facts: Facts, area: Area) -> tuple[list[_Line], int, _Stop]:
        """All lines, how many of them are above the first that is seen, and what is chosen."""
        every = _sections(view, facts)
        chosen = self._chosen([stop for _, rows in every for _, stop in rows if stop])[1]
        lines = _lines(every, view, facts, area.columns, chosen)
        most = max(0, len(lines) - area.rows)
        top = min(self.top, most)
        if self.loose:
            return lines, top, chosen
        mine = [i for i, line in enumerate(lines) if line.key == chosen.key]
        first, last, room = mine[0], mine[-1], area.rows
        if room >= MORE_ROWS:
            room -= 1  # the last one may be taken
            first -= lines[first - 1].title
        if last >= top + room:
            top = min(last + 1 - room, most)
        return lines, min(top, first), chosen


def placed(lines: Sequence[bytes], before: Sequence[bytes], area: Area) -> bytes:
    """Those of ``lines`` that differ from ``before``, at their places."""
    out = b""
    for i, line in enumerate(lines):
        if i >= len(before) or before[i] != line:
            out += cup(area.top + i + 1, area.left + 1) + line
    return PLAIN + out if out else b""


def _stops(view: View, facts: Facts) -> list[_Stop]:
    return [stop for _, rows in _sections(view, facts) for _, stop in rows if stop]


def _sections(view: View, facts: Facts) -> _Sections:
    """Titles, and their rows with what makes them ones that can be chosen."""
    out = []
    for title, rows in sections(view, facts):
        only_said = all(row.step is None for row in rows)
        seen: dict[str, int] = {}
        pairs: list[tuple[Row, _Stop | None]] = []
        for row in rows:
            seen[row.name] = number = seen.get(row.name, 0) + 1
            key = f"{title}/{row.name}/{number}"
            pairs.append((row, _Stop(key, row) if only_said or row.step is not None else None))
        if rows:
            out.append((title, pairs))
    return out


def _lines(every: _Sections, view: View, facts: Facts, columns: int, chosen: _Stop) -> list[_Line]:
    out: list[_Line] = []
    for title, rows in every:
        out.append(_Line(title, title=True))
        for row, stop in rows:
            key, words = stop.key if stop else None, row.text(view, facts)
            out += _row_lines(row.name, row.step is not None, key, words, columns, stop == chosen)
    return out


@lru_cache(maxsize=KEPT)
def _row_lines(
    name: str, can_be_set: bool, key: str | None, words: str, columns: int, chosen: bool
) -> tuple[_Line, ...]:
    """Name and value beside each other; below each other where they do not fit."""
    if can_be_set:
        words = f"< {words} >" if chosen else f"  {words}"
    beside = columns - NAME - (0 if can_be_set else 2)
    if beside >= VALUE:
        parts = [words] if can_be_set else wrapped(words, beside)
        names = [name] + [""] * (len(parts) - 1)
        gap = NAME - 2 if can_be_set else NAME
        value = NAME if can_be_set else None
        return tuple(
            _Line("  " + padded(left, gap) + part, key, value)
            for left, part in zip(names, parts, strict=True)
        )
    value_columns = width(words) + (0 if chosen or not can_be_set else 2)  # as wide when chosen
    if 1 + width(name) + 1 + value_columns <= columns:
        at = columns - value_columns
        return (_Line(padded(f" {name}", at) + words, key, at if can_be_set else None),)
    if can_be_set:
        return _Line(f" {name}", key), _Line(" " + words, key, 0)
    parts = wrapped(words, max(1, columns - 3))
    return _Line(f" {name}", key), *(_Line("   " + part, key) for part in parts)


def _more(lines: Sequence[_Line], top: int, area: Area) -> bool:
    """Whether the last row says that there are more lines."""
    return area.rows >= MORE_ROWS and top + area.rows < len(lines)


@lru_cache(maxsize=KEPT)
def _bytes(line: _Line, columns: int, chosen: bool) -> bytes:
    shown = padded(line.text, columns).encode()
    style = BOLD if line.title else REVERSE if chosen else b""
    return style + shown + PLAIN if style else shown
