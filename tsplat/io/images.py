"""Frame -> file: PNG, JPEG and WebP by Pillow, raw floats as .npy and .npz.

A file appears whole or not at all: it is written beside its place and moved there.
"""

from __future__ import annotations

import io
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tsplat.core.errors import OutputError, printable
from tsplat.core.types import U8, Frame

if TYPE_CHECKING:
    from tsplat.core.camera import Camera

Background = tuple[float, float, float] | None
"""RGB in 0..1, or None for transparent."""

PILLOW = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP"}
SUFFIXES = (*PILLOW, ".npy", ".npz")
STDOUT = "-"

OPTIONS: dict[str, dict[str, int | bool]] = {
    "PNG": {"compress_level": 6},
    "JPEG": {"quality": 95, "subsampling": 0},
    # lossless, and the colour of transparent pixels too, so that what is read is what was drawn
    "WEBP": {"lossless": True, "exact": True},
}


def _suffix(path: str) -> str:
    return ".png" if path == STDOUT else Path(path).suffix.lower()


def needs_depth(path: str) -> bool:
    """Whether writing to ``path`` takes a frame with depth: .npz does."""
    return _suffix(path) == ".npz"


def check_output(path: str, background: Background = (0.0, 0.0, 0.0)) -> None:
    """Finds out before anything is rendered whether a picture can be written to ``path``.

    Raises:
        OutputError: unknown suffix, no such directory, no permission, standard output is a
            terminal, JPEG without a background.
    """
    shown = printable(path)
    suffix = _suffix(path)
    if suffix not in SUFFIXES:
        raise OutputError(f"{shown}: unknown suffix {suffix!r}; known: {', '.join(SUFFIXES)}, or -")
    if background is None and PILLOW.get(suffix) == "JPEG":
        raise OutputError(f"{shown}: JPEG has no transparency; choose a background, PNG or WebP")
    if path == STDOUT:
        if sys.stdout.isatty():
            raise OutputError("standard output is a terminal; redirect it: tsplat ... > image.png")
        return
    check_place(path)


def check_place(path: str) -> None:
    """Finds out whether a file can be put at ``path``.

    Raises:
        OutputError: no such directory, no permission, or what is there is no regular file.
    """
    shown = printable(path)
    place = Path(os.path.realpath(path))
    if not place.parent.is_dir():
        raise OutputError(f"{shown}: no directory {printable(place.parent)}; create it first")
    if place.exists() and not stat.S_ISREG(place.stat().st_mode):
        raise OutputError(f"{shown}: exists and is not a regular file; choose another name")
    if not os.access(place.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{shown}: no permission to write in {printable(place.parent)}")


def to_rgba(frame: Frame) -> U8:
    """[H, W, 4] 8-bit straight (not premultiplied) RGB and alpha; black where alpha is 0."""
    alpha = (1 - frame.transmittance).clip(0, 1)[..., None]
    colour = np.divide(frame.rgb, alpha, out=np.zeros_like(frame.rgb), where=alpha > 0)
    straight = Frame(np.concatenate([colour, alpha], axis=2), frame.transmittance)
    return straight.to_uint8()


def to_pixels(frame: Frame, background: Background) -> U8:
    """[H, W, 3] over ``background``, or [H, W, 4] if that is None."""
    return to_rgba(frame) if background is None else frame.over(background).to_uint8()


def encode(suffix: str, frame: Frame, camera: Camera | None, background: Background) -> bytes:
    """The bytes of a file with that suffix.

    ``.npy`` is float32 [H, W, 4]: premultiplied RGB and alpha, without background. ``.npz`` holds
    rgb, transmittance and depth as they are in Frame, and the camera: viewmat, K, width, height,
    near, far.

    Raises:
        OutputError: ``.npz`` of a frame without depth, or without a camera.
    """
    buffer = io.BytesIO()
    if suffix == ".npy":
        rgba = np.concatenate([frame.rgb, 1 - frame.transmittance[..., None]], axis=2)
        np.save(buffer, rgba.astype(np.float32, copy=False))
    elif suffix == ".npz":
        if frame.depth is None or camera is None:
            lacks = "a camera" if camera is None else "depth"
            raise OutputError(f".npz holds depth and camera, but this frame comes without {lacks}")
        np.savez(
            buffer,
            rgb=frame.rgb,
            transmittance=frame.transmittance,
            depth=frame.depth,
            viewmat=camera.viewmat,
            K=camera.K,
            width=camera.width,
            height=camera.height,
            near=camera.near,
            far=camera.far,
        )
    else:
        from PIL import Image

        kind = PILLOW[suffix]
        Image.fromarray(to_pixels(frame, background)).save(buffer, kind, **OPTIONS[kind])
    return buffer.getvalue()


def write_output(path: str, frame: Frame, camera: Camera | None, background: Background) -> None:
    """Writes ``frame`` to ``path``, in the format of its suffix; ``-`` is PNG on standard output.

    Args:
        path: ends in .png, .jpg, .jpeg, .webp, .npy or .npz, or is ``-``.
        frame: the picture; ``.npz`` needs its depth.
        camera: what it was made with; only ``.npz`` keeps it.
        background: RGB in 0..1, or None for transparent. Not used by .npy and .npz.

    Raises:
        OutputError: it cannot be written; one line that says why and what to do.
    """
    check_output(path, background)
    shown = "standard output" if path == STDOUT else printable(path)
    try:
        data = encode(_suffix(path), frame, camera, background)
    except OutputError as error:
        raise OutputError(f"{shown}: {error}") from error
    except (OSError, ValueError, KeyError) as error:  # what Pillow raises: sizes, missing codecs
        raise OutputError(f"{shown}: Pillow cannot write it: {printable(error)}") from error
    write_bytes(path, data)


def write_bytes(path: str, data: bytes) -> None:
    """Puts ``data`` at ``path``, whole or not at all; ``-`` is standard output.

    Raises:
        OutputError: it cannot be written; one line that says why.
    """
    shown = "standard output" if path == STDOUT else printable(path)
    try:
        if path == STDOUT:
            sys.stdout.buffer.write(data)
            sys.stdout.buffer.flush()
        else:
            _replace(Path(os.path.realpath(path)), data)
    except OSError as error:
        raise OutputError(f"{shown}: cannot be written: {printable(error.strerror)}") from error


def _replace(place: Path, data: bytes) -> None:
    """Puts a file at ``place`` in one step; what was there stays whole until then."""
    with beside(place) as other:
        other.write_bytes(data)


@contextmanager
def beside(place: Path) -> Iterator[Path]:
    """A file that takes ``place`` in one step if all goes well, and is gone if not."""
    other = place.with_name(f".{place.stem[:200]}.{os.getpid()}.tmp{place.suffix}")
    try:
        other.open("xb").close()  # with the mode the user's umask asks for
        yield other
        other.replace(place)
    except BaseException:
        with suppress(FileNotFoundError):
            other.unlink()
        raise


def save_image(
    frame: Frame, path: str | os.PathLike[str], background: Background = (0.0, 0.0, 0.0)
) -> None:
    """:func:`write_output` for a frame whose camera is not at hand; ``.npz`` needs one.

    Raises:
        OutputError: it cannot be written; one line that says why and what to do.
    """
    write_output(os.fspath(path), frame, None, background)
