"""``tsplat cat``: into a pipe, and in a pseudo-terminal that answers in several ways."""

from __future__ import annotations

import array
import fcntl
import os
import re
import signal
import subprocess
import sys
import termios
import time

import numpy as np
import pytest
from PIL import Image

from tests.conftest import ROOT
from tests.terminal.fakes import FakeTerminal
from tests.test_cli import camera_file, ply, scene, tsplat  # noqa: F401 - fixtures
from tsplat.presenters.base import Terminal
from tsplat.testing.decoders import halfblock, iterm2, kitty, sixel

PLAIN = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES", "NO_COLOR")}
KITTY_OK = b"\x1b_Gi=31;OK\x1b\\"


def pixels(lines):
    """[2 * rows, columns, 3] of half-block lines, each of which stands alone."""
    columns = [len(re.sub(rb"\x1b\[[0-9;]*m", b"", line).decode()) for line in lines]
    assert len(set(columns)) == 1
    picture = np.zeros((2 * len(lines), columns[0], 3), np.uint8)
    for i, line in enumerate(lines):
        picture[2 * i : 2 * i + 2] = halfblock(line, Terminal(columns[0], 2))
    return picture


def piped(*words, code=0, env=PLAIN):
    """Lines on stdout."""
    return tsplat("cat", *words, code=code, env=env).stdout.splitlines()


def rendered(tmp_path, *words):
    """What ``tsplat render`` makes."""
    tsplat("render", *words, "-o", tmp_path / "x.png")
    return np.asarray(Image.open(tmp_path / "x.png"))


# --- a pipe


def test_a_pipe_gets_half_blocks_of_the_picture(ply, tmp_path):  # noqa: F811
    """As many cells as asked for; their halves are the pixels that render makes, one by one."""
    words = "--columns", 60, "--rows", 20, "--background", "0.2,0.3,0.4"
    want = rendered(tmp_path, ply, "--size", "60x40", "--background", "0.2,0.3,0.4")
    lines = piped(ply, *words, env={**PLAIN, "TSPLAT_SAMPLES": "1"})
    np.testing.assert_array_equal(pixels(lines), want)


def test_half_blocks_are_the_mean_of_smaller_pixels(ply, tmp_path):  # noqa: F811
    """Of 4x4, unless TSPLAT_SAMPLES says otherwise; both roundings take half a level at most."""
    for env, samples in (({}, 4), ({"TSPLAT_SAMPLES": "2"}, 2)):
        lines = piped(ply, "--columns", 60, "--rows", 20, env={**PLAIN, **env})
        fine = rendered(tmp_path, ply, "--size", f"{60 * samples}x{40 * samples}")
        mean = fine.reshape(40, samples, 60, samples, 3).mean((1, 3))
        assert np.abs(pixels(lines) - mean).max() <= 1
    tsplat("cat", ply, code=1, env={**PLAIN, "TSPLAT_SAMPLES": "no"})


def test_a_pipe_has_80_by_24_cells_at_most(ply, camera_file):  # noqa: F811
    """The largest picture in the camera's shape; COLUMNS, LINES and options say otherwise."""
    for words, env, size in (
        ((), {}, (44, 80)),  # 16:9
        (("--camera", camera_file), {}, (48, 64)),  # 4:3
        ((), {"COLUMNS": "40", "LINES": "99"}, (22, 40)),
        ((), {"COLUMNS": "200", "LINES": "10"}, (20, 36)),
        (("--rows", 9), {"COLUMNS": "200"}, (18, 32)),
        (("--columns", 20), {}, (12, 20)),
    ):
        assert pixels(piped(ply, *words, env={**PLAIN, **env})).shape[:2] == size


def test_a_pipe_is_asked_nothing(ply):  # noqa: F811
    """SGR, characters and line feeds; no colour with NO_COLOR; no picture unless by name."""
    out = tsplat("cat", ply, env=PLAIN).stdout
    assert not re.sub(r"\x1b\[[0-9;]*m|[▀▄█ \n]", "", out.decode())
    assert b"38;2;" in out
    assert b"\x1b" not in tsplat("cat", ply, env={**PLAIN, "NO_COLOR": "1"}).stdout
    assert tsplat("cat", ply, "--presenter", "sixel", env=PLAIN).stdout.count(b"\x1bP") == 1


def test_scenes_one_after_the_other(ply, tmp_path):  # noqa: F811
    """Each with its name below; one that cannot be read is told, and the others are shown."""
    other = tmp_path / "other.ply"
    other.write_bytes(ply.read_bytes())
    result = tsplat("cat", ply, "missing.ply", other, "--rows", 5, code=1, env=PLAIN)
    lines = result.stdout.splitlines()
    assert [lines[5], lines[11]] == [b"scene.ply", b"other.ply"]
    assert len(lines) == 12
    np.testing.assert_array_equal(pixels(lines[:5]), pixels(lines[6:11]))
    assert result.stderr.decode().strip() == "tsplat: missing.ply: no such file"
    assert b"scene.ply" not in tsplat("cat", ply, "--rows", 5, env=PLAIN).stdout


def test_a_camera_and_a_quality_may_be_asked_for(ply, camera_file, tmp_path):  # noqa: F811
    """Options are render's."""
    words = (ply, "--camera", camera_file, "--quality", "exact")
    lines = piped(*words, "--columns", 64, "--rows", 24, env={**PLAIN, "TSPLAT_SAMPLES": "1"})
    np.testing.assert_array_equal(pixels(lines), rendered(tmp_path, *words, "--size", "64x48"))


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("missing.ply",), 1, "missing.ply: no such file"),
        (("SCENE", "--presenter", "pixels"), 1, "no presenter named 'pixels'"),
        (("SCENE", "--fov", "190"), 1, "190"),
        (("SCENE", "--rows", "0"), 2, "from 1 to 999"),
        (("SCENE", "--columns", "1000"), 2, "1 to 999"),
    ],
)
def test_errors_are_one_line(ply, words, code, text):  # noqa: F811
    """And nothing on stdout."""
    result = tsplat("cat", *(ply if w == "SCENE" else w for w in words), code=code, env=PLAIN)
    assert text in result.stderr.decode()
    assert result.stdout == b""


def test_a_reader_that_went_away_is_no_error_message(ply):  # noqa: F811
    """`tsplat cat | head -0` ends quietly."""
    program = [sys.executable, "-m", "tsplat", "cat", str(ply)]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT) as p:
        p.stdout.close()
        assert p.stderr.read() == b""


# --- a terminal


def shown(words, code=0, stdin=None, **kwargs):
    """What a terminal of 80x24 cells of 10x20 px was sent after the questions."""
    run = "import sys; from tsplat.cli import main; sys.exit(main(sys.argv[1:]))"
    script = f"import sys; sys.argv[1:] = {['cat', *map(str, words)]!r}; {run}"
    with FakeTerminal(**kwargs) as terminal:
        process = terminal.spawn(script if stdin is None else f"{stdin}; {script}")
        error = process.communicate(timeout=60)[1]
        terminal.settle()
        assert process.returncode == code, error
        assert terminal.mode() == terminal.saved
        assert b"\x1b[?1049h" not in terminal.output
    _, asked, after = terminal.output.partition(b"\x1b8\x1b[J")
    return after if asked else terminal.output


@pytest.mark.parametrize(
    ("extra", "decode", "rows"),
    [
        (KITTY_OK, kitty, 21),
        (b"\x1bP>|Konsole 26.08\x1b\\", iterm2, 21),
        (b"\x1bP>|foot(1.28.0)\x1b\\", sixel, 21),
    ],
    ids=["kitty", "iterm2", "sixel"],
)
def test_the_presenter_is_the_viewers(ply, tmp_path, extra, decode, rows):  # noqa: F811
    """By what the terminal answers; the picture fills the screen but for the rows below it."""
    data = shown([ply, "--background", "0,0,1"], extra=extra)
    begin = re.match(rb"\r((?:\r?\n)+)\x1b\[(\d+)A\x1b7", data)
    assert begin[1].count(b"\n") == int(begin[2]) == rows + 2
    end = re.search(rb"\x1b8\x1b\[m\x1b\[(\d+)B\r(?:\x1b\[m)?$", data)
    assert int(end[1]) == rows
    got = decode(data[begin.end() : end.start()], Terminal(columns=80, rows=24, kitty=True)).picture
    height, width = got.shape[:2]
    assert (width, height) == (750, 20 * rows)
    want = rendered(tmp_path, ply, "--size", f"{width}x{height}", "--background", "0,0,1")
    error, mirrored = (abs(p.astype(int) - want).mean() for p in (got, got[:, ::-1]))
    assert error <= (0 if decode is kitty else mirrored / 4)
    assert mirrored > 1


def test_other_terminals_get_half_blocks(ply):  # noqa: F811
    """In the colours they have, row by row, whether they answer or not."""
    for kwargs in ({"extra": b"\x1b[?62;22c"}, {"delay": None}):
        data = shown([ply, "--presenter", "halfblock", "--columns", 30, "--rows", 30], **kwargs)
        lines = data.replace(b"\r\r\n", b"\r\n").split(b"\r\n")
        assert lines.pop() == b""
        assert pixels(lines).shape == (60, 30, 3)  # more rows than the screen has: they scroll
    silent = shown([ply, "--rows", 4], delay=None)
    assert silent.count(b"\n") == 4


def test_a_picture_too_high_to_be_drawn_is_refused(ply):  # noqa: F811
    """It would scroll away from under the cursor that is drawing it."""
    shown([ply, "--presenter", "sixel", "--rows", 30, "--columns", 30], code=1)


def test_standard_input_may_be_something_else(ply):  # noqa: F811
    """`echo | tsplat cat` asks on /dev/tty, and leaves its input alone."""
    data = shown([ply, "--rows", 5], stdin="import os; r, w = os.pipe(); os.dup2(r, 0)",
                 extra=KITTY_OK)  # fmt: skip
    assert b"\x1b_Ga=T" in data


def test_sigterm_ends_it_while_the_terminal_takes_nothing(ply):  # noqa: F811
    """Stuck in the middle of a picture: it gives up at once, and the tty's mode is as it was."""
    run = f"import sys; from tsplat.cli import main; sys.exit(main(['cat', {str(ply)!r}]))"
    with FakeTerminal(extra=KITTY_OK) as terminal:
        process = terminal.spawn(run)
        terminal.wait_for(b"\x1b8\x1b[J", 60)
        terminal.reading.clear()
        waiting = array.array("i", [0])
        deadline = time.monotonic() + 60
        while waiting[0] < 1000:  # bytes of the picture; the rest does not fit
            assert time.monotonic() < deadline
            time.sleep(0.01)
            fcntl.ioctl(terminal.master, termios.FIONREAD, waiting)
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 128 + signal.SIGTERM
        assert terminal.mode() == terminal.saved
        terminal.reading.set()
        process.stderr.close()
