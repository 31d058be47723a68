"""Where the picture and the panel go on the screen: beside each other, never one on the other.

Text written over a picture stays, is erased or takes the picture away, as the protocol has it. So
an open panel has cells of its own, and the picture gets a screen that ends where the panel begins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from tsplat.presenters.base import Terminal

PANEL = 42  # columns; enough for the longest row
PICTURE = 30  # columns that must be left for a picture beside the panel
ROWS = 5, 12  # of a panel under the picture, at least and at most
PICTURE_ROWS = 8  # that must be left above it


@dataclass(frozen=True)
class Area:
    """Cells, counted from 0."""

    left: int
    top: int
    columns: int
    rows: int

    def has(self, x: float, y: float) -> bool:
        """Whether a cell is in it."""
        return 0 <= x - self.left < self.columns and 0 <= y - self.top < self.rows


@dataclass(frozen=True)
class Layout:
    """``picture`` None: there is room for the panel alone."""

    picture: Terminal | None  # the screen as presenters are to see it, from the top left cell on
    panel: Area | None


def layout(terminal: Terminal, panel: bool) -> Layout:
    """Beside the picture, or under it, or instead of it; the last row is the status line's.

    A screen of one row has no place for a panel.
    """
    if not panel or terminal.rows < 2:
        return Layout(terminal, None)
    rows = terminal.rows - 1
    if terminal.columns >= PANEL + PICTURE:
        left = terminal.columns - PANEL
        area = Area(left + 1, 0, PANEL - 1, rows)
        return Layout(replace(terminal, columns=left), area)
    least, most = ROWS
    if rows >= least + PICTURE_ROWS:
        top = max(PICTURE_ROWS, rows - most)
        area = Area(0, top, terminal.columns, rows - top)
        return Layout(replace(terminal, rows=top + 1), area)  # its last row is left alone, too
    return Layout(None, Area(0, 0, terminal.columns, rows))
