"""Writes docs/stability.md: how far each backend is off in the stiff cases, and naive formulas.

python bench/stability.py
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from naive import CONIC, FLOAT32

from tsplat.backends.cffi import isa
from tsplat.core import reference
from tsplat.core.stages import Stages
from tsplat.core.types import Frame
from tsplat.core.workspace import Workspace
from tsplat.plugins import load_backend, plugins
from tsplat.testing.checks import Case, run_stages
from tsplat.testing.oracle import Oracle
from tsplat.testing.stiff import CASES, REFUSALS, Stiff, prepared

PAGE = Path(__file__).resolve().parents[1] / "docs" / "stability.md"
SETS = ("generic", "avx2", "avx512")
BACKENDS = ("numpy", "numba", *(f"cffi/{name}" for name in SETS))
NAIVE = {"`ac-b²`": CONIC, "`Rm+t`": FLOAT32}
EXACT = "float64"
COLUMNS = (EXACT, *BACKENDS, *NAIVE)


@dataclass(frozen=True)
class Cell:
    """How far a picture is off."""

    error: float  # largest difference of a channel, of pixels that are near no threshold
    crossings: int  # pixels near one that are farther off than the bound

    def __str__(self) -> str:
        if not np.isfinite(self.error):
            return "NaN"
        digit, _, power = f"{self.error:.0e}".partition("e")
        error = f"{digit}e{int(power)}" if int(power) else digit
        return f"{error} ({self.crossings})" if self.crossings else error


def cell(frame: Frame, oracle: Oracle, case: Stiff) -> Cell:
    """``frame`` against the oracle's; depth in units of the farthest, as in compare_frames."""
    want = oracle.frame
    layers = [abs(frame.rgb - want.rgb).max(axis=2), abs(frame.transmittance - want.transmittance)]
    if want.depth is not None and frame.depth is not None:
        layers.append(abs(frame.depth - want.depth) / max(want.depth.max(), 1e-30))
    error = np.max(layers, axis=0)  # NaN wins
    close = oracle.margins < case.crossing
    return Cell(float(error[~close].max(initial=0)), int((error[close] > case.bound).sum()))


def contestants() -> Iterator[tuple[str, Stages]]:
    """What float32 makes of the cases, one after the other; the C kernel is switched on the way."""
    for name in BACKENDS:
        backend, _, chosen = name.partition("/")
        stages = load_backend(plugins().backends[backend])
        if not chosen or chosen in isa.offered():
            if chosen:
                isa.use_isa(chosen)
            yield name, stages
    isa.use_environment()
    yield from NAIVE.items()


def measured() -> dict[str, dict[str, Cell]]:
    """Case -> column -> cell."""
    cells: dict[str, dict[str, Cell]] = {case.name: {} for case in CASES}
    for case in CASES:
        scene, camera, params, oracle = prepared(case)
        frame = reference.render(scene, camera, replace(params, float64=True))
        cells[case.name][EXACT] = cell(frame, oracle, case)
    for name, stages in contestants():
        for case in CASES:
            scene, camera, params, oracle = prepared(case)
            with np.errstate(all="ignore"):
                frame = run_stages(stages, Case(scene, camera, params), Workspace(2))
                cells[case.name][name] = cell(frame, oracle, case)
    return cells


def table(headings: tuple[str, ...], lines: list[list[str]], left: int) -> str:
    """Markdown; all but the first ``left`` columns are numbers."""
    ruler = ["---"] * left + ["--:"] * (len(headings) - left)
    return "\n".join("| " + " | ".join(row) + " |" for row in (headings, ruler, *lines))


def bound(case: Stiff) -> str:
    """As it is written."""
    return str(Cell(case.bound, 0))


def page(cells: dict[str, dict[str, Cell]]) -> str:
    """The whole page."""
    figures = [
        [case.name, bound(case), *(str(cells[case.name].get(name, "")) for name in COLUMNS)]
        for case in CASES
    ]
    reasons = [[case.name, case.why] for case in CASES]
    bounds = [[case.name, bound(case), case.bound_why] for case in CASES if case.bound_why]
    refused = [[refusal.name, f"… {refusal.words} …"] for refusal in REFUSALS]
    return TEXT.format(
        figures=table(("case", "bound", *COLUMNS), figures, 1),
        reasons=table(("case", "why it is hard"), reasons, 2),
        bounds=table(("case", "bound", "because"), bounds, 3),
        refused=table(("camera", "refused with"), refused, 2),
    )


TEXT = """\
# Stability

Scenes that are hard for a renderer, and how far each backend is off in them. They are in
`tsplat/testing/stiff.py`; `stiff_checks(backend)` runs them on any backend, and tsplat's tests run
them on its own. `python bench/stability.py` wrote this page.

What must hold in every case: nothing in the picture is NaN or infinite, transmittance stays within
0..1, no warning is given, even with NumPy told to raise them all, and no channel is farther off
than the bound. What is right is worked out by `tsplat/testing/oracle.py`, by textbook formulas in
numbers of 106 bits; with the reference it shares nothing but camera z, which the
[contract](contract.md) defines to the bit.

## Figures

Largest error of a channel, of pixels that sit on no threshold; in brackets how many of those that
do sit on one fell to the other side. `float64` is the reference in float64: what is left is
rounding, so that contract and oracle agree. The last two columns are what many renderers do, in
float32: `ac-b²` is the reference but for the inverse covariance, by the textbook's determinant;
`Rm+t` is the reference but for means in world coordinates, moved by `viewmat`. They are here for
comparison and have no bound.

{figures}

What the table shows:

- Where nothing cancels, float32 costs 1e-7 to 1e-6, whatever the size of things: 1e-40 units, 1e31
  units and a focal length of 1e-100 px are no harder than a scene of the usual size.
- `ac-b²` is off by more than the bound from needles of 100 px on, and where a picture far off the
  axis stretches splats. At 10,000 px its determinant is not positive for half of the needles, at
  100,000 px for two thirds: they are not drawn. The Cholesky factor takes as much memory and, made
  from sums of positive terms, loses nothing.
- `Rm+t` is fine as long as scene and camera are near the origin. A scene in a national grid is
  gone, one that is seen through a long lens is torn, and what stands on the near plane is drawn.
- float32 does lose precision far from a needle's middle. Its tilt is rounded by some 1e-7, which at
  20,000 px is 2e-3 px, of a width of 0.55 px. Backends differ by what else they round: numba places
  splats with the factor in float64; the C kernel rounds the factor once more when it scales it for
  base-2 exponents; NumPy has offsets from the middle and their products in float32.
- Colours whose terms cancel lose what float32 loses: 16 terms of 100 that make a colour below 1 are
  5e-5 off where the sum is float32, as in both fast backends. The reference sums in float64.
- 100,000 layers cost NumPy's running product 3e-6, because `1 - alpha` is rounded before it is
  multiplied, each time alike; the kernels round `T - T alpha` once.

## Why they are hard

{reasons}

Where a bound is not 1e-4:

{bounds}

## Cameras that are refused

With a `CameraError` that has these words, and no warning before it.

{refused}
"""


if __name__ == "__main__":
    PAGE.write_text(page(measured()))
