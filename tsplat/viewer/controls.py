"""What keys and the mouse do to the view; pure, so that it can be tested without a terminal."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from tsplat.core.camera import Camera, Orbit
from tsplat.paths import Path
from tsplat.presenters.base import Terminal
from tsplat.terminal import Event
from tsplat.views import FOV, clip_planes

TURN = math.radians(4)  # per key press
PAN = 0.04  # of the distance, per key press
ZOOM = 0.9  # of the distance, per key press or wheel click
SPIN = math.radians(20)  # per second of auto-orbit
DRAG = math.pi  # for a drag over the whole width
DISTANCES = 1e-4, 1e4  # of the first distance


def orbit_of(camera: Camera, home: Orbit) -> Orbit:
    """The orbit about what ``camera`` has in its middle, as far away as ``home``'s target is.

    Its up is ``home``'s: a camera that is tilted sideways stands upright there.
    """
    forward = camera.rotation[2]
    distance = max(float((home.target - camera.centre) @ forward), DISTANCES[0] * home.distance)
    flat = replace(home, yaw=0.0, pitch=0.0).camera(FOV, 2, 2).rotation  # right, down, forward
    right, down, ahead = flat @ forward
    return replace(
        home,
        target=camera.centre + distance * forward,
        distance=distance,
        yaw=math.atan2(right, ahead),
        pitch=math.asin(min(max(down, -1.0), 1.0)),
    )


HELP = """\
W A S D      move up, left, down, right
arrows       turn; J K sideways, H L up and down
+ -  wheel   nearer, farther
drag         turn (right or middle button, or Shift: move)
O            orbit by itself, or stop
U            turn the scene upside up
R            back to the first view
Tab          status line on and off
?            this help; any key goes back
Q Esc        quit"""


@dataclass(frozen=True, eq=False)
class View:
    """Where the camera is and what is switched on."""

    orbit: Orbit
    home: Orbit  # where R goes
    fov: float  # degrees, vertical
    spinning: bool = False
    status: bool = True
    help: bool = False
    quit: bool = False
    grip: tuple[float, float] | None = None  # cell where a drag was last seen
    path: Path | None = None  # the camera is on it, not on the orbit; spinning, too, while it goes
    played: float = 0.0  # s since the path's begin

    def camera(self, size: tuple[int, int], pixel: tuple[float, float]) -> Camera:
        """The camera for a picture of ``size`` px, each as wide and high on screen as ``pixel``."""
        width, height = (max(1, round(n * unit)) for n, unit in zip(size, pixel, strict=True))
        if self.path is not None:
            return self.path.camera(self.played).reframed(width, height).resized(*size)
        near, far = clip_planes(self.orbit.distance)
        return self.orbit.camera(self.fov, width, height, near, far).resized(*size)

    def spun(self, seconds: float) -> View:
        """The view after that long of auto-orbit, or farther along its path."""
        if self.path is not None:
            return self._farther(seconds) if self.spinning else self
        return self._turned(SPIN * seconds, 0.0) if self.spinning else self

    def playing(self, path: Path) -> View:
        """The view at the begin of ``path``, about to go along it."""
        return replace(self, path=path, played=0.0, spinning=True)

    def _farther(self, seconds: float) -> View:
        """A path that ends where it began begins again; others are over at their end."""
        assert self.path is not None
        played = self.played + seconds
        if self.path.closed:
            return replace(self, played=played % self.path.seconds)
        return replace(
            self, played=min(played, self.path.seconds), spinning=played < self.path.seconds
        )

    def _stopped(self) -> View:
        """Off the path: the orbit that looks from here at what is in the middle, upright."""
        assert self.path is not None
        camera = self.path.camera(self.played)
        orbit = orbit_of(camera, self.home)
        fov = 2 * math.degrees(math.atan(camera.height / 2 / camera.K[1, 1]))
        return replace(self, path=None, spinning=False, orbit=orbit, fov=fov)

    def after(self, event: Event, terminal: Terminal) -> View:
        """The view after a key or mouse event; itself if the event means nothing."""
        if event.kind == "key" and event.action != "release":
            if self.help:
                return replace(self, help=False)
            if self.path is not None:
                stopped = self._stopped()
                return _quit(stopped) if KEYS.get(event.key.lower()) is _quit else stopped
            act = KEYS.get(event.key) or KEYS.get(event.key.lower())
            return act(self) if act else self
        if event.kind == "mouse":
            return self._after_mouse(event, terminal)
        return self

    def _after_mouse(self, event: Event, terminal: Terminal) -> View:
        if self.path is not None:
            return self._stopped() if event.action in ("press", "wheel") else self
        if event.action == "wheel":
            steps = {"up": ZOOM, "down": 1 / ZOOM}
            return self._zoomed(steps[event.button]) if event.button in steps else self
        if event.action == "press":
            return replace(self, grip=(event.x, event.y), help=False)
        if event.action == "release" or self.grip is None:
            return self if self.grip is None else replace(self, grip=None)
        dx = (event.x - self.grip[0]) * terminal.cell_width  # px
        dy = (event.y - self.grip[1]) * terminal.cell_height
        moved = replace(self, grip=(event.x, event.y))
        width, height = terminal.pixels
        if event.button == "left" and "shift" not in event.modifiers:
            return moved._turned(-DRAG * dx / width, DRAG * dy / width)
        unit = 2 * self.orbit.distance * math.tan(math.radians(self.fov) / 2) / height  # per px
        return replace(moved, orbit=self.orbit.panned(-dx * unit, dy * unit))

    def _turned(self, yaw: float, pitch: float) -> View:
        tilt = min(max(self.orbit.pitch + pitch, -math.pi / 2), math.pi / 2)
        return replace(self, orbit=replace(self.orbit, yaw=self.orbit.yaw + yaw, pitch=tilt))

    def _panned(self, right: float, up: float) -> View:
        step = PAN * self.orbit.distance
        return replace(self, orbit=self.orbit.panned(right * step, up * step))

    def _zoomed(self, factor: float) -> View:
        low, high = (d * self.home.distance for d in DISTANCES)
        distance = min(max(self.orbit.distance * factor, low), high)
        return replace(self, orbit=replace(self.orbit, distance=distance))

    def _flipped(self) -> View:
        def flip(orbit: Orbit) -> Orbit:
            return replace(orbit, up=-orbit.up, yaw=-orbit.yaw)

        return replace(self, orbit=flip(self.orbit), home=flip(self.home))


def _turn(yaw: float, pitch: float) -> Callable[[View], View]:
    return lambda view: view._turned(yaw * TURN, pitch * TURN)


def _pan(right: float, up: float) -> Callable[[View], View]:
    return lambda view: view._panned(right, up)


def _zoom(factor: float) -> Callable[[View], View]:
    return lambda view: view._zoomed(factor)


def _quit(view: View) -> View:
    return replace(view, quit=True)


KEYS: dict[str, Callable[[View], View]] = {
    "w": _pan(0, 1), "s": _pan(0, -1), "a": _pan(-1, 0), "d": _pan(1, 0),
    "left": _turn(-1, 0), "j": _turn(-1, 0), "right": _turn(1, 0), "k": _turn(1, 0),
    "up": _turn(0, 1), "l": _turn(0, 1), "down": _turn(0, -1), "h": _turn(0, -1),
    "+": _zoom(ZOOM), "=": _zoom(ZOOM), "-": _zoom(1 / ZOOM), "_": _zoom(1 / ZOOM),
    "o": lambda view: replace(view, spinning=not view.spinning),
    "u": View._flipped,
    "r": lambda view: replace(view, orbit=view.home, spinning=False),
    "tab": lambda view: replace(view, status=not view.status),
    "?": lambda view: replace(view, help=True),
    "q": _quit, "escape": _quit, "ctrl+c": _quit,
}  # fmt: skip
"""What each key does; letters in either case."""
