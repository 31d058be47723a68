"""Every built-in backend against the reference, stage by stage, on drawn scenes and cameras."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tsplat.core.camera import look_at
from tsplat.core.constants import EPS2D
from tsplat.core.params import RenderParams
from tsplat.core.stages import Stages
from tsplat.plugins import load_backend, plugins
from tsplat.testing.checks import Case, check_stages
from tsplat.testing.conformance import backend_checks
from tsplat.testing.strategies import make_scene

BACKENDS = [plugins().backends[name] for name in ("numpy", "numba", "cffi")]


@pytest.mark.parametrize(
    "check", [check for backend in BACKENDS for check in backend_checks(backend)], ids=str
)
def test_conformance(check):
    """The backend keeps the contract in this stage."""
    check()


@pytest.mark.parametrize("backend", BACKENDS, ids=lambda b: b.name)
def test_many_gaussians(backend):
    """The same on 20,000 Gaussians, where work is shared out among threads in earnest."""
    oddities = frozenset({"equal depths", "needles", "discs", "opaque", "faint", "behind"})
    scene = make_scene(seed=7, n=20_000, degree=3, oddities=oddities)
    camera = look_at((0.5, -1, -4), (0, 0, 0), (0, -1, 0), 60, 150, 100)
    case = Case(scene, camera, RenderParams(depth=True, antialias=True), threads=3)
    for verdict in check_stages(load_backend(backend), case):
        assert verdict.passed, verdict


@pytest.mark.parametrize("low_pass", [0.1, 3.0])
@pytest.mark.parametrize("backend", BACKENDS, ids=lambda b: b.name)
def test_another_low_pass(backend, low_pass):
    """Variances grow by what is asked for; one that adds the contract's 0.3 px^2 is told."""
    scene = make_scene(seed=3, n=400, degree=1, oddities=frozenset({"needles", "faint"}))
    camera = look_at((0.5, -1, -4), (0, 0, 0), (0, -1, 0), 60, 90, 70)
    case = Case(scene, camera, RenderParams(low_pass=low_pass, antialias=low_pass < 1), threads=2)
    stages = load_backend(backend)
    for verdict in check_stages(stages, case):
        assert verdict.passed, verdict
    assert stages.project is not None

    def deaf(scene, camera, params, workspace):
        return stages.project(scene, camera, replace(params, low_pass=EPS2D), workspace)

    verdicts = check_stages(Stages(project=deaf), case)
    assert not all(verdict.passed for verdict in verdicts)


@pytest.mark.parametrize("backend", BACKENDS, ids=lambda b: b.name)
def test_available(backend):
    """Where the tests run, every built-in backend is there: nothing above was skipped."""
    assert backend.unavailable() is None
