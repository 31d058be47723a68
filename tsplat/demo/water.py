"""The pond with its mirror image, the waterfall, and the boulders on the shore."""

from __future__ import annotations

import numpy as np

from tsplat.demo.land import FALL, LIP, POND, disc, on_ground, to_water
from tsplat.demo.light import MOON, SUN, Lights, flat, glint, lobe, zonal
from tsplat.demo.parts import (
    UP,
    Part,
    blobs,
    cover,
    gaussians,
    join,
    mirrored,
    mix,
    noise,
    smooth,
    sphere,
    surfels,
    unit,
    xyz,
)

BASIN = xyz(-0.70, 0.0, -0.22)  # the hollow under the pond that holds the mirror image
BASIN_RADII = np.array([1.25, 0.76, 1.25])


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

    x, z = disc(17000)
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
    parts.append(gaussians(at, normals, 0.029, 0.003, np.minimum(opacity, 0.97), sh))
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
    streaks = gaussians(xyz(x, height, z), along, 0.0050, rng.uniform(0.05, 0.13, n), fade, sh)
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
    ball, normals, size, _, _ = cover(sphere([0, 0, 0], [1, 1, 1]), 200)
    radii = radius[:, None] * np.stack(
        [np.ones_like(flatness), flatness, np.ones_like(flatness)], 1
    )
    at = on_ground(*spots.T)[0] + UP * (0.12 * radii[:, 1:2])
    points = (at[:, None] + radii[:, None] * ball).reshape(-1, 3)
    points *= 1 + 0.006 * noise(points, 14.0, 2, 91)[:, None]
    out = unit((normals / radii[:, None]).reshape(-1, 3))
    albedo = mix([0.36, 0.34, 0.40], [0.62, 0.56, 0.56], smooth(-1, 1, noise(points, 11.0, 3, 92)))
    rgb = lights.shade(points, out, albedo, 0.55 + 0.45 * smooth(-0.8, 0.6, out @ UP), shadow=0.6)
    sh = flat(rgb) + glint(out, SUN, [0.16, 0.10, 0.06], 5.0)
    return surfels(points, out, np.outer(radius, size).ravel() * 1.05, sh)
