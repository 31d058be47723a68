"""The machine's limits: bytes read and written per second, and vector operations per second.

    python bench/machine.py

Measured by probe.c, compiled here; without a C compiler there are no limits, and no floors.
"""

from __future__ import annotations

import ctypes
import os
import platform
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from contestants import instruction_sets

SIZE = 1 << 28  # bytes, several times any cache
ROUNDS = 1_000_000
UNROLLED = 12  # TWELVE of probe.c
LANES = {"generic": 4, "avx2": 8, "avx512": 16}
PER_STEP = {"generic": 2, "avx2": 1, "avx512": 1}  # instructions: generic x86 has no FMA
TRIES = 5


@dataclass(frozen=True)
class Limits:
    """What a number of threads reaches together; the best of a few tries."""

    read: float  # bytes/s
    write: float  # bytes/s
    lanes: dict[str, float]  # instruction set -> floating-point lanes/s, one operation each

    def best(self, other: Limits) -> Limits:
        """The better of both in everything: what slows a machine down is not its limit."""
        lanes = {name: max(rate, other.lanes[name]) for name, rate in self.lanes.items()}
        return Limits(max(self.read, other.read), max(self.write, other.write), lanes)


def processor() -> str:
    """Its name."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


@cache
def _build() -> ctypes.CDLL | None:
    compiler = os.environ.get("CC", "cc")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "probe.so"
        source = Path(__file__).with_name("probe.c")
        flags = ["-O2", "-ffp-contract=fast", "-shared", "-fPIC"]
        try:
            command = [compiler, *flags, str(source), "-o", str(library)]
            subprocess.run(command, check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            return None
        return ctypes.CDLL(str(library))


def _rate(work: Callable[[int], object], threads: int, amount: float) -> float:
    """``amount`` per second when each thread does ``work(thread)``."""
    least = float("inf")
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(TRIES):
            begin = time.perf_counter()
            list(pool.map(work, range(threads)))  # ctypes lets go of the interpreter's lock
            least = min(least, time.perf_counter() - begin)
    return amount / least


def limits(counts: Iterable[int]) -> dict[int, Limits]:
    """Number of threads -> limits; empty without a C compiler."""
    probe = _build()
    if probe is None:
        return {}
    memory = np.ones(SIZE + 64, np.uint8)
    start = memory.ctypes.data + -memory.ctypes.data % 64
    found = {}
    for threads in counts:
        share = SIZE // threads // 256 * 256

        def on_share(
            function: Callable[..., object], share: int = share
        ) -> Callable[[int], object]:
            return lambda thread: function(
                ctypes.c_void_p(start + thread * share), ctypes.c_int64(share)
            )

        lanes = {}
        for name in instruction_sets():
            step, per_step = getattr(probe, name), PER_STEP[name] * UNROLLED * LANES[name]
            lanes[name] = _rate(
                lambda _, step=step: step(ctypes.c_int64(ROUNDS), ctypes.c_float(0.5)),
                threads, threads * ROUNDS * per_step,
            )  # fmt: skip
        found[threads] = Limits(
            _rate(on_share(probe.read_bytes), threads, share * threads),
            _rate(on_share(probe.write_bytes), threads, share * threads),
            lanes,
        )
    return found


def main() -> None:
    print(processor())
    for threads, limit in limits([1, 2]).items():
        rates = ", ".join(f"{name} {rate / 1e9:.0f}" for name, rate in limit.lanes.items())
        print(
            f"{threads} threads: reads {limit.read / 1e9:.1f} GB/s, "
            f"writes {limit.write / 1e9:.1f} GB/s; 10^9 lanes/s: {rates}"
        )


if __name__ == "__main__":
    main()
