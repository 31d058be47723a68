"""The viewer over a slow link: how long a key takes to a picture, for each presenter.

    python bench/link.py [--rate 1] [--delay 100] [--presenters kitty,sixel] [--markdown] [--json F]

Two network namespaces, a link of so many Mbit/s and ms there and back between them (network.py;
root). In the one `tsplat view` runs in a pty of 100x34 cells of 10x20 px, and a relay, standing in
for sshd, carries the pty over TCP. In the other a terminal answers questions and status reports
when it has read everything before them, and types keys:

- 20 taps, a quarter of them when the picture is there in full, the others at any time before;
- a key held down, repeated 30 times a second.

The program's own pictures are marked (an OSC that terminals ignore) with the number of keys that
had been heard when the picture was begun, and its level: a key is shown by the first picture whose
mark counts it, and shown when the terminal has read that picture's end. What was in transit when a
key was pressed is what the relay had taken and the terminal had not got, in bytes. All in one
machine, so one clock.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import json
import os
import pty
import random
import re
import select
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import termios
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from network import ADDRESSES, QUEUE, NoNetworkError, network

ROOT = Path(__file__).resolve().parents[1]
COLUMNS, ROWS = 100, 34
CELL = 10, 20  # px
PORT = 7777
PRESENTERS = "kitty", "iterm2", "sixel", "halfblock", "blocks", "braille"
REPEAT = 1 / 30  # s, of a key held down
TAPS = 20
FULL_TAPS = 5  # of them, when the picture is there in full
HOLD_SECONDS = 6.0
SETTLED = 1.0  # s of silence after which nothing more is to come
IDLE_SECONDS = 2.0  # that nothing may be sent in, at the end
LOST_SECONDS = 60.0  # for anything to happen

MARK = re.compile(rb"\x1b\]7771;(\d+);(\d+);(\d+)\x07")
WORDS = re.compile(
    rb"(?P<report>\x1b\[5n)|(?P<da1>\x1b\[c)|(?P<version>\x1b\[>q)|(?P<mode>\x1b\[\?(\d+)\$p)"
    rb"|(?P<area>\x1b\[14t)|(?P<cell>\x1b\[16t)|(?P<kitty>\x1b_Gi=(\d+),[^;\x1b]*a=q[^;\x1b]*;)"
    rb"|(?P<keys>\x1b\[\?u)"
    rb"|(?P<registers>\x1b\[\?1;1;0S)|(?P<largest>\x1b\[\?2;4;0S)"
    rb"|(?P<mark>\x1b\]7771;(\d+);(\d+);(\d+)\x07)"
)


# --- the program, its pictures marked


def run_viewer(words: Sequence[str]) -> int:
    """`tsplat view`, marking each picture with the keys heard before it was begun and its level."""
    from dataclasses import replace

    from tsplat import cli
    from tsplat.viewer import loop
    from tsplat.viewer.loop import Viewer

    heard: list[float] = []  # when
    hear, encode = Viewer._hear, loop.encode

    def marked_hear(self: Viewer, event: object) -> None:
        hear(self, event)  # type: ignore[arg-type]
        if getattr(event, "kind", "") == "key":
            heard.append(time.monotonic())

    def marked_encode(drawn: object, before: object) -> object:
        encoded = encode(drawn, before)  # type: ignore[arg-type]
        picture = drawn.picture  # type: ignore[attr-defined]
        keys = bisect_right(heard, picture.begun)
        mark = b"\x1b]7771;%d;%d;%d\x07" % (keys, picture.level, len(encoded.payload))
        return replace(encoded, payload=encoded.payload + mark)

    Viewer._hear = marked_hear  # type: ignore[method-assign]
    loop.encode = marked_encode  # type: ignore[assignment]
    return cli.main(["view", *words])


# --- the relay beside the program


def run_relay(log: Path, command: Sequence[str]) -> int:
    """Serves one connection with ``command`` in a pty. Writes when it took how many bytes."""
    listener = socket.create_server((ADDRESSES[0], PORT))
    print("listening", flush=True)
    connection, _ = listener.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    pid, master = pty.fork()
    if pid == 0:
        size = struct.pack("4H", ROWS, COLUMNS, COLUMNS * CELL[0], ROWS * CELL[1])
        fcntl.ioctl(0, termios.TIOCSWINSZ, size)
        os.execvp(command[0], command)
    taken: list[tuple[float, int]] = []
    total = 0
    with contextlib.suppress(OSError):  # EIO: the program has ended
        while True:
            for ready in select.select([connection, master], [], [])[0]:
                if ready is connection:
                    data = connection.recv(1 << 16)
                    if not data:
                        os.kill(pid, signal.SIGHUP)
                    os.write(master, data)
                else:
                    data = os.read(master, 1 << 14)
                    total += len(data)
                    taken.append((time.monotonic(), total))
                    connection.sendall(data)
    connection.close()
    log.write_text(json.dumps(taken))
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


# --- the terminal at the other end


@dataclass(frozen=True)
class Shown:
    """A picture, read to its end."""

    at: float  # s, monotonic
    keys: int  # heard when it was begun
    level: int
    payload: int  # bytes; 0: nothing had changed


@dataclass
class Terminal:
    """Answers as a terminal does that has everything; notes when what came."""

    connection: socket.socket
    kitty: bool
    began: float | None = None  # when the first byte came
    total: int = 0  # bytes
    last: float = 0.0  # when bytes came
    pictures: list[Shown] = field(default_factory=list)
    received: list[tuple[float, int]] = field(default_factory=list)
    presses: list[float] = field(default_factory=list)  # the nth key's is [n - 1]
    ended: bool = False
    _tail: bytes = b""
    _marks: list[tuple[int, int, int]] = field(default_factory=list)

    def pump(self, done: Callable[[], bool], seconds: float = LOST_SECONDS) -> bool:
        """Reads and answers until ``done()``; False if it is not after so long."""
        deadline = time.monotonic() + seconds
        while not done() and not self.ended:
            left = min(deadline - time.monotonic(), 0.005)
            if left <= 0:
                return False
            if select.select([self.connection], [], [], left)[0]:
                self._read()
        return True

    def wait(self, seconds: float) -> None:
        """So long."""
        self.pump(lambda: False, seconds)

    def press(self, key: bytes = b"j") -> int:
        """Types ``key``; its number."""
        self.presses.append(time.monotonic())
        self.connection.sendall(key)
        return len(self.presses)

    def shows(self, key: int) -> bool:
        """Whether a picture that has heard that key is there."""
        return bool(self.pictures) and self.pictures[-1].keys >= key

    def settled(self) -> bool:
        """Whether the picture is there in full and nothing has come for a while."""
        full = bool(self.pictures) and self.pictures[-1].level == 0
        return full and time.monotonic() - self.last > SETTLED

    def _read(self) -> None:
        data = self.connection.recv(1 << 16)
        now = time.monotonic()
        self.ended = not data
        self.began = now if self.began is None else self.began
        self.total, self.last = self.total + len(data), now
        self.received.append((now, self.total))
        text, at = self._tail + data, 0
        for word in WORDS.finditer(text):
            at = word.end()
            self._answer(word, now)
        self._tail = text[at:][-64:]

    def _answer(self, word: re.Match[bytes], now: float) -> None:
        kind = word.lastgroup
        answers = {
            "report": b"\x1b[0n",
            "da1": b"\x1b[?62;4;22c",
            "area": b"\x1b[4;%d;%dt" % (ROWS * CELL[1], COLUMNS * CELL[0]),
            "cell": b"\x1b[6;%d;%dt" % (CELL[1], CELL[0]),
            "version": b"\x1bP>|bench(1.0)\x1b\\",
            "registers": b"\x1b[?1;0;256S",
            "largest": b"\x1b[?2;0;4096;4096S",
        }
        if kind == "mark":
            keys, level, payload = map(int, MARK.fullmatch(word.group()).groups())  # type: ignore[union-attr]
            self._marks.append((keys, level, payload))
        elif kind == "mode":
            number = int(word.group("mode")[3:-2])
            self.connection.sendall(b"\x1b[?%d;%d$y" % (number, 2 if number == 2026 else 0))
        elif kind == "kitty" and self.kitty:
            number = int(re.search(rb"i=(\d+)", word.group()).group(1))  # type: ignore[union-attr]
            self.connection.sendall(b"\x1b_Gi=%d;OK\x1b\\" % number)
        elif kind in answers:
            if kind == "report":
                self.pictures += [Shown(now, *mark) for mark in self._marks]
                self._marks.clear()
            self.connection.sendall(answers[kind])


def run_terminal(presenter: str, taps: int, hold: float) -> dict[str, object]:
    """The whole session. Figures in s and bytes."""
    connection = socket.create_connection((ADDRESSES[0], PORT), LOST_SECONDS)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    terminal = Terminal(connection, presenter == "kitty")
    lost = 0

    def wait(done: Callable[[], bool]) -> None:
        nonlocal lost
        lost += not terminal.pump(done)

    wait(lambda: bool(terminal.pictures))
    first = terminal.pictures[0].at - (terminal.began or 0.0) if terminal.pictures else None
    wait(terminal.settled)
    start = terminal.pictures[-1].at - (terminal.began or 0.0)

    rng = random.Random(1)
    tapped, refined = [], []
    for n in range(taps):
        if n % (taps // FULL_TAPS or 1) == 0:
            wait(terminal.settled)
        key = terminal.press()
        tapped.append(key)
        wait(lambda key=key: terminal.shows(key))  # type: ignore[misc]
        terminal.wait(rng.uniform(0.5, 1.5))
    wait(terminal.settled)

    held, begun, before = [], time.monotonic(), terminal.total
    while time.monotonic() < begun + hold:
        held.append(terminal.press())
        terminal.wait(max(0.0, begun + len(held) * REPEAT - time.monotonic()))
    released, moved = time.monotonic(), terminal.total - before
    wait(terminal.settled)
    refined.append(terminal.pictures[-1].at - released)
    steady = begun + 1.0  # by then the level is found
    moving = [p for p in terminal.pictures if steady <= p.at < released and p.payload]
    before = terminal.total
    terminal.wait(IDLE_SECONDS)
    idle = terminal.total - before
    terminal.press(b"q")
    terminal.pump(lambda: terminal.ended, 5.0)

    def delays(keys: Sequence[int]) -> list[float]:
        found = []
        for key in keys:
            shown = [p.at for p in terminal.pictures if p.keys >= key]
            found.append(shown[0] - terminal.presses[key - 1] if shown else LOST_SECONDS)
        return found

    return {
        "presenter": presenter,
        "first": first,
        "full": start,
        "tap": delays(tapped),
        "held": delays([key for key in held if terminal.presses[key - 1] >= steady]),
        "fps": len(moving) / (released - steady),
        "frame": statistics.median(p.payload for p in moving) if moving else 0,
        "level": statistics.median_low([p.level for p in moving]) if moving else None,
        "moved": moved / hold,
        "refined": refined[0],
        "idle": idle,
        "lost": lost,
        "tap_presses": [terminal.presses[key - 1] for key in tapped],
        "held_presses": [t for t in (terminal.presses[k - 1] for k in held) if t >= steady],
        "received": terminal.received,
    }


# --- both, and what is said


def transit(
    taken: list[list[float]], got: list[list[float]], presses: Sequence[float]
) -> list[int]:
    """Bytes that the relay had taken and the terminal not got, when each key was pressed."""

    def at(curve: list[list[float]], when: float) -> int:
        place = bisect_right([point[0] for point in curve], when)
        return int(curve[place - 1][1]) if place else 0

    return [at(taken, when) - at(got, when) for when in presses]


def measure(presenter: str, arguments: argparse.Namespace) -> dict[str, object]:
    """One session over a link of its own."""
    me = [sys.executable, str(Path(__file__).resolve())]
    environment = {
        **{k: v for k, v in os.environ.items() if not k.startswith(("TSPLAT_", "TMUX"))},
        "TERM": "xterm-256color", "COLORTERM": "truecolor", "PYTHONPATH": str(ROOT),
        "SSH_CONNECTION": f"{ADDRESSES[1]} 50000 {ADDRESSES[0]} 22",
    }  # fmt: skip
    view = [*([arguments.scene] if arguments.scene else []), "--presenter", presenter]
    view += arguments.view
    with (
        tempfile.TemporaryDirectory() as folder,
        network(arguments.rate * 1e6, arguments.delay / 1e3, arguments.link) as ends,
    ):
        log = Path(folder) / "taken.json"
        relay = subprocess.Popen(
            ends.inside(ends.sender, [*me, "--role", "relay", "--log", str(log), "--", *view]),
            env=environment, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            assert relay.stdout is not None
            relay.stdout.readline()
            words = ["--presenters", presenter, "--hold", str(arguments.hold)]
            words += ["--taps", str(arguments.taps), "--role", "terminal"]
            said = subprocess.run(
                ends.inside(ends.receiver, [*me, *words]), env=environment, text=True,
                stdout=subprocess.PIPE, check=True,
            ).stdout  # fmt: skip
            code = relay.wait(20)
        finally:
            relay.kill()
            relay.wait()
        row: dict[str, object] = json.loads(said)
        taken = json.loads(log.read_text())
    got = row.pop("received")
    for name in ("tap", "held"):
        presses = row.pop(f"{name}_presses")
        row[f"{name}_transit"] = transit(taken, got, presses)  # type: ignore[arg-type]
    return {**row, "code": code, "link": ends.kind}


HEADINGS = (
    "presenter", "first, s", "full, s", "tap, ms", "held, ms", "in transit, kB", "fps",
    "level", "kB a frame", "refined, s", "idle, B",
)  # fmt: skip


def cells(row: dict[str, object]) -> list[str]:
    """A row of the table; medians, and the worst behind them."""

    def both(values: list[float], unit: float) -> str:
        if not values:
            return ""
        return f"{statistics.median(values) * unit:.0f}, {max(values) * unit:.0f}"

    every = [*row["tap_transit"], *row["held_transit"]]  # type: ignore[misc]
    return [
        str(row["presenter"]), f"{row['first']:.2f}", f"{row['full']:.1f}",
        both(row["tap"], 1e3), both(row["held"], 1e3), both(every, 1e-3),  # type: ignore[arg-type]
        f"{row['fps']:.1f}", str(row["level"]), f"{row['frame'] / 1e3:.1f}",  # type: ignore[operator]
        f"{row['refined']:.1f}", str(row["idle"]),
    ]  # fmt: skip


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rate", type=float, default=1.0, help="Mbit/s towards the terminal")
    parser.add_argument("--delay", type=float, default=100.0, help="ms there and back")
    parser.add_argument("--presenters", default=",".join(PRESENTERS))
    parser.add_argument("--scene", help="a file; the demo scene without")
    parser.add_argument("--taps", type=int, default=TAPS)
    parser.add_argument("--hold", type=float, default=HOLD_SECONDS, help="s that a key is held")
    parser.add_argument("--link", choices=("auto", "netem", "tun"), default="auto")
    parser.add_argument("--json", type=Path, help="all figures into this file")
    parser.add_argument("--markdown", action="store_true", help="the table for a document")
    parser.add_argument("--role", choices=("relay", "terminal", "viewer"), help=argparse.SUPPRESS)
    parser.add_argument("--log", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("view", nargs="*", help="more for `tsplat view`, after --")
    arguments = parser.parse_args(words)
    if arguments.role == "viewer":
        return run_viewer(arguments.view)
    if arguments.role == "relay":
        viewer = [sys.executable, str(Path(__file__).resolve()), "--role", "viewer", "--"]
        return run_relay(arguments.log, [*viewer, *arguments.view])
    if arguments.role == "terminal":
        found = run_terminal(arguments.presenters, arguments.taps, arguments.hold)
        json.dump(found, sys.stdout)
        return 0
    rows = []
    try:
        for presenter in arguments.presenters.split(","):
            rows.append(measure(presenter, arguments))
            if not arguments.markdown:
                print(
                    "  ".join(f"{h}: {c}" for h, c in zip(HEADINGS, cells(rows[-1]), strict=True)),
                    flush=True,
                )
    except NoNetworkError as error:
        print(f"no link: {error}", file=sys.stderr)
        return 1
    if arguments.markdown:
        kind = {"netem": "netem", "tun": "TUN devices, as this kernel has no netem"}
        print(
            f"{arguments.rate:g} Mbit/s, {arguments.delay:g} ms there and back, a queue of "
            f"{QUEUE} packets ({kind[str(rows[0]['link'])]})\n"
        )
        lines = [HEADINGS, ["---"] + ["--:"] * (len(HEADINGS) - 1), *map(cells, rows)]
        print("\n".join(f"| {' | '.join(line)} |" for line in lines))
    if arguments.json:
        settings = {"rate": arguments.rate * 1e6, "delay": arguments.delay / 1e3, "queue": QUEUE}
        arguments.json.write_text(json.dumps({**settings, "rows": rows}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
