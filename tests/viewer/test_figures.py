"""The words about a picture are the picture's."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.conftest import gaussians
from tests.viewer.rules import VIEW
from tsplat.core.params import PRESETS
from tsplat.edits import Edits
from tsplat.plan import make_plan
from tsplat.presenters.base import Terminal
from tsplat.viewer.figures import Shown, bits, figures, status
from tsplat.viewer.look import Look
from tsplat.viewer.pace import Link

SCENE = replace(
    gaussians([(0, 0, 0), (0.2, 0, 0), (900, 0, 0)], scales=0.4),
    name="three.ply", dropped={"non-finite mean": 7},
)  # fmt: skip
TERMINAL = Terminal(columns=60, rows=20, cell_width=9.6, cell_height=19, name="foot(1.21)")


def shown(**changes):
    """A picture that was really drawn, and words about how it was shown."""
    params = changes.pop("params", PRESETS["contract"])
    plan = make_plan(SCENE, backend="numpy", threads=2, params=params)
    camera = VIEW.camera((40, 30), (1.0, 1.0))
    rendered = plan.run(SCENE, camera)
    made = Shown(
        scene=SCENE, plan=plan, look=Look(params=params), rendered=rendered, presenter="sixel",
        size=(40, 30), full=(40, 30), camera=camera, frames=None, encode=0.0021, sent=12_345,
        link=None, latency=None,
    )  # fmt: skip
    return replace(made, **changes)


def table(made, why="asked for", verified=""):
    rows = figures(made, TERMINAL, why, verified)
    return dict(rows)


def test_the_status_line_has_the_most_important_first():
    """The scene, how much of it is seen, what that took and who did it, how it is shown."""
    made = shown()
    parts = list(filter(None, status(made)))
    milliseconds = made.rendered.seconds["total"] * 1e3
    assert parts[:4] == [
        "three.ply", "2 of 3", f"{milliseconds:.1f} ms numpy x2", "sixel 40x30",
    ]  # fmt: skip
    assert parts[-1].startswith("without") or "2.1 ms 12 kB" in parts


def test_the_status_line_says_what_is_not_usual():
    """Shortcuts, edits, fewer pixels, frames and the link; none of it when all is usual."""
    plain = "  ".join(status(shown()))
    for words in ("fast", "min_opacity", "fps", "bit/s", "/"):
        assert words not in plain, words
    parts = status(
        shown(
            params=PRESETS["fast"], look=Look(edits=Edits(min_opacity=0.1)), size=(20, 15),
            frames=24.4, link=Link(0.012, 2.5e6),
        )
    )  # fmt: skip
    for words in ("fast", "min_opacity=0.1", "24 fps", "sixel 20x15/40x30", "12 ms 20 Mbit/s"):
        assert words in parts, words


def test_the_figures_are_the_pictures():
    """Times of its stages, what was sent, splats, pairs, who drew it, where the camera is."""
    made = shown(latency=0.0456, frames=9.6, link=Link(0.012, 2.5e6))
    seconds, got = made.rendered.seconds, table(made)
    assert got["resolution"] == "40x30"
    assert got["render"] == f"{seconds['total'] * 1e3:.2f} ms"
    for stage in ("project", "sort", "bin", "composite"):
        assert got[f"  {stage}"] == f"{seconds[stage] * 1e3:.2f} ms"
    assert got["encode"] == "2.10 ms"
    assert got["frame"] == "12.3 kB"
    assert got["frames"] == "10 a second"
    assert got["input to picture"] == "46 ms"
    assert got["link"] == "12 ms 20 Mbit/s"
    assert got["splats"] == "2 of 3"
    assert got["pairs with tiles"] == str(made.rendered.intersections)
    assert got["backend"] == "numpy x2"
    assert got["not loaded"] == "7: non-finite mean"
    eye = [float(word) for word in got["eye"].split()]
    assert eye == pytest.approx(made.camera.centre.tolist(), rel=0.01)
    ahead = [float(word) for word in got["looks along"].split()]
    assert ahead == pytest.approx(made.camera.rotation[2].tolist(), abs=0.01)


def test_the_figures_know_the_terminal():
    """Without a picture, too; what it is inside of, and how few colours it has."""
    got = table(None, "the best foot supports", "3 frames agree")
    assert got == {
        "verified": "3 frames agree", "terminal": "foot(1.21)",
        "chosen for": "the best foot supports", "cells": "60x20 of 9.6x19 px", "colours": "24 bits",
    }  # fmt: skip
    poor = figures(None, replace(TERMINAL, colors=256, multiplexer="tmux", name=""), "x", "")
    assert {("colours", "256"), ("inside", "tmux"), ("terminal", "unknown")} <= set(poor)


def test_shortcuts_are_told_with_their_price():
    """What the settings leave out is listed with what that does to the picture."""
    rows = figures(shown(params=PRESETS["fast"]), TERMINAL, "", "")
    without = [words for name, words in rows if name == "without"]
    assert any("Gaussians" in words and "another picture" in words for words in without)
    assert ("settings", "fast") in rows
    assert "settings" not in table(shown())


@pytest.mark.parametrize(
    ("rate", "words"),
    [(12.5, "100 bit/s"), (125e3, "1 Mbit/s"), (2.5e6, "20 Mbit/s"), (1.25e9, "10 Gbit/s"),
     (56e3 / 8, "56 kbit/s")],
)  # fmt: skip
def test_rates_are_in_bits(rate, words):
    """Bytes a second times eight."""
    assert bits(rate) == words
