"""The command line through its real entry point, as a script would call it."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.conftest import ROOT, gaussians, straight
from tests.io import spzwriter
from tsplat.cli import main
from tsplat.commands.info import describe
from tsplat.core import reference
from tsplat.core.params import RenderParams
from tsplat.io.cameras import camera_to_json
from tsplat.plan import make_plan

CAMERA = straight(64, 48, 50.0)


def tsplat(*words, code=0, **kwargs):
    """Runs the installed program; its result, with the exit code checked."""
    program = shutil.which("tsplat", path=str(Path(sys.executable).parent))
    command = [program] if program else [sys.executable, "-m", "tsplat"]
    result = subprocess.run(
        [*command, *map(str, words)], capture_output=True, cwd=kwargs.pop("cwd", ROOT),
        timeout=120, stdin=subprocess.DEVNULL, check=False, **kwargs,
    )  # fmt: skip
    assert result.returncode == code, result.stderr.decode()
    assert b"Traceback" not in result.stderr
    return result


@pytest.fixture
def here(capsys):
    """Runs the command line in this process; what it said on stdout and stderr."""

    def run(*words, code=0):
        try:
            got = main([str(word) for word in words])
        except SystemExit as left:  # argparse's
            got = left.code
        said = capsys.readouterr()
        assert got == code, said.err
        return said.out, said.err

    return run


@pytest.fixture(scope="module")
def scene():
    """Gaussians whose values a PLY keeps to the bit through exp and sigmoid of simple numbers."""
    rng = np.random.default_rng(4)
    return gaussians(
        rng.normal((0, 0, 6), 0.7, (300, 3)), scales=rng.uniform(0.02, 0.3, (300, 3)),
        opacities=rng.uniform(0.05, 0.95, 300), sh=rng.normal(0, 0.3, (300, 4, 3)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def ply(scene, tmp_path_factory):
    """The scene as INRIA's trainer would write it."""
    names = "x y z f_dc_0 f_dc_1 f_dc_2".split() + [f"f_rest_{i}" for i in range(9)]
    names += "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
    rest = scene.sh[:, 1:].transpose(0, 2, 1).reshape(len(scene), 9)  # channel-major
    logits = np.log(scene.opacities / (1 - scene.opacities))[:, None]
    table = np.hstack([
        scene.means, scene.sh[:, 0], rest, logits, np.log(scene.scales), scene.quats
    ]).astype("<f4")  # fmt: skip
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(scene)}"]
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    path = tmp_path_factory.mktemp("scenes") / "scene.ply"
    path.write_bytes("\n".join(header).encode() + table.tobytes())
    return path


@pytest.fixture(scope="module")
def camera_file(ply):
    """Two cameras; the second is twice as large."""
    path = ply.with_name("cameras.json")
    path.write_text(json.dumps([camera_to_json(c) for c in (CAMERA, CAMERA.resized(128, 96))]))
    return path


def test_render_png_is_the_references_picture(scene, ply, camera_file, tmp_path):
    """The file's 8-bit pixels are the reference's, to one level where rounding differs."""
    out = tmp_path / "out.png"
    tsplat("render", ply, "-o", out, "--camera", camera_file)
    got = np.asarray(Image.open(out)).astype(int)
    want = reference.render(scene, CAMERA, RenderParams(float64=True)).to_uint8().astype(int)
    assert got.shape == (48, 64, 3)
    assert want.max() > 100
    assert abs(got - want).max() <= 1
    assert (got != want).mean() < 0.01


@pytest.mark.parametrize("backend", ["numpy", "numba", "cffi", "project=numba,composite=cffi"])
def test_render_npy_is_premultiplied_rgba(scene, ply, camera_file, tmp_path, backend):
    """.npy: float32 [H, W, 4], alpha = 1 - T, no background, from whichever backend."""
    out = tmp_path / "out.npy"
    tsplat("render", ply, "-o", out, "--camera", f"{camera_file}#0", "--backend", backend,
           "--background", "1,0,0")  # fmt: skip
    got = np.load(out)
    assert got.dtype == np.float32
    want = reference.render(scene, CAMERA, RenderParams(float64=True))
    np.testing.assert_allclose(got[..., :3], want.rgb, atol=5e-4)
    np.testing.assert_allclose(got[..., 3], 1 - want.transmittance, atol=5e-4)


def test_render_npz_has_depth_and_the_camera(ply, camera_file, tmp_path):
    """.npz: rgb, transmittance, depth and the camera, which --size has scaled."""
    out = tmp_path / "out.npz"
    tsplat("render", ply, "-o", out, "--camera", f"{camera_file}#1", "--size", "64x48", "--near", 1)
    with np.load(out) as got:
        np.testing.assert_array_equal(got["K"], CAMERA.K)
        np.testing.assert_array_equal(got["viewmat"], CAMERA.viewmat)
        assert got["near"] == 1
        covered = 1 - got["transmittance"]
        middle = covered > 0.5
        depth = got["depth"][middle] / covered[middle]
    assert middle.any()
    assert 3 < depth.min() < depth.max() < 9


def test_render_to_stdout_is_png(ply, camera_file):
    """-o - writes PNG bytes and nothing else to stdout."""
    result = tsplat("render", ply, "-o", "-", "--camera", camera_file)
    assert result.stdout.startswith(b"\x89PNG")
    assert result.stdout.rstrip().endswith(b"IEND\xaeB`\x82")


def test_ideal_differs_from_the_contract_by_its_thresholds(ply, camera_file, tmp_path):
    """--ideal has no thresholds, --float64 has them: close, but not the same."""
    pictures = []
    for flag in ("--ideal", "--float64"):
        tsplat("render", ply, "-o", tmp_path / "x.npy", "--camera", camera_file, flag)
        pictures.append(np.load(tmp_path / "x.npy"))
    gap = abs(pictures[0] - pictures[1]).max()
    assert 1e-5 < gap < 0.05


def test_render_json_has_the_promised_keys(ply, camera_file, tmp_path):
    """One object on stdout; times are minima over the repeats, medians beside them."""
    result = tsplat("render", ply, "-o", tmp_path / "x.png", "--camera", camera_file, "--repeat", 3,
                    "--threads", 1, "--backend", "cffi", "--json")  # fmt: skip
    facts = json.loads(result.stdout)
    stages = ("project", "sort", "bin", "composite")
    assert facts["backend"] == dict.fromkeys(stages, "cffi")
    assert (facts["threads"], facts["width"], facts["height"]) == (1, 64, 48)
    assert facts["gaussians"] == 300
    assert facts["dropped"] == {}
    assert 0 < facts["visible"] <= 300
    assert facts["intersections"] > 0
    assert facts["fused"] == ["sort"]  # tile by tile, where they are composited
    assert set(facts["seconds"]) == {"load", "total", "project", "bin", "composite"}
    assert set(facts["seconds_median"]) == {"total", "project", "bin", "composite"}
    assert facts["seconds"]["total"] <= facts["seconds_median"]["total"]
    assert {"what", "why", "effect"} == set(facts["left_out"][0])


def test_a_pose_may_be_given_in_numbers(ply, tmp_path):
    """--eye, --target, --up with leading minus signs work without an equals sign."""
    out = tmp_path / "x.npz"
    tsplat("render", ply, "-o", out, "--size", "33x17", "--fov", 40,
           "--eye", "-1,-2,-3", "--target", "-0.5,0,6", "--up", "-.1,-1,0")  # fmt: skip
    with np.load(out) as got:
        viewmat = got["viewmat"]
        np.testing.assert_allclose(-viewmat[:3, :3].T @ viewmat[:3, 3], (-1, -2, -3), atol=1e-12)
        np.testing.assert_allclose(got["K"][1, 1], 17 / 2 / np.tan(np.radians(20)))
        assert got["rgb"].shape == (17, 33, 3)


def test_max_splats_keeps_an_even_sample(ply, tmp_path):
    """N rows are kept and the rest are counted."""
    result = tsplat("render", ply, "-o", tmp_path / "x.png", "--max-splats", 100, "--json")
    facts = json.loads(result.stdout)
    assert facts["gaussians"] == 100
    assert sum(facts["dropped"].values()) == 200


def test_max_splats_holds_for_the_demo_too(tmp_path):
    """The scene without a file is sampled as one from a file is."""
    words = ("render", "-o", tmp_path / "x.png", "--size", "8x8", "--json", "--max-splats", 100)
    facts = json.loads(tsplat(*words).stdout)
    assert facts["gaussians"] == 100
    assert list(facts["dropped"]) == ["beyond max_splats"]


def test_info_describes_the_file(ply):
    """Count, degree, bounds and plan, as JSON and as text."""
    facts = json.loads(tsplat("info", ply, "--json").stdout)
    assert facts["gaussians"] == 300
    assert facts["sh_degree"] == 1
    assert facts["backend"]["sort"] == "cffi"
    assert facts["rows"] == "in the file's order"
    text = tsplat("info", ply).stdout.decode()
    assert "in the file's order" in text
    assert "300" in text
    assert "content" in text


def test_info_names_the_level_of_a_ksplat(ply, tmp_path, here):
    """What reads the file, and what matters of the format."""
    from tests.io.splatwriter import drawn, write_ksplat

    path = tmp_path / "a.ksplat"
    write_ksplat(path, [(drawn(50, 2), 2)], 1)
    for file, name in ((ply, "ply"), (path, "ksplat level 1, SH 2")):
        assert json.loads(here("info", file, "--json")[0])["format"] == name
        assert re.search(rf"format +{name} *\n", here("info", file)[0])


@pytest.fixture(scope="module")
def smooth(tmp_path_factory):
    """An SPZ file of small Gaussians that says it was trained with antialiasing."""
    planes = spzwriter.random_planes(400, 3, 1)
    planes[3] = bytes(b % 40 + 70 for b in planes[3])  # sizes of 0.004 to 0.04
    path = tmp_path_factory.mktemp("smooth") / "a.spz"
    path.write_bytes(spzwriter.packed(400, 3, 1, planes, fraction=20, flags=1))
    return path


def test_antialiasing_is_what_the_file_says(smooth, ply, tmp_path, here):
    """Without a word it is on where the file says so; --no-antialias and --antialias overrule."""

    def picture(*words):
        out = tmp_path / "out.npy"
        here("render", *words, "-o", out, "--size", "64x48")
        return np.load(out)

    said, on, off = (
        picture(smooth),
        picture(smooth, "--antialias"),
        picture(smooth, "--no-antialias"),
    )
    assert (said == on).all()
    assert np.abs(on - off).max() > 0.01
    assert (picture(ply) == picture(ply, "--no-antialias")).all()


def test_info_names_the_format(smooth, ply, here):
    """Format, version and what matters of it; of a PLY, its reader's name."""
    facts = json.loads(here("info", smooth, "--json")[0])
    assert (facts["format"], facts["antialias"]) == ("spz 3, SH 1, antialiased", True)
    assert not any(item["what"] == "antialias factor" for item in facts["left_out"])
    text = here("info", smooth)[0]
    assert "spz 3, SH 1, antialiased" in text
    assert "on, as the file says; view, cat, render: --no-antialias" in text
    assert "off, the file does not say" in here("info", ply)[0]
    facts = json.loads(here("info", ply, "--json")[0])
    assert (facts["format"], facts["antialias"]) == ("ply", None)


def test_up_is_known_or_said(ply, tmp_path, here):
    """From a comment, from cameras beside the file, or not at all; --up and --flip-y overrule."""

    def known(path):
        return json.loads(here("info", path, "--json")[0])["up"]

    def picture(path, *words):
        out = tmp_path / "out.npy"
        here("render", path, *words, "-o", out, "--size", "64x48")
        return np.load(out)

    content = ply.read_bytes()  # beside other cameras
    ply = tmp_path / "plain.ply"
    ply.write_bytes(content)
    assert known(ply)["direction"] == [0, -1, 0]
    assert "COLMAP" in known(ply)["why"]
    said = tmp_path / "said.ply"
    words = b"\ncomment Vertical Axis: z\nelement"
    said.write_bytes(content.replace(b"\nelement", words, 1))
    assert known(said) == {"direction": [0, 0, 1], "why": "the file says: Vertical axis: z"}
    np.testing.assert_array_equal(picture(said), picture(ply, "--up", "z"))
    np.testing.assert_array_equal(picture(ply, "--flip-y"), picture(ply, "--up", "0,1,0"))
    np.testing.assert_array_equal(picture(said, "--flip-y"), picture(ply, "--up", "-z"))
    assert np.abs(picture(ply) - picture(said)).max() > 0.1
    beside = tmp_path / "a.ply"
    beside.write_bytes(content)
    placed = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
    frames = {"w": 9, "h": 9, "fl_x": 9, "frames": [{"transform_matrix": placed}]}
    (tmp_path / "transforms.json").write_text(json.dumps(frames))
    assert known(beside)["direction"] == [0, 1, 0]
    assert known(said)["direction"] == [0, 0, 1]
    np.testing.assert_array_equal(picture(beside, "--up=-y"), picture(beside, "--flip-y"))
    (tmp_path / "transforms.json").write_text("{")
    assert known(beside)["direction"] == [0, -1, 0]
    told = here("render", ply, "--up", "z", "--flip-y", "-o", "x.png", code=1)[1]
    assert "leave one out" in told
    told = here("render", ply, "--up", "up", "-o", "x.png", code=2)[1]
    assert "expected x, -x, y, -y, z, -z or three numbers" in told


def test_filters_are_of_every_command(ply, tmp_path, here):
    """info counts what they leave out; render draws the rest; check and bench take the rest."""
    words = ("--min-opacity", "0.4", "--max-scale", "0.2", "--trim", "2")
    facts = json.loads(here("info", ply, "--json", *words)[0])
    assert facts["gaussians"] + sum(facts["dropped"].values()) == 300
    assert set(facts["dropped"]) == {
        "below --min-opacity 0.4", "above --max-scale 0.2", "outside --trim 2",
    }  # fmt: skip
    made = json.loads(
        here("render", ply, *words, "-o", tmp_path / "a.png", "--size", "40x30", "--json")[0]
    )
    assert made["gaussians"] == facts["gaussians"]
    table = json.loads(
        here("check", ply, *words, "--backend", "cffi", "--size", "40x30", "--json")[0]
    )
    assert table["gaussians"] == facts["gaussians"]
    for command in (("render", ply, "-o", tmp_path / "a.png"), ("check", ply), ("bench", ply)):
        told = here(*command, "--max-scale", "1e-9", code=1)[1]
        assert "nothing is left of 300 Gaussians (max_scale=1e-09); filter less" in told


def test_info_says_where_rows_lie(scene):
    """A scene whose rows were moved is said to lie along the curve; numbers take memory too."""
    moved = replace(scene, numbers=np.arange(len(scene), dtype=np.int32))
    facts, before = (describe(one, make_plan(one)) for one in (moved, scene))
    assert facts["rows"] == "along a space-filling curve"
    assert facts["bytes"] - before["bytes"] == 4 * len(scene)


def test_info_says_how_far_off_colours_are(ply, here):
    """float16 and its price by default; float32 and none if asked for."""
    facts = json.loads(here("info", ply, "--json")[0])
    assert facts["sh_dtype"] == "float16"
    assert 0 < facts["sh_error_levels"] < 0.25
    price = f"{facts['sh_error_levels']:.2g} of an 8-bit level"
    assert (
        price in {item["what"]: item["effect"] for item in facts["left_out"]}["SH beyond float16"]
    )
    text = " ".join(here("info", ply)[0].split())
    assert f"SH in float16: largest colour error {price} or less" in text
    full = json.loads(here("info", ply, "--sh-float32", "--json")[0])
    assert full["sh_dtype"] == "float32"
    assert full["sh_error_levels"] == 0
    assert full["bytes"] - facts["bytes"] == 300 * 4 * 3 * 2


@pytest.mark.parametrize("option", ["--sh-float32", "--ideal", "--float64"])
def test_render_in_full_precision(ply, tmp_path, option):
    """Asked for float32, or for what is exact, no colour is rounded; else the plan says it is."""
    words = ("render", ply, "-o", tmp_path / "x.png", "--size", "8x8", "--json")
    whats = [
        {item["what"] for item in json.loads(tsplat(*words, *more).stdout)["left_out"]}
        for more in ((), (option,))
    ]
    assert "SH beyond float16" in whats[0]
    assert "SH beyond float16" not in whats[1]


def test_check_takes_float16_and_float32(ply):
    """The contract holds on the file's colours either way."""
    for more in ((), ("--sh-float32",)):
        words = ("check", ply, "--size", "24x16", "--backend", "cffi", "--json", *more)
        assert json.loads(tsplat(*words).stdout)["passed"]


def test_plugins_lists_what_is_installed():
    """The promised shape, with every built-in available here."""
    facts = json.loads(tsplat("plugins", "--json").stdout)
    rows = {row["name"]: row for row in facts["backends"]}
    assert {"numpy", "numba", "cffi"} <= set(rows)
    for name in ("numpy", "numba", "cffi"):
        assert set(rows[name]) == {
            "name", "summary", "stages", "available", "reason", "distribution",
        }  # fmt: skip
        assert rows[name]["available"] is True
        assert rows[name]["stages"] == ["project", "sort", "bin", "composite"]
    assert {"kitty", "iterm2", "sixel", "halfblock"} <= {r["name"] for r in facts["presenters"]}
    assert b"halfblock" in tsplat("plugins").stdout


def test_check_proves_every_backend(ply, camera_file):
    """All checks of all three backends hold on the scene, and each is told."""
    facts = json.loads(tsplat("check", ply, "--camera", camera_file, "--json").stdout)
    assert facts["passed"] is True
    told = {(c["backend"], c["check"]) for c in facts["checks"]}
    checks = ("project", "sort", "bin", "composite", "picture", "bits", "memory")
    assert told == {(b, c) for b in ("numpy", "numba", "cffi") for c in checks}
    table = tsplat("check", ply, "--backend", "cffi", "--size", "40x30").stdout.decode()
    assert table.count("holds") == 7


BROKEN = """
from tsplat import Backend, Stages, hookimpl
import numpy as np

def sort(splats, workspace):
    return np.arange(len(splats), dtype=np.int32)

@hookimpl
def tsplat_backends():
    return [Backend("unsorted", "does not sort", lambda: Stages(sort=sort), stages=("sort",))]
"""


def test_check_exits_1_when_the_contract_is_broken(ply, camera_file, tmp_path):
    """A plugin that does not sort is found out, named, and fails the command."""
    (tmp_path / "unsorted_plugin.py").write_text(BROKEN)
    info = tmp_path / "unsorted-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: unsorted\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[tsplat]\nunsorted = unsorted_plugin\n")
    result = tsplat(
        "check", ply, "--camera", camera_file, "--backend", "unsorted", code=1,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert b"BROKEN" in result.stdout
    assert b"places differ" in result.stderr


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("view", "SCENE"), "`tsplat render SCENE -o out.png`"),
        (("SCENE",), "tsplat view needs a terminal"),
        (("render", "missing.ply", "-o", "x.png"), "missing.ply: no such file"),
        (("render", "SCENE", "-o", "x.bmp"), ".png"),
        (("render", "SCENE", "-o", "nowhere/x.png"), "nowhere"),
        (("render", "SCENE", "-o", "x.png", "--backend", "nunba"), "installed: cffi, numba, numpy"),
        (("render", "SCENE", "-o", "x.png", "--camera", "CAMERAS#7"), "2"),
        (("render", "SCENE", "-o", "x.png", "--camera", "CAMERAS", "--fov", "3"), "--fov"),
        (("render", "SCENE", "-o", "x.png", "--fov", "190"), "190"),
        (("render", "SCENE", "-o", "x.png", "--near", "5", "--far", "2"), "near < far"),
        (("render", "SCENE", "-o", "x.png", "--size", "99999x99999"), "pixels"),
        (("render", "SCENE", "-o", "-", "--json"), "stdout"),
        (("check", "SCENE", "--backend", "gpu"), "no backend named 'gpu'"),
        (("info", "."), "is a directory"),
    ],
)
def test_errors_are_one_line_and_exit_1(words, text, ply, camera_file, tmp_path):
    """What is wrong and what to do, on stderr, without a traceback; no file is left behind."""
    names = {"SCENE": str(ply), "CAMERAS": str(camera_file)}
    swapped = [w.replace("CAMERAS", names["CAMERAS"]) if "CAMERAS" in w else names.get(w, w)
               for w in words]  # fmt: skip
    result = tsplat(*swapped, code=1, cwd=tmp_path)
    error = result.stderr.decode()
    assert text in error
    assert error.startswith("tsplat: ")
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("x.*"))


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("rendr",), "did you mean 'render'"),
        (("render", "--size", "12"), "WIDTHxHEIGHT"),
        (("render", "-o", "x.png", "--eye", "1,2"), "three finite numbers"),
        (("render", "-o", "x.png", "--eye", "1e200,0,0"), "three finite numbers"),
        (("render", "-o", "x.png", "--background", "255,0,0"), "0 to 1"),
        (("render", "-o", "x.png", "--threads", "0"), "from 1 to 256"),
        (("render",), "-o"),
        (("view", "--sh-degree", "4"), "invalid choice"),
    ],
)
def test_usage_errors_exit_2(words, text):
    """A wrong word on the command line is a usage error that names what was expected."""
    assert text in tsplat(*words, code=2).stderr.decode()


def test_help_shows_examples_and_is_quick_to_import():
    """Every command has help with examples; --help imports neither NumPy nor a kernel."""
    assert b"tsplat render scene.ply -o out.png" in tsplat("--help").stdout
    assert b"keys:" in tsplat("view", "--help").stdout
    code = (
        "import sys; from tsplat.cli import make_parser; make_parser(); print(sorted(sys.modules))"
    )
    listed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    for heavy in ("'numpy'", "'numba'", "'rich'", "'PIL'", "'plyfile'", "'pluggy'", "'shtab'"):
        assert heavy not in listed.stdout


def test_rendering_with_the_c_kernel_imports_nothing_optional(ply, tmp_path):
    """No numba, no hypothesis, no matplotlib, no rich: only what the job needs."""
    code = (
        "import sys; from tsplat.cli import main; "
        f"main(['render', {str(ply)!r}, '-o', {str(tmp_path / 'x.png')!r}, '--size', '32x24']); "
        "print(sorted(m for m in sys.modules if '.' not in m))"
    )
    listed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert "'numpy'" in listed.stdout
    for heavy in ("'numba'", "'llvmlite'", "'matplotlib'", "'hypothesis'", "'rich'", "'torch'"):
        assert heavy not in listed.stdout


def test_completion_scripts_are_printed():
    """A script for each shell, which knows the commands."""
    for shell in ("bash", "zsh", "tcsh"):
        assert b"render" in tsplat("--print-completion", shell).stdout


def test_without_a_scene_the_demo_is_rendered(tmp_path):
    """The built-in scene needs no file and is worth a picture."""
    out = tmp_path / "demo.png"
    facts = json.loads(tsplat("render", "-o", out, "--size", "160x90", "--json").stdout)
    assert facts["gaussians"] > 10_000
    assert np.asarray(Image.open(out)).std() > 10


@pytest.mark.parametrize("words", [("plugins",), ("info", "SCENE"), ("--print-completion", "zsh")])
def test_a_full_disk_is_one_line(ply, words):
    """Output that cannot be written is an error in words."""
    full = [sys.executable, "-m", "tsplat", *(str(ply) if w == "SCENE" else w for w in words)]
    with Path("/dev/full").open("w") as stream:
        run = subprocess.run(full, stdout=stream, stderr=subprocess.PIPE, cwd=ROOT, check=False)
    assert run.returncode == 1
    assert run.stderr.startswith(b"tsplat: standard output cannot be written: No space left")
    assert run.stderr.count(b"\n") == 1


@pytest.mark.parametrize("closed", ["1>&-", "2>&-", "1>&- 2>&-"])
def test_closed_streams_do_not_stop_the_work(ply, tmp_path, closed):
    """The picture is made and the exit code is 0 although there is nobody to tell."""
    out = tmp_path / "x.png"
    command = f"exec {sys.executable} -m tsplat render {ply} -o {out} --size 32x24 {closed}"
    assert subprocess.run(["sh", "-c", command], cwd=ROOT, check=False).returncode == 0
    assert out.is_file()


def test_the_version_comes_from_one_place():
    """The installed metadata, the module and the program agree."""
    from importlib.metadata import version

    from tsplat import __version__

    assert tsplat("--version").stdout.decode().split() == ["tsplat", __version__]
    assert version("tsplat") == __version__


def test_a_closed_pipe_is_no_error_message(ply):
    """`tsplat info | head -0` ends quietly."""
    program = [sys.executable, "-m", "tsplat", "info", str(ply), "--json"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT) as p:
        p.stdout.close()
        assert p.stderr.read() == b""


def test_bench_prints_a_table_and_writes_its_files(ply, tmp_path):
    """Presets in both fast backends; the diagram, the CSV and the JSON tell of the same rows."""
    words = ("bench", ply, "--size", "40x30", "--cameras", 1, "--runs", 1, "--presets")
    told = tsplat(*words, "--csv", tmp_path / "a.csv", "-o", tmp_path / "a.svg").stdout.decode()
    for word in ("cffi", "numba", "exact", "contract", "balanced", "fast", "SSIM"):
        assert word in told
    assert "numpy" not in told
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 * 4
    assert lines[0].startswith("backend,setting,seconds,")
    assert b"<svg" in (tmp_path / "a.svg").read_bytes()
    facts = json.loads(tsplat(*words, "--json", "--set", "scale=0.5", "--backend", "cffi").stdout)
    assert [row["setting"] for row in facts["rows"]] == [
        "exact", "contract", "balanced", "fast", "scale=0.5",
    ]  # fmt: skip
    worst = {row["setting"]: row["worst"] for row in facts["rows"]}
    assert worst["exact"] < 0.1 < worst["contract"] < worst["fast"]
    assert set(facts["rows"][0]["stages"]) >= {"project", "composite"}
    assert not facts["interrupted"]


def test_bench_refuses_what_it_cannot_do_before_it_measures(ply, tmp_path, here):
    """A suffix it cannot draw, no such folder, a screen that is none, a wrong setting."""
    for words, told in (
        (("-o", tmp_path / "a.gif"), "expected a name in .png or .svg"),
        (("--csv", tmp_path / "no" / "a.csv"), "cannot write in"),
        (("--show",), "--show needs a terminal"),
        (("--set", "speed=2"), "expected NAME=VALUE"),
        (("--backend", "nosuch"), "nosuch"),
    ):
        assert told in here("bench", ply, *words, code=1)[1]


def test_bench_keeps_what_is_done_on_ctrl_c(ply):
    """Interrupted while it times, it prints what it has and exits with 130."""
    code = (
        "import sys, tsplat.quality.sweep as s, tsplat.cli as c\n"
        "steps = s.Sweep.steps\n"
        "def some(self):\n"
        "    for i, x in enumerate(steps(self)):\n"
        "        yield x\n"
        "        if i == 6: raise KeyboardInterrupt\n"
        "s.Sweep.steps = some\n"
        "sys.exit(c.main(sys.argv[1:]))\n"
    )
    words = ["bench", str(ply), "--size", "20x20", "--cameras", "1", "--presets", "--json",
             "--backend", "cffi", "--runs", "3"]  # fmt: skip
    result = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, check=False)
    assert result.returncode == 130, result.stderr
    facts = json.loads(result.stdout)
    assert facts["interrupted"] is True
    assert [row["setting"] for row in facts["rows"]] == ["exact", "contract"]


def test_quality_changes_the_picture_and_says_so(ply, tmp_path):
    """fast is another picture than contract; the JSON names the settings and what is left out."""
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps(camera_to_json(CAMERA)))
    pictures = {}
    for quality in ("exact", "contract", "fast"):
        out = tmp_path / f"{quality}.npy"
        facts = json.loads(
            tsplat("render", ply, "-o", out, "--camera", camera, "--quality", quality, "--json")
            .stdout
        )  # fmt: skip
        pictures[quality] = np.load(out)
        asked = any("tsplat bench" in item["effect"] for item in facts["left_out"])
        assert asked == (quality == "fast")
        assert facts["settings"] == quality
    exact = pictures["exact"]
    off = {name: abs(picture - exact).max() for name, picture in pictures.items()}
    assert off["contract"] > 1e-3
    assert off["fast"] > 2 * off["contract"]


def test_max_error_says_what_it_picked(ply, tmp_path):
    """On stderr in words, in the JSON in numbers; it does not go with other settings."""
    out = tmp_path / "a.png"
    result = tsplat("render", ply, "-o", out, "--size", "64x48", "--max-error", "2,4", "--json")
    facts = json.loads(result.stdout)
    assert facts["calibration"]["worst"] <= 4
    assert facts["calibration"]["p999"] <= 2
    assert b"measured on 3 cameras" in result.stderr
    for words, told in (
        (("--max-error", "1", "--quality", "fast"), b"leave out --quality"),
        (("--max-error", "none"), b"expected E or P999,WORST"),
        (("--max-error", "1", "--ideal"), b"leave no choice"),
        (("--set", "scale=3"), b"expected 0 < value <= 1"),
    ):
        assert told in tsplat("render", ply, "-o", out, *words, code=1).stderr


def test_garbage_is_collected_while_a_command_runs():
    """It is left alone only while modules are imported, and at exit."""
    code = (
        "import gc, sys, tsplat.cli, tsplat.commands.plugins as command;"
        "command.run = lambda arguments: print(gc.isenabled()) or 0;"
        "sys.argv = ['tsplat', 'plugins']; tsplat.cli.main()"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert result.stdout == "True\n"
