"""What a frame costs from the program to the screen, in the terminal this runs in.

    python bench/terminals.py results.json            in each terminal: adds its rows to the file
    python bench/terminals.py --table results.json    the table of all, as Markdown

Frames are of the demo scene, the camera moving, in the pixels of 80x24 cells, and made before
anything is timed. Each presenter that the terminal can show encodes them in this process, as the
viewer does, each with the one before it known; so it does the last one, which then rests, and once
more when nothing has changed. chafa, img2sixel and timg, where they are installed, encode the same
frames into a pty of the same size beforehand; the time each takes for a picture of 8x8 px is
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
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench.presenters import in_pty, make_frames, programs, version
from tsplat.core.types import Frame
from tsplat.plugins import plugins
from tsplat.presenters.base import Presenter, Terminal
from tsplat.terminal import device
from tsplat.terminal.screen import BEGIN_UPDATE, CLEAR, END_UPDATE, HOME, STATUS_REPORT
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
    os.write(1, presenter.clear(terminal) + CLEAR)
    return {
        "encode": 1e3 * statistics.median(encode[1:]),
        "terminal": 1e3 * statistics.median(link[1:]),
        "bytes": statistics.median(sent[1:]),
        "rest": 1e3 * (rested + taken),
        "rest_bytes": len(stays),
        "unchanged": 1e3 * unchanged,
    }


def theirs(
    command: list[str], frames: list[Frame], columns: int, rows: int
) -> dict[str, float] | None:
    """The same of a program; it sends a still frame again, so that is no other."""
    from PIL import Image

    encode, link, sent = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        tiny = Path(folder) / "tiny.ppm"
        Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tiny)
        starting = min(in_pty([*command, str(tiny)], columns, rows)[1] for _ in range(3))
        for n, frame in enumerate(frames):
            path = Path(folder) / f"{n}.ppm"
            Image.fromarray(frame.to_uint8()).save(path)
            data, seconds = in_pty([*command, str(path)], columns, rows + 1)
            encode.append(max(0.0, seconds - starting))
            sent.append(len(data))
            link.append(show(BEGIN_UPDATE + HOME + data + END_UPDATE))
    os.write(1, CLEAR)
    return {
        "encode": 1e3 * statistics.median(encode),
        "terminal": 1e3 * statistics.median(link),
        "bytes": statistics.median(sent),
    }


def measure(file: Path) -> None:
    """Adds the rows of the terminal this runs in."""
    environ = dict(os.environ)
    rows: dict[str, dict[str, float]] = {}
    with ExitStack() as stack:
        saved = stack.enter_context(raw())
        sharing = stack.enter_context(closing(Sharing(environ)))
        heard = device.ask(0, 1, environ, sharing, 2.0)
        found = sharing.shared_by(heard.terminal(environ, device.window_size(1)))
        terminal = replace(found, columns=COLUMNS, rows=ROWS + 1)
        for name, presenter in sorted(plugins().presenters.items(), key=lambda p: -p[1].rank):
            if presenter.unsupported(terminal) is None:
                frames = make_frames(*presenter.size(terminal), FRAMES)
                rows[f"tsplat {name}"] = ours(presenter, frames, terminal)
        frames = make_frames(*terminal.pixels, FRAMES)
        for name, command, _ in programs(COLUMNS, ROWS):
            kind = name.split()[-1] if name.split()[-1] in ("kitty", "iterm2", "sixel") else "sixel"
            if getattr(terminal, kind):
                label = name.replace(command[0], f"{command[0]} {version(command[0])}", 1)
                try:
                    rows[label] = theirs(command, frames, COLUMNS, ROWS) or {}
                except (OSError, TimeoutError) as error:
                    rows[f"{label}: {error}"] = {}
        for command in cells():
            label = f"{command[0]} {version(command[0])} half blocks"
            rows[label] = theirs(command, frames, COLUMNS, ROWS) or {}
        del saved
    kept = json.loads(file.read_text()) if file.exists() else {}
    size = "{}x{} px".format(*terminal.pixels)
    kept[found.name or os.environ.get("TERM", "unknown")] = {"size": size, "rows": rows}
    file.write_text(json.dumps(kept, indent=1))


def cells() -> list[list[str]]:
    """Commands that show pictures in half blocks, of what is installed."""
    chafa = ["chafa", f"--size={COLUMNS}x{ROWS}", "--animate=off", "-f", "symbols", "--symbols"]
    commands = [[*chafa, "vhalf", "--colors=full"], ["timg", f"-g{COLUMNS}x{ROWS + 1}", "-ph"]]
    return [command for command in commands if shutil.which(command[0])]


class raw:  # noqa: N801 - a context manager
    """Raw mode, cursor hidden, alternate screen; all back at the end."""

    def __enter__(self) -> raw:
        import termios

        self._before = termios.tcgetattr(0)
        device.set_raw(0)
        os.write(1, b"\x1b[?1049h\x1b[?25l")
        return self

    def __exit__(self, *_: object) -> None:
        os.write(1, b"\x1b[?25h\x1b[?1049l")
        device.set_attributes(0, self._before)


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
