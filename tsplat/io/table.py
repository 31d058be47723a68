"""Numbers of Gaussians, unpacked from whatever a file has them in, -> rows of a SceneBuilder.

A format that packs its numbers unpacks a chunk of them into a table of float32; C reads that like
the rows of a PLY file, or NumPy where there is no C.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tsplat.core.constants import SH_C0
from tsplat.core.types import F32, I32, Floats
from tsplat.io import native
from tsplat.io.clean import SceneBuilder

if TYPE_CHECKING:
    from tsplat.io.turn import Turn

MEAN, QUAT, SCALE = slice(0, 3), slice(3, 7), slice(7, 10)
OPACITY = slice(10, 11)
DC, REST = slice(11, 14), slice(14, None)
"""Columns of a table. Scales are linear, opacities 0..1; ``REST`` is in the format's own order."""

LEVELS = (np.arange(256)[None] / 255).astype(np.float32)
COLORS = ((np.arange(256)[None] / 255 - 0.5) / SH_C0).astype(np.float32)
"""[1, 256] a byte as an opacity, and as the coefficient ``f_dc`` of a colour."""


class Tables:
    """Tables of Gaussians of K coefficients each."""

    def __init__(self, rest: NDArray[np.integer] | None = None) -> None:
        """``rest`` [K - 1, 3]: which of the columns ``REST`` a coefficient of r, g or b is in."""
        self._rooms = threading.local()
        order = np.empty((0, 3), np.intp) if rest is None else rest
        self.coefficients = 1 + len(order)
        self._sh = np.concatenate([np.arange(11, 14), 14 + order.reshape(-1)])
        self._decoder = None
        self._decoder = native.table_decoder(np.concatenate([np.arange(11), self._sh]))

    def room(self, count: int) -> F32:
        """A table [count, 11 + 3 K] to be filled; this thread's last one is then no more.

        Kept, because fresh pages would take as long as what is written to them.
        """
        room: F32 | None = getattr(self._rooms, "room", None)
        if room is None or len(room) < count:
            room = np.empty((count, 11 + 3 * self.coefficients), np.float32)
            self._rooms.room = room
        return room[:count]

    def put(
        self, builder: SceneBuilder, to: slice | I32, table: F32, means: Floats | None = None
    ) -> None:
        """Puts ``table`` into rows ``to`` of ``builder``; float64 ``means`` [n, 3] go first."""
        if self._decoder and means is None and builder.decode(self._decoder, table, to):
            return
        sh = table[:, self._sh].reshape(len(table), -1, 3)
        builder.add(
            table[:, MEAN] if means is None else means, table[:, QUAT], table[:, SCALE],
            table[:, OPACITY.start], sh, to,
        )  # fmt: skip


def in_order(coefficients: int) -> Tables:
    """Tables whose columns ``REST`` are r, g, b of one coefficient after the other."""
    return Tables(np.arange(3 * coefficients - 3).reshape(-1, 3))


def turned(table: F32, turn: Turn) -> Floats | None:
    """Turns what is in ``table``, one of :func:`in_order`.

    Returns:
        [n, 3] the means in float64, unless only signs have changed.
    """
    if turn.signs is not None:
        if (turn.signs < 0).any():
            table *= turn.signs[: table.shape[1]]
        return None
    means = turn.means(table[:, MEAN])
    table[:, MEAN] = means
    quats = turn.quats(table[:, QUAT].astype(np.float64))
    largest = np.abs(quats).max(1, keepdims=True)  # of any length: float32 might not hold it
    table[:, QUAT] = quats / np.where(largest > 0, largest, 1)
    table[:, SCALE] = turn.scales(table[:, SCALE])
    sh = table[:, DC.start :]
    sh[:] = turn.sh(sh.reshape(len(sh), -1, 3).copy()).reshape(sh.shape)
    return means
