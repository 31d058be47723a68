"""Every row of the panel does what its name says, and nothing else."""

from __future__ import annotations

import math

import pytest

from tests.viewer.rules import FACTS, VIEW, changed, flat
from tsplat.core.params import KNOBS, PRESETS
from tsplat.viewer import settings
from tsplat.viewer.settings import Facts, sections
from tsplat.viewer.text import width

KNOBS_CHANGED = {f"look.params.{knob}" for knob in KNOBS}
CHANGES = {
    "fly": {"flying"},
    "turn by itself": {"spinning"},
    "field of view": {"fov"},
    "up": {"orbit.up", "home.up"},
    "move speed": {"look.move_speed"},
    "turn speed": {"look.turn_speed"},
    "zoom speed": {"look.zoom_speed"},
    "quality": KNOBS_CHANGED,
    "SH degree": {"look.params.sh_degree"},
    "antialias": {"look.params.antialias"},
    "pixel density": {"look.params.scale"},
    "share of splats": {"look.params.share"},
    "alpha threshold": {"look.params.alpha_threshold"},
    "stop at": {"look.params.transmittance_min"},
    "depth bits": {"look.params.depth_bits"},
    "low-pass filter": {"look.params.low_pass"},
    "splat scale": {"look.edits.splat_scale"},
    "opacity cut": {"look.edits.min_opacity"},
    "raw opacity": {"look.edits.raw_opacity"},
    "saturation": {"look.edits.saturation"},
    "background": {"look.background"},
    "crop": {"look.edits.crop", "look.edits.crop.low", "look.edits.crop.high"},
    "  x from": {"look.edits.crop.low"},
    "  x to": {"look.edits.crop.high"},
    "  y from": {"look.edits.crop.low"},
    "  y to": {"look.edits.crop.high"},
    "  z from": {"look.edits.crop.low"},
    "  z to": {"look.edits.crop.high"},
    "presenter": {"look.presenter"},
    "backend": {"look.backend"},
    "threads": {"look.threads"},
    "frames a second": {"look.fps"},
    "link at most": {"look.max_rate"},
    "kept pictures": {"look.picture"},
}
"""Row -> the values of a view that it may change."""


@pytest.fixture(autouse=True)
def _four_cpus(monkeypatch):
    """So that threads are a choice on any machine."""
    monkeypatch.setattr(settings, "default_threads", lambda: 4)


def rows_of(view):
    """Name -> row, of those that can be set."""
    return {row.name: row for _, rows in sections(view, FACTS) for row in rows if row.step}


CROPPED = VIEW.cropped()


def walked(row, view):
    """The views that steps lead through, from the least value upwards."""
    for _ in range(60):
        lower = row.step(view, -1, FACTS)
        if not changed(lower, view):
            break
        view = lower
    views = [view]
    for _ in range(60):
        views.append(row.step(views[-1], 1, FACTS))
        if not changed(views[-1], views[-2]):
            return views[:-1]
    return views


def same(a, b):
    """Whether two views are, to the last digits of their numbers."""
    x, y = flat(a), flat(b)
    return x.keys() == y.keys() and all(_close(x[name], y[name]) for name in x)


def _close(a, b):
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(_close, a, b))
    number = isinstance(a, float | int) and isinstance(b, float | int)
    return math.isclose(a, b, rel_tol=1e-12, abs_tol=1e-12) if number else a == b


def test_the_table_here_has_every_row():
    """None can be set that is not looked at below."""
    assert list(rows_of(CROPPED)) == list(CHANGES)


@pytest.mark.parametrize("name", CHANGES)
def test_a_row_changes_what_it_says_and_nothing_else(name):
    """At every value that steps lead to, one of both steps does something."""
    row = rows_of(CROPPED)[name]
    start = VIEW if name == "crop" else CROPPED
    for view in walked(row, start):
        both = [changed(view, row.step(view, by, FACTS)) for by in (-1, 1)]
        assert any(both)
        for names in both:
            assert names <= CHANGES[name]


@pytest.mark.parametrize("name", CHANGES)
def test_a_step_back_undoes_a_step(name):
    """But at an end, where a step does nothing; and the words say so."""
    row = rows_of(CROPPED)[name]
    views = walked(row, CROPPED)
    assert len(views) > 1
    for view in views:
        further = row.step(view, 1, FACTS)
        if changed(view, further):
            back = row.step(further, -1, FACTS)
            assert same(back, view)
            assert row.text(further, FACTS) != row.text(view, FACTS)
            assert row.text(back, FACTS) == row.text(view, FACTS)


@pytest.mark.parametrize("name", CHANGES)
def test_backspace_gives_what_one_starts_with(name):
    """From wherever steps have led."""
    row = rows_of(CROPPED)[name]
    if row.first is None:
        assert name == "up" or name == "crop" or name.startswith("  ")
        return
    for view in walked(row, VIEW)[:9]:
        assert same(row.first(view), VIEW)


def test_words_fit_the_panel():
    """Every value that steps lead to is seen whole, beside its name and its marks."""
    for name, row in rows_of(CROPPED).items():
        assert width(name) <= 17
        for view in walked(row, CROPPED):
            assert width(row.text(view, FACTS)) <= 18, row.text(view, FACTS)


def test_what_one_looks_for_is_there():
    """What a picture costs and shows, where the camera is, what the terminal can do."""
    wanted = (
        "share of splats", "raw opacity", "presenter", "pixel density", "threads",
        "field of view", "move speed", "turn speed", "zoom speed", "low-pass filter",
        "alpha threshold", "  reach in sigmas", "saturation",
    )  # fmt: skip
    names = [row.name for _, rows in sections(VIEW, FACTS) for row in rows]
    assert set(wanted) <= set(names)


def test_quality_has_the_presets():
    """All of them, by their names; a knob turned by hand is one's own."""
    row = rows_of(VIEW)["quality"]
    assert {row.text(view, FACTS) for view in walked(row, VIEW)} == set(PRESETS)
    own = rows_of(VIEW)["depth bits"].step(VIEW, -1, FACTS)
    assert row.text(own, FACTS) == "your own"
    assert row.text(row.step(own, 1, FACTS), FACTS) in PRESETS


def test_a_value_of_the_command_line_is_among_the_others():
    """Steps go to its neighbours, and it is not lost while one only looks."""
    rate = rows_of(VIEW)["link at most"]
    view = VIEW.looking(max_rate=3e6)
    assert rate.text(view, FACTS) == "3 Mbit/s"
    assert rate.step(view, 1, FACTS).look.max_rate == 5e6
    assert rate.step(view, -1, FACTS).look.max_rate == 2e6
    threshold = rows_of(VIEW)["alpha threshold"]
    view = VIEW.shading(alpha_threshold=3 / 255)
    assert threshold.step(view, 1, FACTS).look.params.alpha_threshold == 4 / 255
    assert threshold.step(view, -1, FACTS).look.params.alpha_threshold == 2 / 255
    speed = rows_of(VIEW)["move speed"]
    assert speed.step(VIEW.looking(move_speed=1.1), 1, FACTS).look.move_speed > 1.1


def test_reach_is_where_alpha_falls_to_the_threshold():
    """exp(-s^2 / 2) of what is told is the threshold; for 0 there is a floor."""
    row = next(r for _, rows in sections(VIEW, FACTS) for r in rows if "reach" in r.name)
    assert row.step is None
    for threshold in (1 / 255, 16 / 255):
        told = float(row.text(VIEW.shading(alpha_threshold=threshold), FACTS).split()[0])
        assert math.isclose(math.exp(-told * told / 2), threshold, rel_tol=0.02)
    assert math.isfinite(float(row.text(VIEW.shading(alpha_threshold=0.0), FACTS).split()[0]))


def test_auto_says_what_it_took():
    """And the presenters that are offered are those that this terminal can show."""
    row = rows_of(VIEW)["presenter"]
    assert row.text(VIEW, FACTS) == "auto: kitty"
    names, view = [], VIEW
    for _ in range(3):
        names.append(view.look.presenter)
        view = row.step(view, 1, FACTS)
    assert names == ["auto", "kitty", "sixel"]
    assert view.look.presenter == "auto"


def test_the_box_is_there_while_there_is_one():
    """Its sides move one at a time and never pass each other."""
    assert "  x from" not in rows_of(VIEW)
    rows, view = rows_of(CROPPED), CROPPED
    for _ in range(400):
        view = rows["  x from"].step(view, 1, FACTS)
    crop = view.look.edits.crop
    assert crop.low[0] == crop.high[0]
    assert crop.low[1:] == CROPPED.look.edits.crop.low[1:]


def test_opacities_that_were_read_raw_are_not_taken_back_twice():
    """There is no row for it then: the file is read so already."""
    names = [[row.name for _, rows in sections(VIEW, Facts(read_raw=raw)) for row in rows]
             for raw in (False, True)]  # fmt: skip
    assert set(names[0]) - set(names[1]) == {"raw opacity"}
