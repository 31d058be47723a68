"""``tsplat info``: what a file holds, and what rendering it would leave out."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from tsplat.commands.common import load, print_json
from tsplat.core.errors import printable
from tsplat.core.params import RenderParams
from tsplat.core.types import Scene
from tsplat.plan import Plan, make_plan
from tsplat.views import scene_extent, up_of

ANTIALIAS = {
    True: "on, as the file says; view, cat, render: --no-antialias",
    False: "off, as the file says; view, cat, render: --antialias",
    None: "off, the file does not say; view, cat, render: --antialias",
}
PERCENTILES = (0, 5, 50, 95, 100)
ROWS_MOVED, ROWS_KEPT = "along a space-filling curve", "in the file's order"


def run(arguments: argparse.Namespace) -> int:
    """Loads and describes."""
    scene = load(arguments)
    facts = describe(scene, make_plan(scene, params=RenderParams(antialias=bool(scene.antialias))))
    if arguments.json:
        print_json(facts)
        return 0
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(show_header=False, box=None)
    for key, text in _lines(facts):
        table.add_row(f"[bold]{key}[/bold]", escape(text))
    Console(soft_wrap=True).print(table)
    return 0


def describe(scene: Scene, plan: Plan) -> dict[str, Any]:
    """The scene and its plan as plain data."""
    extent = scene_extent(scene)
    spread = np.percentile(scene.opacities, PERCENTILES) if len(scene) else np.zeros(5)
    sizes = np.percentile(scene.scales.max(1), PERCENTILES) if len(scene) else np.zeros(5)
    low, high = (
        (scene.means.min(0) + scene.origin, scene.means.max(0) + scene.origin)
        if len(scene)
        else (scene.origin, scene.origin)
    )
    up = up_of(scene)
    arrays = (scene.means, scene.quats, scene.scales, scene.opacities, scene.sh, scene.numbers)
    return {
        "name": printable(scene.name),
        "format": printable(scene.source),
        "antialias": scene.antialias,
        "up": {"direction": list(up.direction), "why": up.why},
        "gaussians": len(scene),
        "dropped": dict(scene.dropped),
        "sh_degree": scene.sh_degree,
        "sh_dtype": scene.sh.dtype.name,
        "sh_error_levels": 255 * scene.sh_error,
        "origin": scene.origin.tolist(),
        "bounds": [low.tolist(), high.tolist()],
        "content": {"centre": extent.centre.tolist(), "radius": extent.radius},
        "percentiles": list(PERCENTILES),
        "opacity": spread.tolist(),
        "largest_scale": sizes.tolist(),
        "bytes": sum(a.nbytes for a in arrays if a is not None),
        "rows": ROWS_MOVED if scene.numbers is not None else ROWS_KEPT,
        "backend": dict(plan.backends),
        "backend_reason": {stage: choice.reason for stage, choice in plan.choices.items()},
        "passed_over": list(plan.passed_over),
        "threads": plan.threads,
        "left_out": [vars(item) for item in plan.left_out],
    }


def _axis(direction: list[float]) -> str:
    """``-y``, or the numbers."""
    largest = max(direction, key=abs)
    if abs(largest) == sum(map(abs, direction)):
        return ("-" if largest < 0 else "") + "xyz"[direction.index(largest)]
    return " ".join(f"{value:.3g}" for value in direction)


def _precision(facts: dict[str, Any]) -> str:
    if facts["sh_dtype"] == "float32":
        return "float32"
    return (
        f"{facts['sh_dtype']}: largest colour error {facts['sh_error_levels']:.2g} of an 8-bit "
        "level or less; --sh-float32 keeps all"
    )


def _lines(facts: dict[str, Any]) -> list[tuple[str, str]]:
    def numbers(values: list[float]) -> str:
        return "  ".join(f"{v:.4g}" for v in values)

    lines = [
        ("scene", facts["name"]),
        *([("format", facts["format"])] if facts["format"] else []),
        ("Gaussians", f"{facts['gaussians']:,}"),
        *(("left out", f"{n:,}: {reason}") for reason, n in facts["dropped"].items()),
        ("up", f"{_axis(facts['up']['direction'])}: {facts['up']['why']}"),
        ("", "view, cat, render: --up AXIS or --flip-y says otherwise"),
        ("antialias", ANTIALIAS[facts["antialias"]]),
        ("SH degree", str(facts["sh_degree"])),
        ("SH in", _precision(facts)),
        ("rows", facts["rows"]),
        ("memory", f"{facts['bytes'] / 1e6:.1f} MB"),
        ("bounds", f"{numbers(facts['bounds'][0])}  to  {numbers(facts['bounds'][1])}"),
        (
            "content",
            f"centre {numbers(facts['content']['centre'])}, "
            f"radius {facts['content']['radius']:.4g} (strays left out)",
        ),
        ("", "percentiles " + "  ".join(map(str, facts["percentiles"]))),
        ("opacity", numbers(facts["opacity"])),
        ("size", numbers(facts["largest_scale"])),
    ]
    if any(facts["origin"]):
        lines.append(("origin", numbers(facts["origin"])))
    for name in dict.fromkeys(facts["backend"].values()):
        stages = [s for s, b in facts["backend"].items() if b == name]
        reason = facts["backend_reason"][stages[0]]
        lines.append(("backend", f"{name} for {', '.join(stages)} ({reason})"))
    lines += [("passed over", text) for text in facts["passed_over"]]
    lines += [
        ("not needed", f"{item['what']}: {item['why']}; {item['effect']}")
        for item in facts["left_out"]
    ]
    return lines
