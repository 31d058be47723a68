"""Compositing: pixels in blocks of 4 x 4, one vector each.

Work goes by *patches* of 16 x 16 pixels, parts of a tile of any size. For a batch of splats the
blocks that each can reach are found and listed, splat by splat; then one loop without branches
runs over the list. A pixel is its transmittance, negative once it has stopped, and its sums.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tsplat.backends.numba_kernels.jit import kernel
from tsplat.backends.numba_kernels.simd import (
    bits,
    convert,
    fma,
    load,
    magnitude,
    popcount,
    prefetch,
    select,
    store,
    view,
)
from tsplat.core.constants import ALPHA_MAX, EXP2_POLY
from tsplat.core.types import F32, F64, I32, I64

SIDE = 16  # px, of a patch
BLOCK = 4  # px, of a block
LANES = BLOCK * BLOCK
BLOCKS = 16  # of a patch
BATCH = 32  # splats between two looks for blocks that are closed

# A splat as patches read it, one cache line: its mean as two float64s, then these floats.
RECORD = 16
U11, U12, U22, LEVEL, REACH, SHEAR, TILT, RED, GREEN, BLUE, DEPTH = range(4, 15)
# Pixels of a block: vectors of transmittance and sums.
T, R, G, B, Z, PIXELS = (LANES * i for i in range(6))
# A splat on a patch: w and v, the Cholesky products, at the lanes of a block, and at the first
# lane of each block; then floats.
LANE_W, LANE_V, CORNER_W, CORNER_V, PLACED_LEVEL = (LANES * i for i in range(5))
PLACED_RED, PLACED_GREEN, PLACED_BLUE, PLACED_DEPTH = range(PLACED_LEVEL + 1, PLACED_LEVEL + 5)
PLACED = 5 * LANES
# What a thread needs besides the picture, in floats and in ints.
SPACE = BLOCKS * PIXELS + BATCH * PLACED
LIST = BATCH * BLOCKS + 16

LANE_X = np.tile(np.arange(BLOCK), BLOCK).astype(np.float32)
LANE_Y = np.repeat(np.arange(BLOCK), BLOCK).astype(np.float32)
BLOCK_X, BLOCK_Y = BLOCK * LANE_X, BLOCK * LANE_Y
WIDE_X, WIDE_Y = BLOCK_X.astype(np.float64), BLOCK_Y.astype(np.float64)
BITS_SET = np.array(
    [[b for b in range(8) if byte >> b & 1] + [0] * (8 - byte.bit_count()) for byte in range(256)],
    np.int32,
)  # numbers of the bits set in a byte, lowest first

# exp(-sigma) = 2^-(w^2 + v^2) where w and v are the Cholesky products times this.
UNIT = math.sqrt(0.5 / math.log(2))
REACH_SLACK = 1e-4  # of the exponent: rounding of w and v in float32 is a hundredth of it
PAD, PAD_SLACK = np.float32(0.01), np.float32(1e-6)  # px, and of a splat's distance

# Typed, because numba computes float32 with a bare Python number in float64.
ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
LAST = np.float32(BLOCK - 1)
ROUND = np.float32(12582912)  # 1.5 * 2^23: adding it rounds to the nearest integer
EXPONENT = np.int32(23)  # its lowest bit in a float32
MOST = np.float32(ALPHA_MAX)
E0, E1, E2, E3, E4, E5, E6 = (np.float32(c) for c in EXP2_POLY)


@kernel
def pack_splats(
    first: int, last: int, threshold: float, means2d: F64, factors: F32, depths: F32,
    opacities: F32, colors: F32, records: F32, records64: F64,
) -> None:  # fmt: skip
    """Rows ``first`` to ``last`` as records [M, RECORD], which are also records64 [M, 8]."""
    for k in range(first, last):
        u11, u12 = np.float64(factors[k, 0]), np.float64(factors[k, 1])
        u22 = np.float64(factors[k, 2])
        level = math.log2(np.float64(opacities[k]))
        reach = (level - math.log2(threshold)) / (UNIT * UNIT)
        records64[k, 0] = means2d[k, 0]
        records64[k, 1] = means2d[k, 1]
        records[k, U11] = factors[k, 0]
        records[k, U12] = factors[k, 1]
        records[k, U22] = factors[k, 2]
        records[k, LEVEL] = level
        records[k, REACH] = reach * (1 + REACH_SLACK) + REACH_SLACK
        records[k, SHEAR] = -u12 / u11
        records[k, TILT] = -u11 * u12 / (u12 * u12 + u22 * u22)
        records[k, RED] = colors[k, 0]
        records[k, GREEN] = colors[k, 1]
        records[k, BLUE] = colors[k, 2]
        records[k, DEPTH] = depths[k]


@kernel
def _reached_blocks(record: F32, corner_x: Any, corner_y: Any) -> int:
    """Which blocks a splat may reach, one bit each; the patch's first centre is at the corner.

    The least ``w^2 + v^2`` of a block is where the ellipse is nearest: on the vertical side that
    faces the mean or on the horizontal one, or 0 if the mean is inside.
    """
    u11, u12, u22 = record[U11], record[U12], record[U22]
    shear, tilt = record[SHEAR], record[TILT]
    pad = PAD + PAD_SLACK * (abs(corner_x) + abs(shear * corner_y))
    block_x, block_y = load(BLOCK_X, 0, BLOCKS), load(BLOCK_Y, 0, BLOCKS)
    left, right = block_x + (corner_x - pad), block_x + (corner_x + LAST + pad)
    top, bottom = block_y + (corner_y - pad), block_y + (corner_y + LAST + pad)
    side_x = max(left, min(right, ZERO))
    side_y = max(top, min(bottom, side_x * tilt))
    end_y = max(top, min(bottom, ZERO))
    end_x = max(left, min(right, end_y * shear))
    side_w, side_v = fma(side_x, u11, side_y * u12), side_y * u22
    end_w, end_v = fma(end_x, u11, end_y * u12), end_y * u22
    side = fma(side_w, side_w, side_v * side_v)
    end = fma(end_w, end_w, end_v * end_v)
    return bits(min(side, end) <= record[REACH])


@kernel
def _place(record: F32, dx: float, dy: float, space: F32, at: int) -> None:
    """Fills a splat in. Corners are worked out in float64: far from a needle's middle terms
    cancel.
    """  # noqa: D205
    wide_x, wide_y = UNIT * np.float64(record[U11]), UNIT * np.float64(record[U12])
    wide_v = UNIT * np.float64(record[U22])
    step_x, step_y, step_v = np.float32(wide_x), np.float32(wide_y), np.float32(wide_v)
    lane_x, lane_y = load(LANE_X, 0, LANES), load(LANE_Y, 0, LANES)
    block_x, block_y = load(WIDE_X, 0, BLOCKS), load(WIDE_Y, 0, BLOCKS)
    store(space, at + LANE_W, fma(lane_x, step_x, lane_y * step_y))
    store(space, at + LANE_V, lane_y * step_v)
    corner_w = fma(block_x, wide_x, fma(block_y, wide_y, wide_x * dx + wide_y * dy))
    corner_v = fma(block_y, wide_v, wide_v * dy)
    store(space, at + CORNER_W, convert(corner_w, np.float32))
    store(space, at + CORNER_V, convert(corner_v, np.float32))
    space[at + PLACED_LEVEL] = record[LEVEL]
    space[at + PLACED_RED] = record[RED]
    space[at + PLACED_GREEN] = record[GREEN]
    space[at + PLACED_BLUE] = record[BLUE]
    space[at + PLACED_DEPTH] = record[DEPTH]


@kernel
def _draw(space: F32, at: int, block: int, floor: Any, stop: Any, want_depth: bool) -> None:
    """Draws a placed splat on a block: level - w^2 - v^2 is the binary logarithm of its alpha."""
    w = load(space, at + LANE_W, LANES) + space[at + CORNER_W + block]
    v = load(space, at + LANE_V, LANES) + space[at + CORNER_V + block]
    x = space[at + PLACED_LEVEL] - fma(v, v, w * w)
    reached = x >= floor
    x = max(x, floor)
    # alpha = 2^x = 2^n 2^f; n, the last bits of shifted, goes to the exponent. The polynomial
    # goes in pairs, because pixels wait for it.
    shifted = x + ROUND
    f = x - (shifted - ROUND)
    f2 = f * f
    high = fma(f2, E6, fma(f, E5, E4))
    power = fma(fma(high, f2, fma(f, E3, E2)), f2, fma(f, E1, E0))
    power = view(view(power, np.int32) + (view(shifted, np.int32) << EXPONENT), np.float32)
    alpha = min(power, MOST)
    pixels = block * PIXELS
    t = load(space, pixels + T, LANES)
    part = t * alpha
    after = t - part
    drawn = after > stop
    weight = select(drawn & reached, part, ZERO)
    after = select(drawn, after, ZERO - magnitude(t))
    store(space, pixels + T, select(reached, after, t))
    store(space, pixels + R, fma(weight, space[at + PLACED_RED], load(space, pixels + R, LANES)))
    store(space, pixels + G, fma(weight, space[at + PLACED_GREEN], load(space, pixels + G, LANES)))
    store(space, pixels + B, fma(weight, space[at + PLACED_BLUE], load(space, pixels + B, LANES)))
    if want_depth:
        z = space[at + PLACED_DEPTH]
        store(space, pixels + Z, fma(weight, z, load(space, pixels + Z, LANES)))


@kernel
def _open_patch(space: F32, columns: int, rows: int) -> None:
    """Pixels that nothing was drawn on; those outside the picture are stopped from the start."""
    lane_x, lane_y = load(LANE_X, 0, LANES), load(LANE_Y, 0, LANES)
    for block in range(BLOCKS):
        across = np.float32(columns - block % BLOCK * BLOCK)
        down = np.float32(rows - block // BLOCK * BLOCK)
        inside = (lane_x < across) & (lane_y < down)
        store(space, block * PIXELS + T, select(inside, lane_x * ZERO + ONE, -ONE))
        for f in (R, G, B, Z):
            store(space, block * PIXELS + f, lane_x * ZERO)


@kernel
def _open_blocks(space: F32) -> int:
    """Which blocks have a pixel that is not stopped, one bit each."""
    mask = 0
    for block in range(BLOCKS):
        some = bits(load(space, block * PIXELS + T, LANES) > ZERO) != 0
        mask |= np.int64(some) << block
    return mask


@kernel
def composite_patches(
    first: int, last: int, records: F32, records64: F64, offsets: I64, ids: I32, tile_size: int,
    width: int, height: int, threshold: float, stop: float, want_depth: bool, space: F32,
    entries: I32, rgb: F32, transmittance: F32, depth: F32,
) -> bool:  # fmt: skip
    """Makes patches ``first`` to ``last`` of the picture; False if an id is out of range.

    space [SPACE] and entries [LIST] are lent; rgb [H, W, 3], transmittance [H, W], depth [H, W]
    or anything where it is not wanted.
    """
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
        _open_patch(space, columns, rows)
        begin, end = offsets[tile], offsets[tile + 1]
        corner_x, corner_y = x0 + 0.5, y0 + 0.5
        for start in range(begin, end, BATCH):
            open_blocks = _open_blocks(space)
            if not open_blocks:
                break
            count = min(BATCH, end - start)
            for j in range(count):
                k = ids[start + j]
                if k < 0 or k >= len(records):
                    return False
            for j in range(start + BATCH, min(start + 2 * BATCH, end)):
                prefetch(records, ids[j] * RECORD)
            # In turn, each without branches that would have to wait for sums.
            for j in range(count):
                k = ids[start + j]
                dx = np.float32(corner_x - records64[k, 0])
                dy = np.float32(corner_y - records64[k, 1])
                masks[j] = _reached_blocks(records[k], dx, dy) & open_blocks
            listed = 0
            at = BLOCKS * PIXELS
            for j in range(count):
                mask = masks[j]
                if not mask:
                    continue
                k = ids[start + j]
                dx, dy = corner_x - records64[k, 0], corner_y - records64[k, 1]
                _place(records[k], dx, dy, space, at)
                for shift in (0, 8):
                    byte = mask >> shift & 255
                    entry = np.int32(at << 4 | shift)
                    store(entries, listed, load(BITS_SET, byte * 8, 8) + entry)
                    listed += popcount(byte)
                at += PLACED
            for i in range(listed):
                entry = np.int64(entries[i])
                _draw(space, entry >> 4, entry & 15, floor, stopped, want_depth)
        for y in range(rows):
            for x in range(columns):
                pixel = (y // BLOCK * BLOCK + x // BLOCK) * PIXELS + y % BLOCK * BLOCK + x % BLOCK
                rgb[y0 + y, x0 + x, 0] = space[pixel + R]
                rgb[y0 + y, x0 + x, 1] = space[pixel + G]
                rgb[y0 + y, x0 + x, 2] = space[pixel + B]
                transmittance[y0 + y, x0 + x] = abs(space[pixel + T])
                if want_depth:
                    depth[y0 + y, x0 + x] = space[pixel + Z]
    return True
