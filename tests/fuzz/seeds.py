"""Small files that mutation starts from: written ones, and real ones, malformed or cut short."""

from __future__ import annotations

import io
import json
import re
import tempfile
import zlib
from pathlib import Path

from tests.fuzz.mutators import FOLDER
from tests.io import gltfwriter, plywriter, sogwriter, splatwriter, spzwriter

READERS = ("ply", "compressed-ply", "ksplat", "splat", "spz", "sog", "gltf")
SMALL = 32 << 10
"""Bytes of a real file that is taken whole."""


def written(reader: str) -> list[bytes]:
    """Files of the tests' own writers, of every kind that the format has."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a"
        made = []

        def keep(write, *args, **more):
            write(path, *args, **more)
            made.append(path.read_bytes())

        if reader == "ply":
            for degree in (0, 1, 3):
                keep(plywriter.write_ply, plywriter.raw_columns(3, degree))
            columns = plywriter.raw_columns(3, 0)
            face = {"before": [plywriter.FACE, plywriter.EXTRINSIC]}
            for fmt in plywriter.FORMATS:
                keep(plywriter.write_ply, columns, fmt=fmt, after=[plywriter.FACE])
                keep(plywriter.write_ply, columns, fmt=fmt, **face)
            mixed = dict.fromkeys("xyz", "double") | {"opacity": "uchar", "rot_0": "short"}
            keep(plywriter.write_ply, columns, types=mixed, line_end="\r\n", comments=["a"])
        elif reader == "compressed-ply":
            for degree in (0, 1, 3):
                keep(splatwriter.write_compressed, splatwriter.drawn(5, degree), big=degree == 1)
            keep(splatwriter.write_compressed, splatwriter.drawn(300), colors=False)
            keep(
                splatwriter.write_compressed,
                splatwriter.drawn(4, 1),
                order=("sh", "chunk", "vertex"),
            )
        elif reader == "splat":
            for n in (1, 3, 20, 40):
                keep(splatwriter.write_splat, splatwriter.drawn(n))
        elif reader == "ksplat":
            for level in range(3):
                for degree in range(3):
                    keep(
                        splatwriter.write_ksplat,
                        [(splatwriter.drawn(5, degree), degree)],
                        level,
                        bucket=2,
                    )
            parts = [(splatwriter.drawn(4, 2), 2), (splatwriter.drawn(3, 0, 1), 0)]
            keep(splatwriter.write_ksplat, parts, 2, spare=2)
        elif reader == "spz":
            for version in range(1, 5 if spzwriter.HAVE_ZSTD else 4):
                for degree in (0, 1, 3):
                    planes = spzwriter.random_planes(3, version, degree)
                    made.append(spzwriter.packed(3, version, degree, planes))
            bare = spzwriter.header(2, 2, 1) + b"".join(spzwriter.random_planes(2, 2, 1))
            made.append(bare)
            # beyond 16,384 rows they are put along a curve
            made.append(spzwriter.packed(20000, 3, 0, [bytes(p * 20000) for p in (9, 1, 3, 3, 4)]))
        elif reader == "sog":
            for version in (1, 2):
                for degree in (0, 1, 3):
                    made.append(_sog(degree, version, "WEBP" if degree else "PNG"))
            made += [FOLDER + made[0], FOLDER + made[4]]
        elif reader == "gltf":
            for degree in (0, 1, 3):
                builder = gltfwriter.one(gltfwriter.random_arrays(2, degree))
                made += [builder.glb(), builder.gltf()]
            builder = gltfwriter.Builder()
            kinds = {"SCALE": ("u2", True), "ROTATION": ("i1", True), "OPACITY": ("u1", True)}
            one = builder.primitive(gltfwriter.random_arrays(3, 0), kinds, stride=4, offset=8)
            two = builder.primitive(gltfwriter.random_arrays(2, 1, 1))
            inner = builder.node(one, root=False, rotation=[0.6, 0, 0, 0.8], scale=[2, 2, 2])
            builder.node(two, children=[inner], translation=[1, 2, 3])
            made += [builder.glb(), builder.gltf()]
        return made


def _sog(degree: int, version: int, kind: str) -> bytes:
    """Codebooks of round numbers: JSON that is short."""
    meta, images, _ = sogwriter.random_scene(4, degree, version, kind=kind)
    for part in meta.values():
        if isinstance(part, dict) and "codebook" in part:
            part["codebook"] = [round(x) for x in part["codebook"]]
    return sogwriter.bundle(meta, images, deflate=degree == 1)


def real(reader: str, folder: Path) -> list[bytes]:
    """Other people's files of the format: small ones whole, large ones cut to a few Gaussians."""
    suffixes = {
        "ply": ".ply", "compressed-ply": ".compressed.ply", "ksplat": ".ksplat", "splat": ".splat",
        "spz": ".spz", "sog": ".sog", "gltf": (".glb", ".gltf"),
    }  # fmt: skip
    made = []
    for path in sorted(folder.rglob("*")):
        name = path.name.lower()
        if not name.endswith(suffixes[reader]) or not path.is_file():
            continue
        if reader == "ply" and name.endswith(".compressed.ply"):
            continue
        if path.stat().st_size <= SMALL:
            made.append(path.read_bytes())
        elif (cut := _cut(reader, path)) is not None:
            made.append(cut)
    return [m for m in dict.fromkeys(made) if m]


def _cut(reader: str, path: Path) -> bytes | None:
    content = path.read_bytes()
    if reader == "splat":
        return content[: 32 * 24]
    if reader == "ply":
        head, end, body = content.partition(b"end_header\n")
        found = re.search(rb"element vertex (\d+)", head)
        if found is None or b"ascii" in head:
            return None
        row = len(body) // int(found[1])
        return head.replace(found[0], b"element vertex 3") + end + body[: 3 * row]
    if reader == "spz" and content.startswith(b"\x1f\x8b"):
        raw = zlib.decompress(content, 31)
        version, count, degree = raw[4], int.from_bytes(raw[8:12], "little"), raw[12]
        sizes, at, planes = spzwriter.sizes(version, degree), 16, []
        for size in sizes:
            planes.append(raw[at : at + 4 * size])
            at += size * count
        return spzwriter.packed(4, version, degree, planes, raw[13], raw[14])
    if reader == "sog":
        return _small_sog(content)
    return None


def _small_sog(content: bytes) -> bytes | None:
    """The images' first 3x3 pixels."""
    from PIL import Image

    from tests.fuzz.mutators import members

    files = members(content)
    if "meta.json" not in files:
        return None
    meta = json.loads(files["meta.json"])
    if "count" not in meta:
        return None
    meta["count"] = 9
    meta.pop("shN", None)
    images = {}
    for key in ("means", "scales", "quats", "sh0"):
        for name in meta[key]["files"]:
            with Image.open(io.BytesIO(files[name])) as image:
                pixels = image.convert("RGBA").crop((0, 0, 3, 3)).tobytes()
            images[name] = sogwriter.webp(list(pixels), 3, 3)
    return sogwriter.bundle(meta, images)


def lay_out(folder: Path, reader: str, content: bytes) -> Path:
    """Writes a file, or the folder that it stands for, into ``folder``; what is to be loaded."""
    if not content.startswith(FOLDER):
        path = folder / "scene"
        path.write_bytes(content)
        return path
    from tests.fuzz.mutators import members

    inside = folder / "folder"
    for old in inside.iterdir():
        old.unlink()
    for name, data in members(content[len(FOLDER) :]).items():
        if re.fullmatch(r"[A-Za-z0-9_.%-]{1,40}", name) and name not in (".", "..", "link.webp"):
            (inside / name).write_bytes(data)
    (inside / "link.webp").symlink_to("../secret.webp")
    return inside
