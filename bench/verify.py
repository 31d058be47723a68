"""Whether a contestant's picture is right: only then is its time worth anything.

The contract's picture in float64 takes its time. Where it has to draw at most :data:`PAIRS_MAX`
(splat, tile) pairs, every picture is compared with it at full size. Beyond, that is done on a
smaller picture of the same scene; and at full size the fused frame must have the bits of the four
stages, and all contestants the same picture but for pixels that may flip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from contestants import Contestant

from tsplat.core import reference
from tsplat.core.camera import Camera
from tsplat.core.params import RenderParams
from tsplat.core.types import Frame, Scene
from tsplat.core.workspace import Workspace
from tsplat.testing.compare import FLIPS_MAX, TOLERANCE, Comparison, compare_frames

PAIRS_MAX = 1_500_000
"""About 40 seconds."""

SMALLER = 320, 180
THREADS = 2


@dataclass(frozen=True)
class Verdict:
    """On one contestant and one picture."""

    comparison: Comparison
    how: str  # what was compared
    faults: tuple[str, ...]  # empty if it may be timed


def _frame(contestant: Contestant, scene: Scene, camera: Camera) -> Frame:
    return contestant.run(scene, camera, Workspace(THREADS)).frame


def against_contract(
    scene: Scene, camera: Camera, contestants: list[Contestant]
) -> dict[str, Verdict]:
    """Each one's picture against the contract's in float64."""
    margins = np.empty((camera.height, camera.width))
    want = reference.render(scene, camera, RenderParams(float64=True), margins)
    how = f"float64 at {camera.width}x{camera.height}"
    found = {}
    for contestant in contestants:
        compared = compare_frames(_frame(contestant, scene, camera), want, margins)
        found[contestant.name] = Verdict(compared, how, compared.faults)
    return found


def against_each_other(
    scene: Scene, camera: Camera, contestants: list[Contestant], known: dict[str, Verdict]
) -> dict[str, Verdict]:
    """``known`` from a smaller picture, and what is to be seen at full size without a reference.

    The others are compared with the first whose smaller picture is right.
    """
    first = None
    found = {}
    for contestant in contestants:
        verdict = known[contestant.name]
        frame = _frame(contestant, scene, camera)
        how, faults = [verdict.how], list(verdict.faults)
        if contestant.plan.fused is not None:
            how.append("bits of the stages at full size")
            staged = _frame(contestant.staged(), scene, camera)
            if not all(np.array_equal(getattr(frame, n), getattr(staged, n)) for n in _LAYERS):
                faults.append("the fused frame differs from the four stages")
        if first is not None:
            how.append(f"{first[0]} at full size")
            share = _share_apart(frame, first[1])
            if not share <= FLIPS_MAX:
                faults.append(f"{share:.2%} of the pixels differ from {first[0]}'s")
        elif not faults:
            first = contestant.name, frame
        found[contestant.name] = Verdict(verdict.comparison, "; ".join(how), tuple(faults))
    return found


_LAYERS = ("rgb", "transmittance")


def _share_apart(frame: Frame, other: Frame) -> float:
    """Share of pixels that are further apart than two right ones may be."""
    near = [np.abs(getattr(frame, n) - getattr(other, n)) <= 2 * TOLERANCE for n in _LAYERS]
    return 1 - float((near[0].all(axis=2) & near[1]).mean())
