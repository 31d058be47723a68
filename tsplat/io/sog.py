"""PlayCanvas' SOG: a Gaussian is a pixel of several lossless images, which meta.json describes.

Format: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/ (version 2);
version 1, without a version in meta.json: splat-transform, ``src/lib/readers/read-sog-v1.ts``.
The files lie in a folder or in a zip archive. Axes are those of a PLY file.
"""

from __future__ import annotations

import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path

import numpy as np

from tsplat.core.errors import printable
from tsplat.core.types import F32, F64, I64, U8, Floats, Scene
from tsplat.hookspecs import hookimpl
from tsplat.io.base import Read, Reader, ReadOptions, refuse
from tsplat.io.fields import JSON_MAX, Field, parse
from tsplat.io.gather import Gaussians, check_count, gather, left_of_one, no_raw_opacity

META = "meta.json"
ZIP = b"PK\x03\x04"
EOCD = b"PK\x05\x06"
"""A zip archive's end of its directory: PKWARE APPNOTE.TXT 4.3.16."""

DIRECTORY_MAX = 1 << 16
"""Bytes of a zip archive's directory; a SOG's eight members take 500."""

STORED_OR_DEFLATED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
ENCRYPTED = 1
PER_ROW = 64
"""Palette entries in a row of the image of spherical harmonics."""

DEGREES = {PER_ROW * ((d + 1) ** 2 - 1): d for d in (1, 2, 3)}
"""Width of that image -> degree."""

PALETTE_MAX = 1 << 16
SLACK = 1 << 16
"""Pixels that an image may have beyond twice as many as Gaussians."""

TAG = 252
"""Alpha of quats.webp, and up: which of w, x, y, z is the largest."""

OTHERS = np.array([[j for j in range(4) if j != largest] + [largest] for largest in range(4)])
"""[4, 4] where the three others and the largest stand."""

_BYTES = np.arange(256, dtype=np.float64)
SMALLEST = (_BYTES / 255 * 2 - 1) / np.sqrt(2)
ALPHAS = (_BYTES / 255).astype(np.float32)

Fetch = Callable[[Field], bytes]
"""The content of the image that a field names."""

Measure = Callable[[list[Field]], int]
"""Bytes of the images that fields name, as they are on the disk."""


class Splats:
    """The pixels of all images; see :class:`tsplat.io.gather.Source`."""

    wide = False  # 16 bits of a logarithm

    def __init__(
        self,
        count: int,
        positions: list[F32],
        scales: list[F32],
        colors: list[F32],
        opacities: F32,
        palette: F32 | None,
        pixels: dict[str, U8],
    ) -> None:
        """Tables of what numbers mean, by axis or channel, and ``pixels`` [N, 4] by image.

        ``positions`` are three of 65,536 entries, ``scales`` and ``colors`` three of 256,
        ``opacities`` is one; ``palette`` is [P, K - 1, 3].
        """
        self.count = count
        self.coefficients = 1 if palette is None else 1 + palette.shape[1]
        self._positions, self._scales, self._colors = positions, scales, colors
        self._opacities, self._palette, self._pixels = opacities, palette, pixels

    def means(self, rows: slice | I64) -> Floats:
        """See :class:`tsplat.io.gather.Source`."""
        low, high = self._pixels["means_l"][rows], self._pixels["means_u"][rows]
        means = np.empty((len(low), 3), np.float32)
        for axis, table in enumerate(self._positions):
            means[:, axis] = table[low[:, axis] | high[:, axis].astype(np.uint16) << 8]
        return means

    def gaussians(self, rows: slice | I64) -> Gaussians:
        """See :class:`tsplat.io.gather.Source`."""
        colored, sized = self._pixels["sh0"][rows], self._pixels["scales"][rows]
        scales = np.empty((len(sized), 3), np.float32)
        sh = np.empty((len(sized), self.coefficients, 3), np.float32)
        for i in range(3):
            scales[:, i] = self._scales[i][sized[:, i]]
            sh[:, 0, i] = self._colors[i][colored[:, i]]
        if self._palette is not None:
            labels = self._pixels["shN_labels"][rows]
            sh[:, 1:] = self._palette[labels[:, 0] | labels[:, 1].astype(np.uint16) << 8]
        return Gaussians(
            self.means(rows), self._quats(rows), scales, self._opacities[colored[:, 3]], sh
        )

    def _quats(self, rows: slice | I64) -> F32:
        pixels = self._pixels["quats"][rows]
        parts = SMALLEST[pixels[:, :3]]
        whole = np.concatenate([parts, left_of_one(parts)[:, None]], 1, dtype=np.float32)
        tags = pixels[:, 3]
        whole[tags < TAG] = 0  # no rotation: the builder drops it
        quats = np.empty_like(whole)
        np.put_along_axis(quats, OTHERS[np.maximum(tags, TAG) - TAG], whole, 1)
        return quats


def _size(path: Path, place: str, content: bytes) -> tuple[int, int]:
    """Width and height of a WebP or PNG, by its header.

    WebP: RFC 9649, sections 2.5 to 2.7; PNG: W3C, 11.2.1.
    """
    if content.startswith(b"\x89PNG\r\n\x1a\n") and len(content) >= 24:
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
    return refuse(path, f"{place}: neither WebP nor PNG (begins with {content[:4]!r})")


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


def _pixels(path: Path, name: Field, content: bytes, least: int, most: int) -> tuple[U8, int]:
    """[H W, 4] RGBA of an image of ``least`` to ``most`` pixels, and its width."""
    from PIL import Image

    place = f"{name.place} {printable(name.value, 40)}"
    width, height = _size(path, place, content)
    if width * height < least:
        refuse(
            path,
            f"{place}: {width}x{height} pixels, expected {least} or more, as many as Gaussians; "
            "the file is damaged",
        )
    if width * height > most:
        refuse(path, f"{place}: {width}x{height} pixels, expected at most {most}")
    try:
        with Image.open(BytesIO(content), formats=("WEBP", "PNG")) as image:
            if image.size != (width, height):
                refuse(path, f"{place}: its two headers disagree about its size")
            rgba = image.convert("RGBA")
    except (OSError, ValueError, SyntaxError, EOFError, struct.error, zlib.error) as error:
        text = printable(" ".join(str(error).split()), 80)
        refuse(path, f"{place}: cannot be decoded: {text}; the file is damaged")
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        refuse(path, f"{place}: {width}x{height} pixels are more than Pillow decodes")
    return np.asarray(rgba, np.uint8).reshape(-1, 4), width


def _logarithmic(low: float, high: float) -> F32:
    """[65536] positions: sign(v) (e^|v| - 1), v evenly from ``low`` to ``high``."""
    values = low + (high - low) * (np.arange(65536) / 65535)
    with np.errstate(over="ignore"):  # infinite: the builder drops it
        return (np.sign(values) * np.expm1(np.abs(values))).astype(np.float32)


def _codebook(field: Field) -> F64:
    """[256] what a byte means; NaN where the file does not say: the builder drops it."""
    given = field.get("codebook").numbers(1, 256)
    table = np.full(256, np.nan)
    table[: len(given)] = given
    return table


def _linear(low: float, high: float) -> F64:
    """[256] what a byte means, evenly from ``low`` to ``high``."""
    return low + (high - low) * (_BYTES / 255)


def _spans(field: Field, length: int) -> list[tuple[float, float]]:
    lows = field.get("mins").numbers(length).tolist()
    return list(zip(lows, field.get("maxs").numbers(length).tolist(), strict=True))


def _sigmoid(logits: F64) -> F64:
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-logits))


def _decode(path: Path, meta: Field, fetch: Fetch, measure: Measure, options: ReadOptions) -> Scene:
    """The scene that ``meta`` describes."""
    version = meta.maybe("version")
    old = version is None
    if version is not None and version.integer(1, 2**53) != 2:
        version.wrong("2 (version 1 says none)")
    if not old:
        no_raw_opacity(path, options, "SOG 2")
    means, sh0, scales = meta.get("means"), meta.get("sh0"), meta.get("scales")
    harmonics = meta.maybe("shN")
    images = {
        "means_l": means.get("files").items(2)[0], "means_u": means.get("files").items(2)[1],
        "scales": scales.get("files").items(1)[0], "sh0": sh0.get("files").items(1)[0],
        "quats": meta.get("quats").get("files").items(1)[0],
    }  # fmt: skip
    if harmonics is not None:
        images["shN_labels"] = harmonics.get("files").items(2)[1]
    counted = means.get("shape").items()[0] if old and _listed(means, "shape") else None
    counted = counted or meta.get("count")
    count = check_count(path, counted.integer(0), measure(list(images.values())), counted.place)
    most = 2 * count + SLACK
    if old:
        logs = [_linear(*span) for span in _spans(scales, 3)]
        *colors, logits = [_linear(*span) for span in _spans(sh0, 4)]
        opacities = (logits if options.raw_opacity else _sigmoid(logits)).astype(np.float32)
    else:
        logs, colors = [_codebook(scales)] * 3, [_codebook(sh0)] * 3
        opacities = ALPHAS
    positions = [_logarithmic(*span) for span in _spans(means, 3)]
    palette = None
    if harmonics is not None:
        palette = _palette(path, harmonics, fetch, old=old)
    pixels: dict[str, U8] = {}
    for done, (key, name) in enumerate(images.items()):
        options.progress(done, 3 * len(images))
        decoded, _ = _pixels(path, name, fetch(name), count, most)
        pixels[key] = decoded[:count]
    if palette is not None:
        top = _largest_label(pixels["shN_labels"])
        if top >= len(palette):
            refuse(
                path,
                f"{images['shN_labels'].place}: a label is {top}, the palette has "
                f"{len(palette)} entries; the file is damaged",
            )
    with np.errstate(over="ignore", under="ignore"):
        sizes = [np.exp(log).astype(np.float32) for log in logs]
        hues = [color.astype(np.float32) for color in colors]
        source = Splats(count, positions, sizes, hues, opacities, palette, pixels)
    smooth = meta.maybe("antialias")
    antialias = smooth.value if smooth is not None and isinstance(smooth.value, bool) else None
    degree = 0 if palette is None else DEGREES[PER_ROW * palette.shape[1]]
    about = f"sog {1 if old else 2}, SH {degree}{', antialiased' if antialias else ''}"
    bundle = path.name != META
    return gather(
        path, source, options, about=about if bundle else f"{about}, unbundled",
        antialias=antialias, name=path.name if bundle else path.absolute().parent.name,
    )  # fmt: skip


def _listed(field: Field, key: str) -> bool:
    found = field.maybe(key)
    return found is not None and isinstance(found.value, list) and len(found.value) > 0


def _largest_label(labels: U8) -> int:
    high = int(labels[:, 1].max())
    return high << 8 | int(labels[labels[:, 1] == high, 0].max())


def _palette(path: Path, field: Field, fetch: Fetch, *, old: bool) -> F32:
    """[P, K - 1, 3] coefficients of degree 1 and up that Gaussians share."""
    name = field.get("files").items(2)[0]
    most = (PALETTE_MAX // PER_ROW) * max(DEGREES)
    pixels, width = _pixels(path, name, fetch(name), 1, most)
    if width not in DEGREES:
        refuse(
            path,
            f"{name.place}: {width} pixels wide, expected "
            f"{', '.join(map(str, DEGREES))} (degree 1, 2, 3)",
        )
    bands = field.maybe("bands")
    if bands is not None and bands.integer(1, 3) != DEGREES[width]:
        bands.wrong(f"{DEGREES[width]}, because {name.place} is {width} pixels wide")
    if old:
        table = _linear(field.get("mins").number(), field.get("maxs").number())
    else:
        table = _codebook(field)
    with np.errstate(over="ignore"):
        values = table.astype(np.float32)[pixels[:, :3]]
    return values.reshape(len(pixels) // (width // PER_ROW), -1, 3)


def _directory(path: Path, size: int) -> None:
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
    if length > DIRECTORY_MAX or b"PK\x06\x07" in end[max(at - 20, 0) : at]:
        refuse(
            path,
            f"a zip archive with a directory of {length} bytes, expected at most {DIRECTORY_MAX} "
            "and no zip64; unpack it and name its meta.json",
        )


def _bundle(path: Path, options: ReadOptions) -> Scene:
    size = path.stat().st_size
    _directory(path, size)
    with ExitStack() as stack:
        try:
            archive = stack.enter_context(zipfile.ZipFile(path))
        except (zipfile.BadZipFile, ValueError, NotImplementedError, struct.error) as error:
            text = printable(" ".join(str(error).split()), 80)
            refuse(path, f"a zip archive that cannot be read: {text}")
        names = [n for n in archive.namelist() if n == META or n.endswith("/" + META)]
        if not names:
            inside = ", ".join(printable(n, 40) for n in archive.namelist()[:8]) or "nothing"
            refuse(path, f"a zip archive without {META}, which a SOG has; it holds {inside}")
        first = min(names, key=len)
        prefix = first[: -len(META)]
        meta = parse(path, META, _member(path, archive, first, META, JSON_MAX))

        def fetch(name: Field) -> bytes:
            member = prefix + name.text()
            if member not in archive.NameToInfo:
                refuse(
                    path,
                    f"{name.place} names {printable(name.value, 60)}, which is not in the archive",
                )
            # a WebP is not compressed further; deflate takes off a little, or what was idle
            return _member(path, archive, member, name.place, 4 * size + (1 << 20))

        return _decode(path, meta, fetch, lambda _: size, options)


def _member(path: Path, archive: zipfile.ZipFile, name: str, place: str, most: int) -> bytes:
    info = archive.getinfo(name)
    shown = printable(name, 60)
    if info.file_size > most:
        refuse(path, f"{place}: {shown} has {info.file_size} bytes, expected at most {most}")
    if info.flag_bits & ENCRYPTED or info.compress_type not in STORED_OR_DEFLATED:
        refuse(path, f"{place}: {shown} is encrypted or packed in a way that is not read")
    try:
        with archive.open(info) as stream:
            content = stream.read(info.file_size + 1)
    except (
        zipfile.BadZipFile, zlib.error, EOFError, ValueError, NotImplementedError, RuntimeError,
        struct.error,
    ) as error:  # fmt: skip
        text = printable(" ".join(str(error).split()), 80)
        refuse(path, f"{place}: {shown} cannot be unpacked: {text}; download the file again")
    if len(content) != info.file_size:
        refuse(path, f"{place}: {shown} has {len(content)} bytes, promised were {info.file_size}")
    return content


def _folder(path: Path, options: ReadOptions) -> Scene:
    meta = parse(path, "", _bounded(path))

    def fetch(name: Field) -> bytes:
        return name.inside().read_bytes()

    def measure(names: list[Field]) -> int:
        return sum(name.inside().stat().st_size for name in names)

    return _decode(path, meta, fetch, measure, options)


def _bounded(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(JSON_MAX + 1)


def recognises(start: bytes) -> bool:
    """Whether a file begins like a zip archive of a SOG, or like its meta.json."""
    if start.startswith(ZIP):
        return re.search(rb"meta\.json|\.webp", start) is not None
    return re.match(rb"(\xef\xbb\xbf)?\s*\{", start) is not None and b'"means"' in start


def read(path: Path, options: ReadOptions) -> Scene:
    """See :class:`tsplat.io.base.Read`.

    Memory: the scene, 4 bytes a Gaussian and image (20, 24 with spherical harmonics), and while an
    image is decoded three times as much of that one: 200 bytes a Gaussian, of which the file has
    15 to 40.
    """
    with path.open("rb") as stream:
        bundle = stream.read(len(ZIP)) == ZIP
    return _bundle(path, options) if bundle else _folder(path, options)


def _load() -> Read:
    from PIL import Image  # noqa: F401 - and what is wrong with it, now

    return read


SOG = Reader(
    name="sog",
    summary="PlayCanvas' SOG, versions 1 and 2: a .sog file, its folder or its meta.json",
    recognises=recognises,
    load=_load,
)


@hookimpl
def tsplat_readers() -> list[Reader]:
    """See :func:`tsplat.hookspecs.tsplat_readers`."""
    return [SOG]
