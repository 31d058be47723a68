"""The panel, pictures and paths in a pseudo-terminal: what is typed, what is seen, what is left."""

from __future__ import annotations

import fcntl
import json
import os
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import termios

import numpy as np
import pytest
from PIL import Image

from tests.conftest import ROOT
from tests.io.plywriter import names_inria
from tests.viewer.grid import Grid
from tests.viewer.session import COLOR, ROWS, Session
from tsplat.commands.view import _quoted
from tsplat.core.camera import look_at
from tsplat.io.cameras import camera_to_json
from tsplat.paths import load_path
from tsplat.viewer.layout import PANEL

UP, DOWN, RIGHT, LEFT = b"\x1b[A", b"\x1b[B", b"\x1b[C", b"\x1b[D"
PAGE_DOWN = b"\x1b[6~"
UPDATED = b"\x1b[?2026l"
WIDE = 24, 100, 0, 0
NAME = "two balls (1).ply"


def write_scene(folder):
    """600 Gaussians of degree 1, with a name that a shell would take apart."""
    rng = np.random.default_rng(3)
    n = 600
    columns = {name: rng.normal(0, 1, n) for name in names_inria(1, normals=False)}
    columns["opacity"] = rng.uniform(0.05, 0.95, n)  # as logits, or as they are
    columns |= {f"scale_{i}": rng.normal(-2.0, 0.3, n) for i in range(3)}
    columns |= {f"f_rest_{i}": rng.normal(0, 0.2, n) for i in range(9)}
    header = f"ply\nformat binary_big_endian 1.0\nelement vertex {n}\n"
    header += "".join(f"property float {name}\n" for name in columns) + "end_header\n"
    rows = np.stack(list(columns.values()), 1).astype(">f4")
    (folder / NAME).write_bytes(header.encode() + rows.tobytes())
    return folder


@pytest.fixture
def folder(tmp_path):
    return write_scene(tmp_path)


@pytest.fixture
def sessions(folder):
    """Starts viewers in ``folder``; they are gone afterwards."""
    made = []

    def start(*words, presenter="halfblock", scene=NAME, **options):
        options.setdefault("cwd", folder)
        which = [scene] if scene else []
        session = Session(*which, "--presenter", presenter, *words, **options)
        made.append(session)
        session.pump(lambda: session.frames() >= 1)
        session.rest()
        return session

    yield start
    for session in made:
        session.close()


def seen(session):
    """The screen as it is now, after the last whole update."""
    rows, columns = session.size[:2]
    grid, taken = getattr(session, "grid", (Grid(columns, rows), 0))
    end = session.output.rfind(UPDATED) + len(UPDATED)
    session.grid = grid.feed(session.output[taken : max(taken, end)]), max(taken, end)
    return grid


def shown(session):
    """All text on the screen."""
    screen = seen(session)
    return "\n".join(map(screen.text, range(screen.rows)))


def quit_(session):
    """Leaves; what was said on stderr."""
    session.press(b"q")
    return session.end(0).decode()


def resize(session, rows, columns):
    session.size = rows, columns, 0, 0
    fcntl.ioctl(session.master, termios.TIOCSWINSZ, struct.pack("4H", rows, columns, 0, 0))
    os.killpg(session.process.pid, signal.SIGWINCH)
    session.rest()


def test_tab_opens_a_panel_beside_the_picture(sessions):
    """The picture keeps to its columns, the panel to its own; Tab again: the picture has all."""
    session = sessions("--background", "0,0.3,0.3", size=WIDE)
    opened = len(session.output)
    session.press(b"\t")
    session.wait_for(b"alpha threshold", opened)
    session.rest()
    part = session.output[opened:]
    left = WIDE[1] - PANEL
    after = Grid(WIDE[1], WIDE[0]).feed(part)
    assert after.written
    assert max(x for x, _ in after.written) == left - 1
    assert max(y for _, y in after.written) == WIDE[0] - 2
    for row in range(WIDE[0] - 1):
        assert after.text(row)[left] == " "
        assert not set(after.text(row)[left:]) & set("▀▄█")
    assert after.text(0)[left + 1 :].startswith("Camera")
    assert after.marked(1)
    assert "arrows" in after.text(WIDE[0] - 1)
    closed = len(session.output)
    session.press(b"\t")
    session.rest()
    after = Grid(WIDE[1], WIDE[0]).feed(session.output[closed:])
    assert max(x for x, _ in after.written) == WIDE[1] - 1
    assert "Camera" not in "".join(map(after.text, range(WIDE[0])))
    quit_(session)


def test_arrows_change_a_setting_and_the_picture(sessions):
    """Down to the field of view and to the right: its value and the picture are others."""
    session = sessions(size=WIDE)
    session.press(b"\t")
    session.rest()
    assert "50 degrees" in seen(session).text(3)
    session.press(DOWN + DOWN)
    session.rest()
    assert "< 50 degrees >" in seen(session).text(3)
    assert seen(session).marked(3)
    before = len(session.output)
    session.send(RIGHT)
    session.rest()
    assert COLOR in session.output[before:]
    assert "< 55 degrees >" in seen(session).text(3)
    session.send(b"\x7f")
    session.rest()
    assert "< 50 degrees >" in seen(session).text(3)
    quit_(session)


def test_a_click_in_the_panel_sets(sessions):
    """On the right half of a value; beside the panel it is the picture's and sets nothing."""
    session = sessions(size=WIDE)
    session.press(b"\t")
    session.rest()
    session.press(b"\x1b[<0;95;4M\x1b[<0;95;4m")
    session.rest()
    assert "< 55 degrees >" in seen(session).text(3)
    before = seen(session).text(3)
    session.press(b"\x1b[<0;20;4M\x1b[<0;20;4m")
    session.rest()
    assert seen(session).text(3) == before
    quit_(session)


def test_a_double_click_goes_there(sessions):
    """The picture moves; after two clicks apart in place it does not."""
    session = sessions()
    frames = session.frames()
    session.press(b"\x1b[<0;10;5M\x1b[<0;10;5m\x1b[<0;40;9M\x1b[<0;40;9m")
    session.rest()
    assert session.frames() == frames
    session.press(b"\x1b[<0;30;10M\x1b[<0;30;10m\x1b[<0;30;10M\x1b[<0;30;10m")
    session.rest()
    assert session.frames() > frames + 1
    quit_(session)


@pytest.mark.parametrize("size", [(8, 20, 0, 0), (150, 500, 0, 0), (20, 60, 0, 0), (2, 9, 0, 0)])
def test_panel_and_help_at_any_size(sessions, size):
    """Every row of the panel and every key of the help can be scrolled to; nothing is outside."""
    session = sessions("--eye", "0,-1,-300", "--target", "0,0,0", size=size)  # few bytes
    session.press(b"\t")
    session.rest()
    for _ in range(80):
        session.press(PAGE_DOWN)
        session.listen(0.05)
        if size[1] < 20 or "more below" not in shown(session):
            break
    session.rest()
    text = shown(session)
    assert size[1] < 20 or "without" in text or "looks along" in text
    session.press(b"\t?")
    session.rest()
    for _ in range(20):
        if ": more" not in shown(session):
            break
        session.press(PAGE_DOWN)
        session.listen(0.05)
    session.rest()
    assert size[1] < 20 or "quit" in shown(session)
    session.press(b"\r")
    session.rest()
    assert "quit" not in shown(session)
    quit_(session)


def test_a_window_that_is_resized_with_the_panel_open(sessions):
    """Beside, below, instead: nothing is left of what was there."""
    session = sessions(size=WIDE)
    session.press(b"\t")
    session.rest()
    for rows, columns in ((30, 50), (10, 30), (40, 120)):
        before = len(session.output)
        resize(session, rows, columns)
        screen = Grid(columns, rows).feed(session.output[before:])
        text = [screen.text(row) for row in range(rows)]
        assert any("Camera" in line for line in text)
        assert any(screen.marked(row) for row in range(rows - 1))
        pictures = bool(screen.written)
        assert pictures == (rows > 10)
        for x, y in screen.written:
            assert x < columns - PANEL or (y < rows - 13 and columns == 50)
    quit_(session)


def test_open_and_idle_it_costs_nothing(sessions):
    """With the panel open no byte is written and no processor time spent when nothing happens."""
    session = sessions(size=WIDE)
    session.press(b"\t" + DOWN + DOWN + RIGHT)
    session.rest(0.6)
    before, spent = len(session.output), session.cpu_seconds()
    session.listen(0.6)
    assert len(session.output) == before
    assert session.cpu_seconds() - spent <= 0.05  # a thread that spins takes ten times as long
    quit_(session)


def test_notices_go_away(sessions):
    """Some seconds after they came, without any input."""
    session = sessions()
    session.press(b"v")
    session.wait_for(b"recording the camera's path")
    session.rest()
    assert "recording the" in seen(session).text(ROWS - 1)
    before = len(session.output)
    session.pump(lambda: "recording the" not in seen(session).text(ROWS - 1))
    assert "recording" in seen(session).text(ROWS - 1)  # that it goes on is still said
    assert len(session.output) - before < 2000
    assert session.frames() <= 3
    quit_(session)


# --- pictures


def pixels(file):
    return np.asarray(Image.open(file).convert("RGB")).astype(int)


def run_command(command, folder):
    """Runs it in a shell where ``tsplat`` is this one."""
    commands = folder / "commands"
    commands.mkdir(exist_ok=True)
    script = commands / "tsplat"
    script.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m tsplat "$@"\n')
    script.chmod(0o755)
    environment = {**os.environ, "PATH": f"{commands}:{os.environ['PATH']}",
                   "PYTHONPATH": str(ROOT)}  # fmt: skip
    subprocess.run(["sh", "-c", command], cwd=folder, env=environment, check=True,
                   capture_output=True)  # fmt: skip


def keep_and_make_again(session, folder, number=1):
    """Presses P; the picture that was kept, and the one that the printed command makes."""
    session.press(b"p")
    session.wait_for(f"-{number:03d}.png, ".encode())
    said = quit_(session)
    (line,) = [line for line in said.splitlines() if ".png: tsplat render" in line]
    name, _, command = line.removeprefix("tsplat: ").partition(": ")
    kept = pixels(folder / name)
    (folder / name).unlink()
    run_command(command, folder)
    return kept, pixels(folder / name), command


EVERYTHING = (
    "--max-splats", "400", "--set", "scale=0.5,alpha_threshold=2/255", "--antialias",
    "--background", "0.2,0.4,0.6", "--crop=-1,-1.5,-1,1,1.5,2", "--saturation", "1.7",
    "--min-opacity", "0.55", "--splat-scale", "1.3", "--sh-degree", "0", "--fov", "40",
)  # fmt: skip


@pytest.mark.parametrize(
    ("words", "keys"),
    [
        ((), b""),
        ((), b"xbtyw"),
        (EVERYTHING, b"a"),
        (("--quality", "fast", "--sh-float32", "--raw-opacity"), b"uj["),
        (("--eye", "-1,-2,-5", "--target", "0,0.3,0", "--up", "0.1,-1,0"), b""),
        (("--backend", "numpy"), b"Uf"),
    ],
)  # fmt: skip
def test_the_printed_command_makes_the_picture_again(sessions, folder, words, keys):
    """Run in a shell as it is printed: within one level of 8 bits, in next to no pixel.

    The same bits are not promised: the camera is said by eye, target and up, so that one can change
    it, and its rotation is worked out again from those, which moves it by some 1e-15. Where that
    changes the last bit of a float32, a colour may be rounded otherwise.
    """
    session = sessions(*words)
    for key in keys:
        session.press(bytes([key]))
        session.rest(0.15)
    session.rest()
    kept, again, command = keep_and_make_again(session, folder)
    assert kept.shape == again.shape
    assert len(np.unique(kept.reshape(-1, 3), axis=0)) > 50
    assert np.abs(kept - again).max() <= 1
    assert (kept != again).mean() < 1e-3
    assert shlex.quote(NAME) in command


def test_a_hostile_name_is_harmless_in_the_command():
    """No control character reaches the screen, and bash reads the name as it is."""
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("$'...' is bash's; dash does not have it yet")
    for name in ("a b'c", "x\x1b[2Jy\n$(id)`id`", "\x9b日本 \\'\"", "-rf"):
        quoted = _quoted(name)
        assert quoted.isprintable()
        made = subprocess.run([bash, "-c", f"printf %s {quoted}"],
                              capture_output=True, check=True)  # fmt: skip
        assert made.stdout.decode() == name


def test_a_files_camera_makes_the_same_bits(sessions, folder):
    """N shows it, P keeps its place in a file: every number of it is written whole."""
    cameras = [look_at((3, -2, -4), (0, 0, 0), (0.3, -1, 0.1), 45, 320, 240),
               look_at((-3, 1, -4), (0, 0, 0), (0, -1, 0), 60, 320, 200)]  # fmt: skip
    (folder / "cameras.json").write_text(json.dumps([camera_to_json(c) for c in cameras]))
    session = sessions("--saturation", "0.5")
    session.press(b"n")
    session.wait_for(b"camera 0 of 2")
    session.press(b"n")
    session.wait_for(b"camera 1 of 2")
    session.rest()
    kept, again, command = keep_and_make_again(session, folder)
    np.testing.assert_array_equal(kept, again)
    assert "--camera" in command


def test_pictures_kept_at_once_are_all_written_before_it_ends(sessions, folder):
    """Q right after P, twice: it waits for both, and each has a name of its own."""
    session = sessions()
    session.press(b"ppq")
    said = session.end(0).decode()
    assert len(list(folder.glob("*.png"))) == said.count(".png: tsplat render") == 2
    for file in folder.glob("*.png"):
        assert pixels(file).max() > 50
    assert not [path for path in folder.iterdir() if path.suffix not in (".png", ".ply")]


def test_where_nothing_can_be_written_that_is_said(sessions, folder):
    """A notice, and the session goes on."""
    gone = folder / "gone"
    gone.mkdir()
    session = sessions(cwd=gone, scene=str(folder / NAME))
    gone.rmdir()
    session.press(b"p")
    session.wait_for(b"no picture: ")
    session.send(b"j")
    quit_(session)


def test_a_recorded_path_is_rendered(sessions, folder):
    """V, a move, V: the file is a path, and `tsplat render --path` goes along it."""
    session = sessions()
    session.press(b"v")
    session.wait_for(b"recording")
    for _ in range(6):
        session.press(b"j")
        session.listen(0.1)
    session.rest()
    session.press(b"v")
    session.wait_for(b"-path-001.json, ")
    said = quit_(session)
    (file,) = folder.glob("*-path-001.json")
    assert file.name in said
    path = load_path(file)
    assert path.seconds > 0.5
    ways = np.linalg.norm(path.camera(0).centre - path.camera(path.seconds).centre)
    assert ways > 0.3
    command = f"tsplat render {shlex.quote(NAME)} -o f-%d.png --path {file.name} --frames 3"
    run_command(command + " --size 40x30", folder)
    frames = [pixels(path) for path in sorted(folder.glob("f-*.png"))]
    assert len(frames) == 3
    assert (frames[0] != frames[2]).any()


def test_a_path_that_is_not_ended_is_kept_when_one_quits(sessions, folder):
    """Q while it is recorded."""
    session = sessions()
    session.press(b"v")
    session.wait_for(b"recording")
    session.send(b"j")
    session.rest()
    quit_(session)
    (file,) = folder.glob("*-path-001.json")
    assert load_path(file).seconds > 0


# --- presenters and backends


def test_presenters_and_backends_are_changed_while_it_runs(sessions):
    """M goes to the next one that this terminal can show, Shift+M back; G likewise."""
    session = sessions(size=WIDE)
    names = []
    for key in (b"m", b"m", b"M", b"M"):
        before = len(session.output)
        session.press(key)
        session.pump(lambda before=before: b"presenter " in session.output[before:])
        session.rest()
        names.append(session.output[before:].rpartition(b"presenter ")[2].split()[0])
    assert names[1] == names[3] or names[0] == names[2]
    assert names[3] == b"halfblock"
    assert names[0] != names[1] != b"halfblock"
    assert seen(session).written
    for key, name in ((b"g", b"numba"), (b"g", b"numpy"), (b"G", b"numba")):
        before = len(session.output)
        session.press(key)
        session.wait_for(b"backend " + name, before)
        if name == b"numpy":
            session.pump(lambda before=before: b"ms numpy" in session.output[before:])
    quit_(session)


BROKEN = """
from tsplat import Backend, hookimpl

def load():
    raise RuntimeError("no such GPU")

@hookimpl
def tsplat_backends():
    return [Backend(name="broken", summary="never loads", load=load, rank=99)]
"""


def test_a_backend_that_fails_to_load_is_told_and_the_picture_stays(sessions, tmp_path):
    """The session goes on with what it had, by key and by mouse; another backend ends it."""
    plugin = tmp_path / "plugin"
    (plugin / "fake-1.0.dist-info").mkdir(parents=True)
    (plugin / "fake_broken.py").write_text(BROKEN)
    meta = plugin / "fake-1.0.dist-info"
    (meta / "METADATA").write_text("Metadata-Version: 2.1\nName: fake\nVersion: 1.0\n")
    (meta / "entry_points.txt").write_text("[tsplat]\nfake = fake_broken\n")
    session = sessions("--backend", "cffi", path=[plugin], size=WIDE)
    session.press(b"G")
    session.wait_for(b"no such GPU")
    session.rest()
    assert "ms cffi" in seen(session).text(WIDE[0] - 1) or "GPU" in seen(session).text(WIDE[0] - 1)
    before = len(session.output)
    session.send(b"j")
    session.rest()
    assert COLOR in session.output[before:]
    session.press(b"g")
    session.wait_for(b"backend cffi", before)
    session.send(b"j")
    quit_(session)


def test_x_crops_and_uncrops(sessions):
    """The picture has less in it, and is then what it was."""
    session = sessions()
    session.press(b"x")
    session.rest()
    cropped = session.output
    assert "crop" in seen(session).text(ROWS - 1)
    session.press(b"x")
    session.rest()
    assert len(session.output) > len(cropped) + 1000
    assert "crop" not in seen(session).text(ROWS - 1)
    quit_(session)
