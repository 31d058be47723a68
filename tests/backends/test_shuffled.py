"""Rows in another order, with their numbers: the same picture, many equal depths or not.

Pictures, not orders, are compared, so that the fused paths are covered too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tsplat.backends.cffi import isa
from tsplat.core.camera import Camera, look_at
from tsplat.core.stages import Stages
from tsplat.core.types import Scene
from tsplat.core.workspace import Workspace
from tsplat.plan import make_plan
from tsplat.plugins import load_backend, plugins
from tsplat.testing.checks import Case, run_stages
from tsplat.testing.compare import compare_frames
from tsplat.testing.strategies import make_scene, shuffled

BACKENDS = ("numpy", "numba", *(f"cffi-{name}" for name in isa.offered()))
EYE = (0, 0, -5)
CAMERA = look_at(EYE, (0, 0, 0), (0, -1, 0), 60, 37, 29)


def crowd(seed: int, n: int) -> Scene:
    """Gaussians in few planes across the line of sight, so that most depths are equal."""
    return make_scene(seed, n, 1, frozenset({"equal depths", "opaque"}))


@pytest.fixture(params=BACKENDS, scope="module")
def backend(request):
    """A backend's stages; the C kernel's on one instruction set."""
    name, _, chosen = request.param.partition("-")
    stages = load_backend(plugins().backends[name])
    if chosen:
        isa.use_isa(chosen)
    yield stages
    isa.use_environment()


def judge(stages: Stages, scene: Scene, camera: Camera, seed: int) -> None:
    """Every path of ``stages`` makes of shuffled rows the contract's picture of ``scene``."""
    mixed = Case(shuffled(scene, np.random.default_rng(seed)), camera)
    want, margins = Case(scene, camera).contract
    for path in (stages, replace(stages, fused=None)):
        result = compare_frames(run_stages(path, mixed, Workspace(2)), want, margins)
        assert result.passed, result


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 150))
def test_shuffled_rows_change_nothing(backend, seed, n):
    """Few to many in a tile."""
    judge(backend, crowd(seed, n), CAMERA, seed)


def test_many_in_a_tile(backend):
    """Thousands of equal depths in each tile, where sorting them is left to merging."""
    judge(backend, crowd(5, 20_000), look_at(EYE, (0, 0, 0), (0, -1, 0), 60, 16, 16), 1)


def test_a_plan_looks_at_numbers_before_it_keeps_an_order():
    """The same depths with other numbers are sorted anew."""
    scene = crowd(3, 200)
    numbers = np.arange(len(scene), dtype=np.int32)
    workspace = Workspace()
    for given_numbers in (numbers, numbers[::-1].copy()):
        moved = replace(scene, numbers=given_numbers)
        frame = make_plan(moved, backend="numpy").run(moved, CAMERA, workspace).frame
        alone = make_plan(moved, backend="numpy").run(moved, CAMERA).frame
        np.testing.assert_array_equal(frame.rgb, alone.rgb)
