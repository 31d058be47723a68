"""Ways for a camera to go: through the poses of a file, or once round a scene.

Between two poses a cubic Bezier curve is followed, of positions and of rotations alike: de
Casteljau's steps are straight for the ones and turn at a constant rate for the others (Shoemake,
"Animating Rotation with Quaternion Curves", SIGGRAPH 1985, section 4). The velocity at a pose is
the mean of those before and after it, weighted as the parabola through the three poses has it,
which makes the positions' curve a Catmull-Rom spline with knots at any times; but it is bounded.
Field of view, principal point, near and far go linearly.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from tsplat.core.camera import Camera
from tsplat.core.errors import CameraError, printable
from tsplat.core.reference import rotations
from tsplat.core.types import F64
from tsplat.io.cameras import load_timed_cameras

LEG_SECONDS = 1.0
"""On average from one pose to the next, of a path without times."""

TURN_SECONDS = 4.0
"""Of one turn round a scene."""

STEEP = 3.0
"""Times the slower of two legs' mean velocity that a camera may have between them.

Without a bound a slow leg after a fast one overshoots; up to 3 a monotonous curve stays one
(Fritsch and Carlson, "Monotone Piecewise Cubic Interpolation", SIAM J. Numer. Anal. 17, 1980). It
makes a pose given twice a pause.
"""


@dataclass(frozen=True, eq=False)
class Path:
    """Poses and when each is reached. One that ends in its first pose goes round without a stop.

    Raises:
        CameraError: fewer than two poses, or times that do not begin at 0 and increase.
    """

    poses: tuple[Camera, ...]  # P of them, of one size
    times: F64  # [P]  seconds, increasing, the first 0

    def __post_init__(self) -> None:
        if len(self.poses) < 2:
            raise CameraError(f"a path takes two poses or more, got {len(self.poses)}")
        steps = np.diff(self.times)
        if self.times.shape != (len(self.poses),) or self.times[0] != 0 or not (steps > 0).all():
            raise CameraError(f"expected times that increase from 0 on, got {self.times.tolist()}")
        if not np.isfinite(self.times).all():
            raise CameraError("expected times that are finite")

    @property
    def seconds(self) -> float:
        """From the first pose to the last."""
        return float(self.times[-1])

    @property
    def closed(self) -> bool:
        """Whether the last pose is the first again."""
        return self.poses[0].same(self.poses[-1])

    def camera(self, seconds: float) -> Camera:
        """The camera at that time, held at both ends; a pose itself when it is reached."""
        time = min(max(seconds, 0.0), self.seconds)
        leg = min(int(np.searchsorted(self.times, time, "right")) - 1, len(self.poses) - 2)
        begin, end = self.times[leg], self.times[leg + 1]
        if time in (begin, end):
            return self.poses[leg if time == begin else leg + 1]
        share, third = float((time - begin) / (end - begin)), float(end - begin) / 3
        before, after = self.poses[leg], self.poses[leg + 1]
        centre = _bezier(
            (
                before.centre,
                before.centre + third * self._velocities[leg],
                after.centre - third * self._velocities[leg + 1],
                after.centre,
            ),
            share, _straight,
        )  # fmt: skip
        quat = _bezier(
            (
                self._quats[leg],
                _product(self._quats[leg], _exp(third * self._spins[leg])),
                _product(self._quats[leg + 1], _exp(-third * self._spins[leg + 1])),
                self._quats[leg + 1],
            ),
            share, slerp,
        )  # fmt: skip
        viewmat = np.eye(4)
        viewmat[:3, :3] = rotations(quat)
        viewmat[:3, 3] = -viewmat[:3, :3] @ centre
        near, far = ((1 - share) * a + share * b
                     for a, b in ((before.near, after.near), (before.far, after.far)))  # fmt: skip
        lens = _straight(_lens(before), _lens(after), share)
        return Camera(viewmat, _intrinsics(lens, before), before.width, before.height, near, far)

    @cached_property
    def _quats(self) -> F64:
        """[P, 4] world to camera, w x y z; neighbours on the same side of the sphere."""
        quats = np.array([quaternion(pose.rotation) for pose in self.poses])
        turns = np.where(np.einsum("ij,ij->i", quats[:-1], quats[1:]) < 0, -1.0, 1.0)
        return np.asarray(quats * np.concatenate([[1.0], np.cumprod(turns)])[:, None], np.float64)

    @cached_property
    def _velocities(self) -> F64:
        """[P, 3] world units per second at the poses."""
        return self._rates(np.diff([pose.centre for pose in self.poses], axis=0))

    @cached_property
    def _spins(self) -> F64:
        """[P, 3] half radians per second at the poses, about the world's axes."""
        pairs = itertools.pairwise(self._quats)
        return self._rates(np.array([_log(_product(_inverse(a), b)) for a, b in pairs]))

    def _rates(self, steps: F64) -> F64:
        """[P, 3] rates of change at the poses, of the [P - 1, 3] changes between them."""
        spans = np.diff(self.times)
        rates = steps / spans[:, None]
        if self.closed:
            rates, spans = (np.concatenate([a[-1:], a, a[:1]]) for a in (rates, spans))
        else:
            rates, spans = (np.concatenate([a[:1], a, a[-1:]]) for a in (rates, spans))
        before, after = spans[:-1, None], spans[1:, None]
        mixed: F64 = (after * rates[:-1] + before * rates[1:]) / (before + after)
        lengths = np.linalg.norm(rates, axis=1)
        most = STEEP * np.minimum(lengths[:-1], lengths[1:])[:, None]
        length = np.linalg.norm(mixed, axis=1, keepdims=True)
        bound = np.divide(most, length, out=np.ones_like(length), where=length > most)
        return np.asarray(mixed * bound, np.float64)


def load_path(file: str | os.PathLike[str]) -> Path:
    """The path through the cameras of a JSON file, in its order and at the first one's size.

    Times are those of the file, if every pose has a ``time``; else each leg takes as long as its
    share of the way, :data:`LEG_SECONDS` on average. Turning counts too: a full turn on the spot
    is as far as the whole way.

    Raises:
        CameraError: it cannot be read, or is no path; one line with the file's name.
    """
    shown = printable(file)
    timed = load_timed_cameras(file)
    width, height = timed[0][0].width, timed[0][0].height
    poses = [camera.resized(width, height) for camera, _ in timed]
    given = [time for _, time in timed if time is not None]
    try:
        if given and len(given) < len(poses):
            raise CameraError("some poses have a time and some have none; give all of them one")
        if given:
            return Path(tuple(poses), np.array(given) - given[0])
        kept = [poses[0]]
        for pose in poses[1:]:
            if not pose.same(kept[-1]):  # without a time there is no pause
                kept.append(pose)
        if len(kept) < 2:
            raise CameraError(f"a path takes two poses that differ, got {len(kept)}")
        return Path(tuple(kept), _times(kept))
    except CameraError as error:
        raise CameraError(f"{shown}: {error}") from error


def _times(poses: list[Camera]) -> F64:
    """[P] seconds, by how far each leg goes."""
    centres = np.array([pose.centre for pose in poses])
    moved = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    quats = [quaternion(pose.rotation) for pose in poses]
    turned = np.array([
        2 * math.acos(min(1.0, abs(float(a @ b)))) for a, b in itertools.pairwise(quats)
    ])  # fmt: skip
    way = np.maximum(moved, turned / math.tau * (moved.sum() or 1.0))
    least = 1e-3 * way.sum() or 1.0  # only the lens changes, or the pose by next to nothing
    spans = np.maximum(way, least)
    return np.concatenate([[0.0], np.cumsum(spans * (LEG_SECONDS * len(spans) / spans.sum()))])


def turned(camera: Camera, centre: ArrayLike, up: ArrayLike, angle: float) -> Camera:
    """``camera`` carried round ``centre`` about the axis ``up`` by ``angle`` radians.

    It keeps looking at what it looked at; at a positive angle it goes where an Orbit of higher yaw
    is. At 0 it is the camera itself.
    """
    if not angle % math.tau:
        return camera
    middle, axis = np.asarray(centre, np.float64), np.asarray(up, np.float64)
    turn = rotations(_exp(-angle / 2 * axis / np.linalg.norm(axis)))
    rotation = camera.rotation @ turn.T
    eye = middle + turn @ (camera.centre - middle)
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, -rotation @ eye
    return replace(camera, viewmat=viewmat)


# --- lenses


def _lens(camera: Camera) -> F64:
    """[4]: half the field of view across and down, radians; cx and cy as shares of the size."""
    size = np.array([camera.width, camera.height])
    half = np.arctan(size / 2 / camera.K[[0, 1], [0, 1]])
    return np.concatenate([half, camera.K[:2, 2] / size])


def _intrinsics(lens: F64, camera: Camera) -> F64:
    size = np.array([camera.width, camera.height])
    K = np.eye(3)
    K[[0, 1], [0, 1]] = size / 2 / np.tan(lens[:2])
    K[:2, 2] = lens[2:] * size
    return K


# --- curves and quaternions (w, x, y, z)


def _bezier(
    points: tuple[F64, F64, F64, F64], share: float, between: Callable[[F64, F64, float], F64]
) -> F64:
    """De Casteljau's algorithm with whichever way of going ``between`` two points."""
    row = list(points)
    while len(row) > 1:
        row = [between(a, b, share) for a, b in itertools.pairwise(row)]
    return row[0]


def _straight(a: F64, b: F64, share: float) -> F64:
    return (1 - share) * a + share * b


def slerp(a: F64, b: F64, share: float) -> F64:
    """From one unit quaternion to another at a constant rate; the short way where ``a @ b > 0``."""
    step = _log(_product(_inverse(a), b))
    quat = _product(a, _exp(share * step))
    return np.asarray(quat / np.linalg.norm(quat), np.float64)


def _product(a: F64, b: F64) -> F64:
    w = a[0] * b[0] - a[1:] @ b[1:]
    return np.concatenate([[w], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])


def _inverse(quat: F64) -> F64:
    return quat * (1.0, -1.0, -1.0, -1.0)


def _exp(half: F64) -> F64:
    """The rotation by twice ``half`` [3] radians."""
    angle = float(np.linalg.norm(half))
    return np.concatenate([[math.cos(angle)], half * np.sinc(angle / math.pi)])


def _log(quat: F64) -> F64:
    """[3] half the rotation, axis times radians."""
    length = float(np.linalg.norm(quat[1:]))
    if length == 0:
        return np.zeros(3)
    return np.asarray(quat[1:] * (math.atan2(length, quat[0]) / length), np.float64)


def quaternion(rotation: F64) -> F64:
    """Of the rotation that is nearest to a [3, 3] matrix.

    Bar-Itzhack, "New Method for Extracting the Quaternion from a Rotation Matrix", Journal of
    Guidance, Control, and Dynamics 23 (2000), version 3.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    symmetric = np.array([
        [xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, yy - xx - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, zz - xx - yy],
    ])  # fmt: skip
    return np.asarray(np.linalg.eigh(symmetric)[1][:, -1], np.float64)
