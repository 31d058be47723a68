"""Time and error of every backend at every setting, on several cameras: rows of ``tsplat bench``.

Errors are against the ideal picture in float64. A row's time is what one picture takes, the mean
over the cameras, of each the least or the median of its runs; rows take turns, so that a slow
spell of the machine hits all of them.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from tsplat.core import reference
from tsplat.core.camera import Camera
from tsplat.core.params import IDEAL, PRESETS, RenderParams, parse_settings
from tsplat.core.types import Frame, Scene
from tsplat.core.workspace import Workspace
from tsplat.plan import Plan, Rendered, make_plan
from tsplat.quality.measure import Error, measure, over_all

LADDERS = (
    "alpha_threshold=1/65280", "alpha_threshold=1/4080", "alpha_threshold=1/1020",
    "alpha_threshold=1/510", "alpha_threshold=2/255", "alpha_threshold=4/255",
    "alpha_threshold=8/255", "transmittance_min=1e-6", "transmittance_min=1e-3",
    "transmittance_min=1e-2", "transmittance_min=3e-2", "sh_degree=2", "sh_degree=1", "sh_degree=0",
    "depth_bits=24", "depth_bits=20", "depth_bits=16", "scale=0.75", "scale=0.5", "scale=0.25",
    "share=0.75", "share=0.5", "share=0.25", "half=true",
)  # fmt: skip
"""One shortcut at a time, each on top of the contract."""


def settings(scene: Scene, extra: Sequence[str] = ()) -> dict[str, RenderParams]:
    """Name -> what is to be measured: presets, single shortcuts that apply, and ``extra``."""
    degree = scene.sh_degree
    out = dict(PRESETS)
    for text in LADDERS:
        params = parse_settings(text)
        if text.startswith("sh_degree") and params.sh_degree >= degree:
            continue
        out[text] = params
    return {**out, **{text: parse_settings(text) for text in extra}}


@dataclass
class Row:
    """One backend at one setting."""

    backend: str
    setting: str
    params: RenderParams
    plan: Plan
    errors: list[Error] = field(default_factory=list)  # one per camera
    runs: list[list[Mapping[str, float]]] = field(default_factory=list)  # per camera, per run
    optimal: bool = False  # nothing measured is both faster and nearer the ideal

    @property
    def error(self) -> Error:
        """Over all cameras."""
        return over_all(self.errors)

    def seconds(self, stage: str = "total") -> tuple[float, float]:
        """(least, median) of the runs, the mean over the cameras."""
        per_camera = [[run.get(stage, 0.0) for run in runs] for runs in self.runs]
        least = statistics.fmean(min(times) for times in per_camera)
        return least, statistics.fmean(statistics.median(times) for times in per_camera)

    @property
    def stages(self) -> tuple[str, ...]:
        """What is timed apart."""
        return tuple(name for name in self.runs[0][0] if name != "total")

    @property
    def done(self) -> bool:
        """Whether there is an error and a time for every camera."""
        return bool(self.errors) and len(self.runs) == len(self.errors) and all(self.runs)


@dataclass(frozen=True)
class Sweep:
    """What is to be measured, and the workspace for it."""

    scene: Scene
    cameras: Sequence[Camera]
    rows: Sequence[Row]
    threads: int
    runs: int

    def __len__(self) -> int:
        """Steps in all."""
        return len(self.cameras) * (1 + len(self.rows)) + self.runs * len(self.rows)

    def steps(self) -> Iterator[None]:
        """Errors first, then times; yields after every step. What is done is in the rows."""
        for camera in self.cameras:
            ideal = ideal_frame(self.scene, camera)
            yield
            for row in self.rows:
                row.errors.append(measure(self._frame(row, camera).frame, ideal))
                row.runs.append([])
                yield
        for _ in range(self.runs):
            for row in self.rows:
                workspace = Workspace(self.threads)
                for camera, runs in zip(self.cameras, row.runs, strict=True):
                    row.plan.run(self.scene, camera, workspace)  # memory and caches are warm
                    workspace.forget()
                    runs.append(row.plan.run(self.scene, camera, workspace).seconds)
                yield

    def _frame(self, row: Row, camera: Camera) -> Rendered:
        return row.plan.run(self.scene, camera, Workspace(self.threads))


def ideal_frame(scene: Scene, camera: Camera) -> Frame:
    """The true value of the model, in float64; takes its time."""
    return reference.render(scene, camera, IDEAL)


def make_sweep(
    scene: Scene,
    cameras: Sequence[Camera],
    backends: Sequence[str],
    wanted: Mapping[str, RenderParams],
    threads: int,
    runs: int,
) -> Sweep:
    """Rows for each of ``backends`` at each of ``wanted``.

    Raises:
        PluginError: a backend cannot do that.
    """
    rows = [
        Row(name, setting, params, make_plan(scene, backend=name, threads=threads, params=params))
        for name in backends
        for setting, params in wanted.items()
    ]
    return Sweep(scene, cameras, rows, threads, runs)


FLOOR = 1e-3
"""8-bit levels: errors below it are all alike, being float32's own."""


def mark_optimal(rows: Sequence[Row]) -> None:
    """Sets ``optimal`` where no other row is at least as good in time and error, better in one."""
    points = [(row.seconds()[0], max(row.error.p999, FLOOR)) for row in rows]
    for row, (time, error) in zip(rows, points, strict=True):
        row.optimal = not any(
            t <= time and e <= error and (t, e) != (time, error) for t, e in points
        )
