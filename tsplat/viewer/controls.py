"""What keys and the mouse do to the view; pure, so that it can be tested without a terminal.

A key that moves the camera does so for as long as it is held (:meth:`View.moved`); every other one
does its work when it is pressed (:meth:`View.after`). What takes more than the view itself, such
as writing a file, is left as a wish for the viewer to see to.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tsplat.core.camera import Camera, Orbit
from tsplat.edits import Box
from tsplat.paths import Path
from tsplat.presenters.base import Terminal, proportions
from tsplat.terminal import Event
from tsplat.viewer.look import Look
from tsplat.views import FOV, clip_planes

MOVE = 0.6  # of the distance, per second a key is held
TURN = math.radians(60)  # per second
ZOOM = 1.2  # e-folds of the distance, per second
LENS = 20.0  # degrees of field of view, per second
FAST = 4.0  # times that, with Shift
NOTCH = 0.9  # of the distance, per click of the wheel
SIDEWAYS = math.radians(6)  # per click of a wheel that goes sideways, as touchpads have
SPIN = math.radians(20)  # per second of auto-orbit
DRAG = math.pi  # for a drag over the whole width
GLIDE_SECONDS = 0.35  # from one place to another that is not near
DISTANCES = 1e-4, 1e4  # of the first distance
FOVS = 5.0, 140.0  # degrees
SPEEDS = 1 / 64, 64.0
APPROACH = 0.5  # of the way to what is put in the middle
DOUBLE_SECONDS = 0.4  # between two clicks that are one

BACKGROUNDS = ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (1.0, 1.0, 1.0))
AXES = ((0, -1, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0))


def pointed(x: float, y: float, terminal: Terminal) -> tuple[float, float]:
    """The px that an event's cells are at: the middle of a cell, if no more is told."""
    inside = 0.0 if terminal.pixel_mouse else 0.5
    return (x + inside) * terminal.cell_width, (y + inside) * terminal.cell_height


def orbit_of(camera: Camera, home: Orbit) -> Orbit:
    """The orbit about what ``camera`` has in its middle, as far away as ``home``'s target is.

    Its up is ``home``'s: a camera that is tilted sideways stands upright there.
    """
    forward = camera.rotation[2]
    distance = max(float((home.target - camera.centre) @ forward), DISTANCES[0] * home.distance)
    return _facing(camera.centre, forward, distance, home)


def _facing(eye: np.ndarray, forward: np.ndarray, distance: float, like: Orbit) -> Orbit:
    """The orbit with ``like``'s up whose camera stands at ``eye`` and looks along ``forward``."""
    flat = replace(like, yaw=0.0, pitch=0.0).camera(FOV, 2, 2).rotation  # right, down, forward
    right, down, ahead = flat @ forward
    return replace(
        like,
        target=eye + distance * forward,
        distance=distance,
        yaw=math.atan2(right, ahead),
        pitch=math.asin(min(max(down, -1.0), 1.0)),
    )


HELP = """\
W A S D      forward, left, back, right
R F          up, down
arrows       turn; J K sideways, H L up and down
+ -  wheel   nearer, farther; the wheel at the cursor
[ ]          field of view
Shift        with any of these: faster
drag         turn (right or middle button, or Shift: move)
C  2 clicks  go to what is under the cursor
E            everything into the picture
Z            back to the first view
Space        orbit round a point, or fly
O            turn by itself, or stop
U            turn upside up; Shift: the next axis up
N            next camera of the file; Shift: the one before
, .          slower, faster
T Y          colours seen from aside (SH); antialias
B X          background; crop to a box, or not
M G          next presenter, next backend; Shift: the one before
P            keep a picture, and the command that makes it
V            record a path, or stop and keep it
Tab          all settings and figures: arrows choose and change
I            status line on and off
?            this help
Q Esc        quit"""


@dataclass(frozen=True, eq=False)
class View:
    """Where the camera is and what is switched on."""

    orbit: Orbit
    home: Orbit  # where Z goes
    fov: float  # degrees, vertical
    look: Look = field(default_factory=Look)
    flying: bool = False  # turns about the eye, not about what is looked at
    spinning: bool = False
    status: bool = True
    help: bool = False
    settings: bool = False  # the panel is open
    quit: bool = False
    wish: str = ""  # what the viewer is asked to do, as KEYS have it
    still: Camera | None = None  # a camera of a file, just as it is there, until it is moved
    path: Path | None = None  # the camera is on it, not on the orbit; spinning, too, while it goes
    played: float = 0.0  # s since the path's begin
    goal: Orbit | None = None  # where the camera glides to
    glided: float = 0.0  # s
    grip: tuple[float, float] | None = None  # cell where a drag was last seen
    cursor: tuple[float, float] | None = None  # cell where the mouse was last seen

    # --- the camera

    def camera(self, size: tuple[int, int], pixel: tuple[float, float]) -> Camera:
        """The camera for a picture of ``size`` px, each as wide and high on screen as ``pixel``."""
        width, height = proportions(size, pixel)
        given = self.still if self.path is None else self.path.camera(self.played)
        if given is not None:
            return given.reframed(width, height).resized(*size)
        near, far = clip_planes(self.orbit.distance)
        return self.orbit.camera(self.fov, width, height, near, far).resized(*size)

    @property
    def pose(self) -> tuple[object, ...]:
        """What says where the camera is: unchanged, each the same object, while it rests."""
        return self.orbit, self.fov, self.still, self.path, self.played

    def moves_from(self, other: View) -> bool:
        """Whether the camera is elsewhere, or sees otherwise, than in ``other``."""
        pairs = zip(self.pose, other.pose, strict=True)
        return self.look != other.look or any(
            a is not b if isinstance(a, Orbit | Camera | Path) else a != b for a, b in pairs
        )

    @property
    def going(self) -> bool:
        """Whether the camera moves by itself."""
        return self.spinning or self.goal is not None

    def spun(self, seconds: float) -> View:
        """The view after that long of going by itself: to its goal, along its path, or round."""
        if self.path is not None:
            return self._farther(seconds) if self.spinning else self
        if self.goal is not None:
            return self._gliding(seconds)
        return self._turned(SPIN * seconds, 0.0) if self.spinning else self

    def playing(self, path: Path) -> View:
        """The view at the begin of ``path``, about to go along it."""
        return replace(self, path=path, played=0.0, spinning=True)

    def at(self, camera: Camera) -> View:
        """The view that ``camera`` has, just as it is, until it is moved."""
        return replace(self, still=camera, path=None, spinning=False, goal=None)

    def to(self, orbit: Orbit) -> View:
        """About to glide to ``orbit``."""
        return replace(self._free(), goal=orbit, glided=0.0, spinning=False)

    def approaching(self, point: np.ndarray) -> View:
        """About to have ``point`` [3] in the middle, half as far away as it is now."""
        view = self._free()
        camera = view.orbit.camera(FOV, 2, 2)
        distance = float((point - camera.centre) @ camera.rotation[2])
        low, high = (d * view.home.distance for d in DISTANCES)
        distance = min(max(APPROACH * distance, low), high)
        return view.to(replace(view.orbit, target=point, distance=distance))

    def _gliding(self, seconds: float) -> View:
        """Straight to the goal, in the same share of what is left at every moment, then there."""
        assert self.goal is not None
        glided = self.glided + seconds
        if glided >= GLIDE_SECONDS:
            return replace(self, orbit=self.goal, goal=None)
        # smooth at both ends: 3 t^2 - 2 t^3, as a share of what is left
        done, now = (
            t * t * (3 - 2 * t) for t in (self.glided / GLIDE_SECONDS, glided / GLIDE_SECONDS)
        )
        share, here, there = (now - done) / (1 - done), self.orbit, self.goal
        ways = (there.yaw - here.yaw + math.pi) % math.tau - math.pi  # the short way round
        orbit = replace(
            here,
            target=here.target + share * (there.target - here.target),
            distance=here.distance * (there.distance / here.distance) ** share,
            yaw=here.yaw + share * ways,
            pitch=here.pitch + share * (there.pitch - here.pitch),
            up=there.up,
        )
        return replace(self, orbit=orbit, glided=glided)

    def _farther(self, seconds: float) -> View:
        """A path that ends where it began begins again; others are over at their end."""
        assert self.path is not None
        played = self.played + seconds
        if self.path.closed:
            return replace(self, played=played % self.path.seconds)
        return replace(
            self, played=min(played, self.path.seconds), spinning=played < self.path.seconds
        )

    def _free(self) -> View:
        """Off a path or a file's camera: the orbit that looks from here, upright; no goal."""
        camera = self.still if self.path is None else self.path.camera(self.played)
        if camera is None:
            return self if self.goal is None else replace(self, goal=None)
        orbit = orbit_of(camera, self.home)
        fov = 2 * math.degrees(math.atan(camera.height / 2 / camera.K[1, 1]))
        return replace(self, path=None, still=None, spinning=False, orbit=orbit, fov=fov, goal=None)

    # --- keys

    def moved(self, held: Mapping[str, float]) -> View:
        """The view after keys were held, each for so many seconds; Shift makes them faster.

        A name may be ``shift+left`` or a capital letter. Keys that move nothing are let pass.
        """
        view = self
        for key, seconds in held.items():
            motion, factor = _motion(key)
            if motion is not None and seconds > 0:
                view = motion(view._free(), factor * seconds)
        return view

    def after(self, event: Event, terminal: Terminal) -> View:
        """The view after a key was pressed or the mouse used; itself if that means nothing.

        Keys that move the camera are :meth:`moved`'s; here they only end what goes by itself.
        """
        if event.kind == "key":
            again = event.action == "repeat" and event.key not in REPEATS
            return self if event.action == "release" or again else self._after_key(event.key)
        if event.kind == "mouse":
            return self._after_mouse(event, terminal)
        return self

    def _after_key(self, key: str) -> View:
        if self.help:
            return replace(self, help=False)
        if self.path is not None and key not in LEAVES_PATH:
            return self._free()
        act = KEYS.get(key) or KEYS.get(key.lower())
        return act(self) if act else self

    # --- the mouse

    def _after_mouse(self, event: Event, terminal: Terminal) -> View:
        seen = replace(self, cursor=(event.x, event.y))
        if self.path is not None:
            return seen._free() if event.action in ("press", "wheel") else seen
        if event.action == "wheel":
            return seen._wheeled(event, terminal)
        if event.action == "press":
            return replace(seen, grip=(event.x, event.y), help=False)
        if event.action == "release" or self.grip is None:
            return seen if self.grip is None else replace(seen, grip=None)
        dx = (event.x - self.grip[0]) * terminal.cell_width  # px
        dy = (event.y - self.grip[1]) * terminal.cell_height
        if not (dx or dy):
            return seen
        moved = replace(seen._free(), grip=(event.x, event.y))
        width = terminal.pixels[0]
        if event.button == "left" and "shift" not in event.modifiers:
            turn = DRAG * self.look.turn_speed
            return moved._turned(-turn * dx / width, turn * dy / width)
        unit = moved._unit(terminal)
        return replace(moved, orbit=moved.orbit.panned(-dx * unit, dy * unit))

    def _wheeled(self, event: Event, terminal: Terminal) -> View:
        view, speed = self._free(), self.look.zoom_speed
        if "ctrl" in event.modifiers and event.button in ("up", "down"):
            return view._widened(-3.0 if event.button == "up" else 3.0)
        if event.button in ("up", "down"):
            factor = NOTCH**speed if event.button == "up" else NOTCH**-speed
            return view._zoomed(factor, view._offset(event.x, event.y, terminal))
        if event.button in ("left", "right"):
            return view._turned(-SIDEWAYS if event.button == "left" else SIDEWAYS, 0.0)
        return self

    def _unit(self, terminal: Terminal) -> float:
        """World units at the target's depth that a px of the screen covers."""
        height = terminal.pixels[1]
        return 2 * self.orbit.distance * math.tan(math.radians(self.fov) / 2) / height

    def _offset(self, x: float, y: float, terminal: Terminal) -> tuple[float, float]:
        """From the target to what is under a cell at its depth: world units right and up."""
        width, height = terminal.pixels
        right, down = pointed(x, y, terminal)
        unit = self._unit(terminal)
        return (right - width / 2) * unit, -(down - height / 2) * unit

    # --- moves; on a view that is free

    def _turned(self, yaw: float, pitch: float) -> View:
        orbit = self.orbit
        tilt = min(max(orbit.pitch + pitch, -math.pi / 2), math.pi / 2)
        turned = replace(orbit, yaw=orbit.yaw + yaw, pitch=tilt)
        if self.flying:  # the eye stays, so what is looked at moves
            eye, ahead = orbit.camera(FOV, 2, 2).centre, turned.camera(FOV, 2, 2).rotation[2]
            turned = replace(turned, target=eye + orbit.distance * ahead)
        return replace(self, orbit=turned)

    def _panned(self, right: float, up: float, forward: float) -> View:
        step = MOVE * self.look.move_speed * self.orbit.distance
        return replace(self, orbit=self.orbit.panned(right * step, up * step, forward * step))

    def _zoomed(self, factor: float, offset: tuple[float, float] = (0.0, 0.0)) -> View:
        """The eye goes towards what is ``offset`` from the target, to ``factor`` of its distance.

        In flight the distance to the target, which says how fast things go, stays.
        """
        low, high = (d * self.home.distance for d in DISTANCES)
        orbit = self.orbit
        distance = min(max(orbit.distance * factor, low), high)
        share = 1 - distance / orbit.distance
        if self.flying:
            orbit = orbit.panned(share * offset[0], share * offset[1], share * orbit.distance)
            return replace(self, orbit=orbit)
        orbit = orbit.panned(share * offset[0], share * offset[1])
        return replace(self, orbit=replace(orbit, distance=distance))

    def _widened(self, degrees: float) -> View:
        return replace(self, fov=min(max(self.fov + degrees, FOVS[0]), FOVS[1]))

    # --- switches

    def with_up(self, up: tuple[float, float, float]) -> View:
        """The same view of a world that has ``up`` upwards."""
        axis = np.asarray(up, np.float64)
        free = self._free()
        return replace(free, orbit=replace(free.orbit, up=axis), home=replace(free.home, up=axis))

    def next_axis(self, by: int = 1) -> View:
        """With the next of the world's axes upwards."""
        up = tuple(int(n) for n in np.round(self.home.up))
        place = AXES.index(up) if up in AXES else -1
        return self.with_up(AXES[(place + by) % len(AXES)])

    def with_fov(self, degrees: float) -> View:
        """With another vertical field of view."""
        return replace(self._free(), fov=degrees)

    def flown(self, flying: bool) -> View:
        """Turning about the eye, or about what is looked at."""
        return replace(self._free(), flying=flying)

    def spinning_is(self, spinning: bool) -> View:
        """Turning by itself, or not."""
        return replace(self._free(), spinning=spinning)

    def _flipped(self) -> View:
        def flip(orbit: Orbit) -> Orbit:
            return replace(orbit, up=-orbit.up, yaw=-orbit.yaw)

        free = self._free()
        return replace(free, orbit=flip(free.orbit), home=flip(free.home))

    def looking(self, **changes: object) -> View:
        """With other settings of :class:`Look`."""
        return replace(self, look=replace(self.look, **changes))  # type: ignore[arg-type]

    def shading(self, **changes: object) -> View:
        """With other ``RenderParams``."""
        return self.looking(params=replace(self.look.params, **changes))  # type: ignore[arg-type]

    def editing(self, **changes: object) -> View:
        """With other ``Edits``."""
        return self.looking(edits=replace(self.look.edits, **changes))  # type: ignore[arg-type]

    def _faster(self, factor: float) -> View:
        speed = min(max(self.look.move_speed * factor, SPEEDS[0]), SPEEDS[1])
        return self.looking(move_speed=speed)

    def _shaded(self) -> View:
        return self.shading(sh_degree=0 if self.look.params.sh_degree else 3)

    def _next_background(self) -> View:
        now = self.look.background
        place = BACKGROUNDS.index(now) if now in BACKGROUNDS else -1
        return self.looking(background=BACKGROUNDS[(place + 1) % len(BACKGROUNDS)])

    def cropped(self) -> View:
        """To a box about what is looked at, or not any more."""
        if self.look.edits.crop is not None:
            return self.editing(crop=None)
        orbit = self._free().orbit
        half = orbit.distance * math.tan(math.radians(self.fov) / 2) / 2
        low, high = (tuple((orbit.target + s * half).tolist()) for s in (-1, 1))
        return self.editing(crop=Box(low, high))

    def wishing(self, wish: str) -> View:
        """With something for the viewer to do."""
        return replace(self, wish=wish)


Act = Callable[[View], View]
Motion = Callable[[View, float], View]


def _wish(wish: str) -> Act:
    return lambda view: view.wishing(wish)


def _quit(view: View) -> View:
    return replace(view, quit=True)


def _back(view: View) -> View:
    """Escape closes what is open, first."""
    return replace(view, settings=False) if view.settings else _quit(view)


def _pan(right: float, up: float, forward: float) -> Motion:
    return lambda view, s: view._panned(right * s, up * s, forward * s)


def _turn(yaw: float, pitch: float) -> Motion:
    def turn(view: View, seconds: float) -> View:
        angle = TURN * view.look.turn_speed * seconds
        return view._turned(yaw * angle, pitch * angle)

    return turn


def _zoom(sign: float) -> Motion:
    return lambda view, s: view._zoomed(math.exp(sign * ZOOM * view.look.zoom_speed * s))


def _widen(sign: float) -> Motion:
    return lambda view, s: view._widened(sign * LENS * s)


MOTIONS: dict[str, Motion] = {
    "w": _pan(0, 0, 1), "s": _pan(0, 0, -1), "a": _pan(-1, 0, 0), "d": _pan(1, 0, 0),
    "r": _pan(0, 1, 0), "f": _pan(0, -1, 0),
    "left": _turn(-1, 0), "j": _turn(-1, 0), "right": _turn(1, 0), "k": _turn(1, 0),
    "up": _turn(0, 1), "l": _turn(0, 1), "down": _turn(0, -1), "h": _turn(0, -1),
    "+": _zoom(-1), "=": _zoom(-1), "-": _zoom(1), "_": _zoom(1),
    "[": _widen(-1), "]": _widen(1),
}  # fmt: skip
"""What each key does for as long as it is held."""

ARROWS = frozenset({"left", "right", "up", "down"})
"""Keys that an open panel takes for itself."""


def _motion(key: str) -> tuple[Motion | None, float]:
    """What ``key`` moves, and how many times as fast."""
    if key in MOTIONS:
        return MOTIONS[key], 1.0
    plain = key.removeprefix("shift+").lower()
    return MOTIONS.get(plain), FAST


def moves(key: str) -> bool:
    """Whether ``key`` moves the camera while it is held."""
    return _motion(key)[0] is not None


REPEATS = frozenset({",", "."})
"""Keys that do it again while they are held."""

LEAVES_PATH = frozenset({"q", "Q", "escape", "ctrl+c", "?", "tab", "i", "p", "v", "m", "M"})
"""Keys that do what they do without ending a path that is played."""

KEYS: dict[str, Act] = {
    " ": lambda view: view.flown(not view.flying),
    "o": lambda view: view.spinning_is(not view.spinning),
    "u": View._flipped, "U": View.next_axis,
    "z": lambda view: view.to(view.home), "home": lambda view: view.to(view.home),
    "e": _wish("everything"), "c": _wish("under"),
    "n": _wish("next camera"), "N": _wish("camera before"),
    ",": lambda view: view._faster(1 / 2**0.5), ".": lambda view: view._faster(2**0.5),
    "t": View._shaded,
    "y": lambda view: view.shading(antialias=not view.look.params.antialias),
    "b": View._next_background, "x": View.cropped,
    "m": _wish("next presenter"), "M": _wish("presenter before"),
    "g": _wish("next backend"), "G": _wish("backend before"),
    "p": _wish("picture"), "v": _wish("record"),
    "tab": lambda view: replace(view, settings=not view.settings),
    "i": lambda view: replace(view, status=not view.status),
    "?": lambda view: replace(view, help=True),
    "q": _quit, "escape": _back, "ctrl+c": _quit,
}  # fmt: skip
"""What each other key does when it is pressed; letters in either case where only one is here."""
