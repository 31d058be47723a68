"""``tsplat convert``: a scene in another format, and what that cost."""

from __future__ import annotations

import argparse
import os
import statistics
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tsplat.commands import INTERRUPTED
from tsplat.commands.common import edits, load_unedited, print_json, say, unwinding
from tsplat.core.errors import CameraError, SceneError, printable
from tsplat.edits import NOTHING, nothing_left
from tsplat.io.progress import progress_bar
from tsplat.io.write import check_writing, find_writer, write_scene
from tsplat.io.write.base import WriteOptions, Writer, Written
from tsplat.io.write.source import Source, Verbatim
from tsplat.plugins import plugins

if TYPE_CHECKING:
    from tsplat.core.camera import Camera
    from tsplat.core.types import Scene
    from tsplat.quality.converted import FieldError
    from tsplat.quality.measure import Error


@dataclass(frozen=True)
class Done:
    """A conversion."""

    writer: Writer
    source: Source
    written: Written
    bytes_in: int
    bytes_out: int
    seconds: dict[str, float]


@dataclass(frozen=True)
class Measured:
    """What reading the file back says."""

    fields: list[FieldError]
    pictures: list[Error]
    size: tuple[int, int]
    own_cameras: int  # of the pictures


def run(arguments: argparse.Namespace) -> int:
    """Reads, writes, reads back, reports."""
    writer = find_writer(plugins().writers, arguments.output, arguments.to)
    options = WriteOptions(arguments.format_version, arguments.fractional_bits, arguments.sh_bits)
    check_writing(arguments.output, writer, options, arguments.sh_degree, force=arguments.force)
    with unwinding():
        done = _convert(arguments, writer, options)
    try:
        measured = None if arguments.no_measure else _measured(arguments, done)
    except KeyboardInterrupt:
        say(f"{printable(arguments.output)}: written, but not measured: interrupted")
        return INTERRUPTED
    if arguments.json:
        print_json(_facts(arguments, done, measured))
    else:
        _tell(arguments, done, measured)
    return 0


def _convert(arguments: argparse.Namespace, writer: Writer, options: WriteOptions) -> Done:
    begin = time.perf_counter()
    path = Path(arguments.scene)
    scene = load_unedited(arguments, exact=True)
    if arguments.flip_y:
        from tsplat.io.turn import half_turned

        scene = half_turned(scene)
    loaded = time.perf_counter()
    bytes_in = _bytes_in(path)
    degree = writer.degree if arguments.sh_degree is None else arguments.sh_degree
    source = Source(scene, degree=degree, edits=edits(arguments))
    if not len(source):
        raise nothing_left(scene, source.edits)
    with ExitStack() as stack:
        as_is = not (arguments.raw_opacity or arguments.flip_y)
        if writer.name == "ply" and _is_inria(scene) and as_is:
            verbatim = Verbatim(path, source, arguments.max_splats)
            source.verbatim = stack.enter_context(verbatim)
        progress = stack.enter_context(progress_bar(f"writing {arguments.output}"))
        written = write_scene(source, arguments.output, writer, replace(options, progress=progress))
    seconds = {"read": loaded - begin, "write": time.perf_counter() - loaded}
    return Done(writer, source, written, bytes_in, Path(arguments.output).stat().st_size, seconds)


def _is_inria(scene: Scene) -> bool:
    """Whether the built-in reader read INRIA's rows; others say more of their files."""
    return scene.source == "ply"


def _bytes_in(path: Path) -> int:
    """Of the file; of all files of a scene that is a folder or names others beside it."""
    if path.name == "meta.json":
        path = path.parent
    files = [f for f in path.iterdir() if f.is_file()] if path.is_dir() else [path]
    return sum(f.stat().st_size for f in files)


def _measured(arguments: argparse.Namespace, done: Done) -> Measured:
    from tsplat.io import load_scene
    from tsplat.quality import converted

    with progress_bar(f"reading {arguments.output}") as progress:
        try:
            back = load_scene(arguments.output, sh_float32=True, progress=progress)
        except SceneError as error:  # what no reader can draw is no less written
            raise SceneError(f"written, but it cannot be measured: {error}") from error
    fields = converted.field_errors(done.source, done.written.order, Source(back))
    whole = done.source.drawn_scene()
    own = _own_cameras(arguments)
    size = arguments.size or converted.SIZE
    cameras = converted.standard_views(whole, own, size)
    with progress_bar("comparing pictures") as progress:
        errors = converted.picture_errors(
            whole, back, cameras, backend=arguments.backend, threads=arguments.threads,
            progress=progress,
        )  # fmt: skip
    return Measured(fields, errors, size, len(cameras) - converted.RING)


def _own_cameras(arguments: argparse.Namespace) -> list[Camera]:
    from tsplat.commands.view import scene_cameras

    if arguments.flip_y and arguments.cameras is None:
        return []  # those beside IN look at it as it was
    try:
        return scene_cameras(arguments)
    except CameraError:
        if arguments.cameras is not None:
            raise
        return []


def _cut(done: Done) -> dict[str, int]:
    return {**done.source.given.dropped, **done.source.cut}


def _facts(arguments: argparse.Namespace, done: Done, measured: Measured | None) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "input": printable(arguments.scene),
        "output": printable(arguments.output),
        "format": done.writer.name,
        "about": done.written.about,
        "rows_in": len(done.source) + sum(_cut(done).values()),
        "rows_out": len(done.source),
        "left_out": _cut(done),
        "bytes_in": done.bytes_in,
        "bytes_out": done.bytes_out,
        "seconds": done.seconds,
        "exact": done.source.verbatim is not None and done.source.edits == NOTHING,
        "reordered": done.written.order is not None,
        "not_held": list(done.written.notes),
        "fields": None,
        "pictures": None,
    }
    if measured is not None:
        decibels = [e.psnr for e in measured.pictures]
        facts["fields"] = {
            e.field: {"unit": e.unit, "worst": e.worst, "rms": e.rms} for e in measured.fields
        }
        facts["pictures"] = {
            "count": len(decibels),
            "own_cameras": measured.own_cameras,
            "size": list(measured.size),
            "psnr_worst": min(decibels),
            "psnr_median": statistics.median(decibels),
            "ssim_worst": min(e.ssim for e in measured.pictures),
            "worst_levels": max(e.worst for e in measured.pictures),
        }
    return facts


def _size(count: int) -> str:
    return f"{count / 1e6:.2f} MB" if count >= 1e5 else f"{count:,} bytes"


def _tell(arguments: argparse.Namespace, done: Done, measured: Measured | None) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(soft_wrap=True)
    count = len(done.source)
    lines = [
        ("written", f"{printable(os.fspath(arguments.output))}: {done.written.about}"),
        ("Gaussians", f"{count:,}" + (", in another order" if _reordered(done) else "")),
        (
            "size",
            f"{_size(done.bytes_in)} to {_size(done.bytes_out)}, {done.bytes_out / count:.1f} "
            "bytes a Gaussian",
        ),
        ("time", ", ".join(f"{name} {s:.2f} s" for name, s in done.seconds.items())),
    ]
    if done.source.verbatim is not None and done.source.edits == NOTHING:
        lines.append(("exact", "each number is the file's own"))
    cut = _cut(done)
    lines += [("left out", f"{n:,}: {reason}") for reason, n in cut.items()]
    lines += [("not held", note) for note in done.written.notes]
    table = Table(show_header=False, box=None)
    table.add_column()
    table.add_column(overflow="fold")
    for key, text in lines:
        table.add_row(f"[bold]{key}[/bold]", escape(text))
    console.print(table)
    if measured is None:
        return
    errors = Table("read back", "largest error", "RMS", "in")
    for e in measured.fields:
        errors.add_row(e.field, f"{e.worst:.3g}", f"{e.rms:.3g}", e.unit)
    console.print(errors)
    console.print(_pictures_text(measured))


def _reordered(done: Done) -> bool:
    return done.written.order is not None


def _pictures_text(measured: Measured) -> str:
    decibels = [e.psnr for e in measured.pictures]
    own = f", {measured.own_cameras} of its own cameras" if measured.own_cameras else ""
    width, height = measured.size
    worst = max(e.worst for e in measured.pictures)
    return (
        f"{len(decibels)} pictures of {width}x{height}{own}: PSNR {min(decibels):.1f} dB at worst, "
        f"{statistics.median(decibels):.1f} dB median; a pixel is off by {worst:.3g} of 255 levels "
        "at most"
    )
