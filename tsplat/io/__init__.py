"""Files in and out: scenes, cameras, pictures.

Logits, logarithms and channel-major coefficients end here. A scene format enters through the hook
``tsplat_readers``; INRIA's PLY, built in, does so too.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tsplat.core.errors import ParamsError, SceneError, TsplatError, printable
from tsplat.io.clean import scene_from_arrays

if TYPE_CHECKING:
    from tsplat.core.camera import Camera
    from tsplat.core.types import Frame, Scene
    from tsplat.io.base import Reader
    from tsplat.io.write.base import WriteOptions, Written

__all__ = ["load_cameras", "load_scene", "save_image", "save_scene", "scene_from_arrays"]

START = 4096
"""Bytes from the start of a file that readers are shown."""


def load_scene(
    path: str | os.PathLike[str],
    *,
    max_splats: int | None = None,
    raw_opacity: bool = False,
    sh_float32: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Scene:
    """The Gaussians of a file; which reader reads it is decided by its first bytes.

    Gaussians that cannot be drawn are left out and counted by reason in ``Scene.dropped``.

    Args:
        path: a file in a format some installed plugin reads, or the folder of an unbundled SOG;
            ``tsplat plugins`` lists the formats.
        max_splats: keep at most this many, drawn evenly from the whole file; the same ones on
            every run. How many that leaves out is counted too.
        raw_opacity: the file stores opacities as 0..1, not as logits. Formats in which there is
            nothing to choose refuse it.
        sh_float32: keep spherical harmonics in float32. Otherwise they are float16 where that
            moves no colour by a quarter of an 8-bit level; ``Scene.sh_error`` is how much it does.
        progress: called often with (done, total) in any unit;
            :func:`tsplat.io.progress.progress_bar` makes one that draws on stderr.

    Raises:
        SceneError: no scene can be made of the file; one line that says why and what to do.
        ParamsError: ``max_splats`` is less than 1.
    """
    from tsplat.io.base import ReadOptions

    if max_splats is not None and max_splats < 1:
        raise ParamsError(f"max_splats: expected 1 or more, got {max_splats}")
    options = ReadOptions(max_splats, raw_opacity, sh_float32=sh_float32)
    if progress is not None:
        options = replace(options, progress=progress)
    file = _scene_file(Path(path))
    shown = printable(file)
    try:
        start = _start(file)
        reader = _reader(file, start)
        scene = reader.load()(file, options)
        if not scene.source:
            scene = replace(scene, source=reader.name)
    except TsplatError:
        raise
    except OSError as error:
        raise SceneError(f"{shown}: cannot be read: {printable(error.strerror)}") from error
    except MemoryError as error:
        raise SceneError(
            f"{shown}: not enough memory for all of its Gaussians; "
            "load fewer with max_splats (--max-splats)"
        ) from error
    if len(scene) == 0:
        raise SceneError(f"{shown}: holds no Gaussians")
    return scene


def _scene_file(path: Path) -> Path:
    """``path`` itself; of a folder that is a scene, an unbundled SOG, the file to read first."""
    inside = path / "meta.json"
    try:
        return inside if inside.is_file() else path
    except OSError:  # a name that is too long
        return path


def _start(file: Path) -> bytes:
    """The first bytes of a regular file that is not empty."""
    shown = printable(file)
    if file.is_dir():
        inside = sorted([*file.glob("*.ply"), *file.glob("point_cloud/iteration_*/*.ply")])
        hint = f", such as {printable(inside[-1])}" if inside else ""
        raise SceneError(f"{shown}: is a directory; name a file in it{hint}")
    if not file.exists():
        raise SceneError(f"{shown}: no such file")
    if not file.is_file():
        raise SceneError(f"{shown}: not a regular file; save it to disk first")
    with file.open("rb") as stream:
        start = stream.read(START)
    if not start:
        raise SceneError(f"{shown}: the file is empty; copy or download it again")
    return start


def _reader(file: Path, start: bytes) -> Reader:
    """The first reader that recognises the file; built-in ones come first, guesses last."""
    from tsplat.io.foreign import foreign
    from tsplat.plugins import plugins

    readers = plugins().readers
    faults = []
    for reader in sorted(readers.values(), key=lambda reader: reader.guesses):
        try:
            if reader.recognises(start):
                return reader
        except Exception as error:  # a plugin's code may raise anything
            faults.append(f"; reader {reader.name!r} failed: {printable(error)}")
    raise SceneError(
        f"{printable(file)}: {foreign(file, start)}; formats read: "
        f"{', '.join(sorted(readers))}{''.join(faults)}"
    )


def load_cameras(path: str | os.PathLike[str]) -> list[Camera]:
    """The cameras of a JSON file, tsplat's own or INRIA's; see :mod:`tsplat.io.cameras`.

    Raises:
        CameraError: no cameras can be made of the file; one line that says why.
    """
    from tsplat.io import cameras

    return cameras.load_cameras(path)


def save_image(
    frame: Frame,
    path: str | os.PathLike[str],
    background: tuple[float, float, float] | None = (0.0, 0.0, 0.0),
) -> None:
    """Writes ``frame`` as PNG, JPEG, WebP or .npy, by suffix; see :mod:`tsplat.io.images`.

    Args:
        frame: the picture.
        path: where to; ``-`` is PNG on standard output.
        background: RGB in 0..1 behind the picture; None keeps it transparent.

    Raises:
        OutputError: it cannot be written; one line that says why and what to do.
    """
    from tsplat.io import images

    images.save_image(frame, path, background)


def save_scene(
    scene: Scene,
    path: str | os.PathLike[str],
    *,
    to: str | None = None,
    sh_degree: int | None = None,
    options: WriteOptions | None = None,
    force: bool = False,
) -> Written:
    """Writes ``scene`` to a file, rows in the order of the file it came from.

    Args:
        scene: what is written; load it with ``sh_float32`` so that nothing is rounded twice.
        path: where to; the suffix says in which format.
        to: a writer's name, whatever the suffix.
        sh_degree: bands of harmonics above it are left out.
        options: what the format leaves open.
        force: replace a file that is there; it stays whole until the new one is.

    Returns:
        What was written and what the format did not hold.

    Raises:
        OutputError: it cannot be written; one line that says why and what to do.
        PluginError: there is no writer ``to``.
        ParamsError: an option or a degree that the format does not have.
    """
    from tsplat.io.write import check_writing, find_writer, write_scene
    from tsplat.io.write.base import WriteOptions
    from tsplat.io.write.source import Source
    from tsplat.plugins import plugins

    place = os.fspath(path)
    writer = find_writer(plugins().writers, place, to)
    options = WriteOptions() if options is None else options
    check_writing(place, writer, options, sh_degree, force=force)
    degree = writer.degree if sh_degree is None else sh_degree
    return write_scene(Source(scene, degree=degree), place, writer, options)
