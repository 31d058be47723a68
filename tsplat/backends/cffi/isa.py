"""Which instruction set the C kernel uses: the best this CPU has, or the one that is named."""

from __future__ import annotations

import os

from tsplat.backends.cffi._kernel import lib
from tsplat.core.errors import PluginError, printable

ENVIRONMENT = "TSPLAT_ISA"
ISAS: dict[str, int] = {  # best first
    "avx512": lib.TSPLAT_AVX512,
    "avx2": lib.TSPLAT_AVX2,
    "generic": lib.TSPLAT_GENERIC,
}


def offered() -> list[str]:
    """What this CPU and build offer, best first."""
    found = lib.tsplat_isas()
    return [name for name, bit in ISAS.items() if found & bit]


def use_isa(name: str | None = None) -> str:
    """Switches the kernel to ``name``, or to the best there is; returns which.

    Raises:
        PluginError: this CPU or build does not offer it.
    """
    chosen = name or offered()[0]
    if chosen not in offered():
        raise PluginError(
            f"{ENVIRONMENT}={printable(repr(chosen))}, but this CPU and build offer: "
            + ", ".join(offered())
        )
    lib.tsplat_use_isa(ISAS[chosen])
    return chosen


def use_environment() -> str:
    """:func:`use_isa` with what ``TSPLAT_ISA`` says."""
    return use_isa(os.environ.get(ENVIRONMENT) or None)
