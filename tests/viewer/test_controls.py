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
from tsplat.viewer.controls import HELP, KEYS, MOTIONS, View, orbit_of
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


def hold(view, seconds=0.1, *keys):
    """The view after these keys were held together."""
    return view.moved(dict.fromkeys(keys, seconds))


def eye(view):
    """Where the camera stands."""
    return view.camera((9, 9), (1.0, 1.0)).centre


@pytest.mark.parametrize(
    ("key", "axis", "sign"), [("r", 1, 1), ("f", 1, -1), ("a", 0, 1), ("d", 0, -1)]
)
def test_keys_move_sideways(key, axis, sign):
    """Moving up puts the target lower in the picture, moving left puts it to the right."""
    moved = seen(hold(VIEW, 0.1, key)) - (150, 150)
    assert moved[axis] * sign > 1
    assert abs(moved[1 - axis]) < 1e-6


def test_w_goes_forward_and_s_back():
    """Eye and target go along the line of sight, so far in each second held."""
    forward = VIEW.camera((9, 9), (1.0, 1.0)).rotation[2]
    for key, sign in (("w", 1), ("s", -1)):
        moved = hold(VIEW, 0.5, key)
        np.testing.assert_allclose(eye(moved) - eye(VIEW), sign * 0.5 * 0.6 * 5 * forward)
        np.testing.assert_allclose(moved.orbit.target - HOME.target, eye(moved) - eye(VIEW))


@pytest.mark.parametrize(
    ("keys", "name", "sign"),
    [(("left", "j"), "yaw", -1), (("right", "k"), "yaw", 1), (("up", "l"), "pitch", 1),
     (("down", "h"), "pitch", -1)],
)  # fmt: skip
def test_arrows_and_letters_turn(keys, name, sign):
    """Arrows and J K H L turn at one rate; Shift makes them faster."""
    for key in keys:
        change = getattr(hold(VIEW, 0.1, key).orbit, name) - getattr(HOME, name)
        assert math.isclose(change, sign * math.radians(6))
    for key in (f"shift+{keys[0]}", keys[1].upper()):
        change = getattr(hold(VIEW, 0.1, key).orbit, name) - getattr(HOME, name)
        assert math.isclose(change, sign * math.radians(24))


def test_how_long_a_key_was_held_counts_and_not_how_often_it_was_asked():
    """Ten times a tenth of a second is a second, for every key that moves."""
    for key in MOTIONS:
        whole, parts = hold(VIEW, 0.5, key), VIEW
        for _ in range(10):
            parts = hold(parts, 0.05, key)
        np.testing.assert_allclose(eye(parts), eye(whole), rtol=1e-9, atol=1e-9)
        assert math.isclose(parts.fov, whole.fov)


def test_two_keys_at_once_and_opposite_ones():
    """W and D go both ways; A and D go nowhere."""
    both = hold(VIEW, 0.1, "w", "d")
    np.testing.assert_allclose(
        eye(both) - eye(VIEW),
        (eye(hold(VIEW, 0.1, "w")) - eye(VIEW)) + (eye(hold(VIEW, 0.1, "d")) - eye(VIEW)),
    )
    np.testing.assert_allclose(eye(hold(VIEW, 0.1, "a", "d")), eye(VIEW), atol=1e-12)


def test_pitch_stops_at_the_poles():
    """Holding a key never turns the view over."""
    assert hold(VIEW, 60, "up").orbit.pitch == math.pi / 2
    assert hold(VIEW, 60, "down").orbit.pitch == -math.pi / 2


def test_zoom_has_bounds():
    """Keys and wheel change the distance by a factor, and never to zero or infinity."""
    assert math.isclose(hold(VIEW, 0.5, "+").orbit.distance, 5 * math.exp(-0.6))
    assert math.isclose(mouse(VIEW, "wheel", "down").orbit.distance, 5 / 0.9)
    assert hold(VIEW, 500, "+").orbit.distance >= 5e-4 * 0.999
    assert math.isfinite(hold(VIEW, 500, "-").orbit.distance)


def test_the_wheel_zooms_at_the_cursor():
    """What is under the cursor, as far away as the target, stays there; elsewhere it moves."""
    x, y = 70, 20  # cells; the picture has 1000x600 px
    place = (x + 0.5) * 10, (y + 0.5) * 20
    camera = VIEW.camera((1000, 600), (1.0, 1.0))
    ray = np.linalg.inv(camera.K) @ (*place, 1.0)
    point = camera.centre + camera.rotation.T @ (HOME.distance * ray)
    for flying in (False, True):
        view = VIEW.flown(flying)
        for turn in ("up", "up", "down", "up"):
            view = mouse(view, "wheel", turn, x=x, y=y)
        after = view.camera((1000, 600), (1.0, 1.0))
        p = after.rotation @ (point - after.centre)
        np.testing.assert_allclose((after.K @ p / p[2])[:2], place, atol=1e-6)
        assert p[2] < 0.9 * HOME.distance
        assert np.abs(seen(view) - (150, 150)).max() > 5


def test_a_wheel_that_goes_sideways_turns():
    """As touchpads have it."""
    assert (
        mouse(VIEW, "wheel", "left").orbit.yaw < HOME.yaw < mouse(VIEW, "wheel", "right").orbit.yaw
    )


def test_flying_turns_about_the_eye():
    """Space: the camera stands still and looks elsewhere, with keys and with the mouse."""
    flying = press(VIEW, " ")
    for turned in (
        hold(flying, 0.3, "left", "up"),
        mouse(mouse(flying, "press", x=5, y=5), "drag", x=15, y=9),
    ):
        np.testing.assert_allclose(eye(turned), eye(VIEW), atol=1e-12)
        assert np.abs(seen(turned) - (150, 150)).max() > 5
        assert math.isclose(turned.orbit.distance, HOME.distance)
    assert np.abs(eye(hold(VIEW, 0.3, "left")) - eye(VIEW)).max() > 0.1
    assert not press(flying, " ").flying


def test_speeds():
    """, and . change how fast keys move, within bounds; turning has a speed of its own."""
    fast = press(VIEW, ".", ".")
    np.testing.assert_allclose(
        eye(hold(fast, 0.1, "w")) - eye(VIEW), 2 * (eye(hold(VIEW, 0.1, "w")) - eye(VIEW))
    )
    assert hold(fast, 0.1, "left").orbit.yaw == hold(VIEW, 0.1, "left").orbit.yaw
    slow = press(VIEW, *[","] * 99)
    assert 0 < slow.look.move_speed < 0.1


def test_the_lens_has_bounds():
    """[ and ] narrow and widen the field of view, never to nothing or to everything."""
    assert math.isclose(hold(VIEW, 0.5, "[").fov, 40)
    assert math.isclose(hold(VIEW, 0.5, "]").fov, 60)
    assert 0 < hold(VIEW, 99, "[").fov < hold(VIEW, 99, "]").fov < 180


def test_auto_orbit_turns_with_time_until_stopped():
    """O starts and stops; the angle depends on time, not on frames."""
    spinning = press(VIEW, "o")
    assert math.isclose(spinning.spun(2.0).orbit.yaw - HOME.yaw, math.radians(40))
    assert press(spinning, "o").spun(2.0).orbit.yaw == HOME.yaw
    assert press(spinning, "z").spinning is False


def arrived(view):
    """When it has glided."""
    return view.spun(1.0)


def test_gliding_arrives():
    """To the first view without a jump, whatever the frames' times; then it rests."""
    away = hold(press(VIEW, "u"), 0.7, "w", "left", "+", "up")
    away = replace(away, orbit=replace(away.orbit, yaw=away.orbit.yaw + 12 * math.pi))
    view, places = press(away, "z"), []
    assert view.going
    while view.going:
        places.append(eye(view))
        view = view.spun(0.011)
    assert view.orbit is away.home
    steps = np.linalg.norm(np.diff([*places, eye(view)], axis=0), axis=1)
    assert steps.max() < 0.2 * np.linalg.norm(eye(view) - eye(away)) + 0.2
    halves = press(away, "z").spun(0.1).spun(0.1)
    np.testing.assert_allclose(eye(halves), eye(press(away, "z").spun(0.2)), atol=1e-9)
    held = hold(press(away, "z").spun(0.1), 0.01, "left")
    assert not held.going


def test_approaching_puts_a_point_in_the_middle():
    """Half as far away as it was, seen in the same direction."""
    point = np.array([1.0, -0.5, 0.7])
    before = VIEW.camera((300, 300), (1.0, 1.0))
    view = arrived(VIEW.approaching(point))
    np.testing.assert_allclose(seen(view, point), (150, 150), atol=1e-6)
    after = view.camera((300, 300), (1.0, 1.0))
    np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-9)
    depth = (before.rotation @ (point - before.centre))[2]
    assert math.isclose((after.rotation @ (point - after.centre))[2], depth / 2)


def test_a_files_camera_is_shown_as_it_is():
    """Tilted as it stands there; the first move goes on from it, upright."""
    tilted = look_at((1, -2, -6), (0, 0, 0), (0.3, -1, 0), 35, 64, 48)
    view = VIEW.at(tilted)
    assert view.camera((64, 48), (1.0, 1.0)).same(tilted)
    assert view.moves_from(VIEW)
    moved = hold(view, 1e-9, "w")
    np.testing.assert_allclose(eye(moved), tilted.centre, atol=1e-6)
    np.testing.assert_allclose(seen(moved), seen(view), atol=1e-3)
    assert math.isclose(moved.fov, 35)


def test_the_next_axis_up():
    """Shift+U goes through all six; each stands upright in the picture."""
    view, axes = VIEW, []
    for _ in range(6):
        view = press(view, "U")
        axes.append(tuple(view.home.up))
        up = view.home.up
        top = seen(replace(view, orbit=replace(view.orbit, pitch=0.0)), up)
        assert top[1] < 149
        assert abs(top[0] - 150) < 1e-6
    assert len(set(axes)) == 6
    assert np.array_equal(view.home.up, HOME.up)


def test_what_is_seen_changes():
    """T, Y, B and X change the look and come back to it."""
    for key, times in (("t", 2), ("y", 2), ("x", 2), ("b", 3)):
        once = press(VIEW, key)
        assert once.look != VIEW.look
        assert once.moves_from(VIEW)
        assert press(VIEW, *[key] * times).look == VIEW.look


def test_a_crop_holds_what_is_looked_at():
    """The box is about the target, smaller than what is seen."""
    crop = press(VIEW, "x").look.edits.crop
    assert (np.array(crop.low) < HOME.target).all()
    assert (np.array(crop.high) > HOME.target).all()
    assert max(crop.high) < HOME.distance


def test_u_turns_the_scene_upside_up_and_z_keeps_it():
    """The world's up is the other way round, seen from above again; Z goes back to that."""
    flipped = press(VIEW, "u")
    above, below = seen(flipped, (0, 1, 0)), seen(flipped, (0, -1, 0))
    assert above[1] < 150 < below[1]
    assert flipped.camera((9, 9), (1.0, 1.0)).centre[1] > 0
    assert arrived(press(hold(flipped, 0.2, "w", "j", "+"), "z")).orbit is flipped.home
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
    """An unknown key, a drag without a press, a key let go or repeated: nothing is redrawn."""
    assert press(VIEW, "f5") is VIEW
    assert VIEW.moved({"f5": 1.0, "p": 1.0}) is VIEW
    assert not mouse(VIEW, "drag", x=3, y=3).moves_from(VIEW)
    assert not mouse(VIEW, "release").moves_from(VIEW)
    assert VIEW.spun(1.0) is VIEW
    for action in ("release", "repeat"):
        assert VIEW.after(Event("key", key="u", action=action), TERMINAL) is VIEW


def test_every_key_is_in_the_help():
    """The help page names each letter that does something."""
    named = HELP.replace("arrows", "left right up down").lower().split()
    words = {" ": "space", "escape": "esc"}
    for key in (*KEYS, *MOTIONS):
        if key not in ("=", "_", "ctrl+c", "home"):
            assert words.get(key, key.lower()) in named, key


def test_wishes_are_left_for_the_viewer():
    """Keys that need more than the view say what they want, and change nothing else."""
    for key, wish in (("p", "picture"), ("v", "record"), ("c", "under"), ("e", "everything"),
                      ("n", "next camera"), ("N", "camera before"), ("m", "next presenter"),
                      ("G", "backend before")):  # fmt: skip
        wishing = press(VIEW, key)
        assert wishing.wish == wish
        assert not wishing.moves_from(VIEW)


def test_escape_closes_the_panel_first():
    """Then it quits; Q always does."""
    shown = press(VIEW, "tab")
    assert shown.settings
    assert not press(shown, "escape").quit
    assert not press(shown, "escape").settings
    assert press(shown, "escape", "escape").quit
    assert press(shown, "q").quit


def test_words_fit_the_screen():
    """Lines are cut to the width; wide characters take two cells; controls are made harmless."""
    assert fitted("日本語", 5) == "日本"
    assert "\x1b" not in fitted("a\x1b[2J", 20)
    line = status_line(["x" * 500], Terminal(columns=20, rows=5))
    assert line.count(b"x") == 19
    line = status_line(["first", "second", "third one"], Terminal(columns=20, rows=5))
    assert b"first  second\x1b" in line  # parts are whole or not there
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


@pytest.mark.parametrize("key", ["x", "f9", "o", " ", "z"])
def test_a_key_stops_where_it_is(key):
    """The same picture, from an orbit about what is in the middle."""
    view = VIEW.playing(PATH).spun(1.5)
    stopped = press(view, key)
    assert stopped.path is None
    assert not stopped.spinning
    for point in ((0, 0, 0), (1, 0.5, 0), (0, 2, 1)):
        np.testing.assert_allclose(seen(stopped, point), seen(view, point), atol=1.5)  # it levels
    assert abs(seen(VIEW, (1, 0.5, 0)) - seen(view, (1, 0.5, 0))).max() > 10
    assert arrived(press(stopped, "z")).orbit is HOME


def test_moving_stops_it_and_looking_at_something_else_does_not():
    """Keys that move go on from where it is; the help, the panel and the status line leave it."""
    view = VIEW.playing(PATH).spun(1.5)
    assert hold(view, 0.1, "left").path is None
    for key in ("?", "tab", "i", "p", "m"):
        assert press(view, key).path is PATH
    assert press(view, "q").quit


def test_a_click_or_the_wheel_stops_it_and_the_mouse_alone_does_not():
    """What the hand does on purpose."""
    view = VIEW.playing(PATH).spun(1.5)
    assert mouse(view, "press").path is None
    assert mouse(view, "wheel", "up").path is None
    assert mouse(view, "move").path is PATH


@pytest.mark.parametrize(("yaw", "pitch"), [(0.3, 0.2), (2.0, -0.7), (-3.0, 1.2), (1.0, 1.57)])
def test_orbit_of_is_the_inverse_of_an_orbits_camera(yaw, pitch):
    """An upright camera that looks at the target is on the orbit it was made by."""
    home = replace(HOME, target=np.array([1.0, 2, 3]), up=np.array([0.1, -1, 0.2]))
    orbit = replace(home, yaw=yaw, pitch=pitch)
    camera = orbit.camera(50, 64, 48)
    got = orbit_of(camera, home)
    np.testing.assert_allclose(got.camera(50, 64, 48).viewmat, camera.viewmat, atol=1e-9)
    assert math.isclose(got.distance, orbit.distance)
