"""What it costs to show a frame: ms, bytes and PSNR of each graphics presenter and of its peers.

    python bench/presenters.py [--size 640x360] [--frames 12] [--markdown]

Frames are of the demo scene, the camera moving, made before anything is timed. A presenter is
called in this process, as the viewer does. chafa, img2sixel and timg, where they are installed, are
programs: they read the frame as a PPM file and write to a pty of the right size; the time that each
takes for a picture of 8x8 px is subtracted, so that starting and loading is not counted. Times are
the least over the frames, bytes the median. All bytes are decoded again (tsplat.testing.decoders,
Pillow) and compared with the frame at 8 bits; a picture of another size is scaled to the frame's
first, and its own size is given after a ~.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import io
import os
import pty
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
from base64 import b64decode
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tsplat.core.errors import TsplatError
from tsplat.core.types import U8, Frame
from tsplat.demo import demo_scene
from tsplat.plan import make_plan
from tsplat.presenters.base import Shared, Terminal
from tsplat.presenters.iterm2 import ITERM2
from tsplat.presenters.kitty import KITTY
from tsplat.presenters.sixel import SIXEL
from tsplat.terminal.sharing import Sharing
from tsplat.testing import decoders
from tsplat.views import FOV, frame_orbit

CELL = 10, 20  # px
PASSED = re.compile(rb"\x1bPtmux;((?:[^\x1b]|\x1b\x1b)*)\x1b\\")


@dataclass
class Row:
    """A line of the table."""

    name: str
    moving: float  # ms, the least
    still: float  # ms to find that nothing changed; nan: sends it again
    size: float  # bytes a moving frame, median
    psnr: float  # dB, least; inf: exact
    note: str = ""


def make_frames(width: int, height: int, count: int) -> list[Frame]:
    """The demo scene from ``count`` places of an orbit."""
    scene = demo_scene()
    plan = make_plan(scene)
    orbit = frame_orbit(scene, width, height)
    frames = []
    for n in range(count):
        camera = replace(orbit, yaw=orbit.yaw + 0.02 * n).camera(FOV, width, height)
        frames.append(plan.run(scene, camera).frame.over((0.0, 0.0, 0.0)))
    return frames


def psnr(a: U8, b: U8) -> float:
    """dB; inf if equal."""
    squared = float(((a.astype(np.float64) - b) ** 2).mean())
    return float("inf") if squared == 0 else 10 * float(np.log10(255**2 / squared))


def compared(picture: U8, frame: Frame) -> tuple[float, str]:
    """PSNR against the frame, and "~" if the picture had to be scaled."""
    wanted = frame.to_uint8()
    if picture.shape == wanted.shape:
        return psnr(picture, wanted), ""
    from PIL import Image

    scaled = Image.fromarray(picture).resize((frame.width, frame.height), Image.Resampling.BICUBIC)
    return psnr(np.asarray(scaled), wanted), f"~ {picture.shape[1]}x{picture.shape[0]}"


# --- ours


def ours(frames: list[Frame], terminal: Terminal, sharing: Sharing) -> list[Row]:
    """Each of the built-in graphics presenters, in each of its ways."""
    taken: dict[bytes, bytes] = {}

    def share(data: object) -> Shared | None:
        return sharing.put("s", data)  # type: ignore[arg-type]

    def read(medium: str, name: bytes) -> bytes | None:
        path = Path("/dev/shm" + name.decode())
        if path.exists():
            taken[name] = path.read_bytes()
        return taken.get(name)

    def kitty(data: bytes, terminal: Terminal) -> U8:
        return decoders.kitty(data, terminal, read).picture

    def past_tmux(data: bytes, terminal: Terminal) -> U8:
        plain = b"".join(m[1].replace(b"\x1b\x1b", b"\x1b") for m in PASSED.finditer(data))
        return kitty(plain.replace(b"U=1,", b"C=1,"), terminal)

    shared = replace(terminal, share=share)
    ways = [
        ("kitty, shared memory", KITTY, shared, kitty),
        ("kitty, PNG in the sequence", KITTY, terminal, kitty),
        ("kitty past tmux, shared memory", KITTY, replace(shared, multiplexer="tmux"), past_tmux),
        ("iterm2", ITERM2, terminal, lambda d, t: decoders.iterm2(d, t).picture),
        ("iterm2 over ssh", ITERM2, replace(terminal, remote=True),
         lambda d, t: decoders.iterm2(d, t).picture),
        ("sixel", SIXEL, terminal, lambda d, t: decoders.sixel(d, t).picture),
    ]  # fmt: skip
    rows = []
    for name, presenter, screen, decode in ways:
        before: Frame | None = None
        times, sizes, still, worst, note = [], [], [], float("inf"), ""
        for frame in frames:
            begun = time.perf_counter()
            data = presenter.encode(frame, screen, before)
            times.append(time.perf_counter() - begun)
            sizes.append(len(data))
            before = Frame(frame.rgb.copy(), frame.transmittance.copy())
            begun = time.perf_counter()
            assert presenter.encode(frame, screen, before) == b""
            still.append(time.perf_counter() - begun)
            found, note = compared(decode(data, screen), frame)
            worst = min(worst, found)
        rows.append(
            Row(f"tsplat {name}", 1e3 * min(times), 1e3 * min(still),
                float(np.median(sizes)), worst, note)
        )  # fmt: skip
    return rows


# --- programs


def in_pty(command: list[str], columns: int, rows: int) -> tuple[bytes, float]:
    """What ``command`` writes to a terminal of that many cells, and the seconds it takes."""
    master, slave = pty.openpty()
    size = struct.pack("4H", rows, columns, columns * CELL[0], rows * CELL[1])
    fcntl.ioctl(slave, termios.TIOCSWINSZ, size)
    attributes = termios.tcgetattr(slave)
    attributes[1] &= ~termios.OPOST
    termios.tcsetattr(slave, termios.TCSANOW, attributes)
    output: list[bytes] = []

    def gather() -> None:
        while True:
            try:
                data = os.read(master, 1 << 16)
            except OSError:
                return
            if not data:
                return
            output.append(data)

    reader = threading.Thread(target=gather)
    reader.start()
    begun = time.perf_counter()
    subprocess.run(
        command, stdin=subprocess.DEVNULL, stdout=slave, stderr=subprocess.DEVNULL, check=True,
        timeout=60, env={**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"},
    )  # fmt: skip
    seconds = time.perf_counter() - begun
    os.close(slave)
    reader.join()
    os.close(master)
    return b"".join(output), seconds


def kitty_picture(data: bytes, terminal: Terminal) -> U8:
    """The last picture transmitted, whatever else is broken."""
    keys: dict[str, str] = {}
    payload = b""
    for control, chunk in re.findall(rb"\x1b_G([^;\x1b]*)(?:;([^\x1b]*))?\x1b", data):
        pairs = dict(pair.split("=") for pair in control.decode().split(",") if "=" in pair)
        if pairs.get("a") in ("T", "t") or "s" in pairs:
            keys, payload = pairs, b""
        payload += b64decode(chunk)  # chafa pads each chunk, and the first has none
    if keys.get("f") == "100":
        return file_picture(payload)
    if keys.get("o") == "z":
        import zlib

        payload = zlib.decompress(payload)
    channels = 3 if keys.get("f") == "24" else 4
    pixels = np.frombuffer(payload, np.uint8).reshape(int(keys["v"]), int(keys["s"]), channels)
    return pixels[..., :3]


def file_picture(file: bytes) -> U8:
    """Any file that Pillow reads."""
    from PIL import Image

    with Image.open(io.BytesIO(file)) as picture:
        return np.asarray(picture.convert("RGB"))


def iterm2_picture(data: bytes, terminal: Terminal) -> U8:
    """The picture in the OSC 1337."""
    match = re.search(rb"\x1b\]1337;File=[^:]*:([^\x07\x1b]*)", data)
    if match is None:
        raise ValueError("no OSC 1337 File=")
    return file_picture(b64decode(match[1]))


def sixel_picture(data: bytes, terminal: Terminal) -> U8:
    """The first sixel picture."""
    match = re.search(rb"\x1bP[0-9;]*q[^\x1b]*\x1b\\", data)
    if match is None:
        raise ValueError("no sixel")
    return decoders.sixel(match[0], replace(terminal, columns=999, rows=999)).picture


def programs(columns: int, rows: int) -> list[tuple[str, list[str], Callable[..., U8]]]:
    """(name, command without the file, decoder) of what is installed."""
    chafa = ["chafa", f"--size={columns}x{rows}", "--animate=off"]
    timg = ["timg", f"-g{columns}x{rows + 1}"]
    return [
        (name, command, decode)
        for name, command, decode in (
            ("chafa kitty", [*chafa, "-f", "kitty"], kitty_picture),
            ("chafa iterm2", [*chafa, "-f", "iterm"], iterm2_picture),
            ("chafa sixel", [*chafa, "-f", "sixel"], sixel_picture),
            ("img2sixel", ["img2sixel"], sixel_picture),
            ("img2sixel, no diffusion", ["img2sixel", "-d", "none"], sixel_picture),
            ("timg kitty", [*timg, "-pk"], kitty_picture),
            ("timg iterm2", [*timg, "-pi"], iterm2_picture),
        )
        if shutil.which(command[0])
    ]


def version(program: str) -> str:
    """Its version number."""
    said = subprocess.run([program, "--version"], capture_output=True, text=True, check=False)
    match = re.search(r"[0-9]+\.[0-9]+(\.[0-9]+)?", said.stdout + said.stderr)
    return match[0] if match else ""


def peers(frames: list[Frame], terminal: Terminal) -> list[Row]:
    """chafa, libsixel and timg."""
    from PIL import Image

    rows = []
    columns, lines = frames[0].width // CELL[0], frames[0].height // CELL[1]
    with tempfile.TemporaryDirectory() as folder:
        tiny = Path(folder) / "tiny.ppm"
        Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tiny)
        for name, command, decode in programs(columns, lines):
            label = name.replace(command[0], f"{command[0]} {version(command[0])}", 1)
            times, sizes, worst, note = [], [], float("inf"), ""
            try:
                starting = min(in_pty([*command, str(tiny)], columns, lines)[1] for _ in range(5))
                for n, frame in enumerate(frames):
                    path = Path(folder) / f"{n}.ppm"
                    Image.fromarray(frame.to_uint8()).save(path)
                    data, seconds = in_pty([*command, str(path)], columns, lines + 1)
                    times.append(seconds - starting)
                    sizes.append(len(data))
                    found, note = compared(decode(data, terminal), frame)
                    worst = min(worst, found)
            except (OSError, ValueError, IndexError, TsplatError, subprocess.SubprocessError) as e:
                note = f"{type(e).__name__}: {str(e)[:60]}"
                if not times:
                    rows.append(Row(label, float("nan"), float("nan"), float("nan"), 0.0, note))
                    continue
            rows.append(
                Row(label, 1e3 * min(times), float("nan"), float(np.median(sizes)),
                    worst, note)
            )  # fmt: skip
    return rows


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--markdown", action="store_true", help="a table for docs/terminals.md")
    arguments = parser.parse_args()
    width, height = (int(n) for n in arguments.size.split("x"))
    terminal = Terminal(
        columns=-(-width // CELL[0]), rows=-(-height // CELL[1]) + 2, cell_width=CELL[0],
        cell_height=CELL[1], kitty=True, iterm2=True, sixel=True, sixel_registers=256,
        placeholders=True,
    )  # fmt: skip
    frames = make_frames(width, height, arguments.frames)
    with contextlib.closing(Sharing({})) as sharing:
        rows = ours(frames, terminal, sharing)
    rows += peers(frames, terminal)
    if arguments.markdown:
        print(f"| {width}x{height} | ms a frame | kB a frame | PSNR, dB | ms when still |")
        print("|---|--:|--:|--:|--:|")
    for row in rows:
        exact = "exact" if row.psnr == float("inf") else f"{row.psnr:.1f}"
        still = "" if np.isnan(row.still) else f"{row.still:.1f}"
        moving = f"{row.moving:.1f}" if row.moving > 0 else "lost in starting"
        cells = [
            row.name,
            moving,
            f"{row.size / 1e3:.1f}",
            f"{exact} {row.note}",
            still,
        ]
        if arguments.markdown:
            print(f"| {' | '.join(cell.strip() for cell in cells)} |")
        else:
            print(f"{cells[0]:38}{cells[1]:>8} ms{cells[2]:>9} kB  {cells[3]:>8} dB  {cells[4]}")


if __name__ == "__main__":
    main()
