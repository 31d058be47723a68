"""Stone: the island's underside, the islets beside it, crystals and vines that hang from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tsplat.core.types import F64
from tsplat.demo.land import ground_height, meadow_colour, rim
from tsplat.demo.light import CRYSTAL_COLOUR, MOON, SUN, Lights, flat, glint, zonal
from tsplat.demo.parts import (
    UP,
    Part,
    Shape,
    blobs,
    cover,
    gaussians,
    join,
    lattice,
    mix,
    noise,
    smooth,
    sphere,
    surfels,
    unit,
    xyz,
)


def rock_shape(centre: ArrayLike, wide: float, deep: float, seed: int, main: bool = False) -> Shape:
    """A cone of layered rock that hangs from a rim (v = 0) to its tip (v = 1)."""
    at = np.asarray(centre, np.float64)
    turns = np.linspace(0, 1, 257 if main else 2)
    edges = rim(2 * np.pi * turns)
    tops = ground_height(edges * np.cos(2 * np.pi * turns), edges * np.sin(2 * np.pi * turns))

    def shape(u: F64, v: F64) -> F64:
        angle = 2 * np.pi * u
        ring = xyz(np.cos(angle), 0, np.sin(angle))
        edge = rim(angle) if main else wide * (1 + 0.14 * noise(ring, 2.0, 2, seed + 3))
        tips = 1 + 0.20 * noise(ring, 2.2, 2, seed) * smooth(0.1, 0.6, v)
        flank = ring * (1.2 * (1 - v))[:, None] - 2.2 * UP * v[:, None]
        layer = 6.0 * v + 1.5 * noise(flank, 1.1, 1, seed + 1)
        layer -= np.floor(layer)
        ledge = 0.09 * smooth(0, 1, np.minimum(layer / 0.6, (1 - layer) / 0.4)) - 0.04
        craggy = 0.13 * (0.6 - np.abs(noise(flank, 3.4, 3, seed + 2)))
        thin = (1 - v**1.5) ** 0.95
        radius = edge * thin * (1 + (ledge + craggy) * smooth(0, 0.08, v) * (1 - v))
        top = np.interp(u % 1, turns, tops) if main else 0.0
        start = top * (1 - smooth(0, 0.25, v))
        fall = start - deep * tips * v
        return np.asarray(at + xyz(radius * ring[:, 0], fall, radius * ring[:, 2]))

    return shape


def rock(shape: Shape, n: int, lights: Lights, deep: float) -> Part:
    """``shape`` in violet stone with warm layers."""
    points, normals, size, _, v = cover(shape, n)
    layers = noise(points * [0.6, 5.0 / deep, 0.6], 3.6, 3, 51)
    albedo = mix([0.22, 0.18, 0.33], [0.66, 0.50, 0.54], smooth(-0.7, 0.8, layers))
    grain = np.random.default_rng(n).uniform(-0.16, 0.16, n)
    albedo *= (1 + grain + 0.25 * noise(points, 13.0, 2, 52))[:, None]
    moss = smooth(0.3, 0.7, 1 - v / 0.09 + 0.5 * noise(points, 9.0, 3, 53) + 2 * grain)
    moss = np.maximum(moss, smooth(0.35, 0.75, normals @ UP + grain) * (v < 0.12))
    albedo += (np.array([0.20, 0.33, 0.16]) - albedo) * (0.85 * moss)[:, None]
    crevice = 0.35 + 0.65 * smooth(-0.8, 0.4, noise(points * [1, 0.6, 1], 6.0, 3, 54))
    rough = unit(normals + 0.42 * np.stack([noise(points, 16.0, 1, 55 + i) for i in range(3)], 1))
    rgb = lights.shade(points, rough, albedo, crevice * (1 - 0.25 * v), wrap=0.25)
    sh = flat(rgb) + glint(rough, MOON, [0.10, 0.13, 0.22], 5.0)
    return surfels(points, normals, size, sh)


def islets(lights: Lights) -> Part:
    """Small rocks with a lawn of their own, adrift beside the island."""
    parts = []
    for x, height, z, wide, deep, seed in (
        (-1.45, 0.92, 1.60, 0.38, 0.62, 71),
        (1.85, -0.62, -1.15, 0.34, 0.50, 74),
        (1.15, -0.98, -1.70, 0.17, 0.28, 77),
        (-0.85, 1.22, 1.80, 0.19, 0.28, 79),
    ):
        at = xyz(x, height, z)
        parts.append(rock(rock_shape(at, wide, deep, seed), int(5200 * wide), lights, deep))
        lawn, normals, size, _, _ = cover(sphere(at, [wide * 0.97, 0.13 * wide, wide * 0.97]), 700)
        parts.append(surfels(lawn, normals, size, flat(
            lights.shade(lawn, normals, meadow_colour(lawn), 0.9))))  # fmt: skip
        rng = np.random.default_rng(seed)
        top = lawn[(lawn - at) @ UP > 0]
        rising = unit(UP + rng.normal(0, 0.3, top.shape))
        tall = rng.uniform(0.02, 0.045, len(top))
        blade = lights.shade(top, np.broadcast_to(UP, top.shape), meadow_colour(top) * 1.3, 1.0)
        parts.append(
            gaussians(top + rising * tall[:, None], rising, 0.0035, tall, 0.9, flat(blade))
        )
    return join(parts)


def crystals(shape: Shape) -> tuple[F64, F64, F64]:
    """Where crystals grow out of the rock: points, directions, lengths."""
    u = np.array([0.03, 0.13, 0.16, 0.34, 0.40, 0.55, 0.60, 0.66, 0.72, 0.78, 0.91])
    v = np.array([0.40, 0.62, 0.50, 0.45, 0.66, 0.34, 0.55, 0.42, 0.66, 0.36, 0.55])
    points = shape(u, v)
    out = unit(points * [1, 0, 1] + [0, 0.75, 0])
    return points, out, 0.24 + 0.18 * (u * 7.3 % 1)


def crystal_parts(points: F64, out: F64, length: F64) -> Part:
    """Clusters of glowing six-sided spikes, bright at their tips, glossy."""
    rng = np.random.default_rng(8)
    each, n = 4, 110
    first = np.arange(each * len(points)) % each == 0
    axis = unit(
        np.repeat(out, each, 0)
        + np.where(first, 0, 0.5)[:, None] * rng.normal(size=(len(first), 3))
    )
    tall = np.repeat(length, each) * np.where(first, 1.0, rng.uniform(0.4, 0.75, len(first)))
    side = unit(np.cross(axis, [0.3, 0.2, 0.9]))
    over = np.cross(axis, side)
    u, v = lattice(n)
    angle, facet = 2 * np.pi * u, np.floor(u * 6) / 6 * 2 * np.pi + np.pi / 6
    reach = 0.15 * np.minimum(1, (1 - v) / 0.35) * np.cos(np.pi / 6) / np.cos(angle - facet)
    ball = np.stack([v, reach * np.cos(angle), reach * np.sin(angle)], 1)
    frames = np.stack([axis, side, over], 1)  # [spikes, 3, xyz]
    where = np.einsum("nk,skx,s->snx", ball, frames, tall) + np.repeat(points, each, 0)[:, None]
    faces = np.stack([0 * u, np.cos(facet), np.sin(facet)], 1)
    normals = np.einsum("nk,skx->snx", faces, frames).reshape(-1, 3)
    glow = np.tile(0.25 + 1.1 * v + 0.25 * np.cos(3 * facet), len(first))
    sh = flat(CRYSTAL_COLOUR * glow[:, None]) + zonal(
        -normals, lambda c: 0.5 * (1 - np.abs(c[:, None])) * np.array([0.9, 0.4, 0.9])
    )
    sh += glint(normals, SUN, [0.5, 0.5, 0.5], 6.0)
    spikes = surfels(where.reshape(-1, 3), normals, 0.088 * np.repeat(tall, n), sh)
    halo = blobs(points + 0.6 * out * length[:, None], 0.17, 0.10, flat([0.08, 0.62, 0.95]))
    return join([spikes, halo])


def vines(lights: Lights, shape: Shape) -> Part:
    """Roots that hang from the rim: chains of needles."""
    rng = np.random.default_rng(12)
    count, links = 44, 12
    starts = shape(rng.uniform(0, 1, count), rng.uniform(0.01, 0.10, count))
    step = rng.uniform(0.015, 0.045, count)[:, None, None]
    sway = np.cumsum(rng.normal(0, 0.16, (count, links, 3)), 1)
    out = unit(starts * [1, 0, 1])[:, None] * np.linspace(0.5, 0, links)[:, None]
    along = unit(-UP + sway * [1, 0.1, 1] * 0.5 + out)
    points = starts[:, None] + np.cumsum(along * step, 1)
    flat_points, flat_along = points.reshape(-1, 3), along.reshape(-1, 3)
    normals = unit(np.repeat(starts * [1, 0, 1], links, 0))
    colour = mix([0.16, 0.28, 0.14], [0.42, 0.50, 0.18], np.tile(np.linspace(0, 1, links), count))
    rgb = lights.shade(flat_points, normals, colour, 0.9, wrap=0.5)
    length = np.repeat(0.62 * step.ravel(), links)
    return gaussians(flat_points, flat_along, 0.0042, length, 0.92, flat(rgb))
