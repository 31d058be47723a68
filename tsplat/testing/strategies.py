"""Hypothesis strategies that aim at what breaks renderers.

A scene is drawn as a few integers and switches and filled in by a seeded generator, so that
examples are cheap and shrink to few Gaussians and few oddities.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from tsplat.core.camera import Camera, look_at
from tsplat.core.constants import ALPHA_THRESHOLD
from tsplat.core.errors import CameraError
from tsplat.core.params import RenderParams
from tsplat.core.types import F32, F64, Scene

ODDITIES = (
    "equal depths",  # many Gaussians in planes; ties go by number
    "twins",  # the same Gaussian several times, in other colours
    "needles",  # one axis some 300 times the others
    "threads",  # one axis some 10,000 times the others, across the whole picture
    "discs",  # one axis 1000 times thinner
    "opaque",  # stacks that stop pixels early
    "walls",  # opaque and larger than the picture, so that alpha meets its cap
    "faint",  # alpha just above and below the threshold
    "tiny",  # far below a pixel
    "giants",  # cover the picture, some around the camera
    "behind",  # on and behind the near plane
    "far origin",  # centres at 1e6 units
    "bright",  # colours beyond 1
    "dark",  # colours clamped at 0
    "half",  # spherical harmonics in float16
    "shuffled",  # twins, their rows in any order with numbers that say how they tie
)


def _quats(rng: np.random.Generator, n: int) -> F32:
    quats = rng.normal(size=(n, 4))
    quats[np.linalg.norm(quats, axis=1) < 1e-3] = 1, 0, 0, 0
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return quats.astype(np.float32)


def _off_threshold(opacities: F64) -> F64:
    """Opacities kept 1 % off the alpha threshold: there a whole picture would be one crossing."""
    near = abs(opacities / ALPHA_THRESHOLD - 1) < 0.01
    return np.where(near, 1.02 * ALPHA_THRESHOLD, opacities)


def make_scene(seed: int, n: int, degree: int, oddities: frozenset[str]) -> Scene:
    """``n`` Gaussians about the origin (or about 1e6 units away), with the oddities named."""
    rng = np.random.default_rng(seed)

    def some() -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        return rng.uniform(size=n) < 0.4

    means = rng.uniform(-2, 2, (n, 3))
    scales = np.exp(rng.normal(-2, 0.8, (n, 3)))
    opacities = rng.uniform(0.02, 1, n)
    sh = rng.normal(0, 0.4, (n, (degree + 1) ** 2, 3))
    if "equal depths" in oddities:
        means = np.round(means)
    if "needles" in oddities:
        scales[some(), 0] *= 30
        scales[some(), 1] /= 10
    if "threads" in oddities:
        thread = some()
        scales[thread, 0] *= 100
        scales[thread, 1:] /= 100
    if "discs" in oddities:
        scales[some(), 2] *= 1e-3
    if "opaque" in oddities:
        opacities[some()] = 1.0
    if "walls" in oddities:
        wall = some()
        opacities[wall] = 1.0
        scales[wall] *= 50
    if "faint" in oddities:
        faint = some()
        opacities[faint] = ALPHA_THRESHOLD * rng.uniform(0.5, 2, faint.sum())
    if "tiny" in oddities:
        scales[some()] *= 1e-4
    if "giants" in oddities:
        scales[some()] *= 50
    if "behind" in oddities:
        means[some()] *= 3
    if "bright" in oddities:
        sh[some(), 0] += 4
    if "dark" in oddities:
        sh[some(), 0] -= 3
    quats = _quats(rng, n)
    if oddities & {"twins", "shuffled"} and n > 1:
        twin = some()
        means[twin], scales[twin], quats[twin] = means[0], scales[0], quats[0]
    origin = np.zeros(3)
    if "far origin" in oddities:
        origin = np.round(rng.uniform(-1e6, 1e6, 3))
    scene = Scene(
        means.astype(np.float32), quats, scales.astype(np.float32),
        _off_threshold(opacities).astype(np.float32),
        sh.astype(np.float16) if "half" in oddities else sh.astype(np.float32), origin,
    )  # fmt: skip
    return shuffled(scene, rng) if "shuffled" in oddities else scene


def shuffled(scene: Scene, rng: np.random.Generator) -> Scene:
    """The same picture from rows in another order: ties go by the order they had."""
    numbers = np.arange(len(scene), dtype=np.int32)
    return replace(scene, numbers=numbers).take(rng.permutation(len(scene)))


def scenes(max_gaussians: int = 60, max_degree: int = 3) -> st.SearchStrategy[Scene]:
    """Scenes of 0 to ``max_gaussians`` Gaussians with any of :data:`ODDITIES`."""
    return st.builds(
        make_scene,
        seed=st.integers(0, 2**32 - 1),
        n=st.integers(0, max_gaussians),
        degree=st.integers(0, max_degree),
        oddities=st.frozensets(st.sampled_from(ODDITIES), max_size=4),
    )


@st.composite
def cameras(draw: st.DrawFn, scene: Scene, max_size: int = 40) -> Camera:
    """A camera that looks at ``scene``'s origin from outside or inside.

    Sizes from 1x1, never only whole tiles; the principal point may be off centre and pixels need
    not be square.
    """
    width, height = draw(st.integers(1, max_size)), draw(st.integers(1, max_size))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    direction = rng.normal(size=3)
    distance = draw(st.sampled_from((0.5, 2.5, 6.0, 30.0)))
    eye = scene.origin + distance * direction / np.linalg.norm(direction)
    fov = draw(st.sampled_from((5.0, 50.0, 90.0, 140.0)))
    try:
        camera = look_at(eye, scene.origin, rng.normal(size=3), fov, width, height)
    except CameraError:  # up along the line of sight
        camera = look_at(eye, scene.origin, (0, -1, 0), fov, width, height)
    k = camera.K.copy()
    if draw(st.booleans()):
        k[:2, 2] += rng.uniform(-0.7, 0.7, 2) * (width, height)
    if draw(st.booleans()):
        k[0, 0] *= rng.uniform(0.5, 2)
    near = draw(st.sampled_from((0.01, 1.0)))
    return Camera(camera.viewmat, k, width, height, near)


def params() -> st.SearchStrategy[RenderParams]:
    """The contract's thresholds with any SH degree, antialiased or not, with depth or without.

    Mostly with all bits of depths.
    """
    return st.builds(
        RenderParams,
        sh_degree=st.integers(0, 3),
        antialias=st.booleans(),
        depth=st.booleans(),
        depth_bits=st.sampled_from((32, 32, 24, 16)),
    )
