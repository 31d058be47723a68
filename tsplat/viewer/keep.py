"""What is kept of a session: pictures, each with the command that makes it again, and paths."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from tsplat.core.camera import Camera
from tsplat.core.errors import TsplatError, printable
from tsplat.core.workspace import Workspace
from tsplat.io.cameras import camera_to_json
from tsplat.viewer.controls import View
from tsplat.viewer.engine import Prepared

NUMBERS = 10_000  # names that are tried
POSE_SECONDS = 0.1  # between two poses of a recorded path, at least

Command = Callable[[View, Camera, str, str | None], str]
"""(view, camera, picture's file, camera's file or None) -> the shell command for the picture."""


def free_name(directory: Path, stem: str, suffix: str) -> Path:
    """The first of ``tsplat-STEM-001.png`` and so on that is not there yet.

    Raises:
        OSError: all are.
    """
    plain = re.sub(r"[^\w.-]+", "-", stem).strip("-.")[:80] or "scene"
    for number in range(1, NUMBERS):
        place = directory / f"tsplat-{plain}-{number:03d}{suffix}"
        if not place.exists():
            return place
    raise FileExistsError(f"{NUMBERS} files called {plain} are there already")


@dataclass(eq=False)
class Recording:
    """A path while it is recorded: where the camera was, and when. Rests between moves count."""

    poses: list[tuple[float, Camera]] = field(default_factory=list)

    def add(self, now: float, camera: Camera) -> None:
        """The camera's place at ``now`` s. Of a rest the first moment and the last are kept."""
        resting = len(self.poses) > 1 and all(camera.same(pose) for _, pose in self.poses[-2:])
        if resting:
            self.poses[-1] = now, camera
        elif not self.poses or now - self.poses[-1][0] >= POSE_SECONDS:
            self.poses.append((now, camera))

    def text(self) -> str:
        """As ``--play`` and ``--path`` read it: JSON, times from 0."""
        begin = self.poses[0][0] if self.poses else 0.0
        rows = [{"time": round(t - begin, 4), **camera_to_json(c)} for t, c in self.poses]
        return json.dumps(rows)


class Keeper:
    """Writes files, pictures in a thread of their own.

    ``tell(words)`` is called, from that thread, when one is done. ``said`` has what is to be told
    again when the session is over.
    """

    def __init__(self, command: Command, directory: Path | None = None) -> None:
        self.said: list[str] = []
        self._command, self._directory = command, directory or Path.cwd()
        self._threads: list[threading.Thread] = []

    def picture(
        self, view: View, camera: Camera, prepared: Prepared, tell: Callable[[str], None]
    ) -> None:
        """Renders and writes ``camera``'s picture."""

        def work() -> None:
            try:
                tell(self._picture(view, camera, prepared))
            except (TsplatError, OSError, MemoryError) as error:
                tell(f"no picture: {printable(error)}")

        thread = threading.Thread(target=work)  # no daemon: what was asked for is finished
        self._threads = [other for other in self._threads if other.is_alive()] + [thread]
        thread.start()

    def _picture(self, view: View, camera: Camera, prepared: Prepared) -> str:
        from tsplat.io.images import save_image

        place = free_name(self._directory, Path(prepared.scene.name).stem, ".png")
        frame = prepared.plan.run(prepared.scene, camera, Workspace(prepared.plan.threads)).frame
        save_image(frame, place, view.look.background)
        pose = None
        if not plain(view):
            pose = place.with_suffix(".json")
            pose.write_text(json.dumps(camera_to_json(camera)))
        command = self._command(view, camera, place.name, pose.name if pose else None)
        self.said.append(f"{printable(place.name)}: {command}")
        return f"{printable(place.name)}, {camera.width}x{camera.height}"

    def path(self, recording: Recording, stem: str) -> str:
        """Writes what was recorded; words about that."""
        if len(recording.poses) < 2:
            return "no path: the camera did not move"
        try:
            place = free_name(self._directory, f"{Path(stem).stem}-path", ".json")
            place.write_text(recording.text())
        except OSError as error:
            return f"no path: {printable(error.strerror or error)}"
        seconds = recording.poses[-1][0] - recording.poses[0][0]
        self.said.append(
            f"{printable(place.name)}: a path of {seconds:.1f} s, for --play and --path"
        )
        return f"{printable(place.name)}, {seconds:.1f} s"

    def wait(self) -> None:
        """Until every picture is written."""
        for thread in self._threads:
            thread.join()


def plain(view: View) -> bool:
    """Whether an eye, a target and an up direction say where the camera is."""
    upright = abs(abs(view.orbit.pitch) - 1.5707963267948966) > 1e-6
    return view.still is None and view.path is None and upright
