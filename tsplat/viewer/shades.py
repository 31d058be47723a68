"""Fewer colours for pictures that move over slow links.

Half the pixels each way lose more than colours that are off by a thirtieth, and save less: a PNG of
16 shades a channel has 0.4 of the bytes of one of 256, at 36 dB. Cells send what has changed, and
less changes if what is nearly right may stay.
"""

from __future__ import annotations

import numpy as np

from tsplat.core.types import F32, Frame


def shaded(
    frame: Frame, shades: int, before: Frame | None, cell: tuple[int, int] = (1, 1)
) -> Frame:
    """``frame`` in so many shades of each channel, black and white among them.

    Cells, of ``cell`` px each way, that ``before``, which is on the screen, shows with less than a
    shade's error in each pixel stay as they are there. ``frame`` is of whole cells.
    """
    steps = np.float32(shades - 1)
    shown: F32 = np.clip(frame.rgb, 0, 1).astype(np.float32)
    rgb: F32 = np.rint(shown * steps) / steps
    if before is not None and before.rgb.shape == frame.rgb.shape:
        near = np.all(np.abs(shown - before.rgb) < 1 / steps, axis=-1)
        wide, high = cell
        if cell != (1, 1):
            rows, columns = near.shape[0] // high, near.shape[1] // wide
            cells = near.reshape(rows, high, columns, wide).all((1, 3))
            near = cells.repeat(high, 0).repeat(wide, 1)
        rgb = np.where(near[..., None], before.rgb, rgb).astype(np.float32)
    return Frame(rgb, frame.transmittance)
