"""A scene -> a file, in any format that some installed plugin writes.

A file appears whole or not at all: it is written beside its place and moved there.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from tsplat.core.errors import OutputError, ParamsError, PluginError, TsplatError, printable
from tsplat.io.images import STDOUT, beside, check_place

if TYPE_CHECKING:
    from tsplat.io.write.base import WriteOptions, Writer, Written
    from tsplat.io.write.source import Source


def find_writer(writers: Mapping[str, Writer], path: str, name: str | None = None) -> Writer:
    """The writer called ``name``, or the one whose suffix ``path`` has; the longest suffix wins.

    Raises:
        PluginError: there is none of that name.
        OutputError: no writer has that suffix.
    """
    if name is not None:
        if name not in writers:
            known = ", ".join(sorted(writers))
            raise PluginError(f"no writer named {printable(name)!r}; installed: {known}")
        return writers[name]
    if Path(path).is_dir():
        raise OutputError(f"{printable(path)}: is a directory; name a file in it")
    low = Path(path).name.lower()
    fitting = [(s, w) for w in writers.values() for s in w.suffixes if low.endswith(s)]
    if not fitting:
        known = ", ".join(sorted({s for w in writers.values() for s in w.suffixes}))
        raise OutputError(
            f"{printable(path)}: no format is written to such a name; known: {known}; "
            "or name one with --to"
        )
    return max(fitting, key=lambda found: len(found[0]))[1]


def check_writing(
    path: str, writer: Writer, options: WriteOptions, degree: int | None, *, force: bool
) -> None:
    """Finds out before anything is read whether ``path`` can be written as asked.

    Raises:
        OutputError: no such directory, no permission, or a file is there and not ``force``.
        ParamsError: an option that is not the writer's, or a degree that it does not hold.
    """
    if path == STDOUT:
        raise OutputError("a scene is not written to standard output; name a file")
    check_place(path)
    if os.path.lexists(path) and not force:
        raise OutputError(f"{printable(path)}: exists; choose another name, or --force")
    from tsplat.io.write.base import option

    for name in options.named():
        if name not in writer.takes:
            takes = ", ".join(map(option, writer.takes)) or "no such options"
            raise ParamsError(f"{option(name)} is not for {writer.name}, which takes {takes}")
    if degree is not None and degree > writer.degree:
        raise ParamsError(
            f"sh_degree: {writer.name} holds harmonics up to degree {writer.degree}, got {degree}"
        )


def write_scene(source: Source, path: str, writer: Writer, options: WriteOptions) -> Written:
    """Puts ``source`` at ``path``, whole or not at all.

    Raises:
        OutputError: it cannot be written; one line that says why and what to do.
    """
    shown = printable(path)
    write = writer.load()
    if not len(source):
        raise OutputError(f"{shown}: no Gaussians are left to write; cut fewer")
    try:
        with beside(Path(os.path.realpath(path))) as place, place.open("wb") as out:
            return write(source, out, options)
    except OutputError as error:
        raise OutputError(f"{shown}: {error}") from error
    except TsplatError:
        raise
    except OSError as error:
        reason = printable(error.strerror or error)
        raise OutputError(f"{shown}: cannot be written: {reason}") from error
