"""The reference as a backend: slow, plain, always there, and the only one with float64."""

from __future__ import annotations

from tsplat.core.stages import Backend, Stages
from tsplat.hookspecs import hookimpl


def load() -> Stages:
    """The four stages of :mod:`tsplat.core.reference`."""
    from tsplat.core import reference

    return Stages(
        project=reference.project,
        sort=reference.sort,
        bin=reference.bin,
        composite=reference.composite,
    )


@hookimpl
def tsplat_backends() -> list[Backend]:
    """One row: ``numpy``."""
    return [Backend("numpy", "the reference, in NumPy; float32 or float64", load, rank=0)]
