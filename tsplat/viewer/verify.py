"""Still frames compared with the reference while the viewer goes on.

The float64 reference takes seconds for a frame, so it runs in a process of its own, at low
priority, on a few tiles at a time, and only once the camera has rested. There is never more than
one such round under way.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import time
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Self

from tsplat.core.camera import Camera
from tsplat.core.errors import printable
from tsplat.core.params import RenderParams
from tsplat.core.types import Frame, Scene
from tsplat.testing.compare import flips_allowed
from tsplat.testing.tiles import Still, TilesCompared, cut, tile_count
from tsplat.viewer.breaches import BreachLog

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

REST_SECONDS = 0.5  # the camera's, before a frame is verified
ROUND = 12  # tiles
FRAME_SECONDS = 10.0  # spent on one still frame; then what was seen of it is enough
NICENESS = 19  # the lowest priority there is


def _serve(jobs: Connection, other: Connection, scene: Scene, params: RenderParams) -> None:
    """Answers rounds of tiles until the viewer is gone. The last camera's splats are kept."""
    other.close()  # else the end of the viewer would never be seen
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):  # the terminal is the viewer's
        os.dup2(nowhere, stream)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.nice(NICENESS)
    seen: tuple[Camera, Still] | None = None
    with contextlib.suppress(EOFError, OSError):
        while True:
            camera, tiles = jobs.recv()
            try:
                if seen is None or not seen[0].same(camera):
                    seen = None  # its memory first
                    seen = camera, Still(scene, camera, params)
                answer: TilesCompared | str = seen[1].compare(tiles)
            except Exception as error:
                answer = f"{type(error).__name__}: {printable(error)}"
            jobs.send(answer)


class Worker:
    """The process that compares; a context manager that leaves none behind.

    It is forked, so that it shares the scene's memory. Make it before a backend starts threads.
    """

    def __init__(self, scene: Scene, params: RenderParams) -> None:
        import multiprocessing

        context = multiprocessing.get_context("fork")
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, self.pipe, scene, params), daemon=True
        )
        self._process.start()
        theirs.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.kill()  # whatever it is at
        self._process.join()
        self.pipe.close()


@dataclass(eq=False)
class _Shown:
    """A frame on the screen, and how far it was verified."""

    camera: Camera
    frame: Frame
    since: float  # s, monotonic
    tiles: list[int]  # still to come
    spent: float = 0.0  # s
    flips: int = 0


@dataclass(eq=False)
class Verifier:
    """What to verify next, and what was found; all in the viewer's own thread, none of it slow."""

    worker: Worker
    log: BreachLog
    tiles: int = 0  # compared so far
    flips: int = 0  # pixels in them that differ and sit on a threshold
    max_error: float = 0.0
    broken: int = 0  # frames that broke the contract
    failure: str = ""  # why nothing more is verified
    _shown: _Shown | None = None
    _asked: tuple[_Shown, float] | None = None  # a round under way, and when it began
    _random: random.Random = field(default_factory=random.Random)

    def fileno(self) -> int:
        """The descriptor that can be read when :meth:`receive` has something to take."""
        return self.worker.pipe.fileno()

    def show(self, camera: Camera, frame: Frame) -> None:
        """``frame``, as ``camera`` took it, is on the screen; it stays as it is until the next."""
        if self._shown is not None and self._shown.camera.same(camera):
            self._shown.frame = frame
            return
        tiles = list(range(tile_count(frame.width, frame.height)))
        self._random.shuffle(tiles)
        self._shown = _Shown(camera, frame, time.monotonic(), tiles)

    def wait(self) -> float | None:
        """Seconds until :meth:`step` has something to do; None if it waits for something else."""
        shown = self._shown
        if self.failure or self._asked or shown is None or not shown.tiles:
            return None
        return max(0.0, shown.since + REST_SECONDS - time.monotonic())

    def step(self) -> None:
        """Asks for the next round, if it is time."""
        shown = self._shown
        if self.wait() != 0.0 or shown is None:
            return
        chosen, shown.tiles = shown.tiles[:ROUND], shown.tiles[ROUND:]
        self._asked = shown, time.monotonic()
        try:
            self.worker.pipe.send((shown.camera, {tile: cut(shown.frame, tile) for tile in chosen}))
        except OSError:
            self._fail("its process has ended")

    def receive(self) -> None:
        """Takes the answer to the round under way."""
        try:
            answer: TilesCompared | str = self.worker.pipe.recv()
        except (EOFError, OSError):
            answer = "its process has ended"
        if isinstance(answer, str) or self._asked is None:
            self._fail(str(answer))
            return
        (shown, began), self._asked = self._asked, None
        shown.spent += time.monotonic() - began
        shown.flips += answer.flips
        self.tiles += answer.tiles
        self.flips += answer.flips
        self.max_error = max(self.max_error, answer.max_error)
        faults, allowed = answer.faults, flips_allowed(shown.frame.width * shown.frame.height)
        if shown.flips > allowed:
            faults += (f"{shown.flips} pixels flipped on a threshold; at most {allowed} may",)
        if faults:
            self.broken += 1
            self.log.add(shown.camera, faults)
        if faults or shown.spent > FRAME_SECONDS:
            shown.tiles = []

    def _fail(self, reason: str) -> None:
        self.failure, self._asked = reason, None

    @property
    def text(self) -> str:
        """For the status line."""
        crossings = "1 crossing" if self.flips == 1 else f"{self.flips} crossings"
        found = f"{self.tiles} tiles: max {self.max_error:.1e}, {crossings}"
        if self.broken:
            return f"CONTRACT BROKEN, {found}"
        if self.failure:
            return f"not verified: {self.failure}"
        if self.tiles:
            return f"verified {found}"
        return "verifying" if self._asked else ""
