"""A picture of fewer pixels, interpolated: ``RenderParams.scale``.

Bicubic with a = -1/2 (Catmull and Rom 1974; Keys 1981), by Pillow. What overshoots below 0, and
transmittance above 1, is cut off.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from tsplat.core.camera import Camera
from tsplat.core.types import F32, Floats, Frame
from tsplat.core.workspace import Workspace


def reduced(camera: Camera, scale: float) -> Camera:
    """``camera`` with ``scale`` times as many pixels each way, at least one."""
    width, height = (max(1, round(n * scale)) for n in (camera.width, camera.height))
    return camera.resized(width, height)


def upscale(frame: Frame, width: int, height: int, workspace: Workspace) -> Frame:
    """``frame`` at ``width`` x ``height`` pixels, in ``workspace``, layer by layer."""
    rgb = workspace.array("upscale.rgb", (height, width, 3), np.float32)
    transmittance = workspace.array("upscale.transmittance", (height, width), np.float32)
    jobs: list[tuple[Floats, F32, float]] = [
        (frame.rgb[..., c], rgb[..., c], np.inf) for c in range(3)
    ]
    jobs.append((frame.transmittance, transmittance, 1.0))
    depth = None
    if frame.depth is not None:
        depth = workspace.array("upscale.depth", (height, width), np.float32)
        jobs.append((frame.depth, depth, np.inf))
    with ThreadPoolExecutor(workspace.threads) as pool:
        list(pool.map(lambda job: _stretch(*job), jobs))
    return Frame(rgb, transmittance, depth)


def _stretch(layer: Floats, out: F32, most: float) -> None:
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(layer, np.float32))
    height, width = out.shape
    np.clip(np.asarray(image.resize((width, height), Image.Resampling.BICUBIC)), 0, most, out=out)
