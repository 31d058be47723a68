"""``backend_checks(backend)``: the checks as functions that bring their own examples.

@pytest.mark.parametrize("check", backend_checks(MY_BACKEND), ids=str)
def test_conformance(check):
    check()
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st
from hypothesis.errors import Flaky

from tsplat.core.errors import ContractError
from tsplat.core.stages import STAGES, Backend
from tsplat.plugins import load_backend
from tsplat.testing.checks import FUNCTIONS, Case, Verdict
from tsplat.testing.strategies import cameras, params, scenes


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """A scene, a camera that looks at it, and settings."""
    scene = draw(scenes())
    return Case(
        scene, draw(cameras(scene)), draw(params()), threads=draw(st.sampled_from((1, 2, 3)))
    )


def require(verdict: Verdict, what: str) -> None:
    """Nothing if the verdict is good.

    Raises:
        ContractError: it is not; the text lists the faults.
    """
    if not verdict.passed:
        raise ContractError(f"{what}, {verdict.check}: {'; '.join(verdict.faults)}")


@dataclass(frozen=True)
class Check:
    """One check of one backend or presenter; call it to run it on many examples."""

    name: str
    subject: str  # the backend's or presenter's name
    run: Callable[[], None]

    def __str__(self) -> str:
        return f"{self.subject}-{self.name}"

    def __call__(self) -> None:
        """Runs the check.

        Raises:
            ContractError: an example breaks the contract; hypothesis shows the smallest.
        """
        try:
            self.run()
        except Flaky as error:  # state, or a race: an example fails, but not when run again
            raise ContractError(
                f"{self}: an example fails, but not each time it is run: {error}"
            ) from error


def drawn(max_examples: int) -> settings:
    """How examples are drawn: no limit of time, one fault at a time."""
    return settings(
        max_examples=max_examples,
        deadline=None,
        report_multiple_bugs=False,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


def backend_checks(backend: Backend, max_examples: int = 100) -> list[Check]:
    """A check for every stage that ``backend`` offers, and those of the whole.

    :mod:`tsplat.testing.checks` says what each of them demands.
    """

    def make(name: str) -> Check:
        @drawn(max_examples)
        @given(case=cases())
        def run(case: Case) -> None:
            note(f"{len(case.scene)} Gaussians, {case.camera}, {case.params}")
            require(FUNCTIONS[name](load_backend(backend), case), f"backend {backend.name!r}")

        return Check(name, backend.name, run)

    return [make(name) for name in FUNCTIONS if name not in STAGES or name in backend.stages]
