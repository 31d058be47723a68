"""The C kernel's functions as stages: check arrays, lend buffers, call, turn status into errors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsplat.backends.cffi._kernel import ffi, lib
from tsplat.core.camera import Camera
from tsplat.core.errors import KernelError, check_array
from tsplat.core.params import RenderParams
from tsplat.core.types import I32, Bins, Frame, Scene, Splats
from tsplat.core.workspace import Workspace

_FAULTS = {
    lib.TSPLAT_BAD_SIZE: "a count, a picture size or a number of threads is out of range",
    lib.TSPLAT_BAD_ID: "an index points outside the array it indexes",
}


def _check(status: int, function: str) -> None:
    if status:
        raise KernelError(f"{function}: {_FAULTS.get(status, f'status {status}')}")


def _pointer(array: NDArray[Any] | None, ctype: str) -> Any:
    return ffi.NULL if array is None else ffi.cast(f"{ctype} *", array.ctypes.data)


def _scene(scene: Scene, workspace: Workspace) -> Any:
    fields = [(n, _pointer(getattr(scene, n), "float")) for n in _SCENE_ARRAYS]
    sh = workspace.float32(scene.sh)
    return ffi.new(
        "tsplat_scene *",
        dict(fields, sh=_pointer(sh, "float"), count=len(scene), coefficients=sh.shape[1]),
    )


_SCENE_ARRAYS = ("means", "quats", "scales", "opacities")


def _camera(camera: Camera, scene: Scene) -> Any:
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


def _params(params: RenderParams, degree: int) -> Any:
    return ffi.new(
        "tsplat_params *",
        {
            "alpha_threshold": params.alpha_threshold,
            "transmittance_min": params.transmittance_min,
            "sh_degree": degree,
            "antialias": params.antialias,
        },
    )


_SPLAT_ARRAYS: tuple[tuple[str, tuple[int, ...], type, str], ...] = (
    ("means2d", (2,), np.float64, "double"),
    ("factors", (3,), np.float32, "float"),
    ("depths", (), np.float32, "float"),
    ("opacities", (), np.float32, "float"),
    ("colors", (3,), np.float32, "float"),
    ("radii", (2,), np.float32, "float"),
    ("gaussian_ids", (), np.int32, "int32_t"),
)


def _splats(splats: Splats) -> Any:
    m = len(splats)
    fields: dict[str, Any] = {}
    for name, shape, dtype, ctype in _SPLAT_ARRAYS:
        array = check_array(f"Splats.{name}", getattr(splats, name), dtype, (m, *shape))
        fields[name] = _pointer(array, ctype)
    return ffi.new(
        "tsplat_splats *", dict(fields, count=m, width=splats.width, height=splats.height)
    )


def project(scene: Scene, camera: Camera, params: RenderParams, workspace: Workspace) -> Splats:
    """See :class:`tsplat.core.stages.Project`."""
    n = len(scene)
    scratch = workspace.array("cffi.project", (n, lib.TSPLAT_RECORD), np.float32)
    counts = workspace.array("cffi.chunks", (-(-n // lib.TSPLAT_CHUNK),), np.int32)
    totals = np.zeros(2, np.int64)
    degree = min(params.sh_degree, scene.sh_degree)
    _check(
        lib.tsplat_project(
            _scene(scene, workspace), _camera(camera, scene), _params(params, degree),
            _pointer(scratch, "float"), _pointer(counts, "int32_t"),
            _pointer(totals, "int64_t"), workspace.threads,
        ),
        "project",
    )  # fmt: skip
    m, overflowed = map(int, totals)
    arrays = {
        name: workspace.array(f"cffi.{name}", (m, *shape), dtype)
        for name, shape, dtype, _ in _SPLAT_ARRAYS
    }
    splats = Splats(**arrays, width=camera.width, height=camera.height, overflowed=overflowed)
    _check(
        lib.tsplat_gather(
            _pointer(scratch, "float"), _pointer(counts, "int32_t"), n,
            _splats(splats), workspace.threads,
        ),
        "project",
    )  # fmt: skip
    return splats


def sort(splats: Splats, workspace: Workspace) -> I32:
    """See :class:`tsplat.core.stages.Sort`."""
    m, threads = len(splats), workspace.threads
    depths = check_array("Splats.depths", splats.depths, np.float32, (m,))
    order: I32 = workspace.array("cffi.order", (m,), np.int32)
    pairs = workspace.array("cffi.pairs", (2 * m,), np.uint64)
    histograms = workspace.array("cffi.histograms", (threads, lib.TSPLAT_RADIX), np.uint32)
    _check(
        lib.tsplat_sort(
            _pointer(depths, "float"), m, _pointer(order, "int32_t"),
            _pointer(pairs, "uint64_t"), _pointer(histograms, "uint32_t"), threads,
        ),
        "sort",
    )  # fmt: skip
    return order


def bin(splats: Splats, order: I32, workspace: Workspace) -> Bins:
    """See :class:`tsplat.core.stages.Bin`."""
    check_array("order", order, np.int32, (len(splats),))
    size, threads = lib.TSPLAT_TILE, workspace.threads
    tiles = -(-splats.width // size) * -(-splats.height // size)
    offsets = workspace.array("cffi.offsets", (tiles + 1,), np.int64)
    cursors = workspace.array("cffi.cursors", (threads, tiles), np.int64)
    boxes = workspace.array("cffi.boxes", (len(splats), 4), np.int32)
    struct = _splats(splats)
    _check(
        lib.tsplat_bin_count(
            struct, _pointer(order, "int32_t"), _pointer(boxes, "int32_t"),
            _pointer(offsets, "int64_t"), _pointer(cursors, "int64_t"), threads,
        ),
        "bin",
    )  # fmt: skip
    ids: I32 = workspace.array("cffi.ids", (int(offsets[-1]),), np.int32)
    _check(
        lib.tsplat_bin_fill(
            struct, _pointer(order, "int32_t"), _pointer(boxes, "int32_t"),
            _pointer(cursors, "int64_t"), _pointer(ids, "int32_t"), threads,
        ),
        "bin",
    )  # fmt: skip
    return Bins(offsets, ids, size)


def composite(splats: Splats, bins: Bins, params: RenderParams, workspace: Workspace) -> Frame:
    """See :class:`tsplat.core.stages.Composite`."""
    height, width, size = splats.height, splats.width, bins.tile_size
    tiles = -(-width // size) * -(-height // size)
    offsets = check_array("Bins.tile_offsets", bins.tile_offsets, np.int64, (tiles + 1,))
    ids = check_array("Bins.splat_ids", bins.splat_ids, np.int32, (int(bins.tile_offsets[-1]),))
    if offsets[0] != 0 or (np.diff(offsets) < 0).any():
        raise KernelError("composite: Bins.tile_offsets must start at 0 and never fall")
    records = workspace.array("cffi.records", (len(splats), lib.TSPLAT_RECORD), np.float32)
    rgb = workspace.array("cffi.rgb", (height, width, 3), np.float32)
    transmittance = workspace.array("cffi.transmittance", (height, width), np.float32)
    depth = workspace.array("cffi.depth", (height, width), np.float32) if params.depth else None
    _check(
        lib.tsplat_composite(
            _splats(splats), _pointer(offsets, "int64_t"), _pointer(ids, "int32_t"), size,
            _params(params, 0), _pointer(records, "float"), _pointer(rgb, "float"),
            _pointer(transmittance, "float"),
            _pointer(depth, "float"), workspace.threads,
        ),
        "composite",
    )  # fmt: skip
    return Frame(rgb, transmittance, depth)
