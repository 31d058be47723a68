"""A scene with less in it, as ``RenderParams`` asks: ``share`` and ``half``."""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from tsplat.core.params import RenderParams
from tsplat.core.types import Scene
from tsplat.quality.thin import thin

HALF_MAX = float(np.finfo(np.float16).max)

_halved: WeakKeyDictionary[Scene, Scene] = WeakKeyDictionary()


def lighter(scene: Scene, params: RenderParams) -> Scene:
    """What is drawn instead of ``scene``; itself if nothing is asked for. Kept while it lives."""
    scene = thin(scene, params.share)
    if not params.half or scene.sh.dtype == np.float16:
        return scene
    if scene not in _halved:
        sh = np.clip(scene.sh, -HALF_MAX, HALF_MAX).astype(np.float16)
        _halved[scene] = replace(scene, sh=sh)
    return _halved[scene]
