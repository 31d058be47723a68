"""The numba kernels: their vectors, their bins of large splats, and what they say when compiled."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np

import tsplat
from tsplat.backends.numba_kernels import jit, wrap
from tsplat.backends.numba_kernels.jit import kernel
from tsplat.backends.numba_kernels.simd import (
    bits,
    column,
    fma,
    interleave,
    load,
    log2,
    popcount,
    select,
    store,
)
from tsplat.core import constants, reference
from tsplat.core.camera import look_at
from tsplat.core.params import RenderParams
from tsplat.core.workspace import Workspace

SORT = """
import numpy as np
from tsplat.backends.numba_kernels import wrap
from tsplat.core.types import Splats
from tsplat.core.workspace import Workspace
one = {2: np.zeros((1, 2)), 3: np.ones((1, 3), np.float32), 1: np.ones(1, np.float32)}
ids = np.zeros(1, np.int32)
wrap.sort(Splats(one[2], one[3], one[1], one[1], one[3], one[1], ids, 8, 8), Workspace())
"""


def said_on_a_terminal(cache):
    """What a process that sorts writes to a terminal on its stderr."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    subprocess.run([sys.executable, "-c", SORT], stderr=theirs, env=environment, check=True)
    os.write(theirs, b".")  # so that there is something to read
    os.close(theirs)
    text = os.read(ours, 10_000).decode()
    os.close(ours)
    return text


def test_says_that_it_compiles(tmp_path):
    """Once on the first use, however many kernels are compiled, and not when they are cached."""
    assert said_on_a_terminal(tmp_path).count("compiling the numba kernels") == 1
    assert said_on_a_terminal(tmp_path) == "."


@kernel
def lanes(a, rows, out):
    """Some of everything that a vector can do."""
    x, y = load(a, 0, 8), load(a, 8, 8)
    store(out, 0, log2(x))
    store(out, 8, fma(x, y, min(x, y)) - max(-x, abs(y)) / 2)
    store(out, 16, select(x > y, x, 0))
    store(out, 24, interleave(x, y, x + y))
    store(out, 48, column(rows, 2, 1, 3, 8))
    return bits(x > y), popcount(bits(x > y))


def test_vectors():
    """Vectors compute lane by lane what NumPy does."""
    rng = np.random.default_rng(0)
    a = rng.uniform(1e-12, 3, 16).astype(np.float32)
    rows = rng.normal(size=(10, 3)).astype(np.float32)
    out = np.zeros(56, np.float32)
    mask, count = lanes(a, rows, out)
    x, y = a[:8], a[8:]
    want = [
        np.log2(x), x * y + np.minimum(x, y) - np.maximum(-x, abs(y)) / 2, np.where(x > y, x, 0),
        np.stack([x, y, x + y], 1).ravel(), rows[2:, 1],
    ]  # fmt: skip
    np.testing.assert_allclose(out, np.concatenate(want), rtol=3e-7, atol=3e-7)
    assert mask == sum(1 << i for i in np.flatnonzero(x > y))
    assert count == (x > y).sum()


def test_large_splats_are_listed_like_the_references():
    """Where every splat covers many tiles, lists grow band by band, in the same order."""
    rng = np.random.default_rng(5)
    n = 300
    scene = tsplat.scene_from_arrays(
        rng.uniform(-1, 1, (n, 3)), rng.normal(size=(n, 4)), np.full((n, 3), 1.0),
        np.full(n, 0.9), np.zeros((n, 1, 3)),
    )  # fmt: skip
    splats = reference.project(scene, look_at((0, 0, -5), (0, 0, 0), (0, -1, 0), 60, 250, 170),
                               RenderParams())  # fmt: skip
    order = reference.sort(splats)
    want, got = reference.bin(splats, order), wrap.bin(splats, order, Workspace(2))
    assert got.tile_size == want.tile_size
    assert len(want) > 16 * n
    assert np.array_equal(got.tile_offsets, want.tile_offsets)
    assert np.array_equal(got.splat_ids, want.splat_ids)


def test_what_is_compiled_is_kept_by_the_sources_of_all_kernels(monkeypatch, tmp_path):
    """Another constant, another folder: nothing compiled with the old one is ever read."""
    before = jit._cache_folder()
    assert before == jit._cache_folder() == jit._CACHE_FOLDER
    other = tmp_path / "constants.py"
    other.write_bytes(Path(constants.__file__).read_bytes() + b"EPS2D = 0.1\n")
    monkeypatch.setattr(constants, "__file__", str(other))
    assert jit._cache_folder() != before
