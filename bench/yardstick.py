"""The yardstick: a plain C pipeline that others' speed is quoted against, if it is at hand.

It is not part of tsplat. ``$TSPLAT_YARDSTICK`` or ``../shared/baseline`` names a folder with
``baseline.py``, whose ``Baseline().frame(...)`` renders approximately, with band 0 only, and
returns its seconds per stage.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
from pathlib import Path

import numpy as np

from tsplat.core.camera import Camera
from tsplat.core.types import Frame, Scene

SH_C0 = 0.28209479177387814


class FloatingPoint:
    """How this thread rounds and what it does below the normal numbers, to be put back."""

    def __init__(self) -> None:
        self._kept = ctypes.create_string_buffer(64)  # more than any fenv_t
        self._libm = ctypes.CDLL(None)
        self._libm.fegetenv(self._kept)

    def restore(self) -> None:
        """As it was when this was made."""
        self._libm.fesetenv(self._kept)


class Yardstick:
    """Times frames of the yardstick."""

    def __init__(self, folder: Path) -> None:
        usual = FloatingPoint()  # -ffast-math makes a library flush small numbers to 0 for all
        spec = importlib.util.spec_from_file_location("baseline", folder / "baseline.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        self._baseline = module.Baseline()
        self._fast = FloatingPoint()
        usual.restore()

    def frame(self, scene: Scene, camera: Camera, threads: int) -> tuple[Frame, dict[str, float]]:
        """A picture, and its seconds per stage and in total."""
        view = camera.viewmat.copy()
        view[:3, 3] += camera.rotation @ scene.origin
        colors = np.clip(0.5 + SH_C0 * scene.sh[:, 0], 0, 1)
        usual = FloatingPoint()
        self._fast.restore()
        rgba, seconds = self._baseline.frame(
            scene.means, scene.quats, scene.scales, colors, scene.opacities,
            view, camera.K, camera.width, camera.height, threads,
        )  # fmt: skip
        usual.restore()
        del seconds["visible"]
        return Frame(rgba[..., :3], 1 - rgba[..., 3]), seconds


def find() -> Yardstick | None:
    """The yardstick, or None where there is none."""
    default = Path(__file__).resolve().parents[2] / "shared" / "baseline"
    folder = Path(os.environ.get("TSPLAT_YARDSTICK") or default)
    return Yardstick(folder) if (folder / "baseline.py").is_file() else None
