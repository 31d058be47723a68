"""The encoder with a page that may not be touched before or after every array it gets.

Run as a program, because what touches such a page dies:

python -m tests.presenters.guarded encode SIDE SEED    # exit code 0: within bounds, usual bytes
python -m tests.presenters.guarded overrun             # a signal: one row more than there is
"""

from __future__ import annotations

import sys

import numpy as np

from tests.backends.guarded import guarded
from tsplat.core.types import Frame
from tsplat.presenters import native, sixel
from tsplat.presenters.base import Terminal
from tsplat.testing.presenting import KINDS, make_pixels


class Lending:
    """The C functions, given guarded copies of arrays, which are copied back after each call."""

    def __init__(self, side):
        self.lib, self.pointer, self.side = native.lib, native.pointer, side
        self.lent = []
        self.calls = 0

    def guard(self, array, ctype):
        copy = guarded(array, self.side)
        self.lent.append((array, copy))
        return self.pointer(copy, ctype)

    def __getattr__(self, name):
        value = getattr(self.lib, name)
        if isinstance(value, int):
            return value

        def call(*arguments):
            result = value(*arguments)
            for array, copy in self.lent:
                if array.flags.writeable:
                    array[...] = copy
            self.lent.clear()
            self.calls += 1
            return result

        return call


def encode(side, seed):
    """Frames of all kinds and sizes, moving, repeated and at rest."""
    rng = np.random.default_rng(int(seed))
    for n in range(20):
        width, height = (int(x) for x in rng.integers(1, 90, 2))
        screen = Terminal(12, 8, 10, 18, sixel=True, sixel_registers=int(rng.integers(2, 300)))
        pixels = make_pixels(
            int(rng.integers(2**32)), KINDS[n % len(KINDS)], width, height, 1 << 24
        )
        frame = Frame(pixels / np.float32(255), np.zeros(pixels.shape[:2], np.float32))

        def payloads(frame=frame, screen=screen):
            moving = (f(frame, screen, None) for f in (sixel.encode, sixel.fill))
            return [*moving, sixel.rest(frame, screen)]

        usual = payloads()
        lending = Lending(side)
        native.lib, native.pointer = lending, lending.guard
        assert payloads() == usual
        assert lending.calls >= 15
        native.lib, native.pointer = lending.lib, lending.pointer


def overrun():
    """Tells of a row more than there is."""
    rows, columns = guarded(np.zeros((600, 7), np.uint8), "end"), np.arange(8, dtype=np.int32)

    lib = native.lib
    source = np.arange(601, dtype=np.int32)
    scratch = np.empty((7, lib.TSPLAT_SCRATCH), np.int32)
    used, out = np.empty(256, np.uint8), np.empty(99_999, np.uint8)
    lib.tsplat_lines(
        native.pointer(rows, "uint8_t"), 601, 7, native.pointer(source, "int32_t"), 601,
        native.pointer(columns, "int32_t"), native.pointer(scratch, "int32_t"),
        native.pointer(used, "uint8_t"), native.pointer(out, "uint8_t"), len(out),
    )  # fmt: skip


if __name__ == "__main__":
    {"encode": encode, "overrun": overrun}[sys.argv[1]](*sys.argv[2:])
