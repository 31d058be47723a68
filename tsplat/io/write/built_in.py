"""The formats that tsplat itself writes; what writes them is imported when it is needed."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from tsplat.hookspecs import hookimpl
from tsplat.io.write.base import Write, Writer


def _of(module: str) -> Callable[[], Write]:
    def load() -> Write:
        write: Write = import_module(f"tsplat.io.write.{module}").write
        return write

    return load


WRITERS = [
    Writer(
        name="ply",
        summary="INRIA's PLY, exact, spherical harmonics of degree 0 to 3",
        suffixes=(".ply",),
        load=_of("ply"),
    ),
    Writer(
        name="compressed-ply",
        summary="PlayCanvas' compressed PLY: 16 bytes a Gaussian and one a coefficient",
        suffixes=(".compressed.ply",),
        load=_of("compressed"),
    ),
    Writer(
        name="splat",
        summary="antimatter15's .splat: 32 bytes a Gaussian, no view dependence",
        suffixes=(".splat",),
        load=_of("splat"),
        degree=0,
    ),
    Writer(
        name="spz",
        summary="Niantic's SPZ, version 3, or 2 or 4",
        suffixes=(".spz",),
        load=_of("spz"),
        takes=("version", "fractional_bits", "sh_bits"),
    ),
]


@hookimpl
def tsplat_writers() -> list[Writer]:
    """See :func:`tsplat.hookspecs.tsplat_writers`."""
    return WRITERS
