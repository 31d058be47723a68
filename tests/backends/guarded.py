"""The C kernel with a page that may not be touched before and after every array it gets.

Run as a program, because what touches such a page dies:

python -m tests.backends.guarded render ISA SIDE SEED    # exit code 0: within bounds, usual bits
python -m tests.backends.guarded touch PLACE             # proves the guard: a signal but for inside
"""

from __future__ import annotations

import ctypes
import mmap
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st
from tsplat.backends.cffi._kernel import ffi, lib

from tsplat.backends.cffi import call, isa
from tsplat.backends.cffi import stages as kernel
from tsplat.core import reference
from tsplat.core.camera import look_at
from tsplat.core.errors import KernelError
from tsplat.core.params import RenderParams
from tsplat.core.types import Bins
from tsplat.core.workspace import Workspace
from tsplat.plugins import load_backend, plugins
from tsplat.testing.checks import Case, run_stages
from tsplat.testing.conformance import cases
from tsplat.testing.strategies import make_scene

PAGE = mmap.PAGESIZE
SIDES = ("begin", "end")
_NO_ACCESS = 0  # PROT_NONE, which mmap lacks
_pointer, _check = call.pointer, call.check


def guarded(array, side):
    """A copy that begins right after a page that may not be touched, or ends right before one.

    The end needs no padding: the arrays that kernel.h wants 64-byte aligned are whole cache lines,
    the others are whole elements.
    """
    room = -(-array.nbytes // PAGE) * PAGE
    memory = mmap.mmap(-1, room + 2 * PAGE)
    address = np.frombuffer(memory, np.uint8).ctypes.data
    protect = ctypes.CDLL(None, use_errno=True).mprotect
    protect.argtypes = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
    for page in (address, address + PAGE + room):
        assert protect(page, PAGE, _NO_ACCESS) == 0, ctypes.get_errno()
    start = PAGE if side == "begin" else PAGE + room - array.nbytes
    copy = np.ndarray(array.shape, array.dtype, memory, start)
    copy[...] = array
    return copy


class Guard:
    """Stands in for ``call.pointer`` and ``call.check``.

    Each array goes to the kernel as a guarded copy, and what it wrote comes back.
    """

    def __init__(self, side):
        self.side = side
        self.lent = {}  # address and size -> an array and its copy, until the call is over
        self.copies = []  # structs point to them in later calls too

    def pointer(self, array, ctype):
        if array is None:
            return ffi.NULL
        key = array.ctypes.data, array.nbytes
        if key not in self.lent:
            self.lent[key] = array, guarded(array, self.side)
            self.copies.append(self.lent[key][1])
        return _pointer(self.lent[key][1], ctype)

    def check(self, status, function):
        for array, copy in self.lent.values():
            if array.tobytes() != copy.tobytes():
                array[...] = copy
        self.lent.clear()
        _check(status, function)


@contextmanager
def guard(side) -> Iterator[Guard]:
    """Meanwhile the backend lends the kernel nothing but guarded arrays."""
    stand_in = Guard(side)
    with pytest.MonkeyPatch.context() as patch:
        for name, module in list(sys.modules.items()):
            if name.startswith("tsplat.backends.cffi"):
                for attribute, value in list(vars(module).items()):
                    if value is _pointer or value is _check:
                        patch.setattr(module, attribute, getattr(stand_in, value.__name__))
        yield stand_in


def _bits(frame):
    return [a if a is None else a.tobytes() for a in (frame.rgb, frame.transmittance, frame.depth)]


def _same_bits(case, side):
    """The stages, and the fused frame twice, draw the same guarded as not."""
    fused = load_backend(plugins().backends["cffi"])
    for stages in (replace(fused, fused=None), fused):
        for threads in (1, 3):
            usual = _bits(run_stages(stages, case, Workspace(threads)))
            with guard(side) as lent:
                # another Scene: what was packed for that one is not guarded
                mine = Case(replace(case.scene), case.camera, case.params, threads)
                workspace = Workspace(threads)
                for _ in range(2 if stages.fused else 1):
                    assert _bits(run_stages(stages, mine, workspace)) == usual
                assert len(lent.copies) > 15, "few arrays came through call.pointer"


def _any_tiles(case, side, size):
    """Bins of another tile size, and ids that point nowhere, stay within bounds too."""
    bins = reference.bin(case.splats, case.order, tile_size=size)
    usual = _bits(kernel.composite(case.splats, bins, case.params, Workspace(3)))
    with guard(side):
        assert _bits(kernel.composite(case.splats, bins, case.params, Workspace(3))) == usual
        for bad in (-1, len(case.splats), 2**31 - 1):
            ids, order = bins.splat_ids.copy(), case.order.copy()
            ids[-1:], order[-1:] = bad, bad
            if len(order):
                with pytest.raises(KernelError):
                    kernel.bin(case.splats, order, Workspace(3))
            wrong = Bins(bins.tile_offsets, ids, size)
            with suppress(KernelError):  # a tile that is opaque before its last splat never knows
                kernel.composite(case.splats, wrong, case.params, Workspace(3))


def render(name, side, number):
    """Small scenes as drawn, and a larger one on threads."""
    load_backend(plugins().backends["cffi"])
    isa.use_isa(name)

    def announce(case):
        print(f"{len(case.scene)} Gaussians, {case.camera.width}x{case.camera.height}, "
              f"{case.params}", file=sys.stderr, flush=True)  # fmt: skip

    @seed(int(number))
    @settings(
        max_examples=30, database=None, deadline=None, suppress_health_check=list(HealthCheck)
    )
    @given(case=cases(), size=st.sampled_from((1, 5, 16, 17, 64)))
    def small(case, size):
        announce(case)
        _same_bits(case, side)
        _any_tiles(case, side, size)

    small()
    scene = make_scene(int(number), 12_000, 2, frozenset({"equal depths", "needles", "faint"}))
    for width, height in ((333, 217), (336, 16)):  # the latter is written past the caches
        camera = look_at((0.5, -1, -4), (0, 0, 0), (0, -1, 0), 60, width, height)
        case = Case(scene, camera, RenderParams(depth=True))
        announce(case)
        _same_bits(case, side)


def touch(place):
    """Writes one byte, or lets the kernel sort one number more than there is."""
    depths = np.arange(1, 101, dtype=np.float32)
    if place == "sort":
        with guard("end") as lent:
            pairs, order = np.empty(202, np.uint64), np.empty(101, np.int32)
            histograms = np.empty(lib.TSPLAT_RADIX, np.uint32)
            arrays = (
                (depths, "float"),
                (order, "int32_t"),
                (pairs, "uint64_t"),
                (histograms, "uint32_t"),
            )
            a, b, c, d = (lent.pointer(*pair) for pair in arrays)
            lib.tsplat_sort(a, 101, b, c, d, 1)
        return
    array = guarded(depths, "begin" if place == "before" else "end")
    offset = {"before": -1, "first": 0, "last": array.nbytes - 1, "after": array.nbytes}[place]
    ctypes.memset(array.ctypes.data + offset, 0, 1)


if __name__ == "__main__":
    {"render": render, "touch": touch}[sys.argv[1]](*sys.argv[2:])
