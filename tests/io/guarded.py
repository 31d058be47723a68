"""The decoder, and what unpacks, with a page not to be touched before and after every array.

Run as a program, because what touches such a page dies:

python -m tests.io.guarded decode SIDE SEED    # exit code 0: within bounds, usual bits
python -m tests.io.guarded unpack SIDE SEED    # the same
python -m tests.io.guarded overrun WHAT        # a signal: decode or unpack one row too many
"""

from __future__ import annotations

import sys

import numpy as np

from tests.backends.guarded import guarded
from tests.io import test_unpack
from tests.io.plywriter import REST, names_inria
from tsplat.io import native, ply
from tsplat.io import unpack as unpacking


def make(rng, degree):
    """Rows that end at an odd address, and arrays for them."""
    n = int(rng.integers(1, 60))
    names = names_inria(degree, normals=bool(rng.integers(2)))
    fields = [("label", "u1"), *[(name, "<f4") for name in names]]
    rows = np.zeros(n, [fields[i] for i in rng.permutation(len(fields))])
    for name in names:
        rows[name] = rng.normal(size=n)
    k = 1 + REST[degree] // 3
    shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, k, 3))
    half = np.float16 if rng.integers(2) else np.float32
    arrays = [np.zeros(s, t) for s, t in zip(shapes, [*[np.float32] * 4, half], strict=True)]
    return rows, arrays


def decode(side, seed):
    """Rows of any degree, to places and one after the other."""
    rng = np.random.default_rng(int(seed))
    pointer, lent = native.pointer, []

    def guard(array, ctype):
        if array is None:
            return pointer(None, ctype)
        if not any(array is copy for copy in lent):
            lent.append(guarded(array, side))
            array = lent[-1]
        return pointer(array, ctype)

    for _ in range(60):
        degree = int(rng.integers(4))
        rows, arrays = make(rng, degree)
        places = rng.permutation(len(rows)).astype(np.int32)
        decoder = ply.Layout(rows.dtype, REST[degree])._decoder
        for to in (slice(0, len(rows)), places):
            native.pointer = pointer
            bound = decoder(rows, *arrays, to)
            assert bound is not None
            lent[:] = [guarded(np.zeros_like(a), side) for a in arrays]
            usual, count = [a.tobytes() for a in arrays], len(lent)
            native.pointer = guard
            assert decoder(rows, *lent[:count], to) == bound
            assert len(lent) == count + (4 if to is places else 3), "arrays passed by the guard"
            assert [a.tobytes() for a in lent[:count]] == usual

    means, grid = rng.normal(size=(rng.integers(1, 99), 3)).astype(np.float32), np.ones(3, "f4")
    native.pointer = pointer
    usual = native.curve_keys(means, -grid, grid)
    native.pointer, lent[:] = guard, []
    native.curve_keys(means, -grid, grid)
    assert lent[-1].tolist() == usual.tolist()


def unpack(side, seed):
    """Each function, on rows and tables that lie at such a page."""
    rng = np.random.default_rng(int(seed))
    for _ in range(100):
        for usual, call in test_unpack.calls(rng):
            wanted, found = usual.copy(), guarded(usual, side)
            call(lambda array: array, wanted)
            call(lambda array: guarded(array, side), found)
            assert found.tobytes() == wanted.tobytes(), call


def overrun(what):
    """Lends fewer rows than it says."""
    if what == "unpack":
        short = guarded(np.zeros((7, 9), np.uint8), "end")
        rows = np.lib.stride_tricks.as_strided(short, (8, 9), short.strides)
        unpacking.fixed_24(rows, 1.0, np.zeros((8, 3), np.float32))
        return
    rows, arrays = make(np.random.default_rng(0), 3)
    fewer, pointer = guarded(rows[:-1], "end"), native.pointer
    native.pointer = lambda array, ctype: pointer(fewer if array is rows else array, ctype)
    ply.Layout(rows.dtype, 45)._decoder(rows, *arrays, slice(0, len(rows)))


if __name__ == "__main__":
    {"decode": decode, "unpack": unpack, "overrun": overrun}[sys.argv[1]](*sys.argv[2:])
