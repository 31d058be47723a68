"""The viewer: events in, frames out while something changes, nothing when nothing does.

The viewer's own thread listens, decides and writes; two others render and encode
(:mod:`tsplat.viewer.pipeline`). While the camera moves, pictures have as many pixels as the frame
rate allows (:mod:`tsplat.viewer.pace`); when it rests, all.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from tsplat.core.camera import Camera
from tsplat.core.errors import CameraError, TsplatError, printable
from tsplat.plugins import ask
from tsplat.presenters.base import Presenter
from tsplat.terminal import Event, Flight, Screen, choose_presenter
from tsplat.viewer.controls import DOUBLE_SECONDS, View, moves, pointed
from tsplat.viewer.engine import Engine
from tsplat.viewer.figures import Shown
from tsplat.viewer.frames import Drawn, Encoded, Picture, draw, encode
from tsplat.viewer.held import Held
from tsplat.viewer.keep import Keeper, Recording
from tsplat.viewer.layout import layout
from tsplat.viewer.pace import Pace
from tsplat.viewer.pick import point_under
from tsplat.viewer.pipeline import Pipeline
from tsplat.viewer.settings import Facts
from tsplat.viewer.text import help_page, help_top
from tsplat.viewer.words import Words
from tsplat.views import frame_orbit

if TYPE_CHECKING:
    from tsplat.viewer.verify import Verifier

STILL_SECONDS = 0.08  # without a move the picture is refined, in any case
SOON_SECONDS = 0.03  # or sooner if that takes little time; a mouse is told 60 times a second
STILL_SHARE = 0.3  # of the time that it takes: a move that comes after all is kept waiting as long
FPS_SECONDS = 1.0  # that frames are counted over
FIRST_SECONDS = 0.008  # of a held key that its first picture shows


@dataclass(frozen=True)
class Around:
    """What a session has besides a screen and a scene."""

    presenters: Mapping[str, Presenter]
    backends: Sequence[str]  # that can be used here, the fastest first
    keeper: Keeper
    cameras: Callable[[], Sequence[Camera]]  # of the scene's file; CameraError if there is none
    verifier: Verifier | None = None
    read_raw: bool = False  # with --raw-opacity


class Viewer:
    """One session: an engine, a screen that is already entered, a pipeline not started."""

    def __init__(
        self,
        screen: Screen,
        engine: Engine,
        view: View,
        around: Around,
        *,
        pipeline: Pipeline[Picture, Drawn, Encoded],
    ) -> None:
        self._screen, self._engine, self._view, self._around = screen, engine, view, around
        self._verified = view.look  # what the verifier compares with
        screen.watched = around.verifier.fileno() if around.verifier else None
        self._pipeline = pipeline
        self._asked: Picture | None = None  # last
        # On their way, to be acknowledged in this order; None: abandoned, or no picture
        self._sent: deque[tuple[Drawn, Encoded] | None] = deque()
        self._words = Words(engine.name, around.verifier)
        self._help_top = 0
        self._helping = False  # the help page is on the screen
        self._lead = b""  # to be written before the next frame
        self._held = Held()
        self._heard: float | None = None  # when input came that no picture shows yet
        self._latency: float | None = None  # s, from the last input to its picture
        self._recording: Recording | None = None
        self._click: tuple[float, float, float] | None = None  # s, monotonic, and cell: the last
        self._place = -1  # in the file of cameras
        self._cut = ""  # what was said of pictures that are smaller than the window
        self._clock = self._moved = time.monotonic()
        self._moved -= STILL_SECONDS
        self._frames: deque[float] = deque()  # when the last ones were shown
        self._choose()

    def _choose(self) -> None:
        screen, look = self._screen, self._view.look
        self._presenter, self._why = choose_presenter(
            dict(self._around.presenters), screen.terminal, look.presenter
        )
        screen.cleanup = self._presenter.clear(screen.terminal)
        self._layout = layout(screen.terminal, self._view.settings)
        self._terminal = self._layout.picture or screen.terminal
        size = self._presenter.size(self._terminal)
        self._pace = Pace(size, look.fps, far=screen.far)
        self._limit()
        self._asked = None
        self._sent = deque(None for _ in self._sent)
        self._words.place(self._layout.panel, self._why)
        cut = self._terminal.sixel_cut if self._presenter.name == "sixel" else ""
        if cut not in ("", self._cut):
            self._words.notify(cut)
        self._cut = cut

    def _limit(self) -> None:
        """Holds frames and bytes to what the look and the presenter allow."""
        screen, look = self._screen, self._view.look
        screen.max_rate = look.max_rate / 8 if look.max_rate else None
        self._pace.period = 1 / min(look.fps, self._presenter.fps(screen.terminal))

    def run(self) -> None:
        """Until the user quits."""
        screen = self._screen
        keep = self._around.verifier is not None
        self._pipeline.start(
            lambda picture: draw(picture, self._engine, keep),
            encode,
            lambda: screen.post(Event("made")),
        )
        try:
            while not self._view.quit:
                for event in screen.read_events(self._timeout()):
                    self._hear(event)
                if not self._view.quit:
                    self._acknowledged()
                    self._show()
                    self._want()
                    self._verify()
                    if self._words.settled():
                        self._tell()
        finally:
            self._pipeline.close()
            if self._recording is not None:
                self._around.keeper.path(self._recording, self._engine.name)

    # --- what happens

    def _hear(self, event: Event) -> None:
        screen = self._screen
        if event.kind == "key" and event.key == "ctrl+z" and event.action == "press":
            self._held = Held()
            screen.suspend()
        elif event.kind in ("resize", "terminal"):
            self._redraw_all()
        elif event.kind == "watched":
            self._receive()
        elif event.kind == "kept":
            self._notify(event.key)
        elif event.kind in ("key", "mouse", "focus"):
            self._advance()
            self._use(event)

    def _use(self, event: Event) -> None:
        """Input."""
        before, now = self._view, time.monotonic()
        if before.help and self._turned_help(event):
            return
        taken = None
        if self._layout.panel is not None and not before.help and event.action != "release":
            taken = self._words.panel.after(event, before, self._facts(), self._layout.panel)
        if taken is not None:
            self._words.panel, self._view = taken
        else:
            self._held = self._held.after(event, now)
            self._view = before.after(event, self._terminal)
        if self._holding or self._view.moves_from(before):
            self._heard = self._heard or now
        if self._clicked_twice(event, now) and taken is None:
            self._view = self._view.wishing("under")
        if self._view.wish:
            wish, self._view = self._view.wish, replace(self._view, wish="")
            self._grant(wish)
        self._changed(before)

    def _clicked_twice(self, event: Event, now: float) -> bool:
        """Whether this is a click of the left button soon after another on the same place."""
        if event.kind != "mouse" or event.action != "press":
            return False
        last, self._click = self._click, (now, event.x, event.y)
        if event.button != "left" or last is None or now > last[0] + DOUBLE_SECONDS:
            return False
        near = abs(event.x - last[1]) <= 1 and abs(event.y - last[2]) <= 1
        self._click = None if near else self._click  # a third click is the first of two others
        return near

    def _turned_help(self, event: Event) -> bool:
        """Whether ``event`` turned a page that is longer than the screen."""
        by = {"up": -1, "down": 1, "pageup": -8, "pagedown": 8}.get(event.key or event.button)
        if by is None or event.action == "release":
            return False
        top = help_top(self._help_top + by, self._screen.terminal)
        if top != self._help_top:
            self._help_top = top
            self._screen.draw(help_page(self._screen.terminal, top), track=False)
        return help_top(1, self._screen.terminal) > 0

    def _changed(self, before: View) -> None:
        """Sees to what follows from another view than ``before``."""
        view = self._view
        if view.look.presenter != before.look.presenter or view.settings != before.settings:
            self._redraw_all()
        elif view.look != before.look:
            self._limit()
        if view.moves_from(before):
            self._moved = time.monotonic()
            self._hurry()
        if view.status != before.status or self._layout.panel is not None:
            self._tell()

    def _hurry(self) -> None:
        """A move: a picture that is being refined is in its way, even half written."""
        asked = self._asked
        if asked is None or (asked.level >= self._pace.level and not asked.rests):
            return
        self._pipeline.drop()
        last = self._sent[-1] if self._sent else None
        if last is not None and last[0].picture is asked and self._screen.abandon():
            self._pipeline.forget()
            self._sent[-1] = None  # its flight tells nothing
            self._lead = self._presenter.clear(self._screen.terminal)

    def _redraw_all(self) -> None:
        """Nothing on the screen can be trusted any more."""
        self._held = Held()
        self._pipeline.forget()
        self._screen.abandon()
        self._screen.draw(self._presenter.clear(self._screen.terminal), track=False)
        self._screen.clear()
        self._helping, self._lead = False, b""
        self._choose()
        self._words.figure(self._screen.terminal)
        self._tell()

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
            if drawn.picture.heard is not None:
                self._latency = time.monotonic() - drawn.picture.heard
            if drawn.picture.rests or encoded.begins:  # tells nothing of moving ones
                continue
            flight = flight or Flight(len(encoded.payload), 0.0, 0.0)
            self._pace.note(
                drawn.picture.level, drawn.seconds, encoded.seconds, flight.occupied, flight.sent,
                flight.seconds,
            )  # fmt: skip
        flights.clear()

    # --- wishes

    def _grant(self, wish: str) -> None:
        """What takes more than the view."""
        match wish:
            case "next camera":
                self._next_camera(1)
            case "camera before":
                self._next_camera(-1)
            case "next presenter":
                self._next_name("presenter", 1)
            case "presenter before":
                self._next_name("presenter", -1)
            case "next backend":
                self._next_name("backend", 1)
            case "backend before":
                self._next_name("backend", -1)
            case "everything":
                self._frame_all()
            case "under":
                self._frame_under()
            case "picture":
                self._keep_picture()
            case "record":
                self._record()

    def _next_camera(self, by: int) -> None:
        try:
            cameras = self._around.cameras()
        except CameraError as error:
            self._notify(str(error))
            return
        first = self._place < 0
        self._place = 0 if first and by > 0 else (max(self._place, 0) + by) % len(cameras)
        self._view = self._view.at(cameras[self._place])
        self._notify(f"camera {self._place} of {len(cameras)}")

    def _next_name(self, kind: str, by: int) -> None:
        """The presenter or backend after the one in use, or before it."""
        facts = self._facts()
        names = facts.presenters if kind == "presenter" else facts.backends
        now = getattr(self._view.look, kind)
        if now == "auto":
            now = self._presenter.name if kind == "presenter" else names[0] if names else now
        place = names.index(now) if now in names else 0
        name = names[(place + by) % len(names)] if names else now
        self._view = self._view.looking(**{kind: name})
        self._notify(f"{kind} {name}")

    def _frame_all(self) -> None:
        view, (width, height) = self._view, self._terminal.pixels
        orbit = frame_orbit(
            self._engine.scene, width, height, view.fov, view.orbit.up,
            yaw=view.orbit.yaw, pitch=view.orbit.pitch,
        )  # fmt: skip
        self._view = view.to(orbit)

    def _frame_under(self) -> None:
        view, terminal = self._view, self._terminal
        width, height = terminal.pixels
        x, y = width / 2, height / 2
        if view.cursor is not None:
            x, y = pointed(*view.cursor, terminal)
        camera = view.camera((width, height), (1.0, 1.0))
        try:
            point = point_under(self._engine.prepared_last, camera, x, y)
        except (TsplatError, MemoryError) as error:  # a backend need not offer depths
            self._notify(f"no depth there: {printable(error)}")
            return
        if point is None:
            self._notify("nothing there")
        else:
            self._view = view.approaching(point)

    def _keep_picture(self) -> None:
        view, screen = self._view, self._screen
        size = view.look.picture or self._terminal.pixels
        camera = view.camera(size, (1.0, 1.0))
        self._notify("keeping a picture")
        self._around.keeper.picture(
            view, camera, self._engine.prepared_last,
            lambda words: screen.post(Event("kept", words)),
        )  # fmt: skip

    def _record(self) -> None:
        if self._recording is None:
            self._recording = Recording()
            self._notify("recording the camera's path; V keeps it")
        else:
            recording, self._recording = self._recording, None
            self._notify(self._around.keeper.path(recording, self._engine.name))

    # --- what is wanted

    @property
    def _moving(self) -> bool:
        now = time.monotonic()
        return self._view.going or self._holding or now < self._still_from

    @property
    def _still_from(self) -> float:
        """When the view counts as resting, in monotonic s, if nothing more comes."""
        finer = self._pace.finer(self._asked.level) if self._asked is not None else None
        share = STILL_SHARE * self._pace.load(finer or 0)
        return self._moved + min(STILL_SECONDS, max(SOON_SECONDS, share))

    @property
    def _holding(self) -> bool:
        return any(moves(key) for key in self._held.down(time.monotonic()))

    @property
    def _covered(self) -> bool:
        """Whether there is no place for a picture."""
        return self._view.help or self._layout.picture is None

    def _level(self) -> int | None:
        """Of the picture that is wanted now; None if it is there or on its way."""
        asked, view = self._asked, self._view
        if self._covered:
            return None
        if asked is None or view.going or view.moves_from(asked.view):
            return self._pace.level
        if self._moving or self._pipeline.busy or self._screen.busy:
            return None
        if asked.level == 0 and self._presenter.rest is not None and not asked.rests:
            return 0
        return self._pace.finer(asked.level)

    def _due(self, level: int) -> float:
        """When the next picture may be begun, in monotonic s."""
        asked = self._asked
        if asked is None or not (self._pipeline.busy or self._screen.busy or self._view.going):
            return 0.0
        head_start = self._pace.head_start(level)
        if head_start is None:
            return asked.begun + self._pace.interval(level)
        if self._pipeline.busy:
            return math.inf  # that goes first
        free = time.monotonic() + self._screen.free_in
        return max(asked.begun + self._pace.period, free - head_start)

    def _timeout(self) -> float | None:
        """Seconds until there is something to do without an event; idle costs nothing."""
        now, level = time.monotonic(), self._level()
        ends = [self._words.until] if self._words.notice else []
        if level is not None:
            ends += [due for due in [self._due(level)] if due < math.inf]  # else an event comes
        elif self._holding and not self._covered:
            ends.append(now + FIRST_SECONDS)
        elif self._covered or self._pipeline.busy or self._screen.busy:
            pass  # an event comes
        elif self._moving:
            ends.append(self._still_from)
        elif self._around.verifier and (wait := self._around.verifier.wait()) is not None:
            ends.append(now + wait)
        return max(0.0, min(ends) - now) if ends else None

    def _advance(self) -> None:
        """The view as it is by now: what goes by itself, and keys that are held."""
        before, then, now = self._view, self._clock, time.monotonic()
        self._clock = now
        if self._recording is not None:
            self._record_pose(then)
        view = before.spun(now - then)
        if not view.help:
            view = view.moved(self._held.active(then, now))
        self._view = view
        if self._recording is not None:
            self._record_pose(now)
        if view.moves_from(before):
            self._moved = now
            if not before.going:
                self._hurry()

    def _record_pose(self, now: float) -> None:
        assert self._recording is not None
        camera = self._view.camera(self._terminal.pixels, (1.0, 1.0))
        self._recording.add(now, camera)

    def _want(self) -> None:
        """Asks for the next picture, if it is time."""
        self._advance()
        level, now = self._level(), time.monotonic()
        if level is None or now < self._due(level):
            return
        fresh = self._asked is None or self._view.moves_from(self._asked.view)
        heard = self._heard if fresh else None
        self._heard = None if fresh else self._heard
        rests = level == 0 and self._presenter.rest is not None and not self._moving
        self._asked = Picture(
            self._view, level, self._pace.size(level), self._pace.covered(level),
            self._pace.shades(level), self._terminal, self._presenter, now, heard, rests,
        )  # fmt: skip
        self._pipeline.ask(self._asked)

    # --- what is shown

    def _show(self) -> None:
        """The next frame, if the terminal has taken the last one."""
        screen = self._screen
        if screen.busy:
            return
        if self._view.help:
            if not self._helping:
                self._pipeline.forget()
                self._helping, self._asked, self._help_top = True, None, 0
                self._sent.append(None)
                clear = self._presenter.clear(screen.terminal)
                screen.draw(clear + help_page(screen.terminal))
            return
        if self._helping and self._layout.picture is None:
            self._redraw_all()
        made = self._pipeline.take()
        if made is None:
            return
        drawn, encoded = made
        if self._helping:
            self._helping = False
            screen.clear()
            self._words.forget()
        self._count()
        if drawn.prepared.trouble not in ("", self._words.notice):
            self._notify(drawn.prepared.trouble)
        self._words.show(self._of(drawn, encoded), screen.terminal, drawn.picture.level == 0)
        lead, self._lead = self._lead, b""
        self._sent.append(made)
        screen.draw(lead + encoded.payload + self._text())
        if self._around.verifier is not None and drawn.prepared.look == self._verified:
            self._around.verifier.show(drawn.camera, drawn.rendered.frame)

    def _of(self, drawn: Drawn, encoded: Encoded) -> Shown:
        span = self._frames[-1] - self._frames[0]
        several = len(self._frames) > 3 and self._moving
        return Shown(
            scene=drawn.prepared.scene,
            plan=drawn.prepared.plan,
            look=drawn.prepared.look,
            rendered=drawn.rendered,
            presenter=drawn.picture.presenter.name,
            size=drawn.picture.size,
            full=self._pace.size(0),
            camera=drawn.camera,
            frames=(len(self._frames) - 1) / span if several and span else None,
            encode=encoded.seconds,
            sent=len(encoded.payload),
            link=self._pace.link,
            latency=self._latency,
        )

    def _count(self) -> None:
        now = time.monotonic()
        self._frames.append(now)
        while self._frames[0] < now - FPS_SECONDS:
            self._frames.popleft()

    def _facts(self) -> Facts:
        return Facts(
            [name for name, row in self._around.presenters.items()
             if not ask(row.unsupported, self._screen.terminal)],
            self._around.backends,
            {"presenter": self._presenter.name, "backend": self._engine.backends},
            self._words.figures,
            self._around.read_raw,
        )  # fmt: skip

    def _text(self) -> bytes:
        """Status line and panel, what of them has changed."""
        recording = self._recording is not None
        return self._words.text(self._view, self._screen.terminal, self._facts, recording)

    def _notify(self, words: str) -> None:
        """Words in the status line, for a while."""
        self._words.notify(words)
        self._tell()

    def _tell(self) -> None:
        """Status line and panel anew, without a picture."""
        if not self._view.help:
            self._screen.draw(self._text(), track=False)

    # --- verification

    def _receive(self) -> None:
        """Takes what the verifier has found."""
        verifier = self._around.verifier
        if verifier is not None:
            verifier.receive()
            if verifier.failure:
                self._screen.watched = None  # its end is all there is to read

    def _verify(self) -> None:
        """The next round, while nothing else is to be done."""
        verifier = self._around.verifier
        if verifier is None or self._pipeline.busy or self._screen.busy:
            return
        if self._level() is None:
            verifier.step()
            if verifier.text != self._words.told and self._view.status:
                self._words.figure(self._screen.terminal)
                self._tell()
