"""A scene as writers want it: rows in the order of its file, as few coefficients as asked for.

Where the scene came from an INRIA PLY file, what stands there is at hand too, so that a PLY file
made of it has the very same numbers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from tsplat.core.errors import printable
from tsplat.core.types import F32, I64, Floats, Scene
from tsplat.edits import NOTHING, Edits, cut, edited
from tsplat.io import clean
from tsplat.io.base import sample_rows, silent
from tsplat.io.says import says_antialias, says_up
from tsplat.io.write.base import ROWS, parts

if TYPE_CHECKING:
    from tsplat.io.ply import Stored
    from tsplat.io.plyrows import Element, Header

Rows = slice | I64
"""Some of a source's Gaussians, in its order."""


class Source:
    """The Gaussians of ``scene`` that are written, in the order of its file."""

    def __init__(self, scene: Scene, *, degree: int | None = None, edits: Edits = NOTHING) -> None:
        """``degree``: at most so many bands of harmonics. What ``edits`` cut is left out."""
        self.given = scene
        order = None if scene.numbers is None else np.argsort(scene.numbers)
        left, self.cut = cut(scene, edits)  # and how many are left out by which edit
        self.places: I64 | None = None  # which of the scene's rows, in its file's order, are left
        if not left.all():
            self.places = np.flatnonzero(left if order is None else left[order])
            order = self.places if order is None else order[self.places]
        self.scene = edited(scene, edits)
        self.edits = edits
        self._order = order
        self._count = int(np.count_nonzero(left))
        top = scene.sh_degree if degree is None else min(degree, scene.sh_degree)
        self.degree = top
        self.coefficients = (top + 1) ** 2
        self.verbatim: Verbatim | None = None

    def __len__(self) -> int:
        return self._count

    @property
    def wide(self) -> bool:
        """Whether positions take float64."""
        return bool(self.scene.origin.any())

    @property
    def antialias(self) -> bool | None:
        """See ``Scene.antialias``."""
        return self.scene.antialias

    def _rows(self, rows: Rows) -> Rows:
        return rows if self._order is None else self._order[rows]

    def means(self, rows: Rows) -> Floats:
        """[n, 3] world units; float32 unless ``wide``."""
        means: Floats = self.scene.means[self._rows(rows)]
        return means + self.scene.origin if self.wide else means

    def quats(self, rows: Rows) -> F32:
        """[n, 4] w, x, y, z, of length 1."""
        found: F32 = self.scene.quats[self._rows(rows)]
        return found

    def scales(self, rows: Rows) -> F32:
        """[n, 3] linear."""
        found: F32 = self.scene.scales[self._rows(rows)]
        return found

    def opacities(self, rows: Rows) -> F32:
        """[n] 0..1."""
        found: F32 = self.scene.opacities[self._rows(rows)]
        return found

    def sh(self, rows: Rows, first: int = 0) -> F32:
        """[n, K - first, 3], the coefficients from ``first`` on."""
        found = self.scene.sh[self._rows(rows), first : self.coefficients]
        return found.astype(np.float32, copy=False)

    def drawn_scene(self) -> Scene:
        """What is written as a scene, to be drawn: all coefficients, nothing that was cut."""
        return self.scene if self._order is None else self.scene.take(np.sort(self._order))

    def typical_scale(self) -> float:
        """World units: the median of Gaussians' largest standard deviations; 0 of none."""
        step = max(len(self) // ROWS, 1)
        scales = self.scales(np.arange(0, len(self), step))
        return clean.median(scales.max(1)) if len(scales) else 0.0

    def reach(self) -> float:
        """World units: the largest coordinate; 0 of none."""
        return max(
            (float(np.abs(self.means(p)).max(initial=0)) for p in parts(len(self))), default=0.0
        )


class Verbatim:
    """Rows of an INRIA PLY file, as they stand there: logits, logarithms, any quaternions."""

    def __init__(self, path: Path, source: Source, max_splats: int | None) -> None:
        """``source`` is of the scene that this file was read as, with ``max_splats``."""
        from tsplat.io import ply, plyrows

        header = plyrows.read_header(path)
        vertex = ply.check(path, header)
        rest = ply.rest_count(vertex.properties)
        assert isinstance(rest, int)  # it has been read
        self.passed_over = _passed_over(header, vertex)
        self._rows = plyrows.open_rows(path, header, silent)
        self._layout = ply.Layout(self._rows.dtype, rest)
        dropped = Counter(source.given.dropped)
        total = len(self._rows)
        kept = np.arange(total)
        if max_splats is not None and max_splats < total:
            kept = sample_rows(total, max_splats)
        if any(dropped[reason] for reason in clean.REASONS):
            kept = self._sound(kept)
        if source.places is not None:
            kept = kept[source.places]
        self._kept = kept

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._rows.__exit__(*exception)

    def __len__(self) -> int:
        return len(self._kept)

    def _pieces(self, kept: I64) -> Iterator[tuple[slice, NDArray[np.void]]]:
        """Those rows of the file, piece by piece, and which of ``kept`` they are."""
        room = np.empty(min(ROWS, len(self._rows)), self._rows.dtype)
        for start in range(0, len(self._rows), ROWS):
            stop = min(start + ROWS, len(self._rows))
            part = slice(*np.searchsorted(kept, (start, stop)).tolist())
            if part.start < part.stop:
                rows = self._rows.read(start, stop, room)
                whole = part.stop - part.start == stop - start
                yield part, rows if whole else rows[kept[part] - start]

    def _sound(self, kept: I64) -> I64:
        """Those of ``kept`` that can be drawn."""
        good = np.empty(len(kept), bool)
        for part, rows in self._pieces(kept):
            good[part] = clean.judged(
                *self._layout.decoded(rows, raw_opacity=False), wide=self._layout.wide
            )
        return kept[good]

    def pieces(self) -> Iterator[tuple[slice, Stored]]:
        """Which Gaussians of the source, and what the file has of them."""
        for part, rows in self._pieces(self._kept):
            yield part, self._layout.stored(rows)


def _passed_over(header: Header, vertex: Element) -> tuple[str, ...]:
    """What else the file has."""
    from tsplat.io.ply import NEEDED

    known = {*NEEDED, "nx", "ny", "nz"}
    other = [n for n in vertex.properties if n not in known and not n.startswith("f_rest_")]
    elements = [e.name for e in header.elements if e is not vertex]
    kept = sum(says_up([c]) is not None or says_antialias([c]) is not None for c in header.comments)
    comments = sum(line.split()[:1] in ([b"comment"], [b"obj_info"]) for line in header.lines)
    comments -= kept
    named = (("properties", other), ("elements", elements))
    found = [f"{what} {printable(', '.join(names[:8]))}" for what, names in named if names]
    return (*found, *([f"{comments} comment{'s' if comments > 1 else ''}"] if comments else []))
