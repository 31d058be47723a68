"""The numba kernels as a backend. This module only says whether they can run; it is cheap."""

from __future__ import annotations

from importlib.util import find_spec

from tsplat.core.params import RenderParams
from tsplat.core.stages import Backend, Stages
from tsplat.core.types import Scene
from tsplat.hookspecs import hookimpl


def unavailable() -> str | None:
    """Why the kernels cannot be used, and what to do about it; None if they can."""
    if find_spec("numba") is not None:
        return None
    return "numba is not installed; pip install numba"


def cannot(scene: Scene, params: RenderParams) -> str | None:
    """The kernels work in float32."""
    return "computes in float32; float64 needs numpy" if params.float64 else None


def load() -> Stages:
    """The four stages in numba; each is compiled when it first runs, and kept on disk."""
    from tsplat.backends.numba_kernels import wrap

    return Stages(wrap.project, wrap.sort, wrap.bin, wrap.composite, wrap.fused)


@hookimpl
def tsplat_backends() -> list[Backend]:
    """One row: ``numba``."""
    return [
        Backend(
            "numba", "loops compiled by numba, float32, any number of threads", load,
            rank=10, unavailable=unavailable, cannot=cannot,
        )
    ]  # fmt: skip
