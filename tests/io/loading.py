"""What tests of readers share: a refusal's line, and that damage gives a scene or a line."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from tsplat.core.errors import SceneError
from tsplat.io import load_scene


def refusal(path, **options) -> str:
    """The one printable line that load_scene refuses ``path`` with."""
    with pytest.raises(SceneError) as caught:
        load_scene(path, **options)
    text = str(caught.value)
    assert text.isprintable(), text
    assert text.startswith(str(path)[:40])
    assert len(text) < 700
    return text


def scene_or_line(path) -> None:
    """A Scene of finite numbers or a one-line SceneError, and little memory for either."""
    size = path.stat().st_size if path.is_file() else 0
    tracemalloc.start()
    line, arrays = "", ()
    try:
        scene = load_scene(path, sh_float32=True)
        arrays = (scene.means, scene.quats, scene.scales, scene.opacities, scene.sh)
    except SceneError as error:
        line = str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert line.isprintable()
    assert all(np.isfinite(array).all() for array in arrays)
    assert peak < 4 * size + (64 << 20), f"{peak} bytes at most for a file of {size}"


def in_file_order(scene):
    """The scene with its rows as they were in the file."""
    return scene if scene.numbers is None else scene.take(np.argsort(scene.numbers))


def covariances(scene):
    """[N, 3, 3], which do not depend on the sign of a quaternion or the order of its axes."""
    from tsplat.core.reference import rotations

    half = rotations(scene.quats) * scene.scales[:, None].astype(np.float64)
    return half @ half.transpose(0, 2, 1)
