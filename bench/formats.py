"""Files of one scene in several formats: how fast each loads, and how far its picture is off.

    python bench/formats.py scene.ply scene.splat scene.ksplat     # pictures against the first's
    python bench/formats.py --million                              # a million Gaussians a format

Every load is a process of its own with the file in the page cache, whose CPU time, too, is that of
``load_scene`` alone; quoted are minima. The floor is what one thread takes to read the file and to
write as many bytes as the scene has, decoding nothing. Peak memory is the largest resident set
less what it was before the load. PSNR (dB) is of pictures of 640x360 from the default view of the
first scene; ``of what fits`` is that against its Gaussians with no more than a format of that
degree can hold: base colours within 0..1 in .splat and ksplat, all coefficients within what SPZ
has bytes for. Files whose writer left a PLY's axes as they were, where the format has others, are
turned by 180 degrees about x first, and marked.
``--million`` writes files as the tests do, positions and colours at random, compressed PLY along a
curve as its own tools do, and takes no pictures. Random numbers are the worst that an unpacker can
get: nothing in them repeats.
``--splat-transform`` and ``--gsply`` add what other readers take: the process
``splat-transform FILE null`` beside the process that loads with tsplat, from start to end, and
gsply's function, called a second time, when its loops are compiled, beside ``load_scene`` alone.
A dash: it does not read that.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

LOAD = r"""
import re, sys, time, tsplat
import tsplat.plugins, tsplat.io.plyrows
peak = lambda: int(re.search(r"VmHWM:\s+(\d+)", open("/proc/self/status").read())[1])
tsplat.plugins.plugins()
before = peak()
begin, cpu = time.perf_counter(), time.process_time()
scene = tsplat.load_scene(sys.argv[1])
end, used = time.perf_counter(), time.process_time()
arrays = scene.means, scene.quats, scene.scales, scene.opacities, scene.sh
size = sum(array.nbytes for array in arrays)
print(end - begin, used - cpu, (peak() - before) * 1024, len(scene), size, scene.source, sep="\t")
"""
FLOOR = r"""
import sys, time
import numpy as np
room = np.zeros(1 << 20, np.uint8)
begin = time.perf_counter()
with open(sys.argv[1], "rb", buffering=0) as file:
    while file.readinto(room):
        pass
np.empty(int(sys.argv[2]), np.uint8).fill(1)
print(time.perf_counter() - begin)
"""
GSPLY = r"""
import sys, time, gsply
read = gsply.read_spz if sys.argv[1].endswith(".spz") else gsply.plyread
read(sys.argv[1])
begin = time.perf_counter()
read(sys.argv[1])
print(time.perf_counter() - begin)
"""
HEADINGS = (
    "file", "format", "Gaussians", "MB", "floor, ms", "ms", "CPU ms", "ns each", "MB/s", "peak, MB",
    "PSNR", "of what fits",
)  # fmt: skip
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
"""Of processes: an installed package is compiled."""

OTHERS = "process, ms", "splat-transform, ms", "gsply, ms"
SIZE = 640, 360


def measure(path: Path, runs: int) -> list[str]:
    """The cells of a file's row but the last."""
    rows = []
    for _ in range(runs):
        command = [sys.executable, "-c", LOAD, str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=ENVIRONMENT)
        rows.append(done.stdout.strip().split("\t"))
    seconds, cpu = (min(float(row[i]) for row in rows) for i in (0, 1))
    peak = max(float(row[2]) for row in rows)
    count, source, size = int(rows[0][3]), rows[0][5], path.stat().st_size
    command = [sys.executable, "-c", FLOOR, str(path), rows[0][4]]
    floor = min(
        float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        for _ in range(runs)
    )
    return [
        path.name, source, f"{count:,}", f"{size / 1e6:.1f}", f"{floor * 1e3:.0f}",
        f"{seconds * 1e3:.0f}", f"{cpu * 1e3:.0f}", f"{cpu / count * 1e9:.0f}",
        f"{size / seconds / 1e6:.0f}", f"{peak / 1e6:.0f} ({peak / size:.1f} files)",
    ]  # fmt: skip


def seconds_of(command: list[str], runs: int) -> float | None:
    """The fastest of several runs of a process; nothing if it fails."""
    best = float("inf")
    for _ in range(runs):
        begin = time.perf_counter()
        if subprocess.run(command, capture_output=True, env=ENVIRONMENT, check=False).returncode:
            return None
        best = min(best, time.perf_counter() - begin)
    return best


def peers(path: Path, runs: int, transform: str | None, gsply: str | None) -> list[str]:
    """What other readers take for ``path``, beside tsplat's whole process."""
    ours = seconds_of([sys.executable, "-c", LOAD, str(path)], runs)
    theirs = seconds_of([transform, "-q", str(path), "null"], runs) if transform else None
    inside = None
    for _ in range(runs if gsply and path.suffix in (".ply", ".spz") else 0):
        command = [str(gsply), "-c", GSPLY, str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            inside = min(inside or float("inf"), float(done.stdout))
    return ["-" if s is None else f"{s * 1e3:.0f}" for s in (ours, theirs, inside)]


def pictures(paths: list[Path]) -> list[str]:
    """PSNR of each file's picture against the first one's."""
    import numpy as np

    import tsplat
    from tsplat.core.constants import SH_C0
    from tsplat.io.turn import half_turned
    from tsplat.testing.compare import psnr

    first = tsplat.load_scene(paths[0])
    camera = tsplat.frame_scene(first, *SIZE)
    wanted = tsplat.render(first, camera)
    cells = [" | "]
    for path in paths[1:]:
        scene = tsplat.load_scene(path)
        sh = first.sh[:, : scene.sh.shape[1]].astype(np.float32)
        if scene.source.startswith((".splat", "ksplat")):
            sh[:, 0] = np.clip(sh[:, 0], -0.5 / SH_C0, 0.5 / SH_C0)
        if scene.source.startswith("spz"):
            sh[:, 0] = np.clip(sh[:, 0], -0.5 / 0.15, 0.5 / 0.15)
            sh[:, 1:] = np.clip(sh[:, 1:], -1, 127 / 128)
        fitting = tsplat.render(replace(first, sh=sh), camera)
        frames = [tsplat.render(s, camera) for s in (scene, half_turned(scene))]
        frame = max(frames, key=lambda frame: psnr(frame, wanted))
        mark = "" if frame is frames[0] else " (turned)"
        cells.append(f"{psnr(frame, wanted):.1f}{mark} | {psnr(frame, fitting):.1f}")
    return cells


def million(folder: Path) -> list[Path]:
    """A file of each format."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from tests.io import gltfwriter, sogwriter, spzwriter
    from tests.io.splatwriter import drawn, write_compressed, write_ksplat, write_splat
    from tsplat.io.curve import rows_along_curve

    for degree in (0, 2, 3):
        g = drawn(1_000_000, degree)
        if degree == 0:
            write_splat(folder / "random.splat", g)
        for level in (0, 1, 2) if degree == 2 else ():
            write_ksplat(folder / f"level{level}-sh2.ksplat", [(g, 2)], level)
        if degree != 2:
            g = g.take(rows_along_curve(g.means))
            write_compressed(folder / f"sh{degree}.compressed.ply", g)
    count = 1_000_000
    for version, degree in ((2, 0), (3, 0), (3, 3), (4, 3)):
        planes = spzwriter.random_planes(count, version, degree)
        content = spzwriter.packed(count, version, degree, planes)
        (folder / f"v{version}-sh{degree}.spz").write_bytes(content)
    for degree in (0, 3):
        meta, images = sogwriter.random_scene(count, degree)[:2]
        (folder / f"sh{degree}.sog").write_bytes(sogwriter.bundle(meta, images))
        glb = gltfwriter.one(gltfwriter.random_arrays(count, degree)).glb()
        (folder / f"sh{degree}.glb").write_bytes(glb)
    return sorted(folder.iterdir())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--million", action="store_true")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--splat-transform", metavar="PROGRAM")
    parser.add_argument("--gsply", metavar="PYTHON", help="an interpreter that has it")
    arguments = parser.parse_args()
    others = arguments.splat_transform, arguments.gsply
    headings = HEADINGS + (OTHERS if any(others) else ())
    print("| " + " | ".join(headings) + " |")
    print("|---|---|" + "--:|" * (len(headings) - 2))
    with tempfile.TemporaryDirectory() as folder:
        paths = million(Path(folder)) if arguments.million else arguments.files
        shown = [" | "] * len(paths) if arguments.million else pictures(paths)
        for path, cell in zip(paths, shown, strict=True):
            cells = [*measure(path, arguments.runs), cell]
            if any(others):
                cells += peers(path, arguments.runs, *others)
            print("| " + " | ".join(cells) + " |", flush=True)
    print(f"\n{os.cpu_count()} CPUs")


if __name__ == "__main__":
    main()
