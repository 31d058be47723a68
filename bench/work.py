"""What a frame cannot do without: pairs, evaluations and bytes, and the time they take at least.

Counted on the staged splats and bins, so that every backend is held against the same work:

pairs: (splat, tile), each to be listed and brought into order.
evaluations: pixels of the 4 x 4 blocks that a splat can reach, as long as a pixel of the block is
open. Blocks are tested as the C kernel does (``reached`` in composite_template.h).
bytes: each column, record, pair and pixel crosses to memory once each way; what the caches
serve again costs nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from machine import Limits
from numba import njit

import tsplat
from tsplat.core.camera import Camera
from tsplat.core.constants import ALPHA_MAX
from tsplat.core.stages import STAGES
from tsplat.core.types import Scene
from tsplat.core.workspace import Workspace

OPERATIONS = 18
"""Vector operations that an evaluation takes: exponent 5, power of two 8, blending 5."""

COLUMNS, COLOR = 48, 12  # bytes of a packed Gaussian, see pack.h; its colour where degree is 0
RECORD, BOX, PAIR, PIXEL = 64, 12, 8, 16  # bytes, see kernel.h; a box has its depth with it
BLOCK = 4  # px
UNIT = math.sqrt(0.5 / math.log(2))  # exp(-sigma) = 2^-(w^2 + v^2), w and v times this


@dataclass(frozen=True)
class Work:
    """Counts of one frame."""

    visible: int  # splats
    pairs: int
    evaluations: int
    read: dict[str, int]  # stage -> bytes
    written: dict[str, int]

    @property
    def nbytes(self) -> int:
        """Read and written."""
        return sum(self.read.values()) + sum(self.written.values())


def measure(scene: Scene, camera: Camera) -> Work:
    """The work in one frame."""
    plan = tsplat.make_plan(scene)
    space = Workspace(plan.threads)
    project, sort, bin, _ = (getattr(plan.stages, stage) for stage in STAGES)
    splats = project(scene, camera, plan.params, space)
    bins = bin(splats, sort(splats, space), space)
    entries = _entries(
        bins.tile_offsets, bins.splat_ids, bins.tile_size, splats.width, splats.height,
        splats.means2d, splats.factors, splats.opacities,
        plan.params.alpha_threshold, plan.params.transmittance_min,
    )  # fmt: skip
    visible, pairs, pixels = len(splats), len(bins), camera.width * camera.height
    degree = plan.params.sh_degree
    gaussian = COLUMNS + COLOR * ((degree + 1) ** 2)
    return Work(
        visible, pairs, int(entries) * BLOCK * BLOCK,
        read={
            "project": visible * gaussian, "bin": visible * BOX,
            "composite": visible * RECORD + pairs * PAIR,
        },
        written={
            "project": visible * (RECORD + BOX), "bin": pairs * PAIR, "composite": pixels * PIXEL,
        },
    )  # fmt: skip


def floor(work: Work, limits: Limits, isa: str) -> float:
    """Seconds that a frame takes at least.

    Stages follow one another, so theirs add up; within a stage bytes move while numbers are
    worked out, so the slower of the two counts. The arithmetic of projecting and sorting is left
    out: the true floor is a little higher.
    """
    moving = {
        stage: work.read[stage] / limits.read + work.written[stage] / limits.write
        for stage in work.read
    }
    evaluating = work.evaluations * OPERATIONS / limits.lanes[isa]
    return moving["project"] + moving["bin"] + max(moving["composite"], evaluating)


@njit(cache=True)
def _entries(offsets, ids, size, width, height, means, factors, opacities, threshold, stop):
    """(Splat, block) entries that a frame with perfect foresight draws."""
    across, count = (width + size - 1) // size, 0
    blocks = (size + BLOCK - 1) // BLOCK
    left = np.empty((blocks, blocks, BLOCK, BLOCK))
    open_ = np.empty((blocks, blocks), np.bool_)
    half = (BLOCK - 1) / 2
    for tile in range(len(offsets) - 1):
        x0, y0 = tile % across * size + 0.5, tile // across * size + 0.5
        still = 0
        for j in range(blocks):
            for i in range(blocks):
                open_[j, i] = x0 + i * BLOCK < width and y0 + j * BLOCK < height
                still += open_[j, i]
                for y in range(BLOCK):
                    for x in range(BLOCK):
                        in_x, in_y = x0 + i * BLOCK + x < width, y0 + j * BLOCK + y < height
                        left[j, i, y, x] = 1.0 if in_x and in_y else -1.0
        for k in ids[offsets[tile] : offsets[tile + 1]]:
            if not still:
                break
            u11, u12, u22 = UNIT * factors[k, 0], UNIT * factors[k, 1], UNIT * factors[k, 2]
            level = math.log2(opacities[k])
            reach = level - math.log2(threshold)
            half_w, half_v = half * (u11 + abs(u12)), half * u22
            for j in range(blocks):
                dy = y0 + j * BLOCK + half - means[k, 1]
                v_least = max(abs(u22 * dy) - half_v, 0.0)
                if v_least * v_least > reach:
                    continue
                for i in range(blocks):
                    if not open_[j, i]:
                        continue
                    dx = x0 + i * BLOCK + half - means[k, 0]
                    w_least = max(abs(u11 * dx + u12 * dy) - half_w, 0.0)
                    if w_least * w_least + v_least * v_least > reach:
                        continue
                    count += 1
                    some = False
                    for y in range(BLOCK):
                        for x in range(BLOCK):
                            t = left[j, i, y, x]
                            if t < 0:
                                continue
                            w = u11 * (dx - half + x) + u12 * (dy - half + y)
                            v = u22 * (dy - half + y)
                            drop = w * w + v * v
                            if drop <= reach:
                                t *= 1 - min(2.0 ** (level - drop), ALPHA_MAX)
                                left[j, i, y, x] = t if t > stop else -1.0
                            some |= left[j, i, y, x] > 0
                    if not some:
                        open_[j, i] = False
                        still -= 1
    return count
