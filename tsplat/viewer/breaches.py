"""What is kept of a frame that broke the contract: a line in a log, and how to see it again.

Where: the directory for state of the XDG base directory specification,
https://specifications.freedesktop.org/basedir-spec/latest/ .
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tsplat._version import __version__
from tsplat.core.camera import Camera
from tsplat.core.errors import printable
from tsplat.io.cameras import camera_to_json

KEPT_MAX = 20
"""Frames of one session that are written down. A wrong backend breaks every one."""

FAULTS_MAX = 3
"""Faults that are written of one frame. A wrong backend has one in every tile."""

TOLD_MAX = 3
"""Frames of one session that are told when it ends."""


def state_directory(environ: Mapping[str, str]) -> Path:
    """``$XDG_STATE_HOME/tsplat``; ``~/.local/state/tsplat`` if that is unset or not absolute."""
    home = environ.get("XDG_STATE_HOME", "")
    base = Path(home) if Path(home).is_absolute() else Path.home() / ".local" / "state"
    return base / "tsplat"


@dataclass(eq=False)
class BreachLog:
    """Breaches of one session. ``command`` makes the words that reproduce one from its camera."""

    command: Callable[[Camera, Path], str]
    directory: Path = field(default_factory=lambda: state_directory(os.environ))
    entries: list[str] = field(default_factory=list)  # what was written down
    count: int = 0
    trouble: str = ""  # why the last one could not be

    @property
    def path(self) -> Path:
        """The log."""
        return self.directory / "verify.log"

    def add(self, camera: Camera, faults: tuple[str, ...]) -> None:
        """Writes the camera and a paragraph with the command; nothing raised if it cannot."""
        self.count += 1
        if self.count > KEPT_MAX:
            return
        now = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        pose = self.directory / f"camera-{now}-{os.getpid()}-{self.count}.json"
        shown = list(faults[:FAULTS_MAX])
        if len(faults) > FAULTS_MAX:
            shown.append(f"and {len(faults) - FAULTS_MAX} more like these")
        lines = [f"{now} tsplat {__version__}", *shown, self.command(camera, pose)]
        entry = "\n  ".join(printable(line, 4000) for line in lines) + "\n"
        self.entries.append(entry)
        try:
            self.directory.mkdir(parents=True, exist_ok=True, mode=0o700)
            pose.write_text(json.dumps(camera_to_json(camera)))
            with self.path.open("a") as stream:
                stream.write(entry)
        except OSError as error:
            self.trouble = f"{printable(self.directory)}: {printable(error.strerror)}"

    def report(self) -> list[str]:
        """Lines for after the session; none if the contract was never broken."""
        if not self.count:
            return []
        lines = [f"{self.count} of the frames shown broke the contract"]
        lines += [line.rstrip() for entry in self.entries[:TOLD_MAX] for line in entry.splitlines()]
        if self.count > TOLD_MAX:
            lines.append(f"and {self.count - TOLD_MAX} more")
        kept = f"cannot be written: {self.trouble}" if self.trouble else printable(self.path, 4000)
        return [*lines, f"log: {kept}"]
