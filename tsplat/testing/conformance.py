"""``backend_checks(backend)``: the checks as functions that bring their own examples.

@pytest.mark.parametrize("check", backend_checks(MY_BACKEND), ids=str)
def test_conformance(check):
    check()
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st
from hypothesis.errors import Flaky

from tsplat.core.errors import ContractError
from tsplat.core.stages import STAGES, Backend
from tsplat.plugins import load_backend
from tsplat.testing.checks import FUNCTIONS, Case, Check, require
from tsplat.testing.strategies import cameras, params, scenes

__all__ = ["Check", "backend_checks", "cases", "drawn_check", "require"]

T = TypeVar("T")


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """A scene, a camera that looks at it, and settings."""
    scene = draw(scenes())
    return Case(
        scene, draw(cameras(scene)), draw(params()), threads=draw(st.sampled_from((1, 2, 3)))
    )


def drawn_check(
    name: str,
    subject: str,
    examples: st.SearchStrategy[T],
    run: Callable[[T], None],
    max_examples: int,
) -> Check:
    """The check that calls ``run`` on drawn examples until one raises."""

    @settings(
        max_examples=max_examples,
        deadline=None,
        report_multiple_bugs=False,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    @given(case=examples)
    def draw(case: T) -> None:
        run(case)

    def check() -> None:
        try:
            draw()
        except Flaky as error:  # state, or a race
            raise ContractError(
                f"{subject}, {name}: an example fails, but not each time it is run: {error}"
            ) from error

    return Check(name, subject, check)


def backend_checks(backend: Backend, max_examples: int = 100) -> list[Check]:
    """A check for every stage that ``backend`` offers, and those of the whole.

    :mod:`tsplat.testing.checks` says what each of them demands.
    """

    def make(name: str) -> Check:
        def run(case: Case) -> None:
            note(f"{len(case.scene)} Gaussians, {case.camera}, {case.params}")
            require(FUNCTIONS[name](load_backend(backend), case), f"backend {backend.name!r}")

        return drawn_check(name, backend.name, cases(), run, max_examples)

    return [make(name) for name in FUNCTIONS if name not in STAGES or name in backend.stages]
