"""The panel: which row is chosen, how far it is scrolled, and its lines as bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from tsplat.terminal import Event
from tsplat.viewer.controls import View
from tsplat.viewer.layout import Area
from tsplat.viewer.settings import Facts, Row, sections
from tsplat.viewer.text import BOLD, PLAIN, REVERSE, cup, fitted

NAME = 19  # columns of a row's name


@dataclass(frozen=True)
class Panel:
    """Rows are counted without titles."""

    chosen: int = 0
    top: int = 0  # lines, titles among them, that are above what is shown

    def after(
        self, event: Event, view: View, facts: Facts, area: Area
    ) -> tuple[Panel, View] | None:
        """Panel and view after an event; None if it is none of the panel's."""
        if event.kind == "key" and event.key in ("up", "down", "pageup", "pagedown"):
            page = max(1, area.rows - 2)
            by = {"up": -1, "down": 1, "pageup": -page, "pagedown": page}[event.key]
            return self._moved(by, view, facts, area), view
        if event.kind == "key" and event.key in ("left", "right", "enter"):
            return self, self._stepped(view, facts, -1 if event.key == "left" else 1)
        if event.kind == "key" and event.key in ("backspace", "delete"):
            row = _settable(view, facts)[self.chosen]
            return self, row.first(view) if row.first else view
        if event.kind == "mouse" and area.has(event.x, event.y):
            return self._after_mouse(event, view, facts, area)
        return None

    def _after_mouse(
        self, event: Event, view: View, facts: Facts, area: Area
    ) -> tuple[Panel, View]:
        if event.action == "wheel" and event.button in ("up", "down"):
            return self._scrolled(-3 if event.button == "up" else 3, view, facts, area), view
        if event.action != "press":
            return self, view
        lines = _lines(view, facts)
        place = self.top + int(event.y) - area.top
        row = lines[place] if place < len(lines) else None
        rows = _settable(view, facts)
        if not isinstance(row, Row) or row not in rows:
            return self, view
        there = replace(self, chosen=rows.index(row))
        across = event.x - area.left
        if across < NAME:
            return there, view
        middle = NAME + (area.columns - NAME) / 2
        backwards = event.button == "right" or across < middle
        return there, there._stepped(view, facts, -1 if backwards else 1)

    def _moved(self, by: int, view: View, facts: Facts, area: Area) -> Panel:
        """To another row that can be set; it is shown. Past the last one the lines below."""
        rows = _settable(view, facts)
        if by > 0 and self.chosen == len(rows) - 1:
            return self._scrolled(by, view, facts, area)  # to the figures
        chosen = min(max(self.chosen + by, 0), len(rows) - 1)
        place = _lines(view, facts).index(rows[chosen])
        top = min(self.top, place - 1)  # the title above it is seen as well
        return Panel(chosen, max(0, top, place + 2 - area.rows))

    def _scrolled(self, by: int, view: View, facts: Facts, area: Area) -> Panel:
        most = max(0, len(_lines(view, facts)) - area.rows)
        return replace(self, top=min(max(self.top + by, 0), most))

    def _stepped(self, view: View, facts: Facts, by: int) -> View:
        rows = _settable(view, facts)
        row = rows[min(self.chosen, len(rows) - 1)]
        return view if row.step is None else row.step(view, by, facts)

    def lines(self, view: View, facts: Facts, area: Area) -> list[bytes]:
        """``area.rows`` lines, each as wide as the area, without their places."""
        rows, shown = _lines(view, facts), []
        chosen = _settable(view, facts)[min(self.chosen, len(_settable(view, facts)) - 1)]
        for row in rows[self.top : self.top + area.rows]:
            shown.append(_title(row, area.columns) if isinstance(row, str) else
                         _line(row, view, facts, area.columns, row is chosen))  # fmt: skip
        blank = b" " * area.columns
        shown += [blank] * (area.rows - len(shown))
        if self.top + area.rows < len(rows) and area.rows > 1:
            shown[-1] = _padded("  more below", area.columns)
        return shown


def placed(lines: Sequence[bytes], before: Sequence[bytes], area: Area) -> bytes:
    """Those of ``lines`` that differ from ``before``, at their places."""
    out = b""
    for i, line in enumerate(lines):
        if i >= len(before) or before[i] != line:
            out += cup(area.top + i + 1, area.left + 1) + line
    return PLAIN + out if out else b""


def _lines(view: View, facts: Facts) -> list[str | Row]:
    out: list[str | Row] = []
    for title, rows in sections(view, facts):
        if rows:
            out += [title, *rows]
    return out


def _settable(view: View, facts: Facts) -> list[Row]:
    return [row for _, rows in sections(view, facts) for row in rows if row.step is not None]


def _padded(text: str, columns: int) -> bytes:
    shown = fitted(text, columns)
    return (shown + " " * (columns - len(shown))).encode()


def _title(text: str, columns: int) -> bytes:
    return BOLD + _padded(text, columns) + PLAIN


def _line(row: Row, view: View, facts: Facts, columns: int, chosen: bool) -> bytes:
    value = row.text(view, facts)
    if row.step is None:
        return _padded(f"  {row.name:<{NAME}}{value}", columns)
    value = f"< {value} >" if chosen else f"  {value}"
    line = _padded(f"  {row.name:<{NAME - 2}}{value}", columns)
    return REVERSE + line + PLAIN if chosen else line
