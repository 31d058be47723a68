"""Terminals that stay open for a file's tests, and pictures to compare their screens with."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path

import pytest

from tests.real.desk import Make, Terminal, opened
from tests.real.pictures import Pictures

COLUMNS, ROWS = 80, 25  # of which the last is the status line's
HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All of these are marked ``real``."""
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.real)


@pytest.fixture(scope="module")
def terminal(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[Make], Terminal]]:
    """Opens a terminal, or gives the one that is open already."""
    with ExitStack() as stack:

        @cache
        def get(make: Make) -> Terminal:
            folder = tmp_path_factory.mktemp(make.name)
            return stack.enter_context(opened(make, folder, COLUMNS, ROWS))

        yield get


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Pictures:
    """One picture of a kind is rendered once."""
    return Pictures(tmp_path_factory.mktemp("pictures"))
