"""What is timed: scenes, sizes of pictures, threads."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SIZES = ("120x80", "640x360", "1280x720", "1920x1080")
LARGE = ("1280x720", "1920x1080")
COUNTS = (10_000, 30_000, 100_000, 300_000)  # and 200,000 and 1,000,000, at all sizes
REAL = (
    "formats/leica-8k-sh3/leica-8k-sh3.gf.ply",
    "formats/plant-114k-sh0/plant-114k-sh0.st.ply",
    "large/playbot-125k-sh2.ply",
)
"""Files under ``$TSPLAT_DATA`` or ``../shared/data``; one that is not there is left out."""


@dataclass(frozen=True)
class Case:
    """A scene, and the pictures taken of it."""

    scene: str  # for scenes.load
    sizes: tuple[str, ...]
    threads: tuple[int, ...] = (1, 2)
    also: tuple[str, ...] = ()  # contestants beside the usual ones


def _real() -> Iterator[Case]:
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("TSPLAT_DATA") or default)
    for name in REAL:
        if (folder / name).is_file():
            yield Case(str(folder / name), ("1280x720",))


def quick() -> list[Case]:
    """A few minutes: what a change to a kernel should be looked at with."""
    return [Case("random:200000", ("120x80", "1280x720")), Case("surface:200000", ("1280x720",))]


def full() -> list[Case]:
    """All that docs/performance.md shows."""
    staged = ("cffi/staged",)
    cases = [Case(f"{kind}:200000", SIZES, also=staged) for kind in ("random", "surface")]
    cases += [Case(f"{kind}:1000000", SIZES, also=staged) for kind in ("random", "surface")]
    cases += [Case("cloud:2000", LARGE), Case("stack:2000", LARGE)]
    cases += _real()
    for kind in ("random", "surface"):
        for count in COUNTS:
            also = ("numpy",) if count <= COUNTS[1] else ()
            cases.append(Case(f"{kind}:{count}", ("1280x720",), (1,), also))
    return cases
