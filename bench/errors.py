"""How right a picture is, against how long it took.

Right means near the true value of the model: float64, no alpha threshold, no early stop. The
thresholds of the contract cost more decibels than float32 does, so backends are also run with
others; a higher one draws less and is off by more.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import replace
from typing import Any

import contestants
import scenes
from clock import YARDSTICK, take_turns
from yardstick import Yardstick

from tsplat.core import reference
from tsplat.core.constants import ALPHA_THRESHOLD, TRANSMITTANCE_MIN
from tsplat.core.params import IDEAL, RenderParams
from tsplat.core.workspace import Workspace
from tsplat.testing.compare import psnr

BACKENDS = ("cffi", "numba")
SCENE, SIZE, THREADS = "surface:50000", (640, 360), 1
FACTORS = (16, 4, 1, 1 / 4, 1 / 16, 1 / 256)
"""Times both of the contract's thresholds."""


def sweep(rod: Yardstick | None, runs: int) -> dict[str, Any]:
    """Points of (backend, factor, milliseconds, decibels)."""
    made, camera_of = scenes.load(SCENE)
    camera = camera_of(*SIZE)
    ideal = reference.render(made, camera, IDEAL)
    fields = {}
    for factor in FACTORS:
        scene = replace(made)  # packed anew, for its own threshold
        params = RenderParams(
            alpha_threshold=ALPHA_THRESHOLD * factor, transmittance_min=TRANSMITTANCE_MIN * factor
        )
        fields[factor] = scene, [contestants.enter(name, scene, params) for name in BACKENDS]
    least: dict[tuple[str, float], float] = defaultdict(lambda: math.inf)
    for _ in range(runs):
        for factor, (scene, entered) in fields.items():
            for name, times in take_turns(scene, camera, entered, rod, THREADS, 1).items():
                key = name, factor if name != YARDSTICK else 1
                least[key] = min(least[key], times.least)
    frames = {
        (one.name, factor): one.run(scene, camera, Workspace(THREADS)).frame
        for factor, (scene, entered) in fields.items()
        for one in entered
    }
    if rod is not None:
        frames[YARDSTICK, 1] = rod.frame(made, camera, THREADS)[0]
    points = [
        {"backend": name, "factor": factor, "ms": least[name, factor] * 1e3,
         "db": psnr(frame, ideal)}
        for (name, factor), frame in sorted(frames.items(), key=lambda item: item[0])
    ]  # fmt: skip
    return {
        "scene": made.name,
        "size": f"{SIZE[0]}x{SIZE[1]}",
        "threads": THREADS,
        "points": points,
    }
