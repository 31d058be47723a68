"""The cheapest settings that keep an error bound on a scene: ``--max-error``.

What is not known is measured: pictures at each setting against the ``exact`` preset's, which is
the ideal picture as far as float32 goes, from the camera asked for and from two more round the
scene. Shortcuts are tried one after the other and kept where they are faster and hold; a margin is
left for cameras that were not tried.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from tsplat.core.camera import Camera
from tsplat.core.errors import ParamsError
from tsplat.core.params import KNOBS, PRESETS, RenderParams, parse_settings
from tsplat.core.types import Frame, Scene
from tsplat.core.workspace import Workspace
from tsplat.paths import turned
from tsplat.plan import Plan
from tsplat.quality.measure import LEVELS, Error, measure, over_all
from tsplat.views import scene_extent

MARGIN = 0.7
"""Of the bound that may be used up where it is measured."""

TURNS = (0.0, math.tau / 3, -math.tau / 3)
"""Radians about the middle of the scene and the camera's own upward axis: where to measure."""

THRESHOLDS = (
    ("1/65280", "1e-7"), ("1/16320", "1e-6"), ("1/4080", "1e-6"), ("1/1020", "1e-5"),
    ("1/510", "1e-4"), ("1/255", "1e-4"), ("2/255", "1e-3"), ("4/255", "1e-3"), ("8/255", "1e-3"),
)  # fmt: skip
"""Of alpha and of transmittance, each pair faster than the one before."""

FURTHER = (
    ("transmittance_min", ("1e-3", "1e-2", "3e-2")),
    ("sh_degree", ("2", "1", "0")),
    ("share", ("0.75", "0.5", "0.25")),
    ("scale", ("0.75", "0.5", "0.25")),
)
"""What is tried after the alpha threshold, each until it does not hold."""

REPEATS = 3


@dataclass(frozen=True)
class Bound:
    """8-bit levels that the error has to stay below."""

    p999: float
    worst: float

    def holds(self, error: Error) -> bool:
        """Whether ``error`` leaves the margin."""
        return error.p999 <= MARGIN * self.p999 and error.worst <= MARGIN * self.worst


def parse_bound(text: str) -> Bound:
    """``E`` for both or ``P999,WORST``.

    Raises:
        ParamsError: not one or two numbers above 0.
    """
    try:
        first, *rest = (float(part) for part in text.split(","))
        worst = rest[0] if rest else first
        if len(rest) > 1 or not (0 < first < math.inf and first <= worst < math.inf):
            raise ValueError
    except ValueError:
        raise ParamsError(
            "--max-error: expected E or P999,WORST in 8-bit levels, such as 1 or 0.5,4, "
            f"got {text!r}"
        ) from None
    return Bound(first, worst)


@dataclass(frozen=True)
class Tried:
    """Settings and what they did."""

    params: RenderParams
    error: Error
    seconds: float  # per picture
    holds: bool


@dataclass(frozen=True)
class Calibration:
    """What was picked, and all that was tried; ``contract`` is for comparison."""

    picked: Tried
    contract: Tried
    tried: Sequence[Tried]
    cameras: int


class _Trial:
    """Measures settings on some cameras."""

    def __init__(
        self, scene: Scene, cameras: Sequence[Camera], plan_of: Callable[[RenderParams], Plan],
        base: RenderParams, bound: Bound, progress: Callable[[], None],
    ) -> None:  # fmt: skip
        self._scene, self._cameras, self._plan_of = scene, cameras, plan_of
        self._bound, self._progress = bound, progress
        self._ideal = [
            self._copy(plan_of(_with(base, PRESETS["exact"])), camera) for camera in cameras
        ]
        self.all: list[Tried] = []

    def _copy(self, plan: Plan, camera: Camera) -> Frame:
        return plan.run(self._scene, camera, Workspace(plan.threads)).frame

    def __call__(self, params: RenderParams) -> Tried:
        """Stops at the first camera where the bound is broken."""
        plan, errors, times = self._plan_of(params), [], []
        workspace = Workspace(plan.threads)
        for camera, ideal in zip(self._cameras, self._ideal, strict=True):
            runs = []
            for _ in range(REPEATS):
                workspace.forget()
                rendered = plan.run(self._scene, camera, workspace)
                runs.append(rendered.seconds["total"])
            times.append(min(runs))
            errors.append(self._with_storage(measure(rendered.frame, ideal)))
            self._progress()
            if not self._bound.holds(errors[-1]):
                break
        error = over_all(errors)
        out = Tried(params, error, sum(times) / len(times), self._bound.holds(error))
        self.all.append(out)
        return out

    def _with_storage(self, error: Error) -> Error:
        """What float16 colours may cost comes on top."""
        more = LEVELS * self._scene.sh_error
        return replace(error, worst=error.worst + more, p999=error.p999 + more)


def _with(base: RenderParams, settings: RenderParams) -> RenderParams:
    """``base`` with the knobs of ``settings``."""
    return replace(base, **{name: getattr(settings, name) for name in KNOBS})


def calibrate(
    scene: Scene,
    camera: Camera,
    bound: Bound,
    plan_of: Callable[[RenderParams], Plan],
    base: RenderParams,
    progress: Callable[[], None] = lambda: None,
) -> Calibration:
    """The fastest settings found that hold ``bound`` on ``scene`` seen from about ``camera``.

    ``base`` says what is no knob: antialiasing, depth. ``exact`` is the last resort.

    Raises:
        ParamsError: not even that holds; the text says what it measured.
    """
    centre = scene_extent(scene).centre
    up = -camera.rotation[1]
    cameras = [turned(camera, centre, up, angle) for angle in TURNS]
    trial = _Trial(scene, cameras, plan_of, base, bound, progress)
    contract = trial(base)
    best = trial(_with(base, PRESETS["exact"]))
    if not best.holds:
        raise ParamsError(
            f"--max-error: colours in float16 alone may be {LEVELS * scene.sh_error:.2g} levels "
            f"off, and {MARGIN:.0%} of the bound may be used; try --sh-float32"
        )
    for alpha, left in THRESHOLDS:
        text = f"alpha_threshold={alpha},transmittance_min={left}"
        found = trial(parse_settings(text, base))
        if not found.holds:
            break
        best = min(best, found, key=lambda tried: tried.seconds)
    for name, values in FURTHER:
        start = best
        for value in values:
            params = parse_settings(f"{name}={value}", start.params)
            if _no_shortcut(name, params, start.params, scene):
                continue
            found = trial(params)
            if not found.holds:
                break
            best = min(best, found, key=lambda tried: tried.seconds)
    return Calibration(best, contract, trial.all, len(cameras))


def _no_shortcut(name: str, params: RenderParams, before: RenderParams, scene: Scene) -> bool:
    """Whether ``name`` leaves out no more in ``params`` than it did ``before``."""
    if name == "sh_degree":
        return params.sh_degree >= min(before.sh_degree, scene.sh_degree)
    if name == "transmittance_min":
        return params.transmittance_min <= before.transmittance_min
    return params == before
