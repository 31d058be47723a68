"""Decides which backend runs which stage, and why; leaves out what the scene does not need."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tsplat.core.camera import Camera
from tsplat.core.constants import ALPHA_THRESHOLD, TRANSMITTANCE_MIN
from tsplat.core.errors import PluginError, printable
from tsplat.core.params import DEPTH_BITS, RenderParams
from tsplat.core.stages import STAGES, Backend, Fused, LeftOut, Stages
from tsplat.core.ties import same_numbers
from tsplat.core.types import F16, F32, I32, Frame, Scene, Splats
from tsplat.core.workspace import Workspace, default_threads
from tsplat.plugins import Registry, ask, load_backend, plugins

AUTO = "auto"

PRICED = "another picture; tsplat bench says how much so"
"""The effect of a shortcut that was asked for."""


@dataclass(frozen=True)
class Choice:
    """Who runs a stage."""

    backend: str
    reason: str


@dataclass(frozen=True)
class Rendered:
    """A frame and what it took. ``seconds`` has the stages that ran apart, and ``total``."""

    frame: Frame
    visible: int  # splats
    intersections: int  # (splat, tile) pairs
    overflowed: int  # Gaussians too large or near for float32
    seconds: Mapping[str, float]
    left_out: tuple[LeftOut, ...] = ()  # what this frame did not need, besides Plan.left_out


@dataclass(frozen=True)
class Plan:
    """What :func:`make_plan` decided; pass it to :func:`render`."""

    params: RenderParams  # what stages are given: without SH bands that are zero
    asked: RenderParams
    threads: int
    choices: Mapping[str, Choice]  # stage -> who and why
    stages: Stages  # all four
    fused: Fused | None = None  # the whole frame at once, if one backend offers that
    left_out: tuple[LeftOut, ...] = ()  # of every frame
    everything: bool = False  # whether nothing is to be left out
    passed_over: tuple[str, ...] = ()  # backends "auto" did not take, with the reason

    @property
    def shortcuts(self) -> tuple[str, ...]:
        """What is left out of every frame although it makes another picture."""
        return tuple(item.what for item in self.left_out if item.effect == PRICED)

    @property
    def backends(self) -> dict[str, str]:
        """Stage -> backend name."""
        return {stage: choice.backend for stage, choice in self.choices.items()}

    @property
    def names(self) -> str:
        """The backends, each once, in the order of the stages: ``cffi+numpy``."""
        return "+".join(dict.fromkeys(self.backends.values()))

    def run(self, scene: Scene, camera: Camera, workspace: Workspace | None = None) -> Rendered:
        """One frame, with the time each stage took.

        The frame lives in ``workspace`` if one is lent, and is then good until its next use; a
        frame that was the last one made in it is not made again.
        """
        workspace = workspace or Workspace(self.threads)
        begin = time.perf_counter()
        last: tuple[Plan, Scene, Camera, Rendered] | None = workspace.known.get("plan")
        if last and last[0] is self and last[1] is scene and last[2].same(camera):
            why = LeftOut("the whole frame", "nothing has changed since the last one")
            seconds = {"total": time.perf_counter() - begin}
            return replace(last[3], seconds=seconds, left_out=(why,))
        rendered = self._made(scene, camera, workspace)
        workspace.known["plan"] = None if self.everything else (self, scene, camera, rendered)
        return rendered

    def _made(self, scene: Scene, camera: Camera, workspace: Workspace) -> Rendered:
        """Of a lighter scene and in fewer pixels, if that is asked for."""
        if self.params.share < 1 or self.params.half:
            from tsplat.quality.lighter import lighter

            scene = lighter(scene, self.params)
        if self.params.scale >= 1:
            return self._drawn(scene, camera, workspace)
        from tsplat.quality.upscale import reduced, upscale

        stretch = self.stages.upscale or upscale
        rendered = self._drawn(scene, reduced(camera, self.params.scale), workspace)
        begin = time.perf_counter()
        frame = stretch(rendered.frame, camera.width, camera.height, workspace)
        took = time.perf_counter() - begin
        seconds = {**rendered.seconds, "upscale": took, "total": rendered.seconds["total"] + took}
        return replace(rendered, frame=frame, seconds=seconds)

    def _drawn(self, scene: Scene, camera: Camera, workspace: Workspace) -> Rendered:
        clock = time.perf_counter
        begin = clock()
        if self.fused is not None:
            workspace.known["order"] = None  # it may use the memory
            frame, counts = self.fused(
                scene, camera, self.params, workspace, everything=self.everything
            )
            seconds = {**counts.seconds, "total": clock() - begin}
            return Rendered(
                frame, counts.visible, counts.intersections, counts.overflowed, seconds,
                counts.left_out,
            )  # fmt: skip
        project, bin, composite = self.stages.project, self.stages.bin, self.stages.composite
        assert project is not None  # as make_plan saw to
        assert bin is not None
        assert composite is not None
        splats = project(scene, camera, self.params, workspace)
        projected = clock()
        order, left_out = self._sorted(splats, workspace)
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
        return Rendered(frame, len(splats), len(bins), splats.overflowed, seconds, left_out)

    def _sorted(self, splats: Splats, workspace: Workspace) -> tuple[I32, tuple[LeftOut, ...]]:
        """The order of ``splats``; the last one if it must be the same.

        A sort sees depths and numbers and nothing else: if they are the same, so is the order. They
        are where the same Gaussians are seen from the same place: after a zoom or a change of size.
        """
        sort = self.stages.sort
        assert sort is not None
        last = workspace.known.get("order")
        if (
            last
            and last[0] is sort
            and np.array_equal(last[1], splats.depths)
            and same_numbers(last[2], splats.numbers)
        ):
            return last[3], (LeftOut("sorting", "depths are those of the last frame"),)
        order = sort(splats, workspace)
        kept = sort, splats.depths.copy(), splats.numbers, order
        workspace.known["order"] = None if self.everything else kept
        return order, ()


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
    out += _shortcuts(scene, params)
    if scene.sh_error:
        effect = f"no colour moves by more than {255 * scene.sh_error:.2g} of an 8-bit level"
        out.append(LeftOut("SH beyond float16", "not asked for", effect))
    if not params.depth:
        out.append(LeftOut("depth", "not asked for"))
    if not params.antialias:
        out.append(LeftOut("antialias factor", "not asked for"))
    return replace(params, sh_degree=lowest), out


def _shortcuts(scene: Scene, params: RenderParams) -> list[LeftOut]:
    """What is left out because it was asked for, and does change the picture."""
    asked = (
        (params.sh_degree < scene.sh_degree, f"SH beyond degree {params.sh_degree}"),
        (params.alpha_threshold > ALPHA_THRESHOLD, f"alphas below {params.alpha_threshold:.3g}"),
        (
            params.transmittance_min > TRANSMITTANCE_MIN,
            f"what is seen through {params.transmittance_min:.3g} of the light or less",
        ),
        (params.depth_bits < DEPTH_BITS, f"{DEPTH_BITS - params.depth_bits} bits of depths"),
        (params.scale < 1, f"{1 - params.scale**2:.0%} of the pixels, which are interpolated"),
        (params.share < 1, f"about {1 - params.share:.0%} of the Gaussians"),
        (params.half and scene.sh.dtype == np.float32, "SH beyond float16"),
    )
    return [LeftOut(what, "not wanted", PRICED) for applies, what in asked if applies]


def _any_nonzero(array: F16 | F32) -> bool:
    """``array.any()`` that stops at the first block that has one."""
    return any(array[i : i + 4096].any() for i in range(0, len(array), 4096))


def make_plan(
    scene: Scene,
    *,
    backend: str = AUTO,
    threads: int | None = None,
    params: RenderParams | None = None,
    everything: bool = False,
    registry: Registry | None = None,
) -> Plan:
    """The plan for pictures of ``scene``: a backend for each stage, and what is left out.

    ``backend`` is a name, ``STAGE=NAME,...`` or ``auto``. A named backend runs what it offers;
    the fastest available one runs the rest. With ``everything``, work is done that the picture
    does not need: to compare.

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
    stages = Stages(
        **{stage: getattr(loaded[name], stage) for stage, name in names.items()},
        upscale=loaded[names["composite"]].upscale,
    )
    one = loaded[names["project"]] if len(set(names.values())) == 1 else stages
    needed, left_out = (asked, []) if everything else _leave_out(scene, asked)
    if one.fused is not None and not everything:
        left_out += one.leaves_out(scene, needed)
    return Plan(
        params=needed,
        asked=asked,
        threads=threads or default_threads(),
        choices=choices,
        stages=stages,
        fused=one.fused,
        left_out=tuple(left_out),
        everything=everything,
        passed_over=tuple(f"{n}: {r}" for n, r in passed_over.items()),
    )
