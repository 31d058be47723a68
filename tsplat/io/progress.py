"""A progress bar on stderr, for loads that take longer than a blink."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

DELAY = 0.5
"""Seconds of quiet first: most files are loaded by then, and rich takes a while to import."""


@contextmanager
def progress_bar(label: str, *, delay: float = DELAY) -> Iterator[Callable[[int, int], None]]:
    """A function ``(done, total)`` that shows how far along ``label`` is.

    Nothing is shown unless stderr is a terminal and ``delay`` seconds have passed; the bar
    disappears at the end, whether by success or not.
    """
    started = time.monotonic()
    bar: Progress | None = None
    task: TaskID | None = None

    def show(done: int, total: int) -> None:
        nonlocal bar, task
        if bar is None:
            if time.monotonic() - started < delay:
                return
            from rich.console import Console
            from rich.progress import Progress

            bar = Progress(console=Console(stderr=True), transient=True)
            bar.start()
        if task is None:
            task = bar.add_task(_plain(label), total=total)
        bar.update(task, completed=done, total=total)

    def quiet(done: int, total: int) -> None:
        pass

    try:
        yield show if sys.stderr.isatty() else quiet
    finally:
        if bar is not None:
            bar.stop()


def _plain(label: str) -> str:
    """``label`` without control characters and without rich's markup."""
    from rich.markup import escape

    from tsplat.core.errors import printable

    return escape(printable(label, 60))
