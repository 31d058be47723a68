"""The benchmark itself, on scenes that take no time: it counts right and times nobody who is wrong.

Not tested: how long anything takes.
"""

from __future__ import annotations

import importlib
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from rich.progress import Progress

import tsplat
from tests.conftest import ROOT, gaussians, straight
from tests.meta.wrong import WRONG
from tsplat.backends.cffi import isa


@pytest.fixture
def bench(monkeypatch):
    """Modules of bench/ by name, which import each other as scripts do."""
    monkeypatch.syspath_prepend(str(ROOT / "bench"))
    yield importlib.import_module
    isa.use_environment()  # contestants switch it


@pytest.fixture
def scene():
    """A few Gaussians in front of the camera of ``straight``."""
    rng = np.random.default_rng(0)
    means = rng.uniform([-0.5, -0.5, 4], [0.5, 0.5, 6], (40, 3))
    return gaussians(means, colors=rng.uniform(size=(40, 3)))


def race(bench, scene, entered, sizes=((48, 32),)):
    """Names that were timed, and what was said."""
    said = io.StringIO()
    with Progress(console=Console(file=said, width=400)) as progress:
        made = bench("frames").Bench(1, False, [1], progress)
        rows = list(made.rows_of(scene, straight, list(sizes), (1,), entered))
    return [row["backend"] for row in rows], said.getvalue()


def test_a_run_writes_all_figures(bench, tmp_path):
    """Times, work, floor and verdict of every contestant and picture are in the JSON."""
    out = tmp_path / "out.json"
    bench("frames").main(
        [
            "--scenes",
            "random:300",
            "stack:20",
            "--sizes",
            "64x48",
            "--runs",
            "2",
            "--json",
            str(out),
        ]
    )
    found = json.loads(out.read_text())
    names = bench("contestants").default()
    assert len(names) >= 2
    assert found["error"] is None
    rows = [row for row in found["rows"] if row["backend"] != "yardstick"]
    assert [row["backend"] for row in rows] == names * 4  # two scenes, one and two threads
    for row in rows:
        assert row["ms"]["total"] > 0
        assert row["ms_median"]["total"] >= row["ms"]["total"]
        assert row["runs"] == 2
        assert row["max_error"] < 1e-4
        assert row["verified"] == "float64 at 64x48"
        assert {"visible", "pairs", "evaluations", "read", "written"} == set(row["work"])
        assert row["work"]["evaluations"] > 0
        assert (row["floor_ms"] is None) == (not found["limits"])


@pytest.mark.parametrize("name", ["half a pixel off", "rough exp", "stop too early"])
def test_a_wrong_backend_is_not_timed(bench, scene, name):
    """It is named with its fault, and the others are timed."""
    entrants = bench("contestants")
    right = entrants.enter("numpy", scene)
    if name == "stop too early":
        scene = gaussians(np.c_[np.zeros((9, 2)), np.arange(4, 13)], scales=1, opacities=0.9)
    wrong = entrants.Contestant("bent", replace(right.plan, stages=WRONG[name][0]))
    timed, said = race(bench, scene, [wrong, right])
    assert "bent" not in timed
    assert "numpy" in timed
    assert "bent breaks the contract and is not timed" in said


@pytest.mark.parametrize("fault", [1e-6, 0.1, np.nan])
def test_a_fault_at_full_size_is_seen_without_a_reference(bench, scene, monkeypatch, fault):
    """A fused frame that is right on a small picture, and not the same as the stages on a large."""
    verify, entrants = bench("verify"), bench("contestants")
    monkeypatch.setattr(verify, "PAIRS_MAX", 0)
    monkeypatch.setattr(verify, "SMALLER", (24, 16))
    right = entrants.enter("cffi", scene)

    def fused(scene, camera, params, workspace, everything=False):
        frame, counts = right.plan.fused(scene, camera, params, workspace)
        off = np.float32(fault if camera.width > 24 else 0)
        return replace(frame, rgb=frame.rgb + off), counts

    wrong = entrants.Contestant("bent", replace(right.plan, fused=fused), right.isa)
    timed, said = race(bench, scene, [wrong, right])
    assert "bent" not in timed
    assert "the fused frame differs from the four stages" in said


def test_backends_must_agree_at_full_size(bench, scene, monkeypatch):
    """One that is wrong only on large pictures is caught by one that is not."""
    verify, entrants = bench("verify"), bench("contestants")
    monkeypatch.setattr(verify, "PAIRS_MAX", 0)
    monkeypatch.setattr(verify, "SMALLER", (24, 16))
    right = entrants.enter("numpy", scene)

    def composite(splats, bins, params, workspace):
        stages = right.plan.stages if splats.width == 24 else WRONG["rough exp"][0]
        return stages.composite(splats, bins, params, workspace)

    stages = replace(right.plan.stages, composite=composite)
    wrong = entrants.Contestant("bent", replace(right.plan, stages=stages))
    timed, said = race(bench, scene, [right, wrong])
    assert "bent" not in timed
    assert "differ from numpy's" in said


def test_work_is_what_cannot_be_left_out(bench):
    """A faint splat over all is evaluated once a pixel; what opaque ones hide is not."""
    measure = bench("work").measure
    camera = straight(40, 24)
    faint = gaussians([[0, 0, 5]], scales=50, opacities=0.5)
    assert measure(faint, camera).evaluations == 40 * 24
    near = np.c_[np.zeros((4, 2)), np.arange(5, 9)]
    opaque = gaussians(near, scales=50, opacities=0.99)
    few = measure(opaque, camera)
    hidden = np.c_[np.zeros((50, 2)), np.arange(20, 70)]
    many = measure(gaussians(np.r_[near, hidden], scales=50, opacities=0.99), camera)
    assert many.evaluations == few.evaluations
    assert many.pairs > few.pairs


def test_work_counts_the_drawn_pixels(bench, scene):
    """No fewer evaluations than pixels that are drawn, and no more than the boxes hold."""
    from tsplat.core import reference

    camera = straight(48, 32)
    splats = reference.project(scene, camera, tsplat.RenderParams())
    low, high = reference.pixel_boxes(splats)
    drawn = 0
    for k in range(len(splats)):
        only = scene.take(splats.gaussian_ids[k : k + 1])
        drawn += int((tsplat.render(only, camera).transmittance < 1).sum())
    counted = bench("work").measure(scene, camera).evaluations
    sides = (high // 4 - low // 4 + 1) * 4
    assert drawn <= counted <= int(sides.prod(axis=1).sum())


def test_a_slope_is_a_power(bench):
    """Points of y = 3 x^0.5 have the slope 0.5."""
    assert bench("plots").slope([(x, 3 * x**0.5) for x in (1, 10, 50)]) == pytest.approx(0.5)


def test_the_page_has_a_place_for_every_table(bench):
    """Putting a table in twice gives the same page; without markers it is refused."""
    put = bench("report").put
    page = "a\n<!-- x -->\n<!-- /x -->\nb\n"
    once = put(page, "x", "| t |")
    assert "| t |" in once
    assert put(once, "x", "| t |") == once
    with pytest.raises(ValueError, match="no markers for y"):
        put(page, "y", "")


def test_presenters_are_all_in_the_tables(bench, monkeypatch, capsys):
    """Each in each of its ways, decoded again: exact where it promises to be, else near."""
    presenters = bench("presenters")
    monkeypatch.setattr(presenters, "REPEATS", 1)
    monkeypatch.setattr(presenters, "timg", lambda *_: [])  # a program, which starts slowly
    pictures, cells = presenters.picture_rows(120, 60, 2), presenters.cell_rows(12, 4, 2)
    rows = {row.name: row for row in (*pictures, *cells) if row.name.startswith("tsplat")}
    names = {name.split(",")[0].split()[1] for name in rows}
    assert names == {"kitty", "iterm2", "sixel", "halfblock", "blocks", "braille", "letters"}
    for name, row in rows.items():
        exact = "kitty" in name or name == "tsplat halfblock"
        assert (row.moving.psnr == np.inf) == exact, name
        assert row.moving.psnr > 5
        assert row.moving.size > 0
        assert row.note == ""
    assert rows["tsplat iterm2"].rest.psnr == np.inf
    assert rows["tsplat sixel"].few.size < rows["tsplat sixel"].moving.size
    for markdown in (True, False):
        presenters.show("120x60", pictures, markdown)
        said = capsys.readouterr().out
        assert all(row.name in said for row in pictures)
        assert ("|" in said) == markdown


def test_a_presenter_that_shows_something_else_is_found_by_its_psnr(bench):
    """Upside down is far away; a picture of another size says so."""
    presenters = bench("presenters")
    [frame] = presenters.make_frames(60, 40, 1)
    image = frame.to_uint8()
    assert presenters.compared(image, frame) == (np.inf, "")
    assert presenters.compared(image[::-1], frame)[0] < 30
    psnr, note = presenters.compared(image[::2, ::2], frame)
    assert psnr < np.inf
    assert note == "~ 30x20"
