"""What a file is that no reader recognises, and how it becomes one that can be read."""

from __future__ import annotations

from pathlib import Path

from tsplat.core.errors import printable

NAMED = {
    ".splat": "its first rows of 32 bytes are no Gaussians",
    ".ksplat": "its first 4096 bytes are no header of version 0.1",
    ".ply": "it does not begin with 'ply'",
    ".spz": "it begins neither like gzip of 'NGSP' nor with that",
    ".sog": "it is no zip archive with a meta.json",
    ".glb": "it does not begin with 'glTF'",
}
"""Why a file with the name of a format that is read has not been taken for one."""


GZIP, ZIP = b"\x1f\x8b", b"PK\x03\x04"
PACKED = {".spz": GZIP, ".sog": ZIP}
"""How files of packed formats begin, whatever is in them."""


def _level(file: Path) -> str:
    """A folder of one level that is there."""
    there = sorted(meta.parent.name for meta in file.parent.glob("*/meta.json"))
    return printable(there[0]) if there else "0_0"


def foreign(file: Path, start: bytes) -> str:
    """What ``file`` looks like by its first bytes, or what its suffix promises in vain."""
    suffix = file.suffix.lower()
    if b'"lodLevels"' in start:
        return (
            "a list of levels of detail, not a scene; "
            f"name the folder of one of them, such as {_level(file)} beside it"
        )
    if suffix in PACKED and start.startswith(PACKED[suffix]):
        return f"damaged: named {suffix}, but {NAMED[suffix]}; copy or download it again"
    for magic, kind in (
        (GZIP, "gzip-compressed file; unpack it first"),
        (ZIP, "zip archive; unpack it first"),
        (b"version https://git-lfs", "Git LFS pointer; fetch the file itself with: git lfs pull"),
        (b"<", "web page or XML file; was the download refused?"),
    ):
        if start.lstrip().startswith(magic):
            return f"not a scene but a {kind}"
    if suffix in NAMED:
        return f"unknown format: named {suffix}, but {NAMED[suffix]}"
    return "unknown format"
