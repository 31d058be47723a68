"""Where to stand so that a scene fills the picture.

Files have stray Gaussians at 1000 or 2e7 around content of size 10, so nothing here looks at the
smallest or the largest coordinate: the extent is found by opacity-weighted percentiles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tsplat.core.camera import Camera, Orbit
from tsplat.core.constants import FAR, NEAR
from tsplat.core.errors import CameraError
from tsplat.core.types import F64, I64, UPWARDS, Scene, Up

SAMPLE = 32_768
"""Gaussians looked at; a percentile of that many is within 0.6 % of the whole scene's."""

GOLDEN = (math.sqrt(5) - 1) / 2

CORE = 0.9
"""Share of all opacity that is content for sure; the rest counts if it is near that."""

FENCE = 3.0
"""Times the core's distance from the middle at which a Gaussian is a stray one."""

MARGIN = 0.95
"""Share of the picture's half width and height that content may take."""

FOV = 50.0
"""Degrees, vertical."""

YAW = math.radians(30)
PITCH = math.radians(15)
"""The three-quarter view from slightly above, in which a thing shows its shape."""

UP = Up(UPWARDS, "y points down, as in COLMAP's frame, which trainers keep")
"""Which way is up unless a file says otherwise."""

AGREE = 0.7
"""Length that the mean of the cameras' upward directions has at least, if there is an upward."""

TURNS = 24
"""Directions on the circle round a scene in which it must fit."""


@dataclass(frozen=True, eq=False)
class Extent:
    """Where a scene's content is, strays left out."""

    centre: F64  # [3]     world units
    radius: float  # world units, > 0: of a ball about centre that holds points and their blur
    points: F64  # [M, 3]  world units, relative to centre: a sample of the content
    blur: float  # world units: two standard deviations of a typical Gaussian


def scene_extent(scene: Scene) -> Extent:
    """The content of ``scene``: its Gaussians without the strays, weighted by opacity.

    The same scene gives the same extent on every run. A scene without Gaussians has a ball of
    radius 1 about its origin.
    """
    rows = _sample(len(scene))
    means = scene.means[rows].astype(np.float64)
    weights = scene.opacities[rows].astype(np.float64)
    if not len(means):
        return Extent(scene.origin.copy(), 1.0, np.zeros((0, 3)), 0.0)
    if not weights.any():
        weights = np.ones_like(weights)
    middle = np.array([_quantiles(column, weights, 0.5)[0] for column in means.T])
    away = np.sqrt(((means - middle) ** 2).sum(1))
    content = (away <= FENCE * _quantiles(away, weights, CORE)[0]) & (weights > 0)
    means, weights = means[content], weights[content]
    blur = 2.0 * float(_quantiles(scene.scales[rows][content].max(1), weights, 0.5)[0])
    lowest, highest = np.array([_quantiles(column, weights, 0.005, 0.995) for column in means.T]).T
    centre = (lowest + highest) / 2
    inside = ((means >= lowest) & (means <= highest)).all(1)
    points = (means[inside] if inside.any() else np.stack([lowest, highest])) - centre
    radius = float(np.sqrt((points**2).sum(1)).max()) + blur
    return Extent(scene.origin + centre, radius if radius > 0 else 1.0, points, blur)


def _sample(count: int) -> I64:
    """SAMPLE rows of ``count``, spread evenly but without a period; all of fewer.

    Multiples of the golden ratio do for that; numpy.random would bring 7 MB into memory.
    """
    if count <= SAMPLE:
        return np.arange(count)
    place = np.arange(SAMPLE)
    return ((place + place * GOLDEN % 1) * (count / SAMPLE)).astype(np.int64)


def _quantiles(values: F64, weights: F64, *shares: float) -> F64:
    """The values below which these shares of all weight lie."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    places = np.searchsorted(total, np.asarray(shares) * total[-1])
    return np.asarray(values[order][np.minimum(places, len(order) - 1)], np.float64)


def up_of(scene: Scene) -> Up:
    """Which way is up in ``scene``."""
    return scene.up or UP


def up_of_cameras(rotations: F64, where: str) -> Up | None:
    """The mean of cameras' upward directions, if they agree by and large.

    People hold cameras upright: over a walk round a scene what is tilted or looks down cancels.

    Args:
        rotations: [n, 3, 3] world to camera.
        where: the name of their file.
    """
    mean = -rotations[:, 1].mean(0)
    length = float(np.linalg.norm(mean))
    if not length >= AGREE:
        return None
    x, y, z = (round(float(value), 6) + 0.0 for value in mean / length)
    return Up((x, y, z), f"upwards in the {len(rotations)} pictures of {where}")


def clip_planes(distance: float) -> tuple[float, float]:
    """(near, far) for content at ``distance``, however small or large the world's unit is."""
    return min(NEAR, distance * 1e-3), max(FAR, distance * 1e3)


def frame_orbit(
    scene: Scene,
    width: int,
    height: int,
    fov: float = FOV,
    up: ArrayLike | None = None,
    *,
    yaw: float = YAW,
    pitch: float = PITCH,
) -> Orbit:
    """The orbit about the middle of ``scene`` on which its content is in the picture all round.

    Args:
        scene: what to look at.
        width: px.
        height: px.
        fov: vertical field of view, degrees.
        up: [3] world direction that is upwards; None is what the scene's file says, or UP.
        yaw: radians about ``up``, where the orbit begins.
        pitch: radians; positive looks down from above.

    Raises:
        CameraError: ``fov`` is not between 0 and 180, ``up`` is zero, a size is less than 1.
    """
    upwards = np.asarray(up_of(scene).direction if up is None else up, np.float64)
    if upwards.shape != (3,) or not np.isfinite(upwards).all() or not upwards.any():
        raise CameraError(f"up: expected three finite numbers, not all zero, got {up!r}")
    extent = scene_extent(scene)
    orbit = Orbit(extent.centre, 1.0, yaw, pitch, upwards / np.abs(upwards).max())
    view = orbit.camera(fov, width, height)
    slopes = MARGIN * np.array([width, height]) / 2 / view.K[[0, 1], [0, 1]]
    # a ball of radius blur touches a plane of slope t through the eye at z = x / t + blur / sin
    clearance = extent.blur * np.sqrt(1 + slopes**-2)
    # in the picture is: |x| / slope + clearance - z of no more than the distance, and |y| likewise
    sides = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]) / slopes
    sides = np.column_stack([sides, np.full(4, -1.0)])
    distance = 0.0
    points = np.ascontiguousarray(extent.points.T)
    for turn in range(TURNS):
        turned = replace(orbit, yaw=yaw + 2 * math.pi * turn / TURNS)
        outwards = sides @ turned.camera(fov, width, height).rotation
        needed = (outwards @ points).max(1, initial=-math.inf) + np.repeat(clearance, 2)
        distance = max(distance, float(needed.max()))
    # never in the ball or at its skin, where a wide field of view would else allow to stand
    return replace(orbit, distance=max(distance, 1.2 * extent.radius))


def frame_scene(
    scene: Scene,
    width: int,
    height: int,
    *,
    fov: float = FOV,
    yaw: float = YAW,
    pitch: float = PITCH,
    up: ArrayLike | None = None,
) -> Camera:
    """The camera that :func:`frame_orbit` begins with; near and far fit the scene's size.

    Raises:
        CameraError: ``fov`` is not between 0 and 180, ``up`` is zero, a size is less than 1.
    """
    orbit = frame_orbit(scene, width, height, fov, up, yaw=yaw, pitch=pitch)
    near, far = clip_planes(orbit.distance)
    return orbit.camera(fov, width, height, near, far)


def ring(scene: Scene, count: int, width: int, height: int) -> list[Camera]:
    """``count`` cameras on the orbit that :func:`frame_orbit` begins, evenly round ``scene``."""
    orbit = frame_orbit(scene, width, height)
    return [
        replace(orbit, yaw=orbit.yaw + math.tau * i / count).camera(FOV, width, height)
        for i in range(count)
    ]
