"""What a real terminal's screen shows is the picture that ``tsplat render`` makes.

Compared are photographs of the window, all rows but the last, with pictures in files. Presenters of
pictures are held to every pixel, half blocks to the middle of each half, where the mean of what it
covers should be. How near, in dB (PSNR), is each case's bound: once the picture rests, kitty's
protocol and iTerm2's are exact, half blocks in 24 bits as good as that, a palette is not.
``pytest tests/real -rP`` says how near each comes.
"""

from __future__ import annotations

import math
import random
import shlex
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest

from tests.real.desk import (
    KITTY,
    KONSOLE,
    MLTERM,
    XTERM,
    Make,
    Terminal,
    await_,
    in_tmux,
    tsplat,
)
from tests.real.pictures import Pictures, psnr, readable
from tsplat.presenters.halfblock import HALFBLOCK

AGAIN = 50.0  # dB; a camera by its eye and target is rounded elsewhere
OTHER = 25.0  # dB; two views of the scene are farther apart
EXACT = math.inf
MEAN = 60.0  # dB; a sum in another order may be rounded to the next level


@dataclass(frozen=True)
class Case:
    """A terminal, what is asked of ``tsplat view`` there, and how near the screen must come."""

    make: Make
    presenter: str  # which is asked for, or would be chosen
    bound: float  # dB
    asked: bool = True
    halves: bool = False  # a pixel is half a cell
    most: float = math.inf  # dB; nearer is another presenter's picture

    def __str__(self) -> str:
        return f"{self.make.name}-{self.presenter}"

    @property
    def words(self) -> tuple[str, ...]:
        return ("--presenter", self.presenter) if self.asked else ()


CASES = (
    Case(KITTY, "kitty", EXACT, asked=False),
    Case(XTERM, "sixel", 33.0, asked=False),
    Case(MLTERM, "iterm2", EXACT),
    Case(KONSOLE, "iterm2", EXACT, asked=False),
    Case(XTERM, "halfblock", MEAN, halves=True),
    Case(in_tmux(XTERM), "halfblock", MEAN, asked=False, halves=True),
    Case(in_tmux(KITTY), "kitty", EXACT, asked=False),
)


class Viewing:
    """``tsplat view`` on the demo scene, in a terminal of ``COLUMNS`` by ``ROWS`` at first."""

    def __init__(self, case: Case, terminal: Terminal, pictures: Pictures) -> None:
        self.case, self.terminal, self._pictures = case, terminal, pictures
        width, height = terminal.area(terminal.window)
        columns, rows = terminal.cells()
        self.cell = width // columns, height // rows
        self._margin = width - columns * self.cell[0], height - rows * self.cell[1]
        self._cells = columns, rows
        self.first = self.pixels()

    def pixels(self) -> tuple[int, int]:
        """px of all rows but the last, in the window as it was last asked for."""
        columns, rows = self._cells
        return columns * self.cell[0], (rows - 1) * self.cell[1]

    def resize(self, columns: int, rows: int) -> None:
        """The window."""
        width, height = columns * self.cell[0], rows * self.cell[1]
        self.terminal.resize(width + self._margin[0], height + self._margin[1])
        self._cells = columns, rows

    def shown(self) -> np.ndarray | None:
        """The picture on the screen; None until the program can know of the window's size."""
        if self.terminal.cells() != self._cells:
            return None
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

    def wanted(self, aside: bool = False) -> np.ndarray:
        """What ``tsplat render`` makes for the window as it is."""
        window = size = self.pixels()
        if self.case.halves:
            size = window[0] // self.cell[0], 2 * window[1] // self.cell[1]
        if size == self.first and not aside:
            return self._pictures.render(size)
        camera = self._pictures.camera(self.first, window, aside)
        samples = HALFBLOCK.samples if self.case.halves else 1
        return self._pictures.render(size, "--camera", camera, samples=samples)

    def show(self, what: str, aside: bool = False) -> np.ndarray:
        """Waits until the screen shows what it should, and returns it."""
        best, last = -math.inf, None

        def there() -> bool:
            nonlocal best, last
            before, last = last, self.shown()
            wanted = self.wanted(aside)
            if last is None or last.shape != wanted.shape:
                return False
            now = psnr(last, wanted)
            best = max(best, now)
            still = before is not None and np.array_equal(before, last)
            return still and self.case.bound <= now <= self.case.most

        try:
            await_(what, there)
        except AssertionError as error:
            kept = self.terminal.keep(last, self.wanted(aside))
            raise AssertionError(f"{error}; at best {best:.1f} dB; {kept}") from None
        print(f"{self.case}, {what}: {psnr(last, self.wanted(aside)):.1f} dB")  # seen with -rP
        return last


@pytest.fixture
def viewing(terminal, pictures):
    """Starts ``tsplat view``; Q ends it, with code 0 and the tty as it was."""

    @contextmanager
    def start(case: Case) -> Iterator[Viewing]:
        opened = terminal(case.make)
        opened.fresh()
        first = Viewing(case, opened, pictures)
        cameras = pictures.camera(first.first, first.first, aside=True)
        opened.view(*case.words, "--cameras", cameras, errors="said")
        try:
            yield first
        finally:
            opened.press("q")
            opened.ready()
        assert opened.code() == 0
        assert opened.changed() == []

    return start


@pytest.mark.parametrize("case", CASES, ids=str)
def test_moves_are_followed(case: Case, viewing: Callable[[Case], Viewing]) -> None:
    """The first view; a camera of a file; and back: each the picture that ``render`` makes."""
    with viewing(case) as view:
        first = view.show("the first view")
        view.terminal.press("n")
        aside = view.show("the file's camera", aside=True)
        assert psnr(aside, first) < OTHER
        view.terminal.press("z")
        view.show("the first view again")


@pytest.mark.parametrize("case", CASES[:2], ids=str)
def test_what_is_kept_is_what_is_shown(case: Case, viewing: Callable[[Case], Viewing]) -> None:
    """After arrows, P keeps the screen's picture, and a command that makes it again."""
    with viewing(case) as view:
        first = view.show("the first view")
        state = view.terminal.state
        view.terminal.press("Left", "Left", "Up")
        await_("another view", lambda: psnr(view.shown(), first) < OTHER)

        def kept() -> bool:
            """A key may go on to move the camera for a moment: then P comes too early."""
            before = view.shown()
            name = f"tsplat-demo-{len(list(state.glob('tsplat-demo-*.png'))) + 1:03d}.png"
            view.terminal.press("p")
            await_("the file", (state / name).exists)
            await_("all of it", lambda: readable(state / name) is not None)
            same = np.array_equal(before, view.shown())
            return same and psnr(before, readable(state / name)) >= case.bound

        await_("the screen's picture, kept", kept)
        shown = view.shown()
    *_, last = (state / "said").read_text().splitlines()
    words = shlex.split(last.rpartition(": ")[2])
    words[0:1] = tsplat()
    words[words.index("-o") + 1] = str(state / "again.png")
    subprocess.run(words, check=True, capture_output=True)
    assert psnr(shown, readable(state / "again.png")) >= min(case.bound, AGAIN)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_resizes_are_followed(case: Case, viewing: Callable[[Case], Viewing]) -> None:
    """A larger window, one after a storm of sizes, and the first again: of each its picture."""
    dice = random.Random(1)
    with viewing(case) as view:
        view.show("the first view")
        columns, rows = view.terminal.cells()
        view.resize(columns + 20, rows + 6)
        view.show("the larger window's picture")
        for _ in range(25):
            view.resize(columns + dice.randrange(-40, 20), rows + dice.randrange(-12, 6))
        view.resize(columns - 20, rows - 6)
        view.show("the smaller window's picture")
        view.resize(columns, rows)
        view.show("the first view again")


CYCLE = (
    Case(KITTY, "kitty", EXACT),
    Case(KITTY, "blocks", 20.0, most=40.0),  # quadrants and eighths, against every pixel
    Case(KITTY, "halfblock", MEAN, halves=True),
)
"""What a kitty that draws blocks itself goes through first, in the presenters' order."""


def test_another_presenter_shows_the_same_view(viewing: Callable[[Case], Viewing]) -> None:
    """M goes to the next, Shift+M back: each clears the last one's picture and shows its own."""
    with viewing(CYCLE[0]) as view:
        view.show("the first view")
        for case in CYCLE[1:]:
            view.terminal.press("m")
            view.case = case
            view.show(f"the first view by {case.presenter}")
        for case in CYCLE[-2::-1]:
            view.terminal.press("M")
            view.case = case
            view.show(f"the first view by {case.presenter} again")
