"""What a scene writer is, and what every writer needs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, BinaryIO, Protocol

import numpy as np

from tsplat.core.errors import ParamsError
from tsplat.core.types import F32, F64, I64, Floats
from tsplat.io.base import silent

if TYPE_CHECKING:
    from tsplat.io.write.source import Source

ROWS = 1 << 16
"""Gaussians encoded at a time; of degree 3 some 50 MB with all that NumPy makes on the way."""

FLOOR = -105.0
"""Logarithms and logits of 0: exp of it is 0 in float32, and it is finite, as all readers like it.
The least float32 is 1.4e-45 = e^-103.3; what is below half of that is rounded to 0."""

CEILING = 18.0
"""The logit of 1: a sigmoid of more than 17.4 is 1 in float32, whose step below 1 is 2^-24."""


def option(name: str) -> str:
    """``version (--format-version)``: a name of WriteOptions, and what the command calls it."""
    words = "format-version" if name == "version" else name.replace("_", "-")
    return f"{name} (--{words})"


@dataclass(frozen=True)
class WriteOptions:
    """How to write; None leaves it to the writer. A writer says in ``Writer.takes`` what it heeds.

    Raises:
        ParamsError: a value outside its range.
    """

    version: int | None = None  # of the format
    fractional_bits: int | None = None  # of positions in fixed point
    sh_bits: tuple[int, int] | None = None  # of coefficients of degree 1, and of higher ones
    progress: Callable[[int, int], None] = silent  # (done, total) in any unit, called often

    def __post_init__(self) -> None:
        if self.fractional_bits is not None and not 0 <= self.fractional_bits <= 23:
            raise ParamsError(
                f"{option('fractional_bits')}: expected 0 to 23, got {self.fractional_bits}"
            )
        if self.sh_bits is not None and not all(1 <= bits <= 8 for bits in self.sh_bits):
            raise ParamsError(f"{option('sh_bits')}: expected 1 to 8 each, got {self.sh_bits}")

    def named(self) -> list[str]:
        """The options that are not left to the writer."""
        names = ("version", "fractional_bits", "sh_bits")
        return [name for name in names if getattr(self, name) is not None]


@dataclass(frozen=True, eq=False)
class Written:
    """What a writer says when it is done."""

    about: str  # the format, and what matters of it: "spz 3, SH 2, 12 fractional bits"
    order: I64 | None = None  # [N] which Gaussian of the source each one in the file is; None: same
    notes: tuple[str, ...] = ()  # what the format did not hold, a line each


class Write(Protocol):
    """The Gaussians of ``source`` -> ``out``, which is an empty file that can be sought in.

    Raises:
        OutputError: the format cannot hold the scene; one line: what, and what to do. What is
            raised by writing to ``out`` goes through.
    """

    def __call__(self, source: Source, out: BinaryIO, options: WriteOptions) -> Written: ...


@dataclass(frozen=True)
class Writer:
    """A file format to write: one row of the table that ``tsplat plugins`` prints."""

    name: str
    summary: str  # one line
    suffixes: tuple[str, ...]  # of files in this format, such as ".compressed.ply"; longest wins
    load: Callable[[], Write]  # heavy imports go in here
    degree: int = 3  # the highest one of spherical harmonics that it holds
    takes: tuple[str, ...] = ()  # which of WriteOptions' names it heeds


def parts(count: int, rows: int = ROWS) -> list[slice]:
    """0..count in slices of ``rows``."""
    return [slice(i, min(i + rows, count)) for i in range(0, count, rows)]


def logs(scales: Floats) -> F64:
    """Natural logarithms in float64, FLOOR or more."""
    with np.errstate(divide="ignore"):
        found = np.log(scales, dtype=np.float64)
    return np.asarray(np.maximum(found, FLOOR))


def logits(opacities: Floats) -> F64:
    """What a sigmoid makes ``opacities`` of, in float64, within FLOOR and CEILING."""
    wide = opacities.astype(np.float64)
    with np.errstate(divide="ignore"):
        found = np.log(wide) - np.log1p(-wide)
    return np.asarray(np.clip(found, FLOOR, CEILING))


def smallest_three(quats: F32, order: tuple[int, int, int, int]) -> tuple[F64, I64]:
    """[n, 3] the components but the largest, in ``order``, and [n] which of ``order`` that is.

    Signs are those of the quaternion or its negative whose largest component is positive.
    """
    seen = quats[:, order].astype(np.float64)
    largest = np.abs(seen).argmax(1)
    rows = np.arange(len(seen))
    seen *= np.where(seen[rows, largest] < 0, -1.0, 1.0)[:, None]
    small = np.empty((len(seen), 3))
    for j in range(3):  # the others keep their order, left and right of the largest
        small[:, j] = np.where(largest > j, seen[:, j], seen[:, j + 1])
    return small, largest


class Clipped:
    """Counts values that a format holds no more of, for notes."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.most: dict[str, float] = {}

    def see(self, what: str, over: Floats, slack: float) -> None:
        """``over``: how far values are beyond the limit; beyond ``slack`` they count."""
        beyond = over > slack
        count = int(np.count_nonzero(beyond))
        if count:
            self.counts[what] = self.counts.get(what, 0) + count
            self.most[what] = max(self.most.get(what, 0.0), float(over.max()))

    def notes(self) -> tuple[str, ...]:
        """A line each."""
        return tuple(
            f"{count:,} {what}" + (f" (by {most:.3g} at most)" if math.isfinite(most) else "")
            for (what, count), most in zip(self.counts.items(), self.most.values(), strict=True)
        )


def comments(source: Source) -> list[str]:
    """Lines of a PLY header about the scene, in the words that :mod:`tsplat.io.says` knows."""
    said = []
    if source.antialias is not None:
        said.append(f"comment antialiased {int(source.antialias)}")
    if source.scene.up is not None:
        said.append(
            "comment Vertical axis: "
            + " ".join(f"{x + 0.0:.9g}" for x in source.scene.up.direction)
        )
    return said


def unsaid(
    source: Source, fmt: str, *, antialias: bool, up: tuple[float, float, float] | None = None
) -> list[str]:
    """Notes on what ``fmt`` cannot say of the scene.

    ``antialias``: that it can say. ``up``: which way that is in all of its files.
    """
    notes = []
    if source.antialias is not None and not antialias:
        notes.append(f"whether it was trained with antialiasing is not in {fmt}")
    known = source.scene.up
    if known is not None and not (up is not None and _alike(known.direction, up)):
        notes.append(f"which way is up ({known.why}) is not in {fmt}")
    return notes


def _alike(a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
    """Whether two directions are within a degree of each other."""
    cosine = sum(x * y for x, y in zip(a, b, strict=True)) / (math.hypot(*a) * math.hypot(*b))
    return cosine > math.cos(math.radians(1))
