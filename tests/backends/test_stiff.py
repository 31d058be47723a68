"""Every built-in backend, on every instruction set, on the named hard cases."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tsplat.backends.cffi import isa
from tsplat.core.workspace import Workspace
from tsplat.plugins import load_backend, plugins
from tsplat.testing.stiff import (
    CASES,
    REFUSALS,
    check_refusal,
    check_stiff,
    prepared,
    stiff_checks,
)

BACKENDS = [plugins().backends[name] for name in ("numpy", "numba")]
CFFI = plugins().backends["cffi"]


@pytest.mark.parametrize(
    "check", [check for backend in BACKENDS for check in stiff_checks(backend)], ids=str
)
def test_stiff(check):
    """The backend holds the case's bound, without NaN, infinity or a warning."""
    check()


@pytest.fixture(params=isa.offered())
def chosen(request):
    """The kernel switched to one instruction set, and back afterwards."""
    load_backend(CFFI)
    yield isa.use_isa(request.param)
    isa.use_environment()


@pytest.mark.parametrize("check", stiff_checks(CFFI), ids=str)
def test_stiff_on_every_instruction_set(chosen, check):
    """So does the C kernel, with each set that this CPU has."""
    check()


@pytest.mark.parametrize("name", ["numba", "cffi"])
@pytest.mark.parametrize("threads", [1, 3])
def test_any_number_of_threads(name, threads):
    """The cases with most Gaussians hold on one thread and on three."""
    stages = load_backend(plugins().backends[name])
    for case in CASES:
        if case.name in ("100,000 faint layers", "10,000 opaque layers", "3,000 at equal depth"):
            assert check_stiff(stages, case, threads).passed, case


@pytest.mark.parametrize("refusal", REFUSALS, ids=str)
def test_impossible_cameras_are_refused(refusal):
    """With a CameraError that has the words expected, and no warning before it."""
    verdict = check_refusal(refusal)
    assert verdict.passed, verdict


def test_the_crowd_is_cut_into_slabs():
    """The C kernel's way for crowded frames is taken by the case that is meant for it."""
    (case,) = (c for c in CASES if c.name == "3,000 large ones at five depths")
    scene, camera, params, _ = prepared(case)
    _, counts = load_backend(CFFI).fused(scene, camera, params, Workspace(2))
    assert any("intersections" in left.what for left in counts.left_out), counts


def test_names_are_distinct():
    """A name is one case."""
    for rows in (CASES, REFUSALS):
        assert len({row.name for row in rows}) == len(rows)


def test_what_is_not_the_usual_bound_has_a_reason():
    """And only that has one."""
    for case in CASES:
        assert (case.bound == 1e-4) is not bool(case.bound_why), case
        assert case.bound >= 1e-4


def test_the_collection_needs_no_hypothesis():
    """Third parties import it with what tsplat itself needs."""
    code = "import sys, tsplat.testing.stiff; assert 'hypothesis' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
