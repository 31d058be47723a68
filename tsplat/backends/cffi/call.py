"""Calling the C kernel: arrays and structs as it reads them, status codes as errors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsplat.backends.cffi._kernel import ffi, lib
from tsplat.core.camera import Camera
from tsplat.core.errors import KernelError, check_array
from tsplat.core.params import RenderParams
from tsplat.core.types import Scene, Splats

_FAULTS = {
    lib.TSPLAT_BAD_SIZE: "a count, a picture size or a number of threads is out of range",
    lib.TSPLAT_BAD_ID: "an index points outside the array it indexes",
}


def check(status: int, function: str) -> None:
    """Raises KernelError unless ``status`` is 0."""
    if status:
        raise KernelError(f"{function}: {_FAULTS.get(status, f'status {status}')}")


def pointer(array: NDArray[Any] | None, ctype: str) -> Any:
    """The array's first element as a C pointer; NULL for None. The caller keeps the array."""
    return ffi.NULL if array is None else ffi.cast(f"{ctype} *", array.ctypes.data)


_SCENE_ARRAYS = ("means", "quats", "scales", "opacities")


def scene_struct(scene: Scene) -> Any:
    """``tsplat_scene *``; good as long as the scene lives."""
    fields = [(n, pointer(getattr(scene, n), "float")) for n in _SCENE_ARRAYS]
    return ffi.new(
        "tsplat_scene *",
        dict(
            fields, sh=pointer(scene.sh, "void"), half=scene.sh.dtype == np.float16,
            count=len(scene), coefficients=scene.sh.shape[1],
        ),
    )  # fmt: skip


def camera_struct(camera: Camera, scene: Scene) -> Any:
    """``tsplat_camera *``, its centre relative to the scene's origin."""
    k = camera.K
    return ffi.new(
        "tsplat_camera *",
        {
            "rotation": camera.rotation.ravel().tolist(),
            "centre": (camera.centre - scene.origin).tolist(),
            "fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2],
            "near_": camera.near, "far_": camera.far,
            "width": camera.width, "height": camera.height,
        },
    )  # fmt: skip


def params_struct(params: RenderParams, degree: int) -> Any:
    """``tsplat_params *``."""
    return ffi.new(
        "tsplat_params *",
        {
            "alpha_threshold": params.alpha_threshold,
            "transmittance_min": params.transmittance_min,
            "sh_degree": degree,
            "antialias": params.antialias,
            "depth_split": params.depth_split,
            "low_pass": params.low_pass,
        },
    )


SPLAT_ARRAYS: tuple[tuple[str, tuple[int, ...], type, str], ...] = (
    ("means2d", (2,), np.float64, "double"),
    ("factors", (3,), np.float32, "float"),
    ("depths", (), np.float32, "float"),
    ("opacities", (), np.float32, "float"),
    ("colors", (3,), np.float32, "float"),
    ("radii", (2,), np.float32, "float"),
    ("gaussian_ids", (), np.int32, "int32_t"),
)
"""Name, shape of a row, dtype and C type of the arrays of Splats."""


def splats_struct(splats: Splats) -> Any:
    """``tsplat_splats *``; good as long as the splats live."""
    m = len(splats)
    fields: dict[str, Any] = {}
    for name, shape, dtype, ctype in SPLAT_ARRAYS:
        array = check_array(f"Splats.{name}", getattr(splats, name), dtype, (m, *shape))
        fields[name] = pointer(array, ctype)
    return ffi.new(
        "tsplat_splats *", dict(fields, count=m, width=splats.width, height=splats.height)
    )
