"""The scene and the plan for a look, and what is under the cursor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.conftest import gaussians
from tests.viewer.rules import VIEW
from tsplat.core.camera import Camera
from tsplat.core.errors import PluginError
from tsplat.core.params import PRESETS
from tsplat.edits import NOTHING, Edits
from tsplat.plan import make_plan
from tsplat.presenters.base import Terminal
from tsplat.presenters.halfblock import HALFBLOCK
from tsplat.viewer import engine as module
from tsplat.viewer.controls import pointed
from tsplat.viewer.engine import Engine, Prepared
from tsplat.viewer.look import Look
from tsplat.viewer.pick import WINDOW, point_under

SCENE = gaussians([(0, 0, 0), (0.5, 0.2, 1), (0, 1, 0)], scales=0.4, opacities=[0.9, 0.5, 0.1])
NUMPY = Look(backend="numpy")


def made(look=NUMPY):
    return Engine(SCENE, make_plan(SCENE, backend="numpy"), look)


@pytest.fixture
def planned(monkeypatch):
    """What plans were made of: scenes and keywords."""
    calls = []

    def plan(scene, **words):
        calls.append((scene, words))
        return make_plan(scene, **words)

    monkeypatch.setattr(module, "make_plan", plan)
    return calls


def test_the_first_look_is_drawn_as_planned(planned):
    """By the plan that was given, of the scene itself."""
    engine = made()
    prepared = engine.prepared(NUMPY)
    assert prepared.scene is SCENE
    assert prepared is engine.prepared_last
    assert engine.backends == "numpy"
    assert not planned


def test_what_cannot_be_had_is_told_and_passed_over():
    """The last look's scene and plan draw on; a look that can be had ends the trouble."""
    engine = made()
    good = engine.prepared(replace(NUMPY, params=PRESETS["fast"]))
    for backend in ("none-such", "project=none-such", "numpy=numpy", ""):
        bad = engine.prepared(replace(NUMPY, backend=backend))
        assert (bad.plan, bad.scene, bad.look) == (good.plan, good.scene, good.look)
        assert bad.trouble
        assert bad.trouble.isprintable()
    assert "none-such" in engine.prepared(replace(NUMPY, backend="none-such")).trouble
    assert engine.prepared(replace(NUMPY, params=PRESETS["fast"])).trouble == ""
    after = engine.prepared(NUMPY)
    assert after.trouble == ""
    assert after.plan.asked == NUMPY.params


def test_a_scene_too_large_to_be_edited_is_passed_over(monkeypatch):
    """Out of memory: told, and what was there is drawn on."""

    def none_left(scene, edits):
        raise MemoryError

    engine = made()
    monkeypatch.setattr(module, "edited", none_left)
    got = engine.prepared(replace(NUMPY, edits=Edits(saturation=0.5)))
    assert got.trouble == "out of memory"
    assert got.scene is SCENE


def test_edits_are_made_to_the_scene_as_it_was():
    """Not on top of each other; none gives back the very scene."""
    engine = made()
    for scale in (2.0, 3.0, 1.5):
        scene = engine.prepared(replace(NUMPY, edits=Edits(splat_scale=scale))).scene
        np.testing.assert_array_equal(scene.scales, SCENE.scales * np.float32(scale))
        assert scene.sh is SCENE.sh
    cut = engine.prepared(replace(NUMPY, edits=Edits(min_opacity=0.4))).scene
    assert (cut.opacities > 0).tolist() == [True, True, False]
    np.testing.assert_array_equal(cut.scales, SCENE.scales)
    assert engine.prepared(replace(NUMPY, edits=NOTHING)).scene is SCENE
    assert engine.scene is SCENE


def test_a_scene_that_begins_edited_can_be_had_unedited():
    """--min-opacity and then none."""
    look = replace(NUMPY, edits=Edits(min_opacity=0.4))
    engine = made(look)
    assert (engine.prepared(look).scene.opacities > 0).sum() == 2
    assert engine.prepared(NUMPY).scene is SCENE


def test_the_same_look_is_not_planned_again(planned):
    """Nor one that differs in what no plan depends on, nor one that could not be had before."""
    engine = made()
    engine.prepared(NUMPY)
    for change in ({"background": (1.0, 0.0, 0.0)}, {"presenter": "sixel"}, {"fps": 5.0},
                   {"move_speed": 2.0}, {"max_rate": 1e6}, {"picture": (64, 48)}):  # fmt: skip
        engine.prepared(replace(NUMPY, **change))
    assert not planned
    for _ in range(3):
        engine.prepared(replace(NUMPY, threads=3))
    assert len(planned) == 1
    bad = replace(NUMPY, backend="none-such")
    troubles = {engine.prepared(bad).trouble for _ in range(3)}
    assert len(troubles) == 1
    assert len(planned) == 2


def test_the_same_edits_are_not_made_again():
    """Another setting of quality leaves the edited scene as it is."""
    engine = made()
    look = replace(NUMPY, edits=Edits(splat_scale=2.0))
    scene = engine.prepared(look).scene
    assert engine.prepared(replace(look, params=PRESETS["fast"])).scene is scene


def test_threads_have_workspaces_of_their_number():
    """A plan of other threads gets another workspace."""
    engine = made()
    for threads in (1, 3, 2):
        plan = engine.prepared(replace(NUMPY, threads=threads)).plan
        assert engine.workspace.threads == plan.threads == threads


def test_a_backend_that_does_not_load_is_passed_over(monkeypatch):
    """Its failure is told."""
    engine = made()

    def broken(scene, **words):
        raise PluginError("backend 'x' failed to load: ImportError: \x1b[2J no such thing")

    monkeypatch.setattr(module, "make_plan", broken)
    got = engine.prepared(replace(NUMPY, backend="x"))
    assert "failed to load" in got.trouble
    assert got.trouble.isprintable()
    assert got.plan is engine.prepared_last.plan


def failing(error):
    """Makes plans whose projection raises."""

    def project(*arguments):
        raise error

    def plan(scene, **words):
        made = make_plan(scene, **{**words, "backend": "numpy"})
        return replace(made, stages=replace(made.stages, project=project), fused=None)

    return plan


@pytest.mark.parametrize("error", [ZeroDivisionError("by \x1b zero"), MemoryError(),
                                   PluginError("lost")])  # fmt: skip
def test_a_backend_that_fails_while_it_draws_is_passed_over(monkeypatch, error):
    """The last look that was drawn is drawn on, and why is told; it is not tried for each frame."""
    engine, camera = made(), lens()
    right = engine.run(NUMPY, camera)[1].frame.rgb.copy()
    monkeypatch.setattr(module, "make_plan", failing(error))
    bad = replace(NUMPY, backend="x", threads=2)
    for _ in range(2):
        prepared, rendered = engine.run(bad, camera)
        np.testing.assert_array_equal(rendered.frame.rgb, right)
        assert prepared.trouble.startswith("numpy failed: ")
        assert prepared.trouble.isprintable()
        assert prepared.look == NUMPY
    monkeypatch.setattr(module, "make_plan", make_plan)
    prepared, _ = engine.run(replace(NUMPY, threads=3), camera)
    assert prepared.trouble == ""
    assert prepared.plan.threads == 3


def test_the_first_picture_that_fails_is_an_error():
    """There is nothing to fall back on; nor where what drew all the time fails."""
    plan = failing(ZeroDivisionError("by zero"))(SCENE)
    with pytest.raises(ZeroDivisionError):
        Engine(SCENE, plan, NUMPY).run(NUMPY, lens())


# --- what is under the cursor


def prepare(scene, backend="numpy", **words):
    return Prepared(scene, make_plan(scene, backend=backend, **words), Look())


def lens(cx=50.0, cy=40.0, focal=100.0):
    K = np.array([[focal, 0, cx], [0, 0.8 * focal, cy], [0, 0, 1.0]])
    return Camera(np.eye(4), K, 100, 80)


def pixel_of(camera, point):
    p = camera.rotation @ (np.asarray(point) - camera.centre)
    x, y, _ = camera.K @ p / p[2]
    return float(x), float(y)


@pytest.mark.parametrize("backend", ["numpy", "cffi"])
def test_the_depth_of_one_splat_is_its_centres(backend):
    """Wherever it is hit: a splat is flat in depth. The point is on the ray of the pixel."""
    mean = np.array([0.3, -0.2, 4.0])
    prepared = prepare(gaussians(mean, scales=0.3, opacities=0.99), backend)
    camera = lens()
    x, y = pixel_of(camera, mean)
    for dx, dy in ((0, 0), (5, -3), (-8.3, 4.6)):
        point = point_under(prepared, camera, x + dx, y + dy)
        # the depth is a sum of alpha z in float32, over 1 - transmittance, which cancels
        assert abs(point[2] - 4.0) < 4e-6 * 4
        np.testing.assert_allclose(pixel_of(camera, point), (x + dx, y + dy), atol=1e-9)


def test_nothing_is_under_an_empty_pixel():
    """None, farther from the splat than the window; and where what is drawn is next to nothing."""
    prepared = prepare(gaussians((0, 0, 4), scales=0.02, opacities=0.99))
    camera = lens()
    assert point_under(prepared, camera, 50, 40) is not None
    for x, y in ((50 + WINDOW, 40), (50, 40 - WINDOW), (0, 0), (-900, 40), (50, 1e6)):
        assert point_under(prepared, camera, x, y) is None
    faint = prepare(gaussians((0, 0, 4), scales=0.2, opacities=0.04))
    assert point_under(faint, camera, 50, 40) is None


def test_a_near_miss_finds_the_nearest():
    """A splat a few pixels off is found, at its own place and not under the pixel."""
    camera = lens()
    prepared = prepare(gaussians((0, 0, 4), scales=0.005, opacities=0.99))
    point = point_under(prepared, camera, 54, 38)
    x, y = pixel_of(camera, point)
    assert abs(x - 50) < 2.5
    assert abs(y - 40) < 2.5
    assert abs(point[2] - 4) < 1e-4


@given(st.floats(0.2, 0.95), st.floats(0.2, 0.95), st.floats(1.5, 30.0))
def test_of_two_splats_depths_are_weighted_as_drawn(front, back, depth):
    """Through the middle of both: o1 z1 + (1 - o1) o2 z2, over o1 + (1 - o1) o2."""
    ray = np.array([0.05, -0.1, 1.0])
    scene = gaussians([depth * ray, 1.0 * ray], scales=0.05, opacities=[back, front])
    camera = lens()
    point = point_under(prepare(scene), camera, *pixel_of(camera, ray))
    o1, o2 = scene.opacities[1], scene.opacities[0]
    weights = np.array([o1, (1 - o1) * o2], np.float64)
    assert np.isclose(point[2], weights @ (1.0, depth) / weights.sum(), rtol=1e-5)


@given(st.floats(-300, 400), st.floats(-300, 400), st.floats(20, 400))
def test_any_principal_point(cx, cy, focal):
    """Off the middle and outside the picture: the point found is on the splat."""
    camera = lens(cx, cy, focal)
    mean = np.array([(30.0 - cx) / focal, (45.0 - cy) / (0.8 * focal), 1.0]) * 3
    prepared = prepare(gaussians(mean, scales=6 / focal, opacities=0.99))
    assume(np.abs(mean[:2] / 3).max() < 1.2)  # the footprint of what is farther off is bounded
    point = point_under(prepared, camera, 30.0, 45.0)
    np.testing.assert_allclose(point, mean, atol=2e-5 * np.abs(mean).max())


def test_settings_of_quality_do_not_move_it():
    """Fewer pixels, another threshold: the pixel that is asked for is the same."""
    mean = np.array([0.3, -0.2, 4.0])
    camera = lens()
    x, y = pixel_of(camera, mean)
    for params in (PRESETS["fast"], replace(PRESETS["contract"], scale=0.25, sh_degree=0)):
        scene = gaussians([mean] * 8, scales=0.3, opacities=0.6)
        point = point_under(prepare(scene, params=params), camera, x, y)
        np.testing.assert_allclose(point, mean, atol=1e-4)


@pytest.mark.parametrize("pixel_mouse", [False, True])
def test_the_cell_of_a_splat_finds_it(pixel_mouse):
    """As half blocks show it, two to a cell: the middle of the cell where it is seen hits it."""
    terminal = Terminal(columns=60, rows=21, cell_width=9, cell_height=19,
                        pixel_mouse=pixel_mouse)  # fmt: skip
    mean = np.array([0.4, -0.7, 0.3])
    scene = gaussians(mean, scales=0.05, opacities=0.99)
    shown = VIEW.camera(HALFBLOCK.size(terminal), HALFBLOCK.pixel(terminal))
    frame = prepare(scene).plan.run(scene, shown).frame
    row, column = np.unravel_index(frame.transmittance.argmin(), frame.transmittance.shape)
    x, y = int(column), int(row) // 2
    if pixel_mouse:
        x, y = x + 0.5, y + 0.25 + 0.5 * (row % 2)
    camera = VIEW.camera(terminal.pixels, (1.0, 1.0))
    point = point_under(prepare(scene), camera, *pointed(x, y, terminal))
    np.testing.assert_allclose(point, mean, atol=0.12)
    depth = (camera.rotation @ (point - camera.centre))[2]
    assert np.isclose(depth, (camera.rotation @ (mean - camera.centre))[2], rtol=1e-5)
