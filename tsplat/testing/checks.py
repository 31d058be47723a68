"""Each stage of a backend against the reference, on one scene and camera.

Each stage gets the *reference's* inputs, so that one fault fails one check. What must hold:

- project: the same depths to the bit, their numbers, no Gaussian missing that reaches a pixel, and
  the picture that the reference makes of these splats is the contract's;
- sort: the same order;
- bin: every tile lists distinct splats near to far, and the picture does not change;
- composite: the contract's picture of the reference's splats and bins;
- picture: all stages together;
- bits: the whole picture has the same bits on 1 and on 3 threads and when repeated;
- memory: what a stage returned stays as it was through calls with another workspace, and no stage
  changes what it was given.

Not compared: intermediate numbers that only lead to the picture (means, factors, radii, tile
sizes), because they are each backend's own business.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tsplat.core import reference
from tsplat.core.camera import Camera
from tsplat.core.errors import ContractError
from tsplat.core.params import RenderParams
from tsplat.core.stages import STAGES, Bin, Composite, Project, Sort, Stages
from tsplat.core.ties import same_numbers
from tsplat.core.types import F64, I32, Bins, Frame, Scene, Splats
from tsplat.core.workspace import Workspace
from tsplat.testing.compare import Comparison, compare_frames

_SAME = 1e-9
"""Bins may only change the order of float64 sums."""


@dataclass(frozen=True)
class Verdict:
    """The outcome of one check; ``comparison`` where pictures were compared."""

    check: str
    faults: tuple[str, ...]
    comparison: Comparison | None = None

    @property
    def passed(self) -> bool:
        """Whether the contract holds."""
        return not self.faults


def require(verdict: Verdict, what: str) -> None:
    """Nothing if the verdict is good.

    Raises:
        ContractError: it is not; the text lists the faults.
    """
    if not verdict.passed:
        raise ContractError(f"{what}, {verdict.check}: {'; '.join(verdict.faults)}")


@dataclass(frozen=True)
class Check:
    """One check of one backend; call it to run it."""

    name: str
    subject: str  # the backend's or presenter's name
    run: Callable[[], None]

    def __str__(self) -> str:
        return f"{self.subject}-{self.name}"

    def __call__(self) -> None:
        """Runs the check.

        Raises:
            ContractError: the contract is broken.
        """
        self.run()


class Case:
    """A scene, a camera, and everything the reference has to say about them, made when needed."""

    def __init__(
        self, scene: Scene, camera: Camera, params: RenderParams | None = None, threads: int = 2
    ) -> None:
        self.scene, self.camera = scene, camera
        self.params = replace(params or RenderParams(), float64=False)
        self.exact = replace(self.params, float64=True)
        self.threads = threads

    @cached_property
    def splats(self) -> Splats:
        """The reference's splats as a float32 backend gets them."""
        return reference.project(self.scene, self.camera, self.params)

    @cached_property
    def order(self) -> I32:
        """The reference's order of :attr:`splats`."""
        return reference.sort(self.splats)

    @cached_property
    def bins(self) -> Bins:
        """The reference's bins of :attr:`splats`."""
        return reference.bin(self.splats, self.order)

    @cached_property
    def contract(self) -> tuple[Frame, F64]:
        """The contract's picture of the scene in float64, and its margins."""
        splats = reference.project(self.scene, self.camera, self.exact)
        return self.picture(splats, reference.bin(splats, reference.sort(splats)))

    @cached_property
    def composited(self) -> tuple[Frame, F64]:
        """The contract's picture of the float32 splats, in float64, and its margins."""
        return self.picture(self.splats, self.bins)

    def picture(self, splats: Splats, bins: Bins) -> tuple[Frame, F64]:
        """The reference's float64 picture of ``splats`` and ``bins``, and its margins."""
        margins = np.empty((splats.height, splats.width))
        return reference.composite(splats, bins, self.exact, margins=margins), margins


def pipeline(stages: Stages) -> tuple[Project, Sort, Bin, Composite]:
    """The four stages, the reference's where ``stages`` has none."""
    return (
        stages.project or reference.project,
        stages.sort or reference.sort,
        stages.bin or reference.bin,
        stages.composite or reference.composite,
    )


def _judge(check: str, comparison: Comparison, faults: list[str] | None = None) -> Verdict:
    return Verdict(check, (*(faults or ()), *comparison.faults), comparison)


def check_project(stages: Stages, case: Case) -> Verdict:
    """See the module: depths to the bit, nothing missing, the contract's picture."""
    got = pipeline(stages)[0](case.scene, case.camera, case.params, Workspace(case.threads))
    ids, want = got.gaussian_ids, case.splats
    faults = [
        f"Splats.{name}: expected {dtype} {[len(got), *shape]}, got {a.dtype} {list(a.shape)}"
        for name, (dtype, *shape) in _SPLAT_TYPES.items()
        if (a := getattr(got, name)).dtype != dtype or a.shape != (len(got), *shape)
    ]
    if (np.diff(ids) <= 0).any() or not ((ids >= 0) & (ids < len(case.scene))).all():
        faults.append("Splats.gaussian_ids must increase and point into the scene")
    elif not same_numbers(got.numbers, case.scene.numbers_of(ids)):
        faults.append("Splats.numbers: expected scene.numbers_of(gaussian_ids)")
    if faults:
        return Verdict("project", tuple(faults))
    if (got.width, got.height) != (want.width, want.height):
        return Verdict("project", (f"Splats has size {got.width}x{got.height}",))
    _, mine, theirs = np.intersect1d(ids, want.gaussian_ids, return_indices=True)
    off = got.depths[mine] != want.depths[theirs]
    if off.any():
        faults.append(
            f"{int(off.sum())} depths differ in their bits, first of Gaussian {ids[mine][off][0]}"
        )
    _, p = reference.camera_space(case.scene, case.camera, slice(0, len(case.scene)))
    beyond = ~((p[ids, 2] > case.camera.near) & (p[ids, 2] < case.camera.far))
    if beyond.any():
        faults.append(f"{int(beyond.sum())} Gaussians kept that are not between near and far")
    if got.overflowed != want.overflowed:
        faults.append(f"overflowed: expected {want.overflowed}, got {got.overflowed}")
    bins = reference.bin(got, reference.sort(got))
    return _judge("project", compare_frames(case.picture(got, bins)[0], *case.contract), faults)


_SPLAT_TYPES: dict[str, tuple[Any, ...]] = {
    "means2d": ("float64", 2),
    "factors": ("float32", 3),
    "depths": ("float32",),
    "opacities": ("float32",),
    "colors": ("float32", 3),
    "radii": ("float32", 2),
}


def check_sort(stages: Stages, case: Case) -> Verdict:
    """See the module: the same order."""
    order = pipeline(stages)[1](case.splats, Workspace(case.threads))
    if order.dtype != np.int32 or order.shape != case.order.shape:
        return Verdict(
            "sort", (f"expected int32 [{len(case.order)}], got {order.dtype} {list(order.shape)}",)
        )
    wrong = int((order != case.order).sum())
    return Verdict("sort", (f"{wrong} of {len(order)} places differ",) if wrong else ())


def _bin_faults(bins: Bins, case: Case) -> list[str]:
    size, m = bins.tile_size, len(case.splats)
    if size < 1:
        return [f"Bins.tile_size: expected at least 1, got {size}"]
    tiles = -(-case.camera.width // size) * -(-case.camera.height // size)
    offsets, ids = bins.tile_offsets, bins.splat_ids
    if offsets.dtype != np.int64 or offsets.shape != (tiles + 1,):
        return [f"Bins.tile_offsets: expected int64 [{tiles + 1}], got {offsets.dtype} "
                f"{list(offsets.shape)}"]  # fmt: skip
    if offsets[0] != 0 or offsets[-1] != len(ids) or (np.diff(offsets) < 0).any():
        return ["Bins.tile_offsets must rise from 0 to the number of intersections"]
    if ids.dtype != np.int32 or not ((ids >= 0) & (ids < m)).all():
        return ["Bins.splat_ids must be int32 rows of Splats"]
    rank = np.empty(m, np.int64)
    rank[case.order] = np.arange(m)
    rises = np.diff(rank[ids]) > 0
    first = np.zeros(len(ids) + 1, bool)
    first[offsets] = True
    if not (rises | first[1:-1]).all():
        return ["a tile lists a splat twice, or not near to far"]
    return []


def check_bin(stages: Stages, case: Case) -> Verdict:
    """See the module: distinct, near to far, and the picture does not change."""
    bins = pipeline(stages)[2](case.splats, case.order, Workspace(case.threads))
    faults = _bin_faults(bins, case)
    if faults:
        return Verdict("bin", tuple(faults))
    want, _ = case.composited
    got, _ = case.picture(case.splats, bins)
    never = np.full(want.transmittance.shape, np.inf)  # no pixel may flip: the splats are the same
    return _judge("bin", compare_frames(got, want, never, tolerance=_SAME))


def check_composite(stages: Stages, case: Case) -> Verdict:
    """See the module: the contract's picture of the reference's splats and bins."""
    got = pipeline(stages)[3](case.splats, case.bins, case.params, Workspace(case.threads))
    return _judge("composite", compare_frames(got, *case.composited))


def run_stages(stages: Stages, case: Case, workspace: Workspace) -> Frame:
    """The whole picture; by the fused path if there is one."""
    if stages.fused is not None:
        return stages.fused(case.scene, case.camera, case.params, workspace)[0]
    project, sort, bin, composite = pipeline(stages)
    splats = project(case.scene, case.camera, case.params, workspace)
    bins = bin(splats, sort(splats, workspace), workspace)
    return composite(splats, bins, case.params, workspace)


def check_picture(stages: Stages, case: Case) -> Verdict:
    """See the module: all stages together."""
    got = run_stages(stages, case, Workspace(case.threads))
    return _judge("picture", compare_frames(got, *case.contract))


def check_bits(stages: Stages, case: Case) -> Verdict:
    """See the module: the same bits on 1 and 3 threads, and in a workspace used before."""
    used = Workspace(3)
    frames = [run_stages(stages, case, w) for w in (Workspace(1), used)]
    first = [(f.rgb.tobytes(), f.transmittance.tobytes()) for f in frames]
    again = run_stages(stages, case, used)
    faults = []
    if first[0] != first[1]:
        faults.append("3 threads give other bits than 1")
    if stages.fused is not None:
        apart = run_stages(replace(stages, fused=None), case, Workspace(1))
        if first[0] != (apart.rgb.tobytes(), apart.transmittance.tobytes()):
            faults.append("the fused frame has other bits than the four stages")
    if first[1] != (again.rgb.tobytes(), again.transmittance.tobytes()):
        faults.append("a second run gives other bits")
    return Verdict("bits", tuple(faults))


def _bytes(*values: object) -> list[bytes]:
    """The bytes of every array in ``values``, and in the fields of those that are dataclasses."""
    out = []
    for value in values:
        if isinstance(value, np.ndarray):
            out.append(value.tobytes())
        elif is_dataclass(value):
            out += _bytes(*(getattr(value, field.name) for field in fields(value)))
    return out


def check_memory(stages: Stages, case: Case) -> Verdict:
    """See the module: results of one workspace outlive calls with another; inputs stay."""
    scene, params = case.scene, case.params
    half = Case(
        scene.take(np.arange(len(scene) // 2, len(scene))), case.camera, params, case.threads
    )
    stage_by_stage: dict[str, Callable[[Case], tuple[object, ...]]] = {
        "project": lambda c: (c.scene, c.camera, c.params),
        "sort": lambda c: (c.splats,),
        "bin": lambda c: (c.splats, c.order),
        "composite": lambda c: (c.splats, c.bins, c.params),
        "fused": lambda c: (c.scene, c.camera, c.params),
    }
    faults = []
    for name, inputs in stage_by_stage.items():
        stage: Callable[..., object] | None = getattr(stages, name)
        if stage is None:
            continue
        given = inputs(case)
        before = _bytes(*given)
        result = stage(*given, Workspace(case.threads))
        result = result if isinstance(result, tuple) else (result,)
        if _bytes(*given) != before:
            faults.append(f"{name} changes what it is given")
        kept = _bytes(*result)
        stage(*inputs(half), Workspace(case.threads))
        if _bytes(*result) != kept:
            faults.append(f"{name}'s result changes in a call with another workspace")
    return Verdict("memory", tuple(faults))


FUNCTIONS: dict[str, Callable[[Stages, Case], Verdict]] = {
    "project": check_project,
    "sort": check_sort,
    "bin": check_bin,
    "composite": check_composite,
    "picture": check_picture,
    "bits": check_bits,
    "memory": check_memory,
}
"""In the order in which they are run."""


def check_stages(stages: Stages, case: Case) -> Iterator[Verdict]:
    """Every check that applies to what ``stages`` offers, one by one."""
    for name, function in FUNCTIONS.items():
        if name in STAGES and getattr(stages, name) is None:
            continue
        yield function(stages, case)
