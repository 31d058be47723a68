"""Verifies every backend against the reference, then times frames stage by stage.

    python bench/frames.py --quick                           # a few minutes
    python bench/frames.py --full --json bench/results.json  # all that docs/performance.md shows
    python bench/frames.py --scenes surface:1000000 scene.ply --sizes 1280x720 --stages

Backends and the yardstick take turns in one process, so that a slow spell hits all alike. Quoted
are the minimum and the median of the runs, the ratio of the yardstick's minimum to ours, and the
share that the least possible time (work.py) has in ours. A backend that breaks the contract
is not timed.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import clock
import contestants
import errors
import machine
import presets
import scenes
import verify
import work
import yardstick
from contestants import Contestant
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from tsplat.core.camera import Camera
from tsplat.core.types import Scene

Row = dict[str, Any]
STAGES = ("project", "sort", "bin", "composite", "total")


class Bench:
    """What all cases share: settings, the yardstick, the machine's limits, where to report."""

    def __init__(self, runs: int, patient: bool, threads: list[int], progress: Progress) -> None:
        self.runs, self.patient = runs, patient
        self.rod = yardstick.find()
        self.threads = threads
        self.limits: dict[int, machine.Limits] = {}
        self._progress = progress
        self._task = progress.add_task("", total=None)

    def say(self, text: str) -> None:
        """A line that stays."""
        self._progress.console.print(text, markup=False, highlight=False)

    def steps(self, total: int) -> None:
        """How many there will be."""
        self._progress.update(self._task, total=total)

    def step(self, text: str) -> None:
        """What is done now; a line of its own where no bar can be drawn."""
        self._progress.update(self._task, description=text, advance=1)
        if not self._progress.console.is_terminal:
            self.say(text)

    def look_at_machine(self) -> None:
        """Measures its limits once more: the best that was ever seen counts."""
        for threads, seen in machine.limits(self.threads).items():
            known = self.limits.get(threads)
            self.limits[threads] = seen if known is None else known.best(seen)

    def verify(
        self, scene: Scene, camera_of: Callable[[int, int], Camera], size: tuple[int, int],
        entered: list[Contestant], pairs: int, smaller: dict[str, verify.Verdict],
    ) -> dict[str, verify.Verdict]:  # fmt: skip
        """A verdict on each; ``smaller`` keeps those on a smaller picture for the next size."""
        if pairs <= verify.PAIRS_MAX:
            return verify.against_contract(scene, camera_of(*size), entered)
        if not smaller:
            smaller |= verify.against_contract(scene, camera_of(*verify.SMALLER), entered)
        return verify.against_each_other(scene, camera_of(*size), entered, smaller)

    def rows_of(
        self, scene: Scene, camera_of: Callable[[int, int], Camera], sizes: list[tuple[int, int]],
        threads: tuple[int, ...], entered: list[Contestant],
    ) -> Iterator[Row]:  # fmt: skip
        """All rows for one scene."""
        smaller: dict[str, verify.Verdict] = {}
        for size in sizes:
            title = f"{scene.name} {size[0]}x{size[1]}"
            self.step(f"{title}: verifying")
            camera = camera_of(*size)
            needed = work.measure(scene, camera)
            verdicts = self.verify(scene, camera_of, size, entered, needed.pairs, smaller)
            for name, verdict in verdicts.items():
                for fault in verdict.faults:
                    self.say(f"{title}: {name} breaks the contract and is not timed: {fault}")
            good = [one for one in entered if not verdicts[one.name].faults]
            self.look_at_machine()
            for count in threads:
                self.step(f"{title}: timing on {count} thread{'s'[: count > 1]}")
                taken = clock.take_turns(
                    scene, camera, good, self.rod, count, self.runs, self.patient
                )
                rod = taken.get(clock.YARDSTICK)
                facts = {
                    "scene": scene.name, "gaussians": len(scene), "width": size[0],
                    "height": size[1], "threads": count, "work": asdict(needed),
                }  # fmt: skip
                sets = {one.name: one.isa for one in good}
                for name, times in taken.items():
                    verdict = verdicts.get(name)
                    compared = verdict and verdict.comparison
                    yield facts | {
                        "backend": name, "isa": sets.get(name), **times.summary(),
                        "ratio": None if rod is None else rod.least / times.least,
                        "verified": verdict and verdict.how,
                        "max_error": compared and compared.max_error,
                        "flips": compared and compared.flips,
                    }  # fmt: skip

    def add_floors(self, rows: list[Row]) -> None:
        """Floors come last, when the machine has been seen at its best."""
        for row in rows:
            limits = self.limits.get(row["threads"])
            row["floor_ms"] = row["floor_share"] = None
            if limits is not None:
                isa = row["isa"] or contestants.instruction_sets()[0]
                row["floor_ms"] = work.floor(work.Work(**row["work"]), limits, isa) * 1e3
                row["floor_share"] = row["floor_ms"] / row["ms"]["total"]


def show(rows: list[Row]) -> None:
    """The rows as a table."""
    table = Table(title="milliseconds, least of the runs", title_justify="left")
    for heading in ("scene", "size", "threads", "backend"):
        table.add_column(heading)
    for heading in (*STAGES, "median", "ratio", "of floor", "max error", "flips"):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(
            row["scene"], f"{row['width']}x{row['height']}", str(row["threads"]), row["backend"],
            *(f"{row['ms'][s]:.1f}" if s in row["ms"] else "" for s in STAGES),
            f"{row['ms_median']['total']:.1f}",
            _text(row["ratio"], ".1f"), _text(row["floor_share"], ".0%"),
            _text(row["max_error"], ".1e"), _text(row["flips"], "d"),
        )  # fmt: skip
    Console(width=160).print(table)
    counted = Table(title="what a frame takes at least", title_justify="left")
    for heading in ("scene", "size", "visible", "pairs", "evaluations", "MB", "verified"):
        counted.add_column(heading)
    seen = set()
    for row in rows:
        size = f"{row['width']}x{row['height']}"
        if row["verified"] is None or (row["scene"], size, row["verified"]) in seen:
            continue
        seen.add((row["scene"], size, row["verified"]))
        needed = work.Work(**row["work"])
        counted.add_row(
            row["scene"], size, f"{needed.visible:,}", f"{needed.pairs:,}",
            f"{needed.evaluations:,}", f"{needed.nbytes / 1e6:.0f}", row["verified"],
        )  # fmt: skip
    Console(width=160).print(counted)


def _text(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    return int(width), int(height)


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    add = parser.add_argument
    preset = parser.add_mutually_exclusive_group()
    preset.add_argument("--quick", action="store_true", help="three pictures of 200,000 Gaussians")
    preset.add_argument("--full", action="store_true", help="all that docs/performance.md shows")
    add(
        "--scenes",
        nargs="+",
        metavar="SCENE",
        help="random:N, surface:N, cloud:N, stack:N or a file",
    )
    add("--sizes", nargs="+", default=["640x360", "1280x720"], metavar="WxH", help="with --scenes")
    add("--threads", nargs="+", type=int, metavar="N", help="instead of 1 and 2")
    add("--backends", nargs="+", metavar="NAME", help="as numba, cffi/avx2 or cffi/staged")
    add("--stages", action="store_true", help="one stage after the other, no fused frames")
    add("--runs", type=int, default=7, metavar="N", help="turns each takes (default: 7)")
    add("--patient", action="store_true", help="more runs, until the least times stay as they are")
    add("--json", metavar="FILE", type=Path, help="where all figures go")
    return parser.parse_args(argv)


def _cases(arguments: argparse.Namespace) -> list[presets.Case]:
    if arguments.scenes:
        return [presets.Case(scene, tuple(arguments.sizes)) for scene in arguments.scenes]
    return presets.full() if arguments.full else presets.quick()


def main(argv: list[str] | None = None) -> None:
    arguments = _arguments(argv)
    cases = _cases(arguments)
    begin = time.monotonic()
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    rows: list[Row] = []
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        bench = Bench(arguments.runs, arguments.patient, arguments.threads or [1, 2], progress)
        if bench.rod is None:
            bench.say("no yardstick here: ratios are left out")
        plan = [(case, tuple(arguments.threads or case.threads)) for case in cases]
        bench.steps(
            sum(len(case.sizes) * (1 + len(threads)) for case, threads in plan) + arguments.full
        )
        for case, threads in plan:
            scene, camera_of = scenes.load(case.scene)
            names = [*(arguments.backends or contestants.default()), *case.also]
            entered = [contestants.enter(name, scene) for name in names]
            if arguments.stages:
                entered = [one.staged() for one in entered]
            sizes = [_size(size) for size in case.sizes]
            rows += bench.rows_of(scene, camera_of, sizes, threads, entered)
        bench.add_floors(rows)
        if not bench.limits:
            bench.say("no C compiler here: the machine's floor is left out")
        error = None
        if arguments.full:
            bench.step("error against time")
            error = errors.sweep(bench.rod, arguments.runs)
    show(rows)
    if arguments.json:
        found = {
            "processor": machine.processor(),
            "limits": {threads: asdict(limits) for threads, limits in bench.limits.items()},
            "runs": arguments.runs,
            "minutes": (time.monotonic() - begin) / 60,
            "rows": rows,
            "error": error,
        }
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
