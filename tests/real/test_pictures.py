"""What a real terminal's screen shows is the picture that ``tsplat render`` makes.

Compared are photographs of the window, all rows but the last, with PNGs. Presenters of pictures
are held to every pixel, half blocks to the middle of each half. How near, in dB (PSNR), is each
case's bound: kitty's protocol and half blocks in 24 bits are exact, a palette and JPEG are not.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from PIL import Image

from tests.real.desk import (
    KITTY,
    KONSOLE,
    MLTERM,
    XTERM,
    Make,
    Terminal,
    await_,
    in_tmux,
    psnr,
)
from tsplat.viewer.controls import KEYS

TURN = math.radians(4)  # what K does, as the help page's keys are documented
OTHER = 25.0  # dB; two views of the scene are farther apart
EXACT = math.inf


@dataclass(frozen=True)
class Case:
    """A terminal, what is asked of ``tsplat view`` there, and how near the screen must come."""

    make: Make
    presenter: str  # which is asked for, or would be chosen
    bound: float  # dB
    asked: bool = True
    halves: bool = False  # a pixel is half a cell

    def __str__(self) -> str:
        return f"{self.make.name}-{self.presenter}"

    @property
    def words(self) -> tuple[str, ...]:
        return ("--presenter", self.presenter) if self.asked else ()


CASES = (
    Case(KITTY, "kitty", EXACT, asked=False),
    Case(XTERM, "sixel", 33.0, asked=False),
    Case(MLTERM, "iterm2", 33.0),
    Case(KONSOLE, "iterm2", 33.0, asked=False),
    Case(XTERM, "halfblock", EXACT, halves=True),
    Case(in_tmux(XTERM), "halfblock", EXACT, asked=False, halves=True),
    Case(in_tmux(KITTY), "kitty", EXACT, asked=False),
)


class Viewing:
    """``tsplat view`` on the demo scene, in a terminal of ``COLUMNS`` by ``ROWS`` at first."""

    def __init__(self, case: Case, terminal: Terminal, pictures, report) -> None:
        self.case, self.terminal, self._pictures = case, terminal, pictures
        self._report = report
        width, height = terminal.area(terminal.window)
        columns, rows = terminal.cells()
        self.cell = width // columns, height // rows
        self._margin = width - columns * self.cell[0], height - rows * self.cell[1]
        self.first = self.pixels()

    def pixels(self) -> tuple[int, int]:
        """px of all rows but the last."""
        columns, rows = self.terminal.cells()
        return columns * self.cell[0], (rows - 1) * self.cell[1]

    def resize(self, columns: int, rows: int) -> None:
        """The window."""
        width, height = columns * self.cell[0], rows * self.cell[1]
        self.terminal.resize(width + self._margin[0], height + self._margin[1])

    def shown(self) -> np.ndarray | None:
        """The picture on the screen; None while the window is smaller than the tty says."""
        photograph = self.terminal.photograph()
        width, height = self.pixels()
        if photograph.shape[0] < height or photograph.shape[1] < width:
            return None
        if not self.case.halves:
            return photograph[:height, :width]
        across, down = self.cell[0], self.cell[1] / 2
        x = ((np.arange(width // across) + 0.5) * across).astype(int)
        y = ((np.arange(round(height / down)) + 0.5) * down).astype(int)
        return photograph[y][:, x]

    def wanted(self, turned: float = 0.0) -> np.ndarray:
        """What ``tsplat render`` makes for the window as it is."""
        window = size = self.pixels()
        if self.case.halves:
            size = window[0] // self.cell[0], 2 * window[1] // self.cell[1]
        if size == self.first and not turned:
            return self._pictures.framed(size)
        return self._pictures.seen(self.first, window, size, turned)

    def show(self, what: str, turned: float = 0.0) -> np.ndarray:
        """Waits until the screen shows what it should, and returns it."""
        best, last = -math.inf, None

        def there() -> bool:
            nonlocal best, last
            before, last = last, self.shown()
            wanted = self.wanted(turned)
            if last is None or last.shape != wanted.shape:
                return False
            best = max(best, psnr(last, wanted))
            still = before is not None and np.array_equal(before, last)
            return still and psnr(last, wanted) >= self.case.bound

        try:
            await_(what, there)
        except AssertionError as error:
            folder = self.terminal.state
            for name, picture in (("seen", last), ("wanted", self.wanted(turned))):
                if picture is not None:
                    Image.fromarray(picture).save(folder / f"{name}.png")
            told = f"{error}; at best {best:.1f} dB; see {folder}/seen.png and wanted.png"
            raise AssertionError(told) from None
        value = psnr(last, self.wanted(turned))
        self._report[str(self.case)] = min(value, self._report.get(str(self.case), math.inf))
        return last


@pytest.fixture
def viewing(terminal, pictures, report):
    """Starts ``tsplat view``; Q ends it, with code 0 and the tty as it was."""

    @contextmanager
    def start(case: Case) -> Iterator[Viewing]:
        opened = terminal(case.make)
        opened.fresh()
        opened.view(*case.words)
        viewing = Viewing(case, opened, pictures, report)
        try:
            yield viewing
        finally:
            opened.press("q")
            opened.ready()
        assert opened.code() == 0
        assert opened.unchanged()

    return start


@pytest.mark.parametrize("case", CASES, ids=str)
def test_moves_are_followed(case: Case, viewing: Callable[[Case], Viewing]) -> None:
    """The first view; three turns on; and back by R: each as ``render`` makes it from there."""
    with viewing(case) as view:
        first = view.show("the first view")
        view.terminal.press("k", "k", "k")
        turned = view.show("the view three turns on", 3 * TURN)
        assert psnr(turned, first) < OTHER
        view.terminal.press("r")
        back = view.show("the first view again")
        np.testing.assert_array_equal(back, first)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_resizes_are_followed(case: Case, viewing: Callable[[Case], Viewing]) -> None:
    """A larger window, one after a storm of sizes, and the first again: of each its picture."""
    dice = random.Random(1)
    with viewing(case) as view:
        first = view.show("the first view")
        columns, rows = view.terminal.cells()
        view.resize(columns + 20, rows + 6)
        view.show("the larger window's picture")
        assert view.terminal.cells() == (columns + 20, rows + 6)
        for _ in range(25):
            view.resize(columns + dice.randrange(-40, 20), rows + dice.randrange(-12, 6))
        view.resize(columns - 20, rows - 7)
        await_("the last size", lambda: view.terminal.cells() == (columns - 20, rows - 7))
        view.show("the smaller window's picture")
        view.resize(columns, rows)
        await_("the first size", lambda: view.terminal.cells() == (columns, rows))
        np.testing.assert_array_equal(view.show("the first view again"), first)
