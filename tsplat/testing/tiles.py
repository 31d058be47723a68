"""Some tiles of a picture against the reference: a part of the check at a part of its price.

The splats are those of the whole picture, because its borders enter the projection
(docs/contract.md, rule 3). Only the tiles that are asked for are composited.

Compared: every pixel of those tiles, as :mod:`tsplat.testing.compare` does. Not compared: whether
flips lean to one side, which needs all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tsplat.core import reference
from tsplat.core.camera import Camera
from tsplat.core.params import RenderParams
from tsplat.core.reference import TILE_SIZE
from tsplat.core.types import Bins, Frame, Scene
from tsplat.testing.compare import compare_frames


@dataclass(frozen=True)
class TilesCompared:
    """What some tiles showed."""

    tiles: int
    max_error: float  # largest difference outside flipped pixels
    flips: int  # pixels that differ and sit on a threshold
    faults: tuple[str, ...]  # empty if the contract holds in these tiles


def tile_count(width: int, height: int) -> int:
    """Tiles in a picture of that size, px; they are counted by rows from the top left."""
    return -(-width // TILE_SIZE) * -(-height // TILE_SIZE)


def tile_pixels(tile: int, width: int, height: int) -> tuple[slice, slice]:
    """Pixel rows and columns of a tile; those at the right and at the bottom may be smaller."""
    row, column = divmod(tile, -(-width // TILE_SIZE))
    y, x = row * TILE_SIZE, column * TILE_SIZE
    return slice(y, min(y + TILE_SIZE, height)), slice(x, min(x + TILE_SIZE, width))


def cut(frame: Frame, tile: int) -> Frame:
    """A tile of ``frame``, copied; without depth."""
    rows, columns = tile_pixels(tile, frame.width, frame.height)
    return Frame(frame.rgb[rows, columns].copy(), frame.transmittance[rows, columns].copy())


class Still:
    """A scene as the reference sees it from one camera, ready to have tiles compared with it."""

    def __init__(self, scene: Scene, camera: Camera, params: RenderParams) -> None:
        self._params = replace(params, float64=True, depth=False)
        self._splats = reference.project(scene, camera, self._params)
        self._order = reference.sort(self._splats)
        low, high = reference.pixel_boxes(self._splats)
        self._low, self._high = low[self._order], high[self._order]

    def _bins(self, tiles: list[int]) -> Bins:
        """The splats of these tiles, near to far; none in the others."""
        width, height = self._splats.width, self._splats.height
        lists = {}
        for tile in tiles:
            rows, columns = tile_pixels(tile, width, height)
            touches = (self._low[:, 0] < columns.stop) & (self._high[:, 0] >= columns.start)
            touches &= (self._low[:, 1] < rows.stop) & (self._high[:, 1] >= rows.start)
            lists[tile] = self._order[touches]
        offsets = np.zeros(tile_count(width, height) + 1, np.int64)
        offsets[np.array(tiles) + 1] = [len(lists[tile]) for tile in tiles]
        np.cumsum(offsets, out=offsets)
        return Bins(offsets, np.concatenate([lists[tile] for tile in tiles]), TILE_SIZE)

    def compare(self, tiles: Mapping[int, Frame]) -> TilesCompared:
        """The contract's verdict on these tiles (one or more) of a frame: number -> pixels."""
        width, height = self._splats.width, self._splats.height
        margins = np.empty((height, width))
        bins = self._bins(sorted(tiles))
        want = reference.composite(self._splats, bins, self._params, margins=margins)
        worst, flips, faults = 0.0, 0, []
        for tile, got in sorted(tiles.items()):
            rows, columns = tile_pixels(tile, width, height)
            part = Frame(want.rgb[rows, columns], want.transmittance[rows, columns])
            result = compare_frames(got, part, margins[rows, columns], of=width * height)
            worst, flips = max(worst, result.max_error), flips + result.flips
            where = f"tile at ({columns.start}, {rows.start}), counted from there"
            faults += [f"{where}: {fault}" for fault in result.faults]
        return TilesCompared(len(tiles), worst, flips, tuple(faults))
