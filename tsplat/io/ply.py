"""INRIA's PLY of Gaussians: one vertex per Gaussian, properties found by name.

Layout and activations: graphdeco-inria/gaussian-splatting ``scene/gaussian_model.py``,
``save_ply`` and ``load_ply`` (Kerbl et al. 2023). ``opacity`` is a logit, ``scale_*`` are natural
logarithms, ``rot_*`` is w, x, y, z of any length, ``f_rest_*`` is channel-major: every
coefficient of red, then of green, then of blue. Property order, number types, byte order, normals
and further properties and elements differ from writer to writer and are no matter.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tsplat.core.errors import printable
from tsplat.core.types import F32, I32, Floats, Scene
from tsplat.hookspecs import hookimpl
from tsplat.io import native
from tsplat.io.base import Read, Reader, ReadOptions, refuse, silent
from tsplat.io.clean import SceneBuilder, sigmoid
from tsplat.io.says import says_antialias, says_up
from tsplat.io.sweeps import scene_of

if TYPE_CHECKING:
    from tsplat.io.plyrows import Element, Header

MEANS = ("x", "y", "z")
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
SCALES = ("scale_0", "scale_1", "scale_2")
DC = ("f_dc_0", "f_dc_1", "f_dc_2")
THICKNESS = SCALES[2]
"""2D Gaussians, which are flat, are written without it."""

NEEDED = (*MEANS, *DC, "opacity", *SCALES, *QUATS)
TELLING = ("opacity", *DC, *SCALES, *QUATS)
"""Properties that only a file of Gaussians has."""

REST_COUNTS = (0, 9, 24, 45)
"""f_rest properties of degree 0 to 3: for each of three channels (degree + 1)^2 - 1."""

Columns = Callable[[NDArray[np.void]], NDArray[np.generic]]
"""Rows -> [n, k], some of their properties."""


def rest_count(properties: tuple[str, ...]) -> int | str:
    """How many ``f_rest_*`` there are, or what is wrong with them."""
    rest = [p for p in properties if p.startswith("f_rest")]
    indices = set()
    for name in rest:
        found = re.fullmatch(r"f_rest_(0|[1-9][0-9]{0,3})", name)
        if not found:
            return f"has a property {printable(name, 40)!r}; expected f_rest_0, f_rest_1, ..."
        indices.add(int(found[1]))
    missing = set(range(len(rest))) - indices
    if missing:
        return (
            f"has {len(rest)} f_rest properties but no f_rest_{min(missing)}; the file is damaged"
        )
    if len(rest) not in REST_COUNTS:
        degree = {72: ", which is degree 4"}.get(len(rest), "")
        return (
            f"has {len(rest)} f_rest properties{degree}; expected 0, 9, 24 or 45, "
            "spherical harmonics of degree 0 to 3"
        )
    return len(rest)


def _columns(dtype: np.dtype[np.void], names: tuple[str, ...]) -> Columns:
    """How to get the properties ``names`` of rows: a view where they lie side by side, as mostly.

    Of one type they keep it; of several, float32 if every value fits into it exactly, else
    float64.
    """
    fields = [dtype.fields[name] for name in names]  # type: ignore[index]
    kind, first = fields[0][:2]
    if [f[:2] for f in fields] == [(kind, first + j * kind.itemsize) for j in range(len(fields))]:
        run = np.dtype(
            {
                "names": ["run"],
                "formats": [(kind, (len(names),))],
                "offsets": [first],
                "itemsize": dtype.itemsize,
            }
        )
        return lambda rows: rows.view(run)["run"]
    fits = all(np.can_cast(f[0], np.float32) for f in fields)

    def gathered(rows: NDArray[np.void]) -> NDArray[np.generic]:
        columns = np.empty((len(rows), len(names)), np.float32 if fits else np.float64)
        for j, name in enumerate(names):
            columns[:, j] = rows[name]
        return columns

    return gathered


def _floats(columns: NDArray[np.generic]) -> Floats:
    """``columns`` as float32 if every value fits into it exactly, float64 otherwise."""
    if np.can_cast(columns.dtype, np.float32):
        return columns.astype(np.float32, copy=False)
    return columns.astype(np.float64, copy=False)


class Stored(NamedTuple):
    """Some rows of a file as they are there."""

    means: Floats  # [n, 3]
    quats: Floats  # [n, 4]  w, x, y, z; any length
    logs: Floats  # [n, 3]  of scales
    logits: Floats  # [n]  of opacities
    sh: F32  # [n, K, 3]


class Layout:
    """Where the properties of a Gaussian stand in rows of ``dtype``."""

    def __init__(self, dtype: np.dtype[np.void], rest: int) -> None:
        """``rest`` is how many ``f_rest_*`` there are."""
        self.coefficients = 1 + rest // 3
        self.wide = not all(np.can_cast(dtype[name], np.float32) for name in MEANS)
        self._means, self._quats = _columns(dtype, MEANS), _columns(dtype, QUATS)
        self._flat = THICKNESS not in (dtype.names or ())
        self._scales = _columns(dtype, SCALES[:2] if self._flat else SCALES)
        self._dc = _columns(dtype, DC)
        per_channel = rest // 3
        self._rest = [
            _columns(dtype, tuple(f"f_rest_{i}" for i in range(first, first + per_channel)))
            for first in (range(0, rest, per_channel) if rest else ())
        ]
        colours = [f"f_rest_{c * per_channel + k}" for k in range(per_channel) for c in range(3)]
        self._decoder = None
        if not self._flat:
            order = (*MEANS, *QUATS, *SCALES, "opacity", *DC, *colours)
            self._decoder = native.decoder(dtype, order)

    def means(self, rows: NDArray[np.void]) -> Floats:
        """[n, 3] the positions of ``rows``, some of which may not be finite."""
        return _floats(np.ascontiguousarray(self._means(rows)))

    def add(
        self, builder: SceneBuilder, to: slice | I32, rows: NDArray[np.void], raw_opacity: bool
    ) -> None:
        """Decodes ``rows`` into rows ``to`` of ``builder``.

        exp and sigmoid in float64: rounded once, to float32.
        """
        if self._decoder and not raw_opacity and builder.decode(self._decoder, rows, to):
            return
        builder.add(*self.decoded(rows, raw_opacity), to)

    def decoded(
        self, rows: NDArray[np.void], raw_opacity: bool
    ) -> tuple[Floats, Floats, F32, Floats, F32]:
        """Means, quaternions, scales, opacities and coefficients of ``rows``; some not finite."""
        found = self.stored(rows)
        # the builder drops what is not finite; what underflows is a point
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            opacities = found.logits.astype(np.float64)
            scales = np.exp(found.logs.astype(np.float64)).astype(np.float32)
        if self._flat:
            scales = np.concatenate([scales, np.zeros((len(rows), 1), np.float32)], axis=1)
        if not raw_opacity:
            opacities = sigmoid(opacities)
        return found.means, found.quats, scales, opacities, found.sh

    def stored(self, rows: NDArray[np.void]) -> Stored:
        """``rows`` as they stand in the file, float64 only where float32 does not hold them."""
        sh = np.empty((len(rows), self.coefficients, 3), np.float32)
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            sh[:, 0] = self._dc(rows)
            for channel, columns in enumerate(self._rest):
                sh[:, 1:, channel] = columns(rows)
            return Stored(
                self.means(rows),
                _floats(self._quats(rows)),
                _floats(self._scales(rows)),
                _floats(rows["opacity"]),
                sh,
            )


def check(path: Path, header: Header) -> Element:
    """Element ``vertex`` of a file of Gaussians.

    Raises:
        SceneError: it is something else; the line says what.
    """
    vertex = header.find("vertex")
    if vertex is None:
        found = ", ".join(e.name for e in header.elements[:8]) or "none"
        refuse(
            path, f"PLY file without an element vertex; its elements: {found}; expected Gaussians"
        )
    if not set(TELLING) & set(vertex.properties):
        face = next((e for e in header.elements if e.name in ("face", "tristrips")), None)
        kind = f"mesh (element {face.name} {face.count})" if face else "point cloud"
        refuse(
            path,
            f"this is a {kind} of {vertex.count} vertices without opacity, scale_* and rot_*, "
            "not Gaussian splats; train splats from it, or open it in a mesh viewer",
        )
    if vertex.lists:
        name = printable(vertex.lists[0], 40)
        refuse(path, f"property {name} of element vertex is a list, expected a number")
    missing = [name for name in NEEDED if name not in vertex.properties]
    if missing not in ([], [THICKNESS]):
        refuse(
            path,
            f"element vertex lacks {', '.join(missing)}; "
            "a file of Gaussians has x y z f_dc_0..2 opacity scale_0..2 rot_0..3",
        )
    if not vertex.count:
        refuse(path, "holds no Gaussians (element vertex 0)")
    return vertex


def read(path: Path, options: ReadOptions) -> Scene:
    """See :class:`tsplat.io.base.Read`."""
    from tsplat.io import compressed, plyrows

    header = plyrows.read_header(path)
    if compressed.packed(header):  # farther down than the bytes by which a reader is chosen
        return compressed.read(path, options)
    vertex = check(path, header)
    rest = rest_count(vertex.properties)
    if isinstance(rest, str):
        refuse(path, rest)
    with plyrows.open_rows(path, header, options.progress) as rows:
        if header.text:  # reading it was the work
            options = replace(options, progress=silent)
        return scene_of(
            path, rows, Layout(rows.dtype, rest), options,
            about="" if THICKNESS in vertex.properties else "ply of 2D Gaussians",
            antialias=says_antialias(header.comments), up=says_up(header.comments),
        )  # fmt: skip


def _load() -> Read:
    import tsplat.io.plyrows  # noqa: F401 - plyfile, and what is wrong with it, now

    return read


def recognises(start: bytes) -> bool:
    """Whether a file begins like a PLY file."""
    return re.match(rb"ply[\r\n]", start) is not None


PLY = Reader(
    name="ply",
    summary="Gaussians as INRIA's trainer writes them, spherical harmonics of degree 0 to 3",
    recognises=recognises,
    load=_load,
)


@hookimpl
def tsplat_readers() -> list[Reader]:
    """See :func:`tsplat.hookspecs.tsplat_readers`."""
    return [PLY]
