"""Every built-in backend against the reference, stage by stage, on drawn scenes and cameras."""

from __future__ import annotations

import pytest

from tsplat.plugins import plugins
from tsplat.testing.conformance import backend_checks

BACKENDS = [plugins().backends[name] for name in ("numpy", "numba", "cffi")]


@pytest.mark.parametrize(
    "check", [check for backend in BACKENDS for check in backend_checks(backend)], ids=str
)
def test_conformance(check):
    """The backend keeps the contract in this stage."""
    check()


@pytest.mark.parametrize("backend", BACKENDS, ids=lambda b: b.name)
def test_available(backend):
    """Where the tests run, every built-in backend is there: nothing above was skipped."""
    assert backend.unavailable() is None
