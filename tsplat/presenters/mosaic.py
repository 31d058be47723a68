"""Sets of block characters, and for each cell the one that shows it with the least error.

A character splits a cell's n px into two groups, ink and paper. With the colours that are best for
it, the means of the two, the squared error is that of one colour less the gain

    k (n - k) / n * |mean of the ink's px - mean of the others|^2 = n / (k (n - k)) * |S|^2,

k the px of the ink, S the sum over them of each px less the cell's mean (the variance between
groups, as in Otsu's threshold: https://doi.org/10.1109/TSMC.1979.4310076). S of all characters is
one matrix product.

PSNR of 100x32 cells of the demo scene (of a robot of 125,000 Gaussians) against the picture they
were made of by averaging, 8x24 px a cell: halves 23.3 (27.1) dB, quadrants 23.9 (27.7), sextants
24.7 (28.1), quadrants and eighths 25.0 (28.5), octants 25.1 (28.8). So the characters that every
font has are as good as sextants.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from tsplat.core.types import F32, U8
from tsplat.presenters.cells import Tokens, tokens

WIDE = 2  # px a cell, in all sets but halves
BLOCK = 512  # cells at a time, so that the products stay in the cache

QUADRANTS = " ▘▝▀▖▌▞▛▗▚▐▜▄▙▟█"  # the bits upper left, upper right, lower left, lower right
LOWER_EIGHTHS = "▁▂▃▄▅▆▇"
SEXTANTS = 0x1FB00  # Unicode 13: 1 to 62 but for the halves, bit n - 1 for sextant n
OCTANTS = 0x1CD00  # Unicode 16: likewise, but for those that have a character already
# Unicode 16, charts U1CC00 and U1FB00: quarters of a half, middle quarters, upper quarters
OTHER_OCTANTS = {
    0b00000001: 0x1CEA8, 0b00000010: 0x1CEAB, 0b01000000: 0x1CEA3, 0b10000000: 0x1CEA0,
    0b00010100: 0x1FBE6, 0b00101000: 0x1FBE7, 0b00000011: 0x1FB82, 0b00111111: 0x1FB85,
    0b11000000: ord("▂"), 0b11111100: ord("▆"),
}  # fmt: skip
NOT_DRAWN = frozenset((0x1CEA8, 0x1CEAB, 0x1CEA3, 0x1CEA0, 0x1FBE6, 0x1FBE7))
"""foot 1.28 draws all octants but these; each is another one with ink and paper exchanged."""


@dataclass(frozen=True, eq=False)
class Mosaic:
    """A set of characters, as splits of a cell's px."""

    height: int  # px of a cell
    masks: F32  # [P, n]  1 for ink; the first px is never ink, its place is the complement's
    glyphs: Tokens  # [P]  0 where there is none
    complements: Tokens  # [P]  with ink and paper exchanged
    dots: Tokens  # [2 ** (2 * grid)]  a character for each pattern of 2 x grid dots, bit by bit
    grid: int  # rows of dots; a divisor of the height

    @cached_property
    def weights(self) -> F32:
        """[n, P]: the px sums' factors, such that the squared product is the gain."""
        ink = self.masks.sum(1)
        n = self.masks.shape[1]
        factor = np.sqrt(n / np.maximum(ink * (n - ink), 1))
        return np.ascontiguousarray((self.masks * factor[:, None]).T.astype(np.float32))


def _split(bits: int, rows: int, height: int) -> tuple[bool, ...]:
    """2 x ``rows`` squares as px, 2 x ``height``."""
    return tuple(
        bool(bits >> WIDE * (y * rows // height) + x & 1)
        for y in range(height)
        for x in range(WIDE)
    )


def _mosaic(characters: dict[tuple[bool, ...], str], dots: str, grid: int, height: int) -> Mosaic:
    pairs: dict[tuple[bool, ...], list[str]] = {}
    for split, character in characters.items():
        turned = split[0]
        key = tuple(not px for px in split) if turned else split
        pairs.setdefault(key, ["", ""])[turned] = character
    pairs = {key: pairs[key] for key in sorted(pairs)}  # one colour first: it wins where all tie
    plain, exchanged = (tokens([pair[n] for pair in pairs.values()]) for n in (0, 1))
    masks = np.array(list(pairs), np.float32)
    return Mosaic(height, masks, plain, exchanged, tokens(dots), grid)


def _octants() -> str:
    taken = {_split(bits, 2, 4): ord(c) for bits, c in enumerate(QUADRANTS)}
    taken |= {_split(bits, 4, 4): code for bits, code in OTHER_OCTANTS.items()}
    codes = []
    free = OCTANTS
    for bits in range(256):
        split = _split(bits, 4, 4)
        codes.append(taken.get(split, free))
        free += split not in taken
    return "".join(map(chr, codes))


@cache
def mosaic(name: str) -> Mosaic:
    """``quadrants`` (and lower eighths, 2 x 8 px), ``sextants`` (2 x 3) or ``octants`` (2 x 4)."""
    if name == "octants":
        dots = _octants()
        found = {_split(b, 4, 4): c for b, c in enumerate(dots) if ord(c) not in NOT_DRAWN}
        return _mosaic(found, dots, 4, 4)
    if name == "sextants":
        halves = {0: " ", 0b010101: "▌", 0b101010: "▐", 0b111111: "█"}
        rest = iter(range(SEXTANTS, SEXTANTS + 60))
        dots = "".join(halves.get(bits) or chr(next(rest)) for bits in range(64))
        return _mosaic({_split(b, 3, 3): c for b, c in enumerate(dots)}, dots, 3, 3)
    found = {_split(b, 2, 8): c for b, c in enumerate(QUADRANTS)}
    for n, character in enumerate(LOWER_EIGHTHS, 1):
        found[_split((1 << 2 * n) - 1 << 2 * (8 - n), 8, 8)] = character
    return _mosaic(found, QUADRANTS, 2, 8)


@dataclass(frozen=True, eq=False)
class Fit:
    """The best split of each of N cells, and its two colours."""

    splits: NDArray[np.intp]  # [N]     row of Mosaic.masks
    inks: F32  # [3, N]  0..255; the paper's where there is no ink
    papers: F32  # [3, N]


def fit(pixels: U8, chars: Mosaic) -> Fit:
    """The split of least squared error for ``pixels`` [3, h, 2, N]."""
    planes = pixels.reshape(3, -1, pixels.shape[3]).astype(np.float32)  # [3, n, N]
    n, count = planes.shape[1:]
    sums = planes.sum(1)
    centred = planes - (sums / np.float32(n))[:, None]
    weights = chars.weights
    splits = np.empty(count, np.intp)
    for start in range(0, count, BLOCK):
        gain = np.zeros(1, np.float32)
        for plane in centred[:, :, start : start + BLOCK]:
            part = plane.T @ weights
            part *= part
            part += gain
            gain = part
        gain.argmax(1, out=splits[start : start + BLOCK])
    ink = chars.masks.T.take(splits, 1)
    size = ink.sum(0)
    planes *= ink
    inside = planes.sum(1)
    papers = (sums - inside) / (n - size)
    inks = np.where(size > 0, inside / np.maximum(size, 1), papers)
    return Fit(splits, inks, papers)
