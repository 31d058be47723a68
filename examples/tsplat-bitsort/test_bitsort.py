"""The whole proof: tsplat's own checks, run on this backend."""

import pytest
from tsplat_bitsort import BITSORT

from tsplat.testing.conformance import backend_checks


@pytest.mark.parametrize("check", backend_checks(BITSORT), ids=str)
def test_conformance(check):
    check()
