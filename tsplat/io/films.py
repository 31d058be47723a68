"""Frames -> film: animated GIF and WebP by Pillow, a sequence of PNG files, an asciinema recording,
and MP4 by ffmpeg.

A film appears whole or not at all, as pictures do; of a PNG sequence every file does. asciicast v2:
https://docs.asciinema.org/manual/asciicast/v2/ .
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tsplat.core.errors import OutputError, PluginError, printable
from tsplat.core.types import U8, Frame
from tsplat.io.images import Background, beside, check_place, to_pixels, write_bytes
from tsplat.presenters.base import Presenter, Terminal, encoded

if TYPE_CHECKING:
    from PIL import Image

SUFFIXES = (".gif", ".webp", ".mp4", ".cast", ".png")
GIF_RATE = 50.0
"""Frames a second at most: delays are whole hundredths, and browsers slow 0.01 s down to 0.1 s."""
GIF_COLORS = 255
"""Of each frame; the 256th means unchanged."""
WEBP: dict[str, int | bool] = {"quality": 90, "method": 2}
"""A frame of 640x360 of the demo scene has 24 kB, lossless 125, and takes a tenth of the time."""
WEBP_CLEAR: dict[str, int | bool] = {"lossless": True, "method": 2}
"""With transparency, which libwebp forgets of a lossy film whose last frame is opaque."""
NOTE = "tsplat"
"""Keyword of the PNG text that says of which film a file is a frame."""
NUMBER = re.compile(r"%(0?)([0-9]?)d")
IN_FOLDER = "%04d.png"
"""What files are called in a folder."""
STRINGS = re.compile(rb"\x1b[P_\]^X]")
"""Begins of DCS, APC, OSC, PM and SOS: what pictures come in, and text does not."""

Shot = Callable[[int], Frame]
"""The frame of that number, from 0 on; good until the frame after the next is made."""


@dataclass(frozen=True, eq=False)
class Film:
    """What is to be written."""

    count: int  # frames, 1 or more
    rate: float  # frames a second
    size: tuple[int, int]  # px
    shot: Shot  # with a camera's picture, without background
    background: Background = (0.0, 0.0, 0.0)
    notes: Callable[[int], str] = lambda index: ""  # what frame ``index`` depends on, in a line


@dataclass(frozen=True)
class Written:
    """What became of a film."""

    rendered: int  # frames
    kept: int  # frames of a PNG sequence that were there
    size: int  # bytes


@dataclass(frozen=True)
class Glyphs:
    """The terminal and the presenter of a recording."""

    terminal: Terminal  # one row more than the recording has
    presenter: Presenter


def _is_folder(path: str) -> bool:
    return path.endswith("/") or not Path(path).suffix or Path(path).is_dir()


def is_sequence(path: str) -> bool:
    """Whether ``path`` names numbered PNG files: ``out-%04d.png``, or a folder."""
    return _is_folder(path) or Path(path).suffix.lower() == ".png"


def frame_file(path: str, index: int) -> Path:
    """The file of frame ``index`` of a PNG sequence."""
    place = Path(path) / IN_FOLDER if _is_folder(path) else Path(path)
    return place.with_name(NUMBER.sub(lambda match: _number(match, index), place.name))


def _number(match: re.Match[str], index: int) -> str:
    width = int(match[2] or 0)
    return str(index).zfill(width) if match[1] else str(index).rjust(width)


def check_film(path: str, rate: float, background: Background = (0.0, 0.0, 0.0)) -> None:
    """Finds out before anything is rendered whether a film can be written to ``path``.

    Raises:
        OutputError: unknown suffix, no such directory, no permission, no ffmpeg, a rate or a
            transparency that the format does not have.
    """
    shown, suffix = printable(path), Path(path).suffix.lower()
    if path == "-":
        raise OutputError("a film cannot go to standard output; name a file")
    if is_sequence(path):
        if not _is_folder(path) and len(NUMBER.findall(Path(path).name)) != 1:
            raise OutputError(
                f"{shown}: a film is many PNG files; name them out-%04d.png, or name a folder"
            )
        there = not _is_folder(path) or Path(path).is_dir()
        check_place(str(frame_file(path, 0)) if there else path.rstrip("/"))
        return
    if suffix not in SUFFIXES:
        raise OutputError(
            f"{shown}: unknown suffix {suffix!r} of a film; known: {', '.join(SUFFIXES)}, "
            "or a folder for PNG files"
        )
    if background is None and suffix != ".webp":
        raise OutputError(f"{shown}: {suffix} has no transparency; take .webp or PNG files")
    if suffix == ".gif" and rate > GIF_RATE:
        raise OutputError(
            f"{shown}: GIF shows {GIF_RATE:.0f} frames a second at most; lower --fps, "
            "or take .webp or .mp4"
        )
    if suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise OutputError(
            f"{shown}: .mp4 needs ffmpeg, which is not on PATH; install it, "
            "or take .webp, .gif, .cast or PNG files"
        )
    check_place(path)


def write_film(
    path: str, film: Film, *, force: bool = False, glyphs: Glyphs | None = None
) -> Written:
    """Makes the frames of ``film`` one by one and writes them in the format of ``path``'s suffix.

    Args:
        path: ends in .gif, .webp, .mp4 or .cast; or has %04d in its name and ends in .png; or is a
            folder, made if need be.
        film: what to write.
        force: make frames again that a PNG sequence has already.
        glyphs: how .cast shows frames, which are then as large as the presenter wants them.

    Raises:
        OutputError: it cannot be written; one line that says why and what to do.
    """
    check_film(path, film.rate, film.background)
    if is_sequence(path):
        return _write_sequence(path, film, force)
    write = {".gif": _write_gif, ".webp": _write_webp, ".mp4": _write_mp4}.get(
        Path(path).suffix.lower()
    )
    place = Path(os.path.realpath(path))
    try:
        with beside(place) as other:
            if write is not None:
                write(other, film)
            else:
                assert glyphs is not None
                _write_cast(other, film, glyphs)
            size = other.stat().st_size
    except (OutputError, PluginError):
        raise
    except OSError as error:
        reason = printable(error.strerror or error)
        raise OutputError(f"{printable(path)}: cannot be written: {reason}") from error
    return Written(film.count, 0, size)


def _delays(film: Film, unit: int) -> list[int]:
    """How long each frame is shown, ms, in multiples of ``unit`` that add up."""
    ends = [round((i + 1) * 1000 / film.rate / unit) for i in range(film.count)]
    return [unit * (end - begin) for begin, end in zip([0, *ends], ends, strict=False)]


# --- GIF and WebP


def _pictures(film: Film) -> Iterator[U8]:
    """[H, W, 3 or 4] of each frame."""
    for index in range(film.count):
        yield to_pixels(film.shot(index), film.background)


def _reel(pictures: Iterator[Image.Image], count: int) -> Image.Image:
    """An image of ``count`` frames, as Pillow reads one from a file, made when they are asked for.

    Given as a list they would all be in memory at once.
    """
    from PIL import Image

    class Reel(Image.Image):
        n_frames = count
        _at = -1

        def seek(self, frame: int) -> None:
            if frame >= count:
                raise EOFError
            if frame == self._at + 1:  # writers go on by one, and back to the first at the end
                picture = next(pictures)
                self.im, self._mode, self._size = picture.im, picture.mode, picture.size
                self.palette, self._at = picture.palette, frame

        def tell(self) -> int:
            return max(self._at, 0)

    reel = Reel()
    reel.seek(0)
    return reel


def _write_gif(place: Path, film: Film) -> None:
    """Each frame in 255 colours of its own, dithered in a fixed pattern that does not crawl."""
    from PIL import Image

    from tsplat.presenters.dither import adaptive_palette, distinct, dither

    def frames() -> Iterator[Image.Image]:
        for picture in _pictures(film):
            colors = distinct(picture)
            palette = np.rint(adaptive_palette(colors, GIF_COLORS)).astype(np.uint8)
            image = Image.fromarray(dither(colors, palette))
            image.putpalette(palette.astype(np.uint8).tobytes())
            yield image

    with place.open("wb") as stream:
        _reel(frames(), film.count).save(
            stream, "GIF", save_all=True, duration=_delays(film, 10), loop=0, optimize=True
        )


def _write_webp(place: Path, film: Film) -> None:
    from PIL import Image

    frames = (Image.fromarray(picture) for picture in _pictures(film))
    options = WEBP_CLEAR if film.background is None else WEBP
    with place.open("wb") as stream:
        _reel(frames, film.count).save(
            stream, "WEBP", save_all=True, duration=_delays(film, 1), loop=0, **options
        )


# --- PNG sequence


def _write_sequence(path: str, film: Film, force: bool) -> Written:
    """Frames that are there, whole and of this film, are kept unless ``force``."""
    import io

    from PIL import Image, PngImagePlugin

    if _is_folder(path):
        try:
            Path(path).mkdir(exist_ok=True)
        except OSError as error:
            reason = printable(error.strerror)
            raise OutputError(f"{printable(path)}: cannot be made: {reason}") from error
    rendered = kept = size = 0
    for index in range(film.count):
        place = frame_file(path, index)
        if not force and _is_whole(place, film.size, film.notes(index)):
            kept += 1
        else:
            note = PngImagePlugin.PngInfo()
            note.add_text(NOTE, film.notes(index))
            buffer = io.BytesIO()
            picture = Image.fromarray(to_pixels(film.shot(index), film.background))
            picture.save(buffer, "PNG", compress_level=6, pnginfo=note)
            write_bytes(str(place), buffer.getvalue())
            rendered += 1
        size += place.stat().st_size
    return Written(rendered, kept, size)


def _is_whole(place: Path, size: tuple[int, int], note: str) -> bool:
    """Whether a PNG file of that size and note can be read to its end."""
    from PIL import Image

    try:
        with Image.open(place, formats=("PNG",)) as picture:
            picture.load()
            return picture.size == size and picture.info.get(NOTE) == note
    except (OSError, ValueError, SyntaxError):
        return False


# --- asciinema


def _write_cast(place: Path, film: Film, glyphs: Glyphs) -> None:
    """A recording that draws each frame from the top left on, only what changed."""
    terminal, presenter = glyphs.terminal, glyphs.presenter
    header = {
        "version": 2,
        "width": terminal.columns,
        "height": terminal.rows - 1,
        "title": "tsplat",
        "env": {"TERM": "xterm-256color"},
    }
    background = film.background or (0.0, 0.0, 0.0)
    shown: Frame | None = None
    with place.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(json.dumps(header) + "\n")
        before = "\x1b[?25l\x1b[m\x1b[2J"
        for index in range(film.count):
            frame = film.shot(index).over(background)
            drawn = encoded(presenter, frame, terminal, shown)
            if STRINGS.search(drawn):
                raise OutputError(
                    f"a recording holds text, and {presenter.name} draws pictures; "
                    "take --presenter halfblock"
                )
            data = drawn.decode("utf-8")
            if before or data:
                event = [round(index / film.rate, 6), "o", f"{before}\x1b[H{data}"]
                stream.write(json.dumps(event, ensure_ascii=False) + "\n")
            shown, before = frame, ""
        last = [round(film.count / film.rate, 6), "o", "\x1b[m\x1b[?25h"]
        stream.write(json.dumps(last) + "\n")


# --- MP4


def _write_mp4(place: Path, film: Film) -> None:
    """Raw frames through a pipe to ffmpeg, which is killed if the rest is not to come.

    The codec is ffmpeg's own choice for MP4: H.264 where it has that. yuv420p is what every player
    shows; it needs even sizes, so an odd one gets a black row or column.
    """
    import subprocess
    import tempfile

    command = [
        "ffmpeg", "-nostdin", "-loglevel", "error", "-y",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", "{}x{}".format(*film.size),
        "-framerate", str(film.rate), "-i", "pipe:0",
        "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", "-f", "mp4", f"file:{place}",
    ]  # fmt: skip
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said,
            process_group=0,  # Ctrl-C is ours to deal with
        )  # fmt: skip
        assert process.stdin is not None
        try:
            with suppress(BrokenPipeError):  # it has given up, and says why
                for picture in _pictures(film):
                    process.stdin.write(picture.tobytes())
                process.stdin.close()
            code = process.wait()
        finally:
            process.kill()
            process.wait()
            with suppress(BrokenPipeError):
                process.stdin.close()
        if code:
            said.seek(0)
            lines = said.read().decode("utf-8", "replace").strip().splitlines()
            why = printable(lines[-1]) if lines else f"exit code {code}"
            raise OutputError(f"ffmpeg cannot write the film: {why}")
