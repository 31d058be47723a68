"""Members of a zip archive, none of them larger than it may be."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path
from typing import Self

from tsplat.core.errors import printable
from tsplat.io.base import one_line, refuse

EOCD = b"PK\x05\x06"
"""A zip archive's end of its directory: PKWARE APPNOTE.TXT 4.3.16."""

LOCATOR_64 = b"PK\x06\x07"
"""What zip64 puts before it (4.3.15)."""

DIRECTORY_MAX = 1 << 16
"""Bytes of a directory; a SOG's eight members take 500."""

STORED_OR_DEFLATED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
ENCRYPTED = 1
FAULTS = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, ValueError, OSError,
    NotImplementedError, RuntimeError,
)  # fmt: skip
"""What zipfile raises of archives that it cannot read."""


class Bundle:
    """An open zip archive."""

    def __init__(self, path: Path) -> None:
        """The archive at ``path``.

        Raises:
            SceneError: it cannot be read, or has a directory too large for what it should be.
        """
        self._path = path
        self.size = path.stat().st_size
        _check_directory(path, self.size)
        try:
            self._archive = zipfile.ZipFile(path)
        except FAULTS as error:
            text = one_line(error, 80)
            refuse(path, f"a zip archive that cannot be read: {text}; download it again")
        self.names = self._archive.namelist()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._archive.close()

    def read(self, name: str, place: str, most: int) -> bytes:
        """The member ``name``, at most ``most`` bytes; ``place`` says where it is named."""
        path = self._path
        info = self._archive.getinfo(name)
        shown = printable(name, 60)
        if info.file_size > most:
            refuse(path, f"{place}: {shown} has {info.file_size} bytes, expected at most {most}")
        if info.flag_bits & ENCRYPTED or info.compress_type not in STORED_OR_DEFLATED:
            refuse(
                path,
                f"{place}: {shown} is encrypted or packed in a way that is not read; unpack it",
            )
        try:
            with self._archive.open(info) as stream:
                content = stream.read(info.file_size + 1)
        except FAULTS as error:
            text = one_line(error, 80)
            refuse(path, f"{place}: {shown} cannot be unpacked: {text}; download the file again")
        if len(content) != info.file_size:
            refuse(path, f"{place}: {shown} has {len(content)} bytes, expected {info.file_size}")
        return content


def _check_directory(path: Path, size: int) -> None:
    """Refuses a zip archive whose directory is larger than a SOG's can be.

    zipfile makes an object of each entry it finds there, ten times as large.
    """
    tail = 22 + 65535
    with path.open("rb") as stream:
        stream.seek(max(size - tail - 20, 0))
        end = stream.read()
    at = end.rfind(EOCD)
    if at < 0 or len(end) - at < 22:
        refuse(path, "truncated: a zip archive without its directory; copy or download it again")
    (length,) = struct.unpack_from("<I", end, at + 12)
    if length > DIRECTORY_MAX or LOCATOR_64 in end[max(at - 20, 0) : at]:
        refuse(
            path,
            f"a zip archive with a directory of {length} bytes, expected at most {DIRECTORY_MAX} "
            "and no zip64; unpack it and name its meta.json",
        )
