"""What is special about the C kernel: its header, its build, what it refuses."""

from __future__ import annotations

import os
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tsplat.backends.cffi._kernel import lib

import tsplat.backends.cffi as package
from tests.conftest import ROOT, gaussians, straight
from tsplat.backends.cffi import WAITING, build
from tsplat.backends.cffi import stages as kernel
from tsplat.core import reference
from tsplat.core.errors import KernelError, SceneError
from tsplat.core.params import RenderParams
from tsplat.core.types import Bins
from tsplat.core.workspace import Workspace
from tsplat.plan import make_plan

PARAMS = RenderParams()


@pytest.fixture
def stages():
    """Splats and bins of a small scene, and a workspace."""
    splats = reference.project(gaussians([[0, 0, 4], [0.1, 0, 5]]), straight(), PARAMS)
    return splats, reference.bin(splats, reference.sort(splats)), Workspace(2)


def test_constants_h_is_current():
    """The kernel's numbers are those of core/constants.py."""
    assert (Path(build.__file__).with_name("constants.h")).read_text() == build.constants_h()


def test_the_kernel_has_openmp_here():
    """The compiler has OpenMP here, so the threads of the other tests are real."""
    assert lib.tsplat_has_openmp() == 1


def test_no_machine_specific_flags():
    """What is installed runs on any CPU of its kind and keeps IEEE arithmetic."""
    text = (ROOT / "setup.py").read_text() + Path(build.__file__).read_text()
    assert "-march" not in text
    assert "fast-math" not in text
    assert "-ffp-contract=off" in text


def test_without_the_kernel_the_reason_and_remedy_are_given(monkeypatch, tmp_path):
    """The compiler's complaint, kept at install, is quoted; so is what to do."""
    (tmp_path / "_kernel.build_error.txt").write_text("CompileError: command 'cc' failed\n")
    monkeypatch.setattr(package, "find_spec", lambda name: None)
    monkeypatch.setattr(package, "__file__", str(tmp_path / "__init__.py"))
    reason = package.unavailable()
    assert "command 'cc' failed" in reason
    assert "install a C compiler" in reason


def test_float64_is_refused_with_a_reason():
    """The backend answers "cannot" before it is asked to compute."""
    assert "float64 needs numpy" in package.cannot(gaussians([0, 0, 1]), RenderParams(float64=True))


def test_splats_of_the_wrong_type_are_refused(stages):
    """A float32 array from another backend is an error, not a reinterpretation of its bytes."""
    splats, bins, workspace = stages
    wrong = replace(splats, means2d=splats.means2d.astype(np.float32))
    with pytest.raises(SceneError, match=r"Splats.means2d: expected .*float64 \[2, 2\]"):
        kernel.composite(wrong, bins, PARAMS, workspace)


@pytest.mark.parametrize("bad", [-1, 2, 2**31 - 1])
def test_ids_outside_their_array_are_refused(stages, bad):
    """A tile list or an order that points nowhere is an error, not a read out of bounds."""
    splats, bins, workspace = stages
    ids = bins.splat_ids.copy()
    ids[-1] = bad
    with pytest.raises(KernelError, match="index"):
        kernel.composite(splats, Bins(bins.tile_offsets, ids, bins.tile_size), PARAMS, workspace)
    with pytest.raises(KernelError, match="index"):
        kernel.bin(splats, np.array([0, bad], np.int32), workspace)


@pytest.mark.parametrize("width", [21, 48])
@pytest.mark.parametrize("size", [1, 5, 16, 17, 18, 64])
def test_bins_of_any_tile_size_are_composited(width, size):
    """A third party's tiles need not be 16 px, nor begin at a multiple of anything."""
    scene, camera = gaussians([[0, 0, 4], [0.1, 0, 5]], scales=0.5), straight(width, 37)
    splats = reference.project(scene, camera, PARAMS)
    bins = reference.bin(splats, reference.sort(splats), tile_size=size)
    want = reference.composite(splats, bins, PARAMS)
    got = kernel.composite(splats, bins, PARAMS, Workspace(2))
    np.testing.assert_allclose(got.rgb, want.rgb, atol=1e-5)


def test_falling_offsets_are_refused(stages):
    """Offsets that fall or do not start at 0 are an error."""
    splats, bins, workspace = stages
    offsets = bins.tile_offsets.copy()
    offsets[0] = 1
    with pytest.raises(KernelError, match="start at 0"):
        kernel.composite(splats, Bins(offsets, bins.splat_ids, 16), PARAMS, workspace)


def test_a_steady_view_allocates_no_buffers():
    """After the first frame the workspace neither grows nor moves."""
    workspace = Workspace(2)
    scene, camera = (
        gaussians(np.random.default_rng(0).normal((0, 0, 5), 1, (500, 3))),
        straight(),
    )

    def frame():
        splats = kernel.project(scene, camera, PARAMS, workspace)
        bins = kernel.bin(splats, kernel.sort(splats, workspace), workspace)
        return kernel.composite(splats, bins, PARAMS, workspace).rgb.ctypes.data, workspace.nbytes

    assert frame() == frame()


def test_a_steady_view_allocates_nothing():
    """A second round past the same views asks for no memory but Python's small change."""
    rng = np.random.default_rng(0)
    scene = gaussians(rng.normal((0, 0, 8), 1, (3000, 3)), sh=rng.normal(0, 0.3, (3000, 4, 3)))
    plan, workspace = make_plan(scene, backend="cffi", threads=2), Workspace(2)
    cameras = [straight(200, 120, focal=f) for f in np.linspace(100, 300, 12)]
    for camera in cameras:
        plan.run(scene, camera, workspace)
    held = workspace.nbytes
    tracemalloc.start()
    for camera in cameras:
        plan.run(scene, camera, workspace)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert workspace.nbytes == held
    assert peak < 20_000  # the picture alone has 384,000 bytes


@pytest.mark.parametrize("given", [{}, {"OMP_WAIT_POLICY": "active", "GOMP_SPINCOUNT": "7"}])
def test_waiting_threads_sleep_unless_told_otherwise(given):
    """OpenMP is told so before it is loaded; what the user has said stays."""
    code = (
        "import os, tsplat.plugins as p\n"
        "p.load_backend(p.plugins().backends['cffi'])\n"
        "print(os.environ['OMP_WAIT_POLICY'], os.environ['GOMP_SPINCOUNT'])\n"
    )
    environ = {k: v for k, v in os.environ.items() if k not in WAITING} | given
    told = subprocess.run(
        [sys.executable, "-c", code], env=environ, capture_output=True, check=True
    )
    assert told.stdout.decode().split() == list((given or WAITING).values())
