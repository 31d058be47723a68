"""SOG files of given pixels, and what they mean, worked out one Gaussian at a time."""

from __future__ import annotations

import io
import json
import math
import zipfile

import numpy as np
from PIL import Image

PLANES = ("means_l", "means_u", "scales", "quats", "sh0")


def webp(pixels, width, height, kind="WEBP", **options):
    """A lossless image of [width * height, 4] bytes."""
    image = Image.fromarray(np.asarray(pixels, np.uint8).reshape(height, width, 4), "RGBA")
    buffer = io.BytesIO()
    options = {"lossless": True, "exact": True, "method": 0} | options
    image.save(buffer, kind, **(options if kind == "WEBP" else {}))
    return buffer.getvalue()


def random_scene(n, degree, version=2, seed=0, kind="WEBP"):
    """meta.json as data, images by name, and pixels by name."""
    rng = np.random.default_rng(seed)
    width = math.ceil(math.sqrt(n))
    height = -(-n // width)
    pixels = {key: rng.integers(0, 256, (width * height, 4)).astype(np.uint8) for key in PLANES}
    pixels["quats"][:, 3] = rng.integers(252, 256, width * height)
    low = rng.uniform(-3, 0, 3)

    def span(length):
        mins = rng.uniform(-4, 0, length)
        return {"mins": mins.tolist(), "maxs": (mins + rng.uniform(0, 4, length)).tolist()}

    def book():
        return {"codebook": np.sort(rng.normal(-2, 2, 256)).tolist()}

    meta = {
        "means": {
            "mins": low.tolist(), "maxs": (low + rng.uniform(0, 6, 3)).tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {**(book() if version == 2 else span(3)), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {**(book() if version == 2 else span(4)), "files": ["sh0.webp"]},
    }  # fmt: skip
    if version == 2:
        meta = {"version": 2, "count": n, **meta}
    else:
        meta["means"]["shape"] = [n, 3]
    images = {f"{key}.webp": webp(pixels[key], width, height, kind) for key in PLANES}
    if degree:
        k = (degree + 1) ** 2 - 1
        palette = int(rng.integers(1, 150))
        rows = -(-palette // 64)
        pixels["shN_centroids"] = rng.integers(0, 256, (64 * k * rows, 4)).astype(np.uint8)
        pixels["shN_labels"] = np.full((width * height, 4), 255, np.uint8)
        labels = rng.integers(0, palette, width * height)
        pixels["shN_labels"][:, 0], pixels["shN_labels"][:, 1] = labels & 255, labels >> 8
        names = ["shN_centroids.webp", "shN_labels.webp"]
        meta["shN"] = {"files": names}
        if version == 2:
            meta["shN"] |= {"count": palette, "bands": degree, **book()}
        else:
            meta["shN"] |= {"mins": -2.0, "maxs": 3.0}
        images[names[0]] = webp(pixels["shN_centroids"], 64 * k, rows, kind)
        images[names[1]] = webp(pixels["shN_labels"], width, height, kind)
    return meta, images, pixels


def bundle(meta, images, *, deflate=False, prefix="", last=False):
    """A zip archive; ``meta`` is data or text."""
    text = meta if isinstance(meta, bytes) else json.dumps(meta).encode()
    members = [("meta.json", text), *images.items()]
    if last:
        members.append(members.pop(0))
    buffer = io.BytesIO()
    how = zipfile.ZIP_DEFLATED if deflate else zipfile.ZIP_STORED
    with zipfile.ZipFile(buffer, "w", how) as archive:
        for name, content in members:
            archive.writestr(prefix + name, content)
    return buffer.getvalue()


def unbundled(folder, meta, images):
    """The same as files."""
    folder.mkdir(exist_ok=True)
    (folder / "meta.json").write_text(json.dumps(meta))
    for name, content in images.items():
        (folder / name).write_bytes(content)
    return folder


def decoded(i, degree, meta, pixels):
    """Gaussian ``i``: position, w x y z, sizes, opacity, [K][3] coefficients."""
    old = "version" not in meta

    def value(field, byte, channel):
        if not old:
            return field["codebook"][byte]
        low, high = field["mins"], field["maxs"]
        if isinstance(low, list):
            low, high = low[channel], high[channel]
        return low + (high - low) * byte / 255

    mean = []
    for axis in range(3):
        word = int(pixels["means_l"][i, axis]) + 256 * int(pixels["means_u"][i, axis])
        low, high = meta["means"]["mins"][axis], meta["means"]["maxs"][axis]
        v = low + (high - low) * word / 65535
        mean.append(math.copysign(math.exp(abs(v)) - 1, v))
    *three, tag = (int(b) for b in pixels["quats"][i])
    parts = [(b / 255 * 2 - 1) / math.sqrt(2) for b in three]
    largest = math.sqrt(max(0, 1 - sum(p * p for p in parts)))
    quat = [*parts[: tag - 252], largest, *parts[tag - 252 :]]
    length = math.sqrt(sum(c * c for c in quat))
    scales = [
        math.exp(value(meta["scales"], int(b), a)) for a, b in enumerate(pixels["scales"][i, :3])
    ]
    *color, alpha = (int(b) for b in pixels["sh0"][i])
    opacity = alpha / 255
    if old:
        opacity = 1 / (1 + math.exp(-value(meta["sh0"], alpha, 3)))
    sh = [[value(meta["sh0"], b, c) for c, b in enumerate(color)]]
    if degree:
        k = (degree + 1) ** 2 - 1
        label = int(pixels["shN_labels"][i, 0]) + 256 * int(pixels["shN_labels"][i, 1])
        for j in range(k):
            x, y = label % 64 * k + j, label // 64
            sh.append(
                [value(meta["shN"], int(b), 0) for b in pixels["shN_centroids"][y * 64 * k + x, :3]]
            )
    return mean, [c / length for c in quat], scales, opacity, sh
