"""``tsplat render``: one picture into a file, and what it took. Films are ``film.py``'s."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from tsplat.commands.common import (
    calibrated,
    dropped_text,
    load,
    params,
    pose,
    print_json,
    say,
)
from tsplat.core.errors import ParamsError
from tsplat.core.params import IDEAL, RenderParams, settings_text
from tsplat.core.stages import STAGES
from tsplat.core.types import Scene
from tsplat.core.workspace import Workspace
from tsplat.io.images import check_output, needs_depth, write_output
from tsplat.plan import Plan, Rendered, make_plan

if TYPE_CHECKING:
    from tsplat.quality.calibrate import Calibration

FILM_ONLY = ("frames", "fps", "force", "presenter")


def wanted(arguments: argparse.Namespace, scene: Scene) -> RenderParams:
    """The settings that the command line asks for, without what ``--max-error`` may choose."""
    made = replace(params(arguments, scene), depth=needs_depth(arguments.output))
    chosen = arguments.quality or arguments.set or arguments.max_error
    if chosen and (arguments.ideal or arguments.float64):
        raise ParamsError("--ideal and --float64 leave no choice of quality")
    if arguments.ideal:
        return replace(
            made,
            float64=True,
            alpha_threshold=IDEAL.alpha_threshold,
            transmittance_min=IDEAL.transmittance_min,
        )
    return replace(made, float64=arguments.float64)


def run(arguments: argparse.Namespace) -> int:
    """Loads, renders, writes, reports."""
    if arguments.path is not None:
        from tsplat.commands import film

        return film.run(arguments)
    if alone := [name for name in FILM_ONLY if getattr(arguments, name)]:
        raise ParamsError(f"--{alone[0]} is for films: say with --path where the camera goes")
    if arguments.json and arguments.output == "-":
        raise ParamsError("--json and -o - both write to stdout; choose one")
    check_output(arguments.output, arguments.background)
    begin = time.perf_counter()
    scene = load(arguments, exact=arguments.ideal or arguments.float64)
    loaded = time.perf_counter() - begin
    camera = pose(arguments, scene)
    settings, calibration = calibrated(arguments, scene, camera, wanted(arguments, scene))
    plan = make_plan(
        scene, backend=arguments.backend, threads=arguments.threads, params=settings,
        everything=arguments.everything,
    )  # fmt: skip
    workspace = Workspace(plan.threads)
    runs = []
    for _ in range(arguments.repeat):
        workspace.forget()
        runs.append(plan.run(scene, camera, workspace))
    del workspace  # all but the frame: its memory is needed for writing
    write_output(arguments.output, runs[-1].frame, camera, arguments.background)
    seconds = {"load": loaded, **_over(runs, min)}
    if arguments.json:
        print_json(_facts(scene, plan, runs, seconds, calibration))
    else:
        _tell(arguments.output, scene, plan, runs[-1], seconds)
    return 0


def _over(runs: Sequence[Rendered], summarise: Any) -> dict[str, float]:
    return {stage: summarise([r.seconds[stage] for r in runs]) for stage in runs[0].seconds}


def _facts(
    scene: Scene, plan: Plan, runs: Sequence[Rendered], seconds: Mapping[str, float],
    calibration: Calibration | None,
) -> dict[str, Any]:  # fmt: skip
    import statistics

    last = runs[-1]
    return {
        "backend": dict(plan.backends),
        "fused": [s for s in STAGES if s not in last.seconds],
        "threads": plan.threads,
        "width": last.frame.width,
        "height": last.frame.height,
        "gaussians": len(scene),
        "dropped": {**scene.dropped, **_overflow(last)},
        "visible": last.visible,
        "intersections": last.intersections,
        "seconds": dict(seconds),
        "seconds_median": _over(runs, statistics.median),
        "settings": settings_text(plan.asked),
        "calibration": calibration
        and {
            "cameras": calibration.cameras,
            "pictures": len(calibration.tried),
            **vars(calibration.picked.error),
        },
        "left_out": [vars(item) for item in (*plan.left_out, *last.left_out)],
    }


def _overflow(rendered: Rendered) -> dict[str, int]:
    return {"projection overflow": rendered.overflowed} if rendered.overflowed else {}


def _tell(
    output: str, scene: Scene, plan: Plan, last: Rendered, seconds: Mapping[str, float]
) -> None:
    stages = ", ".join(f"{s} {seconds[s] * 1e3:.1f}" for s in STAGES if s in seconds)
    names = " + ".join(dict.fromkeys(plan.backends.values()))
    left = dropped_text(scene)
    threads = f"{plan.threads} thread{'s' if plan.threads > 1 else ''}"
    say(
        f"{output}: {last.frame.width}x{last.frame.height}, {last.visible:,} of {len(scene):,} "
        f"Gaussians in view, {seconds['total'] * 1e3:.1f} ms ({stages}) by {names}, {threads}"
        + (f"; {left}" if left else "")
    )
    if last.overflowed:
        say(f"{last.overflowed:,} Gaussians too large or too near for float32 were left out")
