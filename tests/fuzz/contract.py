"""What loading any file at all may do, checked in this process; ``Finding`` is what it may not.

A Scene that is sound, or a SceneError of one printable line that names the file; a second of CPU
time and one more for each MB; 64 MB of memory and four times the file; no warning, no file left
open, no other file opened. A process that checks this ``guard``s itself first.
"""

from __future__ import annotations

import contextlib
import gc
import os
import re
import resource
import signal
import sys
import time
import traceback
import tracemalloc
import warnings
from pathlib import Path

import numpy as np

from tsplat.core.errors import SceneError

SECONDS, SECONDS_A_MB = 1.0, 1.0
ROOM, ROOM_A_BYTE = 64 << 20, 4
TICK, TICKS_MAX = 5, 24
"""A load that waits for something is given up after so many ticks of a clock of so many seconds;
a process that was stopped and goes on hears one."""

LINE_MAX = 700
TELLS = re.compile(
    r"expected|copy|download|write|update|open |damaged|leave it out|leave out|pip install|"
    r"unpack|name |not a scene|formats read|missing|holds no Gaussians|can be drawn|"
    r"a file of Gaussians has|read the file without|in a mesh viewer|apply its transform|wait until"
)
"""What was expected, or what to do: a line has one of these."""


class Finding(Exception):  # noqa: N818 - it is none of the product's
    """Something a file made a reader do that it may not."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(f"{kind}: {text}")
        self.kind = kind


class _TooLong(BaseException):
    """Raised by the clock, through every ``except Exception``."""


class Guard:
    """Watches this process. Make one, load what will be loaded later once, then ``arm``."""

    def __init__(self, folder: Path) -> None:
        """``folder`` is the one place where files may be opened."""
        self._folder = str(folder.resolve())
        self._opened: list[str] = []
        self._armed = self._inside = False
        self._complaints: list[str] = []
        self._free = _lowest_descriptor()
        self.limited = _mapped() < 1 << 40  # a sanitizer maps terabytes of shadow
        warnings.simplefilter("error")
        sys.unraisablehook = lambda fault: self._complaints.append(repr(fault.exc_value))
        sys.addaudithook(self._audit)
        signal.signal(signal.SIGPROF, _late)
        signal.signal(signal.SIGALRM, self._tick)
        self._ticks = 0

    def arm(self) -> None:
        """From now on nothing new is imported, so that every file opened is a file named."""
        self._armed = True
        gc.collect()
        self._free = _lowest_descriptor()

    def _audit(self, event: str, args: tuple) -> None:
        if not (self._armed and self._inside):
            return
        if event == "open" and isinstance(args[0], str | bytes):
            name = os.path.abspath(os.fsdecode(args[0]))  # noqa: PTH100 - a Path takes longer
            writes = isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR)
            if writes or not name.startswith(self._folder + "/"):
                self._opened.append(name)
        elif event.startswith(("os.system", "subprocess", "socket", "os.exec", "os.remove")):
            self._opened.append(event)

    def _tick(self, signum: int, frame: object) -> None:
        self._ticks += 1
        if self._ticks >= TICKS_MAX:
            raise _TooLong

    def load(self, path: Path, read, *, precisely: bool = False, **options) -> str:
        """The line that ``read`` refuses ``path`` with, or "" and a number of coefficients.

        ``precisely`` counts bytes allocated (tracemalloc) where otherwise the process may not map
        more than that; it takes three times as long.

        Raises:
            Finding: the file made it do what it may not.
        """
        size = _size(path)
        room = ROOM + ROOM_A_BYTE * size
        allowed = SECONDS + SECONDS_A_MB * size / 1e6
        if precisely:
            tracemalloc.start()
        elif self.limited:
            _limit(_mapped() + room + (2 << 20))
        signal.setitimer(signal.ITIMER_PROF, 3 * allowed + 1)
        self._ticks = 0
        signal.setitimer(signal.ITIMER_REAL, TICK, TICK)
        started = time.process_time()
        scene = fault = None
        self._inside = True
        try:
            scene = read(path, **options)
        except SceneError as error:
            fault = error
        except _TooLong as error:
            self._inside = False
            where = " < ".join(traceback.format_tb(error.__traceback__)[-3:])
            raise Finding("time", f"more than {3 * allowed + 1:.1f} s\n{where}") from None
        except BaseException as error:
            self._inside = False
            if isinstance(error, KeyboardInterrupt | SystemExit):
                raise
            raise Finding("exception", _innermost(error)) from error
        finally:
            took = time.process_time() - started
            self._inside = False
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.setitimer(signal.ITIMER_REAL, 0)
            if precisely:
                peak = tracemalloc.get_traced_memory()[1]
                tracemalloc.stop()
            elif self.limited:
                _limit(resource.RLIM_INFINITY)
        if precisely and peak > room:
            raise Finding("memory", f"{peak >> 20} MB at most for a file of {size} bytes")
        if fault is not None and isinstance(fault.__cause__, MemoryError):
            raise Finding("memory", f"more than {room >> 20} MB for {size} bytes: {fault}")
        if took > allowed * (4 if precisely else 1):
            raise Finding("time", f"{took:.2f} s for a file of {size} bytes")
        line = "" if fault is None else str(fault)
        del fault
        if self._complaints or self._opened:
            said = [*self._complaints, *self._opened]
            del self._complaints[:], self._opened[:]
            raise Finding("side effect", ", ".join(said))
        if _lowest_descriptor() != self._free:
            gc.collect()
            self._free = _lowest_descriptor()
            raise Finding("side effect", "a file is left open")
        if scene is None:
            check_line(line, path)
            return line
        check_scene(scene, options.get("max_splats"))
        return f" {scene.source} {scene.sh.shape[1]} {scene.sh.dtype} {sorted(scene.dropped)}"


def _late(signum: int, frame: object) -> None:
    raise _TooLong


def _mapped() -> int:
    with open("/proc/self/statm", "rb", buffering=0) as file:  # noqa: PTH123 - as above
        return int(file.read().split()[0]) * 4096


def _limit(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (size, resource.RLIM_INFINITY))


def _lowest_descriptor() -> int:
    """A file that is left open takes it."""
    found = os.dup(0)
    os.close(found)
    return found


def _size(path: Path) -> int:
    if path.is_dir():
        return sum(f.stat().st_size for f in path.iterdir())
    return path.stat().st_size


def _innermost(error: BaseException) -> str:
    """The exception, and the last line of tsplat's that it passed."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if "tsplat" in Path(f.filename).parts]
    where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "?"
    return f"{type(error).__name__} at {where}: {error}"


def check_line(line: str, path: Path) -> None:
    """A refusal: one line, printable, about the file, with an expectation or a remedy."""
    from tsplat.core.errors import printable

    if not line.isprintable() or len(line) > LINE_MAX:
        raise Finding("line", f"not one printable line of {LINE_MAX}: {line[:999]!r}")
    if not line.startswith(printable(path)):
        raise Finding("line", f"does not begin with the file's name: {line!r}")
    if not TELLS.search(line):
        raise Finding("line", f"neither expectation nor remedy: {line[line.find(': ') :]}")


def check_scene(scene, most: int | None = None) -> None:
    """What every Scene of a file must be."""
    n = len(scene)
    faults = [
        what
        for what, sound in (
            ("no Gaussians", n >= 1),
            ("more than max_splats", most is None or n <= most),
            ("means", np.isfinite(scene.means).all()),
            ("quats", (np.abs(np.square(scene.quats).sum(1) - 1) < 1e-5).all()),
            ("scales", (scene.scales >= 0).all() and np.isfinite(scene.scales).all()),
            ("opacities", ((scene.opacities >= 0) & (scene.opacities <= 1)).all()),
            ("sh", np.isfinite(scene.sh).all() and float(np.abs(scene.sh).max()) < 2.2e37),
            ("shapes", {len(scene.quats), len(scene.scales), len(scene.opacities)} == {n}),
            ("coefficients", scene.sh.shape == (n, scene.sh.shape[1], 3)),
            ("degree", scene.sh.shape[1] in (1, 4, 9, 16)),
            ("origin", np.isfinite(scene.origin).all()),
            ("dropped", all(count > 0 for count in scene.dropped.values())),
            ("numbers", scene.numbers is None or len(set(scene.numbers.tolist())) == n),
            ("text", (scene.source + scene.name).isprintable()),
        )
        if not sound
    ]
    if faults:
        raise Finding("scene", f"unsound: {', '.join(faults)}")


@contextlib.contextmanager
def unguarded():
    """Warnings and signals as they were, after a test has used a :class:`Guard`."""
    hooks = sys.unraisablehook
    handlers = [(s, signal.getsignal(s)) for s in (signal.SIGPROF, signal.SIGALRM)]
    with warnings.catch_warnings():
        yield
    sys.unraisablehook = hooks
    for which, handler in handlers:
        signal.signal(which, handler)
