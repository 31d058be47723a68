"""How right a picture is, against how long it took.

Right means near the true value of the model: float64, no alpha threshold, no early stop. The
thresholds of the contract cost more decibels than float32 does, so backends are also run with
others; a higher one draws less and is off by more.
"""

from __future__ import annotations

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

SCENE, SIZE, THREADS = "surface:50000", (640, 360), 1
FACTORS = (16, 4, 1, 1 / 4, 1 / 16, 1 / 256)
"""Times both of the contract's thresholds."""


def sweep(rod: Yardstick | None, runs: int) -> dict[str, Any]:
    """Points of (backend, factor, milliseconds, decibels)."""
    made, camera_of = scenes.load(SCENE)
    camera = camera_of(*SIZE)
    ideal = reference.render(made, camera, IDEAL)
    points = []
    rod_seconds = []
    for factor in FACTORS:
        scene = replace(made)  # a packed scene is good for one threshold
        params = RenderParams(
            alpha_threshold=ALPHA_THRESHOLD * factor, transmittance_min=TRANSMITTANCE_MIN * factor
        )
        entered = [contestants.enter(name, scene, params) for name in ("cffi", "numba")]
        taken = take_turns(scene, camera, entered, rod, THREADS, runs)
        for one in entered:
            frame = one.run(scene, camera, Workspace(THREADS)).frame
            ms = taken[one.name].least * 1e3
            points.append(
                {"backend": one.name, "factor": factor, "ms": ms, "db": psnr(frame, ideal)}
            )
        if rod is not None:
            rod_seconds.append(taken[YARDSTICK].least)
    if rod is not None:
        frame, _ = rod.frame(made, camera, THREADS)
        ms = min(rod_seconds) * 1e3
        points.append({"backend": YARDSTICK, "factor": 1, "ms": ms, "db": psnr(frame, ideal)})
    return {
        "scene": made.name,
        "size": f"{SIZE[0]}x{SIZE[1]}",
        "threads": THREADS,
        "points": points,
    }
