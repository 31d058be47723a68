"""What a scene reader is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from tsplat.core.types import Scene


def _silent(done: int, total: int) -> None:
    pass


@dataclass(frozen=True)
class ReadOptions:
    """What to do while reading, the same for every format."""

    max_splats: int | None = None  # keep at most this many, an even, seeded sample
    raw_opacity: bool = False  # opacities are stored as 0..1, not as logits
    progress: Callable[[int, int], None] = _silent  # (done, total) in any unit, called often


class Read(Protocol):
    """A file -> a Scene.

    Raises:
        SceneError: the file is not what it says; the text is one line that names what was
            found and what to do.
    """

    def __call__(self, path: Path, options: ReadOptions) -> Scene: ...


@dataclass(frozen=True)
class Reader:
    """A file format: one row of the table that ``tsplat plugins`` prints."""

    name: str
    summary: str  # one line
    recognises: Callable[[bytes], bool]  # the file's first 4096 bytes
    load: Callable[[], Read]  # heavy imports go in here
