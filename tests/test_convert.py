"""``tsplat convert``: exact where it can be, whole or not at all, and honest about what it cost."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.conftest import gaussians, hear_signals
from tests.io.plywriter import BIG, LITTLE, TEXT, raw_columns, write_ply
from tests.io.realdata import needs_data
from tests.io.writing import by_plyfile, check, drawn
from tsplat import load_scene, render, save_scene
from tsplat.cli import main
from tsplat.core.camera import look_at
from tsplat.core.errors import OutputError
from tsplat.io.write.source import Source
from tsplat.quality.converted import angles, field_errors, picture_errors, standard_views
from tsplat.views import up_of

SMALL = ["--size", "64x36"]


def inria(path, n=300, degree=3, seed=0, **changed):
    """A file as INRIA's trainer writes it; ``changed`` columns replace drawn ones."""
    columns = raw_columns(n, degree, seed)
    for name in ("nx", "ny", "nz"):
        columns[name] = np.zeros(n)
    columns |= changed
    table = np.stack([columns[name] for name in columns], 1).astype("<f4")
    lines = [f"property float {name}" for name in columns]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {n}", *lines]
    path.write_bytes("\n".join([*head, "end_header", ""]).encode() + table.tobytes())
    return table


def facts(capsys, *words):
    """What ``tsplat convert --json`` says."""
    assert main(["convert", *map(str, words), "--json", *SMALL]) == 0
    return json.loads(capsys.readouterr().out)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(n=st.sampled_from([1, 7, 256, 20_000]), degree=st.integers(0, 3), seed=st.integers(0, 99))
def test_a_ply_file_made_of_inrias_is_the_same_file(tmp_path, n, degree, seed):
    """Byte for byte: logits, logarithms and quaternions of any length are not decoded."""
    inria(tmp_path / "a.ply", n, degree, seed)
    arguments = [str(tmp_path / "a.ply"), str(tmp_path / "b.ply"), "--force", "--no-measure"]
    assert main(["convert", *arguments]) == 0
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()


def test_rows_that_cannot_be_drawn_are_left_out_and_named(tmp_path, capsys):
    """The others keep their numbers and their order; infinite logits stay as they are."""
    x = np.arange(300.0)
    x[[5, 77]] = np.nan
    opacity = np.full(300, 0.25)
    opacity[3] = np.inf
    rot = np.ones(300)
    rot[9] = np.inf
    table = inria(tmp_path / "a.ply", x=x, opacity=opacity, rot_0=rot)
    found = facts(capsys, tmp_path / "a.ply", tmp_path / "b.ply")
    assert found["left_out"] == {"mean not finite": 2, "quaternion not finite": 1}
    assert (found["rows_in"], found["rows_out"], found["exact"]) == (300, 297, True)
    kept = np.delete(table, [5, 9, 77], 0)
    assert (tmp_path / "b.ply").read_bytes().endswith(b"end_header\n" + kept.tobytes())


@pytest.mark.parametrize("fmt", [LITTLE, BIG, TEXT])
def test_other_kinds_of_ply_become_inrias(tmp_path, capsys, fmt):
    """Any byte order, text, another order of properties, a further one: the same float32s."""
    from tests.io.plywriter import write_ply
    from tests.io.test_ply_variants import names_inria

    columns = raw_columns(40, 2)
    columns = {name: np.float32(values) for name, values in columns.items()}
    names = sorted(names_inria(2)) + ["weight"]
    columns["weight"] = np.ones(40, np.float32)
    write_ply(tmp_path / "a.ply", {n: columns[n] for n in names}, fmt=fmt)
    found = facts(capsys, tmp_path / "a.ply", tmp_path / "b.ply")
    assert "left out: properties weight" in found["not_held"]
    out = by_plyfile(tmp_path / "b.ply")
    assert np.array_equal(out.means[:, 1], columns["y"])
    assert np.array_equal(out.quats[:, 3], columns["rot_3"])
    assert np.array_equal(out.logs[:, 0], columns["scale_0"])
    assert np.array_equal(out.sh[:, 8, 1], columns["f_rest_15"])


def test_edits_cut_rows_and_change_values(tmp_path, capsys):
    """What is cut is not in the file, what is left is the file's own but for what was changed."""
    opacity = np.where(np.arange(300) % 3, 4.0, -6.0)
    table = inria(tmp_path / "a.ply", degree=1, opacity=opacity)
    found = facts(
        capsys, tmp_path / "a.ply", tmp_path / "b.ply", "--min-opacity", "0.5",
        "--crop", "-1,-1,-1,9,9,9", "--splat-scale", "2",
    )  # fmt: skip
    keep = (opacity > 0) & (table[:, :3] >= -1).all(1) & (table[:, :3] <= 9).all(1)
    assert 0 < keep.sum() < 300
    assert sum(found["left_out"].values()) == 300 - keep.sum()
    assert set(found["left_out"]) == {"outside --crop", "below --min-opacity 0.5"}
    out = by_plyfile(tmp_path / "b.ply")
    assert np.array_equal(out.means, table[keep, :3])
    assert np.array_equal(out.quats, table[keep, -4:])
    np.testing.assert_allclose(out.logs, table[keep, -7:-4] + np.log(2), rtol=1e-6)
    facts(capsys, tmp_path / "a.ply", tmp_path / "c.ply", "--saturation", "0")
    grey = by_plyfile(tmp_path / "c.ply").sh
    assert np.ptp(grey, axis=2).max() < 1e-5
    assert np.array_equal(by_plyfile(tmp_path / "c.ply").logs, table[:, -7:-4])


def test_bands_and_samples_are_left_out(tmp_path, capsys):
    """--sh-degree drops bands, --max-splats rows; what stays is the file's own."""
    table = inria(tmp_path / "a.ply", degree=3)
    found = facts(
        capsys, tmp_path / "a.ply", tmp_path / "b.ply", "--sh-degree", "1", "--max-splats", "100"
    )
    assert found["rows_out"] == 100
    assert found["left_out"] == {"beyond max_splats": 200}
    out = by_plyfile(tmp_path / "b.ply")
    rows = [int(np.flatnonzero((table[:, :3] == mean).all(1))[0]) for mean in out.means]
    assert rows == sorted(rows)
    # f_rest is channel-major: of 45, a channel's first three
    assert np.array_equal(out.sh[:, 1:, 2], table[rows, 9 + 30 : 9 + 33])


def test_a_sample_of_a_file_with_rows_that_cannot_be_drawn(tmp_path, capsys):
    """Sampled, dropped and cut rows at once: the others are still the file's own."""
    x = np.random.default_rng(3).normal(size=20_000)
    x[::7] = np.nan
    table = inria(tmp_path / "a.ply", 20_000, 0, x=x)
    out = tmp_path / "b.ply"
    options = ["--max-splats", "9000", "--crop", "-1,-9,-9,9,9,9"]
    found = facts(capsys, tmp_path / "a.ply", out, *options)
    assert set(found["left_out"]) == {"beyond max_splats", "mean not finite", "outside --crop"}
    assert sum(found["left_out"].values()) + found["rows_out"] == found["rows_in"] == 20_000
    assert all(e["worst"] == 0 for e in found["fields"].values())
    made = np.frombuffer(out.read_bytes().split(b"end_header\n", 1)[1], "<f4").reshape(-1, 17)
    place = {row.tobytes(): i for i, row in enumerate(table)}
    rows = [place[row.tobytes()] for row in made]
    assert rows == sorted(rows)
    assert len(rows) == found["rows_out"]


def test_doubles_stay_doubles_where_that_matters(tmp_path, capsys):
    """Positions 1e7 from zero with a size of 1e-3: the PLY has the very float64s of the file."""
    from tests.io.plywriter import write_ply

    columns = raw_columns(50, 0)
    columns |= {"x": columns["x"] + 1e7, **{f"scale_{i}": np.full(50, -7.0) for i in range(3)}}
    types = dict.fromkeys("xyz", "double")
    write_ply(tmp_path / "a.ply", columns, types=types)
    found = facts(capsys, tmp_path / "a.ply", tmp_path / "b.ply")
    assert any("positions are doubles" in note for note in found["not_held"])
    assert np.array_equal(by_plyfile(tmp_path / "b.ply").means[:, 0], columns["x"])


@pytest.mark.parametrize("fmt", ["ply", "compressed.ply", "splat", "spz"])
def test_the_summary_is_what_was_measured(tmp_path, capsys, fmt):
    """Rows, bytes, errors of fields and pictures, in JSON and in words."""
    inria(tmp_path / "a.ply", degree=1)
    out = tmp_path / f"b.{fmt}"
    found = facts(capsys, tmp_path / "a.ply", out)
    assert (found["rows_in"], found["rows_out"]) == (300, 300)
    assert found["bytes_in"] == (tmp_path / "a.ply").stat().st_size
    assert found["bytes_out"] == out.stat().st_size
    assert found["exact"] == (fmt == "ply")
    assert found["reordered"] == (fmt == "compressed.ply")
    scene, back = (load_scene(f, sh_float32=True) for f in (tmp_path / "a.ply", out))
    cameras = standard_views(scene, [], (64, 36))
    psnr = [e.psnr for e in picture_errors(scene, back, cameras)]
    if fmt == "ply":
        assert found["pictures"]["psnr_worst"] is None, "infinite"
        assert all(e["worst"] == 0 for e in found["fields"].values())
    else:
        assert found["pictures"]["psnr_worst"] == pytest.approx(min(psnr))
        assert found["fields"]["opacity"]["worst"] > 1e-4
    assert main(["convert", str(tmp_path / "a.ply"), str(out), "--force", *SMALL]) == 0
    said = capsys.readouterr().out
    assert "300" in said
    assert "PSNR" in said
    assert ("each number is the file's own" in said) == (fmt == "ply")


def test_pictures_and_fields_show_a_wrong_file():
    """A scene with one thing changed is off in that field, and in its picture."""
    scene = drawn(200, 1, 0, wild=0.0)
    views = standard_views(scene, [], (64, 36))
    assert {e.psnr for e in picture_errors(scene, scene, views)} == {np.inf}
    turned = scene.quats[:, [0, 2, 1, 3]].copy()
    other = gaussians(scene.means, scene.scales, scene.opacities, quats=turned, sh=scene.sh)
    off = {e.field: e.worst for e in field_errors(Source(scene), None, Source(other))}
    assert off.pop("rotation") > 90
    assert set(off.values()) == {0}
    assert max(e.psnr for e in picture_errors(scene, other, views)) < 60
    with pytest.raises(OutputError, match="holds 200 Gaussians, expected 10"):
        field_errors(Source(scene.take(np.arange(10))), None, Source(scene))


def test_angles_are_those_of_rotations():
    """Half of the angle is in the quaternion; signs do not matter; small ones are not lost."""
    for degrees in (0.0, 1e-5, 0.3, 90.0, 179.9):
        half = np.radians(degrees) / 2
        q = np.array([[np.cos(half), np.sin(half), 0, 0]])
        one = np.array([[1.0, 0, 0, 0]])
        assert angles(q, one)[0] == pytest.approx(degrees, rel=1e-6)
        assert angles(-q, one)[0] == pytest.approx(degrees, rel=1e-6)


def test_own_cameras_are_used_too(tmp_path, capsys):
    """cameras.json beside the scene: up to four of them, at about the same number of pixels."""
    inria(tmp_path / "a.ply")
    camera = {
        "id": 0, "img_name": "a", "width": 1000, "height": 500, "position": [0, 0, -9],
        "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 700, "fy": 700,
    }  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps([{**camera, "id": i} for i in range(9)]))
    found = facts(capsys, tmp_path / "a.ply", tmp_path / "b.spz")
    assert (found["pictures"]["count"], found["pictures"]["own_cameras"]) == (8, 4)


def test_the_file_that_is_read_may_be_replaced(tmp_path, capsys):
    """IN is OUT: refused without --force, and right with it."""
    inria(tmp_path / "a.ply", degree=2)
    before = (tmp_path / "a.ply").read_bytes()
    words = ["convert", str(tmp_path / "a.ply"), str(tmp_path / "a.ply")]
    assert main(words) == 1
    assert "exists; choose another name, or --force" in capsys.readouterr().err
    assert (tmp_path / "a.ply").read_bytes() == before
    assert main([*words, "--force", "--sh-degree", "1", *SMALL]) == 0
    assert load_scene(tmp_path / "a.ply").sh_degree == 1
    link = tmp_path / "link.ply"
    link.symlink_to(tmp_path / "a.ply")
    assert main(["convert", str(link), str(link), "--force", "--no-measure"]) == 0
    assert link.is_symlink()


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["a.ply"], 2, "the following arguments are required: OUT"),
        (["a.ply", "b.spz", "--sh-bits", "9"], 2, "expected 1 to 8"),
        (["a.ply", "b.spz", "--fractional-bits", "24"], 2, "a whole number from 0 to 23"),
        (["a.ply", "b.spz", "--sh-degree", "4"], 2, "invalid choice"),
        (["a.ply", "b.spz", "--format-version", "1"], 1, "versions 2, 3 and 4, got 1"),
        (["a.ply", "b.ply", "--sh-bits", "5,4"], 1, "sh_bits (--sh-bits) is not for ply"),
        (["a.ply", "b.gltf"], 1, "known: .compressed.ply, .ply, .splat, .spz"),
        (["a.ply", "b.ply", "--to", "gltf"], 1, "no writer named 'gltf'"),
        (["a.ply", "b.splat", "--sh-degree", "2"], 1, "harmonics up to degree 0, got 2"),
        (
            ["a.ply", "b.ply", "--crop", "1e5,0,0,2e5,1,1"],
            1,
            "nothing is left of 5 Gaussians",
        ),
        (["none.ply", "b.ply"], 1, "no such file"),
        (["a.ply", "no/b.ply"], 1, "no directory"),
    ],
    ids=lambda x: " ".join(x[1:]) if isinstance(x, list) else "",
)
def test_what_cannot_be_done_is_one_line(tmp_path, monkeypatch, capsys, words, code, text):
    """Exit code 2 for a command line that cannot be read, 1 for an error; no file is left."""
    monkeypatch.chdir(tmp_path)
    inria(tmp_path / "a.ply", 5)
    if code == 2:
        with pytest.raises(SystemExit) as left:
            main(["convert", *words])
        assert left.value.code == 2
    else:
        assert main(["convert", *words]) == 1
    said = capsys.readouterr()
    assert text in said.err
    assert "Traceback" not in said.err
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


def _child(tmp_path, *words, before=hear_signals):
    return subprocess.Popen(
        [sys.executable, "-m", "tsplat", "convert", *words],
        cwd=tmp_path, preexec_fn=before,  # noqa: PLW1509 - a limit or signals
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip


def test_a_full_disk_is_an_error_and_leaves_nothing(tmp_path):
    """A file that cannot grow (RLIMIT_FSIZE): one line, exit code 1, the old one is whole."""
    inria(tmp_path / "a.ply", 5000)
    (tmp_path / "b.ply").write_bytes(b"old")

    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, 500_000))

    child = _child(tmp_path, "a.ply", "b.ply", "--force", before=limited)
    said = child.communicate()[1].decode()
    assert child.returncode == 1
    assert "b.ply: cannot be written: File too large" in said
    assert (tmp_path / "b.ply").read_bytes() == b"old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.ply", "b.ply"]


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_in_the_middle_leaves_nothing(tmp_path, signum):
    """Ctrl-C, SIGTERM and a lost line while bytes are written: no half file, nothing beside it."""
    inria(tmp_path / "a.ply", 150_000, 3)
    child = _child(tmp_path, "a.ply", "b.spz")
    while child.poll() is None and len(list(tmp_path.iterdir())) < 2:
        time.sleep(0.002)
    child.send_signal(signum)
    child.communicate()
    assert child.returncode == (130 if signum == signal.SIGINT else 128 + signum)
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


def test_interrupted_while_it_measures_it_says_what_is_there(tmp_path, monkeypatch, capsys):
    """The file is written and whole; only how far it is off is not known."""
    inria(tmp_path / "a.ply", 20)

    def interrupted(*words, **named):
        raise KeyboardInterrupt

    monkeypatch.setattr("tsplat.quality.converted.field_errors", interrupted)
    words = [str(tmp_path / name) for name in ("a.ply", "b.splat")]
    assert main(["convert", *words]) == 130
    assert "b.splat: written, but not measured: interrupted" in capsys.readouterr().err
    assert len(load_scene(tmp_path / "b.splat")) == 20


def test_plugins_are_writers_too(tmp_path, monkeypatch, capsys):
    """A row of tsplat_writers is chosen by its suffix and its file is whole."""
    from tsplat import Writer, Written, hookimpl
    from tsplat.plugins import Registry, _add, plugins

    class Module:
        @hookimpl
        def tsplat_writers(self):
            def write(source, out, options):
                out.write(b"%d" % len(source))
                return Written("a count", notes=("nothing else is held",))

            return [Writer("count", "how many", (".count",), lambda: write)]

    class Bad:
        @hookimpl
        def tsplat_writers(self):
            return [Writer("bad", "no dot", ("count",), lambda: None)]

    registry = Registry()
    _add(registry, "mine", "dist", Module())
    _add(registry, "bad", "dist", Bad())
    assert "begin with a dot" in str(registry.problems[0])
    monkeypatch.setitem(plugins().writers, "count", registry.writers["count"])
    inria(tmp_path / "a.ply", 12)
    words = ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.count")]
    assert main([*words, "--no-measure"]) == 0
    assert "nothing else is held" in capsys.readouterr().out
    assert (tmp_path / "b.count").read_bytes() == b"12"
    assert main([*words, "--force"]) == 1
    assert "written, but it cannot be measured" in capsys.readouterr().err


SOURCES = [
    "formats/leica-8k-sh3/leica-8k-sh3.niantic-v4.spz",
    "formats/leica-8k-sh3/leica-8k-sh3.niantic-v2.spz",
    "formats/leica-8k-sh3/leica-8k-sh3.sog",
    "formats/leica-8k-sh3/leica-8k-sh3.glb",
    "formats/leica-8k-sh3/leica-8k-sh3.mk-l1-sh2.ksplat",
    "formats/leica-8k-sh3/leica-8k-sh3.compressed.ply",
    "formats/leica-8k-sh3/leica-8k-sh3.am15.splat",
]


@needs_data
@pytest.mark.parametrize("name", SOURCES)
def test_every_format_that_is_read_becomes_a_ply_of_the_same_scene(tmp_path, data, name):
    """Real files of all kinds: the PLY has what the reader found, as plyfile reads it."""
    scene = load_scene(data / name, sh_float32=True)
    assert main(["convert", str(data / name), str(tmp_path / "a.ply"), "--no-measure"]) == 0
    source = Source(scene)
    found = by_plyfile(tmp_path / "a.ply")
    assert np.array_equal(found.means, source.means(slice(None)))
    assert np.array_equal(found.sh, source.sh(slice(None)))


@needs_data
def test_what_was_quantised_once_is_not_worse_the_second_time(tmp_path, data):
    """SPZ to SPZ of the same bits gives the same planes: every value is a bucket's centre."""
    path = data / "formats" / "leica-8k-sh3" / "leica-8k-sh3.niantic-v3.spz"
    assert main(["convert", str(path), str(tmp_path / "a.spz"), "--no-measure"]) == 0
    a, b = (load_scene(f, sh_float32=True) for f in (path, tmp_path / "a.spz"))
    a, b = Source(a), Source(b)
    off = {e.field: e.worst for e in field_errors(a, None, b)}
    assert off.pop("rotation") < 0.25, "of two as large, another may be left out"
    assert off.pop("scale") < 1e-6
    assert set(off.values()) == {0}
    turned = angles(*(s.quats(slice(None)).astype(float) for s in (a, b)))
    assert np.mean(turned > 1e-4) < 0.01


TOOL = os.environ.get("TSPLAT_SPLAT_TRANSFORM") or shutil.which("splat-transform")


@pytest.mark.skipif(TOOL is None, reason="no splat-transform; npm i -g @playcanvas/splat-transform")
@pytest.mark.parametrize("fmt", ["ply", "compressed.ply"])
def test_splat_transform_reads_what_is_written(tmp_path, fmt):
    """PlayCanvas' own tool makes a PLY of it that is the scene, within the format's steps."""
    scene = drawn(700, 3, 11, wild=0.0)
    written = save_scene(scene, tmp_path / f"a.{fmt}")
    made = tmp_path / "made.ply"
    subprocess.run([TOOL, "-q", tmp_path / f"a.{fmt}", made], check=True, capture_output=True)
    check(fmt, scene, by_plyfile(made), written)


@pytest.mark.parametrize("axis", ["z", "-x", "0.5 -0.7 0.3", "0 -1 0", None])
@pytest.mark.parametrize("name", ["b.ply", "b.compressed.ply", "b.spz"])
def test_a_scene_that_says_its_up_is_turned_over(tmp_path, capsys, name, axis):
    """What was above is below; what is said to be up still is, where the format can say it."""
    comments = [] if axis is None else [f"Vertical axis: {axis}"]
    columns = raw_columns(50, 3)
    write_ply(tmp_path / "a.ply", columns, comments=comments)
    facts(capsys, tmp_path / "a.ply", tmp_path / name, "--flip-y", "--no-measure")
    before, after = load_scene(tmp_path / "a.ply"), load_scene(tmp_path / name)
    up = np.array(up_of(before).direction)
    up /= np.linalg.norm(up)
    if name != "b.spz":
        np.testing.assert_allclose(np.array(up_of(after).direction) / np.linalg.norm(
            up_of(after).direction), up, atol=1e-6)  # fmt: skip
        assert b" -0" not in (tmp_path / name).read_bytes().partition(b"end_header")[0].replace(
            b" -0.", b"")  # fmt: skip
    heights = [np.sort((scene.means + scene.origin) @ up) for scene in (before, after)]
    spread = np.ptp(before.means, axis=0).max()
    np.testing.assert_allclose(heights[1], -heights[0][::-1], atol=spread / 500)


def test_a_scene_on_its_head_is_turned(tmp_path, capsys):
    """--flip-y turns by 180 degrees about x: the picture of a camera that was turned with it."""
    inria(tmp_path / "a.ply", 200, 3)
    told = facts(capsys, tmp_path / "a.ply", tmp_path / "b.ply", "--flip-y")
    assert not told["exact"]
    before, after = load_scene(tmp_path / "a.ply"), load_scene(tmp_path / "b.ply")
    np.testing.assert_allclose(after.means, before.means * [1, -1, -1], rtol=1e-6)
    eye, target, up = np.array([1.0, -2, -5]), np.array([0.2, 0.1, 0]), np.array([0.0, -1, 0.3])
    turned = np.array([1, -1, -1])
    pictures = [
        render(scene, look_at(eye * by, target * by, up * by, 50, 64, 48)).rgb
        for scene, by in ((before, np.ones(3)), (after, turned), (after, np.ones(3)))
    ]
    np.testing.assert_allclose(pictures[0], pictures[1], atol=1e-4)
    assert np.abs(pictures[0] - pictures[2]).max() > 0.1
    facts(capsys, tmp_path / "b.ply", tmp_path / "c.ply", "--flip-y")
    again = load_scene(tmp_path / "c.ply")
    np.testing.assert_array_equal(again.means, before.means)
    np.testing.assert_allclose(again.sh, before.sh, atol=1e-6)
