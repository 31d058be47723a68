"""`tsplat view --verify`: what it compares, when, what it says, and that it leaves nothing."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.conftest import ROOT, gaussians, straight
from tests.io.plywriter import raw_columns, write_ply
from tests.viewer.session import Session, parent_of
from tsplat.cli import make_parser
from tsplat.commands.view import check_command, scene_words
from tsplat.core import reference
from tsplat.core.camera import Camera
from tsplat.core.params import RenderParams
from tsplat.core.types import Frame
from tsplat.io.cameras import load_camera, parse_camera_spec
from tsplat.testing.tiles import Still, TilesCompared, cut, tile_count, tile_pixels
from tsplat.viewer import verify
from tsplat.viewer.breaches import FAULTS_MAX, KEPT_MAX, TOLD_MAX, BreachLog, state_directory
from tsplat.viewer.look import Look
from tsplat.viewer.verify import FRAME_SECONDS, REST_SECONDS, ROUND, Verifier

CAMERA = straight(53, 37, 30.0)
SIZE = CAMERA.width, CAMERA.height
TILES = range(tile_count(*SIZE))


@pytest.fixture(scope="module")
def scene():
    """Large, oblique and overlapping Gaussians, some beyond the borders of the picture."""
    rng = np.random.default_rng(8)
    quats = rng.normal(size=(200, 4))
    return gaussians(
        rng.normal((0, 0, 5), (4, 3, 1), (200, 3)), scales=rng.uniform(0.02, 1.0, (200, 3)),
        opacities=rng.uniform(0.05, 0.99, 200), colors=rng.uniform(0, 1, (200, 3)),
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True),
    )  # fmt: skip


# --- tiles


def test_tiles_cover_every_pixel_once():
    """Tiles of a picture that is no whole number of them."""
    seen = np.zeros((CAMERA.height, CAMERA.width), int)
    for tile in TILES:
        seen[tile_pixels(tile, *SIZE)] += 1
    assert (seen == 1).all()


@pytest.mark.parametrize("antialias", [False, True])
def test_a_tile_is_compared_with_the_whole_pictures_reference(scene, antialias):
    """Of the float64 picture itself no tile differs by a bit; its borders are the picture's."""
    params = RenderParams(antialias=antialias)
    frame = reference.render(scene, CAMERA, replace(params, float64=True))
    still = Still(scene, CAMERA, params)
    for chosen in ([4], [11, 0, 5], list(TILES)):
        found = still.compare({tile: cut(frame, tile) for tile in chosen})
        assert found == TilesCompared(len(chosen), 0.0, 0, ())


def test_a_crops_own_camera_would_be_another_picture(scene):
    """Rule 3: a camera of only those pixels has other borders, and another picture."""
    frame = reference.render(scene, CAMERA, RenderParams(float64=True))
    rows, columns = tile_pixels(5, *SIZE)
    k = CAMERA.K.copy()
    k[:2, 2] -= columns.start, rows.start
    crop = reference.render(scene, Camera(CAMERA.viewmat, k, 16, 16), RenderParams(float64=True))
    found = Still(scene, CAMERA, RenderParams()).compare({5: crop})
    assert abs(crop.rgb - frame.rgb[rows, columns]).max() > 1e-3
    assert found.faults


def test_a_wrong_pixel_is_found_in_its_tile_and_in_no_other(scene):
    """One pixel off by 2e-4: its tile and the pixel in it are named."""
    frame = reference.render(scene, CAMERA, RenderParams())
    rgb = frame.rgb.copy()
    rgb[20, 35, 1] += 2e-4
    still = Still(scene, CAMERA, RenderParams())
    pieces = {tile: cut(replace(frame, rgb=rgb), tile) for tile in TILES}
    found = still.compare(pieces)
    (fault,) = found.faults
    assert fault.startswith("tile at (32, 16), counted from there: 1 pixels off")
    assert "(3, 4)" in fault
    assert 1.9e-4 < found.max_error < 2.1e-4
    del pieces[6]
    assert still.compare(pieces).faults == ()


def test_a_tile_that_is_not_finite_is_a_breach(scene):
    """NaN never counts as equal."""
    frame = reference.render(scene, CAMERA, RenderParams())
    piece = cut(frame, 0)
    piece.transmittance[2, 3] = np.nan
    assert Still(scene, CAMERA, RenderParams()).compare({0: piece}).faults


# --- when


class Pipe:
    """A worker's pipe whose answers a test gives."""

    def __init__(self):
        self.sent, self.answers = [], []

    def send(self, job):
        self.sent.append(job)

    def recv(self):
        if not self.answers:
            raise EOFError
        return self.answers.pop(0)

    def fileno(self):
        return 99


@pytest.fixture
def clock(monkeypatch):
    """The verifier's time, which only the test moves."""
    now = SimpleNamespace(seconds=100.0)
    monkeypatch.setattr(verify, "time", SimpleNamespace(monotonic=lambda: now.seconds))
    return now


@pytest.fixture
def verifier(tmp_path):
    """A verifier without a process."""
    log = BreachLog(lambda camera, pose: f"check {pose}", tmp_path / "state")
    return Verifier(SimpleNamespace(pipe=Pipe()), log)


BLANK = Frame(np.zeros((80, 100, 3), np.float32), np.ones((80, 100), np.float32))  # 35 tiles
WIDE = straight(100, 80)


def answer(verifier, **found):
    """The worker's answer to the round under way."""
    told = {"tiles": len(verifier.worker.pipe.sent[-1][1]), "max_error": 0.0, "flips": 0} | found
    verifier.worker.pipe.answers.append(TilesCompared(**{"faults": (), **told}))
    verifier.receive()


def test_nothing_is_verified_before_the_camera_has_rested(verifier, clock):
    """A frame waits; another camera's frame waits anew; the same camera's does not."""
    assert verifier.wait() is None
    verifier.show(WIDE, BLANK)
    assert verifier.wait() == REST_SECONDS
    clock.seconds += REST_SECONDS - 0.1
    verifier.step()
    assert verifier.worker.pipe.sent == []
    verifier.show(straight(100, 80), BLANK)
    assert verifier.wait() == pytest.approx(0.1)
    verifier.show(straight(100, 80, 50.0), BLANK)
    assert verifier.wait() == REST_SECONDS
    clock.seconds += REST_SECONDS
    verifier.step()
    assert len(verifier.worker.pipe.sent) == 1


def test_rounds_follow_each_other_and_cover_the_frame(verifier, clock):
    """Never two at a time, each tile once, and then there is nothing more to do."""
    verifier.show(WIDE, BLANK)
    clock.seconds += REST_SECONDS
    for _ in range(3):
        verifier.step()
        verifier.step()
        assert verifier.wait() is None
        answer(verifier, max_error=3e-6, flips=1)
    jobs = [tiles for _, tiles in verifier.worker.pipe.sent]
    assert [len(tiles) for tiles in jobs] == [ROUND, ROUND, 35 - 2 * ROUND]
    assert sorted(tile for tiles in jobs for tile in tiles) == list(range(35))
    assert verifier.text == "verified 35 tiles: max 3.0e-06, 3 crossings"
    assert verifier.wait() is None


def test_a_frame_that_takes_long_is_left_after_a_while(verifier, clock):
    """Half a frame may do; the next frame has its own time."""
    verifier.show(WIDE, BLANK)
    clock.seconds += REST_SECONDS
    verifier.step()
    clock.seconds += FRAME_SECONDS + 1
    answer(verifier)
    assert verifier.wait() is None
    verifier.show(straight(100, 80, 50.0), BLANK)
    assert verifier.wait() == REST_SECONDS


def test_an_answer_counts_for_the_frame_it_was_asked_for(verifier, clock):
    """The camera moved on meanwhile: the breach is of the frame before, and is written so."""
    verifier.show(WIDE, BLANK)
    clock.seconds += REST_SECONDS
    verifier.step()
    verifier.show(straight(100, 80, 50.0), BLANK)
    answer(verifier, max_error=0.5, faults=("tile at (0, 0): wrong",))
    assert verifier.text == "CONTRACT BROKEN, 12 tiles: max 5.0e-01, 0 crossings"
    (pose,) = (verifier.log.directory).glob("camera-*.json")
    assert load_camera(f"{pose}#0").same(WIDE)
    assert verifier.wait() == REST_SECONDS  # the new frame's turn comes


def test_flips_are_counted_over_a_frames_rounds(verifier, clock):
    """8000 pixels may have 8 flips: 4 and 4 are fine, one more is a breach."""
    verifier.show(WIDE, BLANK)
    clock.seconds += REST_SECONDS
    for flips, broken in ((4, 0), (4, 0), (1, 1)):
        verifier.step()
        answer(verifier, flips=flips)
        assert verifier.broken == broken
    assert "at most 8" in verifier.log.entries[0]
    verifier.show(straight(100, 80, 50.0), BLANK)
    clock.seconds += REST_SECONDS
    verifier.step()
    answer(verifier, flips=8)
    assert verifier.broken == 1


def test_a_worker_that_ends_or_fails_is_told(verifier, clock):
    """No more rounds; what happened is in the status line."""
    verifier.show(WIDE, BLANK)
    clock.seconds += REST_SECONDS
    verifier.step()
    verifier.receive()  # nothing comes but the end
    assert verifier.text == "not verified: its process has ended"
    assert verifier.wait() is None


# --- the log


def test_where_state_is_kept(tmp_path):
    """XDG_STATE_HOME if it is absolute, as the specification wants it."""
    assert state_directory({"XDG_STATE_HOME": str(tmp_path)}) == tmp_path / "tsplat"
    for unset in ({}, {"XDG_STATE_HOME": ""}, {"XDG_STATE_HOME": "here"}):
        assert state_directory(unset) == Path.home() / ".local/state/tsplat"


def test_a_session_of_breaches_neither_fills_the_disk_nor_the_screen(tmp_path):
    """Some are written, fewer are told, all are counted."""
    log = BreachLog(lambda camera, pose: f"check {pose}", tmp_path / "deep" / "state")
    for _ in range(KEPT_MAX + 5):
        log.add(CAMERA, ("wrong",))
    assert len(list(log.directory.glob("camera-*.json"))) == KEPT_MAX
    assert log.path.read_text().count("wrong") == KEPT_MAX
    lines = log.report()
    assert lines[0] == f"{KEPT_MAX + 5} of the frames shown broke the contract"
    assert sum("check" in line for line in lines) == TOLD_MAX
    assert lines[-1] == f"log: {log.path}"


def test_a_frame_that_is_wrong_everywhere_takes_few_lines(tmp_path):
    """The first faults, how many more there are, and the command."""
    log = BreachLog(lambda camera, pose: "check", tmp_path)
    log.add(CAMERA, tuple(f"fault {i}" for i in range(30)))
    lines = log.path.read_text().splitlines()
    assert [line.strip() for line in lines[1:]] == [
        *(f"fault {i}" for i in range(FAULTS_MAX)), "and 27 more like these", "check",
    ]  # fmt: skip


def test_a_log_that_cannot_be_written_is_told(tmp_path):
    """The breach is told all the same."""
    (tmp_path / "file").write_text("in the way")
    log = BreachLog(lambda camera, pose: "check", tmp_path / "file" / "state")
    log.add(CAMERA, ("wrong",))
    assert any("wrong" in line for line in log.report())
    assert "cannot be written" in log.report()[-1]
    assert BreachLog(lambda camera, pose: "check", tmp_path).report() == []


def test_the_command_says_what_was_shown(tmp_path, monkeypatch):
    """Read back by the command line, it names the scene, the camera, the size and every option."""
    monkeypatch.setenv("TSPLAT_ISA", "generic")
    words = ["view", "a scene.ply", "--verify", "--antialias", "--sh-degree", "1"]
    words += ["--max-splats", "7", "--threads", "3", "--sh-float32"]
    viewed = make_parser().parse_args(words)
    pose = tmp_path / "with #" / "camera.json"
    text = check_command(viewed, ["numba", "cffi"], CAMERA, pose)
    for command, backend in zip(text.split(" && "), ("numba", "cffi"), strict=True):
        setting, program, *rest = shlex.split(command)
        assert (setting, program) == ("TSPLAT_ISA=generic", "tsplat")
        read = make_parser().parse_args(rest)
        assert read.scene == str(Path.cwd() / "a scene.ply")
        assert (parse_camera_spec(read.camera), read.size) == ((str(pose), 0), (53, 37))
        assert (read.backend, read.threads, read.max_splats) == (backend, 3, 7)
        assert (read.antialias, read.sh_float32, read.raw_opacity) == (True, True, False)
        assert read.sh_degree == 1


@pytest.mark.parametrize("said", [None, True, False])
def test_the_command_says_whether_to_antialias(tmp_path, said):
    """On and off are both said, so that it holds whatever the scene's file says."""
    viewed = make_parser().parse_args(["view", "a.spz"])
    viewed.antialias = said
    command = shlex.split(check_command(viewed, ["numba"], CAMERA, tmp_path / "camera.json"))
    assert make_parser().parse_args(command[1:]).antialias is said
    look = Look(RenderParams(antialias=bool(said)))
    words = scene_words(viewed, look)
    assert make_parser().parse_args(["render", *words, "-o", "a.png"]).antialias is said


# --- in a terminal

WRONG = """
from dataclasses import replace

from tsplat import Backend, Stages, hookimpl
from tsplat.plugins import load_backend, plugins

def load():
    right = load_backend(plugins().find("backend", "cffi"))

    def composite(splats, bins, params, workspace):
        frame = right.composite(splats, bins, params, workspace)
        rgb = frame.rgb.copy()
        rgb[::3, ::5] += 0.004
        return replace(frame, rgb=rgb)

    return Stages(composite=composite)

@hookimpl
def tsplat_backends():
    return [Backend("tinted", "wrong on purpose", load, stages=("composite",))]
"""


@pytest.fixture
def view(tmp_path, monkeypatch):
    """Starts sessions whose state is kept apart and that know the wrong backend."""
    (tmp_path / "tinted_plugin.py").write_text(WRONG)
    info = tmp_path / "tinted-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: tinted\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[tsplat]\ntinted = tinted_plugin\n")
    path = os.pathsep.join(p for p in (str(tmp_path), os.environ.get("PYTHONPATH")) if p)
    monkeypatch.setenv("PYTHONPATH", path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    columns = raw_columns(300, 1)  # logits and logarithms
    columns |= {f"scale_{i}": columns[f"scale_{i}"] / 2 - 1.5 for i in range(3)}
    scene = write_ply(tmp_path / "a scene.ply", columns)
    made = []

    def start(*words):
        made.append(Session(str(scene), "--presenter", "halfblock", "--verify", *words))
        return made[-1]

    yield start
    for session in made:
        session.close()


def says(session, text):
    """Waits until the screen has shown ``text``."""
    session.pump(lambda: text in session.output, 60.0)


def test_a_right_backend_is_verified_on_the_screen(view, tmp_path):
    """The measured error is in the status line, for this frame and the next; nothing is logged."""
    session = view()
    says(session, b"verified 12 tiles: max ")
    error = session.output.partition(b"verified 12 tiles: max ")[2].partition(b",")[0]
    assert 0 < float(error) < 1e-4
    (child,) = session.children()
    session.send(b"j")
    says(session, b"verified 24 tiles: max ")
    session.press(b"q")
    assert session.end(0) == b""
    assert parent_of(child) is None
    assert not (tmp_path / "state").exists()


def test_a_wrong_backend_is_found_and_can_be_shown_again(view, tmp_path):
    """The screen says it; afterwards stderr and the log have a command that shows it again."""
    session = view("--backend", "tinted", "--threads", "1")
    says(session, b"CONTRACT BROKEN, 12 tiles: max 4.0e-03")
    session.press(b"q")
    said = session.end(1).decode()
    assert said.startswith("tsplat: 1 of the frames shown broke the contract\n")
    log = (tmp_path / "state" / "tsplat" / "verify.log").read_text()
    (command,) = [line.strip() for line in log.splitlines() if "tsplat check" in line]
    assert command in said
    assert "tile at (" in said
    command = next(c for c in command.split(" && ") if "--backend tinted" in c)
    words = shlex.split(command)[1:]
    again = subprocess.run(
        [sys.executable, "-m", "tsplat", *words, "--json"], cwd=ROOT, capture_output=True,
        check=False, timeout=120,
    )  # fmt: skip
    assert again.returncode == 1, again.stderr
    verdicts = {c["check"]: c for c in json.loads(again.stdout)["checks"]}
    assert not verdicts["picture"]["passed"]
    assert verdicts["picture"]["max_error"] == pytest.approx(4e-3, rel=0.02)


def stopped_at_work(session):
    """The process that verifies, held in the middle of its first round."""
    session.pump(session.children)
    (child,) = session.children()
    os.kill(child, signal.SIGSTOP)
    says(session, b"verifying")
    return child


def test_quitting_does_not_wait_for_a_verification(view):
    """A round that would never end is ended, and its process with it."""
    session = view()
    child = stopped_at_work(session)
    session.press(b"q")
    assert session.end(0) == b""
    assert parent_of(child) is None


@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGHUP])
def test_signals_end_a_verification_too(view, signum):
    """The terminal is restored, and no process is left."""
    session = view()
    child = stopped_at_work(session)
    session.process.send_signal(signum)
    session.end(128 + signum)
    assert parent_of(child) is None


def test_a_viewer_that_is_killed_leaves_no_process(view):
    """The other process notices by itself."""
    session = view()
    says(session, b"verified")
    (child,) = session.children()
    session.process.kill()
    session.pump(lambda: parent_of(child) is None)


def test_the_viewer_outlives_its_verification(view):
    """Killed, as for want of memory: the viewer says so and goes on."""
    session = view()
    session.pump(session.children)
    (child,) = session.children()
    session.pump(lambda: session.frames() >= 1)
    os.kill(child, signal.SIGKILL)
    says(session, b"not verified: its process has ended")
    session.send(b"j")
    session.press(b"q")
    assert session.end(0) == b"tsplat: frames were not verified to the end: its process has ended\n"


@pytest.mark.parametrize("words", ["--quality fast", "--set scale=0.5", "--max-error 1"])
def test_shortcuts_are_not_verified(view, words):
    """They make another picture than the contract's, which would be told as a breach of it."""
    session = view(*words.split())
    session.pump(lambda: session.process.poll() is not None)
    assert session.process.returncode == 1
    assert session.process.stderr.read().startswith(b"tsplat: --verify compares with the contract")
    assert session.output == b""


def test_without_the_option_there_is_no_second_process():
    """Nobody pays who has not asked."""
    session = Session("--presenter", "halfblock", "--max-splats", "1000")
    session.pump(lambda: session.frames() >= 1)
    assert session.children() == []
    session.press(b"q")
    session.end(0)
    session.close()
