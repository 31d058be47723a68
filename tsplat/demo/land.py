"""The ground: where water, meadow and rim are; grass and flowers."""

from __future__ import annotations

import numpy as np

from tsplat.core.types import F64
from tsplat.demo.light import SUN, Lights, flat, lobe
from tsplat.demo.parts import (
    UP,
    Part,
    gaussians,
    join,
    lattice,
    mix,
    noise,
    smooth,
    surfels,
    unit,
    xyz,
)

POND = np.array([-0.98, -0.34])  # x, z
TREE = np.array([0.88, 0.20])
FALL = unit([-0.93, -0.36])  # where the brook runs to
LIP = 1.36  # how far from the pond's middle it falls


def _rim_table() -> F64:
    angle = 2 * np.pi * np.arange(1024) / 1024
    wave = 0.08 * np.sin(2 * angle + 0.4) + 0.06 * np.sin(3 * angle + 2.1)
    wave += 0.04 * np.sin(5 * angle + 1.0) + 0.025 * np.sin(11 * angle + 0.3)
    return np.asarray(2.3 * (1 + wave + 0.012 * np.sin(23 * angle)), np.float64)


_RIM = _rim_table()


def rim(angle: F64) -> F64:
    """Radius of the island in a direction."""
    place = angle * (len(_RIM) / (2 * np.pi))
    i = np.floor(place).astype(np.int64)
    t = place - i
    return _RIM[i % len(_RIM)] * (1 - t) + _RIM[(i + 1) % len(_RIM)] * t


def to_water(x: F64, z: F64) -> F64:
    """About the distance to the water's edge; negative on the water."""
    dx, dz = x - POND[0], z - POND[1]
    angle = np.arctan2(dz, dx)
    bend = 1 + 0.06 * np.sin(3 * angle + 1.0) + 0.03 * np.sin(7 * angle)
    pond = (np.hypot(dx / 0.92, dz / 0.84) / bend - 1) * 0.75
    along = dx * FALL[0] + dz * FALL[1]
    across = np.abs(dz * FALL[0] - dx * FALL[1] + 0.05 * np.sin(5 * along))
    brook = np.where(along > 0, across - 0.15, 9.0)
    near = np.clip(0.5 + (brook - pond) / 0.3, 0, 1)
    return np.asarray(brook + (pond - brook) * near - 0.15 * near * (1 - near), np.float64)


def ground_height(x: F64, z: F64) -> F64:
    """Height of the meadow above the water."""
    water = to_water(x, z)
    ragged = noise(np.stack([x, 0 * x, z], 1), 3.0, 3, 11)
    hill = 0.26 * np.exp(-((x - TREE[0]) ** 2 + (z - TREE[1]) ** 2) / 0.7)
    height = (
        0.07 * smooth(-0.02, 0.18, water) - 0.02 + hill + 0.045 * smooth(0, 0.5, water) * ragged
    )
    return np.asarray(height - 0.10 * _edge(x, z) ** 2 * smooth(0, 0.2, water), np.float64)


def _edge(x: F64, z: F64) -> F64:
    """0 inland, 1 on the rim."""
    return smooth(0.84, 1.0, np.hypot(x, z) / rim(np.arctan2(z, x)))


def on_ground(x: F64, z: F64) -> tuple[F64, F64]:
    """Points and normals of the meadow."""
    e, height = 0.01, ground_height(x, z)
    slope_x = (ground_height(x + e, z) - height) / e
    slope_z = (ground_height(x, z + e) - height) / e
    return xyz(x, height, z), unit(np.stack([-slope_x, -np.ones_like(x), -slope_z], 1))


def disc(n: int) -> tuple[F64, F64]:
    """x, z of n points spread over the island."""
    u, v = lattice(n)
    angle = 2 * np.pi * u
    radius = np.sqrt(v) * rim(angle)
    return radius * np.cos(angle), radius * np.sin(angle)


def meadow_colour(points: F64) -> F64:
    """Patches of deep and of yellowish green."""
    patches = noise(points, 1.7, 2, 21)
    green = mix([0.13, 0.33, 0.17], [0.36, 0.47, 0.16], smooth(-0.7, 0.8, patches))
    return green * (1 + 0.16 * noise(points, 9.0, 1, 22))[:, None]


def meadow(lights: Lights) -> Part:
    """The ground: opaque surfels, soil at the water's edge and on the rim."""
    x, z = disc(10500)
    water = to_water(x, z)
    dry = water > -0.035
    x, z, water = x[dry], z[dry], water[dry]
    points, normals = on_ground(x, z)
    soil = mix([0.30, 0.23, 0.22], [0.46, 0.36, 0.28], smooth(-1, 1, noise(points, 8.0, 2, 23)))
    bare = np.maximum(1 - smooth(0.015, 0.08, water), smooth(0.8, 1.0, _edge(x, z)))
    albedo = meadow_colour(points) * 0.9
    albedo += (soil - albedo) * bare[:, None]
    rgb = lights.shade(points, normals, albedo, 0.75, shadow=0.8)
    return surfels(points, normals, 0.051, flat(rgb))


def grass(lights: Lights) -> Part:
    """Blades: two needles each, dark at the root, bent and bright at the tip; lit from behind."""
    rng = np.random.default_rng(5)
    x, z = disc(14000)
    x, z = x + rng.normal(0, 0.03, len(x)), z + rng.normal(0, 0.03, len(x))
    points = xyz(x, 0, z)
    tuft = noise(points, 5.0, 2, 31)
    inside = np.hypot(x, z) < 0.995 * rim(np.arctan2(z, x))
    grown = inside & (to_water(x, z) > 0.045) & (0.6 * tuft + rng.uniform(-0.5, 0.7, len(x)) > -0.8)
    x, z, tuft = x[grown], z[grown], tuft[grown]
    roots, normals = on_ground(x, z)
    n = len(roots)
    wind = np.stack([noise(roots, 1.6, 1, 32), np.zeros(n), noise(roots, 1.6, 1, 33)], 1)
    lean = rng.normal(0, 0.34, (n, 3)) + 0.25 * wind + normals * [0.5, 0, 0.5]
    lean += 0.5 * _edge(x, z)[:, None] * unit(roots * [1, 0, 1])
    tall = (
        (0.085 + 0.02 * _edge(x, z)) * rng.uniform(0.5, 1.25, n) * (1 + 0.35 * np.clip(tuft, -1, 1))
    )
    rising = unit(UP + lean * [1, 0.2, 1])
    bent = unit(UP * 0.85 + 2.0 * lean * [1, 0.2, 1])
    knee = roots + rising * tall[:, None]
    colour = meadow_colour(roots) * rng.uniform(0.75, 1.35, (n, 1))
    soft = unit(normals + 0.5 * lean)
    shaded = lights.shade(roots, soft, colour, 0.8, wrap=0.6, shadow=0.75)
    lit = shaded.sum(1) / colour.sum(1)
    root, tip = flat(shaded * 0.62), flat(shaded * [1.22, 1.2, 0.95])
    tip += lobe(SUN, [0.30, 0.22, 0.05], 3.0) * lit.astype(np.float32)[:, None, None]
    low = gaussians(roots + rising * (0.5 * tall)[:, None], rising, 0.0021, 0.36 * tall, 0.9, root)
    high = gaussians(knee + bent * (0.35 * tall)[:, None], bent, 0.0014, 0.32 * tall, 0.88, tip)
    return join([low, high])


def flowers(lights: Lights) -> Part:
    """Specks of colour in drifts."""
    rng = np.random.default_rng(6)
    x, z = disc(5200)
    x, z = x + rng.normal(0, 0.05, len(x)), z + rng.normal(0, 0.05, len(x))
    drift = noise(xyz(x, 0, z), 2.6, 2, 41)
    keep = (
        (drift > 0.45) & (to_water(x, z) > 0.08) & (np.hypot(x, z) < 0.95 * rim(np.arctan2(z, x)))
    )
    points, normals = on_ground(x[keep], z[keep])
    points += UP * rng.uniform(0.07, 0.15, (len(points), 1))
    petals = np.array([[1.0, 0.93, 0.86], [1.0, 0.78, 0.30], [0.72, 0.50, 0.98]])
    albedo = petals[rng.integers(0, 3, len(points))] * 1.15
    tilted = unit(normals + rng.normal(0, 0.35, normals.shape))
    rgb = lights.shade(points, tilted, albedo, 1.0, wrap=0.8, shadow=0.5)
    return gaussians(points, tilted, 0.011, 0.004, 0.97, flat(rgb))
