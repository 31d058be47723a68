"""Around the island: stars, a nebula, the moon, clouds, fireflies."""

from __future__ import annotations

import numpy as np

from tsplat.demo.light import MOON, SUN, flat, lobe
from tsplat.demo.parts import (
    Part,
    blobs,
    cover,
    join,
    mix,
    noise,
    smooth,
    sphere,
    surfels,
    unit,
    xyz,
)

FAR = 42.0


def stars() -> Part:
    """Pin-pricks all around; far beyond what is framed."""
    rng = np.random.default_rng(30)
    n = 900
    points = FAR * unit(rng.normal(size=(n, 3)))
    bright = rng.uniform(0, 1, n) ** 3
    rgb = mix([0.62, 0.72, 1.0], [1.0, 0.86, 0.70], rng.uniform(0, 1, n))
    return blobs(points, 0.022 + 0.030 * bright, 0.12 + 0.8 * bright, flat(rgb))


def nebula() -> Part:
    """A faint band of dusk behind everything."""
    rng = np.random.default_rng(31)
    n = 90
    angle = rng.uniform(0, 2 * np.pi, n)
    band = xyz(np.cos(angle), 0.25 * np.sin(angle + 0.6) + rng.normal(0, 0.16, n), np.sin(angle))
    tone = 0.5 + 0.5 * np.sin(2 * angle + 0.8)
    rgb = mix([0.16, 0.12, 0.42], [0.36, 0.14, 0.36], tone)
    return blobs(1.1 * FAR * unit(band), rng.uniform(4.0, 8.0, n), 0.11, flat(rgb))


def moon() -> Part:
    """The full moon, opposite the sun, low in the sky."""
    centre = 0.9 * FAR * unit(MOON * [1, 0.12, 1])
    points, normals, size, _, _ = cover(sphere(centre, [2.3] * 3), 1300)
    seas = smooth(-0.6, 1.0, noise(normals, 3.3, 4, 85))
    rgb = mix([1.0, 0.96, 0.88], [0.70, 0.68, 0.74], seas)
    halo = blobs(
        np.repeat(centre[None], 2, 0), np.array([3.0, 6.0]), [0.22, 0.10], flat([0.55, 0.6, 0.9])
    )
    return join([halo, surfels(points, normals, size, flat(rgb))])


def clouds() -> Part:
    """Soft cushions in a ring below the rim: many, each almost nothing."""
    rng = np.random.default_rng(32)
    heaps = 13
    angle = 2 * np.pi * (np.arange(heaps) + rng.uniform(-0.3, 0.3, heaps)) / heaps
    radius = rng.uniform(1.25, 2.1, heaps)
    centres = xyz(radius * np.cos(angle), rng.uniform(-1.30, -0.95, heaps), radius * np.sin(angle))
    n = 44
    offset = rng.normal(size=(heaps, n, 3)) * [0.26, 0.06, 0.26]
    points = (centres[:, None] + offset).reshape(-1, 3)
    high = smooth(-0.12, 0.14, -offset[:, :, 1].ravel())
    rgb = mix([0.34, 0.30, 0.62], [1.05, 0.80, 0.84], high)
    sh = flat(rgb * 0.9) + lobe(SUN, [0.35, 0.18, 0.08], 2.5)
    size = rng.uniform(0.05, 0.14, heaps * n)
    return blobs(points, size, 0.17, sh)


def fireflies() -> Part:
    """Sparks over the meadow, each in a small glow."""
    rng = np.random.default_rng(33)
    n = 36
    angle, radius = rng.uniform(0, 2 * np.pi, n), 2.1 * np.sqrt(rng.uniform(0, 1, n))
    points = xyz(radius * np.cos(angle), rng.uniform(0.18, 0.75, n), radius * np.sin(angle))
    return join([
        blobs(points, 0.0075, 0.8, flat([1.0, 0.95, 0.55])),
        blobs(points, 0.035, 0.20, flat([0.85, 0.95, 0.30])),
    ])  # fmt: skip
