"""A picture of fewer pixels, interpolated: ``RenderParams.scale``.

Bicubic with a = -1/2 (R. Keys, "Cubic Convolution Interpolation for Digital Image Processing",
1981, eq. 15), the border repeated. What overshoots below 0, and transmittance above 1, is cut off.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np

from tsplat.core.camera import Camera
from tsplat.core.types import F32, F64, I32, Floats, Frame
from tsplat.core.workspace import Workspace

TAPS = 4
"""Pixels that one is interpolated from, along each axis."""

ROWS = 16
"""Of the large picture at a time: they stay in the caches."""


def reduced(camera: Camera, scale: float) -> Camera:
    """``camera`` with ``scale`` times as many pixels each way, at least one."""
    width, height = (max(1, round(n * scale)) for n in (camera.width, camera.height))
    return camera.resized(width, height)


@lru_cache(maxsize=8)
def taps(few: int, many: int) -> tuple[I32, F32]:
    """Which of ``few`` pixels each of ``many`` is made of [many, TAPS], and their weights."""
    place = (np.arange(many) + 0.5) * few / many - 0.5
    first = np.floor(place).astype(np.int64) - 1
    which = first[:, None] + np.arange(TAPS)
    weights = _cubic(np.abs(place[:, None] - which))
    return np.clip(which, 0, few - 1).astype(np.int32), weights.astype(np.float32)


def _cubic(x: F64) -> F64:
    near = (1.5 * x - 2.5) * x * x + 1
    far = ((-0.5 * x + 2.5) * x - 4) * x + 2
    return np.where(x <= 1, near, far)


def upscale(frame: Frame, width: int, height: int, workspace: Workspace) -> Frame:
    """``frame`` at ``width`` x ``height`` pixels, in ``workspace``."""
    out = room(frame, width, height, workspace)
    columns, rows = taps(frame.width, width), taps(frame.height, height)
    starts = range(0, height, ROWS)
    for small, large, most in layers(frame, out):
        with ThreadPoolExecutor(workspace.threads) as pool:
            list(pool.map(lambda y, a=small, b=large, m=most: _stretch(a, b, columns, rows, y, m),
                          starts))  # fmt: skip
    return out


def room(frame: Frame, width: int, height: int, workspace: Workspace) -> Frame:
    """Memory for ``frame`` at another size."""
    depth = None
    if frame.depth is not None:
        depth = workspace.array("upscale.depth", (height, width), np.float32)
    return Frame(
        workspace.array("upscale.rgb", (height, width, 3), np.float32),
        workspace.array("upscale.transmittance", (height, width), np.float32),
        depth,
    )


def layers(frame: Frame, out: Frame) -> list[tuple[Floats, Floats, float]]:
    """What is interpolated [h, w, c], where it goes [H, W, c], and the most it may be."""
    pairs: list[tuple[Floats, Floats, float]] = [
        (frame.rgb, out.rgb, np.inf),
        (frame.transmittance[..., None], out.transmittance[..., None], 1.0),
    ]
    if frame.depth is not None and out.depth is not None:
        pairs.append((frame.depth[..., None], out.depth[..., None], np.inf))
    return pairs


def _stretch(
    small: Floats, large: Floats, columns: tuple[I32, F32], rows: tuple[I32, F32], y: int,
    most: float,
) -> None:  # fmt: skip
    """Rows ``y`` to ``y + ROWS`` of ``large``."""
    which, weights = (a[y : y + ROWS] for a in rows)
    high = small[which[:, 0]] * weights[:, 0, None, None]  # [ROWS, w, c]
    for k in range(1, TAPS):
        high += small[which[:, k]] * weights[:, k, None, None]
    which, weights = columns
    full = high[:, which[:, 0]] * weights[:, 0, None]
    for k in range(1, TAPS):
        full += high[:, which[:, k]] * weights[:, k, None]
    np.clip(full, 0, most, out=large[y : y + ROWS])
