"""What a file is that no reader recognises, and how it becomes one that can be read."""

from __future__ import annotations

from pathlib import Path

SPLAT_ROW = 32
"""Bytes of a Gaussian in antimatter15's .splat."""


def foreign(file: Path, start: bytes) -> str:
    """What ``file`` looks like by its first bytes, or by suffix where a format has no magic."""
    suffix = file.suffix.lower()
    for known, kind in (
        (suffix == ".ksplat", "ksplat"),
        (suffix == ".splat" and file.stat().st_size % SPLAT_ROW == 0, ".splat"),
    ):
        if known:
            return (
                f"{kind} files are not read yet; convert to PLY with: "
                f"splat-transform in{suffix} out.ply"
            )
    if b'"lodLevels"' in start:
        return (
            "a list of levels of detail, not a scene; "
            "name the folder of one of them, such as 0_0 beside it"
        )
    for magic, kind in (
        (b"\x1f\x8b", "gzip-compressed file; unpack it first"),
        (b"PK\x03\x04", "zip archive; unpack it first"),
        (b"version https://git-lfs", "Git LFS pointer; fetch the file itself with: git lfs pull"),
        (b"<", "web page or XML file; was the download refused?"),
    ):
        if start.lstrip().startswith(magic):
            return f"not a scene but a {kind}"
    return "unknown format"
