"""Pinhole cameras, and two ways to move one: around a point, or through the scene.

Axes are OpenCV's: x right, y down, z forward. ``viewmat`` takes world to camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from tsplat.core.constants import FAR, FAR_MAX, NEAR
from tsplat.core.errors import CameraError
from tsplat.core.types import F64

ROTATION_SLACK = 1e-3
"""How far rows of a rotation may be off orthonormal."""

PIXELS_MAX = 2**28
"""Pixels in one picture: 4 GiB of float32 RGB and transmittance."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera.

    Raises:
        CameraError: no picture can be made with it (sizes, focal lengths, a reflection, shear).
    """

    viewmat: F64  # [4, 4]  world to camera, rigid
    K: F64  # [3, 3]        px: fx, fy on the diagonal, cx, cy in the last column
    width: int  # px
    height: int  # px
    near: float = NEAR  # world units
    far: float = FAR  # world units; FAR_MAX at most, whatever is asked for

    def __post_init__(self) -> None:
        viewmat = np.array(self.viewmat, np.float64)
        intrinsics = np.array(self.K, np.float64)
        object.__setattr__(self, "viewmat", viewmat)
        object.__setattr__(self, "K", intrinsics)
        for name, array, shape in (("viewmat", viewmat, (4, 4)), ("K", intrinsics, (3, 3))):
            if array.shape != shape or not np.isfinite(array).all():
                raise CameraError(
                    f"Camera.{name}: expected {shape[0]} x {shape[1]} finite numbers, "
                    f"got shape {list(array.shape)} with {_finite(array)}"
                )
            array.flags.writeable = False
        if self.width < 1 or self.height < 1 or self.width * self.height > PIXELS_MAX:
            raise CameraError(
                f"Camera: expected a size from 1x1 to {PIXELS_MAX} pixels in all, "
                f"got {self.width}x{self.height}"
            )
        # Beyond it depths would be infinite in float32. NaN stays NaN, and is refused.
        object.__setattr__(self, "far", FAR_MAX if self.far > FAR_MAX else self.far)
        if not 0 < self.near < self.far:
            raise CameraError(f"Camera: expected 0 < near < far, got {self.near} and {self.far}")
        fx, fy = intrinsics[0, 0], intrinsics[1, 1]
        if fx <= 0 or fy <= 0:
            raise CameraError(f"Camera.K: expected positive focal lengths, got {fx} and {fy}")
        rest = intrinsics[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]]
        if not np.array_equal(rest, [0, 0, 0, 0, 1]):
            raise CameraError(
                "Camera.K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; this one has skew or "
                f"another last row: {intrinsics.tolist()}"
            )
        rotation = viewmat[:3, :3]
        if not np.array_equal(viewmat[3], [0, 0, 0, 1]):
            raise CameraError(
                f"Camera.viewmat: expected [0, 0, 0, 1] as its last row, got {viewmat[3].tolist()}."
                " The matrix is row-major; transpose one that is column-major."
            )
        with np.errstate(all="ignore"):  # what overflows is far off, or not a number
            off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if not off <= ROTATION_SLACK:
            raise CameraError(
                f"Camera.viewmat: expected a rotation, but rows are off orthonormal by {off:.3g}. "
                "Scale and shear belong into the scene."
            )
        if np.linalg.det(rotation) < 0:
            raise CameraError(
                "Camera.viewmat: expected a rotation, got a reflection (determinant -1). "
                "Axes are OpenCV's: x right, y down, z forward."
            )

    def same(self, other: Camera) -> bool:
        """Whether both take the same picture of any scene."""
        return (
            (self.width, self.height, self.near, self.far)
            == (other.width, other.height, other.near, other.far)
            and np.array_equal(self.viewmat, other.viewmat)
            and np.array_equal(self.K, other.K)
        )

    @property
    def rotation(self) -> F64:
        """[3, 3] world to camera."""
        return self.viewmat[:3, :3]

    @cached_property
    def centre(self) -> F64:
        """[3] world units: the point that every ray leaves from."""
        return np.asarray(-np.linalg.solve(self.rotation, self.viewmat[:3, 3]), np.float64)

    def resized(self, width: int, height: int) -> Camera:
        """The same view in ``width`` x ``height`` pixels; ``K`` is scaled per axis."""
        scale = np.array([[width / self.width], [height / self.height], [1.0]])
        return replace(self, K=self.K * scale, width=width, height=height)

    def reframed(self, width: int, height: int) -> Camera:
        """The same height of view in ``width`` x ``height`` px: sides are cut off or added."""
        scale = height / self.height
        K = self.K * np.array([[scale], [scale], [1.0]])
        K[0, 2] += (width - scale * self.width) / 2
        return replace(self, K=K, width=width, height=height)


def _finite(array: F64) -> str:
    bad = int(array.size - np.isfinite(array).sum())
    return f"{bad} of {array.size} not finite" if bad else "all finite"


def intrinsics(width: int, height: int, fov: float) -> F64:
    """K of square pixels and a centred principal point; ``fov`` is vertical, in degrees.

    Raises:
        CameraError: ``fov`` is not between 0 and 180.
    """
    if not 0 < fov < 180:
        raise CameraError(f"fov: expected degrees between 0 and 180, got {fov}")
    f = 0.5 * height / math.tan(math.radians(fov) / 2)
    return np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1.0]])


def _viewmat(eye: F64, right: F64, down: F64, forward: F64) -> F64:
    viewmat = np.eye(4)
    viewmat[:3, :3] = right, down, forward
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    return viewmat


def look_at(
    eye: ArrayLike,
    target: ArrayLike,
    up: ArrayLike,
    fov: float,
    width: int,
    height: int,
    near: float = NEAR,
    far: float = FAR,
) -> Camera:
    """A camera at ``eye`` that has ``target`` in its middle and ``up`` (world) upwards.

    Raises:
        CameraError: ``eye`` is ``target``, or ``up`` is zero or along the line of sight.
    """
    where, at, upwards = (np.asarray(v, np.float64) for v in (eye, target, up))
    forward = at - where
    distance = math.hypot(*forward)
    if not (math.isfinite(distance) and distance > 0):
        raise CameraError(
            "look_at: expected eye and target to be finite and to differ, "
            f"got {where.tolist()} and {at.tolist()}"
        )
    forward = forward / distance
    right = np.cross(forward, upwards)
    length = float(np.linalg.norm(right))
    if not length > 1e-9 * float(np.linalg.norm(upwards)):
        raise CameraError(
            f"look_at: up {upwards.tolist()} is zero or along the line of sight; choose another"
        )
    right = right / length
    down = np.cross(forward, right)
    return Camera(
        _viewmat(where, right, down, forward),
        intrinsics(width, height, fov), width, height, near, far,
    )  # fmt: skip


def _axes(up: F64, yaw: float, pitch: float) -> tuple[F64, F64, F64]:
    """right, down, forward of a camera turned by ``yaw`` and tilted down by ``pitch`` (radians)."""
    upwards = up / np.linalg.norm(up)
    ahead = np.array([0.0, 0.0, 1.0]) if abs(upwards[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    ahead = ahead - upwards * (ahead @ upwards)
    ahead /= np.linalg.norm(ahead)
    side = np.cross(ahead, upwards)
    flat = math.cos(yaw) * ahead + math.sin(yaw) * side
    forward = math.cos(pitch) * flat - math.sin(pitch) * upwards
    down = -math.cos(pitch) * upwards - math.sin(pitch) * flat
    return np.cross(down, forward), down, forward


@dataclass(frozen=True, eq=False)
class Orbit:
    """A camera that circles ``target``; well defined at the poles too."""

    target: F64  # [3]     world units
    distance: float  # world units
    yaw: float  # radians, about up
    pitch: float  # radians; positive looks down from above
    up: F64  # [3]         world direction that is upwards

    def camera(
        self, fov: float, width: int, height: int, near: float = NEAR, far: float = FAR
    ) -> Camera:
        """The pinhole camera at this place; ``fov`` is vertical, in degrees."""
        right, down, forward = _axes(self.up, self.yaw, self.pitch)
        eye = self.target - self.distance * forward
        view = _viewmat(eye, right, down, forward)
        return Camera(view, intrinsics(width, height, fov), width, height, near, far)

    def panned(self, right: float, up: float, forward: float = 0.0) -> Orbit:
        """Moved along the camera's own axes, in world units."""
        x, y, z = _axes(self.up, self.yaw, self.pitch)
        return replace(self, target=self.target + right * x - up * y + forward * z)


@dataclass(frozen=True, eq=False)
class Fly:
    """A camera that stands at ``eye`` and looks around."""

    eye: F64  # [3]       world units
    yaw: float  # radians, about up
    pitch: float  # radians; positive looks down
    up: F64  # [3]        world direction that is upwards

    def camera(
        self, fov: float, width: int, height: int, near: float = NEAR, far: float = FAR
    ) -> Camera:
        """The pinhole camera at this place; ``fov`` is vertical, in degrees."""
        view = _viewmat(self.eye, *_axes(self.up, self.yaw, self.pitch))
        return Camera(view, intrinsics(width, height, fov), width, height, near, far)

    def moved(self, right: float, up: float, forward: float) -> Fly:
        """Moved along the camera's own axes, in world units."""
        x, y, z = _axes(self.up, self.yaw, self.pitch)
        return replace(self, eye=self.eye + right * x - up * y + forward * z)
