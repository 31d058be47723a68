"""Verifies every backend against the reference, then times frames stage by stage.

    python bench/frames.py                                   # a table on 200,000 made-up Gaussians
    python bench/frames.py --scenes surface:1000000 scene.ply --sizes 1280x720 --json out.json

Backends and the yardstick take turns in one process, so that a slow spell hits all alike. Quoted
are the minimum and the median of the runs, and the ratio of the yardstick's minimum to ours. A
backend that breaks the contract is not timed.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import scenes
import yardstick

import tsplat
from tsplat.core import reference
from tsplat.core.params import RenderParams
from tsplat.core.workspace import Workspace
from tsplat.testing.compare import compare_frames

STAGES = ("project", "sort", "bin", "composite", "total")
YARDSTICK = "yardstick"


def verify(scene, camera, plans):
    """Comparison of each plan's picture with the contract's in float64."""
    margins = np.empty((camera.height, camera.width))
    want = reference.render(scene, camera, RenderParams(float64=True), margins)
    return {
        name: compare_frames(plan.run(scene, camera).frame, want, margins)
        for name, plan in plans.items()
    }


def clock(scene, camera, plans, threads, runs, rod):
    """Name -> stage -> seconds of every run, names taking turns."""
    spaces = {name: Workspace(threads) for name in plans}
    taken = defaultdict(lambda: defaultdict(list))
    for turn in range(runs + 1):
        for name, plan in plans.items():
            made = plan.run(scene, camera, spaces[name])
            for stage, value in made.seconds.items():
                if turn:  # the first run warms up
                    taken[name][stage].append(value)
        if rod is not None:
            for stage, value in rod.seconds(scene, camera, threads).items():
                if turn:
                    taken[YARDSTICK][stage].append(value)
    return taken


def rows_of(spec, sizes, threads, backends, runs, rod, progress):
    """All rows for one scene."""
    scene, camera_of = scenes.load(spec)
    for width, height in sizes:
        camera = camera_of(width, height)
        plans = {name: tsplat.make_plan(scene, backend=name, threads=2) for name in backends}
        progress(f"{scene.name} {width}x{height}: verifying")
        verdicts = verify(scene, camera, plans)
        for name, verdict in verdicts.items():
            if not verdict.passed:
                progress(f"{name} breaks the contract and is not timed: {verdict.faults}")
        good = {name: plan for name, plan in plans.items() if verdicts[name].passed}
        counts = next(iter(plans.values())).run(scene, camera)
        for count in threads:
            progress(f"{scene.name} {width}x{height}: timing on {count} threads")
            taken = clock(scene, camera, good, count, runs, rod)
            base = min(taken[YARDSTICK]["total"]) if rod is not None else None
            for name, stages in taken.items():
                least = {s: min(v) * 1e3 for s, v in stages.items()}
                verdict = verdicts.get(name)
                yield {
                    "scene": scene.name, "size": f"{width}x{height}", "threads": count,
                    "backend": name, "ms": least,
                    "ms_median": {s: statistics.median(v) * 1e3 for s, v in stages.items()},
                    "ratio": base * 1e3 / least["total"] if base else None,
                    "max_error": verdict and verdict.max_error,
                    "flips": verdict and verdict.flips,
                    "gaussians": len(scene), "visible": counts.visible,
                    "intersections": counts.intersections,
                }  # fmt: skip


def show(rows):
    """The rows as a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="milliseconds, least of the runs")
    for heading in ("scene", "size", "threads", "backend", *STAGES, "ratio", "max error", "flips"):
        table.add_column(heading, justify="right" if heading in STAGES else "left")
    for row in rows:
        table.add_row(
            row["scene"], row["size"], str(row["threads"]), row["backend"],
            *(f"{row['ms'][s]:.1f}" if s in row["ms"] else "" for s in STAGES),
            f"{row['ratio']:.1f}" if row["ratio"] else "",
            f"{row['max_error']:.1e}" if row["max_error"] is not None else "",
            str(row["flips"]) if row["flips"] is not None else "",
        )  # fmt: skip
    Console(width=150).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", nargs="+", default=["random:200000", "surface:200000"])
    parser.add_argument("--sizes", nargs="+", default=["640x360", "1280x720"])
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--backends", nargs="+", default=["cffi", "numba", "numpy"])
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--json", metavar="FILE")
    arguments = parser.parse_args()
    sizes = [tuple(map(int, size.split("x"))) for size in arguments.sizes]
    rod = yardstick.find()
    if rod is None:
        print("no yardstick here: ratios are left out", file=sys.stderr)
    rows = []
    for spec in arguments.scenes:
        rows += rows_of(
            spec, sizes, arguments.threads, arguments.backends, arguments.runs, rod,
            lambda text: print(text, file=sys.stderr),
        )  # fmt: skip
    show(rows)
    if arguments.json:
        machine = {"processor": platform.processor() or platform.machine(), "rows": rows}
        Path(arguments.json).write_text(json.dumps(machine, indent=1))


if __name__ == "__main__":
    main()
