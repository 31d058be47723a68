"""What stands in the garden: a cherry tree, a torii with an opal, lanterns on a wire."""

from __future__ import annotations

import numpy as np

from tsplat.core.types import F64
from tsplat.demo.land import POND, TREE
from tsplat.demo.light import MOON, SUN, Lights, flat, glint, lobe, opal, zonal
from tsplat.demo.parts import (
    UP,
    Part,
    beam,
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

CROWN = xyz(TREE[0] - 0.05, 1.36, TREE[1])
CROWN_RADII = np.array([1.12, 0.62, 1.08])
THROUGH = xyz(-0.80, 0, -0.60)  # the way through the gate
ACROSS = xyz(0.60, 0, -0.80)
GATE = xyz(POND[0], 0, POND[1])
OPAL = GATE + 0.52 * UP
OPAL_RADIUS = 0.29


def pads() -> tuple[F64, F64]:
    """Centres and radii [P, 3] of the crown's cushions of blossom."""
    rng = np.random.default_rng(20)
    u, v = lattice(17)
    angle, height = 2 * np.pi * u, 1 - 1.35 * v
    ring = np.sqrt(1 - height**2)
    shell = xyz(ring * np.cos(angle), height, ring * np.sin(angle))
    centres = CROWN + CROWN_RADII * shell * rng.uniform(0.68, 0.92, (17, 1))
    centres = np.concatenate([centres, CROWN + xyz([0.0, 0.25], [0.1, 0.25], [0.0, -0.2])])
    wide = rng.uniform(0.29, 0.43, len(centres))
    return centres, np.stack([wide, 0.56 * wide, wide], 1)


def tree(lights: Lights) -> Part:
    """A bent trunk, boughs into every cushion, and petals."""
    centres, radii = pads()
    return join([_wood(lights, centres), _blossom(lights, centres, radii)])


def _wood(lights: Lights, tips: F64) -> Part:
    """Trunk and boughs: quadratic curves with round sections."""
    foot, bend = xyz(TREE[0], 0.16, TREE[1]), xyz(TREE[0] + 0.30, 0.62, TREE[1] - 0.05)
    fork = xyz(TREE[0] - 0.06, 1.02, TREE[1])
    k = len(tips)
    start = np.concatenate(
        [foot[None], np.repeat(fork[None], k, 0) + 0.12 * (tips - fork) * [1, 0, 1]]
    )
    start[1:] += UP * np.linspace(-0.22, 0.10, k)[:, None]
    end = np.concatenate([fork[None] + 0.12 * UP, tips])
    middle = np.concatenate([bend[None], 0.5 * (start[1:] + tips) + UP * 0.10])
    thick = np.concatenate([[0.115], np.full(k, 0.042)])
    thin = np.concatenate([[0.058], np.full(k, 0.010)])
    counts = np.concatenate([[2600], np.full(k, 190)])
    which = np.repeat(np.arange(k + 1), counts)
    t = np.concatenate([lattice(c)[1] for c in counts])
    angle = 2 * np.pi * np.concatenate([lattice(c)[0] for c in counts])
    a, b, c = start[which], middle[which], end[which]
    s = t[:, None]
    centre = (1 - s) ** 2 * a + 2 * s * (1 - s) * b + s**2 * c
    along = unit((1 - s) * (b - a) + s * (c - b))
    side = unit(np.cross(along, [0.31, 0.17, 0.93]))
    over = np.cross(along, side)
    normals = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * over
    radius = thick[which] + (thin - thick)[which] * t
    radius += np.where(which == 0, 0.11 * np.exp(-t / 0.07) * (1 + 0.5 * np.sin(5 * angle)), 0)
    bark = noise(np.stack([5 * angle, 9 * t, which], 1), 1.0, 2, 81)
    points = centre + normals * (radius * (1 + 0.10 * bark))[:, None]
    albedo = mix([0.20, 0.13, 0.15], [0.50, 0.34, 0.32], smooth(-1, 1, bark))
    rgb = lights.shade(points, normals, albedo, 0.75, shadow=0.35)
    size = np.where(which == 0, 0.024, 0.020)
    return surfels(points, normals, size, flat(rgb))


def _blossom(lights: Lights, centres: F64, radii: F64) -> Part:
    """Petals, thick on the cushions' outside; soft dark ones inside, so that none looks hollow."""
    rng = np.random.default_rng(21)
    n = 22000
    share = radii[:, 0] ** 2
    which = rng.choice(len(centres), n, p=share / share.sum())
    out = unit(rng.normal(size=(n, 3)))
    depth = rng.uniform(0, 1, n) ** 0.33
    bumpy = 1 + 0.16 * noise(centres[which] * 3 + out, 4.5, 2, 82)
    points = centres[which] + radii[which] * out * (depth * bumpy)[:, None]
    normals = unit(out / radii[which] * 0.3 + 0.55 * unit((points - CROWN) / CROWN_RADII**2))
    leaf = unit(normals + rng.normal(0, 0.45, (n, 3)))
    height = 0.5 + 0.5 * (out @ UP)
    tone = np.clip(0.62 * height + 0.38 * depth + rng.normal(0, 0.13, n), 0, 1)
    albedo = mix([0.58, 0.15, 0.42], [1.22, 0.80, 0.90], tone)
    pale = rng.uniform(0, 1, n) < 0.10
    albedo[pale] = [1.15, 0.95, 0.95]
    open_ = 0.30 + 0.75 * smooth(0.55, 1.0, depth) * (0.4 + 0.6 * height)
    rgb = lights.shade(points, unit(0.75 * normals + 0.4 * leaf), albedo, open_, wrap=0.35)
    through = (0.28 * depth**2 * (1 - 0.5 * height)).astype(np.float32)
    sh = flat(rgb) + lobe(SUN, [1.0, 0.42, 0.36], 3.0) * through[:, None, None]
    petals = gaussians(points, leaf, rng.uniform(0.014, 0.025, n), 0.005, 0.93, sh)
    m = 900
    core = rng.integers(0, len(centres), m)
    inner = centres[core] + radii[core] * unit(rng.normal(size=(m, 3))) * rng.uniform(
        0, 0.62, (m, 1)
    )
    dark = lights.shade(inner, unit(inner - CROWN), [0.62, 0.20, 0.40], 0.42, wrap=0.6)
    return join([blobs(inner, 0.062, 0.85, flat(dark)), petals])


def torii(lights: Lights) -> Part:
    """The gate in the pond: two posts, a tie beam, a black lintel with lifted ends."""
    over = UP
    red, black = [0.78, 0.15, 0.08], [0.13, 0.11, 0.15]
    pieces: list[tuple[F64, F64, F64, F64]] = []

    def add(path: tuple[F64, F64], lift: float, side: F64, up: F64, wide: float, high: float,
            power: float, n: int, albedo: list[float]) -> None:  # fmt: skip
        a, b = path

        def line(v: F64) -> F64:
            bow = lift * (2 * v - 1) ** 2
            return np.asarray(a + v[:, None] * (b - a) + bow[:, None] * UP, np.float64)

        points, normals, size, _, _ = cover(beam(line, side, up, wide, high, power), n)
        pieces.append((points, normals, size, np.tile(albedo, (n, 1))))

    for s in (-1.0, 1.0):
        foot, head = GATE + s * 0.55 * ACROSS, GATE + s * 0.51 * ACROSS + 1.30 * UP
        add((foot + 0.02 * UP, head), 0, ACROSS, THROUGH, 0.064, 0.064, 2, 1300, red)
        add((foot, foot + 0.12 * UP), 0, ACROSS, THROUGH, 0.088, 0.088, 2, 400, black)
    ends = 0.71 * ACROSS
    add(
        (GATE - ends + 1.02 * UP, GATE + ends + 1.02 * UP),
        0,
        THROUGH,
        over,
        0.042,
        0.055,
        4,
        1500,
        red,
    )
    add((GATE + 1.04 * UP, GATE + 1.28 * UP), 0, ACROSS, THROUGH, 0.06, 0.036, 6, 220, red)
    ends = 0.85 * ACROSS
    add(
        (GATE - ends + 1.31 * UP, GATE + ends + 1.31 * UP),
        0.05,
        THROUGH,
        over,
        0.058,
        0.052,
        4,
        2200,
        red,
    )
    ends = 0.94 * ACROSS
    add(
        (GATE - ends + 1.405 * UP, GATE + ends + 1.405 * UP),
        0.08,
        THROUGH,
        over,
        0.090,
        0.044,
        4,
        3000,
        black,
    )
    points, normals, size, albedo = (np.concatenate(column) for column in zip(*pieces, strict=True))
    grain = 1 + 0.10 * noise(points, 15.0, 2, 83)
    wet = 0.55 + 0.45 * smooth(0.0, 0.25, points @ UP)
    sh = flat(lights.shade(points, normals, albedo, wet) * grain[:, None])
    sh += glint(normals, SUN, [0.30, 0.20, 0.12], 6.0)
    sh += glint(normals, MOON, [0.10, 0.14, 0.26], 5.0)
    return surfels(points, normals, size, sh)


def gem() -> Part:
    """The opal between the posts: its colours run and its highlights slide as one walks by."""
    points, normals, size, _, _ = cover(sphere(OPAL, [OPAL_RADIUS] * 3), 3600)
    normals = unit(points - OPAL)
    swirl = 1.1 * noise(normals, 1.5, 2, 84)
    sh = flat([[0.46, 0.42, 0.58]]) + 0.34 * opal(normals, swirl)
    sh += zonal_rim(normals)
    sh += glint(normals, SUN, [0.95, 0.70, 0.50], 9.0) + glint(
        normals, MOON, [0.45, 0.55, 0.85], 8.0
    )
    sh += glint(normals, unit([-0.3, -0.9, -0.3]), [0.35, 0.33, 0.40], 5.0)
    parts = [surfels(points, normals, 1.4 * size, sh)]
    for tilt, radius in ((0.45, 0.41),):
        n = 160
        angle = 2 * np.pi * np.arange(n) / n
        a = unit(ACROSS * np.cos(tilt) + UP * np.sin(tilt))
        b = unit(THROUGH + 0.5 * tilt * UP)
        b = unit(b - a * (a @ b))
        ring = np.cos(angle)[:, None] * a + np.sin(angle)[:, None] * b
        along = -np.sin(angle)[:, None] * a + np.cos(angle)[:, None] * b
        gold = flat([0.95, 0.66, 0.26]) + glint(ring, SUN, [0.8, 0.7, 0.5], 6.0)
        parts.append(
            gaussians(OPAL + radius * ring, along, 0.0055, np.pi * radius / n * 1.5, 0.85, gold)
        )
    parts.append(blobs(OPAL[None], 0.30, 0.09, flat([0.62, 0.55, 1.0])))
    return join(parts)


def zonal_rim(normals: F64) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """A violet sheen at grazing angles."""
    return zonal(
        -normals,
        lambda c: (np.clip(1 - np.abs(c), 0, 1) ** 2)[:, None] * np.array([0.30, 0.20, 0.42]),
    )


def _wire(a: F64, b: F64, sag: float, t: F64) -> F64:
    return a + t[:, None] * (b - a) - UP * (4 * sag * t * (1 - t))[:, None]


ROPE = (GATE + 0.80 * ACROSS + 1.30 * UP, xyz(TREE[0] - 0.25, 1.24, TREE[1] - 0.72), 0.24)
ROPE_AT = np.array([0.14, 0.38, 0.62, 0.86])
HUNG = xyz([1.62, 1.30, 0.42, 0.98], [0.68, 0.80, 0.70, 0.60], [-0.18, 0.90, 0.88, -0.62])
"""Lanterns that hang from the boughs."""

LANTERNS = np.concatenate([_wire(*ROPE, ROPE_AT) - 0.15 * UP, HUNG])


def lanterns() -> Part:
    """Paper lanterns, the wire and the threads that they hang on, and their glow."""
    ball, normals, size, _, v = cover(sphere([0, 0, 0], [0.066, 0.082, 0.066]), 420)
    ribs = 0.90 + 0.10 * np.cos(2 * np.pi * 6 * v)
    warm = mix([1.0, 0.45, 0.12], [1.25, 0.88, 0.50], np.sin(np.pi * v) ** 1.5) * ribs[:, None]
    warm[(v < 0.035) | (v > 0.965)] = [0.16, 0.10, 0.10]
    sh = flat(warm) + zonal(
        -normals, lambda c: np.clip(c, 0, 1)[:, None] * np.array([0.18, 0.22, 0.20]) - 0.05
    )
    parts = [surfels(lantern + ball, normals, size, sh) for lantern in LANTERNS]
    t = np.linspace(0, 1, 120)
    rope = _wire(*ROPE, t)
    along = unit(np.gradient(rope, axis=0))
    dark = flat([0.30, 0.22, 0.20])
    parts.append(gaussians(rope, along, 0.0045, 0.012, 0.97, dark))
    for lantern in LANTERNS:
        high = 0.15 if lantern[0] < HUNG[:, 0].min() and lantern[1] < -0.75 else 0.42
        knots = lantern + UP * np.linspace(0.08, high, 10)[:, None]
        parts.append(gaussians(knots, np.broadcast_to(UP, knots.shape), 0.003, 0.03, 0.9, dark))
    for spread, opacity in ((0.055, 0.30), (0.13, 0.13), (0.26, 0.05)):
        parts.append(blobs(LANTERNS, spread, opacity, flat([1.0, 0.60, 0.22])))
    return join(parts)


def petals(lights: Lights) -> Part:
    """Petals in the wind, and a drift of them on the grass and on the water below the tree."""
    rng = np.random.default_rng(22)
    n = 170
    away = rng.uniform(0, 1, n)
    points = CROWN + rng.normal(0, 0.45, (n, 3)) * [1, 0.5, 1]
    points += away[:, None] * xyz(-2.1, -1.0, -1.3) + UP * (0.3 * np.sin(5 * away))[:, None]
    points = points[(points[:, 1] < -0.2) & (points[:, 1] > -1.85)]
    leaf = unit(rng.normal(size=points.shape))
    rgb = lights.shade(points, leaf, [1.1, 0.66, 0.78], 1.0, wrap=1.0)
    sh = flat(rgb) + lobe(SUN, [0.3, 0.12, 0.1], 3.0)
    return gaussians(points, leaf, rng.uniform(0.010, 0.017, len(points)), 0.003, 0.95, sh)
