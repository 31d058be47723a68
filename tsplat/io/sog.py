"""PlayCanvas' SOG: a Gaussian is a pixel of several lossless images, which meta.json describes.

Format: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/ (version 2);
version 1, without a version in meta.json: splat-transform, ``src/lib/readers/read-sog-v1.ts``.
The files lie in a folder or in a zip archive. Axes are those of a PLY file.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsplat.core.errors import printable
from tsplat.core.types import F32, F64, I64, U8, Floats, Scene
from tsplat.hookspecs import hookimpl
from tsplat.io.base import Read, Reader, ReadOptions, check_memory, refuse, refuse_raw_opacity
from tsplat.io.clean import sigmoid
from tsplat.io.fields import JSON_MAX, Field, parse
from tsplat.io.gather import UNPACKING, check_count, gather, stretch
from tsplat.io.table import DC, LEVELS, MEAN, OPACITY, QUAT, REST, SCALE
from tsplat.io.unpack import PLACES, look_up, smallest_three

META = "meta.json"
ZIP = b"PK\x03\x04"
PER_ROW = 64
"""Palette entries in a row of the image of spherical harmonics."""

DEGREES = {PER_ROW * ((d + 1) ** 2 - 1): d for d in (1, 2, 3)}
"""Width of that image -> degree."""

PALETTE_MAX = 1 << 16
SLACK = 1 << 16
"""Pixels that an image may have beyond twice as many as Gaussians."""

WORDS = 1 << 16
"""What 16 bits may be."""

TAG = 252
"""Alpha of quats.webp, and up: which of w, x, y, z is the largest."""

TAGGED = np.full((256, 4), -1, np.int8)
TAGGED[TAG:] = PLACES
"""[256, 4] PLACES by alpha; others are no rotation."""

_BYTES = np.arange(256, dtype=np.float64)
SMALLEST = (_BYTES / 255 * 2 - 1) / np.sqrt(2)

Fetch = Callable[[Field], bytes]
"""The content of the image that a field names."""

Meaning = Callable[[NDArray[np.uint16]], F32]
"""What 16 bits mean."""

Measure = Callable[[list[Field]], int]
"""Bytes of the images that fields name, as they are on the disk."""


class Splats:
    """The pixels of all images; see :class:`tsplat.io.gather.Source`."""

    wide = False  # 16 bits of a logarithm

    def __init__(
        self,
        count: int,
        positions: list[Meaning],
        scales: F32,
        colors: F32,
        opacities: F32,
        palette: F32 | None,
        pixels: dict[str, U8],
    ) -> None:
        """Tables of what numbers mean, by axis or channel, and ``pixels`` [N, 4] by image.

        ``positions`` say what 16 bits mean, ``scales`` and ``colors`` [3, 256] and ``opacities``
        [1, 256] what a byte does; ``palette`` is [P, 3 (K - 1)].
        """
        self.count = count
        self.coefficients = 1 if palette is None else 1 + palette.shape[1] // 3
        self._positions, self._scales, self._colors = positions, scales, colors
        self._opacities, self._palette, self._pixels = opacities, palette, pixels

    def means(self, rows: slice | I64) -> Floats:
        """See :class:`tsplat.io.gather.Source`."""
        low, high = self._pixels["means_l"][rows], self._pixels["means_u"][rows]
        means = np.empty((len(low), 3), np.float32)
        for axis, meaning in enumerate(self._positions):
            means[:, axis] = meaning(low[:, axis] | high[:, axis].astype(np.uint16) << np.uint16(8))
        return means

    def fill(self, rows: slice | I64, table: F32) -> None:
        """See :class:`tsplat.io.gather.Source`."""
        colored, quats = self._pixels["sh0"][rows], self._pixels["quats"][rows]
        table[:, MEAN] = self.means(rows)
        smallest_three(quats.view("<u4")[:, 0], (0, 8, 16), SMALLEST, 24, TAGGED, table[:, QUAT])
        look_up(self._pixels["scales"][rows, :3], self._scales, table[:, SCALE])
        look_up(colored[:, 3:], self._opacities, table[:, OPACITY])
        look_up(colored[:, :3], self._colors, table[:, DC])
        if self._palette is not None:
            labels = self._pixels["shN_labels"][rows]
            table[:, REST] = self._palette[labels[:, 0] | labels[:, 1].astype(np.uint16) << 8]


def _position(low: float, high: float, words: NDArray[np.uint16]) -> F32:
    """Positions of 16 bits: sign(v) (e^|v| - 1), v evenly from ``low`` to ``high``."""
    with np.errstate(over="ignore", invalid="ignore"):  # not finite: the builder drops it
        values = low + (high - low) * (words / 65535)
        return (np.sign(values) * np.expm1(np.abs(values))).astype(np.float32)


def _positions(low: float, high: float, count: int) -> Meaning:
    """The same as a table, if there are as many Gaussians as entries."""
    if count < WORDS:
        return partial(_position, low, high)
    table = _position(low, high, np.arange(WORDS, dtype=np.uint16))
    return lambda words: table[words]


def _codebook(field: Field) -> F64:
    """[256] what a byte means; NaN where the file does not say: the builder drops it."""
    given = field.get("codebook").numbers(1, 256)
    table = np.full(256, np.nan)
    table[: len(given)] = given
    return table


def _linear(low: float, high: float) -> F64:
    """[256] what a byte means, evenly from ``low`` to ``high``."""
    with np.errstate(over="ignore", invalid="ignore"):  # not finite: the builder drops it
        return low + (high - low) * (_BYTES / 255)


def _spans(field: Field, length: int) -> list[tuple[float, float]]:
    lows = field.get("mins").numbers(length).tolist()
    return list(zip(lows, field.get("maxs").numbers(length).tolist(), strict=True))


def _decode(path: Path, meta: Field, fetch: Fetch, measure: Measure, options: ReadOptions) -> Scene:
    """The scene that ``meta`` describes."""
    version = meta.maybe("version")
    old = version is None
    if version is not None and version.integer(1, 2**53) != 2:
        version.wrong("2 (version 1 says none)")
    if not old:
        refuse_raw_opacity(path, options, "SOG 2")
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
    size = measure(list(images.values()))
    count = check_count(path, counted.integer(0), size, counted.place)
    most = 2 * count + SLACK
    if old:
        logs = [_linear(*span) for span in _spans(scales, 3)]
        *colors, logits = [_linear(*span) for span in _spans(sh0, 4)]
        with np.errstate(over="ignore"):  # beyond 0..1: the builder drops it
            levels = logits if options.raw_opacity else sigmoid(logits)
            opacities = levels[None].astype(np.float32)
    else:
        logs, colors = [_codebook(scales)] * 3, [_codebook(sh0)] * 3
        opacities = LEVELS
    positions = [_positions(*span, count) for span in _spans(means, 3)]
    palette = None
    if harmonics is not None:
        palette = _palette(path, harmonics, fetch, old=old)
    coefficients = 1 if palette is None else 1 + palette.shape[1] // 3
    check_memory(path, count, coefficients, 4 * len(images), size)
    pixels: dict[str, U8] = {}
    for done, (key, name) in enumerate(images.items()):
        stretch(options, 0, UNPACKING).progress(done, len(images))
        decoded, _ = _image(path, name, fetch, count, most)
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
        sizes = np.exp(np.stack(logs)).astype(np.float32)
        hues = np.stack(colors).astype(np.float32)
    source = Splats(count, positions, sizes, hues, opacities, palette, pixels)
    antialias = _antialias(meta)
    degree = 0 if palette is None else DEGREES[PER_ROW * (coefficients - 1)]
    about = f"sog {1 if old else 2}, SH {degree}{', antialiased' if antialias else ''}"
    bundle = path.name != META
    return gather(
        path, source, stretch(options, UNPACKING, 1),
        about=about if bundle else f"{about}, unbundled",
        antialias=antialias, name=path.name if bundle else path.absolute().parent.name,
    )  # fmt: skip


def _antialias(meta: Field) -> bool | None:
    """What ``antialias`` says, or, in newer files, ``model``."""
    smooth, model = meta.maybe("antialias"), meta.maybe("model")
    if smooth is not None and isinstance(smooth.value, bool):
        return smooth.value
    return None if model is None else model.value == "antialiased"


def _listed(field: Field, key: str) -> bool:
    found = field.maybe(key)
    return found is not None and isinstance(found.value, list) and len(found.value) > 0


def _largest_label(labels: U8) -> int:
    high = int(labels[:, 1].max())
    return high << 8 | int(labels[labels[:, 1] == high, 0].max())


def _image(path: Path, name: Field, fetch: Fetch, least: int, most: int) -> tuple[U8, int]:
    from tsplat.io.pixels import pixels

    place = f"{name.place} {printable(name.value, 40)}"
    return pixels(path, place, fetch(name), least, most)


def _palette(path: Path, field: Field, fetch: Fetch, *, old: bool) -> F32:
    """[P, 3 (K - 1)] coefficients of degree 1 and up that Gaussians share."""
    name = field.get("files").items(2)[0]
    most = (PALETTE_MAX // PER_ROW) * max(DEGREES)
    pixels, width = _image(path, name, fetch, 1, most)
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
    palette = values.reshape(len(pixels) // (width // PER_ROW), -1)
    promised = field.maybe("count")
    return palette if promised is None else palette[: promised.integer(1, len(palette))]


def _bundle(path: Path, options: ReadOptions) -> Scene:
    from tsplat.io.bundle import Bundle

    with Bundle(path) as bundle:
        names = [n for n in bundle.names if n == META or n.endswith("/" + META)]
        if not names:
            inside = ", ".join(printable(n, 40) for n in bundle.names[:8]) or "nothing"
            refuse(path, f"a zip archive without {META}, expected a SOG's; it holds {inside}")
        first = min(names, key=len)
        meta = parse(path, META, bundle.read(first, META, JSON_MAX))

        def fetch(name: Field) -> bytes:
            member = first.removesuffix(META) + name.text()
            if member not in bundle.names:
                refuse(
                    path,
                    f"{name.place} names {printable(name.value, 60)}, which is not in the archive; "
                    "copy or download it again",
                )
            # a WebP is not compressed further; deflate takes off a little, or what was idle
            return bundle.read(member, name.place, 4 * bundle.size + (1 << 20))

        return _decode(path, meta, fetch, lambda _: bundle.size, options)


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
    import tsplat.io.pixels  # noqa: F401 - Pillow, and what is wrong with it, now

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
