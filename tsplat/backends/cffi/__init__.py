"""The C kernel as a backend. This module only says whether it is there, and is cheap."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

from tsplat.core.params import RenderParams
from tsplat.core.stages import Backend, Stages
from tsplat.core.types import Scene
from tsplat.hookspecs import hookimpl

REMEDY = "install a C compiler (gcc or clang) and reinstall tsplat with pip install --no-cache-dir"


WAITING = {"OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "10000"}
"""What OpenMP reads when it is loaded: its threads may spin for some 10 us before they sleep.

By default they spin for milliseconds. On a machine with other work that takes the CPU away from the
very thread that is waited for: small frames took ten times as long, large ones twice.
"""


def unavailable() -> str | None:
    """Why the kernel cannot be used, and what to do about it; None if it can."""
    if find_spec("tsplat.backends.cffi._kernel") is not None:
        return None
    report = Path(__file__).with_name("_kernel.build_error.txt")
    cause = " ".join(report.read_text().split()) if report.is_file() else "no attempt was made"
    return f"no C kernel: {REMEDY}. It was not built: {cause}"


def cannot(scene: Scene, params: RenderParams) -> str | None:
    """The kernel works in float32."""
    return "computes in float32; float64 needs numpy" if params.float64 else None


def load() -> Stages:
    """The four stages in C, on the instruction set that ``TSPLAT_ISA`` names or the best there is.

    Raises:
        PluginError: ``TSPLAT_ISA`` names one that this CPU or build does not offer.
    """
    for name, value in WAITING.items():
        os.environ.setdefault(name, value)
    from tsplat.backends.cffi import frame, isa, stages, upscale

    isa.use_environment()
    return Stages(
        project=stages.project, sort=stages.sort, bin=stages.bin, composite=stages.composite,
        fused=frame.fused, upscale=upscale.upscale, leaves_out=frame.leaves_out,
    )  # fmt: skip


@hookimpl
def tsplat_backends() -> list[Backend]:
    """One row: ``cffi``."""
    return [
        Backend(
            "cffi", "C kernel, float32, threads by OpenMP", load,
            rank=20, unavailable=unavailable, cannot=cannot,
        )
    ]  # fmt: skip
