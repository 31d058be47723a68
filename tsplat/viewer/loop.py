"""The viewer: events in, frames out while something changes, nothing when nothing does.

The viewer's own thread listens, decides and writes; two others render and encode
(:mod:`tsplat.viewer.pipeline`). While the camera moves, pictures have as many pixels as the frame
rate allows (:mod:`tsplat.viewer.pace`); when it rests, all.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from tsplat.core.camera import Camera
from tsplat.core.errors import PluginError, printable
from tsplat.core.params import settings_text
from tsplat.core.types import Frame, Scene
from tsplat.core.workspace import Workspace
from tsplat.plan import Plan, Rendered
from tsplat.presenters.base import Presenter, Terminal
from tsplat.presenters.enlarge import enlarged
from tsplat.terminal import Event, Flight, Screen, choose_presenter
from tsplat.viewer.controls import View
from tsplat.viewer.pace import Pace
from tsplat.viewer.pipeline import Pipeline
from tsplat.viewer.shades import shaded
from tsplat.viewer.text import help_page, status_line

if TYPE_CHECKING:
    from tsplat.viewer.verify import Verifier

FPS = 30.0
STILL_SECONDS = 0.08  # without a move the picture is refined; keys held down repeat faster
FPS_SECONDS = 1.0  # that frames are counted over


@dataclass(frozen=True, eq=False)
class Picture:
    """One that is wanted."""

    view: View
    level: int  # of Pace; 0 has all pixels
    size: tuple[int, int]  # px
    shades: int | None  # of each channel; None: all
    terminal: Terminal
    presenter: Presenter
    begun: float  # s, monotonic


@dataclass(eq=False)
class Drawn:
    """One that was rendered. Its frames are its own: the workspace goes on to the next."""

    picture: Picture
    camera: Camera
    frame: Frame  # as it is encoded: on its background, as large as encode wants it, in its shades
    rendered: Rendered  # its frame only where it is verified
    seconds: float


@dataclass(frozen=True)
class Encoded:
    """What is written for one."""

    payload: bytes
    seconds: float


class Viewer:
    """One session: a scene, its plan, a screen that is already entered, a pipeline not started."""

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
        *,
        pipeline: Pipeline[Picture, Drawn, Encoded],
        fps: float = FPS,
    ) -> None:
        self._screen, self._scene, self._plan, self._view = screen, scene, plan, view
        self._presenters, self._wanted = dict(presenters), wanted
        self._background, self._fps = background, fps
        self._verifier = verifier
        screen.watched = verifier.fileno() if verifier else None
        self._line = ""  # the status line's words for the frame on the screen
        self._told = ""  # the verifier's words in it
        self._workspace = Workspace(plan.threads)
        self._pipeline = pipeline
        self._asked: Picture | None = None  # last
        # On their way, to be acknowledged in this order; None: abandoned, or no picture
        self._sent: deque[tuple[Drawn, Encoded] | None] = deque()
        self._helping = False  # the help page is on the screen
        self._lead = b""  # to be written before the next frame
        self._clock = self._moved = time.monotonic()
        self._moved -= STILL_SECONDS
        self._frames: deque[float] = deque()  # when the last ones were shown
        self._choose()

    def _choose(self) -> None:
        terminal = self._screen.terminal
        self._presenter, _ = choose_presenter(self._presenters, terminal, self._wanted)
        self._screen.cleanup = self._presenter.clear(terminal)
        self._pace = Pace(self._presenter.size(terminal), self._fps, far=self._screen.far)
        self._asked = None
        self._sent = deque(None for _ in self._sent)

    def run(self) -> None:
        """Until the user quits."""
        screen = self._screen
        self._pipeline.start(self._render, self._encode, lambda: screen.post(Event("made")))
        try:
            while not self._view.quit:
                for event in screen.read_events(self._timeout()):
                    self._hear(event)
                if not self._view.quit:
                    self._acknowledged()
                    self._show()
                    self._want()
                    self._verify()
        finally:
            self._pipeline.close()

    # --- what happens

    def _hear(self, event: Event) -> None:
        screen, before = self._screen, self._view
        if event.kind == "key" and event.key == "ctrl+z":
            screen.suspend()
        elif event.kind in ("resize", "terminal"):
            self._redraw_all()
        elif event.kind == "watched":
            self._receive()
        else:
            self._view = before.after(event, screen.terminal)
        if self._view.orbit is not before.orbit:
            self._moved = time.monotonic()
            self._hurry()

    def _hurry(self) -> None:
        """A move: a picture that is being refined is in its way, even half written."""
        asked = self._asked
        if asked is None or asked.level >= self._pace.level:
            return
        self._pipeline.drop()
        last = self._sent[-1] if self._sent else None
        if last is not None and last[0].picture is asked and self._screen.abandon():
            self._pipeline.forget()
            self._sent[-1] = None  # its flight tells nothing
            self._lead = self._presenter.clear(self._screen.terminal)

    def _redraw_all(self) -> None:
        """Nothing on the screen can be trusted any more."""
        self._pipeline.forget()
        self._screen.abandon()
        self._screen.draw(self._presenter.clear(self._screen.terminal), track=False)
        self._screen.clear()
        self._helping, self._lead = False, b""
        self._choose()

    def _acknowledged(self) -> None:
        """What the terminal has answered is on the screen."""
        flights = self._screen.flights
        while self._sent and (flights or not self._screen.waiting):
            # a terminal that answers nothing has none
            flight = flights.popleft() if flights else None
            sent = self._sent.popleft()
            if sent is None or not sent[1].payload:  # what has not changed takes no time
                continue
            drawn, encoded = sent
            flight = flight or Flight(len(encoded.payload), 0.0, 0.0)
            self._pace.note(
                drawn.picture.level, drawn.seconds, encoded.seconds, flight.occupied, flight.sent,
                flight.seconds,
            )  # fmt: skip
        flights.clear()

    # --- what is wanted

    @property
    def _moving(self) -> bool:
        return self._view.spinning or time.monotonic() < self._moved + STILL_SECONDS

    def _level(self) -> int | None:
        """Of the picture that is wanted now; None if it is there or on its way."""
        asked, view = self._asked, self._view
        if view.help:
            return None
        if asked is None:
            return self._pace.level
        if view.spinning or view.orbit is not asked.view.orbit:
            return self._pace.level
        if view is not asked.view:
            return asked.level
        if self._moving or self._pipeline.busy or self._screen.busy:
            return None
        return self._pace.finer(asked.level)

    def _due(self, level: int) -> float:
        """When the next picture may be begun, in monotonic s."""
        asked = self._asked
        if asked is None or not (self._pipeline.busy or self._screen.busy or self._view.spinning):
            return 0.0
        return asked.begun + self._pace.interval(level)

    def _timeout(self) -> float | None:
        """Seconds until there is something to do without an event; idle costs nothing."""
        now, level = time.monotonic(), self._level()
        if level is not None:
            return max(0.0, self._due(level) - now)
        if self._view.help or self._pipeline.busy or self._screen.busy:
            return None  # an event comes
        if self._moving:
            return max(0.0, self._moved + STILL_SECONDS - now)
        return self._verifier.wait() if self._verifier else None

    def _want(self) -> None:
        """Asks for the next picture, if it is time."""
        now = time.monotonic()
        elapsed, self._clock = now - self._clock, now
        self._view = self._view.spun(elapsed)
        level = self._level()
        if level is None or now < self._due(level):
            return
        self._asked = Picture(
            self._view, level, self._pace.size(level), self._pace.shades(level),
            self._screen.terminal, self._presenter, now,
        )  # fmt: skip
        self._pipeline.ask(self._asked)

    # --- the pipeline's threads

    def _render(self, picture: Picture) -> Drawn:
        begin = time.perf_counter()
        full = picture.presenter.size(picture.terminal)
        pixel = picture.presenter.pixel(picture.terminal)
        camera = picture.view.camera(full, pixel).resized(*picture.size)
        rendered = self._plan.run(self._scene, camera, self._workspace)
        frame = rendered.frame.over(self._background)
        if picture.presenter.fill is None and picture.size != full:
            frame = enlarged(frame, *full)
        elif frame.rgb is rendered.frame.rgb:
            frame = Frame(frame.rgb.copy(), frame.transmittance)
        kept = rendered.frame
        if self._verifier is not None:
            kept = Frame(kept.rgb.copy(), kept.transmittance.copy())
        return Drawn(
            picture, camera, frame, replace(rendered, frame=kept), time.perf_counter() - begin
        )

    def _encode(self, drawn: Drawn, before: Drawn | None) -> Encoded:
        begin = time.perf_counter()
        picture = drawn.picture
        presenter, terminal = picture.presenter, picture.terminal
        few = presenter.fill is not None and picture.size != presenter.size(terminal)
        encode = presenter.fill if few and presenter.fill is not None else presenter.encode
        if picture.shades is not None:
            drawn.frame = shaded(drawn.frame, picture.shades, before.frame if before else None)
        try:
            payload = encode(drawn.frame, terminal, before.frame if before else None)
        except Exception as error:
            raise PluginError(
                f"presenter {presenter.name!r} failed: "
                f"{type(error).__name__}: {printable(error)}; try another with --presenter"
            ) from error
        return Encoded(payload, time.perf_counter() - begin)

    # --- what is shown

    def _show(self) -> None:
        """The next frame, if the terminal has taken the last one."""
        screen = self._screen
        if screen.busy:
            return
        if self._view.help:
            if not self._helping:
                self._pipeline.forget()
                self._helping, self._asked = True, None
                self._sent.append(None)
                clear = self._presenter.clear(screen.terminal)
                screen.draw(clear + help_page(screen.terminal))
            return
        made = self._pipeline.take()
        if made is None:
            return
        drawn, encoded = made
        if self._helping:
            self._helping = False
            screen.clear()
        self._count()
        view = drawn.picture.view
        self._line = self._status(drawn, encoded)
        status = self._status_line() if view.status else status_line("", screen.terminal)
        lead, self._lead = self._lead, b""
        self._sent.append(made)
        screen.draw(lead + encoded.payload + status)
        if self._verifier is not None:
            self._verifier.show(drawn.camera, drawn.rendered.frame)

    def _count(self) -> None:
        now = time.monotonic()
        self._frames.append(now)
        while self._frames[0] < now - FPS_SECONDS:
            self._frames.popleft()

    def _status_line(self) -> bytes:
        terminal, verifier = self._screen.terminal, self._verifier
        if verifier is None:
            return status_line(self._line, terminal)
        self._told = verifier.text
        words = "  ".join(words for words in (self._told, self._line) if words)
        return status_line(words, terminal, alarm=verifier.broken > 0)

    def _status(self, drawn: Drawn, encoded: Encoded) -> str:
        rendered, picture = drawn.rendered, drawn.picture
        names = "+".join(dict.fromkeys(self._plan.backends.values()))
        shortcuts = f"  {settings_text(self._plan.asked)}" if self._plan.shortcuts else ""
        width, height = picture.size
        full = "" if picture.level == 0 else "/{}x{}".format(*self._pace.size(0))
        every = f" of {len(self._scene):,}" if rendered.visible < len(self._scene) else ""
        span = self._frames[-1] - self._frames[0]
        rate = f"  {(len(self._frames) - 1) / span:.0f} fps" if len(self._frames) > 2 else ""
        link = self._pace.link
        way = f"  {link.seconds * 1e3:.0f} ms {bits(link.rate)}" if link else ""
        return (
            f"{self._scene.name}  {rendered.visible:,}{every}{rate}  "
            f"{rendered.seconds['total'] * 1e3:.1f} ms {names} x{self._plan.threads}{shortcuts}  "
            f"{picture.presenter.name} {width}x{height}{full} "
            f"{encoded.seconds * 1e3:.1f} ms {len(encoded.payload) / 1e3:.0f} kB{way}  ? keys"
            + "".join(f"  without {item.what}" for item in rendered.left_out)
        )

    # --- verification

    def _receive(self) -> None:
        """Takes what the verifier has found."""
        if self._verifier is not None:
            self._verifier.receive()
            if self._verifier.failure:
                self._screen.watched = None  # its end is all there is to read

    def _verify(self) -> None:
        """The next round, while nothing else is to be done."""
        if self._verifier is None or self._pipeline.busy or self._screen.busy:
            return
        if self._level() is None:
            self._verifier.step()
            self._tell(self._verifier.text)

    def _tell(self, found: str) -> None:
        """The status line anew, if the verifier has something new for it."""
        if found != self._told and self._view.status and not self._view.help:
            self._screen.draw(self._status_line(), track=False)


def bits(rate: float) -> str:
    """Bytes/s as bits/s, as links are sold."""
    for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if rate * 8 >= size:
            return f"{rate * 8 / size:.3g} {unit}bit/s"
    return f"{rate * 8:.0f} bit/s"
