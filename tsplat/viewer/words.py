"""What is written beside the picture: status line, notices, and the panel's lines."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from tsplat.presenters.base import Terminal
from tsplat.viewer.controls import View
from tsplat.viewer.figures import Shown, figures, status
from tsplat.viewer.layout import Area
from tsplat.viewer.panel import Panel, placed
from tsplat.viewer.settings import Facts
from tsplat.viewer.text import status_line

if TYPE_CHECKING:
    from tsplat.viewer.verify import Verifier

NOTICE_SECONDS = 5.0  # that words stay in the status line
FIGURE_SECONDS = 0.25  # between figures while the picture moves


class Words:
    """What is said, and what of it the screen shows already; writes nothing itself."""

    def __init__(self, scene: str, verifier: Verifier | None) -> None:
        self.panel = Panel()
        self.figures: Sequence[tuple[str, str]] = ()  # of the panel
        self.notice, self.until = "", 0.0  # s, monotonic, that it stays
        self.told = ""  # the verifier's words in the status line
        self._scene, self._verifier = scene, verifier
        self._area: Area | None = None
        self._why = ""
        self._shown: Shown | None = None
        self._figured = 0.0  # s, monotonic
        self._lines: list[bytes] = []  # of the panel, on the screen

    def place(self, area: Area | None, why: str) -> None:
        """The panel is in ``area`` now, and ``why`` the presenter was chosen."""
        self._area, self._why = area, why
        self.forget()

    def forget(self) -> None:
        """The screen shows none of the panel."""
        self._lines = []

    def notify(self, words: str) -> None:
        """``words`` in the status line, for a while."""
        self.notice, self.until = words, time.monotonic() + NOTICE_SECONDS

    def settled(self) -> bool:
        """Takes the notice away when it has been there long enough; whether it did."""
        over = bool(self.notice) and time.monotonic() >= self.until
        if over:
            self.notice = ""
        return over

    def show(self, shown: Shown, terminal: Terminal, whole: bool) -> None:
        """Another picture is there; figures of one that is not ``whole`` come now and then."""
        self._shown = shown
        if whole or time.monotonic() > self._figured + FIGURE_SECONDS:
            self.figure(terminal)

    def figure(self, terminal: Terminal) -> None:
        """Works out the panel's figures anew."""
        if self._area is None:
            return
        self._figured = time.monotonic()
        found = self._verifier.text if self._verifier else ""
        self.figures = figures(self._shown, terminal, self._why, found)

    def text(
        self, view: View, terminal: Terminal, facts: Callable[[], Facts], recording: bool
    ) -> bytes:
        """Status line and panel, what of them has changed. ``facts`` is asked for a panel only."""
        line = self._status(view, terminal, recording)
        if self._area is None:
            return line
        lines = self.panel.lines(view, facts(), self._area)
        before, self._lines = self._lines, lines
        return line + placed(lines, before, self._area)

    def _status(self, view: View, terminal: Terminal, recording: bool) -> bytes:
        if not view.status:
            return status_line([self.notice] if self.notice else [], terminal)
        verifier = self._verifier
        self.told = verifier.text if verifier else ""
        parts = status(self._shown, self._area is not None) if self._shown else [self._scene]
        words = [self.notice, "recording" if recording else "", self.told, *parts]
        return status_line(words, terminal, alarm=verifier is not None and verifier.broken > 0)
