"""docs/stability.md: it has every case, and its figures are what it says."""

from __future__ import annotations

import importlib
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import ROOT
from tsplat.core import reference
from tsplat.core.camera import look_at
from tsplat.core.types import Frame
from tsplat.testing.checks import Case, check_picture
from tsplat.testing.stiff import CASES, REFUSALS, prepared
from tsplat.testing.strategies import make_scene

PAGE = (ROOT / "docs" / "stability.md").read_text()


@pytest.fixture
def stability(monkeypatch):
    """bench/stability.py, imported as a script finds it."""
    monkeypatch.syspath_prepend(str(ROOT / "bench"))
    return importlib.import_module("stability")


def tables():
    """Rows of each table on the page, headings included."""
    found = re.findall(r"(?:^\|.*\|\n)+", PAGE, re.M)
    return [
        [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
        for table in found
    ]


def figures():
    """Case -> heading -> what stands there."""
    headings, _, *rows = tables()[0]
    return {row[0]: dict(zip(headings, row, strict=True)) for row in rows}


def test_every_case_is_listed():
    """In order, with its bound, its reason, and why its bound is not the usual one."""
    assert list(figures()) == [case.name for case in CASES]
    _, reasons, bounds, _ = (table[2:] for table in tables())
    assert reasons == [[case.name, case.why] for case in CASES]
    for case, row in zip((c for c in CASES if c.bound_why), bounds, strict=True):
        assert row[0] == case.name
        assert row[2] == case.bound_why
        assert math.isclose(float(row[1]), case.bound, rel_tol=0.5)


def test_every_refusal_is_listed():
    """With the words that the error has."""
    rows = tables()[3][2:]
    assert [row[0] for row in rows] == [refusal.name for refusal in REFUSALS]
    for row, refusal in zip(rows, REFUSALS, strict=True):
        assert refusal.words in row[1]


def test_the_page_is_what_the_script_writes(stability):
    """Its sentences, and its tables as they are formatted; figures apart."""
    for part in re.split(r"\{[a-z]+\}", stability.TEXT):
        assert part.strip() in PAGE
    assert tables()[0][0] == ["case", "bound", *stability.COLUMNS]
    cells = {case.name: {} for case in CASES}
    empty = stability.page(cells).splitlines()
    assert len(empty) == len(PAGE.splitlines())


def error(cell):
    """The number before the brackets."""
    return float(cell.split()[0])


def test_every_figure_is_within_its_bound(stability):
    """Of all backends and instruction sets; the oracle and the contract agree to 1e-8."""
    for case in CASES:
        row = figures()[case.name]
        for name in stability.BACKENDS:
            assert error(row[name]) <= 1.05 * case.bound, (case.name, name)
        assert error(row["float64"]) <= 1e-8 * max(case.bound / 1e-4, 1)


def test_the_naive_formulas_fail_where_the_page_says():
    """Needles for one, places far out for the other."""
    rows = figures()
    for case in CASES:
        if case.name.startswith("needles of"):
            assert error(rows[case.name]["`ac-b²`"]) > case.bound
        elif case.name in ("centres at 1e7 m", "focal length of 1e7 px"):
            assert error(rows[case.name]["`Rm+t`"]) > case.bound


def test_the_naive_formulas_are_right_where_nothing_is_hard(stability):
    """They are a fair comparison: on an ordinary scene they keep the contract."""
    scene = make_scene(5, 300, 2, frozenset())
    camera = look_at((0.5, -1, -4), (0, 0, 0), (0, -1, 0), 60, 60, 40)
    for stages in stability.NAIVE.values():
        verdict = check_picture(stages, Case(scene, camera))
        assert verdict.passed, verdict
        assert verdict.comparison.max_error < 1e-5


def test_a_cell_has_the_error_and_the_crossings(stability):
    """Measured apart: a pixel on a threshold counts, one on none is an error; NaN stays NaN."""
    case = next(c for c in CASES if c.name == "opacities one ulp from 1/255")
    scene, camera, params, oracle = prepared(case)
    frame = reference.render(scene, camera, replace(params, float64=True))
    rgb = frame.rgb.copy()
    on_threshold = np.argwhere(oracle.margins < case.crossing)
    rgb[tuple(on_threshold[0])] += 0.5
    assert str(stability.cell(replace(frame, rgb=rgb), oracle, case)) == "0 (1)"
    rgb[0, 0] += 3e-7
    assert str(stability.cell(replace(frame, rgb=rgb), oracle, case)) == "3e-7 (1)"
    rgb[0, 1] = np.nan
    bad = Frame(rgb, frame.transmittance)
    assert str(stability.cell(bad, oracle, case)).startswith("NaN")
    assert str(stability.Cell(1.0, 0)) == "1"
