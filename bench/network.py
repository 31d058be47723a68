"""Two network namespaces and a slow link between them, made of what the kernel offers.

With netem (tc-netem(8)): a veth pair, half the delay on each side, the rate and a queue of
``QUEUE`` packets on the side that sends pictures. Without it: two TUN devices
(https://docs.kernel.org/networking/tuntap.html) and a thread here that carries the packets from
one to the other with the same rate, delay and queue. TCP is the kernel's in both.
"""

from __future__ import annotations

import contextlib
import fcntl
import heapq
import os
import select
import shutil
import struct
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count

QUEUE = 50  # packets of 1500 bytes: 0.6 s at 1 Mbit/s, as modems have; more are dropped
MTU = 1500
ADDRESSES = "10.199.77.1", "10.199.77.2"  # of the side that sends pictures, of the other
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
TUN = "/dev/net/tun"


class NoNetworkError(Exception):
    """Why there is no link."""


@dataclass(frozen=True)
class Ends:
    """A link that is up: its two namespaces, and how it is made."""

    sender: str
    receiver: str
    kind: str  # netem or tun

    def inside(self, namespace: str, command: Sequence[str]) -> list[str]:
        """``command`` as one to be run in ``namespace``."""
        return ["ip", "netns", "exec", namespace, *command]


def _run(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        raise NoNetworkError(f"`{' '.join(words)}`: {done.stderr.strip()}")


@contextlib.contextmanager
def network(rate: float, delay: float, kind: str = "auto") -> Iterator[Ends]:
    """A link of ``rate`` bits/s and ``delay`` s there and back; gone again at the end.

    Raises:
        NoNetworkError: not root, a program or the kernel's part of it is missing.
    """
    missing = [name for name in ("ip", "tc") if shutil.which(name) is None]
    if os.geteuid() or missing:
        wants = f"{' and '.join(missing)} (iproute2)" if missing else "root"
        raise NoNetworkError(f"network namespaces need {wants}")
    names = [f"tsplat-{os.getpid()}-{side}" for side in ("a", "b")]
    with contextlib.ExitStack() as stack:
        for name in names:
            _run("ip", "netns", "add", name)
            stack.callback(_run, "ip", "netns", "del", name)
        if kind in ("auto", "netem"):
            try:
                _netem(names, rate, delay)
                yield Ends(*names, "netem")
                return
            except NoNetworkError:
                if kind == "netem":
                    raise
        stack.enter_context(_tun(names, rate, delay))
        yield Ends(*names, "tun")


def _up(namespace: str, device: str, address: str, more: Sequence[str] = ()) -> None:
    inside = "ip", "-n", namespace
    _run(*inside, "addr", "add", f"{address}/30", "dev", device, *more)
    _run(*inside, "link", "set", device, "up")


def _netem(names: Sequence[str], rate: float, delay: float) -> None:
    devices = [f"ts{os.getpid()}{side}" for side in "ab"]
    pair = ["ip", "link", "add", devices[0], "netns", names[0], "type", "veth"]
    _run(*pair, "peer", "name", devices[1], "netns", names[1])
    half = f"{delay * 500:.3f}ms"
    limits = ["rate", f"{rate:.0f}bit", "limit", str(QUEUE)], []
    try:
        for name, device, limit in zip(names, devices, limits, strict=True):
            qdisc = "tc", "-n", name, "qdisc", "add", "dev", device, "root"
            _run(*qdisc, "netem", "delay", half, *limit)
    except NoNetworkError:
        _run("ip", "-n", names[0], "link", "del", devices[0])
        raise
    for name, device, address in zip(names, devices, ADDRESSES, strict=True):
        _up(name, device, address)


@dataclass
class _Way:
    """One direction of the link: a queue, a bottleneck, a delay."""

    rate: float  # bits/s
    delay: float  # s
    free_at: float = 0.0  # s, monotonic: when the bottleneck has sent all it has
    dropped: int = 0

    def due(self, packet: bytes, now: float) -> float | None:
        """When ``packet`` arrives; None: the queue is full."""
        if (self.free_at - now) * self.rate > QUEUE * MTU * 8:
            self.dropped += 1
            return None
        self.free_at = max(now, self.free_at) + len(packet) * 8 / self.rate
        return self.free_at + self.delay


@contextlib.contextmanager
def _tun(names: Sequence[str], rate: float, delay: float) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        tuns = []
        for side, name, address in zip("ab", names, ADDRESSES, strict=True):
            device = f"ts{os.getpid()}{side}"
            try:
                tun = os.open(TUN, os.O_RDWR | os.O_NONBLOCK)
                stack.callback(os.close, tun)
                request = struct.pack("16sH22x", device.encode(), IFF_TUN | IFF_NO_PI)
                fcntl.ioctl(tun, TUNSETIFF, request)
            except OSError as error:
                raise NoNetworkError(f"{TUN}: {error.strerror}") from error
            _run("ip", "link", "set", device, "netns", name)
            _up(name, device, address)
            tuns.append(tun)
        stop = threading.Event()
        ways = _Way(rate, delay / 2), _Way(1e9, delay / 2)
        carrier = threading.Thread(target=_carry, args=(tuns, ways, stop))
        carrier.start()
        stack.callback(carrier.join)
        stack.callback(stop.set)
        yield


def _carry(tuns: Sequence[int], ways: Sequence[_Way], stop: threading.Event) -> None:
    """Packets from each device to the other, when they are due."""
    due: list[tuple[float, int, int, bytes]] = []
    order = count()
    while not stop.is_set():
        wait = min(max(due[0][0] - time.monotonic(), 0.0), 0.1) if due else 0.1
        for tun in select.select(tuns, [], [], wait)[0]:
            side = tuns.index(tun)
            with contextlib.suppress(BlockingIOError):
                while True:
                    packet = os.read(tun, 2 * MTU)
                    at = ways[side].due(packet, time.monotonic())
                    if at is not None:
                        heapq.heappush(due, (at, next(order), tuns[1 - side], packet))
        while due and due[0][0] <= time.monotonic():
            _, _, tun, packet = heapq.heappop(due)
            with contextlib.suppress(OSError):
                os.write(tun, packet)
