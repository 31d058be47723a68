"""What the Plan leaves out: each cut happens where it may, says so, and moves no bit."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.conftest import gaussians, straight
from tests.io.plywriter import raw_columns, write_ply
from tsplat.cli import main
from tsplat.core.camera import Camera, look_at
from tsplat.core.params import RenderParams
from tsplat.core.workspace import Workspace
from tsplat.plan import Rendered, make_plan
from tsplat.plugins import plugins

pytestmark = pytest.mark.skipif(
    plugins().backends["cffi"].unavailable() is not None, reason="there is no C kernel here"
)


def cloud(seed: int, n: int, degree: int = 0, spread: float = 30.0, **kwargs):
    """Gaussians all around the origin, from dust to some larger than the picture."""
    rng = np.random.default_rng(seed)
    scales = np.exp(rng.normal(-1.5, 1.2, (n, 3)))
    sh = rng.normal(0, 0.5, (n, (degree + 1) ** 2, 3))
    quats = rng.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    kwargs.setdefault("opacities", rng.uniform(0.01, 1, n))
    return gaussians(
        rng.uniform(-spread, spread, (n, 3)), scales, quats=quats, sh=sh, **kwargs
    )  # fmt: skip


def camera_at(eye, target, width=97, height=61, fov=60.0) -> Camera:
    """A camera at ``eye`` that looks at ``target``, y down."""
    return look_at(
        np.asarray(eye, float), np.asarray(target, float), np.array([0.0, -1.0, 0.0]),
        fov, width, height,
    )  # fmt: skip


def same_bits(a: Rendered, b: Rendered) -> bool:
    """Whether two frames agree in every bit."""
    return (
        a.frame.rgb.tobytes() == b.frame.rgb.tobytes()
        and a.frame.transmittance.tobytes() == b.frame.transmittance.tobytes()
    )


def without(rendered: Rendered, word: str) -> bool:
    """Whether the frame says that it left out something that ``word`` names."""
    return any(word in item.what or word in item.why for item in rendered.left_out)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**16),
    eye=st.tuples(*[st.floats(-40, 40)] * 3),
    fov=st.sampled_from([5.0, 40.0, 60.0, 110.0]),
)
def test_clusters_out_of_sight_are_skipped_and_no_bit_moves(seed, eye, fov):
    """From anywhere, inside the cloud or beside it, with giants across the picture's edge."""
    scene = cloud(seed, 3000)
    camera = camera_at(eye, np.asarray(eye) + (0.3, 0.1, 1.0), fov=fov)
    cut, full = make_plan(scene, threads=1), make_plan(scene, threads=1, everything=True)
    assert same_bits(cut.run(scene, camera), full.run(scene, camera))


def test_most_clusters_are_skipped_where_the_camera_turns_its_back():
    """The cut does happen: a camera beside the cloud that looks away from most of it."""
    scene = cloud(1, 20000)
    rendered = make_plan(scene, threads=1).run(scene, camera_at((25, 25, 25), (60, 60, 60)))
    (item,) = [i for i in rendered.left_out if "out of sight" in i.why]
    assert int(item.what.split()[0].replace(",", "")) > 10000
    everything = make_plan(scene, threads=1, everything=True)
    assert everything.run(scene, camera_at((25, 25, 25), (60, 60, 60))).left_out == ()


def test_culling_by_centres_would_be_caught():
    """The comparison sees what a cull without extents loses."""
    scene, camera = cloud(2, 3000), camera_at((0, 0, -20), (0, 0, 0))
    p = (scene.means - camera.centre) @ camera.rotation.T
    inside = p[:, 2] > camera.near
    for axis, size in ((0, camera.width), (1, camera.height)):
        with np.errstate(divide="ignore"):
            pixel = camera.K[axis, axis] * p[:, axis] / p[:, 2] + camera.K[axis, 2]
        inside &= (pixel >= 0) & (pixel <= size)
    wrong = scene.take(inside)
    frames = [make_plan(s, threads=1).run(s, camera) for s in (scene, wrong)]
    assert not same_bits(*frames)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**16), threshold=st.sampled_from([1 / 255, 0.02, 0.2]))
def test_gaussians_below_the_threshold_are_dropped_and_no_bit_moves(seed, threshold):
    """They are counted, and no picture knows them."""
    rng = np.random.default_rng(seed)
    scene = cloud(seed, 500, spread=4, opacities=rng.choice([0.001, 0.01, 0.1, 0.9], 500))
    params = RenderParams(alpha_threshold=threshold)
    cut = make_plan(scene, threads=1, params=params)
    faint = int((scene.opacities < threshold).sum())
    assert any(item.what == f"{faint:,} Gaussians" for item in cut.left_out)
    full = make_plan(scene, threads=1, params=params, everything=True)
    camera = camera_at((0, 0, -8), (0, 0, 0))
    assert same_bits(cut.run(scene, camera), full.run(scene, camera))


def test_a_scene_without_faint_gaussians_says_nothing_of_them():
    """Nothing is dropped, nothing is told."""
    plan = make_plan(cloud(3, 500, opacities=0.5))
    assert not any("threshold" in item.why for item in plan.left_out)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**16), degree=st.integers(1, 3), half=st.booleans())
def test_colours_are_kept_while_the_camera_stands(seed, degree, half):
    """A camera that only turns sees old Gaussians in their old colours and new ones in new."""
    scene = cloud(seed, 600, degree, spread=6)
    if half:
        scene = replace(scene, sh=scene.sh.astype(np.float16))
    cut, full = make_plan(scene, threads=1), make_plan(scene, threads=1, everything=True)
    workspace, kept = Workspace(1), []
    for target in ((0, 0, 1), (0.2, 0, 1), (0.5, 0.1, 1), (1, 0, 0.5)):
        camera = camera_at((0.1, 0.2, 0.3), np.add((0.1, 0.2, 0.3), target))
        rendered = cut.run(scene, camera, workspace)
        want = full.run(scene, camera).frame.rgb
        np.testing.assert_allclose(rendered.frame.rgb, want, atol=2e-6)
        kept.append(without(rendered, "colours"))
    assert kept[:2] == [False, False]
    assert kept[2]


def test_kept_colours_are_the_same_bits_after_a_change_of_size():
    """Where the centre is the same to the bit, so are the colours."""
    scene = cloud(4, 600, 3, spread=6)
    cut, full = make_plan(scene, threads=1), make_plan(scene, threads=1, everything=True)
    workspace, camera = Workspace(1), camera_at((0, 0, 0), (0, 0, 1))
    for width in (50, 60, 70, 80):
        wider = replace(camera, width=width)
        rendered = cut.run(scene, wider, workspace)
        assert same_bits(rendered, full.run(scene, wider))
    assert without(rendered, "colours")


def test_colours_are_not_kept_where_the_camera_moves():
    """A step aside changes every direction."""
    scene = cloud(5, 600, 3, spread=6)
    cut, full = make_plan(scene, threads=1), make_plan(scene, threads=1, everything=True)
    workspace = Workspace(1)
    for x in (0, 0.1, 0.2, 0.3):
        camera = camera_at((x, 0, 0), (x, 0, 1))
        rendered = cut.run(scene, camera, workspace)
        assert not without(rendered, "colours")
        assert same_bits(rendered, full.run(scene, camera))


def test_colours_of_one_scene_do_not_serve_another():
    """Same place, same memory, another scene."""
    workspace, camera = Workspace(1), camera_at((0, 0, 0), (0, 0, 1))
    for seed in (6, 6, 7, 7, 7):
        scene = cloud(seed, 600, 2, spread=6)
        workspace.known["plan"] = None
        got = make_plan(scene, threads=1).run(scene, camera, workspace)
        want = make_plan(scene, threads=1, everything=True).run(scene, camera)
        assert same_bits(got, want)


@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**16), width=st.integers(1, 70), height=st.integers(1, 70),
    depth=st.booleans(),
)  # fmt: skip
def test_tiles_without_splats_are_only_cleared(seed, width, height, depth):
    """Whatever the buffers held before; pictures of any size, with and without depth."""
    scene = cloud(seed, 40, spread=3)
    params = RenderParams(depth=depth)
    camera = camera_at((0, 0, -30), (0, 0, 0), width, height)
    cut = make_plan(scene, threads=1, params=params)
    full = make_plan(scene, threads=1, params=params, everything=True)
    workspace = Workspace(1)
    cut.run(scene, camera, workspace).frame.rgb.fill(7)
    workspace.forget()
    got, want = cut.run(scene, camera, workspace), full.run(scene, camera)
    assert same_bits(got, want)
    if depth:
        assert got.frame.depth.tobytes() == want.frame.depth.tobytes()


def test_tiles_that_all_have_splats_are_not_called_empty():
    """Four tiles, then one of them in use."""
    wide = gaussians([[0, 0, 5]], 3.0)
    assert not without(make_plan(wide).run(wide, straight(32, 32)), "tiles")
    small = gaussians([[-0.5, -0.5, 5]], 0.01)
    assert without(make_plan(small).run(small, straight(32, 32)), "3 of 4 tiles")


@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**16), width=st.integers(50, 90), height=st.integers(50, 90),
    most=st.sampled_from([0.02, 0.3, 1.0]), depth=st.booleans(), threads=st.integers(1, 2),
)  # fmt: skip
def test_a_crowded_frame_is_made_in_slabs_and_no_bit_moves(
    seed, width, height, most, depth, threads
):
    """Opaque, half opaque and thin crowds, some of equal depth; pixels go on where they were."""
    rng = np.random.default_rng(seed)
    scene = cloud(seed, 4000, spread=3, opacities=rng.uniform(0.01, most, 4000))
    means = scene.means.copy()
    means[:500, 2] = np.round(means[:500, 2])
    scene = replace(scene, means=means, scales=np.maximum(scene.scales, 3))
    params = RenderParams(depth=depth)
    camera = camera_at((0, 0, -12), (0, 0, 0), width, height, fov=30)
    cut = make_plan(scene, threads=threads, params=params)
    full = make_plan(scene, threads=1, params=params, everything=True)
    got, want = cut.run(scene, camera), full.run(scene, camera)
    assert want.intersections > 1024 * (-(-width // 16)) * (-(-height // 16))
    assert same_bits(got, want)
    if depth:
        assert got.frame.depth.tobytes() == want.frame.depth.tobytes()
    if most == 1:
        assert without(got, "opaque before")
        assert got.intersections < want.intersections / 2


def test_a_frame_with_little_behind_anything_is_made_in_one():
    """No slabs where they would save nothing."""
    scene = cloud(12, 3000, spread=3)
    got = make_plan(scene).run(scene, camera_at((0, 0, -30), (0, 0, 0)))
    assert not without(got, "opaque before")


@settings(max_examples=15)
@given(seed=st.integers(0, 2**16), factor=st.floats(0.8, 1.2))
def test_the_order_is_kept_where_depths_are_the_same(seed, factor):
    """A zoom that loses nobody out of sight leaves depths as they are; a step does not."""
    scene = cloud(seed, 200, spread=1)
    plan = make_plan(scene, backend="numpy", threads=1)
    workspace = Workspace(1)
    first = camera_at((0, 0, -30), (0, 0, 0), fov=60)
    k = first.K.copy()
    k[0, 0] = k[1, 1] = k[0, 0] * factor
    zoomed = replace(first, K=k)
    moved = camera_at((0, 0, -31), (0, 0, 0), fov=60)
    assert not without(plan.run(scene, first, workspace), "sorting")
    kept = plan.run(scene, zoomed, workspace)
    if factor != 1:
        assert without(kept, "sorting")
    assert same_bits(kept, plan.run(scene, zoomed))
    again = plan.run(scene, moved, workspace)
    assert not without(again, "sorting")
    assert same_bits(again, plan.run(scene, moved))


@pytest.mark.parametrize("backend", ["cffi", "numpy"])
def test_a_frame_is_not_made_twice(backend):
    """The same plan, scene, camera and memory: the frame is there already, until told to forget."""
    scene = cloud(8, 100, spread=3)
    plan = make_plan(scene, backend=backend, threads=1)
    workspace, camera = Workspace(1), camera_at((0, 0, -8), (0, 0, 0))
    first = plan.run(scene, camera, workspace)
    again = plan.run(scene, replace(camera), workspace)
    assert again.frame is first.frame
    assert without(again, "whole frame")
    workspace.forget()
    assert not without(plan.run(scene, camera, workspace), "whole frame")
    moved = plan.run(scene, camera_at((0, 0, -9), (0, 0, 0)), workspace)
    assert not without(moved, "whole frame")
    other = scene.take(np.arange(50))
    assert not without(plan.run(other, camera_at((0, 0, -9), (0, 0, 0)), workspace), "whole frame")


def test_everything_leaves_nothing_out():
    """The plan to compare with is what it says."""
    plan = make_plan(cloud(9, 1000), everything=True)
    assert plan.left_out == ()
    assert plan.everything


def test_info_lists_what_a_scene_allows(tmp_path, capsys):
    """And does not list it for a scene that does not allow it."""
    told = {}
    for name, n, degree, faint in (("many", 1000, 0, 10), ("few", 100, 1, 0)):
        columns = raw_columns(n, degree)
        columns["opacity"] = np.where(np.arange(n) < faint, -8.0, 1.0)
        path = write_ply(tmp_path / f"{name}.ply", columns)
        assert main(["info", str(path), "--json"]) == 0
        facts = json.loads(capsys.readouterr().out)
        told[name] = {item["what"]: item["why"] for item in facts["left_out"]}
    assert told["many"]["10 Gaussians"] == "their opacity is below the alpha threshold"
    assert "4 clusters" in told["many"]["Gaussians out of sight"]
    assert "colours per frame" in told["many"]
    assert not {"10 Gaussians", "Gaussians out of sight", "colours per frame"} & set(told["few"])
    assert "harmonics of Gaussians that are not visible" in told["few"]
