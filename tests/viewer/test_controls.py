"""Keys and mouse: each does what the help says, and nothing else."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tsplat.core.camera import Orbit, look_at
from tsplat.paths import Path
from tsplat.presenters.base import Terminal
from tsplat.terminal import Event
from tsplat.viewer.controls import HELP, KEYS, View, orbit_of
from tsplat.viewer.text import fitted, help_page, status_line

TERMINAL = Terminal(columns=100, rows=31)
HOME = Orbit(np.zeros(3), 5.0, 0.3, 0.2, np.array([0.0, -1.0, 0.0]))
VIEW = View(HOME, HOME, 50.0)


def press(view, *keys):
    """The view after these keys."""
    for key in keys:
        view = view.after(Event("key", key=key), TERMINAL)
    return view


def mouse(view, action, button="left", x=0, y=0, modifiers=frozenset()):
    """The view after a mouse event."""
    event = Event("mouse", action=action, button=button, x=x, y=y, modifiers=modifiers)
    return view.after(event, TERMINAL)


def seen(view, point=(0, 0, 0)):
    """Where a world point is seen, px of a 300x300 picture."""
    camera = view.camera((300, 300), (1.0, 1.0))
    p = camera.rotation @ (np.asarray(point) - camera.centre)
    return (camera.K @ p / p[2])[:2]


@pytest.mark.parametrize(
    ("key", "axis", "sign"), [("w", 1, 1), ("s", 1, -1), ("a", 0, 1), ("d", 0, -1)]
)
def test_wasd_moves_the_view(key, axis, sign):
    """Moving up puts the target lower in the picture, moving left puts it to the right."""
    moved = seen(press(VIEW, key)) - (150, 150)
    assert moved[axis] * sign > 1
    assert abs(moved[1 - axis]) < 1e-6


@pytest.mark.parametrize(
    ("keys", "name", "sign"),
    [(("left", "j"), "yaw", -1), (("right", "k"), "yaw", 1), (("up", "l"), "pitch", 1),
     (("down", "h"), "pitch", -1)],
)  # fmt: skip
def test_arrows_and_letters_turn(keys, name, sign):
    """Arrows and J K H L turn by the same step; capitals do the same."""
    for key in (*keys, keys[1].upper()):
        change = getattr(press(VIEW, key).orbit, name) - getattr(HOME, name)
        assert math.isclose(change, sign * math.radians(4))


def test_pitch_stops_at_the_poles():
    """Holding a key never turns the view over."""
    assert press(VIEW, *["up"] * 100).orbit.pitch == math.pi / 2
    assert press(VIEW, *["down"] * 100).orbit.pitch == -math.pi / 2


def test_zoom_has_bounds():
    """Keys and wheel change the distance by a tenth, and never to zero or infinity."""
    assert math.isclose(press(VIEW, "+").orbit.distance, 4.5)
    assert math.isclose(mouse(VIEW, "wheel", "down").orbit.distance, 5 / 0.9)
    assert press(VIEW, *["+"] * 500).orbit.distance >= 5e-4 * 0.999
    assert math.isfinite(press(VIEW, *["-"] * 500).orbit.distance)


def test_auto_orbit_turns_with_time_until_stopped():
    """O starts and stops; the angle depends on time, not on frames."""
    spinning = press(VIEW, "o")
    assert math.isclose(spinning.spun(2.0).orbit.yaw - HOME.yaw, math.radians(40))
    assert press(spinning, "o").spun(2.0).orbit.yaw == HOME.yaw
    assert press(spinning, "r").spinning is False


def test_u_turns_the_scene_upside_up_and_r_keeps_it():
    """The world's up is the other way round, seen from above again; R goes back to that."""
    flipped = press(VIEW, "u")
    above, below = seen(flipped, (0, 1, 0)), seen(flipped, (0, -1, 0))
    assert above[1] < 150 < below[1]
    assert flipped.camera((9, 9), (1.0, 1.0)).centre[1] > 0
    assert press(flipped, "w", "j", "+", "r").orbit is flipped.home
    assert np.array_equal(press(flipped, "u").orbit.up, HOME.up)


def test_dragging_turns_with_the_pointer():
    """The left button turns: the scene follows the pointer; the others move it exactly."""
    start = mouse(VIEW, "press", x=50, y=15)
    assert mouse(start, "drag", x=60, y=15).orbit.yaw < HOME.yaw
    assert mouse(start, "drag", x=50, y=20).orbit.pitch > HOME.pitch
    grip = mouse(VIEW, "press", "right", x=50, y=15)
    moved = mouse(grip, "drag", "right", x=60, y=15)
    camera = moved.camera((1000, 600), TERMINAL_PIXEL)
    p = camera.rotation @ -camera.centre
    np.testing.assert_allclose((camera.K @ p / p[2])[:2], (500 + 100, 300), atol=0.5)
    assert mouse(mouse(moved, "release", "right"), "drag", "right", x=9, y=9).orbit is moved.orbit


TERMINAL_PIXEL = (1.0, 1.0)


def test_a_picture_has_the_screens_proportions():
    """Half cells of 10x9.5 px: fy / fx is what makes a circle a circle on the screen."""
    k = VIEW.camera((100, 62), (10.0, 9.5)).K
    assert math.isclose(k[0, 0] * 10, k[1, 1] * 9.5, rel_tol=0.01)


@pytest.mark.parametrize("key", ["q", "Q", "escape", "ctrl+c"])
def test_quitting(key):
    """Each of these ends the session."""
    assert press(VIEW, key).quit


def test_help_goes_away_with_any_key_that_then_does_nothing_else():
    """? shows the page; even Q only closes it."""
    shown = press(VIEW, "?")
    assert shown.help
    back = press(shown, "q")
    assert not back.help
    assert not back.quit


def test_what_means_nothing_changes_nothing():
    """An unknown key, a drag without a press: the same view object, so nothing is redrawn."""
    assert press(VIEW, "x") is VIEW
    assert press(VIEW, "f5") is VIEW
    assert mouse(VIEW, "drag", x=3, y=3) is VIEW
    assert mouse(VIEW, "release") is VIEW
    assert VIEW.spun(1.0) is VIEW


def test_every_key_is_in_the_help():
    """The help page names each letter that does something."""
    named = HELP.replace("arrows", "left right up down").lower().split()
    for key in KEYS:
        if key not in ("=", "_", "escape", "ctrl+c"):
            assert key in named, key


def test_words_fit_the_screen():
    """Lines are cut to the width; wide characters take two cells; controls are made harmless."""
    assert fitted("日本語", 5) == "日本"
    assert "\x1b" not in fitted("a\x1b[2J", 20)
    line = status_line("x" * 500, Terminal(columns=20, rows=5))
    assert line.count(b"x") == 19
    assert b"\x1b[5;1H" in line
    assert help_page(Terminal(columns=20, rows=3)).count(b"H") >= 2


# --- along a path

EYES = (0, 0, -6), (2, -1, -5), (4, 1, -4)
PATH = Path(
    tuple(look_at(eye, (0, 0.5, 0), (0, -1, 0), 40, 64, 48) for eye in EYES),
    np.array([0.0, 1.0, 3.0]),
)


def test_a_path_is_played_in_its_own_time():
    """The camera is where the path is after so many seconds, and rests at its end."""
    view = VIEW.playing(PATH)
    for seconds in (0.25, 0.75, 1.0, 0.5):
        view = view.spun(seconds)
        np.testing.assert_array_equal(
            view.camera((64, 48), (1.0, 1.0)).viewmat, PATH.camera(view.played).viewmat
        )
    assert view.played == 2.5
    assert view.spinning
    ended = view.spun(9.0)
    assert ended.camera((64, 48), (1.0, 1.0)).same(PATH.poses[-1])
    assert not ended.spinning
    assert ended.spun(1.0) is ended


def test_a_path_that_goes_round_goes_on():
    """One that ends where it began never rests."""
    ring = Path((*PATH.poses, PATH.poses[0]), np.array([0.0, 1, 3, 4]))
    view = VIEW.playing(ring).spun(3.5).spun(1.0)
    assert view.spinning
    assert math.isclose(view.played, 0.5)


def test_pixels_of_any_shape_show_the_path_upright():
    """In half-blocks or at another size the height of view is the path's, and a ball is round."""
    view = VIEW.playing(PATH)
    camera = view.camera((100, 60), (10.0, 9.5))
    assert (camera.width, camera.height) == (100, 60)
    assert math.isclose(camera.K[0, 0] * 10, camera.K[1, 1] * 9.5)
    assert math.isclose(camera.height / camera.K[1, 1], 48 / PATH.poses[0].K[1, 1])


@pytest.mark.parametrize("key", ["x", "left", "o", "?", "q", "ctrl+c", "escape"])
def test_any_key_stops_where_it_is(key):
    """The same picture, from an orbit about what is in the middle; quitting keys quit as well."""
    view = VIEW.playing(PATH).spun(1.5)
    stopped = press(view, key)
    assert stopped.path is None
    assert not stopped.spinning
    assert not stopped.help
    assert stopped.quit == (key in ("q", "ctrl+c", "escape"))
    for point in ((0, 0, 0), (1, 0.5, 0), (0, 2, 1)):
        np.testing.assert_allclose(seen(stopped, point), seen(view, point), atol=1.5)  # it levels
    assert abs(seen(VIEW, (1, 0.5, 0)) - seen(view, (1, 0.5, 0))).max() > 10
    assert press(stopped, "r").orbit is HOME


def test_a_click_or_the_wheel_stops_it_and_the_mouse_alone_does_not():
    """What the hand does on purpose."""
    view = VIEW.playing(PATH).spun(1.5)
    assert mouse(view, "press").path is None
    assert mouse(view, "wheel", "up").path is None
    assert mouse(view, "move") is view


@pytest.mark.parametrize(("yaw", "pitch"), [(0.3, 0.2), (2.0, -0.7), (-3.0, 1.2), (1.0, 1.57)])
def test_orbit_of_is_the_inverse_of_an_orbits_camera(yaw, pitch):
    """An upright camera that looks at the target is on the orbit it was made by."""
    home = replace(HOME, target=np.array([1.0, 2, 3]), up=np.array([0.1, -1, 0.2]))
    orbit = replace(home, yaw=yaw, pitch=pitch)
    camera = orbit.camera(50, 64, 48)
    got = orbit_of(camera, home)
    np.testing.assert_allclose(got.camera(50, 64, 48).viewmat, camera.viewmat, atol=1e-9)
    assert math.isclose(got.distance, orbit.distance)
