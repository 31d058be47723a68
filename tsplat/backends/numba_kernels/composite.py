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
    fma,
    interleave,
    item,
    load,
    log2,
    popcount,
    prefetch,
    put,
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
LINE = 16  # floats, of a cache line
BATCH = 32  # splats between two looks for blocks that are closed

# A splat as patches read it, one cache line: its mean and the first row of its factor as float64,
# because far from a needle's middle their products cancel; then floats.
RECORD = 16
MEAN_X, MEAN_Y, WIDE_X, WIDE_Y = range(4)  # in float64s
STEP_X, STEP_Y, STEP_V, LEVEL, RED, GREEN, BLUE, DEPTH = range(8, 16)
FLOATS = 8  # from STEP_X on
# Pixels of a block: vectors of transmittance and sums.
T, R, G, B, Z, PIXELS = (LANES * i for i in range(6))
# A splat on a patch: the Cholesky products w and v at the middle of each block, what the lane adds
# to w, and the record's floats.
BLOCK_W, BLOCK_V, LANE_W, PLACED_FLOATS, PLACED = (LANES * i for i in range(5))
PLACED_V, PLACED_LEVEL, PLACED_RED, PLACED_GREEN, PLACED_BLUE, PLACED_DEPTH = range(
    PLACED_FLOATS + STEP_V - STEP_X, PLACED_FLOATS + FLOATS
)
# What a thread needs besides the picture, in floats and in ints.
SPACE = BLOCKS * PIXELS + BATCH * PLACED
LIST = BATCH * BLOCKS + 16

# Pixels of a block and blocks of a patch, px from their middles.
LANE_X = np.tile(np.arange(BLOCK) - 1.5, BLOCK).astype(np.float32)
LANE_Y = np.repeat(np.arange(BLOCK) - 1.5, BLOCK).astype(np.float32)
BLOCK_X, BLOCK_Y = BLOCK * LANE_X, BLOCK * LANE_Y
BITS_SET = np.array(
    [[b for b in range(8) if byte >> b & 1] + [0] * (8 - byte.bit_count()) for byte in range(256)],
    np.int32,
)  # numbers of the bits set in a byte, lowest first

# exp(-sigma) = 2^-(w^2 + v^2) where w and v are the Cholesky products times this.
UNIT = math.sqrt(0.5 / math.log(2))
REACH_SLACK = np.float32(1e-4)  # of w^2 + v^2, whose rounding is a tenth of it

# Typed, because numba computes float32 with a bare Python number in float64.
ZERO, ONE = np.float32(0), np.float32(1)
EDGE = np.float32((BLOCK - 1) / 2)  # px, from a block's middle to its outermost centres
ROUND = np.float32(12582912)  # 1.5 * 2^23: adding it rounds to the nearest integer
EXPONENT = np.int32(23)  # its lowest bit in a float32
MOST = np.float32(ALPHA_MAX)
E0, E1, E2, E3, E4, E5, E6 = (np.float32(c) for c in EXP2_POLY)


@kernel
def pack_splats(
    first: int, last: int, means2d: F64, factors: F32, depths: F32, opacities: F32, colors: F32,
    records: F32, records64: F64,
) -> None:  # fmt: skip
    """Rows ``first`` to ``last`` as records [M, RECORD], which are also records64 [M, 8].

    There are at least LANES opacities.
    """
    levels = np.empty(LANES, np.float32)
    for start in range(first, last, LANES):
        row = min(start, len(opacities) - LANES)  # the last group overlaps the one before it
        store(levels, 0, log2(load(opacities, row, LANES)))
        for k in range(start, min(start + LANES, last)):
            wide, floats = k * (RECORD // 2), k * RECORD
            wide_x = UNIT * np.float64(item(factors, 3 * k))
            wide_y = UNIT * np.float64(item(factors, 3 * k + 1))
            put(records64, wide + MEAN_X, item(means2d, 2 * k))
            put(records64, wide + MEAN_Y, item(means2d, 2 * k + 1))
            put(records64, wide + WIDE_X, wide_x)
            put(records64, wide + WIDE_Y, wide_y)
            put(records, floats + STEP_X, np.float32(wide_x))
            put(records, floats + STEP_Y, np.float32(wide_y))
            put(records, floats + STEP_V, np.float32(UNIT * np.float64(item(factors, 3 * k + 2))))
            put(records, floats + LEVEL, item(levels, k - row))
            put(records, floats + RED, item(colors, 3 * k))
            put(records, floats + GREEN, item(colors, 3 * k + 1))
            put(records, floats + BLUE, item(colors, 3 * k + 2))
            put(records, floats + DEPTH, item(depths, k))


@kernel
def _place(
    records: F32, records64: F64, k: int, middle_x: float, middle_y: float, floor: Any, space: F32,
    at: int,
) -> int:  # fmt: skip
    """Fills splat ``k`` in for a patch; returns which blocks it may reach, one bit each.

    Over the pixels of a block w and v stay within an interval, as long as the block's shape says;
    the splat does not reach it where the ends next to 0 lie outside its ellipse.
    """
    wide, floats = k * (RECORD // 2), k * RECORD
    dx = middle_x - item(records64, wide + MEAN_X)
    dy = middle_y - item(records64, wide + MEAN_Y)
    middle_w = np.float32(item(records64, wide + WIDE_X) * dx + item(records64, wide + WIDE_Y) * dy)
    step_x, step_y = item(records, floats + STEP_X), item(records, floats + STEP_Y)
    step_v = item(records, floats + STEP_V)
    block_x, block_y = load(BLOCK_X, 0, BLOCKS), load(BLOCK_Y, 0, BLOCKS)
    w = fma(block_x, step_x, fma(block_y, step_y, middle_w))
    v = fma(block_y, step_v, step_v * np.float32(dy))
    store(space, at + BLOCK_W, w)
    store(space, at + BLOCK_V, v)
    store(space, at + LANE_W, fma(load(LANE_X, 0, LANES), step_x, load(LANE_Y, 0, LANES) * step_y))
    store(space, at + PLACED_FLOATS, load(records, floats + STEP_X, FLOATS))
    near_w = max(abs(w) - EDGE * (step_x + abs(step_y)), ZERO)
    near_v = max(abs(v) - EDGE * step_v, ZERO)
    reach = item(records, floats + LEVEL) - floor
    reached = fma(near_w, near_w, near_v * near_v) <= reach + REACH_SLACK * (reach + ONE)
    return bits(reached)  # type: ignore[no-any-return]


@kernel
def _draw(space: F32, at: int, block: int, floor: Any, stop: Any, want_depth: bool) -> None:
    """Draws a placed splat on a block: level - w^2 - v^2 is the binary logarithm of its alpha."""
    w = load(space, at + LANE_W, LANES) + item(space, at + BLOCK_W + block)
    v = fma(load(LANE_Y, 0, LANES), item(space, at + PLACED_V), item(space, at + BLOCK_V + block))
    x = fma(-v, v, fma(-w, w, item(space, at + PLACED_LEVEL)))
    reached = x >= floor
    # alpha = 2^x = 2^n 2^f; n, the last bits of shifted, goes to the exponent. The polynomial
    # goes in pairs, because pixels wait for it. Far below the floor all this is garbage.
    shifted = x + ROUND
    f = x - (shifted - ROUND)
    f2 = f * f
    high = fma(f2, E6, fma(f, E5, E4))
    power = fma(fma(high, f2, fma(f, E3, E2)), f2, fma(f, E1, E0))
    power = view(view(power, np.int32) + (view(shifted, np.int32) << EXPONENT), np.float32)
    alpha = select(reached, min(power, MOST), ZERO)
    # Where alpha is 0, t stays: an open pixel's is above stop, any other's is negative.
    pixels = block * PIXELS
    t = load(space, pixels + T, LANES)
    part = t * alpha
    after = t - part
    drawn = after > stop
    weight = select(drawn, part, ZERO)
    store(space, pixels + T, select(drawn, after, -abs(t)))
    red, green = item(space, at + PLACED_RED), item(space, at + PLACED_GREEN)
    blue = item(space, at + PLACED_BLUE)
    store(space, pixels + R, fma(weight, red, load(space, pixels + R, LANES)))
    store(space, pixels + G, fma(weight, green, load(space, pixels + G, LANES)))
    store(space, pixels + B, fma(weight, blue, load(space, pixels + B, LANES)))
    if want_depth:
        z = item(space, at + PLACED_DEPTH)
        store(space, pixels + Z, fma(weight, z, load(space, pixels + Z, LANES)))


@kernel
def _open_patch(space: F32, columns: int, rows: int) -> None:
    """Pixels that nothing was drawn on; those outside the picture are stopped from the start."""
    lane_x, lane_y = load(LANE_X, 0, LANES), load(LANE_Y, 0, LANES)
    for block in range(BLOCKS):
        across = np.float32(columns - block % BLOCK * BLOCK) - EDGE
        down = np.float32(rows - block // BLOCK * BLOCK) - EDGE
        inside = (lane_x < across) & (lane_y < down)
        nothing = lane_x * ZERO
        store(space, block * PIXELS + T, select(inside, nothing + ONE, -ONE))
        for f in (R, G, B, Z):
            store(space, block * PIXELS + f, nothing)


@kernel
def _open_blocks(space: F32) -> int:
    """Which blocks have a pixel that is not stopped, one bit each."""
    mask: Any = 0
    for block in range(BLOCKS):
        some = bits(load(space, block * PIXELS + T, LANES) > ZERO) != 0
        mask |= np.int64(some) << block
    return int(mask)


@kernel
def _write_patch(
    space: F32, x0: int, y0: int, columns: int, rows: int, want_depth: bool, rgb: F32,
    transmittance: F32, depth: F32,
) -> None:  # fmt: skip
    """Pixels to the picture, four in a row at a time."""
    width = rgb.shape[1]
    for y in range(rows):
        for x in range(0, columns, BLOCK):
            pixel = (y // BLOCK * BLOCK + x // BLOCK) * PIXELS + y % BLOCK * BLOCK
            to = (y0 + y) * width + x0 + x
            if x + BLOCK <= columns:
                red, green = load(space, pixel + R, BLOCK), load(space, pixel + G, BLOCK)
                blue = load(space, pixel + B, BLOCK)
                store(rgb, 3 * to, interleave(red, green, blue))
                store(transmittance, to, abs(load(space, pixel + T, BLOCK)))
                if want_depth:
                    store(depth, to, load(space, pixel + Z, BLOCK))
                continue
            for i in range(columns - x):
                put(rgb, 3 * (to + i), item(space, pixel + R + i))
                put(rgb, 3 * (to + i) + 1, item(space, pixel + G + i))
                put(rgb, 3 * (to + i) + 2, item(space, pixel + B + i))
                put(transmittance, to + i, abs(item(space, pixel + T + i)))
                if want_depth:
                    put(depth, to + i, item(space, pixel + Z + i))


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
        for y in range(y0, y0 + rows):  # the picture's lines, which come late if asked for late
            to = y * width + x0
            for line in range(3):
                prefetch(rgb, 3 * to + LINE * line)
            prefetch(transmittance, to)
        begin, end = offsets[tile], offsets[tile + 1]
        middle_x, middle_y = x0 + SIDE / 2, y0 + SIDE / 2
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
                prefetch(records, item(ids, j) * RECORD)
            # In turn, each without branches that would have to wait for sums.
            for j in range(count):
                splat: Any = np.int64(item(ids, start + j))
                at = BLOCKS * PIXELS + j * PLACED
                masks[j] = _place(records, records64, splat, middle_x, middle_y, floor, space, at)
            listed = 0
            for j in range(count):
                mask = masks[j] & open_blocks
                at = BLOCKS * PIXELS + j * PLACED
                for shift in (0, 8):
                    byte = mask >> shift & 255
                    place = np.int32(at << 4 | shift)
                    store(entries, listed, load(BITS_SET, byte * 8, 8) + place)
                    listed += popcount(byte)
            for i in range(listed):
                entry: Any = np.int64(item(entries, i))
                _draw(space, entry >> 4, entry & 15, floor, stopped, want_depth)
        _write_patch(space, x0, y0, columns, rows, want_depth, rgb, transmittance, depth)
    return True
