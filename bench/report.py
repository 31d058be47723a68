"""Puts the figures of bench/results.json into docs/performance.md, and draws its charts.

    python bench/frames.py --full --json bench/results.json && python bench/report.py

Text between ``<!-- NAME -->`` and ``<!-- /NAME -->`` is replaced; the rest of the page is left.
"""

from __future__ import annotations

import json
import re
import statistics
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from plots import Axis, Panel, Series, figure, short, slope
from presets import COUNTS

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "performance.md"
RESULTS = ROOT / "bench" / "results.json"
YARDSTICK = "yardstick"
FUSED = ("cffi/avx512", "cffi/avx2", "cffi/generic", "numba")
DRAWN = (*FUSED, "numpy", YARDSTICK)
SWEEP_SIZE, SWEEP_COUNT, SWEEP_THREADS = "1280x720", 200_000, 1
KINDS = ("random", "surface")

Row = dict[str, Any]
MILLISECONDS = Axis("ms per frame", lambda value: f"{value:g}")


def size(row: Row) -> str:
    """As 1280x720."""
    return f"{row['width']}x{row['height']}"


def where(rows: list[Row], **wanted: object) -> list[Row]:
    """Rows that have these values."""
    return [r for r in rows if all({**r, "size": size(r)}[k] == v for k, v in wanted.items())]


def table(headings: Sequence[str], lines: Iterable[Sequence[str]], left: int = 1) -> str:
    """Markdown; all but the first ``left`` columns are numbers."""
    ruler = ["---"] * left + ["--:"] * (len(headings) - left)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (headings, ruler, *lines))


def pictures(rows: list[Row]) -> list[tuple[str, str, int]]:
    """Scene, size and threads of all rows, in order."""
    return list(dict.fromkeys((r["scene"], size(r), r["threads"]) for r in rows))


def per_picture(rows: list[Row], names: Sequence[str], cell: Any) -> list[list[str]]:
    """One line for each picture: a cell for each contestant, empty where it was not timed."""
    lines = []
    for scene, pixels, threads in pictures(rows):
        here = {r["backend"]: r for r in where(rows, scene=scene, size=pixels, threads=threads)}
        cells = [cell(here[name]) if name in here else "" for name in names]
        lines.append([scene, pixels, str(threads), *cells])
    return lines


def present(rows: list[Row], names: Sequence[str]) -> list[str]:
    """Those of ``names`` that were timed."""
    return [name for name in names if any(r["backend"] == name for r in rows)]


def machine_table(found: dict[str, Any]) -> str:
    sets = list(next(iter(found["limits"].values()))["lanes"]) if found["limits"] else []
    lines = [
        [
            threads, f"{limit['read'] / 1e9:.1f}", f"{limit['write'] / 1e9:.1f}",
            *(f"{limit['lanes'][name] / 1e9:.0f}" for name in sets),
        ]
        for threads, limit in found["limits"].items()
    ]  # fmt: skip
    headings = ["threads", "GB/s read", "GB/s written", *(f"{s}, 10⁹ lanes/s" for s in sets)]
    spread = statistics.median(r["spread"] for r in found["rows"])
    said = (
        f"{found['processor']}. Minima of {found['runs']} runs, of which the middle half spans "
        f"{spread:.0%} of the minimum (median of all rows); {found['minutes']:.0f} minutes in all."
    )
    return said + "\n\n" + table(headings, lines)


def ratio_table(rows: list[Row]) -> str:
    names = present(rows, FUSED)
    lines = per_picture(rows, names, lambda r: f"{r['ratio']:.1f}" if r["ratio"] else "")
    return table(["scene", "picture", "threads", *names], lines, 2)


def time_table(rows: list[Row]) -> str:
    names = present(rows, (*FUSED, YARDSTICK))
    lines = per_picture(
        rows, names, lambda r: f"{r['ms']['total']:.1f} / {r['ms_median']['total']:.1f}"
    )
    return table(["scene", "picture", "threads", *names], lines, 2)


def stage_table(rows: list[Row]) -> str:
    stages = ("project", "sort", "bin", "composite", "total")
    lines = [
        [r["scene"], r["backend"], *(f"{r['ms'][s]:.1f}" if s in r["ms"] else "" for s in stages)]
        for r in where(rows, size=SWEEP_SIZE, threads=SWEEP_THREADS)
        if r["gaussians"] in {SWEEP_COUNT, 1_000_000}
    ]
    return table(["scene", "backend", *stages], lines, 2)


def floor_table(rows: list[Row]) -> str:
    names = present(rows, FUSED)
    lines = []
    for scene, pixels, threads in pictures(rows):
        here = {r["backend"]: r for r in where(rows, scene=scene, size=pixels, threads=threads)}
        first = next(iter(here.values()))
        work = first["work"]
        moved = sum(work["read"].values()) + sum(work["written"].values())
        shares = [
            f"{here[n]['floor_share']:.0%}" if n in here and here[n]["floor_share"] else ""
            for n in names
        ]
        counts = [f"{work[k] / 1e3:,.0f}" for k in ("visible", "pairs")]
        counts += [f"{work['evaluations'] / 1e6:,.1f}", f"{moved / 1e6:,.0f}"]
        floor = f"{first['floor_ms']:.2f}" if first["floor_ms"] else ""
        lines.append([scene, pixels, str(threads), *counts, floor, *shares])
    headings = ["scene", "picture", "threads", "10³ visible", "10³ pairs", "10⁶ evaluations", "MB"]
    return table([*headings, "floor, ms", *names], lines, 2)


def verified_table(rows: list[Row]) -> str:
    lines = []
    for scene, pixels in dict.fromkeys((r["scene"], size(r)) for r in rows):
        here = [r for r in where(rows, scene=scene, size=pixels) if r["verified"]]
        if here:
            how = dict.fromkeys(part for r in here for part in r["verified"].split("; "))
            error, flips = (max(r[k] for r in here) for k in ("max_error", "flips"))
            lines.append([scene, pixels, "; ".join(how), f"{error:.1e}", str(flips)])
    return table(["scene", "picture", "compared with", "largest error", "flips"], lines, 3)


def error_table(error: dict[str, Any]) -> str:
    lines = [
        [p["backend"], f"{p['factor']:g}", f"{p['ms']:.1f}", f"{p['db']:.1f}"]
        for p in error["points"]
    ]
    return table(["backend", "thresholds", "ms", "dB"], lines)


def lines_of(rows: list[Row], key: Any) -> list[Series]:
    """A line for each contestant that has two points, with its slope if there are more."""
    found = []
    for name in present(rows, DRAWN):
        points = sorted((key(r), r["ms"]["total"]) for r in rows if r["backend"] == name)
        if len(points) > 1:
            straight = len(points) > 2
            found.append(Series(name, points, f"{slope(points):.2f}" if straight else ""))
    return found


def against_gaussians(rows: list[Row]) -> str:
    axis = Axis("Gaussians", short)
    at = where(rows, size=SWEEP_SIZE, threads=SWEEP_THREADS)
    panels = []
    for kind in KINDS:
        series = lines_of(
            [r for r in at if r["scene"].startswith(f"{kind} ")], lambda r: r["gaussians"]
        )
        panels.append(Panel(f"{kind}, {SWEEP_SIZE}", axis, MILLISECONDS, series))
    return figure(panels)


def against_pixels(rows: list[Row]) -> str:
    axis = Axis("pixels", short)
    panels = []
    for kind in KINDS:
        at = where(rows, scene=f"{kind} {SWEEP_COUNT:,}", threads=SWEEP_THREADS)
        series = lines_of(at, lambda r: r["width"] * r["height"])
        panels.append(Panel(f"{kind}, {SWEEP_COUNT:,} Gaussians", axis, MILLISECONDS, series))
    return figure(panels)


def against_error(error: dict[str, Any]) -> str:
    series = []
    for name in dict.fromkeys(p["backend"] for p in error["points"]):
        points = [p for p in error["points"] if p["backend"] == name]
        marks = [_factor(p["factor"]) for p in points] if name == "cffi" else None
        series.append(Series(name, [(p["ms"], p["db"]) for p in points], marks=marks))
    decibels = Axis("dB against the ideal picture", lambda v: f"{v:g}", logarithmic=False)
    return figure([Panel(f"{error['scene']}, {error['size']}", MILLISECONDS, decibels, series)])


def _factor(factor: float) -> str:
    """As x 4 or / 16; the contract's own thresholds have none."""
    if factor == 1:
        return "contract"
    return f"x {factor:g}" if factor > 1 else f"/ {1 / factor:g}"


def put(page: str, name: str, text: str) -> str:
    """``page`` with ``text`` between the markers ``name``."""
    pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.S)
    if not pattern.search(page):
        raise ValueError(f"{PAGE.name} has no markers for {name}")
    return pattern.sub(lambda found: f"{found[1]}\n{text}\n\n{found[2]}", page)


def main() -> None:
    results = Path(sys.argv[1]) if sys.argv[1:] else RESULTS
    found = json.loads(results.read_text())
    if found["error"] is None:
        sys.exit(f"{results}: not all that the page shows; expected what frames.py --full writes")
    rows = found["rows"]
    # the other counts are for the charts
    tabled = [r for r in rows if r["gaussians"] not in set(COUNTS) or r["scene"].endswith(".ply")]
    page = PAGE.read_text()
    for name, text in (
        ("machine", machine_table(found)), ("ratios", ratio_table(tabled)),
        ("times", time_table(tabled)), ("stages", stage_table(tabled)),
        ("floors", floor_table(tabled)), ("verified", verified_table(rows)),
        ("errors", error_table(found["error"])),
    ):  # fmt: skip
        page = put(page, name, text)
    PAGE.write_text(page)
    for name, chart in (
        ("gaussians", against_gaussians(rows)), ("pixels", against_pixels(rows)),
        ("errors", against_error(found["error"])),
    ):  # fmt: skip
        (PAGE.parent / f"performance-{name}.svg").write_text(chart)


if __name__ == "__main__":
    main()
