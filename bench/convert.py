"""Converting a scene to every format: seconds, memory, bytes and pictures, beside other tools.

    python bench/convert.py scene.ply
    python bench/convert.py scene.ply --splat-transform PATH --niantic PATH

Each conversion is a process of its own with the file in the page cache; wall time and the largest
resident set are the process's, so Python's or Node's start is in them. ``write`` is tsplat's own
part after the scene is in memory; ``least`` is what the result must cost anyway: writing its bytes,
or for SPZ compressing its planes with zlib's level 6 in one thread. Every result is read by
tsplat's reader and drawn: PSNR (dB, at worst and median) is against the source's pictures. gsply,
where it is installed, splat-transform, and a program ``PATH write IN OUT VERSION`` made of
Niantic's library are the others.
"""

from __future__ import annotations

import argparse
import gzip
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import zlib
from dataclasses import replace
from pathlib import Path

FORMATS = ("ply", "compressed.ply", "splat", "spz")
GSPLY = {
    "compressed.ply": "import gsply,sys; d=gsply.plyread(sys.argv[1]); "
    "gsply.plywrite(sys.argv[2], d, compressed=True)",
    "spz": "import gsply,sys; d=gsply.plyread(sys.argv[1]); gsply.write_spz(sys.argv[2], d)",
}
HEADINGS = ("format", "by", "MB", "s", "write, s", "least, s", "peak, MB", "PSNR", "median")


# A process begins with the peak of the one it was forked from, and this one is large.
LAUNCH = """
import os, subprocess, sys, time
begin = time.perf_counter()
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.PIPE, stderr=sys.stderr)
said = child.stdout.read().decode()
_, status, used = os.wait4(child.pid, 0)
print(time.perf_counter() - begin, used.ru_maxrss * 1024 / 1e6, said, sep="\\n")
sys.exit(status != 0)
"""


def run(command: list[str]) -> tuple[float, float, str]:
    """Wall seconds, peak MB of a process, and what it says; raises if it fails."""
    launch = [sys.executable, "-S", "-c", LAUNCH, *map(str, command)]
    done = subprocess.run(launch, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{command[0]} failed: {done.stderr}")
    seconds, peak, said = done.stdout.split("\n", 2)
    return float(seconds), float(peak), said


def least(path: Path) -> float:
    """Seconds that no writer of this file can do without."""
    content = path.read_bytes()
    if path.suffix == ".spz":
        planes = gzip.decompress(content)
        begin = time.perf_counter()
        zlib.compress(planes, 6)
    else:
        begin = time.perf_counter()
        with path.with_name("least").open("wb") as out:
            out.write(content)
    return time.perf_counter() - begin


def pictures(scene, path: Path, turn: bool) -> tuple[float, float]:
    """PSNR at worst and median; ``turn``: the file keeps a PLY's axes where RUB is right."""
    import numpy as np

    from tsplat import load_scene
    from tsplat.io.turn import Turn
    from tsplat.quality.converted import picture_errors, standard_views

    back = load_scene(path, sh_float32=True)
    if turn:
        rub = Turn(np.diag([1.0, -1, -1]))
        back = replace(
            back, means=rub.means(back.means), quats=rub.quats(back.quats), sh=rub.sh(back.sh)
        )
    found = [e.psnr for e in picture_errors(scene, back, standard_views(scene, []))]
    return min(found), statistics.median(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--splat-transform", default=shutil.which("splat-transform"))
    parser.add_argument("--niantic")
    parser.add_argument("--runs", type=int, default=3)
    arguments = parser.parse_args()
    from tsplat import load_scene

    source = arguments.scene
    scene = load_scene(source, sh_float32=True)
    print(f"{source.name}: {len(scene):,} Gaussians, SH {scene.sh_degree}")
    print("\t".join(HEADINGS))
    with tempfile.TemporaryDirectory() as folder:
        for fmt in FORMATS:
            out = Path(folder) / f"out.{fmt}"
            ours = [sys.executable, "-m", "tsplat", "convert", str(source), str(out), "--force"]
            tools = {"tsplat": [*ours, "--no-measure", "--json"]}
            if arguments.splat_transform and fmt != "splat":
                tools["splat-transform"] = [
                    arguments.splat_transform, "-q", "-w", str(source), str(out),
                ]  # fmt: skip
            try:
                import gsply  # noqa: F401
            except ImportError:
                pass
            else:
                if fmt in GSPLY:
                    tools["gsply"] = [sys.executable, "-c", GSPLY[fmt], str(source), str(out)]
            if arguments.niantic and fmt == "spz":
                tools["Niantic"] = [arguments.niantic, "write", str(source), str(out), "3"]
            for name, command in tools.items():
                done = [run(command) for _ in range(arguments.runs)]
                seconds, peak = min(d[0] for d in done), max(d[1] for d in done)
                write = None
                if name == "tsplat":
                    write = min(json.loads(d[2])["seconds"]["write"] for d in done)
                turn = fmt == "spz" and name in ("splat-transform", "gsply")
                worst, middle = pictures(scene, out, turn)
                print(
                    fmt, name, f"{out.stat().st_size / 1e6:.1f}", f"{seconds:.2f}",
                    "" if write is None else f"{write:.2f}",
                    f"{least(out):.2f}" if write is not None else "",
                    f"{peak:.0f}", f"{worst:.1f}", f"{middle:.1f}", sep="\t", flush=True,
                )  # fmt: skip


if __name__ == "__main__":
    main()
