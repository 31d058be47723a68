"""What is kept of a session: pictures, each with the command that makes it again, and paths."""

from __future__ import annotations

import json
import math
import re
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from tsplat.core.camera import Camera
from tsplat.core.errors import printable
from tsplat.core.workspace import Workspace
from tsplat.io.cameras import camera_to_json
from tsplat.viewer.controls import View
from tsplat.viewer.engine import Prepared

NUMBERS = 10_000  # names that are tried
STEM_BYTES = 80  # of the scene's name in them; a file's name has 255 at most
POSE_SECONDS = 0.1  # between two poses of a move that is recorded, at least
LEAST_SECONDS = 0.001  # between any two; times are written to a tenth of that

Command = Callable[[View, Camera, str, str | None], str]
"""(view, camera, picture's file, camera's file or None) -> the shell command for the picture."""


def free_name(directory: Path, stem: str, *suffixes: str) -> Path:
    """The first of ``tsplat-STEM-001`` and so on that is there with none of ``suffixes``.

    It is returned with the first of them, as an empty file: what keeps the name from others.

    Raises:
        OSError: all are there, or nothing can be written here.
    """
    plain = re.sub(r"[^\w.-]+", "-", stem).encode()[:STEM_BYTES].decode(errors="ignore")
    plain = plain.strip("-.") or "scene"
    for number in range(1, NUMBERS):
        place = directory / f"tsplat-{plain}-{number:03d}{suffixes[0]}"
        if any(place.with_suffix(suffix).exists() for suffix in suffixes[1:]):
            continue
        with suppress(FileExistsError):
            place.touch(exist_ok=False)
            return place
    raise FileExistsError(f"{NUMBERS} files called {plain} are there already")


@dataclass(eq=False)
class Recording:
    """A path while it is recorded: where the camera was, and when. Rests between moves count."""

    poses: list[tuple[float, Camera]] = field(default_factory=list)

    def add(self, now: float, camera: Camera) -> None:
        """The camera's place at ``now`` s. Of a rest the first moment and the last are kept.

        Of a move the poses are :data:`POSE_SECONDS` apart or more, but for its last one.
        """
        poses = self.poses
        if not poses:
            poses.append((now, camera))
            return
        first = poses[0][1]
        if (camera.width, camera.height) != (first.width, first.height):  # a path has one size
            camera = camera.reframed(first.width, first.height)
        last, pose = poses[-1]
        if now < last + LEAST_SECONDS and camera.same(pose):
            return
        before = poses[-2] if len(poses) > 1 else None
        resting = camera.same(pose) and before is not None and pose.same(before[1])
        passing = (
            before is not None
            and last < before[0] + POSE_SECONDS
            and not camera.same(pose)
            and not pose.same(before[1])
        )
        if resting or passing:
            poses.pop()
        poses.append((max(now, poses[-1][0] + LEAST_SECONDS), camera))

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
            except Exception as error:  # a plugin may raise any; nobody else would hear of it
                tell(f"no picture: {_words(error)}")

        thread = threading.Thread(target=work)  # no daemon: what was asked for is finished
        self._threads = [other for other in self._threads if other.is_alive()] + [thread]
        thread.start()

    def _picture(self, view: View, camera: Camera, prepared: Prepared) -> str:
        from tsplat.io.images import save_image

        place = free_name(self._directory, Path(prepared.scene.name).stem, ".png", ".json")
        try:
            workspace = Workspace(prepared.plan.threads)
            frame = prepared.plan.run(prepared.scene, camera, workspace).frame
            save_image(frame, place, view.look.background)
        except BaseException:
            place.unlink(missing_ok=True)
            raise
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
            return f"no path: {_words(error)}"
        seconds = recording.poses[-1][0] - recording.poses[0][0]
        self.said.append(
            f"{printable(place.name)}: a path of {seconds:.1f} s, for --play and --path"
        )
        return f"{printable(place.name)}, {seconds:.1f} s"

    def wait(self) -> None:
        """Until every picture is written."""
        for thread in self._threads:
            thread.join()


def _words(error: BaseException) -> str:
    """What it says, without numbers and names that say nothing to a person."""
    told = error.strerror if isinstance(error, OSError) else None
    return printable(told or error) or type(error).__name__


def plain(view: View) -> bool:
    """Whether an eye, a target and an up direction say where the camera is."""
    upright = abs(abs(view.orbit.pitch) - math.pi / 2) > 1e-6
    return view.still is None and view.path is None and upright
