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
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tsplat.core.errors import printable
from tsplat.core.types import F64, I32, Floats, Scene
from tsplat.core.workspace import default_threads
from tsplat.hookspecs import hookimpl
from tsplat.io import curve, native
from tsplat.io.base import SAMPLED, Read, Reader, ReadOptions, refuse, sample_rows
from tsplat.io.clean import CHUNK, OPACITY_RANGE, THREADS, SceneBuilder
from tsplat.io.half import SH_ERROR_MAX

if TYPE_CHECKING:
    from tsplat.io.plyrows import Element, Header, Rows

MEANS = ("x", "y", "z")
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
SCALES = ("scale_0", "scale_1", "scale_2")
DC = ("f_dc_0", "f_dc_1", "f_dc_2")
NEEDED = (*MEANS, *DC, "opacity", *SCALES, *QUATS)
TELLING = ("opacity", *DC, *SCALES, *QUATS)
"""Properties that only a file of Gaussians has."""

REST_COUNTS = (0, 9, 24, 45)
"""f_rest properties of degree 0 to 3: for each of three channels (degree + 1)^2 - 1."""

Columns = Callable[[NDArray[np.void]], NDArray[np.generic]]
"""Rows -> [n, k], some of their properties."""

PIECE = 4 * CHUNK
"""Rows that a thread decodes before it takes the next."""


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
        return f"has {len(rest)} f_rest properties but no f_rest_{min(missing)}"
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


def sigmoid(logits: F64) -> F64:
    """1 / (1 + e^-x) in float64; exactly 0 and 1 at the infinities."""
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        return 1 / (1 + np.exp(-logits))


class Layout:
    """Where the properties of a Gaussian stand in rows of ``dtype``."""

    def __init__(self, dtype: np.dtype[np.void], rest: int) -> None:
        """``rest`` is how many ``f_rest_*`` there are."""
        self.coefficients = 1 + rest // 3
        self.wide = not all(np.can_cast(dtype[name], np.float32) for name in MEANS)
        self._means, self._quats = _columns(dtype, MEANS), _columns(dtype, QUATS)
        self._scales, self._dc = _columns(dtype, SCALES), _columns(dtype, DC)
        per_channel = rest // 3
        self._rest = [
            _columns(dtype, tuple(f"f_rest_{i}" for i in range(first, first + per_channel)))
            for first in (range(0, rest, per_channel) if rest else ())
        ]
        colours = [f"f_rest_{c * per_channel + k}" for k in range(per_channel) for c in range(3)]
        self._decoder = native.decoder(dtype, (*MEANS, *QUATS, *SCALES, "opacity", *DC, *colours))

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
        sh = np.empty((len(rows), self.coefficients, 3), np.float32)
        # the builder drops what is not finite; what underflows is a point
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            opacities = rows["opacity"].astype(np.float64)
            means = self.means(rows)
            quats = _floats(self._quats(rows))
            scales = np.exp(self._scales(rows).astype(np.float64)).astype(np.float32)
            sh[:, 0] = self._dc(rows)
            for channel, columns in enumerate(self._rest):
                sh[:, 1:, channel] = columns(rows)
        if not raw_opacity:
            opacities = sigmoid(opacities)
        builder.add(means, quats, scales, opacities, sh, to)


def check(path: Path, header: Header) -> Element:
    """Element ``vertex`` of a file of Gaussians.

    Raises:
        SceneError: it is something else; the line says what.
    """
    vertex = header.find("vertex")
    if vertex is None:
        found = ", ".join(e.name for e in header.elements[:8]) or "none"
        refuse(path, f"PLY file without an element vertex; its elements: {found}")
    if any(p.startswith("packed_") for p in vertex.properties):
        refuse(
            path,
            "compressed PLY (PlayCanvas, packed_* properties), which is not read yet; convert "
            "it with: splat-transform in.compressed.ply out.ply",
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
    if missing:
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
    from tsplat.io import plyrows

    header = plyrows.read_header(path)
    vertex = check(path, header)
    rest = rest_count(vertex.properties)
    if isinstance(rest, str):
        refuse(path, rest)
    with plyrows.open_rows(path, header, options.progress) as rows:
        sweeps = Sweeps(rows, options, _nothing if header.text else options.progress)
        builder, numbers = decode(sweeps, Layout(rows.dtype, rest), options)
    if options.raw_opacity and builder.dropped[OPACITY_RANGE] > len(builder):
        refuse(
            path,
            f"{builder.dropped[OPACITY_RANGE]} opacities lie outside 0..1, so they are logits; "
            "read the file without raw_opacity (--raw-opacity)",
        )
    if not len(builder):
        reasons = ", ".join(f"{r}: {n}" for r, n in builder.dropped.items() if r != SAMPLED)
        refuse(path, f"none of its Gaussians can be drawn ({reasons})")
    return builder.build(printable(path.name), numbers=numbers)


def _load() -> Read:
    import tsplat.io.plyrows  # noqa: F401 - plyfile, and what is wrong with it, now

    return read


def _nothing(done: int, total: int) -> None:
    pass


class Sweeps:
    """Goes through all rows, or an even sample of ``options.max_splats``, as often as needed."""

    def __init__(
        self, rows: Rows, options: ReadOptions, progress: Callable[[int, int], None]
    ) -> None:
        self._rows = rows
        self._progress = progress
        total = len(rows)
        self.count = min(options.max_splats or total, total)
        self.left_out = total - self.count
        self._picked = sample_rows(total, self.count) if self.left_out else None

    def _place(self, row: int) -> int:
        """Where ``row`` of the file, or the first one behind it that is picked, goes."""
        return row if self._picked is None else int(np.searchsorted(self._picked, row))

    def sweep(
        self, work: Callable[[slice, NDArray[np.void]], bool], before: int, goal: int
    ) -> None:
        """Calls ``work`` in threads with a slice of 0..count and its rows, until one says False.

        Progress goes from ``before`` to ``before + count`` of ``goal``.
        """
        rows, total = self._rows, len(self._rows)
        more = True
        workers = min(default_threads(), THREADS)
        # Made here: what a thread of a pool allocates for itself stays the process's, by and large.
        rooms: SimpleQueue[NDArray[np.void]] = SimpleQueue()
        for _ in range(workers):
            rooms.put(np.empty(min(CHUNK, total), rows.dtype))

        def piece(first: int) -> int:
            """Works on PIECE rows; returns where the rows behind them go."""
            nonlocal more
            end = min(first + PIECE, total)
            room = rooms.get()
            try:
                for start in range(first, end, CHUNK):
                    if not more:
                        break
                    stop = min(start + CHUNK, end)
                    part = slice(self._place(start), self._place(stop))
                    chunk = rows.read(start, stop, room)
                    if self._picked is not None:
                        chunk = chunk[self._picked[part] - start]
                    if not work(part, chunk):
                        more = False
            finally:
                rooms.put(room)
            return self._place(end)

        self._progress(before, goal)
        with ThreadPoolExecutor(workers, "tsplat-ply") as pool:
            for done in pool.map(piece, range(0, total, PIECE)):
                self._progress(before + done, goal)


def decode(sweeps: Sweeps, layout: Layout, options: ReadOptions) -> tuple[SceneBuilder, I32 | None]:
    """All rows, and which of them stands where if they are many: along a space-filling curve.

    Places are found in a sweep of its own that reads nothing but positions: reading a file twice
    takes less time than moving rows, and less memory. SH is in float16 if that will do, which is
    known at the end. If not, all is read again: keeping float32 as well until then would take more
    memory than the file.
    """
    numbers = places = None
    before, goal = 0, sweeps.count
    if sweeps.count >= curve.ROWS_MIN:
        before, goal = goal, 2 * goal
        numbers = _numbers(sweeps, layout, goal)
        places = curve.inverse(numbers)

    def decoded(half: bool) -> SceneBuilder:
        builder = SceneBuilder(sweeps.count, layout.coefficients, wide=layout.wide, half=half)
        if sweeps.left_out:
            builder.dropped[SAMPLED] = sweeps.left_out

        def add(part: slice, rows: NDArray[np.void]) -> bool:
            to = part if places is None else places[part]
            layout.add(builder, to, rows, options.raw_opacity)
            return builder.sh_error < SH_ERROR_MAX

        sweeps.sweep(add, before, goal)
        return builder

    builder = None if options.sh_float32 else decoded(half=True)
    if builder is None or builder.sh_error >= SH_ERROR_MAX:
        del builder  # its memory is needed
        builder = decoded(half=False)
    return builder, numbers


def _numbers(sweeps: Sweeps, layout: Layout, goal: int) -> I32:
    """Rows along the curve."""
    means = np.empty((sweeps.count, 3), np.float64 if layout.wide else np.float32)

    def keep(part: slice, rows: NDArray[np.void]) -> bool:
        means[part] = layout.means(rows)
        return True

    sweeps.sweep(keep, 0, goal)
    return curve.rows_along_curve(means)


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
