"""Every way of writing the same Gaussians must give the same Scene.

Compared with ``plywriter.decode_plainly``, row by row in Python's floats, to one unit in the last
place of float32. Not compared here: float16 (test_half), what is refused (test_ply_faults), real
files (test_real).
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.io.plywriter import (
    BIG,
    EXTRINSIC,
    FACE,
    FORMATS,
    LITTLE,
    NO_ROWS,
    TEXT,
    as_stored,
    decode_plainly,
    names_inria,
    raw_columns,
    write_ply,
)
from tsplat.core.errors import ParamsError
from tsplat.io import load_scene, sweeps
from tsplat.io.base import sample_rows

OTHERS = st.lists(st.sampled_from([FACE, EXTRINSIC, NO_ROWS]), unique_by=id, max_size=3)


def assert_scene(scene, stored):
    expected = decode_plainly(stored)
    assert len(scene) == len(expected)
    for field in ("quats", "scales", "opacities", "sh"):
        wanted = np.array([g[field] for g in expected]).reshape(getattr(scene, field).shape)
        np.testing.assert_array_max_ulp(getattr(scene, field), wanted.astype(np.float32), 1)
    wanted = np.array([g["means"] for g in expected]).reshape(-1, 3)
    if scene.origin.any():
        np.testing.assert_allclose(scene.means + scene.origin, wanted, rtol=1e-6, atol=1e-12)
    else:
        np.testing.assert_array_equal(scene.means, wanted.astype(np.float32))


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_any_variant_gives_the_same_scene(tmp_path, data):
    """Property order, number types, byte order, text, and other elements do not matter."""
    degree = data.draw(st.integers(0, 3))
    columns = raw_columns(data.draw(st.integers(1, 9)), degree, data.draw(st.integers(0, 999)))
    if data.draw(st.booleans()):
        for normal in ("nx", "ny", "nz"):
            del columns[normal]
    columns["label"] = np.arange(len(columns["x"]))
    order = data.draw(st.permutations(list(columns)))
    kinds = st.sampled_from(["float", "double", "float32", "float64"])
    types = {name: data.draw(kinds, label=name) for name in ("x", "y", "z", "opacity", "rot_0")}
    if data.draw(st.booleans()):
        types = dict.fromkeys(columns, "double")
    types["label"] = data.draw(st.sampled_from(["uchar", "short", "int", "uint"]))
    first = data.draw(OTHERS)
    later = [o for o in data.draw(OTHERS) if o not in first]
    path = write_ply(
        tmp_path / "any.ply",
        columns,
        order=order,
        types=types,
        fmt=data.draw(st.sampled_from(FORMATS)),
        before=first,
        after=later,
        comments=data.draw(st.lists(st.sampled_from(["", "element vertex 9", "Ärger"]))),
        line_end=data.draw(st.sampled_from(["\n", "\r\n"])),
    )
    assert_scene(load_scene(path, sh_float32=True), as_stored(columns, types))


@pytest.mark.parametrize("fmt", FORMATS)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_degree_in_every_encoding(tmp_path, degree, fmt):
    """0, 9, 24 and 45 f_rest properties are degrees 0 to 3, stored channel by channel."""
    columns = raw_columns(5, degree)
    path = write_ply(tmp_path / "a.ply", columns, fmt=fmt)
    scene = load_scene(path, sh_float32=True)
    assert scene.sh_degree == degree
    assert scene.name == "a.ply"
    assert_scene(scene, as_stored(columns, {}))


def test_channel_major_coefficients(tmp_path):
    """f_rest_0..2 are red's first band, f_rest_3..5 green's, f_rest_6..8 blue's."""
    columns = raw_columns(1, 1)
    for i in range(9):
        columns[f"f_rest_{i}"] = np.array([float(i)])
    scene = load_scene(write_ply(tmp_path / "a.ply", columns))
    np.testing.assert_array_equal(scene.sh[0, 1:], [[0, 3, 6], [1, 4, 7], [2, 5, 8]])


def test_alphabetical_order_as_brush_writes_it(tmp_path):
    """f_rest_10 before f_rest_2 in the file changes nothing: properties are found by name."""
    columns = raw_columns(4, 3)
    path = write_ply(tmp_path / "a.ply", columns, order=sorted(names_inria(3, normals=False)))
    assert_scene(load_scene(path, sh_float32=True), as_stored(columns, {}))


@pytest.fixture
def small_pieces(monkeypatch):
    """Chunks of 7 rows and pieces of 21, so that small files are read by many threads in turn."""
    monkeypatch.setattr(sweeps, "CHUNK", 7)
    monkeypatch.setattr(sweeps, "PIECE", 21)


@pytest.mark.parametrize("fmt", FORMATS)
def test_more_rows_than_a_piece(tmp_path, small_pieces, fmt):
    """Rows at both sides of every border arrive once and in order; progress never goes back."""
    n = 5 * 21 + 8
    columns = raw_columns(n, 1)
    columns["x"] = np.arange(n)
    calls = []
    path = write_ply(tmp_path / "a.ply", columns, fmt=fmt)
    scene = load_scene(path, sh_float32=True, progress=lambda *call: calls.append(call))
    np.testing.assert_array_equal(scene.means[:, 0], np.arange(n))
    assert_scene(scene, as_stored(columns, {}))
    if fmt == LITTLE:
        assert calls[-7:] == [(done, n) for done in (0, 21, 42, 63, 84, 105, n)]


def test_what_is_dropped_in_many_pieces_leaves_no_gap(tmp_path, small_pieces):
    """Whichever rows of whichever pieces are left out, the others follow each other in order."""
    n = 200
    columns = raw_columns(n, 1)
    columns["x"] = np.arange(n).astype(float)
    bad = np.random.default_rng(0).random(n) < 0.3
    bad[21:42] = True  # a piece of which nothing stays
    columns["y"][bad] = np.nan
    columns["opacity"][~bad & (np.arange(n) % 9 == 0)] = np.nan
    good = ~bad & (np.arange(n) % 9 != 0)
    scene = load_scene(write_ply(tmp_path / "a.ply", columns), sh_float32=True)
    assert_scene(scene, as_stored({k: v[good] for k, v in columns.items()}, {}))
    assert dict(scene.dropped) == {
        "mean not finite": bad.sum(),
        "opacity not a number": (~bad & ~good).sum(),
    }


@pytest.mark.parametrize("keep", [1, 3, 20, 199])
def test_a_sample_of_many_pieces(tmp_path, small_pieces, keep):
    """A sample is the same rows whether few or many of a piece are picked, or none."""
    columns = raw_columns(200, 0)
    path = write_ply(tmp_path / "a.ply", columns)
    rows = sample_rows(200, keep)
    scene = load_scene(path, max_splats=keep, sh_float32=True)
    assert_scene(scene, as_stored({k: v[rows] for k, v in columns.items()}, {}))


def test_double_positions_keep_their_detail(tmp_path):
    """Positions at 4e6 with millimetre Gaussians get an origin; float32 positions never do."""
    columns = raw_columns(50, 0)
    for name, place in (("x", 4e6), ("y", -5e5), ("z", 30.0)):
        columns[name] = place + np.linspace(0, 1, 50)
    for i in range(3):
        columns[f"scale_{i}"] = np.full(50, np.log(1e-3))
    types = dict.fromkeys("xyz", "double")
    scene = load_scene(write_ply(tmp_path / "a.ply", columns, types=types))
    wanted = np.stack([columns[c] for c in "xyz"], axis=1)
    assert np.abs(scene.means + scene.origin - wanted).max() < 1e-6
    narrow = load_scene(write_ply(tmp_path / "b.ply", columns))
    assert not narrow.origin.any()
    np.testing.assert_array_equal(narrow.means, wanted.astype(np.float32))


def test_infinite_logits_and_logs_are_legal(tmp_path):
    """+inf is opacity 1, -inf opacity 0, a log-scale of -inf a scale of 0; nothing is dropped."""
    columns = raw_columns(2, 0)
    columns["opacity"] = np.array([np.inf, -np.inf])
    columns["scale_1"] = np.array([-np.inf, 0.0])
    scene = load_scene(write_ply(tmp_path / "a.ply", columns))
    assert scene.opacities.tolist() == [1, 0]
    assert scene.scales[:, 1].tolist() == [0, 1]
    assert not scene.dropped


def test_what_cannot_be_drawn_is_dropped_and_counted(tmp_path):
    """One row per fault, one sound row: the sound one stays, each fault is counted by name."""
    columns = raw_columns(8, 1)
    columns["x"][1] = np.nan
    columns["opacity"][2] = np.nan
    columns["scale_0"][3] = 89.0  # e^89 > the largest float32
    columns["rot_2"][4] = np.inf
    for i in range(4):
        columns[f"rot_{i}"][5] = 0
    columns["f_rest_8"][6] = np.inf
    columns["f_dc_0"][7] = np.nan
    scene = load_scene(write_ply(tmp_path / "a.ply", columns))
    assert len(scene) == 1
    assert dict(scene.dropped) == {
        "mean not finite": 1,
        "opacity not a number": 1,
        "scale not finite": 1,
        "quaternion not finite": 1,
        "quaternion of length zero": 1,
        "colour not finite": 2,
    }


def test_signalling_nans_are_dropped_quietly(tmp_path):
    """Any bit pattern of NaN, in any property, is a fault to count and never a warning."""
    columns = raw_columns(14, 0)
    path = write_ply(tmp_path / "a.ply", columns)
    head, rows = path.read_bytes().split(b"end_header\n")
    body = np.frombuffer(rows, "<u4").reshape(14, -1).copy()
    needed = [i for i, name in enumerate(columns) if not name.startswith("n")]
    for row, column in enumerate(needed[:13]):
        body[row, column] = 0x7F800001  # signalling: the quiet bit is not set
    path.write_bytes(head + b"end_header\n" + body.tobytes())
    scene = load_scene(path)
    assert len(scene) == 1
    assert sum(scene.dropped.values()) == 13


def test_raw_opacity(tmp_path):
    """raw_opacity takes opacities as they are; a number outside 0..1 is dropped."""
    columns = raw_columns(4, 0)
    columns["opacity"] = np.array([0, 0.25, 1, 7])
    scene = load_scene(write_ply(tmp_path / "a.ply", columns), raw_opacity=True)
    assert scene.opacities.tolist() == [0, 0.25, 1]
    assert dict(scene.dropped) == {"opacity outside 0..1": 1}


@pytest.mark.parametrize("fmt", [LITTLE, BIG, TEXT])
def test_max_splats_samples_evenly(tmp_path, fmt):
    """A tenth of the rows comes one from each tenth, in order, the same ones on every run."""
    columns = raw_columns(1000, 0)
    columns["x"] = np.arange(1000)
    path = write_ply(tmp_path / "a.ply", columns, fmt=fmt)
    scene = load_scene(path, max_splats=100)
    np.testing.assert_array_equal(scene.means[:, 0] // 10, np.arange(100))
    assert len(set(scene.means[:, 0] % 10)) > 5
    assert dict(scene.dropped) == {"beyond max_splats": 900}
    np.testing.assert_array_equal(scene.means, load_scene(path, max_splats=100).means)


def test_max_splats_above_the_count_keeps_all(tmp_path):
    """A limit the file does not reach changes nothing; a limit below 1 is refused."""
    path = write_ply(tmp_path / "a.ply", raw_columns(7, 0))
    assert len(load_scene(path, max_splats=7)) == 7
    assert not load_scene(path, max_splats=8).dropped
    with pytest.raises(ParamsError, match="max_splats: expected 1 or more, got 0"):
        load_scene(path, max_splats=0)


def test_trailing_bytes_are_allowed(tmp_path):
    """Bytes after the last row are not looked at."""
    path = write_ply(tmp_path / "a.ply", raw_columns(3, 0), trailing=b"\xff" * 1000)
    assert len(load_scene(path)) == 3


def test_an_element_after_the_vertices_is_never_read(tmp_path):
    """Rows of lists behind the vertices may hold anything, even a list of 4 billion items."""
    path = write_ply(tmp_path / "a.ply", raw_columns(3, 0), trailing=b"\xff" * 64)
    text = path.read_bytes().replace(
        b"end_header", b"element face 16\nproperty list uint float f\nend_header"
    )
    path.write_bytes(text)
    assert len(load_scene(path)) == 3
