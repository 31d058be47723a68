"""Camera files: JSON, one camera or a list of them.

tsplat's own: ``{"width", "height", "viewmat": 4 x 4 rows, world to camera, "K": 3 x 3 rows}`` and
optionally ``near`` and ``far``; axes are OpenCV's: x right, y down, z forward.

INRIA's ``cameras.json`` (graphdeco-inria/gaussian-splatting ``utils/camera_utils.py``,
``camera_to_JSON``): ``{"id", "img_name", "width", "height", "position", "rotation", "fx", "fy"}``,
where position is the camera's centre and rotation's rows are those of camera to world. The
principal point is the image's middle.

Nerfstudio's and instant-ngp's ``transforms.json``: ``{"w", "h", "fl_x", "fl_y", "cx", "cy",
"frames": [{"file_path", "transform_matrix": 4 x 4 rows, camera to world}]}``; a frame may have
intrinsics of its own, ``camera_angle_x`` (radians, the whole picture) stands for ``fl_x``. Cameras
look along -z with y up, as in OpenGL. Nerfstudio trains in a world that is turned and scaled: where
its ``dataparser_transforms.json`` lies beside, cameras are moved there. Lens distortion is left
out. Source: https://docs.nerf.studio/quickstart/data_conventions.html and nerfstudio
``data/dataparsers/base_dataparser.py``.

In a camera path (``tsplat.paths``) each may have a ``time`` in seconds.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from tsplat.core.camera import ROTATION_SLACK, Camera
from tsplat.core.constants import FAR, NEAR
from tsplat.core.errors import CameraError, printable
from tsplat.core.types import F64

SIZE_MAX = 64 << 20
"""Bytes. A camera takes 500, so this is a list of a hundred thousand."""

OWN = ("width", "height", "viewmat", "K")
INRIA = ("width", "height", "position", "rotation", "fx", "fy")
BESIDE = ("cameras.json", "transforms.json")
"""Names of the files of a scene's cameras that lie beside it or above it."""

PARSED = "dataparser_transforms.json"
OPENGL = np.array([1.0, -1.0, -1.0, 1.0])
"""Signs of the axes of a camera that looks along -z."""


def load_cameras(path: str | os.PathLike[str]) -> list[Camera]:
    """Every camera in the file, in its order; one or more.

    Raises:
        CameraError: it cannot be read, is not JSON, or an entry is no camera; one line that
            names the file, the entry's index and what is wrong.
    """
    return [camera for camera, _ in load_timed_cameras(path)]


def load_timed_cameras(path: str | os.PathLike[str]) -> list[tuple[Camera, float | None]]:
    """Every camera in the file with its ``time`` in seconds; None where it has none.

    Raises:
        CameraError: as :func:`load_cameras`, or a time is no number.
    """
    shown = printable(path)
    data = _json(Path(path), shown)
    if isinstance(data, dict) and "frames" in data:
        return [(camera, None) for camera in _transforms(Path(path), data)]
    entries = data if isinstance(data, list) else [data]
    if not entries:
        raise CameraError(f"{shown}: an empty list, expected at least one camera")
    cameras = []
    for index, entry in enumerate(entries):
        try:
            camera, time = camera_from_json(entry), entry.get("time")
            seconds = None if time is None else float(_numbers(time, "time", ()))
        except CameraError as error:
            raise CameraError(f"{shown}: camera {index}: {error}") from error
        cameras.append((camera, seconds))
    return cameras


@np.errstate(over="ignore", invalid="ignore")  # what overflows is no rotation
def load_rotations(path: str | os.PathLike[str]) -> F64:
    """[n, 3, 3] world to camera of every camera in the file.

    Of INRIA's and Nerfstudio's files, which have hundreds, no Camera is made: that takes 0.3 ms.

    Raises:
        CameraError: the file cannot be read, or what should be a rotation is none.
    """
    shown = printable(path)
    data = _json(Path(path), shown)
    if isinstance(data, dict) and "frames" in data:
        world, _ = _world(Path(path))
        placed = _stacked(_frames(data, shown), "transform_matrix", 4, shown)[:, :3, :3]
        rotations = (world[:3, :3] @ (placed * OPENGL[:3])).transpose(0, 2, 1)
    elif isinstance(data, list) and data and all(map(_inria, data)):
        rotations = _stacked(data, "rotation", 3, shown).transpose(0, 2, 1)
    else:
        rotations = np.stack([camera.rotation for camera in load_cameras(path)])
    off = float(np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max())
    if not off <= ROTATION_SLACK:
        raise CameraError(
            f"{shown}: expected rotations, but rows are off orthonormal by {off:.3g}; "
            "scale and shear belong into the scene"
        )
    return np.asarray(rotations, np.float64)


def _stacked(entries: Any, key: str, size: int, shown: str) -> F64:
    """[n, size, size] what all ``entries`` say of ``key``."""
    try:
        stacked = np.array([entry[key] for entry in entries])
    except (KeyError, TypeError, ValueError) as error:  # none, or lists of other lengths
        raise CameraError(f"{shown}: expected {key} in every entry, {size} x {size}") from error
    if stacked.dtype.kind not in "iuf" or stacked.shape[1:] != (size, size):
        raise CameraError(f"{shown}: {key}: expected {size} x {size} numbers in every entry")
    return stacked.astype(np.float64)


def _inria(entry: object) -> bool:
    """Whether it is a camera in INRIA's way of writing."""
    return isinstance(entry, dict) and "viewmat" not in entry and "position" in entry


def _frames(data: dict[str, Any], shown: str) -> list[Any]:
    """Those of a ``transforms.json``."""
    frames = data["frames"]
    if not isinstance(frames, list) or not frames:
        raise CameraError(f"{shown}: frames: expected a list of at least one camera")
    return frames


def cameras_beside(scene: Path) -> Path | None:
    """The file of the cameras that belong to the scene in the file or folder ``scene``, if any.

    INRIA's trainer leaves one two folders above the scene's.
    """
    place = scene.absolute()
    for folder in (place, *place.parents[:3]):
        for name in BESIDE:
            if (folder / name).is_file():
                return folder / name
    return None


def _transforms(path: Path, data: dict[str, Any]) -> list[Camera]:
    """The cameras of a ``transforms.json``."""
    shown = printable(path)
    frames = _frames(data, shown)
    world, scale = _world(path)
    cameras = []
    for index, frame in enumerate(frames):
        try:
            if not isinstance(frame, dict):
                raise CameraError(f"expected an object, got {type(frame).__name__}")
            cameras.append(_transformed({**data, **frame}, world, scale))
        except CameraError as error:
            raise CameraError(f"{shown}: frame {index}: {error}") from error
    return cameras


def _world(path: Path) -> tuple[F64, float]:
    """[4, 4] and a scale: what moves the cameras of a ``transforms.json`` to the scene's world."""
    world, scale = np.eye(4), 1.0
    if path.name == BESIDE[1] and (path.parent / PARSED).is_file():
        parsed = _json(path.parent / PARSED, printable(path.parent / PARSED))
        if not isinstance(parsed, dict) or not {"transform", "scale"} <= parsed.keys():
            raise CameraError(f"{printable(path.parent / PARSED)}: lacks transform or scale")
        world[:3] = _numbers(parsed["transform"], "transform", (3, 4))
        scale = float(_numbers(parsed["scale"], "scale", ()))
    return world, scale


@np.errstate(over="ignore", invalid="ignore")  # what overflows is no Camera
def _transformed(entry: dict[str, Any], world: F64, scale: float) -> Camera:
    """One frame of a ``transforms.json``, moved by ``world`` [4, 4] and then scaled."""
    missing = [key for key in ("transform_matrix", "w", "h") if key not in entry]
    if missing:
        raise CameraError(f"lacks {', '.join(missing)}")
    width, height = _whole(entry["w"], "w"), _whole(entry["h"], "h")
    if "fl_x" in entry:
        fx = float(_numbers(entry["fl_x"], "fl_x", ()))
    elif "camera_angle_x" in entry:
        angle = float(_numbers(entry["camera_angle_x"], "camera_angle_x", ()))
        fx = width / 2 / math.tan(angle / 2) if 0 < angle < math.pi else math.nan
    else:
        raise CameraError("lacks fl_x; expected that or camera_angle_x")
    fy = float(_numbers(entry.get("fl_y", fx), "fl_y", ()))
    cx = float(_numbers(entry.get("cx", width / 2), "cx", ()))
    cy = float(_numbers(entry.get("cy", height / 2), "cy", ()))
    placed = world @ (_numbers(entry["transform_matrix"], "transform_matrix", (4, 4)) * OPENGL)
    placed[:3, 3] *= scale
    rotation = placed[:3, :3].T
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ placed[:3, 3]
    return Camera(viewmat, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), width, height)


def load_camera(spec: str) -> Camera:
    """The camera that ``FILE#INDEX`` names; see :func:`parse_camera_spec`.

    Raises:
        CameraError: no such file, or no such camera in it.
    """
    path, index = parse_camera_spec(spec)
    cameras = load_cameras(path)
    if index >= len(cameras):
        raise CameraError(
            f"{printable(path)}: no camera {index}; it has {len(cameras)}, "
            f"#0 to #{len(cameras) - 1}"
        )
    return cameras[index]


def parse_camera_spec(spec: str) -> tuple[str, int]:
    """``FILE#INDEX`` -> (FILE, INDEX), counted from 0; a FILE alone is its first camera.

    Raises:
        CameraError: no FILE, or an INDEX that is not a whole number.
    """
    path, hash_sign, text = spec.rpartition("#")
    if not hash_sign:
        path, text = spec, "0"
    if not path or not (text.isascii() and text.isdigit()) or len(text) > 9:
        raise CameraError(
            f"camera {printable(spec)!r}: expected FILE#INDEX with INDEX 0, 1, 2, ..., "
            "such as cameras.json#0"
        )
    return path, int(text)


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """``camera`` as :func:`load_cameras` reads it; numbers keep every bit."""
    return {
        "width": camera.width,
        "height": camera.height,
        "viewmat": camera.viewmat.tolist(),
        "K": camera.K.tolist(),
        "near": camera.near,
        "far": camera.far,
    }


@np.errstate(over="ignore", invalid="ignore")  # what overflows is no Camera
def camera_from_json(entry: object) -> Camera:
    """The camera that one JSON object describes.

    Raises:
        CameraError: a key is missing, a value has another shape, or Camera refuses the numbers.
    """
    if not isinstance(entry, dict):
        raise CameraError(f"expected an object, got {type(entry).__name__}")
    keys = INRIA if _inria(entry) else OWN
    missing = [key for key in keys if key not in entry]
    if missing:
        raise CameraError(
            f"lacks {', '.join(missing)}; expected {', '.join(OWN)}, or INRIA's {', '.join(INRIA)}"
        )
    width, height = (_whole(entry[key], key) for key in ("width", "height"))
    near, far = (
        float(_numbers(entry.get(key, default), key, ()))
        for key, default in (("near", NEAR), ("far", FAR))
    )
    if keys is OWN:
        viewmat = _numbers(entry["viewmat"], "viewmat", (4, 4))
        intrinsics = _numbers(entry["K"], "K", (3, 3))
    else:
        rotation = _numbers(entry["rotation"], "rotation", (3, 3)).T
        fx, fy = (float(_numbers(entry[key], key, ())) for key in ("fx", "fy"))
        viewmat = np.eye(4)
        viewmat[:3, :3] = rotation
        viewmat[:3, 3] = -rotation @ _numbers(entry["position"], "position", (3,))
        intrinsics = np.array([[fx, 0, width / 2], [0, fy, height / 2], [0, 0, 1]])
    return Camera(viewmat, intrinsics, width, height, near, far)


def _whole(value: object, key: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value // 1:
        raise CameraError(f"{key}: expected a whole number, got {printable(repr(value), 40)}")
    return int(value)


def _numbers(value: object, key: str, shape: tuple[int, ...]) -> F64:
    """A JSON number or nested lists of them as float64 of ``shape``."""
    wanted = " x ".join(map(str, shape)) + " numbers" if shape else "a number"
    if not _has_shape(value, shape):
        raise CameraError(f"{key}: expected {wanted}, got {printable(repr(value), 60)}")
    try:
        numbers = np.array(value, np.float64)
    except OverflowError as error:
        raise CameraError(f"{key}: expected {wanted} within the range of float64") from error
    if not np.isfinite(numbers).all():
        raise CameraError(f"{key}: expected {wanted} within the range of float64")
    return numbers


def _has_shape(value: object, shape: tuple[int, ...]) -> bool:
    if not shape:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return (
        isinstance(value, list)
        and len(value) == shape[0]
        and all(_has_shape(v, shape[1:]) for v in value)
    )


def _json(path: Path, shown: str) -> Any:
    """The parsed file; NaN and Infinity, which JSON does not have, are refused."""
    try:
        if path.is_dir():
            raise CameraError(f"{shown}: is a directory; name a JSON file in it")
        if not path.exists():
            raise CameraError(f"{shown}: no such file")
        with path.open("rb") as stream:
            raw = stream.read(SIZE_MAX + 1)
    except OSError as error:
        raise CameraError(f"{shown}: cannot be read: {printable(error.strerror)}") from error
    if len(raw) > SIZE_MAX:
        raise CameraError(f"{shown}: more than {SIZE_MAX} bytes, too large for a list of cameras")

    def refuse(constant: str) -> NoReturn:
        raise CameraError(
            f"{shown}: has {constant}, which is not JSON; cameras need finite numbers"
        )

    try:
        return json.loads(raw.decode("utf-8-sig"), parse_constant=refuse)
    except CameraError:
        raise
    except (ValueError, RecursionError) as error:  # not UTF-8, not JSON, nested without end
        raise CameraError(f"{shown}: not a JSON file: {printable(error, 80)}") from error
