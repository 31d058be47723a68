"""Settings for checks that are meant to fail."""

from __future__ import annotations

import pytest
from hypothesis import Phase, settings


@pytest.fixture(autouse=True)
def _quick():
    """Failing examples are neither made small nor remembered: that they exist is enough."""
    settings.register_profile(
        "meta", settings.default, phases=[Phase.explicit, Phase.generate], database=None
    )
    settings.load_profile("meta")
    yield
    settings.load_profile("tsplat")
