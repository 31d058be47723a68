"""Compositing: pixels in blocks of 4 x 2, one vector of eight lanes each.

Work goes by *patches* of 16 x 16 pixels, parts of a tile of any size. A splat runs only in the
blocks where one of its rows can reach the alpha threshold.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tsplat.backends.numba_kernels.jit import kernel
from tsplat.core.constants import ALPHA_MAX, EXP2_POLY
from tsplat.core.types import F32, F64, I32, I64

RECORD = 16  # floats per splat: one cache line
SIDE = 16  # px, of a patch
BLOCK_W, BLOCK_H = 4, 2  # px
LANES = BLOCK_W * BLOCK_H
ACROSS, DOWN = SIDE // BLOCK_W, SIDE // BLOCK_H  # blocks of a patch
BLOCKS = ACROSS * DOWN
BATCH = 32  # splats between two looks for blocks that are closed

# Fields of a record.
MEAN_X, MEAN_Y, U11, U12, U22, LEVEL, REACH, SHEAR, INVERSE, RED, GREEN, BLUE, DEPTH = range(13)
REST_X, REST_Y = 13, 14  # what float32 has left over of the mean
# Values of a pixel. t is transmittance, negative once the pixel has stopped.
T, R, G, B, Z = range(5)

# exp(-sigma) = 2^-(w^2 + v^2) where w and v are the Cholesky products times this.
UNIT = math.sqrt(0.5 / math.log(2))
REACH_SLACK = 1e-4  # of the exponent: rounding of w and v in float32 is a hundredth of it
SPAN_PAD = np.float32(0.01)  # px; a span's end is good to 1e-5 of its distance
SPAN_SLACK = np.float32(1e-5)

# Typed, because numba computes float32 with a bare Python number in float64.
ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
ROUND = np.float32(12582912)  # 1.5 * 2^23: adding it rounds to the nearest integer
MOST = np.float32(ALPHA_MAX)
E0, E1, E2, E3, E4, E5, E6 = (np.float32(c) for c in EXP2_POLY)
ALMOST = np.float32(0.999)
NOWHERE, SPAN_END = np.float32(-64), np.float32(SIDE)
WIDTH = np.float32(BLOCK_W)


@kernel
def pack_splats(
    first: int, last: int, threshold: float, means2d: F64, factors: F32, depths: F32,
    opacities: F32, colors: F32, records: F32,
) -> None:  # fmt: skip
    """Rows ``first`` to ``last`` as records [M, RECORD]: what a patch needs, on one cache line."""
    for k in range(first, last):
        u11, u12 = np.float64(factors[k, 0]), np.float64(factors[k, 1])
        level = math.log2(np.float64(opacities[k]))
        reach = level - math.log2(threshold)
        records[k, MEAN_X] = means2d[k, 0]
        records[k, MEAN_Y] = means2d[k, 1]
        records[k, REST_X] = means2d[k, 0] - np.float64(records[k, MEAN_X])
        records[k, REST_Y] = means2d[k, 1] - np.float64(records[k, MEAN_Y])
        records[k, U11] = factors[k, 0]
        records[k, U12] = factors[k, 1]
        records[k, U22] = factors[k, 2]
        records[k, LEVEL] = level
        records[k, REACH] = reach * (1 + REACH_SLACK) + REACH_SLACK
        records[k, SHEAR] = -u12 / u11
        records[k, INVERSE] = 1 / (UNIT * u11)
        records[k, RED] = colors[k, 0]
        records[k, GREEN] = colors[k, 1]
        records[k, BLUE] = colors[k, 2]
        records[k, DEPTH] = depths[k]


@kernel
def _half_span(dy: Any, slope: Any, reach: Any, shear: Any, inverse: Any) -> Any:
    """Half the interval of x where ``w^2 <= reach - v^2``, padded; negative where there is none."""
    v = slope * dy
    room = reach - v * v
    half: Any = math.sqrt(room if room > ZERO else ZERO) * inverse
    half += SPAN_PAD + SPAN_SLACK * (half + abs(shear * dy))
    return NOWHERE if room < ZERO else half


@kernel
def _reached_blocks(
    batch: F32, count: int, x0: int, y0: int, columns: int, open_blocks: int, masks: I64
) -> None:
    """For ``count`` splats, which of a patch's blocks they may reach, one bit each.

    On one row of pixels ``w`` runs linearly through 0 at ``shear * dy``.
    """
    corner_x, corner_y = np.float32(x0) + HALF, np.float32(y0) + HALF
    end = np.float32(columns - 1)
    for j in range(count):
        mean_x, mean_y = batch[j, MEAN_X] - corner_x, batch[j, MEAN_Y] - corner_y
        slope, reach = batch[j, U22] * np.float32(UNIT), batch[j, REACH]
        shear, inverse = batch[j, SHEAR], batch[j, INVERSE]
        mask: Any = np.int32(0)
        for s in range(DOWN):
            dy = np.float32(s * BLOCK_H) - mean_y
            half = _half_span(dy, slope, reach, shear, inverse)
            below = _half_span(dy + ONE, slope, reach, shear, inverse)
            at = mean_x + shear * dy
            low, high = at - half, at + half
            at += shear
            left = low if low < at - below else at - below
            right = high if high > at + below else at + below
            left = left if left > ZERO else ZERO
            left = left if left < SPAN_END else SPAN_END
            right = right if right < end else end
            right = right if right > -ONE else -ONE
            first = np.int32(left + ALMOST) >> 2  # ALMOST up, so that a span's end is not lost
            after = np.int32(right + WIDTH) >> 2
            none = first >= after or (half < ZERO and below < ZERO)
            run = np.int32(((1 << after) - (1 << first)) << (s * ACROSS))
            mask = np.int32(mask | (np.int32(0) if none else run))
        masks[j] = mask & open_blocks  # which also drops the sign's extension


@kernel
def _open_blocks(state: F32) -> int:
    """Which blocks have a pixel that is not stopped, one bit each."""
    mask: Any = 0
    for block in range(BLOCKS):
        some = False
        for lane in range(LANES):
            some |= state[block, T, lane] > ZERO
        mask |= np.int64(some) << block
    return int(mask)


@kernel
def composite_patches(
    first: int, last: int, records: F32, offsets: I64, ids: I32, tile_size: int, width: int,
    height: int, threshold: float, stop: float, want_depth: bool, rgb: F32, transmittance: F32,
    depth: F32,
) -> bool:  # fmt: skip
    """Makes patches ``first`` to ``last`` of the picture; False if an id is out of range.

    rgb [H, W, 3], transmittance [H, W], depth [H, W] or anything where it is not wanted.
    """
    state = np.empty((BLOCKS, 5, LANES), np.float32)
    batch = np.empty((BATCH, RECORD), np.float32)
    masks = np.empty(BATCH, np.int64)
    floor, stopped = np.float32(math.log2(threshold)), np.float32(stop)
    tiles_across = (width + tile_size - 1) // tile_size
    parts = (tile_size + SIDE - 1) // SIDE  # patches across one tile
    for patch in range(first, last):
        tile, part = patch // (parts * parts), patch % (parts * parts)
        in_x, in_y = part % parts * SIDE, part // parts * SIDE
        x0, y0 = tile % tiles_across * tile_size + in_x, tile // tiles_across * tile_size + in_y
        columns = min(SIDE, tile_size - in_x, width - x0)
        rows = min(SIDE, tile_size - in_y, height - y0)
        if columns <= 0 or rows <= 0:
            continue
        state[:] = ZERO
        for block in range(BLOCKS):
            left, top = block % ACROSS * BLOCK_W, block // ACROSS * BLOCK_H
            for lane in range(LANES):
                inside = left + lane % BLOCK_W < columns and top + lane // BLOCK_W < rows
                state[block, T, lane] = ONE if inside else -ONE  # -1: stopped from the start
        begin, end = offsets[tile], offsets[tile + 1]
        for start in range(begin, end, BATCH):
            open_blocks = _open_blocks(state)
            if not open_blocks:
                break
            count = min(BATCH, end - start)
            for j in range(count):  # by themselves, so that their cache misses overlap
                k = ids[start + j]
                if k < 0 or k >= len(records):
                    return False
                for f in range(RECORD):
                    batch[j, f] = records[k, f]
            _reached_blocks(batch, count, x0, y0, columns, open_blocks, masks)
            for j in range(count):
                # Where terms cancel, in float64; the steps between lanes are small.
                wide_x, wide_y = UNIT * np.float64(batch[j, U11]), UNIT * np.float64(batch[j, U12])
                wide_v = UNIT * np.float64(batch[j, U22])
                step_x, step_y = np.float32(wide_x), np.float32(wide_y)
                step_v, level = np.float32(wide_v), batch[j, LEVEL]
                red, green, blue = batch[j, RED], batch[j, GREEN], batch[j, BLUE]
                z = batch[j, DEPTH]
                dx0 = x0 + 0.5 - np.float64(batch[j, MEAN_X]) - np.float64(batch[j, REST_X])
                dy0 = y0 + 0.5 - np.float64(batch[j, MEAN_Y]) - np.float64(batch[j, REST_Y])
                mask = masks[j]
                while mask:
                    # The lowest bit's number is its float's exponent.
                    lowest = np.float32(mask & -mask)
                    mask &= mask - 1
                    cell: Any = np.uint64((np.float32(lowest).view(np.int32) >> 23) - 127)
                    dx = dx0 + np.int64(cell) % ACROSS * BLOCK_W
                    dy = dy0 + np.int64(cell) // ACROSS * BLOCK_H
                    w0 = np.float32(wide_x * dx + wide_y * dy)
                    v0 = np.float32(wide_v * dy)
                    for lane in range(LANES):
                        lane_x = np.float32(lane % BLOCK_W)
                        lane_y = np.float32(lane // BLOCK_W)
                        w = w0 + (step_x * lane_x + step_y * lane_y)
                        v = v0 + step_v * lane_y
                        x = level - (w * w + v * v)
                        # alpha = 2^x = 2^n 2^f; n, the last bits of shifted, goes to e's exponent.
                        # Garbage below x = -126, where alpha is 0 by the threshold anyway.
                        shifted = x + ROUND
                        f = x - (shifted - ROUND)
                        e = E0 + f * (E1 + f * (E2 + f * (E3 + f * (E4 + f * (E5 + f * E6)))))
                        power = np.float32(shifted).view(np.int32) << 23
                        bits = np.float32(e).view(np.int32) + power
                        alpha = np.int32(bits).view(np.float32)
                        alpha = alpha if alpha < MOST else MOST
                        alpha = alpha if x >= floor else ZERO
                        t = state[cell, T, lane]
                        after = t * (ONE - alpha)
                        drawn = after > stopped
                        weight = t * alpha if drawn else ZERO
                        state[cell, T, lane] = after if drawn else -abs(t)
                        state[cell, R, lane] += weight * red
                        state[cell, G, lane] += weight * green
                        state[cell, B, lane] += weight * blue
                        if want_depth:
                            state[cell, Z, lane] += weight * z
        for y in range(rows):
            for x in range(columns):
                block = y // BLOCK_H * ACROSS + x // BLOCK_W
                lane = y % BLOCK_H * BLOCK_W + x % BLOCK_W
                rgb[y0 + y, x0 + x, 0] = state[block, R, lane]
                rgb[y0 + y, x0 + x, 1] = state[block, G, lane]
                rgb[y0 + y, x0 + x, 2] = state[block, B, lane]
                transmittance[y0 + y, x0 + x] = abs(state[block, T, lane])
                if want_depth:
                    depth[y0 + y, x0 + x] = state[block, Z, lane]
    return True
