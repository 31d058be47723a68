"""What a file is that no reader recognises, and how it becomes one that can be read."""

from __future__ import annotations

import zlib
from pathlib import Path

NAMED = {
    ".splat": "its first rows of 32 bytes are no Gaussians",
    ".ksplat": "its first 4096 bytes are no header of version 0.1",
}
"""Why a file with the name of a format that is read has not been taken for one."""


def foreign(file: Path, start: bytes) -> str:
    """What ``file`` looks like by its first bytes, or what its suffix promises in vain."""
    suffix = file.suffix.lower()
    for known, kind in (
        (_is_spz(start), "SPZ"),
        (start.startswith(b"PK\x03\x04") and _is_sog(file, start), "SOG"),
        (file.name == "meta.json" and b'"means"' in start, "SOG"),
    ):
        if known:
            return (
                f"{kind} files are not read yet; convert to PLY with: "
                f"splat-transform in{suffix} out.ply"
            )
    if start.startswith(b"glTF") or (b'"asset"' in start and suffix == ".gltf"):
        return "glTF files are not read yet; export the splats as PLY instead"
    for magic, kind in (
        (b"\x1f\x8b", "gzip-compressed file; unpack it first"),
        (b"PK\x03\x04", "zip archive; unpack it first"),
        (b"version https://git-lfs", "Git LFS pointer; fetch the file itself with: git lfs pull"),
        (b"<", "web page or XML file; was the download refused?"),
    ):
        if start.lstrip().startswith(magic):
            return f"not a scene but a {kind}"
    if suffix in NAMED:
        return f"unknown format: named {suffix}, but {NAMED[suffix]}"
    return "unknown format"


def _is_spz(start: bytes) -> bool:
    """Niantic's SPZ: gzip of a stream that begins "NGSP", or that stream itself (version 4)."""
    if not start.startswith(b"\x1f\x8b"):
        return start.startswith(b"NGSP")
    try:
        return zlib.decompressobj(wbits=31).decompress(start, 4) == b"NGSP"
    except zlib.error:
        return False


def _is_sog(file: Path, start: bytes) -> bool:
    """PlayCanvas' SOG: a zip of meta.json and textures."""
    return file.suffix.lower() == ".sog" or b"meta.json" in start or b"means_l.webp" in start
