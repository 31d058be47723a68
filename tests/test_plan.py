"""The Plan: which backend runs which stage, why, and what is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tsplat
from tests.conftest import gaussians, straight
from tsplat.core import reference
from tsplat.core.errors import PluginError
from tsplat.core.params import RenderParams
from tsplat.core.stages import STAGES, Backend, Counts, Stages
from tsplat.plan import make_plan, parse_backend
from tsplat.plugins import Registry, plugins

SCENE = gaussians([[0, 0, 5], [0.1, 0, 6]])
FULL = Stages(reference.project, reference.sort, reference.bin, reference.composite)


def registry(*rows):
    """A registry of these backends and the built-in ones."""
    made = Registry(backends=dict(plugins().backends))
    for row in rows:
        made.backends[row.name] = row
    return made


def test_auto_takes_the_fastest_available():
    """Without a word the C kernel runs everything here."""
    plan = make_plan(SCENE)
    assert plan.backends == dict.fromkeys(STAGES, "cffi")
    assert plan.choices["sort"].reason == "fastest available"


def test_auto_passes_over_what_is_not_available_or_cannot():
    """The next fastest is taken, and the plan says why the first was not."""
    rows = (
        Backend("absent", "", Stages, rank=99, unavailable=lambda: "no GPU"),
        Backend("unable", "", Stages, rank=98, cannot=lambda s, p: "only cubes"),
        Backend("broken", "", lambda: 1 / 0, rank=97),
    )
    plan = make_plan(SCENE, registry=registry(*rows))
    assert plan.backends["project"] == "cffi"
    told = " ".join(plan.passed_over)
    for text in ("absent: no GPU", "unable: only cubes", "broken: ", "ZeroDivisionError"):
        assert text in told


def test_float64_leaves_only_the_reference():
    """Backends that cannot work in float64 are passed over; naming one is an error."""
    params = RenderParams(float64=True)
    assert set(make_plan(SCENE, params=params).backends.values()) == {"numpy"}
    with pytest.raises(PluginError, match="'cffi' cannot be used: computes in float32"):
        make_plan(SCENE, backend="cffi", params=params)


def test_backends_mix_by_stage_and_the_picture_holds():
    """project=cffi,composite=numba: each runs its stage, auto the others."""
    plan = make_plan(SCENE, backend="project=cffi,composite=numba,bin=numpy")
    assert plan.backends == {
        "project": "cffi", "sort": "cffi", "bin": "numpy", "composite": "numba",
    }  # fmt: skip
    want = tsplat.render(SCENE, straight(), make_plan(SCENE, backend="numpy"))
    np.testing.assert_allclose(tsplat.render(SCENE, straight(), plan).rgb, want.rgb, atol=1e-5)


def test_a_partial_backend_is_completed():
    """A named backend that offers one stage runs that one; the fastest runs the rest."""
    partial = Backend("sorter", "", lambda: Stages(sort=reference.sort), stages=("sort",))
    plan = make_plan(SCENE, backend="sorter", registry=registry(partial))
    assert plan.backends == {
        "project": "cffi", "sort": "sorter", "bin": "cffi", "composite": "cffi",
    }  # fmt: skip
    assert plan.choices["bin"].reason == "sorter does not offer it"
    with pytest.raises(PluginError, match="'sorter' does not offer bin, only sort"):
        make_plan(SCENE, backend="bin=sorter", registry=registry(partial))


@pytest.mark.parametrize("text", ["paint=cffi", "sort=", "sort=cffi,bin", "=cffi", ""])
def test_a_malformed_choice_is_explained(text):
    """STAGE=NAME,... with a stage that is not one, or without a name."""
    with pytest.raises(PluginError, match=r"expected (NAME or|a name,) STAGE=NAME"):
        parse_backend(text)
    with pytest.raises(PluginError, match="names sort twice"):
        parse_backend("sort=cffi,sort=numba")


def test_a_fused_backend_runs_the_whole_frame():
    """A fused frame is used when all four stages are one backend's, and tells its own times."""

    def fused(scene, camera, params, workspace, everything=False):
        frame = reference.render(scene, camera, params)
        return frame, Counts(2, 7, 1, {"project": 0.5, "composite": 0.25})

    row = Backend("fuser", "", lambda: replace(FULL, fused=fused), rank=99)
    result = make_plan(SCENE, registry=registry(row)).run(SCENE, straight())
    assert (result.visible, result.intersections, result.overflowed) == (2, 7, 1)
    assert set(result.seconds) == {"project", "composite", "total"}
    mixed = make_plan(SCENE, backend="fuser", registry=registry(row))
    assert mixed.fused is not None
    assert make_plan(SCENE, backend="sort=cffi", registry=registry(row)).fused is None


def test_zero_harmonic_bands_are_left_out_and_the_picture_is_the_same():
    """Bands that are zero throughout are not evaluated; the bits stay as they are."""
    rng = np.random.default_rng(0)
    sh = rng.normal(0, 1, (50, 16, 3)).astype(np.float32)
    sh[:, 4:] = 0
    scene = gaussians(rng.normal((0, 0, 5), 0.3, (50, 3)), sh=sh)
    plan = make_plan(scene, threads=1)
    assert plan.params.sh_degree == 1
    (item,) = [i for i in plan.left_out if i.what.startswith("SH bands")]
    assert item.what == "SH bands 2 to 3"
    full = replace(plan, params=replace(plan.params, sh_degree=3))
    frames = [tsplat.render(scene, straight(), p) for p in (plan, full)]
    assert frames[0].rgb.tobytes() == frames[1].rgb.tobytes()


def test_a_scene_that_uses_its_bands_keeps_them():
    """One coefficient of the last band is enough to need it."""
    sh = np.zeros((9000, 16, 3), np.float32)
    sh[-1, 15, 2] = 1e-30
    scene = gaussians(np.zeros((9000, 3)), sh=sh)
    plan = make_plan(scene)
    assert plan.params.sh_degree == 3
    assert not any(item.what.startswith("SH") for item in plan.left_out)


def test_frames_made_without_a_workspace_are_independent():
    """render() twice gives two frames; neither is overwritten by the other."""
    plan = make_plan(SCENE)
    first = tsplat.render(SCENE, straight(), plan)
    before = first.rgb.copy()
    tsplat.render(gaussians([[0.3, 0.3, 4]]), straight(), plan)
    np.testing.assert_array_equal(first.rgb, before)


def test_the_public_names_are_all_there():
    """Every name the package announces can be imported."""
    for name in tsplat.__all__:
        assert getattr(tsplat, name) is not None
    with pytest.raises(AttributeError, match="no attribute"):
        _ = tsplat.nonsense
