"""What it costs to show a frame: ms, bytes and PSNR of each presenter and of its peers.

    python bench/presenters.py [--sizes 640x360,1280x720] [--cells 100x28] [--markdown]

Frames are of the demo scene, the camera moving, made before anything is timed. "moving" is a frame
after another one, "few" one of half as many pixels each way shown over the same area, "at rest" one
that stays, "the same" one that is there already. A presenter is called in this process, as the
viewer does; so are libsixel and libchafa, where they are installed. timg is a program: it reads the
frame as a PPM file and writes to a pty of the right size; the time that it takes for a picture of
8x8 px is subtracted, so that starting and loading is not counted. Times are the least over all
frames, bytes the median, PSNR the least. All bytes are decoded again (tsplat.testing.decoders,
Pillow) and compared with the frame at 8 bits; a picture of another size is scaled to the frame's
first, and its own size is given after a ~. "-": this cannot be decoded, or there is no such thing.
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

from libraries import libchafa, libsixel

from tsplat.core.errors import TsplatError
from tsplat.core.types import U8, Frame
from tsplat.demo import demo_scene
from tsplat.plan import make_plan
from tsplat.presenters.base import Presenter, Shared, Terminal
from tsplat.presenters.blocks import BLOCKS
from tsplat.presenters.braille import BRAILLE
from tsplat.presenters.halfblock import HALFBLOCK
from tsplat.presenters.iterm2 import ITERM2
from tsplat.presenters.kitty import KITTY
from tsplat.presenters.letters import LETTERS
from tsplat.presenters.sixel import SIXEL
from tsplat.terminal.sharing import Sharing
from tsplat.testing import decoders
from tsplat.views import FOV, frame_orbit

CELL = 10, 20  # px
PASSED = re.compile(rb"\x1bPtmux;((?:[^\x1b]|\x1b\x1b)*)\x1b\\")
STEP = 0.02  # radians from one frame to the next
REPEATS = 20  # of what is timed, for each frame
STARTS = 5  # of a program, for each frame
NONE = float("nan")

Decode = Callable[[bytes, Terminal], U8]
Way = tuple[str, Presenter, Terminal, Decode]


@dataclass
class Cost:
    """Of one kind of frame."""

    ms: float = NONE
    size: float = NONE  # bytes
    psnr: float = NONE  # dB; inf: exact

    def cells(self) -> list[str]:
        exact = "exact" if self.psnr == float("inf") else _number(self.psnr, "{:.1f}")
        ms = "lost in starting" if self.ms <= 0 else _number(self.ms, "{:.1f}")
        return [ms, _number(self.size / 1e3, "{:.1f}"), exact]


def _number(value: float, form: str) -> str:
    return "-" if np.isnan(value) else form.format(value)


@dataclass
class Row:
    """A line of the table."""

    name: str
    moving: Cost
    few: Cost
    rest: Cost
    same: float = NONE  # ms to find that nothing changed
    note: str = ""


def make_frames(width: int, height: int, count: int) -> list[Frame]:
    """The demo scene from ``count`` places of an orbit, frames of their own."""
    scene = demo_scene()
    plan = make_plan(scene)
    orbit = frame_orbit(scene, width, height)
    frames = []
    for n in range(count):
        camera = replace(orbit, yaw=orbit.yaw + STEP * n).camera(FOV, width, height)
        frame = plan.run(scene, camera).frame.over((0.0, 0.0, 0.0))
        frames.append(Frame(frame.rgb.copy(), frame.transmittance.copy()))
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


def cost(
    encode: Callable[[int], bytes], frames: list[Frame], decode: Callable[[bytes], U8] | None
) -> tuple[Cost, str]:
    """Of ``encode(n)``, which sends frame n; and a note of what the decoder says."""
    times, sizes, worst, note = [], [], float("inf"), ""
    for n, frame in enumerate(frames):
        for _ in range(REPEATS):
            begun = time.perf_counter()
            data = encode(n)
            times.append(time.perf_counter() - begun)
        sizes.append(len(data))
        if decode is None:
            worst = NONE
            continue
        try:
            found, note = compared(decode(data), frame)
            worst = min(worst, found)
        except (OSError, ValueError, IndexError, TsplatError) as error:
            worst, note = NONE, f"{type(error).__name__}: {str(error)[:60]}"
    return Cost(1e3 * min(times), float(np.median(sizes)), worst), note


# --- ours


def presenter_row(way: Way, frames: list[Frame], few: list[Frame]) -> Row:
    """All that a presenter can do."""
    name, presenter, screen, decode = way
    copies = [Frame(frame.rgb.copy(), frame.transmittance.copy()) for frame in frames]

    def decoded(data: bytes) -> U8:
        return decode(data, screen)

    moving, note = cost(lambda n: presenter.encode(frames[n], screen, frames[n - 1]), frames, None)
    alone, note = cost(lambda n: presenter.encode(frames[n], screen, None), frames, decoded)
    moving.psnr = alone.psnr
    same, _ = cost(lambda n: presenter.encode(frames[n], screen, copies[n]), frames, None)
    assert same.size == 0
    coarse, rest = Cost(), Cost()
    if presenter.fill is not None:
        fill = presenter.fill
        coarse, _ = cost(lambda n: fill(few[n], screen, few[n - 1]), few, None)
    if presenter.rest is not None:
        last = presenter.rest
        rest, _ = cost(lambda n: last(frames[n], screen), frames, decoded)
    return Row(f"tsplat {name}", moving, coarse, rest, same.ms, note)


def graphics(terminal: Terminal, sharing: Sharing) -> list[Way]:
    """The built-in graphics presenters, in each of their ways."""
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

    def iterm2(data: bytes, terminal: Terminal) -> U8:
        return decoders.iterm2(data, terminal).picture

    def sixel(data: bytes, terminal: Terminal) -> U8:
        return decoders.sixel(data, terminal).picture

    shared, remote = replace(terminal, share=share), replace(terminal, remote=True)
    tmux = replace(shared, multiplexer="tmux")
    return [
        ("kitty, shared memory", KITTY, shared, kitty),
        ("kitty, PNG in the sequence", KITTY, terminal, kitty),
        ("kitty past tmux, shared memory", KITTY, tmux, past_tmux),
        ("iterm2", ITERM2, terminal, iterm2),
        ("iterm2 over ssh", ITERM2, remote, iterm2),
        ("sixel", SIXEL, terminal, sixel),
        ("sixel over ssh", SIXEL, remote, sixel),
    ]


def characters(terminal: Terminal) -> list[Way]:
    """The built-in presenters that show characters."""
    ways: list[Way] = []
    for presenter, decoder in (
        (HALFBLOCK, decoders.halfblock), (BLOCKS, decoders.blocks),
        (BRAILLE, decoders.braille), (LETTERS, decoders.letters),
    ):  # fmt: skip

        def decode(data: bytes, terminal: Terminal, decoder: decoders.Decoder = decoder) -> U8:
            return decoders.decoded(decoder, data, terminal).picture

        ways.append((presenter.name, presenter, terminal, decode))
    ways.append(("halfblock, 256 colours", HALFBLOCK, replace(terminal, colors=256), ways[0][3]))
    ways.append(("halfblock, 16 colours", HALFBLOCK, replace(terminal, colors=16), ways[0][3]))
    return ways


# --- libraries


def libraries(frames: list[Frame], terminal: Terminal, columns: int, rows: int) -> list[Row]:
    """Those of libsixel and libchafa, whatever was shown before: they know only whole pictures."""
    images = [frame.to_uint8() for frame in frames]
    found = []
    for name, encode, decode in (
        ("libsixel", libsixel(), sixel_picture),
        ("libsixel, no diffusion", libsixel(False), sixel_picture),
        ("libchafa kitty", libchafa("kitty", columns, rows, CELL), kitty_picture),
        ("libchafa iterm2", libchafa("iterm2", columns, rows, CELL), iterm2_picture),
        ("libchafa sixel", libchafa("sixel", columns, rows, CELL), sixel_picture),
    ):
        found.append(_library_row(name, encode, images, frames, decode, terminal))
    return [row for row in found if row is not None]


def chafa_characters(frames: list[Frame], terminal: Terminal, columns: int, rows: int) -> list[Row]:
    """The symbols of libchafa, of the frame that half blocks show."""
    images = [frame.to_uint8() for frame in frames]
    found = []
    for symbols, colors in (("vhalf", 1 << 24), ("vhalf", 256), ("vhalf", 16), ("block", 1 << 24)):
        encode = libchafa("symbols", columns, rows, CELL, symbols, colors)
        name = f"libchafa {symbols}" + ("" if colors > 256 else f", {colors} colours")
        decode = halves_picture if symbols == "vhalf" else None
        screen = replace(terminal, colors=colors)
        found.append(_library_row(name, encode, images, frames, decode, screen))
    return [row for row in found if row is not None]


def _library_row(
    name: str,
    encode: Callable[[U8], bytes] | None,
    images: list[U8],
    frames: list[Frame],
    decode: Decode | None,
    terminal: Terminal,
) -> Row | None:
    if encode is None:
        return None
    decoded = None if decode is None else (lambda data: decode(data, terminal))
    moving, note = cost(lambda n: encode(images[n]), frames, decoded)
    return Row(name, moving, Cost(), Cost(), NONE, note)


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
    raster = re.search(rb'"1;1;(\d+);(\d+)', match[0])
    if raster is None:
        raise ValueError("no raster attributes")
    width, height = int(raster[1]), int(raster[2])
    body = match[0][2:-2].replace(raster[0], b'"1;1;%d;%d' % (2 * width, height + 6))
    percent = decoders.sixel_percent(body, replace(terminal, sixel_max=(0, 0)), [])
    return np.rint(percent[:height, :width].clip(0) * 2.55).astype(np.uint8)


def halves_picture(data: bytes, terminal: Terminal) -> U8:
    """Half blocks; lines end with the last column."""
    return decoders.decoded(decoders.halfblock, data.replace(b"\n", b"\r\n"), terminal).picture


def timg(frames: list[Frame], terminal: Terminal, ways: dict[str, Decode | None]) -> list[Row]:
    """timg, where it is installed, in each of ``ways``: its option -p, and a decoder."""
    from PIL import Image

    if shutil.which("timg") is None:
        return []
    said = subprocess.run(["timg", "--version"], capture_output=True, text=True, check=False)
    version = re.search(r"[0-9]+\.[0-9]+(\.[0-9]+)?", said.stdout + said.stderr)
    rows = []
    columns, lines = terminal.columns, terminal.rows
    with tempfile.TemporaryDirectory() as folder:
        for option, decode in ways.items():
            command = ["timg", f"-g{columns}x{lines}", f"-p{option}"]
            tiny = Path(folder) / "tiny.ppm"
            Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tiny)
            times, sizes, worst, note = [], [], float("inf") if decode else NONE, ""
            starting = min(in_pty([*command, str(tiny)], columns, lines)[1] for _ in range(5))
            for n, frame in enumerate(frames):
                path = Path(folder) / f"{n}.ppm"
                Image.fromarray(frame.to_uint8()).save(path)
                for _ in range(STARTS):
                    data, seconds = in_pty([*command, str(path)], columns, lines)
                    times.append(seconds - starting)
                sizes.append(len(data))
                if decode is not None:
                    found, note = compared(decode(data, terminal), frame)
                    worst = min(worst, found)
            spent = Cost(1e3 * min(times), float(np.median(sizes)), worst)
            name = f"timg {version[0] if version else ''} -p{option}, the program"
            rows.append(Row(name, spent, Cost(), Cost(), NONE, note))
    return rows


# --- the tables


def picture_rows(width: int, height: int, count: int) -> list[Row]:
    """Pictures of ``width`` x ``height`` px."""
    columns, rows = -(-width // CELL[0]), -(-height // CELL[1])
    terminal = Terminal(
        columns=columns, rows=rows + 1, cell_width=CELL[0], cell_height=CELL[1], kitty=True,
        iterm2=True, sixel=True, sixel_registers=256, placeholders=True,
    )  # fmt: skip
    frames, few = make_frames(width, height, count), make_frames(width // 2, height // 2, count)
    with contextlib.closing(Sharing({})) as sharing:
        found = [presenter_row(way, frames, few) for way in graphics(terminal, sharing)]
    found += libraries(frames, terminal, columns, rows)
    return found + timg(frames, terminal, {"k": kitty_picture, "i": iterm2_picture})


def cell_rows(columns: int, rows: int, count: int) -> list[Row]:
    """Characters in so many cells."""
    terminal = Terminal(columns=columns, rows=rows + 1, cell_width=CELL[0], cell_height=CELL[1])
    found = []
    for way in characters(terminal):
        frames = make_frames(*way[1].size(terminal), count)
        found.append(presenter_row(way, frames, []))
    frames = make_frames(*HALFBLOCK.size(terminal), count)
    found += chafa_characters(frames, terminal, columns, rows)
    return found + timg(frames, terminal, {"h": None, "q": None})


def show(title: str, rows: list[Row], markdown: bool) -> None:
    """One table."""
    kinds = ("moving", "few", "rest")
    heads = [
        title,
        "moving: ms",
        "kB",
        "dB",
        "few: ms",
        "kB",
        "at rest: ms",
        "kB",
        "dB",
        "same: ms",
    ]
    lines = []
    for row in rows:
        moving, few, rest = (getattr(row, kind).cells() for kind in kinds)
        moving[2] = f"{moving[2]} {row.note}".strip()
        lines.append([row.name, *moving, *few[:2], *rest, _number(row.same, "{:.1f}")])
    if markdown:
        lines = [["" if cell == "-" else cell for cell in line] for line in lines]
        print(
            "\n".join(f"| {' | '.join(line)} |" for line in (heads, ["---", *["--:"] * 9], *lines))
        )
    else:
        widths = [max(len(line[n]) for line in (heads, *lines)) for n in range(len(heads))]
        for line in (heads, *lines):
            first, *rest = line
            aligned = (cell.rjust(w) for cell, w in zip(rest, widths[1:], strict=True))
            print(first.ljust(widths[0]), *aligned, sep="  ")
    print()


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--sizes", default="640x360,1280x720", help="px; empty for none")
    parser.add_argument("--cells", default="100x28", help="columns and rows; empty for none")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--markdown", action="store_true", help="tables for docs/terminals.md")
    arguments = parser.parse_args()
    for names, make in ((arguments.sizes, picture_rows), (arguments.cells, cell_rows)):
        for name in filter(None, names.split(",")):
            numbers = [int(n) for n in name.split("x")]
            title = name if make is picture_rows else f"{name} cells"
            show(title, make(*numbers, arguments.frames), arguments.markdown)


if __name__ == "__main__":
    main()
