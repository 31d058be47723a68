"""The whole frame in C: records straight from the projection, splats sorted tile by tile."""

from __future__ import annotations

import time

import numpy as np

from tsplat.backends.cffi._kernel import ffi, lib
from tsplat.backends.cffi.call import camera_struct, check, params_struct, pointer
from tsplat.backends.cffi.pack import pack
from tsplat.core.camera import Camera
from tsplat.core.params import RenderParams
from tsplat.core.stages import Counts
from tsplat.core.types import Frame, Scene
from tsplat.core.workspace import Workspace

_FIELDS = (
    ("records", np.float32, "float"), ("boxes", np.int32, "int32_t"),
    ("depths", np.float32, "float"), ("cluster_counts", np.int32, "int32_t"),
    ("owners", np.int32, "int32_t"), ("steps", np.int32, "int32_t"),
    ("cursors", np.int64, "int64_t"), ("tile_offsets", np.int64, "int64_t"),
)  # fmt: skip


def fused(
    scene: Scene, camera: Camera, params: RenderParams, workspace: Workspace
) -> tuple[Frame, Counts]:
    """See :class:`tsplat.core.stages.Fused`."""
    clock = time.perf_counter
    degree = min(params.sh_degree, scene.sh_degree)
    packed = pack(scene, params, degree, workspace)
    begin = clock()
    width, height, threads = camera.width, camera.height, workspace.threads
    across, down = -(-width // lib.TSPLAT_TILE), -(-height // lib.TSPLAT_TILE)
    slots, clusters, tiles = packed.slots, len(packed.bounds), across * down
    shapes = (
        (slots, lib.TSPLAT_RECORD), (slots, 2), (slots,), (clusters,), (clusters,),
        (threads, down + 1, across + 1), (threads, tiles), (tiles + 1,),
    )  # fmt: skip
    space = ffi.new("tsplat_space *")
    for (name, dtype, ctype), shape in zip(_FIELDS, shapes, strict=True):
        setattr(space, name, pointer(workspace.array(f"cffi.frame.{name}", shape, dtype), ctype))
    eye, how = camera_struct(camera, scene), params_struct(params, degree)
    totals = ffi.new("int64_t[5]")
    check(
        lib.tsplat_frame_project(
            packed.struct, packed.scene, eye, how, 1, space, totals, threads
        ),
        "project",
    )  # fmt: skip
    projected = clock()
    visible, overflowed, _skipped, intersections, longest = totals
    pairs = workspace.array("cffi.frame.pairs", (intersections,), np.uint64)
    scratch = workspace.array("cffi.frame.scratch", (threads, longest), np.uint64)
    ids = workspace.array("cffi.frame.ids", (threads, longest), np.int32)
    space.pairs, space.scratch = pointer(pairs, "uint64_t"), pointer(scratch, "uint64_t")
    space.ids = pointer(ids, "int32_t")
    check(lib.tsplat_frame_bin(packed.struct, eye, space, threads), "bin")
    binned = clock()
    rgb = workspace.array("cffi.rgb", (height, width, 3), np.float32)
    transmittance = workspace.array("cffi.transmittance", (height, width), np.float32)
    depth = workspace.array("cffi.depth", (height, width), np.float32) if params.depth else None
    check(
        lib.tsplat_frame_composite(
            packed.struct, eye, how, space, longest, pointer(rgb, "float"),
            pointer(transmittance, "float"), pointer(depth, "float"), threads,
        ),
        "composite",
    )  # fmt: skip
    end = clock()
    seconds = {"project": projected - begin, "bin": binned - projected, "composite": end - binned}
    return Frame(rgb, transmittance, depth), Counts(visible, intersections, overflowed, seconds)
