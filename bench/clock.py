"""Seconds of frames: contestants take turns, so that a slow spell hits all alike."""

from __future__ import annotations

import statistics
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from contestants import Contestant
from yardstick import Yardstick

from tsplat.core.camera import Camera
from tsplat.core.types import Scene
from tsplat.core.workspace import Workspace

YARDSTICK = "yardstick"
STABLE = 0.99  # patience ends when no least time falls below this share of what it was
PAUSE = 0.005  # seconds; idle OpenMP threads spin a while, which the next one should not feel
PATIENCE = 6  # times the runs asked for


@dataclass
class Times:
    """Seconds per stage and in total, of every run."""

    runs: dict[str, list[float]]

    @property
    def least(self) -> float:
        """Of the totals."""
        return min(self.runs["total"])

    def summary(self) -> dict[str, object]:
        """For the table: milliseconds. Spread is the middle half of the totals over the least."""
        totals = self.runs["total"]
        quarters = statistics.quantiles(totals, n=4) if len(totals) > 1 else totals * 3
        return {
            "runs": len(totals),
            "ms": {stage: min(v) * 1e3 for stage, v in self.runs.items()},
            "ms_median": {stage: statistics.median(v) * 1e3 for stage, v in self.runs.items()},
            "spread": (quarters[2] - quarters[0]) / self.least,
        }


def take_turns(
    scene: Scene, camera: Camera, contestants: list[Contestant], rod: Yardstick | None,
    threads: int, runs: int, patient: bool = False,
) -> Mapping[str, Times]:  # fmt: skip
    """Name -> times of ``runs`` turns after one to warm up; patiently, until they stay the same."""
    spaces = {contestant.name: Workspace(threads) for contestant in contestants}
    taken: dict[str, Times] = defaultdict(lambda: Times(defaultdict(list)))

    def turn() -> Iterator[tuple[str, Mapping[str, float]]]:
        for contestant in contestants:
            time.sleep(PAUSE)
            yield (
                contestant.name,
                contestant.run(scene, camera, spaces[contestant.name]).seconds,
            )
        if rod is not None:
            time.sleep(PAUSE)
            yield YARDSTICK, rod.frame(scene, camera, threads)[1]

    for _ in turn():
        pass
    before: dict[str, float] = {}
    for _ in range(PATIENCE if patient else 1):
        for _ in range(runs):
            for name, seconds in turn():
                for stage, value in seconds.items():
                    taken[name].runs[stage].append(value)
        now = {name: times.least for name, times in taken.items()}
        if before and all(now[name] > STABLE * before[name] for name in now):
            break
        before = now
    return taken
