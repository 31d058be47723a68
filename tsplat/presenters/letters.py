"""Printable ASCII: in each cell the character whose ink lies as the picture's light does.

A character is eight numbers, the ink in each eighth of the cell; the cell's light is eight numbers
too. The best character has the least squared difference, where the difference of their sums counts
once more, as that is what is seen from afar. With colours more ink is used than that, as with
:mod:`braille <tsplat.presenters.braille>`, and is as much darker.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from tsplat.core.types import F32, Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters.base import Presenter, Terminal
from tsplat.presenters.cells import PLAIN, Drawn, Spots, lit, room, show, tokens
from tsplat.presenters.halfblock import unsupported

WIDE, HIGH = 2, 4  # px of a cell
BLOCK = 512  # cells at a time, so that products stay in the cache and no BLAS starts threads
# Space to tilde in DejaVu Sans Mono 2.37: the share of each eighth that is ink, row by row, a digit
# for 0.03 of it
INK = (
    "00000000 22563311 33660000 23dffd21 12d96f45 40f76f03 54d1cf45 11330000 "
    "04739215 40372951 11bb1100 0044bb00 00002252 00004400 00002211 03199150 "
    "55ddcc33 53393b35 751ca654 753d3d53 058cbf02 75c63c52 46f7cc33 770b6520 "
    "55cccc33 65bc7f42 00342211 00342252 00589900 00888800 00868900 551b5311 "
    "12dffe75 33aaee22 75fecd53 47c0c225 83bccd51 77e7c345 68e7b020 46c3ce24 "
    "33ffbb22 77567744 460b3b52 34f8cc22 30b0c345 55ffcc22 53fcbf23 55bbcc33 "
    "76ced320 55bbcc38 75dddc22 56e43d43 99565611 33bbcc33 44bbaa11 33efff22 "
    "44aabb22 44bb5611 791bc456 34828254 30a02805 43282845 33770000 00000088 "
    "51000000 0069df43 40e9cb43 0087b225 049ebc34 0099f935 17a97311 009bcc8b "
    "40daaa22 12645745 04561976 40b8db22 71918304 00dcde23 00aaaa22 0099bb33 "
    "00b9cbb3 009bbc3b 0088a020 00957c43 20e6a214 0077bc33 0077aa11 0077ff22 "
    "0078aa22 0077aa93 005b9444 16559428 22555555 61554a82 00206800"
)
FIRST = ord(" ")
GLYPHS = tokens(bytes(range(FIRST, 0x7F)).decode())


@cache
def ink() -> F32:
    """[95, 8]: the ink of each character in each eighth of its cell, 1 for the darkest there is."""
    digits = [int(digit, 16) for digit in INK.replace(" ", "")]
    shares = np.array(digits, np.float32).reshape(-1, WIDE * HIGH)
    normal: F32 = shares / np.float32(max(digits))
    return normal


def size(terminal: Terminal) -> tuple[int, int]:
    """Eight px a cell, in all rows but the last."""
    return room(terminal, WIDE, HIGH)


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The cells that differ from ``previous``, or all. What does not fit is cut off."""
    return show(frame, terminal, previous, WIDE, HIGH, lambda spots: draw(spots, terminal.colors))


@cache
def _scores() -> tuple[F32, F32]:
    """Factors [95, 8] and terms [95]: factors @ light - terms is largest for the best character."""
    shares = ink()
    factors = shares + shares.sum(1, keepdims=True)
    return factors, (factors * shares).sum(1) / 2


def draw(spots: Spots, colors: int) -> Drawn:
    """Cells of two by four px. White is as much ink as a character has at most, on the whole."""
    shares = ink()
    full = shares.mean(1).max()
    count = spots.pixels.shape[3]
    light = spots.pixels.max(0).reshape(-1, count) / np.float32(255)
    light = (light if colors == PLAIN else np.sqrt(light)) * full
    factors, terms = _scores()
    best = np.empty(count, np.intp)
    for start in range(0, count, BLOCK):
        scores = light[:, start : start + BLOCK].T @ factors.T - terms
        best[start : start + BLOCK] = scores.argmax(1)
    return lit(spots, GLYPHS[best], shares.mean(1)[best] / full, colors)


LETTERS = Presenter(
    name="letters",
    summary="printable ASCII by its shapes, in one colour a cell",
    encode=encode,
    size=size,
    unsupported=unsupported,
    pixel=lambda terminal: (terminal.cell_width / WIDE, terminal.cell_height / HIGH),
    samples=2,
    rank=3,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The letters presenter."""
    return [LETTERS]
