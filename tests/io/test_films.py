"""Films are read again: as many frames, of that size and length, each what was drawn."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import stat
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image, ImageSequence

from tests.presenters.pictures import frame_of, photo, psnr
from tsplat.core.errors import OutputError, PluginError
from tsplat.io.films import Film, Glyphs, check_film, frame_file, write_film
from tsplat.presenters.base import Terminal
from tsplat.presenters.halfblock import HALFBLOCK
from tsplat.presenters.sixel import SIXEL
from tsplat.testing.decoders import halfblock

COUNT, WIDTH, HEIGHT = 5, 41, 30
PICTURES = [np.roll(photo(WIDTH, HEIGHT, noise=1.0), 3 * n, axis=1) for n in range(COUNT)]


GREYS = [np.repeat(p[..., 1:2], 3, axis=2) for p in PICTURES]  # WebP halves colour's resolution


def film_of(pictures=PICTURES, rate=10.0, **changes):
    height, width = pictures[0].shape[:2]
    return replace(
        Film(len(pictures), rate, (width, height), lambda i: frame_of(pictures[i]),
             notes=lambda i: f"film 1, frame {i}"),
        **changes,
    )  # fmt: skip


def interrupted(at, error=KeyboardInterrupt):
    """A film that stops at a frame."""

    def shot(index):
        if index == at:
            raise error
        return frame_of(PICTURES[index])

    return film_of(shot=shot)


def frames(path):
    """(pictures, ms each) of an animation."""
    with Image.open(path) as film:
        got = [(np.asarray(f.convert("RGB")), f.info["duration"])
               for f in ImageSequence.Iterator(film)]  # fmt: skip
    return [p for p, _ in got], [ms for _, ms in got]


def files(folder):
    return sorted(p.name for p in folder.iterdir())


# --- GIF and WebP


def test_gif_has_every_frame(tmp_path):
    """Frames, size and delays; each picture within what 255 dithered colours can be."""
    out = tmp_path / "a.gif"
    done = write_film(str(out), film_of())
    got, delays = frames(out)
    assert delays == [100] * COUNT
    assert [p.shape for p in got] == [(HEIGHT, WIDTH, 3)] * COUNT
    for picture, want in zip(got, PICTURES, strict=True):
        assert psnr(picture, want) > 30
    assert psnr(got[0], PICTURES[1]) < 20  # the measure tells frames apart
    assert (done.rendered, done.kept, done.size) == (COUNT, 0, out.stat().st_size)
    assert files(tmp_path) == ["a.gif"]


def test_gif_of_few_colours_is_exact(tmp_path):
    """Where a frame has no more colours than a palette nothing is changed."""
    coarse = [p // 64 * 80 for p in PICTURES]
    write_film(str(tmp_path / "a.gif"), film_of(coarse))
    got, _ = frames(tmp_path / "a.gif")
    for picture, want in zip(got, coarse, strict=True):
        np.testing.assert_array_equal(picture, want)


def test_gif_delays_add_up_at_any_rate(tmp_path):
    """30 a second is 3, 4, 3 hundredths and so on: never off by more than half of one."""
    write_film(str(tmp_path / "a.gif"), film_of(rate=30.0))
    _, delays = frames(tmp_path / "a.gif")
    assert set(delays) == {30, 40}
    assert np.all(abs(np.cumsum(delays) - np.arange(1, COUNT + 1) * 1000 / 30) <= 5)


def test_webp_has_every_frame(tmp_path):
    """Frames, size and delays; each picture close to what was drawn, in a loop."""
    out = tmp_path / "a.webp"
    write_film(str(out), film_of(GREYS, rate=8.0))
    got, delays = frames(out)
    assert delays == [125] * COUNT
    for picture, want in zip(got, GREYS, strict=True):
        assert psnr(picture, want) > 30
    assert psnr(got[0], GREYS[1]) < 20
    with Image.open(out) as film:
        assert film.info["loop"] == 0


def test_webp_keeps_transparency(tmp_path):
    """Without a background alpha is the frame's, also where the frames after it have none."""
    clear = frame_of(PICTURES[0])
    clear.transmittance[:10] = 1.0
    film = film_of(shot=lambda i: clear if i == 0 else frame_of(PICTURES[i]), background=None)
    write_film(str(tmp_path / "a.webp"), film)
    with Image.open(tmp_path / "a.webp") as got:
        alpha = np.asarray(got.convert("RGBA"))[..., 3]
    assert alpha[:10].max() == 0
    assert alpha[10:].min() == 255


@pytest.mark.parametrize("suffix", ["gif", "webp"])
def test_a_film_of_one_frame(tmp_path, suffix):
    """It is a picture."""
    write_film(str(tmp_path / f"a.{suffix}"), film_of(GREYS[:1]))
    with Image.open(tmp_path / f"a.{suffix}") as film:
        assert getattr(film, "n_frames", 1) == 1
        assert psnr(np.asarray(film.convert("RGB")), GREYS[0]) > 30


# --- PNG files


def test_a_sequence_is_exact_and_numbered(tmp_path):
    """out-%04d.png: one file a frame from 0 on, every pixel as drawn, the note in it."""
    done = write_film(str(tmp_path / "out-%04d.png"), film_of())
    assert files(tmp_path) == [f"out-000{i}.png" for i in range(COUNT)]
    for i, want in enumerate(PICTURES):
        with Image.open(tmp_path / f"out-000{i}.png") as got:
            np.testing.assert_array_equal(np.asarray(got), want)
            assert got.info["tsplat"] == f"film 1, frame {i}"
    assert (done.rendered, done.kept) == (COUNT, 0)


def test_a_folder_is_made(tmp_path):
    """A name without a suffix, or with a slash at its end, is a folder of numbered files."""
    for name in ("frames", "v1.2/"):
        write_film(f"{tmp_path}/{name}", film_of())
        assert files(tmp_path / name) == [f"000{i}.png" for i in range(COUNT)]
    assert frame_file("a/f%d.png", 12).name == "f12.png"
    assert frame_file("a%02d/f%03d.png", 12).as_posix() == "a%02d/f012.png"


def test_a_sequence_goes_on_where_it_stopped(tmp_path):
    """Whole files of the same film are kept; cut ones, others' and such as are no PNG are not."""
    path = str(tmp_path / "f-%02d.png")
    with pytest.raises(KeyboardInterrupt):
        write_film(path, interrupted(4))
    assert files(tmp_path) == [f"f-0{i}.png" for i in range(4)]
    before = {i: frame_file(path, i).stat().st_mtime_ns for i in range(4)}
    cut = frame_file(path, 1)
    cut.write_bytes(cut.read_bytes()[:-40])
    write_film(str(tmp_path / "other-%02d.png"), film_of(notes=lambda i: "another"))
    (tmp_path / "other-02.png").replace(frame_file(path, 2))
    frame_file(path, 3).write_text("hello")
    made = []

    def shot(index):
        made.append(index)
        return frame_of(PICTURES[index])

    done = write_film(path, film_of(shot=shot))
    assert made == [1, 2, 3, 4]
    assert (done.rendered, done.kept) == (4, 1)
    assert frame_file(path, 0).stat().st_mtime_ns == before[0]
    for i, want in enumerate(PICTURES):
        with Image.open(frame_file(path, i)) as got:
            np.testing.assert_array_equal(np.asarray(got), want)
    made.clear()
    assert write_film(path, film_of(shot=shot)).kept == COUNT
    assert not made
    write_film(path, film_of(shot=shot), force=True)
    assert made == list(range(COUNT))


# --- asciinema


def play(events, columns, rows):
    """The screen after each event of a recording, as half cells."""
    assert {kind for _, kind, _ in events} == {"o"}
    sent = list(itertools.accumulate(data.encode() for _, _, data in events))
    return [halfblock(data, Terminal(columns, rows + 1)) for data in sent]


def test_a_recording_plays_to_the_same_pictures(tmp_path):
    """JSON lines; a header, frames at their times, each screen the frame's pixels."""
    terminal = Terminal(columns=WIDTH, rows=HEIGHT // 2 + 1)
    write_film(str(tmp_path / "a.cast"), film_of(), glyphs=Glyphs(terminal, HALFBLOCK))
    header, *events = map(json.loads, (tmp_path / "a.cast").read_text("utf-8").splitlines())
    assert header["version"] == 2
    assert (header["width"], header["height"]) == (WIDTH, HEIGHT // 2)
    assert [time for time, _, _ in events] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5])
    screens = play(events, WIDTH, HEIGHT // 2)
    for screen, want in zip(screens, [*PICTURES, PICTURES[-1]], strict=True):
        np.testing.assert_array_equal(screen, want)
    assert events[-1][2].endswith("\x1b[?25h")


def test_a_recording_says_only_what_changes(tmp_path):
    """A frame like the one before has no event, and the recording is as long all the same."""
    still = [PICTURES[0], PICTURES[0], PICTURES[0], PICTURES[1]]
    terminal = Terminal(columns=WIDTH, rows=HEIGHT // 2 + 1)
    write_film(str(tmp_path / "a.cast"), film_of(still), glyphs=Glyphs(terminal, HALFBLOCK))
    _, *events = map(json.loads, (tmp_path / "a.cast").read_text("utf-8").splitlines())
    assert [time for time, _, _ in events] == pytest.approx([0, 0.3, 0.4])


def test_a_recording_holds_no_pictures(tmp_path):
    """Sixel and the like are no text; a presenter that fails is named; nothing is left."""
    terminal = Terminal(columns=WIDTH, rows=HEIGHT // 2 + 1)
    broken = replace(HALFBLOCK, name="broken", encode=lambda *a: 1 / 0)
    for presenter, error in ((SIXEL, OutputError), (broken, PluginError)):
        with pytest.raises(error, match=presenter.name):
            write_film(str(tmp_path / "a.cast"), film_of(), glyphs=Glyphs(terminal, presenter))
    assert files(tmp_path) == []


# --- MP4

FFMPEG = f"""#!{sys.executable}
import json, os, pathlib, sys
here = pathlib.Path(__file__).parent
raw = sys.stdin.buffer.read(int(os.environ.get("FAKE_READ", "-1")))
(here / "raw").write_bytes(raw)
(here / "argv").write_text(json.dumps(sys.argv))
if "FAKE_FAIL" in os.environ:
    print("warming up\\nno such encoder", file=sys.stderr)
    sys.exit(3)
pathlib.Path(sys.argv[-1].removeprefix("file:")).write_bytes(b"mp4")
"""


@pytest.fixture
def ffmpeg(tmp_path, monkeypatch):
    """A program of that name that keeps what it is given."""
    folder = tmp_path / "bin"
    folder.mkdir()
    program = folder / "ffmpeg"
    program.write_text(FFMPEG)
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(folder))
    return folder


def test_ffmpeg_gets_every_pixel(ffmpeg, tmp_path):
    """Raw RGB frames, their size and rate; what it makes takes the film's place."""
    out = tmp_path / "-a.mp4"
    done = write_film(str(out), film_of(rate=24.0))
    raw = np.frombuffer((ffmpeg / "raw").read_bytes(), np.uint8)
    np.testing.assert_array_equal(raw.reshape(COUNT, HEIGHT, WIDTH, 3), PICTURES)
    words = json.loads((ffmpeg / "argv").read_text())
    assert words[words.index("-video_size") + 1] == f"{WIDTH}x{HEIGHT}"
    assert words[words.index("-framerate") + 1] == "24.0"
    assert out.read_bytes() == b"mp4"
    assert done.size == 3
    assert files(tmp_path) == ["-a.mp4", "bin"]


@pytest.mark.parametrize("read", ["-1", "1"])
def test_ffmpegs_failure_is_told(ffmpeg, tmp_path, monkeypatch, read):
    """Its last words, whether it has read all frames or given up before; no file is left."""
    monkeypatch.setenv("FAKE_FAIL", "1")
    monkeypatch.setenv("FAKE_READ", read)
    many = film_of([photo(200, 100)] * 9)  # more than a pipe holds
    with pytest.raises(OutputError, match="ffmpeg cannot write the film: no such encoder"):
        write_film(str(tmp_path / "a.mp4"), many)
    assert files(tmp_path) == ["bin"]


def test_without_ffmpeg_other_formats_are_named(tmp_path, monkeypatch):
    """Before anything is rendered."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(OutputError, match=r"needs ffmpeg.*\.webp, \.gif, \.cast or PNG"):
        check_film(str(tmp_path / "a.mp4"), 25)


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg on PATH")
def test_mp4_by_the_real_ffmpeg(tmp_path):
    """ffmpeg reads its film again: as many frames, even sizes, pictures like those drawn."""
    import subprocess

    smooth = [photo(WIDTH, HEIGHT, noise=0.0) // 2 + 20 * n for n in range(COUNT)]
    write_film(str(tmp_path / "a.mp4"), film_of(smooth))
    raw = subprocess.run(
        ["ffmpeg", "-loglevel", "error", "-i", tmp_path / "a.mp4", "-f", "rawvideo",
         "-pix_fmt", "rgb24", "pipe:1"], capture_output=True, check=True,
    ).stdout  # fmt: skip
    got = np.frombuffer(raw, np.uint8).reshape(COUNT, HEIGHT, WIDTH + 1, 3)[:, :, :WIDTH]
    for picture, want in zip(got, smooth, strict=True):
        assert psnr(picture, want) > 24


# --- all or nothing


@pytest.mark.parametrize("name", ["a.gif", "a.webp", "a.cast", "a.mp4"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, MemoryError])
@pytest.mark.usefixtures("ffmpeg")
def test_a_film_cut_short_leaves_what_was_there(tmp_path, name, error):
    """Interrupted at the third frame: no half film, no temporary file; an older film is whole."""
    out = tmp_path / name
    out.write_bytes(b"older")
    terminal = Terminal(columns=WIDTH, rows=HEIGHT // 2 + 1)
    with pytest.raises(error):
        write_film(str(out), interrupted(2, error), glyphs=Glyphs(terminal, HALFBLOCK))
    assert out.read_bytes() == b"older"
    assert files(tmp_path) == sorted([name, "bin"])


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        ("a.avi", {}, "unknown suffix '.avi' of a film"),
        ("-", {}, "standard output"),
        ("a.png", {}, "out-%04d.png"),
        ("a-%d-%d.png", {}, "out-%04d.png"),
        ("no/a.gif", {}, "create it first"),
        ("no/frames/", {}, "create it first"),
        ("a.gif", {"rate": 60.0}, "50 frames a second at most"),
        ("a.gif", {"background": None}, "no transparency"),
        ("a.cast", {"background": None}, "no transparency"),
        ("plain", {}, "not a regular file|not a folder"),
    ],
)
def test_what_cannot_be_written_is_refused_first(tmp_path, monkeypatch, name, change, text):
    """In one line, before a frame is made."""
    monkeypatch.chdir(tmp_path)
    if name == "plain":
        os.mkfifo(name)
    film = film_of(shot=lambda i: pytest.fail("a frame was made"), **change)
    with pytest.raises(OutputError, match=text):
        write_film(name, film)
