"""What a frame costs from the program to the screen, in the terminal this runs in.

    python bench/terminals.py results.json            in each terminal: adds its rows to the file
    python bench/terminals.py --table results.json    the table of all, as Markdown

Frames are of the demo scene, the camera moving, in the pixels of 80x24 cells, and made before
anything is timed. Each presenter that the terminal can show encodes them in this process, as the
viewer does, each with the one before it known; so it does the last one, which then rests, and once
more when nothing has changed. libsixel and libchafa, where they are installed, encode frames of the
same pixels in this process, too; timg is a program, and what it takes for a picture of 8x8 px is
subtracted. What anyone has encoded is written here and followed by a status report: the
terminal's time is from the first byte until its answer. Times and bytes are medians over the
frames.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from libraries import libchafa, libsixel
from presenters import in_pty, make_frames

from tsplat.core.types import U8, Frame
from tsplat.plugins import plugins
from tsplat.presenters.base import Presenter, Terminal, sampling
from tsplat.presenters.enlarge import averaged
from tsplat.terminal import device
from tsplat.terminal.screen import (
    BEGIN_UPDATE,
    END_UPDATE,
    HIDE_CURSOR,
    HOME,
    SHOW_CURSOR,
    STATUS_REPORT,
)
from tsplat.terminal.sharing import Sharing

COLUMNS, ROWS = 80, 24
FRAMES = 10
ANSWER = b"\x1b[0n"
PATIENCE = 20.0  # s


def show(data: bytes) -> float:
    """Seconds until the terminal has taken ``data``: until it answers the report behind it."""
    begun, heard, rest = time.perf_counter(), b"", memoryview(data + STATUS_REPORT)
    while ANSWER not in heard:
        readable, writable, _ = select.select([0], [1] if rest else [], [], PATIENCE)
        if not readable and not writable:
            raise TimeoutError("the terminal does not answer")
        if writable:
            rest = rest[os.write(1, rest[:4096]) :]
        if readable:
            heard += os.read(0, 65536)
    return time.perf_counter() - begun


def timed(work: Any, *arguments: Any) -> tuple[bytes, float]:
    """What ``work`` returns, and the seconds it took."""
    begun = time.perf_counter()
    data = work(*arguments)
    return data, time.perf_counter() - begun


def ours(presenter: Presenter, frames: list[Frame], terminal: Terminal) -> dict[str, float]:
    """Ms and bytes of a presenter's frames, moving and still."""
    before: Frame | None = None
    encode, link, sent = [], [], []
    for frame in frames:
        data, seconds = timed(presenter.encode, frame, terminal, before)
        encode.append(seconds)
        link.append(show(BEGIN_UPDATE + HOME + data + END_UPDATE))
        sent.append(len(data))
        before = Frame(frame.rgb.copy(), frame.transmittance.copy())
    rest = presenter.rest or (lambda frame, terminal: presenter.encode(frame, terminal, None))
    stays, rested = timed(rest, before, terminal)
    taken = show(BEGIN_UPDATE + HOME + stays + END_UPDATE)
    same, unchanged = timed(presenter.encode, before, terminal, before)
    assert not same, "a frame that has not changed takes no bytes"
    os.write(1, presenter.clear(terminal) + device.cleared(terminal))
    return {
        "encode": 1e3 * statistics.median(encode[1:]),
        "terminal": 1e3 * statistics.median(link[1:]),
        "bytes": statistics.median(sent[1:]),
        "rest": 1e3 * (rested + taken),
        "rest_bytes": len(stays),
        "unchanged": 1e3 * unchanged,
    }


def theirs(
    encode: Callable[[Frame], tuple[bytes, float]], frames: list[Frame], terminal: Terminal
) -> dict[str, float]:
    """The same of another; it sends a still frame again, so that is no other."""
    times, link, sent = [], [], []
    for frame in frames:
        data, seconds = encode(frame)
        times.append(seconds)
        sent.append(len(data))
        link.append(show(BEGIN_UPDATE + HOME + data + END_UPDATE))
    os.write(1, device.cleared(terminal))
    return {
        "encode": 1e3 * statistics.median(times),
        "terminal": 1e3 * statistics.median(link),
        "bytes": statistics.median(sent),
    }


def library(encode: Callable[[U8], bytes]) -> Callable[[Frame], tuple[bytes, float]]:
    """One that takes 8 bits, and is not charged for making them."""
    return lambda frame: timed(encode, frame.to_uint8())


def program(option: str, folder: Path) -> Callable[[Frame], tuple[bytes, float]]:
    """timg, without the time it takes to start."""
    from PIL import Image

    command, picture = ["timg", f"-g{COLUMNS}x{ROWS + 1}", f"-p{option}"], folder / "picture.ppm"
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(picture)
    starting = min(in_pty([*command, str(picture)], COLUMNS, ROWS + 1)[1] for _ in range(5))

    def encode(frame: Frame) -> tuple[bytes, float]:
        Image.fromarray(frame.to_uint8()).save(picture)
        data, seconds = in_pty([*command, str(picture)], COLUMNS, ROWS + 1)
        return data, max(0.0, seconds - starting)

    return encode


def peers(
    terminal: Terminal, folder: Path
) -> Iterator[tuple[str, Callable[[Frame], tuple[bytes, float]]]]:
    """Those that are installed and speak what ``terminal`` takes."""
    cell = round(terminal.cell_width), round(terminal.cell_height)
    found = []
    if terminal.kitty:
        found.append(("libchafa kitty", libchafa("kitty", COLUMNS, ROWS, cell)))
    if terminal.iterm2:
        found.append(("libchafa iterm2", libchafa("iterm2", COLUMNS, ROWS, cell)))
    if terminal.sixel:
        found.append(("libchafa sixel", libchafa("sixel", COLUMNS, ROWS, cell)))
        found += [("libsixel", libsixel()), ("libsixel, no diffusion", libsixel(False))]
    found.append(("libchafa half blocks", libchafa("symbols", COLUMNS, ROWS, cell, "vhalf")))
    for name, encode in found:
        if encode is not None:
            yield name, library(encode)
    if shutil.which("timg"):
        ways = (("k", terminal.kitty), ("i", terminal.iterm2), ("h", True))
        for option, taken in ways:
            if taken:
                yield f"timg -p{option}, the program", program(option, folder)


def measure(file: Path) -> None:
    """Adds the rows of the terminal this runs in."""
    environ = dict(os.environ)
    rows: dict[str, dict[str, float]] = {}
    with ExitStack() as stack:
        stack.enter_context(screen())
        sharing = stack.enter_context(closing(Sharing(environ)))
        heard = device.ask(0, 1, environ, sharing, 2.0)
        found = sharing.shared_by(heard.terminal(environ, device.window_size(1)))
        terminal = replace(found, columns=COLUMNS, rows=ROWS + 1)
        for name, presenter in sorted(plugins().presenters.items(), key=lambda p: -p[1].rank):
            if presenter.unsupported(terminal) is None:
                samples = sampling(presenter, terminal)
                size = (n * samples for n in presenter.size(terminal))
                frames = [averaged(frame, samples) for frame in make_frames(*size, FRAMES)]
                rows[f"tsplat {name}"] = ours(presenter, frames, terminal)
        frames = make_frames(*terminal.pixels, FRAMES)
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        for name, encode in peers(terminal, folder):
            rows[name] = theirs(encode, frames, terminal)
    kept = json.loads(file.read_text()) if file.exists() else {}
    size = "{}x{} px".format(*terminal.pixels)
    kept[found.name or os.environ.get("TERM", "unknown")] = {"size": size, "rows": rows}
    file.write_text(json.dumps(kept, indent=1))


@contextmanager
def screen() -> Iterator[None]:
    """Raw mode, the alternate screen, no cursor; all back at the end."""
    with device.raw_mode(0):
        os.write(1, device.ENTER_ALTERNATE + HIDE_CURSOR)
        try:
            yield
        finally:
            os.write(1, SHOW_CURSOR + device.LEAVE_ALTERNATE)


def table(file: Path) -> None:
    """Prints all rows, terminal by terminal."""
    print("| terminal | | encode, ms | terminal, ms | kB | rests: ms | kB | unchanged, ms |")
    print("|---|---|--:|--:|--:|--:|--:|--:|")
    for name, found in json.loads(file.read_text()).items():
        shown = f"{name}, {found['size']}"
        for row, facts in found["rows"].items():
            if not facts:
                continue
            cells = [f"{facts['encode']:.1f}", f"{facts['terminal']:.1f}"]
            cells.append(f"{facts['bytes'] / 1e3:.1f}")
            if "rest" in facts:
                cells += [f"{facts['rest']:.0f}", f"{facts['rest_bytes'] / 1e3:.1f}"]
                cells.append(f"{facts['unchanged']:.1f}")
            else:
                cells += ["", "", ""]
            print(f"| {shown} | {row} | {' | '.join(cells)} |")
            shown = ""


def main() -> None:
    """One or the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--table", action="store_true", help="print what is in the file")
    arguments = parser.parse_args()
    if arguments.table:
        table(arguments.file)
    elif os.isatty(0) and os.isatty(1):
        measure(arguments.file)
    else:
        sys.exit("bench/terminals.py: run it in a terminal")


if __name__ == "__main__":
    main()
