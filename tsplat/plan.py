"""Decides which backend runs which stage, and why; leaves out what the scene does not need."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

from tsplat.core.camera import Camera
from tsplat.core.errors import PluginError, printable
from tsplat.core.params import RenderParams
from tsplat.core.stages import STAGES, Backend, Fused, Stages
from tsplat.core.types import F16, F32, Frame, Scene
from tsplat.core.workspace import Workspace, default_threads
from tsplat.plugins import Registry, ask, load_backend, plugins

AUTO = "auto"
IDENTICAL = "the picture is the same to the bit"


@dataclass(frozen=True)
class Choice:
    """Who runs a stage."""

    backend: str
    reason: str


@dataclass(frozen=True)
class LeftOut:
    """Work that is skipped."""

    what: str
    why: str
    effect: str = IDENTICAL


@dataclass(frozen=True)
class Rendered:
    """A frame and what it took. ``seconds`` has the stages that ran apart, and ``total``."""

    frame: Frame
    visible: int  # splats
    intersections: int  # (splat, tile) pairs
    overflowed: int  # Gaussians too large or near for float32
    seconds: Mapping[str, float]


@dataclass(frozen=True)
class Plan:
    """What :func:`make_plan` decided; pass it to :func:`render`."""

    params: RenderParams
    threads: int
    choices: Mapping[str, Choice]  # stage -> who and why
    stages: Stages  # all four
    fused: Fused | None = None  # the whole frame at once, if one backend offers that
    left_out: tuple[LeftOut, ...] = ()
    passed_over: tuple[str, ...] = ()  # backends "auto" did not take, with the reason

    @property
    def backends(self) -> dict[str, str]:
        """Stage -> backend name."""
        return {stage: choice.backend for stage, choice in self.choices.items()}

    def run(self, scene: Scene, camera: Camera, workspace: Workspace | None = None) -> Rendered:
        """One frame, with the time each stage took.

        The frame lives in ``workspace`` if one is lent, and is then good until its next use.
        """
        workspace = workspace or Workspace(self.threads)
        clock = time.perf_counter
        begin = clock()
        if self.fused is not None:
            frame, counts = self.fused(scene, camera, self.params, workspace)
            seconds = {**counts.seconds, "total": clock() - begin}
            return Rendered(frame, counts.visible, counts.intersections, counts.overflowed, seconds)
        project, sort, bin, composite = (getattr(self.stages, s) for s in STAGES)
        splats = project(scene, camera, self.params, workspace)
        projected = clock()
        order = sort(splats, workspace)
        ordered = clock()
        bins = bin(splats, order, workspace)
        binned = clock()
        frame = composite(splats, bins, self.params, workspace)
        end = clock()
        seconds = {
            "project": projected - begin,
            "sort": ordered - projected,
            "bin": binned - ordered,
            "composite": end - binned,
            "total": end - begin,
        }
        return Rendered(frame, len(splats), len(bins), splats.overflowed, seconds)


def render(
    scene: Scene, camera: Camera, plan: Plan | None = None, workspace: Workspace | None = None
) -> Frame:
    """The picture of ``scene`` that ``camera`` takes; ``plan`` defaults to the fastest backend."""
    return (plan or make_plan(scene)).run(scene, camera, workspace).frame


def parse_backend(text: str) -> dict[str, str]:
    """``numba`` or ``project=cffi,composite=numba`` as stage -> backend name, ``auto`` if unsaid.

    Raises:
        PluginError: not of that form, or no such stage.
    """
    if not text.strip():
        raise PluginError("--backend: expected a name, STAGE=NAME,... or auto, got nothing")
    if "=" not in text:
        return dict.fromkeys(STAGES, text.strip() or AUTO)
    wanted = dict.fromkeys(STAGES, AUTO)
    for part in text.split(","):
        stage, equals, name = (p.strip() for p in part.partition("="))
        if stage not in STAGES or not equals or not name:
            raise PluginError(
                f"--backend {printable(text)!r}: expected NAME or STAGE=NAME,... "
                f"with stages {', '.join(STAGES)}"
            )
        if wanted[stage] != AUTO:
            raise PluginError(f"--backend {printable(text)!r} names {stage} twice")
        wanted[stage] = name
    return wanted


def why_not(backend: Backend, scene: Scene, params: RenderParams) -> str | None:
    """Why ``backend`` cannot make this picture here; None if it can."""
    return ask(backend.unavailable) or ask(backend.cannot, scene, params)


def _leave_out(scene: Scene, params: RenderParams) -> tuple[RenderParams, list[LeftOut]]:
    out = []
    degree = min(params.sh_degree, scene.sh_degree)
    lowest = degree
    while lowest > 0 and not _any_nonzero(scene.sh[:, lowest**2 : (lowest + 1) ** 2]):
        lowest -= 1
    if lowest < degree:
        bands = str(degree) if lowest == degree - 1 else f"{lowest + 1} to {degree}"
        out.append(LeftOut(f"SH bands {bands}", "all their coefficients are zero"))
    if scene.sh_error:
        effect = f"no colour moves by more than {255 * scene.sh_error:.2g} of an 8-bit level"
        out.append(LeftOut("SH beyond float16", "not asked for", effect))
    if not params.depth:
        out.append(LeftOut("depth", "not asked for"))
    if not params.antialias:
        out.append(LeftOut("antialias factor", "not asked for"))
    return replace(params, sh_degree=lowest), out


def _any_nonzero(array: F16 | F32) -> bool:
    """``array.any()`` that stops at the first block that has one."""
    return any(array[i : i + 4096].any() for i in range(0, len(array), 4096))


def make_plan(
    scene: Scene,
    *,
    backend: str = AUTO,
    threads: int | None = None,
    params: RenderParams | None = None,
    registry: Registry | None = None,
) -> Plan:
    """The plan for pictures of ``scene``: a backend for each stage, and what is left out.

    ``backend`` is a name, ``STAGE=NAME,...`` or ``auto``. A named backend runs what it offers;
    the fastest available one runs the rest.

    Raises:
        PluginError: a named backend is not installed, not available, or cannot do this.
    """
    registry = registry or plugins()
    asked = params or RenderParams()
    wanted = parse_backend(backend)
    ranked = sorted(registry.backends.values(), key=lambda b: -b.rank)
    loaded: dict[str, Stages] = {}
    passed_over: dict[str, str] = {}
    for name in dict.fromkeys(n for n in wanted.values() if n != AUTO):
        row = registry.find("backend", name)
        reason = why_not(row, scene, asked)
        if reason is not None:
            raise PluginError(f"backend {name!r} cannot be used: {reason}")
        loaded[name] = load_backend(row)

    def fastest(stage: str) -> str:
        for row in ranked:
            if stage not in row.stages or row.name in passed_over:
                continue
            if row.name in loaded:
                return row.name
            reason = why_not(row, scene, asked)
            if reason is None:
                try:
                    loaded[row.name] = load_backend(row)
                except PluginError as error:
                    reason = str(error)
                else:
                    return row.name
            passed_over[row.name] = reason
        raise PluginError(f"no backend offers {stage}: {'; '.join(passed_over.values())}")

    choices = {}
    for stage in STAGES:
        name = wanted[stage]
        if name == AUTO:
            choices[stage] = Choice(fastest(stage), "fastest available")
        elif stage in loaded[name].offered():
            choices[stage] = Choice(name, "asked for")
        elif "=" in backend:
            offered = ", ".join(loaded[name].offered())
            raise PluginError(f"backend {name!r} does not offer {stage}, only {offered}")
        else:
            choices[stage] = Choice(fastest(stage), f"{name} does not offer it")
    names = {stage: choice.backend for stage, choice in choices.items()}
    stages = Stages(**{stage: getattr(loaded[name], stage) for stage, name in names.items()})
    fused = loaded[names["project"]].fused if len(set(names.values())) == 1 else None
    needed, left_out = _leave_out(scene, asked)
    return Plan(
        params=needed,
        threads=threads or default_threads(),
        choices=choices,
        stages=stages,
        fused=fused,
        left_out=tuple(left_out),
        passed_over=tuple(f"{n}: {r}" for n, r in passed_over.items()),
    )
