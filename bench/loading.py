"""Times loading: a file of a million Gaussians of degree 3, made in a temporary directory.

    python bench/loading.py                          # 1M, 248 MB
    python bench/loading.py 6000000 --runs 3         # 1.5 GB
    python bench/loading.py --sh-float32 --json out.json

Every run is a process of its own with the file in the page cache. ``load`` is load_scene alone, as
it sees it; ``first frame`` is all of ``tsplat render FILE --size 120x80`` from start to end; peak
memory is the process's largest resident set, and what share of the file that is. Quoted are the
minimum and the median of the runs, of memory the maximum.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROWS = 1 << 16
NAMES = [
    *"xyz", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(45)),
    "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4)),
]  # fmt: skip
LOAD = """
import sys, time, tsplat
begin = time.perf_counter()
scene = tsplat.load_scene(sys.argv[1], sh_float32="--sh-float32" in sys.argv)
print(time.perf_counter() - begin, scene.sh.dtype, 255 * scene.sh_error)
"""


def write(path: Path, count: int) -> None:
    """A file as INRIA's trainer writes it, of ``count`` Gaussians in a box of 40 units."""
    rng = np.random.default_rng(2)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    head += [*(f"property float {name}" for name in NAMES), "end_header", ""]
    with path.open("wb") as stream:
        stream.write("\n".join(head).encode())
        for start in range(0, count, ROWS):
            n = min(ROWS, count - start)
            rows = np.zeros((n, len(NAMES)), np.float32)
            rows[:, :3] = rng.uniform(-20, 20, (n, 3))
            rows[:, 6:9] = rng.uniform(-1.7, 1.7, (n, 3))
            rows[:, 9:54] = rng.normal(0, 0.1, (n, 45))
            rows[:, 54] = rng.normal(0, 2, n)
            rows[:, 55:58] = rng.normal(-3.5, 0.8, (n, 3))
            rows[:, 58:] = rng.normal(size=(n, 4))
            stream.write(rows.tobytes())


def run(command: list[str]) -> tuple[float, int, str]:
    """Seconds from start to end, bytes of peak memory, and what was printed."""
    begin = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        printed = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{command[0]} failed with exit code {process.returncode}")
    unit = 1 if sys.platform == "darwin" else 1024  # ru_maxrss
    return time.perf_counter() - begin, usage.ru_maxrss * unit, printed


def measure(path: Path, runs: int, options: list[str]) -> dict[str, object]:
    """What the module says, for one file."""
    load = [sys.executable, "-c", LOAD, str(path), *options]
    render = [
        sys.executable, "-m", "tsplat", "render", str(path), "--size", "120x80",
        "-o", str(path.with_suffix(".png")), "--json", *options,
    ]  # fmt: skip
    loads, frames, load_peak, frame_peak, words = [], [], 0, 0, []
    for _ in range(runs):  # in turns, so that a slow spell hits both
        _, peak, printed = run(load)
        words = printed.split()
        loads.append(float(words[0]))
        load_peak = max(load_peak, peak)
        seconds, peak, _ = run(render)
        frames.append(seconds)
        frame_peak = max(frame_peak, peak)
    size = path.stat().st_size
    return {
        "bytes": size,
        "sh_dtype": words[1],
        "sh_error_levels": float(words[2]),
        "load_seconds": min(loads),
        "load_seconds_median": statistics.median(loads),
        "load_peak": load_peak,
        "load_peak_share": load_peak / size,
        "first_frame_seconds": min(frames),
        "first_frame_seconds_median": statistics.median(frames),
        "first_frame_peak": frame_peak,
        "first_frame_peak_share": frame_peak / size,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("gaussians", nargs="?", type=int, default=1_000_000)
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--sh-float32", action="store_true")
    parser.add_argument("--json", metavar="FILE")
    arguments = parser.parse_args()
    options = ["--sh-float32"] if arguments.sh_float32 else []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made.ply"
        write(path, arguments.gaussians)
        facts = measure(path, arguments.runs, options)
    facts = {"gaussians": arguments.gaussians, **facts}
    print(
        f"{facts['gaussians']:,} Gaussians, {facts['bytes'] / 1e6:.0f} MB, SH in "
        f"{facts['sh_dtype']} (at most {facts['sh_error_levels']:.2g} of an 8-bit level off)"
    )
    for name in ("load", "first_frame"):
        print(
            f"{name.replace('_', ' '):11}  {facts[f'{name}_seconds']:.3f} s "
            f"(median {facts[f'{name}_seconds_median']:.3f}), peak "
            f"{facts[f'{name}_peak'] / 1e6:.0f} MB = {facts[f'{name}_peak_share']:.2f} of the file"
        )
    if arguments.json:
        machine = {"processor": platform.processor() or platform.machine(), **facts}
        Path(arguments.json).write_text(json.dumps(machine, indent=1))


if __name__ == "__main__":
    main()
