"""What a scene reader is, and what every reader needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn, Protocol

import numpy as np

from tsplat.core.errors import SceneError, printable
from tsplat.core.types import I64, Scene

SAMPLE_SEED = 0x5EED
"""The same file gives the same sample on every run."""

SAMPLED = "beyond max_splats"
"""Why Gaussians are left out that are not in the sample."""


WHOLE_FREE, WHOLE_RATE = 40 << 20, 64
"""Bytes of memory that the Gaussians of a packed file may take, and more for each byte of it; of
real files they take 4 to 15."""


def silent(done: int, total: int) -> None:
    """Progress that nobody wants to hear of."""


@dataclass(frozen=True)
class ReadOptions:
    """What to do while reading, the same for every format."""

    max_splats: int | None = None  # keep at most this many, an even, seeded sample
    raw_opacity: bool = False  # opacities are stored as 0..1, not as logits
    progress: Callable[[int, int], None] = silent  # (done, total) in any unit, called often
    sh_float32: bool = False  # keep SH in float32 even where float16 would do


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
    guesses: bool = False  # the format has no magic number: asked after all that do not guess


def sample_rows(total: int, keep: int) -> I64:
    """``keep`` of ``total`` rows, increasing: one drawn from each of ``keep`` equal stretches.

    A plain stride would follow any period in the file's order, and a plain draw leaves gaps;
    this has neither fault, and the end of the file counts like its beginning.
    """
    edges = np.arange(keep + 1, dtype=np.int64) * total // keep
    return np.random.default_rng(SAMPLE_SEED).integers(edges[:-1], edges[1:])


def sampled(scene: Scene, keep: int | None) -> Scene:
    """``keep`` of the Gaussians of a scene in memory, as readers keep them of a file; None: all."""
    if keep is None or keep >= len(scene):
        return scene
    dropped = {**scene.dropped, SAMPLED: len(scene) - keep}
    return replace(scene.take(sample_rows(len(scene), keep)), dropped=dropped)


def one_line(error: BaseException, most: int = 100) -> str:
    """What ``error`` says, safe to show, at most so many characters of it."""
    return printable(" ".join(str(error).split()), most)


def refuse(path: Path, fault: str) -> NoReturn:
    """Raises the SceneError about ``path``: its name made safe to show, then ``fault``."""
    raise SceneError(f"{printable(path)}: {fault}")


def check_memory(path: Path, count: int, coefficients: int, packed: int, size: int) -> None:
    """Refuses a packed file whose Gaussians would take far more memory than any real one's.

    ``count`` of them with K ``coefficients`` and ``packed`` bytes each once unpacked, in a file of
    ``size`` bytes. To be asked before anything is unpacked.
    """
    needed = count * (44 + 12 * coefficients + packed)
    limit = WHOLE_FREE + WHOLE_RATE * size
    if needed > limit:
        refuse(
            path,
            f"promises {count} Gaussians of {coefficients} coefficients, {needed >> 20} MB, in "
            f"{size} bytes, expected at most {limit >> 20} MB of as many; "
            "the file is damaged, or made to fill the memory",
        )


def refuse_raw_opacity(path: Path, options: ReadOptions, kind: str) -> None:
    """Refuses ``raw_opacity`` for a file of a format whose opacities are never logits."""
    if options.raw_opacity:
        refuse(
            path,
            f"opacities of {kind} are always 0..1; leave out raw_opacity (--raw-opacity)",
        )
