"""antimatter15's .splat: 32 bytes a Gaussian, colours from one direction.

Layout: see :mod:`tsplat.io.splat`. Bytes are rounded to nearest; antimatter15's ``convert.py`` cuts
them off. Viewers do not normalise quaternions (``main.js``), and 1 is beyond the bytes of
``(byte - 128) / 128``, but -1 is not: the largest component is written negative.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from tsplat.core.constants import SH_C0
from tsplat.core.errors import OutputError
from tsplat.core.types import F64
from tsplat.io.splat import ROW
from tsplat.io.write.base import Clipped, WriteOptions, Written, parts, unsaid
from tsplat.io.write.source import Source


def write(source: Source, out: BinaryIO, options: WriteOptions) -> Written:
    """See :class:`tsplat.io.write.base.Write`."""
    notes = list(_far(source))
    clipped = Clipped()
    for part in parts(len(source)):
        rows = np.empty(part.stop - part.start, ROW)
        rows["means"] = source.means(part)
        rows["scales"] = source.scales(part)
        colors = 0.5 + SH_C0 * source.sh(part)[:, 0].astype(np.float64)
        clipped.see("base colours are outside 0..1 and clipped", _outside(colors), 0.5 / 255)
        rgba = np.concatenate([colors, source.opacities(part)[:, None]], 1)
        rows["rgba"] = np.clip(np.rint(rgba * 255), 0, 255)
        quats = source.quats(part).astype(np.float64)
        largest = np.abs(quats).argmax(1)
        quats *= np.where(quats[np.arange(len(quats)), largest] > 0, -1, 1)[:, None]
        rows["quats"] = np.clip(np.rint(quats * 128 + 128), 0, 255)
        out.write(rows.data)
        options.progress(part.stop, len(source))
    if source.given.sh_degree:
        notes.append(f"harmonics of degree 1 to {source.given.sh_degree} are left out")
    notes += unsaid(source, "a .splat file", antialias=False)
    return Written(".splat", None, (*notes, *clipped.notes()))


def _outside(colors: F64) -> F64:
    """How far each value is outside 0..1."""
    return np.asarray(np.maximum(colors - 1, -colors))


def _far(source: Source) -> tuple[str, ...]:
    """What rounding positions to float32 costs.

    Raises:
        OutputError: more than a typical Gaussian's size.
    """
    if not source.wide:
        return ()
    off, size = source.reach() * 2.0**-24, source.typical_scale()
    if off > size:
        raise OutputError(
            f"positions {source.reach():.3g} from zero are off by up to {off:.3g} in float32, a "
            f"typical Gaussian has a size of {size:.3g}; write .ply, which has doubles then"
        )
    return (f"positions are rounded to float32: off by up to {off:.3g}",)
