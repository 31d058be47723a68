"""The whole frame in C: records straight from the projection, splats sorted tile by tile."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from tsplat.backends.cffi._kernel import ffi, lib
from tsplat.backends.cffi.call import camera_struct, check, params_struct, pointer
from tsplat.backends.cffi.pack import Packed, pack
from tsplat.core.camera import Camera
from tsplat.core.constants import ALPHA_FLOOR
from tsplat.core.params import RenderParams
from tsplat.core.stages import Counts, LeftOut
from tsplat.core.types import Frame, Scene
from tsplat.core.workspace import Workspace

# A frame is made slab by slab, front to back, if tiles and splats have so many intersections each:
# looking at all splats once per slab must cost less than what opaque tiles save.
CROWDED_TILES, CROWDED_SPLATS = 1024, 8
FIRST_SLAB = 64  # intersections per tile
FAR_BITS = 2**32 - 1
_FIELDS = (
    ("records", np.float32, "float"), ("boxes", np.int32, "int32_t"),
    ("depths", np.float32, "float"), ("cluster_counts", np.int32, "int32_t"),
    ("owners", np.int32, "int32_t"), ("steps", np.int32, "int32_t"),
    ("cursors", np.int64, "int64_t"), ("tile_offsets", np.int64, "int64_t"),
    ("closed", np.uint8, "uint8_t"),
)  # fmt: skip


def leaves_out(scene: Scene, params: RenderParams) -> tuple[LeftOut, ...]:
    """What no frame of ``scene`` needs, whatever the camera."""
    out = []
    faint = int((scene.opacities < max(params.alpha_threshold, ALPHA_FLOOR)).sum())
    if faint:
        out.append(LeftOut(f"{faint:,} Gaussians", "their opacity is below the alpha threshold"))
    cluster, left = int(lib.TSPLAT_CLUSTER), len(scene) - faint
    if left > cluster:
        why = f"{-(-left // cluster):,} clusters of {cluster} neighbours have bounds"
        out.append(LeftOut("Gaussians out of sight", why))
    if min(params.sh_degree, scene.sh_degree) == 0:
        out.append(LeftOut("colours per frame", "the same from all sides: worked out once"))
    else:
        out.append(LeftOut("harmonics of Gaussians that are not visible", "projected first"))
    return tuple(out)


def _keep_colors(
    packed: Packed, struct: Any, degree: int, camera: Camera, workspace: Workspace
) -> None:
    """Lends memory for colours from the second frame on that is taken from one place.

    A camera that turns has its centre worked out anew and rounded; up to 1e-7 of the near plane's
    distance, no direction to a visible Gaussian changes by more than float32 rounds it.
    """
    last, lanes = workspace.known.get("cffi.colors"), len(packed.columns)
    if (
        last is None
        or last[0] is not packed
        or last[1] != degree
        or abs(camera.centre - last[2]).max() > 1e-7 * camera.near
    ):
        workspace.known["cffi.colors"] = (packed, degree, camera.centre, False)
        return
    colors = workspace.array("cffi.colors", (lanes, 3, 16), np.float32)
    kept = workspace.array("cffi.kept", (lanes,), np.uint16)
    if not last[3]:
        kept.fill(0)
        workspace.known["cffi.colors"] = (*last[:3], True)
    struct.colors, struct.kept = pointer(colors, "float"), pointer(kept, "uint16_t")


def _frame_left_out(
    skipped: tuple[int, int], empty: tuple[int, int], kept: int, hidden: tuple[int, int]
) -> tuple[LeftOut, ...]:
    """Of so many, where two numbers are given."""
    out = []
    for (count, of), things, why in (
        (skipped, "Gaussians", "their clusters are out of sight"),
        (empty, "tiles", "no splat reaches them"),
        (hidden, "intersections", "the tiles are opaque before"),
    ):
        if count:
            out.append(LeftOut(f"{count:,} of {of:,} {things}", why))
    if kept:
        why = "the camera stands where it stood"
        out.append(LeftOut(f"{kept:,} colours", why, "none moves by more than float32 rounds it"))
    return tuple(out)


def fused(
    scene: Scene,
    camera: Camera,
    params: RenderParams,
    workspace: Workspace,
    everything: bool = False,
) -> tuple[Frame, Counts]:
    """See :class:`tsplat.core.stages.Fused`."""
    clock = time.perf_counter
    degree = min(params.sh_degree, scene.sh_degree)
    packed = pack(scene, params, degree, workspace, everything)
    start = clock()
    width, height, threads = camera.width, camera.height, workspace.threads
    across, down = -(-width // lib.TSPLAT_TILE), -(-height // lib.TSPLAT_TILE)
    slots, clusters, tiles = packed.slots, len(packed.bounds), across * down
    shapes = (
        (slots, lib.TSPLAT_RECORD), (slots, 2), (slots,), (clusters,), (clusters,),
        (threads, down + 1, across + 1), (threads, tiles), (tiles + 1,), (tiles,),
    )  # fmt: skip
    space = ffi.new("tsplat_space *")
    for (name, dtype, ctype), shape in zip(_FIELDS, shapes, strict=True):
        setattr(space, name, pointer(workspace.array(f"cffi.frame.{name}", shape, dtype), ctype))
    eye, how = camera_struct(camera, scene), params_struct(params, degree)
    struct = ffi.new("tsplat_packed *", packed.struct[0])
    if degree and not everything:
        _keep_colors(packed, struct, degree, camera, workspace)
    totals = ffi.new("int64_t[7]")
    check(
        lib.tsplat_frame_project(
            struct, packed.scene, eye, how, not everything, space, totals, threads
        ),
        "project",
    )  # fmt: skip
    projected = clock()
    visible, overflowed, skipped, intersections, longest, empty, kept = totals
    rgb = workspace.array("cffi.rgb", (height, width, 3), np.float32)
    transmittance = workspace.array("cffi.transmittance", (height, width), np.float32)
    depth = workspace.array("cffi.depth", (height, width), np.float32) if params.depth else None
    bounds, slabs = [0, FAR_BITS], 1
    crowded = intersections > max(CROWDED_TILES * tiles, CROWDED_SPLATS * visible)
    if crowded and not everything:
        made, number = ffi.new("uint32_t[]", lib.TSPLAT_SLABS + 1), ffi.new("int32_t *")
        share = FIRST_SLAB * tiles
        check(lib.tsplat_frame_slabs(struct, eye, space, share, made, number), "slabs")
        bounds, slabs = list(made), number[0]
    drawn, binning, compositing = 0, 0.0, 0.0
    for slab in range(slabs):
        begin = clock()
        near, far = bounds[slab : slab + 2]
        if slabs > 1:
            counted = ffi.new("int64_t[2]")
            check(lib.tsplat_frame_count(struct, eye, space, near, far, counted, threads), "count")
            intersections, longest = counted
        drawn += intersections
        pairs = workspace.array("cffi.frame.pairs", (intersections,), np.uint64)
        space.pairs = pointer(pairs, "uint64_t")
        check(lib.tsplat_frame_bin(struct, eye, space, near, far, threads), "bin")
        # where boxes and depths were, if they have served
        memory = ("boxes", "depths") if slabs == 1 else ("scratch", "ids")
        scratch = workspace.array(f"cffi.frame.{memory[0]}", (threads, longest), np.uint64)
        ids = workspace.array(f"cffi.frame.{memory[1]}", (threads, longest), np.int32)
        space.scratch, space.ids = pointer(scratch, "uint64_t"), pointer(ids, "int32_t")
        binned = clock()
        check(
            lib.tsplat_frame_composite(
                struct, eye, how, not everything, slab > 0, slab == slabs - 1, space, longest,
                pointer(rgb, "float"), pointer(transmittance, "float"), pointer(depth, "float"),
                threads,
            ),
            "composite",
        )  # fmt: skip
        binning, compositing = binning + binned - begin, compositing + clock() - binned
    seconds = {"project": projected - start, "bin": binning, "composite": compositing}
    left_out = _frame_left_out(
        (skipped, packed.count), (empty, tiles), kept, (totals[3] - drawn, totals[3])
    )
    counts = Counts(visible, drawn, overflowed, seconds, () if everything else left_out)
    return Frame(rgb, transmittance, depth), counts
