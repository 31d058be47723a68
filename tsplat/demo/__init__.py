"""A scene without a file: a floating garden at dusk, made of formulas and seeded numbers.

A cherry tree, a gate in a pond, an opal, lanterns on a wire. It has what a renderer must cope
with: surfels, needles, soft Gaussians larger than the picture and specks smaller than a pixel,
near and far, opaque and faint, and gloss in harmonics up to degree 3.
"""

from __future__ import annotations

import math

import numpy as np

from tsplat.core.camera import Camera, Orbit
from tsplat.core.types import Scene
from tsplat.demo import garden, land, rock, sky, water
from tsplat.demo.light import Lights
from tsplat.demo.parts import UP, join

__all__ = ["demo_camera", "demo_scene"]


def demo_scene() -> Scene:
    """The floating garden; the same arrays on every call.

    World axes are those of COLMAP's scenes (y down), units arbitrary: the island measures 5
    across and lies about the origin. Stars and moon are 40 away, too few to count as content.
    """
    shape = rock.rock_shape([0.0, 0.0, 0.0], 2.3, 1.45, 50, main=True)
    spikes, out, length = rock.crystals(shape)
    lights = Lights(
        garden.LANTERNS, spikes + out * length[:, None], garden.CROWN, garden.CROWN_RADII
    )
    standing = join([
        garden.torii(lights), garden.gem(), garden.lanterns(), garden.tree(lights),
        water.stones(lights), garden.petals(lights),
    ])  # fmt: skip
    everything = join([
        sky.nebula(), sky.stars(), sky.moon(), rock.rock(shape, 19000, lights, 1.45),
        rock.islets(lights), rock.crystal_parts(spikes, out, length), rock.vines(lights, shape),
        land.meadow(lights), land.grass(lights), land.flowers(lights), water.water(standing),
        water.waterfall(), standing, sky.fireflies(), sky.clouds(),
    ])  # fmt: skip
    return Scene(
        everything.means, everything.quats, everything.scales, everything.opacities, everything.sh,
        name="demo",
    )  # fmt: skip


def demo_camera(width: int, height: int) -> Camera:
    """The view of the pictures in the documentation: gate and waterfall in front, moon behind."""
    orbit = Orbit(np.array([-0.08, 0.10, 0.0]), 5.8, math.radians(30), math.radians(16), UP)
    return orbit.camera(46, width, height)
