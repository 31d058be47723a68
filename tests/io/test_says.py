"""What files say beside their numbers: antialiasing, which way is up, flat Gaussians."""

from __future__ import annotations

import numpy as np
import pytest

from tests.io import gltfwriter, sogwriter, spzwriter
from tests.io.plywriter import raw_columns, write_ply
from tests.io.splatwriter import drawn, write_compressed
from tsplat.core.types import Up
from tsplat.io import load_scene
from tsplat.io.says import says_antialias, says_up


@pytest.mark.parametrize(
    ("comments", "said"),
    [
        ([], None),
        (["Exported from Brush", "SH degree: 3"], None),
        (["SplatRenderMode: mip"], True),
        (["splatrendermode:  MIP "], True),
        (["SplatRenderMode: default"], False),
        (["antialiased 1"], True),
        (["antialiased 0"], False),
        (["antialiased 1", "SplatRenderMode: default"], False),
        (["antialiased by hand 1"], None),
    ],
)
def test_antialiasing_in_comments(comments, said):
    """Brush's and Postshot's words, in any case; the last one counts."""
    assert says_antialias(comments) is said


@pytest.mark.parametrize(
    ("comment", "direction"),
    [
        ("Vertical Axis: z", (0, 0, 1)),
        ("Vertical axis: -z", (0, 0, -1)),
        ("Vertical axis: x", (1, 0, 0)),
        ("Vertical axis: -Y", (0, -1, 0)),
        ("Vertical axis: y", None),
        ("Vertical axis: +y", None),
        ("Vertical axis: up", None),
        ("Vertical axis: 0 -0.6 0.8", (0, -0.6, 0.8)),
        ("vertical axis: [1e-1, 2, -.5]", (0.1, 2, -0.5)),
        ("Vertical axis: 0 0 0", None),
        ("Vertical axis: 1 2", None),
        ("Vertical axis: 1 2 nan", None),
        ("Vertical axis: 1e999 0 0", None),
    ],
)
def test_up_in_comments(comment, direction):
    """Axes and directions are believed; y, which every file of Brush's has, says nothing."""
    said = says_up([comment])
    assert (said and said.direction) == direction


def _ply(tmp_path, *comments, **without):
    columns = raw_columns(20, 1)
    for name in without:
        del columns[name]
    return write_ply(tmp_path / "a.ply", columns, comments=comments)


def test_comments_reach_the_scene(tmp_path):
    """Of PLY and compressed PLY; without them nothing is said."""
    plain = load_scene(_ply(tmp_path))
    assert (plain.antialias, plain.up) == (None, None)
    words = ["SplatRenderMode: mip", "Vertical Axis: z"]
    scene = load_scene(_ply(tmp_path, *words))
    assert (scene.antialias, scene.up) == (True, Up((0, 0, 1), "the file says: Vertical axis: z"))
    packed = tmp_path / "b.ply"
    write_compressed(packed, drawn(20, 1))
    assert load_scene(packed).antialias is None
    content = packed.read_bytes().replace(b"end_header", b"comment antialiased 1\nend_header", 1)
    packed.write_bytes(content)
    assert load_scene(packed).antialias is True


def test_formats_with_y_up_say_so(tmp_path):
    """SPZ and glTF have been turned, so up is -y, and why is told; PLY and SOG say nothing."""
    for content, why in (
        (spzwriter.packed(2, 2, 0, spzwriter.random_planes(2, 2, 0)), "SPZ file's axes are RUB"),
        (gltfwriter.one(gltfwriter.random_arrays(2, 0)).glb(), "y is up in glTF"),
        (sogwriter.bundle(*sogwriter.random_scene(2, 0)[:2]), None),
    ):
        (tmp_path / "a").write_bytes(content)
        up = load_scene(tmp_path / "a").up
        assert up is None if why is None else (up.direction == (0, -1, 0) and why in up.why)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({}, None), ({"antialias": True}, True), ({"antialias": False}, False),
        ({"model": "antialiased"}, True), ({"model": "default"}, False),
        ({"antialias": False, "model": "antialiased"}, False),
    ],
)  # fmt: skip
def test_sog_says_it_in_two_ways(tmp_path, words, said):
    """``antialias``, or ``model`` in newer files."""
    meta, images = sogwriter.random_scene(2, 0)[:2]
    (tmp_path / "a").write_bytes(sogwriter.bundle({**meta, **words}, images))
    assert load_scene(tmp_path / "a").antialias is said


def test_gaussians_without_thickness(tmp_path):
    """A PLY without scale_2 holds flat Gaussians: what it has is read, the third size is 0."""
    flat, full = (
        load_scene(_ply(tmp_path, **without)) for without in ({"scale_2": True}, {})
    )  # fmt: skip
    assert (flat.scales[:, 2] == 0).all()
    np.testing.assert_array_equal(flat.scales[:, :2], full.scales[:, :2])
    for name in ("means", "quats", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(flat, name), getattr(full, name))
    assert (flat.source, full.source) == ("ply of 2D Gaussians", "ply")
