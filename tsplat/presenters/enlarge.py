"""A frame of fewer pixels at the size of the screen's picture: each pixel repeated.

For presenters whose terminal cannot do it. Not interpolated: blocks of one colour are what runs,
palettes and half blocks say in few bytes.
"""

from __future__ import annotations

import numpy as np

from tsplat.core.types import I64, Frame


def edges(few: int, many: int) -> I64:
    """Where each of ``few`` pixels begins among ``many``, and the end: [few + 1].

    A pixel's part is those whose centres lie in it.
    """
    return (2 * np.arange(few + 1, dtype=np.int64) * many + few - 1) // (2 * few)


def enlarged(frame: Frame, width: int, height: int) -> Frame:
    """``frame`` at ``width`` x ``height`` px, no fewer than it has; without its depth."""
    rows, columns = (
        np.repeat(np.arange(few), np.diff(edges(few, many)))
        for few, many in ((frame.height, height), (frame.width, width))
    )
    return Frame(frame.rgb[rows][:, columns], frame.transmittance[rows][:, columns])
