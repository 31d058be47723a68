"""--max-error: the settings it picks hold, also where they were not measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tsplat.core.camera import look_at
from tsplat.core.errors import ParamsError
from tsplat.core.params import PRESETS, RenderParams
from tsplat.io import load_scene
from tsplat.paths import turned
from tsplat.plan import make_plan
from tsplat.quality.calibrate import MARGIN, TURNS, Bound, calibrate, parse_bound
from tsplat.quality.measure import measure
from tsplat.quality.sweep import ideal_frame
from tsplat.testing.strategies import make_scene
from tsplat.views import frame_orbit

SCENE = make_scene(21, 1500, 2, frozenset({"opaque"}))
CAMERA = look_at((1, -1, -5), (0, 0, 0), (0, -1, 0), 50, 60, 45)
UP = -CAMERA.rotation[1]


def plan_of(params):
    """By the C kernel."""
    return make_plan(SCENE, backend="cffi", threads=1, params=params)


@pytest.mark.parametrize("levels", [0.2, 1.0, 8.0])
def test_what_is_picked_holds_against_the_ideal_elsewhere(levels):
    """On cameras between those that were tried, against float64."""
    found = calibrate(SCENE, CAMERA, Bound(levels, levels), plan_of, RenderParams())
    for angle in (0.6, 3.0):
        camera = turned(CAMERA, np.zeros(3), UP, angle)
        got = plan_of(found.picked.params).run(SCENE, camera).frame
        assert measure(got, ideal_frame(SCENE, camera)).worst <= levels
    assert found.picked.error.worst <= MARGIN * levels
    assert found.picked.seconds <= min(t.seconds for t in found.tried if t.holds)


def test_a_looser_bound_allows_more():
    """At a whole picture's error anything goes; at next to none only what is near exact."""

    def shortcuts(levels):
        bound = Bound(levels, levels)
        tried = calibrate(SCENE, CAMERA, bound, plan_of, RenderParams()).tried
        return {t.params for t in tried if t.holds}

    tight, loose = shortcuts(0.01), shortcuts(1000.0)
    assert tight < loose
    assert tight == {PRESETS["exact"]}
    assert RenderParams() in loose


def test_what_is_no_knob_stays():
    """Antialiasing and depth are kept in all that is tried."""
    base = RenderParams(antialias=True, depth=True)
    found = calibrate(SCENE, CAMERA, Bound(4, 4), plan_of, base)
    assert all(t.params.antialias and t.params.depth for t in found.tried)


def test_colours_in_float16_count():
    """What they may be off by is part of the error; if that is too much, it is said so."""
    rough = replace(SCENE, sh_error=0.2 / 255)

    def plan(params):
        return make_plan(rough, backend="cffi", threads=1, params=params)

    assert calibrate(rough, CAMERA, Bound(4, 4), plan, RenderParams()).picked.error.worst >= 0.2
    with pytest.raises(ParamsError, match=r"0\.2 levels off.*--sh-float32"):
        calibrate(rough, CAMERA, Bound(0.1, 0.1), plan, RenderParams())


@pytest.mark.parametrize("angle", TURNS)
def test_turned_cameras_look_at_the_same_point(angle):
    """The middle stays where it is in the picture, and as far away."""
    centre = np.array([0.3, 0.2, 0.1])
    camera = turned(CAMERA, centre, UP, angle)
    before = CAMERA.viewmat @ [*centre, 1]
    np.testing.assert_allclose(camera.viewmat @ [*centre, 1], before, atol=1e-12)
    if angle:
        assert not camera.same(CAMERA)


def test_bounds_are_read():
    """One number for both, or two."""
    assert parse_bound("1") == Bound(1, 1)
    assert parse_bound("0.5,4") == Bound(0.5, 4)
    for text in ("", "0", "-1", "nan", "4,1", "1,2,3", "one"):
        with pytest.raises(ParamsError, match="expected E or P999,WORST"):
            parse_bound(text)


@pytest.mark.parametrize(
    "name", ["leica-8k-sh3/leica-8k-sh3.gf.ply", "plant-114k-sh0/plant-114k-sh0.st.ply"]
)
def test_one_level_holds_on_real_scenes(name, data):
    """--max-error 1, calibrated in front, seen from elsewhere, against float64 and float32 SH."""
    path = data / "formats" / name
    scene = load_scene(path, max_splats=30_000)
    exact = load_scene(path, max_splats=30_000, sh_float32=True)
    orbit = frame_orbit(scene, 96, 54)

    def plan(params):
        return make_plan(scene, threads=2, params=params)

    found = calibrate(scene, orbit.camera(50, 96, 54), Bound(1, 1), plan, RenderParams())
    other = replace(orbit, yaw=orbit.yaw + 1, pitch=orbit.pitch + 0.3).camera(50, 96, 54)
    got = plan(found.picked.params).run(scene, other).frame
    assert measure(got, ideal_frame(exact, other)).worst <= 1
