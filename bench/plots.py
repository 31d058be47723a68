"""Charts as SVG, by hand: lines on logarithmic axes, each named at its right end."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from itertools import pairwise

WIDTH, HEIGHT = 450, 380  # px, of a panel
LEFT, RIGHT, TOP, BOTTOM = 52, 128, 36, 46  # px round the axes
LINE = 14  # px between two names
ENOUGH = 3  # numbers along an axis
INK, FAINT, PAPER = "#33373d", "#e4e6ea", "#ffffff"
STYLES = {  # the C kernel in shades of one blue
    "cffi/avx512": ("#0b3d91", ""),
    "cffi/avx2": ("#2f7ed8", ""),
    "cffi/generic": ("#8fb8ea", ""),
    "cffi": ("#0b3d91", ""),
    "numba": ("#e07b00", ""),
    "numpy": ("#2e8b57", ""),
    "yardstick": ("#70757d", "5 3"),
}


@dataclass(frozen=True)
class Series:
    """A line; its name decides its colour."""

    name: str
    points: list[tuple[float, float]]
    note: str = ""  # behind the name
    marks: list[str] | None = None  # beside the points


@dataclass(frozen=True)
class Axis:
    """What is along a side, and how its numbers are written."""

    title: str
    form: Callable[[float], str]
    logarithmic: bool = True

    def ticks(self, low: float, high: float) -> list[float]:
        """Round numbers from ``low`` to ``high``."""
        if not self.logarithmic:
            step = 10.0 if high - low > 20 else 5.0
            return [step * k for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
        for steps in ((1,), (1, 2, 5), (1, 1.5, 2, 3, 5, 7)):
            found = [m * 10.0**e for e in range(-3, 10) for m in steps]
            found = [value for value in found if low <= value <= high]
            if len(found) >= ENOUGH:
                break
        return found

    def place(self, value: float, low: float, high: float) -> float:
        """0 at ``low``, 1 at ``high``."""
        if self.logarithmic:
            value, low, high = math.log(value), math.log(low), math.log(high)
        return (value - low) / (high - low)

    def range(self, values: list[float]) -> tuple[float, float]:
        """A little more than ``values``."""
        low, high = min(values), max(values)
        if self.logarithmic:
            room = (high / low) ** 0.05 * 1.05
            return low / room, high * room
        room = (high - low) * 0.08 + 1
        return low - room, high + room


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    title: str
    x: Axis
    y: Axis
    series: list[Series]


def short(value: float) -> str:
    """10k, 2M."""
    for unit, name in ((1e6, "M"), (1e3, "k")):
        if value >= unit:
            return f"{value / unit:g}{name}"
    return f"{value:g}"


def slope(points: list[tuple[float, float]]) -> float:
    """Of the straight line through the logarithms, least squares."""
    xs, ys = ([math.log(p[k]) for p in points] for k in (0, 1))
    middle_x, middle_y = sum(xs) / len(xs), sum(ys) / len(ys)
    across = sum((x - middle_x) ** 2 for x in xs)
    return sum((x - middle_x) * (y - middle_y) for x, y in zip(xs, ys, strict=True)) / across


def figure(panels: list[Panel]) -> str:
    """The panels side by side."""
    width = WIDTH * len(panels)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {HEIGHT}" width="{width}" '
        f'height="{HEIGHT}" font-family="Helvetica, Arial, sans-serif" font-size="11">',
        f'<rect width="{width}" height="{HEIGHT}" rx="6" fill="{PAPER}"/>',
    ]
    for k, panel in enumerate(panels):
        parts += [f'<g transform="translate({k * WIDTH} 0)">', *_panel(panel), "</g>"]
    return "\n".join([*parts, "</svg>\n"])


def _panel(panel: Panel) -> list[str]:
    points = [point for series in panel.series for point in series.points]
    ranges = [axis.range([p[k] for p in points]) for k, axis in enumerate((panel.x, panel.y))]
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM

    def at(point: tuple[float, float]) -> tuple[float, float]:
        x = panel.x.place(point[0], *ranges[0])
        y = panel.y.place(point[1], *ranges[1])
        return LEFT + x * (right - LEFT), bottom - y * (bottom - TOP)

    parts = [_text(LEFT, 20, panel.title, size=13, weight="bold")]
    for value in panel.x.ticks(*ranges[0]):
        x, _ = at((value, points[0][1]))
        parts.append(_line(x, TOP, x, bottom, FAINT))
        parts.append(_text(x, bottom + 16, panel.x.form(value), "middle"))
    for value in panel.y.ticks(*ranges[1]):
        _, y = at((points[0][0], value))
        parts.append(_line(LEFT, y, right, y, FAINT))
        parts.append(_text(LEFT - 7, y + 4, panel.y.form(value), "end"))
    parts.append(_line(LEFT, bottom, right, bottom, INK))
    parts.append(_text((LEFT + right) / 2, HEIGHT - 10, panel.x.title, "middle"))
    middle = (TOP + bottom) / 2
    turned = f' transform="rotate(-90 13 {middle:.1f})"'
    parts.append(_text(13, middle, panel.y.title, "middle", more=turned))
    for series in panel.series:
        parts += _series(series, [at(point) for point in series.points])
    ends = [at(max(series.points))[1] for series in panel.series]
    for series, y in zip(panel.series, _apart(ends, TOP, bottom), strict=True):
        name = f"{series.name} {series.note}".strip()
        parts.append(_text(right + 8, y + 4, name, color=STYLES[series.name][0], weight="bold"))
    return parts


def _series(series: Series, places: list[tuple[float, float]]) -> list[str]:
    color, dash = STYLES[series.name]
    along = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    parts = [
        f'<polyline points="{along}" fill="none" stroke="{color}" stroke-width="2" '
        f'stroke-linejoin="round"{dashed}/>'
    ]
    for x, y in places:
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{color}" stroke="{PAPER}"/>')
    for (x, y), mark in zip(places, series.marks or [], strict=False):
        parts.append(_text(x + 6, y + 14, mark, color=color, size=10))
    return parts


def _apart(heights: list[float], top: float, bottom: float) -> list[float]:
    """``heights`` moved as little as keeps names from covering each other."""
    order = sorted(range(len(heights)), key=heights.__getitem__)
    moved = [heights[k] for k in order]
    for _ in range(200):
        for k, (upper, lower) in enumerate(pairwise(moved)):
            push = max(0.0, LINE - (lower - upper)) / 2
            moved[k] -= push
            moved[k + 1] += push
        moved = [min(max(y, top), bottom) for y in moved]
    placed = [0.0] * len(heights)
    for k, y in zip(order, moved, strict=True):
        placed[k] = y
    return placed


def _line(x0: float, y0: float, x1: float, y1: float, color: str) -> str:
    return f'<path d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}" stroke="{color}"/>'


def _text(
    x: float, y: float, text: str, anchor: str = "start", *, color: str = INK, size: int = 11,
    weight: str = "normal", more: str = "",
) -> str:  # fmt: skip
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{color}" '
        f'font-size="{size}" font-weight="{weight}"{more}>{escape(text)}</text>'
    )
