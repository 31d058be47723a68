"""Tests of the tests: each wrong presenter is caught by the checks meant for it, and no other."""

from __future__ import annotations

import pytest

from tests.meta.wrong_presenters import WRONG
from tsplat.core.errors import ContractError
from tsplat.testing.presenting import BYTES_ALONE, DECODED, DECODINGS, presenter_checks


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_presenter_is_caught_and_by_no_other_check(name):
    """Every check meant for this fault finds an example that shows it; the others are content."""
    presenter, meant = WRONG[name]
    caught = set()
    few, many = (presenter_checks(presenter, DECODINGS[presenter.name], n) for n in (8, 600))
    for check in (m if m.name in meant else f for f, m in zip(few, many, strict=True)):
        try:
            check()
        except ContractError:
            caught.add(check.name)
    assert caught == meant


@pytest.mark.parametrize("check", [*BYTES_ALONE, *DECODED])
def test_every_check_catches_something(check):
    """A check that no wrong presenter fails would prove nothing."""
    assert any(check in meant for _, meant in WRONG.values())
