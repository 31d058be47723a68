"""Tests of the tests: each wrong backend is caught by the checks meant for it, and no other."""

from __future__ import annotations

import pytest

from tests.meta.wrong import REFERENCE, WRONG
from tsplat.core.errors import ContractError
from tsplat.core.stages import Backend
from tsplat.testing.checks import FUNCTIONS
from tsplat.testing.conformance import backend_checks


def checks(name, stages, examples=400):
    """Check name -> check, for a backend made of ``stages``."""
    made = backend_checks(Backend(name, "wrong on purpose", lambda: stages), max_examples=examples)
    return {check.name: check for check in made}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_backend_is_caught(name):
    """Every check meant for this fault finds an example that shows it."""
    stages, meant = WRONG[name]
    made = checks(name, stages)
    for check in meant:
        with pytest.raises(ContractError):
            made[check]()


@pytest.mark.parametrize("name", WRONG)
def test_nothing_else_is_caught(name):
    """A fault in one stage leaves the checks of the other stages, of bits and memory content."""
    stages, meant = WRONG[name]
    made = backend_checks(Backend(name, "wrong on purpose", lambda: stages), max_examples=12)
    for check in made:
        if check.name != "picture" and check.name not in meant:
            check()


def test_the_reference_itself_is_never_caught():
    """The same machinery passes what is right."""
    made = checks("reference", REFERENCE, 20)
    assert set(made) == set(FUNCTIONS)
    for check in made.values():
        check()
