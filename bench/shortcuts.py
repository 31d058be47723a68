"""Writes docs/error-vs-time.md's tables and draws its diagrams: what each shortcut costs and saves.

    python bench/shortcuts.py                        # the built-in demo scene
    python bench/shortcuts.py garden.ply plant.ply   # and others

Text between ``<!-- NAME -->`` and ``<!-- /NAME -->`` is replaced; the rest of the page is left. The
measuring is that of ``tsplat bench`` (tsplat/quality/sweep.py).
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

import tsplat
from tsplat.core.types import Scene
from tsplat.core.workspace import default_threads
from tsplat.quality.diagram import draw
from tsplat.quality.measure import levels_text
from tsplat.quality.sweep import Row, make_sweep, mark_optimal, settings
from tsplat.views import ring

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE = DOCS / "error-vs-time.md"
BACKENDS = ("cffi", "numba")
COLUMNS = ("setting", "ms", "speed", "99.9 % within", "worst", "PSNR dB", "SSIM")


def measure(scene: Scene, size: tuple[int, int], cameras: int, runs: int) -> list[Row]:
    """All rows, measured and marked."""
    eyes = ring(scene, cameras, *size)
    sweep = make_sweep(scene, eyes, BACKENDS, settings(scene), default_threads(), runs)
    for done, _ in enumerate(sweep.steps(), 1):
        print(f"\r{scene.name}: {done} of {len(sweep)}", end="", flush=True)
    print()
    rows = list(sweep.rows)
    mark_optimal(rows)
    return rows


def table(rows: list[Row], backend: str) -> str:
    """One backend's rows, fastest first; those that nothing beats are bold."""
    own = sorted((r for r in rows if r.backend == backend), key=lambda r: r.seconds())
    base = next(r for r in own if r.setting == "contract").seconds()[0]
    lines = [f"| {' | '.join(COLUMNS)} |", "|---|" + "--:|" * (len(COLUMNS) - 1)]
    for row in own:
        error, least = row.error, row.seconds()[0]
        name = f"**{row.setting}**" if row.optimal else row.setting
        lines.append(
            f"| {name} | {least * 1e3:.1f} | {base / least:.2f} | {levels_text(error.p999)} "
            f"| {levels_text(error.worst)} | {error.psnr:.1f} | {error.ssim:.4f} |"
        )
    return "\n".join(lines)


def put(name: str, text: str) -> None:
    """Replaces a part of the page."""
    page = PAGE.read_text()
    marks = re.compile(rf"(<!-- {name} -->\n).*?(\n<!-- /{name} -->)", re.DOTALL)
    if not marks.search(page):
        raise SystemExit(f"{PAGE.name} has no part {name}")
    PAGE.write_text(marks.sub(lambda m: f"{m[1]}\n{text}\n{m[2]}", page))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scenes", nargs="*", help="files, beside the demo scene")
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--cameras", type=int, default=3)
    parser.add_argument("--runs", type=int, default=5)
    arguments = parser.parse_args()
    width, height = (int(n) for n in arguments.size.split("x"))
    scenes = {"demo": tsplat.demo_scene()}
    for path in arguments.scenes:
        scenes[Path(path).name.split("-")[0]] = tsplat.load_scene(path, sh_float32=True)
    for name, scene in scenes.items():
        rows = measure(scene, (width, height), arguments.cameras, arguments.runs)
        title = f"{scene.name}, {len(scene):,} Gaussians, {width}x{height}"
        (DOCS / f"error-vs-time-{name}.svg").write_bytes(draw(rows, title, ".svg"))
        head = f"{title}, {arguments.cameras} cameras, {default_threads()} threads, C kernel."
        put(name, f"{head}\n\n{table(rows, 'cffi')}")
        facts = [[r.backend, r.setting, *r.seconds(), *vars(r.error).values()] for r in rows]
        print(json.dumps(facts))


if __name__ == "__main__":
    main()
