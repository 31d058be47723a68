"""What tsplat bench measures: rows of time and error, and which of them are worth having."""

from __future__ import annotations

import numpy as np
import pytest

from tests.conftest import gaussians
from tsplat.core.camera import look_at
from tsplat.core.errors import TsplatError
from tsplat.core.params import PRESETS, RenderParams
from tsplat.quality import diagram
from tsplat.quality.measure import Error
from tsplat.quality.sweep import Row, make_sweep, mark_optimal, settings
from tsplat.testing.strategies import make_scene

SCENE = make_scene(11, 400, 2, frozenset({"needles", "opaque"}))
CAMERAS = [look_at((x, -1, -5), (0, 0, 0), (0, -1, 0), 50, 40, 30) for x in (0, 2)]


def row(time, error, backend="b", setting="s"):
    """A row that was measured."""
    made = Row(backend, setting, RenderParams(), None)
    made.errors = [Error(error, error, 50.0, 0.9)]
    made.runs = [[{"project": time / 2, "total": time}, {"project": time, "total": 2 * time}]]
    return made


def test_a_row_says_least_and_median_over_cameras():
    """Least and median of each camera's runs, then the mean; the worst error."""
    made = row(2.0, 1.0)
    made.errors.append(Error(7.0, 3.0, 40.0, 0.7))
    made.runs.append([{"project": 1, "total": 6.0}] * 2)
    assert made.seconds() == (4.0, 4.5)
    assert made.seconds("project") == (1.0, 1.25)
    assert made.error.p999 == 3.0
    assert made.stages == ("project",)


def test_what_nothing_beats_is_optimal():
    """Slower and worse than another is not; equal rows both are."""
    fast, exact, bad, between, same = (
        row(1, 9), row(9, 1), row(9, 9), row(4, 4), row(4, 4)
    )  # fmt: skip
    mark_optimal([fast, exact, bad, between, same])
    assert [r.optimal for r in (fast, exact, bad, between, same)] == [True, True, False, True, True]


def test_settings_are_those_that_apply():
    """A scene of degree 1 has no degree 1 or 2 to leave out; one's own settings come last."""
    found = settings(make_scene(1, 3, 1, frozenset()), ["scale=0.3"])
    assert "sh_degree=0" in found
    assert "sh_degree=1" not in found
    assert list(found)[: len(PRESETS)] == list(PRESETS)
    assert found["scale=0.3"] == RenderParams(scale=0.3)


@pytest.fixture(scope="module")
def measured():
    """Every row of two backends."""
    wanted = {name: PRESETS[name] for name in ("exact", "contract", "fast")}
    sweep = make_sweep(SCENE, CAMERAS, ["cffi", "numba"], wanted, threads=1, runs=2)
    assert sum(1 for _ in sweep.steps()) == len(sweep)
    return list(sweep.rows)


def test_every_row_is_measured_on_every_camera(measured):
    """Errors are in the order that the presets promise, and alike in both backends."""
    assert all(r.done for r in measured)
    error = {(r.backend, r.setting): r.error for r in measured}
    for backend in ("cffi", "numba"):
        exact, contract, fast = (
            error[backend, s].worst for s in ("exact", "contract", "fast")
        )  # fmt: skip
        assert exact < 0.05 < contract < fast
    assert error["cffi", "contract"].worst == pytest.approx(
        error["numba", "contract"].worst, rel=0.01
    )


def test_an_interrupted_sweep_keeps_what_is_done():
    """After some steps, rows that lack a camera or a time are known for that."""
    sweep = make_sweep(SCENE, CAMERAS, ["cffi"], {"contract": PRESETS["contract"]}, 1, 1)
    steps = sweep.steps()
    for _ in range(4):  # the ideal picture and the error, of both cameras
        assert not any(r.done for r in sweep.rows)
        next(steps)
    next(steps)
    assert all(r.done for r in sweep.rows)


def test_the_diagram_shows_every_row(measured):
    """An SVG names the backends; a frame of any size is not blank."""
    mark_optimal(measured)
    svg = diagram.draw(measured, "a title", ".svg").decode()
    for word in ("a title", "cffi", "numba", "exact", "error, 8-bit levels"):
        assert f"<!-- {word}" in svg, word
    frame = diagram.picture(measured, "a title", 320, 200)
    assert frame.rgb.shape == (200, 320, 3)
    assert np.ptp(frame.rgb) > 0.5
    assert diagram.draw(measured, "a title", ".png").startswith(b"\x89PNG")


def test_without_matplotlib_there_is_a_sentence(measured, monkeypatch):
    """It says what to install."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(TsplatError, match=r'pip install "tsplat\[bench\]"'):
        diagram.draw(measured, "", ".png")


def test_an_empty_scene_can_be_measured():
    """No Gaussians, no error."""
    sweep = make_sweep(gaussians(np.zeros((0, 3))), CAMERAS[:1], ["cffi"], dict(PRESETS), 1, 1)
    list(sweep.steps())
    assert all(r.error.worst == 0 for r in sweep.rows)
