"""The work-precision diagram: error against time, both logarithmic, a line per backend.

Such diagrams are how solvers of stiff equations are compared: E. Hairer and G. Wanner, "Solving
Ordinary Differential Equations II", 1996, section IV.10.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from tsplat.core.errors import TsplatError
from tsplat.core.types import Frame
from tsplat.quality.sweep import FLOOR, Row

DOTS = 120
"""px per inch."""

MARKERS = "osD^vP*X"


def available() -> str | None:
    """Why nothing can be drawn, and what to do; None if it can."""
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        return 'diagrams need matplotlib: pip install "tsplat[bench]"'
    return None


def _figure(rows: Sequence[Row], title: str, size: tuple[float, float]) -> Any:
    """A matplotlib figure of ``size`` in inches."""
    if reason := available():
        raise TsplatError(reason)
    from matplotlib.figure import Figure  # without pyplot: no window, no global state

    figure = Figure(figsize=size, dpi=DOTS, layout="constrained")
    axes = figure.add_subplot()
    for marker, backend in zip(_cycled(MARKERS), _backends(rows), strict=False):
        own = [row for row in rows if row.backend == backend]
        points = sorted((1e3 * row.seconds()[0], max(row.error.p999, FLOOR)) for row in own)
        (line,) = axes.plot(*zip(*_front(points), strict=True), "-", linewidth=1.2, alpha=0.7)
        axes.plot(
            *zip(*points, strict=True), marker, color=line.get_color(), markersize=5, label=backend
        )
    best = sorted((1e3 * r.seconds()[0], max(r.error.p999, FLOOR)) for r in rows if r.optimal)
    if best:
        axes.plot(
            *zip(*best, strict=True), color="0.2", linewidth=4, alpha=0.2, label="best of all"
        )
    _name(axes, rows)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for formatter in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        formatter(lambda value, _: f"{value:g}")
    axes.set_xlabel("ms per picture")
    axes.set_ylabel("error, 8-bit levels (99.9th percentile)")
    axes.set_title(title, loc="left", fontsize=10)
    axes.grid(visible=True, which="both", linewidth=0.3, alpha=0.6)
    axes.legend(frameon=False, fontsize=8)
    return figure


def _cycled(text: str) -> Any:
    from itertools import cycle

    return cycle(text)


def _backends(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(row.backend for row in rows))


def _front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Of points in order of time, those that nothing faster is nearer the ideal than."""
    out: list[tuple[float, float]] = []
    for time, error in points:
        if not out or error < out[-1][1]:
            out.append((time, error))
    return out


def _name(axes: Any, rows: Sequence[Row]) -> None:
    """Words beside the best rows, and beside the presets of the fastest backend."""
    fastest = min(rows, key=lambda row: row.seconds()[0]).backend
    named = [r for r in rows if r.optimal or (r.backend == fastest and "=" not in r.setting)]
    for row in {row.setting: row for row in sorted(named, key=lambda r: -r.seconds()[0])}.values():
        axes.annotate(
            row.setting, (1e3 * row.seconds()[0], max(row.error.p999, FLOOR)),
            xytext=(4, 4), textcoords="offset points", fontsize=6.5, color="0.25",
        )  # fmt: skip


def draw(rows: Sequence[Row], title: str, suffix: str) -> bytes:
    """The bytes of a PNG or SVG file.

    Raises:
        TsplatError: matplotlib is not installed.
    """
    buffer = io.BytesIO()
    _figure(rows, title, (9, 6)).savefig(buffer, format=suffix.lstrip("."))
    return buffer.getvalue()


def picture(rows: Sequence[Row], title: str, width: int, height: int) -> Frame:
    """The diagram as a frame of ``width`` x ``height`` px, for a presenter.

    Raises:
        TsplatError: matplotlib is not installed.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = _figure(rows, title, (width / DOTS, height / DOTS))
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].astype(np.float32) / 255
    return Frame(np.ascontiguousarray(pixels), np.zeros(pixels.shape[:2], np.float32))
