"""The viewer: events in, one frame out when something changed, nothing when nothing did."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

from tsplat.core.camera import Camera
from tsplat.core.errors import PluginError, printable
from tsplat.core.params import settings_text
from tsplat.core.types import Frame, Scene
from tsplat.core.workspace import Workspace
from tsplat.plan import Plan, Rendered
from tsplat.presenters.base import Presenter
from tsplat.terminal import Screen, choose_presenter
from tsplat.viewer.controls import View
from tsplat.viewer.text import help_page, status_line

if TYPE_CHECKING:
    from tsplat.viewer.verify import Verifier


class Viewer:
    """One session: a scene, its plan, a screen that is already entered."""

    def __init__(
        self,
        screen: Screen,
        scene: Scene,
        plan: Plan,
        view: View,
        presenters: Mapping[str, Presenter],
        wanted: str = "auto",
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        verifier: Verifier | None = None,
    ) -> None:
        self._screen, self._scene, self._plan, self._view = screen, scene, plan, view
        self._presenters, self._wanted = dict(presenters), wanted
        self._background = background
        self._verifier = verifier
        screen.watched = verifier.fileno() if verifier else None
        self._line = ""  # the status line's words for the frame on the screen
        self._told = ""  # the verifier's words in it
        # Two workspaces in turn: the frame on the screen must outlive the one being made.
        self._workspaces = [Workspace(plan.threads), Workspace(plan.threads)]
        self._shown: Frame | None = None
        self._drawn: View | None = None  # the view on the screen
        self._camera: Camera | None = None  # that took it
        self._clock = time.monotonic()
        self._choose()

    def _choose(self) -> None:
        self._presenter, _ = choose_presenter(self._presenters, self._screen.terminal, self._wanted)
        self._screen.cleanup = self._presenter.clear(self._screen.terminal)

    def run(self) -> None:
        """Until the user quits."""
        screen = self._screen
        while not self._view.quit:
            if screen.busy:
                timeout: float | None = None  # "ready" comes, or is given up after a second
            elif self._drawn is not self._view or self._view.spinning:
                timeout = 0.0
            else:
                timeout = self._verifier.wait() if self._verifier else None  # idle costs nothing
            for event in screen.read_events(timeout):
                if event.kind == "key" and event.key == "ctrl+z":
                    screen.suspend()
                elif event.kind in ("resize", "terminal"):
                    self._redraw_all()
                elif event.kind == "watched":
                    self._hear()
                else:
                    self._view = self._view.after(event, screen.terminal)
            now = time.monotonic()
            elapsed, self._clock = now - self._clock, now
            if not screen.busy and not self._view.quit:
                self._view = self._view.spun(elapsed)
                if self._drawn is not self._view:
                    self._draw()
                elif self._verifier is not None:
                    self._verifier.step()
                    self._tell(self._verifier.text)

    def _hear(self) -> None:
        """Takes what the verifier has found."""
        if self._verifier is not None:
            self._verifier.receive()
            if self._verifier.failure:
                self._screen.watched = None  # its end is all there is to read

    def _tell(self, found: str) -> None:
        """The status line anew, if the verifier has something new for it."""
        if found != self._told and self._view.status and not self._view.help:
            self._screen.draw(self._status_line(), track=False)

    def _redraw_all(self) -> None:
        """Nothing on the screen can be trusted any more."""
        terminal = self._screen.terminal
        self._screen.write(self._presenter.clear(terminal))
        self._screen.clear()
        self._choose()
        self._shown = self._drawn = None

    def _draw(self) -> None:
        view, before, terminal = self._view, self._drawn, self._screen.terminal
        self._drawn = view
        if view.help:
            self._screen.draw(self._presenter.clear(terminal) + help_page(terminal))
            self._shown = None
            return
        if before is not None and before.help:
            self._screen.clear()
        size = self._presenter.size(terminal)
        camera = view.camera(size, self._presenter.pixel(terminal))
        if self._camera is None or not self._camera.same(camera):
            self._workspaces.reverse()
        self._camera = camera
        rendered = self._plan.run(self._scene, camera, self._workspaces[0])
        frame = rendered.frame.over(self._background)
        begin = time.perf_counter()
        try:
            payload = self._presenter.encode(frame, terminal, self._shown)
        except Exception as error:
            raise PluginError(
                f"presenter {self._presenter.name!r} failed: "
                f"{type(error).__name__}: {printable(error)}; try another with --presenter"
            ) from error
        encoded = time.perf_counter() - begin
        self._line = self._status(rendered, encoded, len(payload))
        status = self._status_line() if view.status else status_line("", terminal)
        self._screen.draw(payload + status)
        self._shown = frame
        if self._verifier is not None:
            self._verifier.show(camera, rendered.frame)

    def _status_line(self) -> bytes:
        terminal, verifier = self._screen.terminal, self._verifier
        if verifier is None:
            return status_line(self._line, terminal)
        self._told = verifier.text
        words = "  ".join(words for words in (self._told, self._line) if words)
        return status_line(words, terminal, alarm=verifier.broken > 0)

    def _status(self, rendered: Rendered, encoded: float, sent: int) -> str:
        names = "+".join(dict.fromkeys(self._plan.backends.values()))
        frame, less = rendered.frame, (item.what for item in rendered.left_out)
        shortcuts = f"  {settings_text(self._plan.asked)}" if self._plan.shortcuts else ""
        return (
            f"{self._scene.name}  {rendered.visible:,} of {len(self._scene):,}  "
            f"{rendered.seconds['total'] * 1e3:.1f} ms {names} x{self._plan.threads}{shortcuts}  "
            f"{self._presenter.name} {frame.width}x{frame.height} "
            f"{encoded * 1e3:.1f} ms {sent / 1e3:.0f} kB  ? keys"
            + "".join(f"  without {what}" for what in less)
        )
