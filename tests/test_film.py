"""``tsplat render --path``: every frame is the picture that ``render`` makes from there."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from PIL import Image

from tests.conftest import ROOT, hear_signals
from tests.test_cli import ply, scene, tsplat  # noqa: F401 - fixtures
from tsplat.core.camera import look_at
from tsplat.io.cameras import camera_to_json
from tsplat.presenters.base import Terminal
from tsplat.testing.decoders import halfblock

EYES = [(0, 0, 0), (2, -1, 1), (3, 0, 4)]


@pytest.fixture(scope="module")
def path_file(ply):  # noqa: F811
    """Three cameras that look at the scene, two seconds apart."""
    cameras = [look_at(eye, (0, 0, 6), (0, -1, 0), 45 + i, 64, 48) for i, eye in enumerate(EYES)]
    file = ply.with_name("path.json")
    entries = [{**camera_to_json(c), "time": 2 * i} for i, c in enumerate(cameras)]
    file.write_text(json.dumps(entries))
    return file


def film(*words, code=0, **kwargs):
    """The facts that --json prints."""
    result = tsplat("render", *words, "--json", code=code, **kwargs)
    return json.loads(result.stdout)


def picture(file):
    with Image.open(file) as image:
        return np.asarray(image)


def test_a_path_begins_and_ends_at_its_poses(ply, path_file, tmp_path):  # noqa: F811
    """Poses are at their times; those frames are render's pictures to the bit, others are not."""
    facts = film(ply, "--path", path_file, "--fps", 1, "-o", tmp_path / "f-%02d.png")
    assert (facts["frames"], facts["width"], facts["height"]) == (5, 64, 48)
    assert (facts["format"], facts["rendered"], facts["kept"]) == ("png", 5, 0)
    stills = []
    for pose in range(3):
        out = tmp_path / "still.png"
        tsplat("render", ply, "-o", out, "--camera", f"{path_file}#{pose}")
        stills.append(picture(out))
    frames = [picture(tmp_path / f"f-0{i}.png") for i in range(5)]
    for i in range(5):
        equal = [np.array_equal(frames[i], still) for still in stills]
        assert equal == [i == 0, i == 2, i == 4]


def test_an_orbit_begins_at_renders_view(ply, tmp_path):  # noqa: F811
    """With whatever camera options; the half of it looks from the other side; it does not end."""
    view = ("--eye", "1,-2,-1", "--fov", 40, "--size", "40x30", "--quality", "exact")
    facts = film(ply, "--path", "orbit", "--frames", 4, *view, "-o", tmp_path / "turn")
    tsplat("render", ply, "-o", tmp_path / "still.png", *view)
    still = picture(tmp_path / "still.png")
    frames = [picture(tmp_path / "turn" / f"000{i}.png") for i in range(4)]
    np.testing.assert_array_equal(frames[0], still)
    assert all((frames[i] != still).any() for i in (1, 2, 3))
    assert facts["settings"] == "exact"


@pytest.mark.parametrize("name", ["a.gif", "a.webp"])
def test_an_animation_has_all_frames(ply, path_file, tmp_path, name):  # noqa: F811
    """As many as asked for, the first and the last close to render's."""
    facts = film(ply, "--path", path_file, "--frames", 4, "-o", tmp_path / name,
                 "--background", "0.2,0.2,0.2")  # fmt: skip
    assert facts["format"] == name[2:]
    assert facts["bytes"] == (tmp_path / name).stat().st_size
    with Image.open(tmp_path / name) as got:
        assert (got.n_frames, got.size) == (4, (64, 48))
        ends = []
        for frame in (0, 3):
            got.seek(frame)
            ends.append(np.asarray(got.convert("RGB")).astype(int))
    stills = []
    for pose in (0, 2):
        tsplat("render", ply, "-o", tmp_path / "still.png", "--camera", f"{path_file}#{pose}",
               "--background", "0.2,0.2,0.2")  # fmt: skip
        stills.append(picture(tmp_path / "still.png").astype(int))
    for end, still, other in zip(ends, stills, stills[::-1], strict=True):
        assert abs(end - still).mean() < abs(end - other).mean() / 3


def test_a_recording_is_the_picture_in_cells(ply, path_file, tmp_path):  # noqa: F811
    """--size counts cells; the first screen and the last are what `tsplat cat` prints there."""
    out = tmp_path / "a.cast"
    film(ply, "--path", path_file, "--frames", 3, "--fps", 2, "--size", "32x12", "-o", out)
    header, *events = map(json.loads, out.read_text("utf-8").splitlines())
    assert (header["width"], header["height"], len(events)) == (32, 12, 4)
    assert [event[0] for event in events] == [0, 0.5, 1, 1.5]
    sent = itertools.accumulate(data.encode() for _, _, data in events)
    seen = [halfblock(data, Terminal(32, 13)) for data in sent]
    for pose, halves in ((0, seen[0]), (2, seen[-1])):
        lines = tsplat("cat", ply, "--camera", f"{path_file}#{pose}", "--columns", 32,
                       "--rows", 12).stdout.splitlines()  # fmt: skip
        for row, line in enumerate(lines):
            alone = halfblock(line, Terminal(32, 2))
            np.testing.assert_array_equal(alone, halves[2 * row : 2 * row + 2])
    assert (seen[0] != seen[1]).any()


def test_a_sequence_goes_on(ply, path_file, tmp_path):  # noqa: F811
    """Frames that are there are kept and that is said; another camera, quality or scene is not."""
    words = (ply, "--path", path_file, "--frames", 3, "-o", tmp_path / "f-%d.png")
    assert film(*words)["rendered"] == 3
    (tmp_path / "f-1.png").unlink()
    told = tsplat("render", *words).stderr.decode()
    assert "2 of 3 frames were there and are kept; --force makes them again" in told
    assert film(*words)["kept"] == 3
    assert film(*words, "--force")["kept"] == 0
    assert film(*words, "--threads", 1, "--backend", "numba")["kept"] == 3  # the same picture
    for other in (("--quality", "fast"), ("--far", "7"), ("--background", "1,1,1"),
                  ("--max-splats", "200"), ("--size", "32x24")):  # fmt: skip
        assert film(*words, *other)["kept"] == 0, other
    assert film(*words[:4], 5, *words[5:], "--size", "32x24")["kept"] == 1  # the first pose


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", ["f-%03d.png", "a.webp"])
def test_interrupted_it_leaves_whole_files(ply, tmp_path, name, signum):  # noqa: F811
    """Frames that are done stay; of a film in one file nothing is left."""
    program = [sys.executable, "-m", "tsplat", "render", str(ply), "--path", "orbit", "--frames",
               "2000", "--size", "640x480", "-o", str(tmp_path / name)]  # fmt: skip
    process = subprocess.Popen(
        program, cwd=ROOT, stderr=subprocess.PIPE, preexec_fn=hear_signals,  # noqa: PLW1509
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while len(list(tmp_path.iterdir())) < (3 if "%" in name else 1):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signum)
    error = process.communicate(timeout=60)[1].decode()
    assert process.returncode == 128 + signum
    assert "Traceback" not in error
    left = sorted(p.name for p in tmp_path.iterdir())
    assert left == ([f"f-{i:03d}.png" for i in range(len(left))] if "%" in name else [])
    for file in left:
        picture(tmp_path / file)  # to its end
    if "%" in name and signum == signal.SIGINT:
        assert "what is done is kept; the same command goes on" in error


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--frames", "3"), "--frames is for films: say with --path"),
        (("--force",), "--force is for films"),
        (("--path", "PATH", "--camera", "PATH"), "leave out --camera"),
        (("--path", "PATH", "--fov", "40"), "leave out --fov"),
        (("--path", "orbit", "--repeat", "2"), "--repeat times one picture"),
        (("--path", "orbit", "-o", "x.npz"), "unknown suffix '.npz' of a film"),
        (("--path", "orbit", "-o", "x.png"), "out-%04d.png"),
        (("--path", "orbit", "-o", "x.mp4"), "needs ffmpeg"),
        (("--path", "orbit", "--presenter", "kitty"), "--presenter is for .cast"),
        (("--path", "orbit", "-o", "x.cast", "--presenter", "sixel"), "sixel draws pictures"),
        (
            (
                "--path",
                "missing.json",
            ),
            "missing.json: no such file",
        ),
    ],
)
def test_errors_are_one_line_and_leave_nothing(ply, path_file, tmp_path, words, text):  # noqa: F811
    """What is wrong and what to do, before a frame is made."""
    swapped = [str(path_file) if w == "PATH" else w for w in words]
    out = () if "-o" in words else ("-o", "x.gif")
    env = {**os.environ, "PATH": str(tmp_path)}
    result = tsplat("render", ply, *out, *swapped, code=1, cwd=tmp_path, env=env)
    error = result.stderr.decode()
    assert text in error
    assert error.startswith("tsplat: ")
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_size_of_a_path_may_be_another(ply, path_file, tmp_path):  # noqa: F811
    """As with render: said once, if that stretches the picture."""
    words = ("--path", path_file, "--frames", 2, "-o", tmp_path / "a.gif")
    result = tsplat("render", ply, *words, "--size", "64x64")
    assert result.stderr.decode().count("stretches its picture") == 1
    with Image.open(tmp_path / "a.gif") as got:
        assert got.size == (64, 64)
