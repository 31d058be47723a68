"""The floating island: meadow, rock, pond and waterfall, grass, stones, crystals, islets."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tsplat.core.types import F64
from tsplat.demo.light import CRYSTAL_COLOUR, MOON, SUN, Lights, flat, glint, lobe, zonal
from tsplat.demo.parts import (
    UP,
    Part,
    Shape,
    blobs,
    cover,
    gaussians,
    join,
    lattice,
    mirrored,
    mix,
    noise,
    smooth,
    sphere,
    surfels,
    unit,
    xyz,
)

POND = np.array([-0.98, -0.34])  # x, z
TREE = np.array([0.66, 0.26])
FALL = unit([-0.93, -0.36])  # where the brook runs to
LIP = 1.36  # how far from the pond's middle it falls
BASIN = xyz(-0.70, 0.0, -0.22)  # the hollow under the pond that holds the mirror image
BASIN_RADII = np.array([1.25, 0.76, 1.25])


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
    height = 0.07 * smooth(-0.02, 0.18, water) - 0.02 + hill + 0.045 * smooth(0, 0.5, water) * ragged
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


def _disc(n: int) -> tuple[F64, F64]:
    """x, z of n points spread over the island."""
    u, v = lattice(n)
    angle = 2 * np.pi * u
    radius = np.sqrt(v) * rim(angle)
    return radius * np.cos(angle), radius * np.sin(angle)


def _meadow_colour(points: F64) -> F64:
    patches = noise(points, 1.7, 2, 21)
    green = mix([0.13, 0.33, 0.17], [0.36, 0.47, 0.16], smooth(-0.7, 0.8, patches))
    return green * (1 + 0.16 * noise(points, 9.0, 1, 22))[:, None]


def meadow(lights: Lights) -> Part:
    """The ground: opaque surfels, soil at the water's edge and on the rim."""
    x, z = _disc(12000)
    water = to_water(x, z)
    dry = water > -0.035
    x, z, water = x[dry], z[dry], water[dry]
    points, normals = on_ground(x, z)
    soil = mix([0.30, 0.23, 0.22], [0.46, 0.36, 0.28], smooth(-1, 1, noise(points, 8.0, 2, 23)))
    bare = np.maximum(1 - smooth(0.015, 0.08, water), smooth(0.8, 1.0, _edge(x, z)))
    albedo = _meadow_colour(points) * 0.9
    albedo += (soil - albedo) * bare[:, None]
    rgb = lights.shade(points, normals, albedo, 0.75, shadow=0.8)
    return surfels(points, normals, 0.048, flat(rgb))


def grass(lights: Lights) -> Part:
    """Blades: two needles each, dark at the root, bent and bright at the tip; lit from behind."""
    rng = np.random.default_rng(5)
    x, z = _disc(14000)
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
    lean += 1.1 * _edge(x, z)[:, None] * unit(roots * [1, 0, 1])
    tall = 0.085 * rng.uniform(0.5, 1.25, n) * (1 + 0.35 * np.clip(tuft, -1, 1))
    rising = unit(UP + lean * [1, 0.2, 1])
    bent = unit(UP * 0.85 + 2.0 * lean * [1, 0.2, 1])
    knee = roots + rising * tall[:, None]
    colour = _meadow_colour(roots) * rng.uniform(0.75, 1.35, (n, 1))
    soft = unit(normals + 0.5 * lean)
    shaded = lights.shade(roots, soft, colour, 0.8, wrap=0.6, shadow=0.75)
    lit = shaded.sum(1) / colour.sum(1)
    root, tip = flat(shaded * 0.62), flat(shaded * [1.22, 1.2, 0.95])
    tip += lobe(SUN, [0.30, 0.22, 0.05], 3.0) * lit.astype(np.float32)[:, None, None]
    low = gaussians(roots + rising * (0.5 * tall)[:, None], rising, 0.0042, 0.34 * tall, 0.9, root)
    high = gaussians(knee + bent * (0.35 * tall)[:, None], bent, 0.0028, 0.30 * tall, 0.88, tip)
    return join([low, high])


def flowers(lights: Lights) -> Part:
    """Specks of colour in drifts."""
    rng = np.random.default_rng(6)
    x, z = _disc(5200)
    x, z = x + rng.normal(0, 0.05, len(x)), z + rng.normal(0, 0.05, len(x))
    drift = noise(xyz(x, 0, z), 2.6, 2, 41)
    keep = (drift > 0.45) & (to_water(x, z) > 0.08) & (np.hypot(x, z) < 0.95 * rim(np.arctan2(z, x)))
    points, normals = on_ground(x[keep], z[keep])
    points += UP * rng.uniform(0.07, 0.15, (len(points), 1))
    petals = np.array([[1.0, 0.93, 0.86], [1.0, 0.78, 0.30], [0.72, 0.50, 0.98]])
    albedo = petals[rng.integers(0, 3, len(points))] * 1.15
    tilted = unit(normals + rng.normal(0, 0.35, normals.shape))
    rgb = lights.shade(points, tilted, albedo, 1.0, wrap=0.8, shadow=0.5)
    return gaussians(points, tilted, 0.011, 0.004, 0.97, flat(rgb))


def rock_shape(centre: ArrayLike, wide: float, deep: float, seed: int, main: bool = False) -> Shape:
    """A cone of layered rock that hangs from a rim (v = 0) to its tip (v = 1)."""
    at = np.asarray(centre, np.float64)
    turns = np.linspace(0, 1, 257)
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
        ledge = 0.09 * np.minimum(layer / 0.65, (1 - layer) / 0.35) - 0.04
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
        lawn, normals, size, _, _ = cover(sphere(at, [wide * 0.97, 0.13 * wide, wide * 0.97]), 900)
        parts.append(surfels(lawn, normals, size, flat(
            lights.shade(lawn, normals, _meadow_colour(lawn), 0.9))))  # fmt: skip
        rng = np.random.default_rng(seed)
        top = lawn[(lawn - at) @ UP > 0]
        rising = unit(UP + rng.normal(0, 0.3, top.shape))
        tall = rng.uniform(0.02, 0.045, len(top))
        blade = lights.shade(top, np.broadcast_to(UP, top.shape), _meadow_colour(top) * 1.3, 1.0)
        parts.append(gaussians(top + rising * tall[:, None], rising, 0.0035, tall, 0.9, flat(blade)))
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
    axis = unit(np.repeat(out, each, 0) + np.where(first, 0, 0.5)[:, None] * rng.normal(size=(len(first), 3)))
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


def water(garden: Part) -> Part:
    """The pond: a thin skin of ripples over an upside-down ``garden``, as in a mirror."""
    sky = flat([0.09, 0.12, 0.28]) + zonal(  # a mirrored sky: pale low down, deep overhead
        UP, lambda c: np.exp(-np.abs(c) * 3.2)[:, None] * np.array([0.42, 0.24, 0.30])
    )
    for light, colour, sharp in ((SUN, [0.85, 0.42, 0.12], 3.5), (MOON, [0.22, 0.34, 0.62], 4.0)):
        sky = sky + glint(UP[None], light, colour, sharp)
    points, normals, size, _, _ = cover(sphere(BASIN, BASIN_RADII), 4200)
    low = points[:, 1] > -0.02
    parts = [surfels(points[low], normals[low], size[low] * 1.1, sky)]
    seen = (((garden.means * [1, -1, 1] - BASIN) / (0.96 * BASIN_RADII)) ** 2).sum(1) < 1
    parts.append(mirrored(garden.take(seen & (garden.means[:, 1] < -0.004)), [0.80, 0.84, 0.95]))

    x, z = _disc(21000)
    edge = to_water(x, z)
    x, z, edge = x[edge < 0.01], z[edge < 0.01], edge[edge < 0.01]
    at = xyz(x, 0, z)
    ripple = np.stack([noise(at, 13.0, 2, 61), 0 * x, noise(at, 13.0, 2, 62)], 1)
    rings = np.hypot(x - POND[0], z - POND[1])
    ripple += 0.8 * np.sin(34 * rings)[:, None] * unit(at - xyz(POND[0], 0, POND[1]))
    normals = unit(UP + 0.22 * ripple)
    brook = (x - POND[0]) * FALL[0] + (z - POND[1]) * FALL[1]
    foam = smooth(0.95, 1.4, brook + 0.10 * noise(at, 17.0, 2, 63))
    rgb = mix([0.08, 0.17, 0.30], [0.66, 0.74, 0.88], 0.8 * foam)
    rgb += 0.25 * smooth(-0.05, 0.0, edge)[:, None] * np.array([0.5, 0.6, 0.7])
    sh = flat(rgb) + glint(normals, SUN, [0.80, 0.46, 0.20], 7.0)
    sh += glint(normals, MOON, [0.30, 0.42, 0.70], 7.0)
    opacity = 0.22 + 0.8 * smooth(0.72, 0.98, brook) + 0.15 * smooth(-0.06, 0.0, edge)
    parts.append(gaussians(at, normals, 0.026, 0.003, np.minimum(opacity, 0.97), sh))
    return join(parts)


def waterfall() -> Part:
    """Falling streaks, close together at the lip and torn apart below; mist around their end."""
    rng = np.random.default_rng(9)
    n = 3000
    side = np.array([-FALL[1], FALL[0]])
    fallen = rng.uniform(0, 1, n) ** 0.8
    time = 1.05 * fallen
    across = rng.normal(0, 0.075, n) * (1 + 0.9 * fallen)
    out = LIP - 0.08 + 0.30 * time + rng.normal(0, 0.02, n) * (0.5 + fallen)
    x, z = POND[:, None] + FALL[:, None] * out + side[:, None] * across
    height = 0.01 - 1.05 * time**2
    along = unit(xyz(0.34 * FALL[0], -2.1 * time - 0.02, 0.34 * FALL[1]))
    pale = rng.uniform(0.55, 1.0, n)
    rgb = mix([0.26, 0.40, 0.70], [1.0, 0.97, 1.0], (2 * pale - 1) * (1 - 0.3 * fallen))
    fade = (0.5 - 0.34 * fallen) * (0.35 + 0.65 * pale) * (1 - smooth(0.75, 1.0, fallen))
    sh = flat(rgb * 0.92) + lobe(SUN, [0.30, 0.16, 0.05], 2.5)
    streaks = gaussians(xyz(x, height, z), along, 0.0075, rng.uniform(0.05, 0.12, n), fade, sh)
    cloud = rng.normal(0, 1, (120, 3)) * [0.20, 0.12, 0.20]
    cloud += xyz(POND[0] + FALL[0] * (LIP + 0.20), -1.08, POND[1] + FALL[1] * (LIP + 0.20))
    mist = blobs(cloud, rng.uniform(0.05, 0.15, 120), 0.05, flat([0.70, 0.70, 0.90]))
    return join([streaks, mist])


def stones(lights: Lights) -> Part:
    """Boulders on the shore, all from one ball."""
    rng = np.random.default_rng(10)
    angle = np.linspace(0, 2 * np.pi, 27)[:-1] + rng.normal(0, 0.09, 26)
    shore = np.stack([POND[0] + 0.97 * np.cos(angle), POND[1] + 0.89 * np.sin(angle)], 1)
    spots = shore[to_water(*shore.T) > -0.06]
    radius = rng.uniform(0.045, 0.11, len(spots))
    flatness = rng.uniform(0.5, 0.8, len(spots))
    ball, normals, size, _, _ = cover(sphere([0, 0, 0], [1, 1, 1]), 260)
    radii = radius[:, None] * np.stack([np.ones_like(flatness), flatness, np.ones_like(flatness)], 1)
    at = on_ground(*spots.T)[0] + UP * (0.12 * radii[:, 1:2])
    points = (at[:, None] + radii[:, None] * ball).reshape(-1, 3)
    points *= 1 + 0.006 * noise(points, 14.0, 2, 91)[:, None]
    out = unit((normals / radii[:, None]).reshape(-1, 3))
    albedo = mix([0.36, 0.34, 0.40], [0.62, 0.56, 0.56], smooth(-1, 1, noise(points, 11.0, 3, 92)))
    rgb = lights.shade(points, out, albedo, 0.55 + 0.45 * smooth(-0.8, 0.6, out @ UP), shadow=0.6)
    sh = flat(rgb) + glint(out, SUN, [0.16, 0.10, 0.06], 5.0)
    return surfels(points, out, np.outer(radius, size).ravel() * 1.05, sh)


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
