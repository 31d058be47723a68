"""Lossless images as arrays of numbers, their size known and checked before they are decoded."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from tsplat.core.types import U8
from tsplat.io.base import one_line, refuse

PNG = b"\x89PNG\r\n\x1a\n"
NEEDED = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
"""Chunks of a PNG that make its picture. Others Pillow would unpack as well, texts up to 64 MB."""


def image_size(path: Path, place: str, content: bytes) -> tuple[int, int]:
    """Width and height of a WebP or PNG, by its header.

    WebP: RFC 9649, sections 2.5 to 2.7; PNG: W3C, 11.2.1.
    """
    if content.startswith(PNG) and len(content) >= 24:
        width, height = struct.unpack_from(">II", content, 16)
        return width, height
    kind = content[12:16] if content.startswith(b"RIFF") and content[8:12] == b"WEBP" else b""
    if kind == b"VP8L" and len(content) >= 25:
        bits = int.from_bytes(content[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if kind == b"VP8X" and len(content) >= 30:
        width = 1 + int.from_bytes(content[24:27], "little")
        height = 1 + int.from_bytes(content[27:30], "little")
        if b"VP8 " not in _chunks(content):
            return width, height
    if kind in (b"VP8 ", b"VP8X"):
        refuse(path, f"{place}: a lossy WebP, expected a lossless one; its numbers are lost")
    return refuse(
        path,
        f"{place}: neither WebP nor PNG (begins with {content[:4]!r}), expected one of them; "
        "the file is damaged",
    )


def _chunks(content: bytes) -> set[bytes]:
    """Names of the first chunks of a WebP; files have up to six."""
    names, at = set(), 12
    for _ in range(16):
        if at + 8 > len(content):
            break
        names.add(content[at : at + 4])
        length = int.from_bytes(content[at + 4 : at + 8], "little")
        at += 8 + length + length % 2
    return names


def _plain_png(content: bytes) -> bytes:
    """A PNG with what makes its picture and nothing else (PNG, W3C, 5.3)."""
    parts, at = [PNG], len(PNG)
    while at + 12 <= len(content):
        end = at + 12 + int.from_bytes(content[at : at + 4], "big")
        if content[at + 4 : at + 8] in NEEDED:
            parts.append(content[at:end])
        at = end
    return b"".join(parts)


def pixels(path: Path, place: str, content: bytes, least: int, most: int) -> tuple[U8, int]:
    """[H W, 4] RGBA of an image of ``least`` to ``most`` pixels, and its width."""
    width, height = image_size(path, place, content)
    if width * height < least:
        refuse(
            path,
            f"{place}: {width}x{height} pixels, expected {least} or more, as many as Gaussians; "
            "the file is damaged",
        )
    if width * height > most:
        refuse(path, f"{place}: {width}x{height} pixels, expected at most {most}")
    if content.startswith(PNG):
        content = _plain_png(content)
    try:
        with Image.open(BytesIO(content), formats=("WEBP", "PNG")) as image:
            if image.size != (width, height):
                refuse(path, f"{place}: its two headers disagree about its size")
            rgba = image.convert("RGBA")
    except (OSError, ValueError, SyntaxError, EOFError, struct.error, zlib.error) as error:
        text = one_line(error, 80)
        refuse(path, f"{place}: cannot be decoded: {text}; the file is damaged")
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        refuse(path, f"{place}: {width}x{height} pixels are more than Pillow decodes")
    return np.asarray(rgba, np.uint8).reshape(-1, 4), width
