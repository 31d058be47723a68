"""INRIA's PLY: one row of float32 a Gaussian, nothing quantised.

Layout: graphdeco-inria/gaussian-splatting ``scene/gaussian_model.py``, ``save_ply``: x y z, normals
of zero, f_dc, f_rest (channel-major), opacity (logit), scale (natural logarithms), rot (w, x, y,
z). A scene far from zero has x y z as doubles, which every reader by name takes; of a scene that
was read from such a file, each number is the file's own.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from tsplat.core.errors import OutputError
from tsplat.core.types import F32
from tsplat.io.write.base import (
    CEILING,
    FLOOR,
    WriteOptions,
    Written,
    comments,
    logits,
    logs,
    parts,
)
from tsplat.io.write.source import Source, Verbatim


def _dtype(source: Source) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("xyz", "<f8" if source.wide else "<f4", 3),
            ("normal", "<f4", 3),
            ("dc", "<f4", 3),
            ("rest", "<f4", 3 * (source.coefficients - 1)),
            ("opacity", "<f4"),
            ("scale", "<f4", 3),
            ("rot", "<f4", 4),
        ]
    )


def header(source: Source) -> bytes:
    """All before the first row."""
    position = "double" if source.wide else "float"
    names = [
        *(f"property {position} {name}" for name in "xyz"),
        *(f"property float {name}" for name in ("nx", "ny", "nz")),
        *(f"property float f_dc_{i}" for i in range(3)),
        *(f"property float f_rest_{i}" for i in range(3 * (source.coefficients - 1))),
        "property float opacity",
        *(f"property float scale_{i}" for i in range(3)),
        *(f"property float rot_{i}" for i in range(4)),
    ]
    lines = ["ply", "format binary_little_endian 1.0", *comments(source)]
    lines += [f"element vertex {len(source)}", *names]
    return "\n".join([*lines, "end_header", ""]).encode()


def write(source: Source, out: BinaryIO, options: WriteOptions) -> Written:
    """See :class:`tsplat.io.write.base.Write`."""
    out.write(header(source))
    dtype = _dtype(source)
    count = len(source)
    if source.verbatim is None:
        for part in parts(count):
            out.write(_rows(source, part, dtype).data)
            options.progress(part.stop, count)
    else:
        if len(source.verbatim) != count:
            raise OutputError("the file that is read has changed meanwhile; convert it again")
        for part, rows in _verbatim(source, source.verbatim, dtype):
            out.write(rows.data)
            options.progress(part.stop, count)
    return Written(f"PLY, SH {source.degree}", None, _notes(source))


def _rows(source: Source, part: slice, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    rows = np.zeros(part.stop - part.start, dtype)
    rows["xyz"] = source.means(part)
    rows["opacity"] = logits(source.opacities(part))
    rows["scale"] = logs(source.scales(part))
    rows["rot"] = source.quats(part)
    _put_sh(rows, source.sh(part))
    return rows


def _verbatim(
    source: Source, verbatim: Verbatim, dtype: np.dtype[np.void]
) -> Iterator[tuple[slice, NDArray[np.void]]]:
    """Rows of the file that was read; of what the edits change, the source's."""
    grown = np.log(source.edits.splat_scale)
    for part, found in verbatim.pieces():
        rows = np.zeros(part.stop - part.start, dtype)
        rows["xyz"] = found.means
        rows["rot"] = found.quats
        with np.errstate(over="ignore", under="ignore"):  # of doubles; logits may be infinite
            rows["opacity"] = found.logits
            rows["scale"] = found.logs + grown if grown else found.logs
        same = source.edits.saturation == 1
        _put_sh(rows, found.sh[:, : source.coefficients] if same else source.sh(part))
        yield part, rows


def _put_sh(rows: NDArray[np.void], sh: F32) -> None:
    rows["dc"] = sh[:, 0]
    if sh.shape[1] > 1:
        rows["rest"] = sh[:, 1:].transpose(0, 2, 1).reshape(len(sh), -1)


def _notes(source: Source) -> tuple[str, ...]:
    notes = []
    if source.wide:
        notes.append("positions are doubles: float32 would lose detail this far from zero")
    if source.verbatim is not None:
        notes += [f"left out: {what}" for what in source.verbatim.passed_over]
    else:
        for part in parts(len(source)):
            if (source.opacities(part) == 1).any() or (source.opacities(part) == 0).any():
                notes.append(
                    f"opacities of exactly 0 and 1 are logits of {FLOOR:g} and {CEILING:g}"
                )
                break
    return tuple(notes)
