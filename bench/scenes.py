"""Scenes to time: four that are made up, and any file.

``random``: a box of Gaussians with nothing hidden behind anything for long, the tutorial's kind.
``surface``: what training makes of a room: flat surfels on floors and balls, foliage, a far shell,
sizes spread log-normally, a few needles, most of it opaque.
``cloud``: opaque balls, of which some ten hide what is behind, and whose faint rims are all that
the sides of the picture see.
``stack``: opaque balls that each fill the picture, one behind the other: a few hide the rest.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import tsplat
from tsplat.core.camera import Camera, Orbit
from tsplat.core.types import Scene

UP = np.array([0.0, -1.0, 0.0])


def _scene(name: str, means, scales, opacities, colors, rng) -> Scene:
    quats = rng.normal(size=(len(means), 4))
    sh = (colors - 0.5) / 0.28209479177387814
    return tsplat.scene_from_arrays(
        means.astype(np.float32), quats, scales, opacities, sh[:, None, :], name=name
    )


def random(n: int) -> Scene:
    """Uniform in a box of 40 units; sizes about 0.05, opacities mostly low."""
    rng = np.random.default_rng(1)
    return _scene(
        f"random {n:,}", rng.uniform(-20, 20, (n, 3)), np.exp(rng.normal(-3, 0.7, (n, 3))),
        np.clip(rng.uniform(size=n) ** 2, 0.01, 0.99), rng.uniform(size=(n, 3)), rng,
    )  # fmt: skip


def surface(n: int) -> Scene:
    """35 % floor, 35 % balls, 20 % foliage, 10 % shell at 60 units."""
    rng = np.random.default_rng(2)
    kind = rng.choice(4, n, p=[0.35, 0.35, 0.2, 0.1])
    ball = rng.uniform(-8, 8, (12, 3)) * [1, 0.2, 1]
    where = ball[rng.integers(0, len(ball), n)]
    around = rng.normal(size=(n, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    floor = np.stack(
        [rng.uniform(-20, 20, n), rng.normal(2, 0.02, n), rng.uniform(-20, 20, n)], axis=1
    )
    places = np.stack([floor, where + 1.5 * around, where + rng.normal(size=(n, 3)), 60 * around])
    means = places[kind, np.arange(n)]
    flat = np.exp(rng.normal([0, -0.5, -2.5], [1e-9, 0.5, 0.6], (n, 3)))
    scales = flat * np.exp(rng.normal(-3.6, 0.8, (n, 1))) * np.where(kind == 3, 12, 1)[:, None]
    scales[rng.uniform(size=n) < 0.02, 0] *= 20
    solid = rng.uniform(size=n) < 0.55
    opacities = np.where(solid, rng.beta(8, 1.2, n), rng.beta(1, 6, n))
    return _scene(
        f"surface {n:,}", means, scales, np.clip(opacities, 0.005, 0.999),
        rng.uniform(size=(n, 3)), rng,
    )  # fmt: skip


def _balls(name: str, n: int, size: float) -> Scene:
    rng = np.random.default_rng(3)
    return _scene(
        f"{name} {n:,}", rng.uniform(-10, 10, (n, 3)), np.full((n, 3), size), np.full(n, 0.99),
        rng.uniform(size=(n, 3)), rng,
    )  # fmt: skip


def cloud(n: int) -> Scene:
    """Balls of 2 units in a box of 20, nearly opaque."""
    return _balls("cloud", n, 2.0)


def stack(n: int) -> Scene:
    """Balls of 10 units in a box of 20, nearly opaque."""
    return _balls("stack", n, 10.0)


MADE: dict[str, tuple[Callable[[int], Scene], float]] = {
    "random": (random, 55.0), "surface": (surface, 34.0),
    "cloud": (cloud, 25.0), "stack": (stack, 25.0),
}  # fmt: skip
"""Name -> maker, and how far away the camera stands."""


def load(spec: str) -> tuple[Scene, Callable[[int, int], Camera]]:
    """``random:200000`` or a file, and a function from width and height to its camera."""
    name, _, count = spec.partition(":")
    if name in MADE and count.isdigit():
        make, distance = MADE[name]
        orbit = Orbit(np.zeros(3), distance, 0.6, 0.35, UP)
        return make(int(count)), lambda width, height: orbit.camera(55, width, height)
    scene = tsplat.load_scene(spec)
    return scene, lambda width, height: tsplat.frame_scene(scene, width, height)
