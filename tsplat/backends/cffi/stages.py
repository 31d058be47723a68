"""The C kernel's functions as stages: check arrays, lend buffers, call."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tsplat.backends.cffi._kernel import lib
from tsplat.backends.cffi.call import (
    SPLAT_ARRAYS,
    camera_struct,
    check,
    params_struct,
    pointer,
    scene_struct,
    splats_struct,
)
from tsplat.core.camera import Camera
from tsplat.core.errors import KernelError, check_array
from tsplat.core.params import RenderParams
from tsplat.core.ties import break_ties
from tsplat.core.types import I32, Bins, Frame, Scene, Splats
from tsplat.core.workspace import Workspace


def project(scene: Scene, camera: Camera, params: RenderParams, workspace: Workspace) -> Splats:
    """See :class:`tsplat.core.stages.Project`."""
    n = len(scene)
    scratch = workspace.array("cffi.project", (n, lib.TSPLAT_RECORD), np.float32)
    counts = workspace.array("cffi.chunks", (-(-n // lib.TSPLAT_CHUNK),), np.int32)
    totals = np.zeros(2, np.int64)
    degree = min(params.sh_degree, scene.sh_degree)
    check(
        lib.tsplat_project(
            scene_struct(scene), camera_struct(camera, scene), params_struct(params, degree),
            pointer(scratch, "float"), pointer(counts, "int32_t"),
            pointer(totals, "int64_t"), workspace.threads,
        ),
        "project",
    )  # fmt: skip
    m, overflowed = map(int, totals)
    arrays = {
        name: workspace.array(f"cffi.{name}", (m, *shape), dtype)
        for name, shape, dtype, _ in SPLAT_ARRAYS
    }
    splats = Splats(**arrays, width=camera.width, height=camera.height, overflowed=overflowed)
    check(
        lib.tsplat_gather(
            pointer(scratch, "float"), pointer(counts, "int32_t"), n,
            splats_struct(splats), workspace.threads,
        ),
        "project",
    )  # fmt: skip
    return replace(splats, numbers=scene.numbers_of(splats.gaussian_ids))


def sort(splats: Splats, workspace: Workspace) -> I32:
    """See :class:`tsplat.core.stages.Sort`."""
    m, threads = len(splats), workspace.threads
    depths = splats.depths
    check_array("Splats.depths", depths, np.float32, (m,))
    order: I32 = workspace.array("cffi.order", (m,), np.int32)
    pairs = workspace.array("cffi.pairs", (2 * m,), np.uint64)
    histograms = workspace.array("cffi.histograms", (threads, lib.TSPLAT_RADIX), np.uint32)
    check(
        lib.tsplat_sort(
            pointer(depths, "float"), m, pointer(order, "int32_t"),
            pointer(pairs, "uint64_t"), pointer(histograms, "uint32_t"), threads,
        ),
        "sort",
    )  # fmt: skip
    return break_ties(order, depths, splats.numbers)


def bin(splats: Splats, order: I32, workspace: Workspace) -> Bins:
    """See :class:`tsplat.core.stages.Bin`."""
    check_array("order", order, np.int32, (len(splats),))
    size, threads = lib.TSPLAT_TILE, workspace.threads
    tiles = -(-splats.width // size) * -(-splats.height // size)
    offsets = workspace.array("cffi.offsets", (tiles + 1,), np.int64)
    cursors = workspace.array("cffi.cursors", (threads, tiles), np.int64)
    boxes = workspace.array("cffi.boxes", (len(splats), 4), np.int32)
    struct = splats_struct(splats)
    check(
        lib.tsplat_bin_count(
            struct, pointer(order, "int32_t"), pointer(boxes, "int32_t"),
            pointer(offsets, "int64_t"), pointer(cursors, "int64_t"), threads,
        ),
        "bin",
    )  # fmt: skip
    ids: I32 = workspace.array("cffi.ids", (int(offsets[-1]),), np.int32)
    check(
        lib.tsplat_bin_fill(
            struct, pointer(order, "int32_t"), pointer(boxes, "int32_t"),
            pointer(cursors, "int64_t"), pointer(ids, "int32_t"), threads,
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
    check(
        lib.tsplat_composite(
            splats_struct(splats), pointer(offsets, "int64_t"), pointer(ids, "int32_t"), size,
            params_struct(params, 0), pointer(records, "float"), pointer(rgb, "float"),
            pointer(transmittance, "float"),
            pointer(depth, "float"), workspace.threads,
        ),
        "composite",
    )  # fmt: skip
    return Frame(rgb, transmittance, depth)
