"""Fewer colours for pictures that move over slow links.

Half the pixels each way lose more than colours that are off by a thirtieth, and save less: a PNG of
16 shades a channel has 0.4 of the bytes of one of 256, at 36 dB. Cells send what has changed, and
less changes if what is nearly right may stay.
"""

from __future__ import annotations

import numpy as np

from tsplat.core.types import F32, Frame


def shaded(frame: Frame, shades: int, before: Frame | None) -> Frame:
    """``frame`` in so many shades of each channel, black and white among them.

    Pixels that ``before``, which is on the screen, shows with less than a shade's error stay as
    they are there.
    """
    steps = np.float32(shades - 1)
    shown: F32 = np.clip(frame.rgb, 0, 1).astype(np.float32)
    rgb: F32 = np.rint(shown * steps) / steps
    if before is not None and before.rgb.shape == frame.rgb.shape:
        near = (np.abs(shown - before.rgb) < 1 / steps).all(-1, keepdims=True)
        rgb = np.where(near, before.rgb, rgb).astype(np.float32)
    return Frame(rgb, frame.transmittance)
