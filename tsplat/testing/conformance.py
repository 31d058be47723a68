"""``backend_checks(backend)``: the checks as functions that bring their own examples.

@pytest.mark.parametrize("check", backend_checks(MY_BACKEND), ids=str)
def test_conformance(check):
    check()
"""

from __future__ import annotations

from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

from tsplat.core.stages import STAGES, Backend
from tsplat.plugins import load_backend
from tsplat.testing.checks import FUNCTIONS, Case, Check, require
from tsplat.testing.strategies import cameras, params, scenes

__all__ = ["Check", "backend_checks", "cases", "require"]


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """A scene, a camera that looks at it, and settings."""
    scene = draw(scenes())
    return Case(
        scene, draw(cameras(scene)), draw(params()), threads=draw(st.sampled_from((1, 2, 3)))
    )


def backend_checks(backend: Backend, max_examples: int = 100) -> list[Check]:
    """A check for every stage that ``backend`` offers, one for the picture, one for its bits."""

    def make(name: str) -> Check:
        @settings(
            max_examples=max_examples,
            deadline=None,
            suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
        )
        @given(case=cases())
        def run(case: Case) -> None:
            note(f"{len(case.scene)} Gaussians, {case.camera}, {case.params}")
            require(FUNCTIONS[name](load_backend(backend), case), f"backend {backend.name!r}")

        return Check(name, backend.name, run)

    return [make(name) for name in FUNCTIONS if name not in STAGES or name in backend.stages]
