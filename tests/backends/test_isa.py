"""The C kernel on each instruction set that this CPU has."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from tsplat.backends.cffi import isa
from tsplat.core.camera import look_at
from tsplat.core.errors import PluginError
from tsplat.core.params import RenderParams
from tsplat.core.workspace import Workspace
from tsplat.plugins import load_backend, plugins
from tsplat.testing.checks import Case, check_stages, run_stages
from tsplat.testing.conformance import backend_checks
from tsplat.testing.strategies import make_scene

CFFI = plugins().backends["cffi"]
CAMERA = look_at((0.5, -1, -4), (0, 0, 0), (0, -1, 0), 60, 150, 100)


@pytest.fixture(params=isa.offered())
def chosen(request):
    """The kernel switched to one instruction set, and back afterwards."""
    load_backend(CFFI)
    yield isa.use_isa(request.param)
    isa.use_environment()


@pytest.mark.parametrize("check", backend_checks(CFFI, max_examples=60), ids=str)
def test_conformance(chosen, check):
    """Every instruction set keeps the contract on drawn scenes."""
    check()


def test_many_gaussians(chosen):
    """And on 20,000 Gaussians at once, on several threads."""
    scene = make_scene(7, 20_000, 3, frozenset({"equal depths", "needles", "opaque", "faint"}))
    case = Case(scene, CAMERA, RenderParams(depth=True), threads=3)
    for verdict in check_stages(load_backend(CFFI), case):
        assert verdict.passed, verdict


def test_instruction_sets_agree():
    """Their pictures differ by rounding alone: a flipped pixel aside, by less than 2e-5."""
    scene = make_scene(3, 5_000, 1, frozenset({"opaque", "discs"}))
    case = Case(scene, CAMERA)
    frames = []
    for name in isa.offered():
        isa.use_isa(name)
        frames.append(run_stages(load_backend(CFFI), case, Workspace(2)).rgb.copy())
    isa.use_environment()
    for frame in frames[1:]:
        error = abs(frame - frames[0]).max(axis=2)
        assert np.quantile(error, 0.999) < 2e-5
        assert error.max() < 0.01


def test_an_instruction_set_this_cpu_lacks_is_refused_in_words():
    """The error names the variable, what it said, and what there is."""
    with pytest.raises(
        PluginError, match=r"TSPLAT_ISA='neon', but this CPU and build offer: .*generic"
    ):
        isa.use_isa("neon")


def test_the_environment_forces_one():
    """TSPLAT_ISA=generic is what a new process then uses; a wrong name fails the backend."""
    code = (
        "from tsplat.backends.cffi import isa; import tsplat.backends.cffi as c; c.load(); "
        "print(isa.use_environment())"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"TSPLAT_ISA": "generic"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert run.stdout.strip() == "generic"
