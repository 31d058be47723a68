"""What a screen should show: pictures by ``tsplat render``, and how far another is from one."""

from __future__ import annotations

import json
import math
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from tests.real.desk import tsplat
from tsplat.core.camera import intrinsics
from tsplat.demo import demo_scene
from tsplat.io.cameras import camera_to_json
from tsplat.views import FOV, YAW, frame_scene

ASIDE = math.radians(20)  # where the second camera stands


def psnr(got: np.ndarray, wanted: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB of 8-bit pictures of one shape."""
    assert got.shape == wanted.shape, (got.shape, wanted.shape)
    error = np.mean((got.astype(float) - wanted) ** 2)
    return math.inf if error == 0 else float(10 * np.log10(255**2 / error))


def readable(file: Path) -> np.ndarray | None:
    """The picture in ``file``, uint8 [H, W, 3]; None while it is being written."""
    try:
        with Image.open(file) as image:
            return np.asarray(image.convert("RGB"))
    except (OSError, SyntaxError):
        return None


class Pictures:
    """The demo scene's, each rendered once, from cameras worked out here, not by the viewer."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._scene = folder, demo_scene()
        self._made: dict[tuple[str, ...], np.ndarray] = {}

    def camera(self, first: tuple[int, int], window: tuple[int, int], aside: bool = False) -> Path:
        """A file with the camera that frames the scene in ``first`` px, in a window of any size.

        ``aside``: from farther round.
        """
        camera = frame_scene(self._scene, *first, yaw=YAW + ASIDE * aside)
        camera = replace(camera, K=intrinsics(*window, FOV), width=window[0], height=window[1])
        file = self._folder / "{}x{}-{}x{}-{}.json".format(*first, *window, aside)
        file.write_text(json.dumps([camera_to_json(camera)]))
        return file

    def render(self, size: tuple[int, int], *words: object, samples: int = 1) -> np.ndarray:
        """By the program; uint8 [H, W, 3], each pixel the mean of ``samples`` x ``samples``."""
        key = ("--size", "{}x{}".format(*(n * samples for n in size)), *map(str, words))
        if key not in self._made:
            out = self._folder / f"{len(self._made)}.npy"
            subprocess.run([*tsplat(), "render", "-o", out, *key], check=True, capture_output=True)
            width, height = size
            parts = np.load(out)[..., :3].clip(0, 1).reshape(height, samples, width, samples, 3)
            self._made[key] = np.floor(parts.mean((1, 3)) * 255 + 0.5).astype(np.uint8)
        return self._made[key]
