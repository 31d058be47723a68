"""Small files made to fill the memory or to take for ever; names that lead elsewhere.

Each is held to what any file is: a Scene or one line, within 4 times its size and 64 MB
(``scene_or_line``). What stands here took more of one or the other, or raised something else, until
it was mended; time is bounded by what is counted, not by a clock: see docs/fuzzing.md.
"""

from __future__ import annotations

import base64
import gzip
import io
import json
import os
import re
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from tests.io import gltfwriter, plywriter, sogwriter, spzwriter
from tests.io.loading import refusal, scene_or_line
from tsplat.io import load_scene

BINARY = b"ply\nformat binary_little_endian 1.0\n"
TEXT = b"ply\nformat ascii 1.0\n"
VERTEX = b"element vertex 1\n" + b"".join(
    b"property float %s\n" % name.encode() for name in plywriter.names_inria(0)
)
ROW = b"1 0 0 0 0 0 0 0 0 1 1 1 1 1 0 0 0\n"
END = b"end_header\n"


def gltf(change):
    """A GLB of one Gaussian whose JSON ``change`` has altered."""
    builder = gltfwriter.one(gltfwriter.random_arrays(1, 0))
    change(builder.root)
    return builder.glb()


def many_nodes(root):
    root["nodes"] = [{"mesh": 0}] * 1500
    root["scenes"][0]["nodes"] = list(range(1500))


def many_meshes_of_many(root):
    root["meshes"][0]["primitives"] += [{}] * 1500
    many_nodes(root)


def one_mesh_400_times():
    """Gaussians that stand in the file once and would be in the scene over and over."""
    builder = gltfwriter.one(gltfwriter.random_arrays(2000, 3))
    builder.root["nodes"] = [{"mesh": 0}] * 400
    builder.root["scenes"][0]["nodes"] = list(range(400))
    return builder.glb()


def many_roots(root):
    root["scenes"][0]["nodes"] = [0] * 20_000


def many_children(root):
    root["nodes"][0]["children"] = [0] * 20_000


def deep_nodes(root):
    root["nodes"] = [{"children": [i + 1]} for i in range(16_500)] + [{"mesh": 0}]
    root["scenes"][0]["nodes"] = [0]


def packed_by_a_number(root):
    primitive = root["meshes"][0]["primitives"][0]
    del primitive["attributes"][f"{gltfwriter.EXT}:SCALE"]
    primitive["extensions"][gltfwriter.EXT]["extensions"] = 5


def packed_by_many(root):
    packed_by_a_number(root)
    names = {f"x{i}": 1 for i in range(999)}
    root["meshes"][0]["primitives"][0]["extensions"][gltfwriter.EXT]["extensions"] = names


HOSTILE = {
    "glTF: one mesh in 1,500 nodes": (
        lambda: gltf(many_nodes), "more than 1024 primitives of splats, expected at most"),
    "glTF: 1,500 primitives in 1,500 nodes": (
        lambda: gltf(many_meshes_of_many), "more than 1024 primitives of splats"),
    "glTF: one large mesh in 400 nodes": (
        one_mesh_400_times, r"promises \d+ Gaussians of 16 coefficients, 69 MB"),
    "glTF: 20,000 roots": (
        lambda: gltf(many_roots), r"scenes\[0\].nodes: expected at most 16384 items"),
    "glTF: 20,000 children": (
        lambda: gltf(many_children), r"nodes\[0\].children: expected at most 16384 items"),
    "glTF: an extension that is a number": (
        lambda: gltf(packed_by_a_number), r"extensions\..*: expected an object, got 5"),
    "glTF: 999 extensions": (
        lambda: gltf(packed_by_many), "packed by x0, x1, x2, which is not read"),
    "JSON nested 100,000 deep": (
        lambda: b'{"asset":' + b"[" * 100_000, "JSON that is nested too deeply"),
    "JSON objects nested 100,000 deep": (
        lambda: b'{"asset":' + b'{"a":' * 100_000, "JSON that is nested too deeply"),
    "JSON of 300,000 objects": (
        lambda: b'{"asset":{"version":"2.0"},"x":[' + b"{}," * 300_000 + b"1]}", "a glTF scene of"),
    "a number of two million digits": (
        lambda: b'{"asset":{"version":' + b"9" * 2_000_000 + b"}}", "JSON that cannot be read"),
    "SPZ: 262,144 Gaussians of degree 3 in 16 kB": (
        lambda: gzip.compress(spzwriter.header(1 << 18, 3, 3) + bytes(65 << 18), 9),
        "promises 262144 Gaussians of 16 coefficients, 75 MB, in 16... bytes, expected at most"),
    "PLY: a million comments": (
        lambda: BINARY + b"comment\n" * 120_000 + VERTEX + END + bytes(68),
        "without an end_header line in its first 131072 bytes"),
    "PLY: a million lists": (
        lambda: BINARY + b"element face 1000000\nproperty list uchar int a\n" + VERTEX + END
        + bytes(1_000_068),
        "element face has 1000000 rows of lists before the vertices, expected at most 65536"),
    "PLY: 66,000 rows of text": (
        lambda: TEXT + b"element a 66000\nproperty int a\n" + VERTEX + END + b"1\n" * 66_000 + ROW,
        "element a has 66000 rows of text before the vertices, expected at most 65536"),
    "PLY: a list of 2 GB": (
        lambda: BINARY + b"element face 1\nproperty list uint double a\n" + VERTEX + END
        + b"\xff\xff\xff\x0f" + bytes(200),
        "PLY rows that cannot be read: .*early end-of-file"),
    "PLY: a list of length -1": (
        lambda: BINARY + b"element face 1\nproperty list char char a\n" + VERTEX + END
        + b"\xff" + bytes(200),
        "PLY rows that cannot be read: .*early end-of-file"),
    "PLY: a line of 5 MB": (
        lambda: TEXT + VERTEX + END + b"12 " * 1_800_000, "a line of 1048576 characters or more"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_refused_in_one_line_and_little_memory(tmp_path, case):
    """A claim, a count, a line, a depth beyond bounds is named; nothing was allocated for it."""
    make, expected = HOSTILE[case]
    path = tmp_path / "a"
    path.write_bytes(make())
    line = refusal(path)
    assert re.search(expected, line), line
    scene_or_line(path)


def test_a_chain_of_nodes_has_an_end(tmp_path):
    """16,500 nodes, each within the last, are too many; a hundred are not."""
    (tmp_path / "a.glb").write_bytes(gltf(deep_nodes))
    assert "glTF scene of more than 16384 nodes" in refusal(tmp_path / "a.glb")

    def few(root):
        root["nodes"] = [{"children": [i + 1]} for i in range(100)] + [{"mesh": 0}]
        root["scenes"][0]["nodes"] = [0]

    (tmp_path / "b.glb").write_bytes(gltf(few))
    assert len(load_scene(tmp_path / "b.glb")) == 1


def test_bombs_within_bounds_take_little_memory(tmp_path):
    """As many Gaussians as 8 kB may hold; SOG's largest palette, in 1 kB, for ten Gaussians."""
    count = 1 << 17
    planes = bytes(count * sum(spzwriter.sizes(3, 3)))
    (tmp_path / "a").write_bytes(gzip.compress(spzwriter.header(count, 3, 3) + planes, 9))
    scene_or_line(tmp_path / "a")
    assert len(load_scene(tmp_path / "a")) == count

    image = sogwriter.webp(np.full((10, 4), 255), 10, 1)
    files = {
        "a": image, "l": sogwriter.webp(np.zeros((10, 4)), 10, 1),
        "c": sogwriter.webp(np.zeros((960 * 1024, 4)), 960, 1024),
    }  # fmt: skip
    meta = {
        "version": 2, "count": 10, "quats": {"files": ["a"]},
        "means": {"mins": [0] * 3, "maxs": [1] * 3, "files": ["a", "a"]},
        "scales": {"codebook": [-3] * 256, "files": ["a"]},
        "sh0": {"codebook": [0.1] * 256, "files": ["a"]},
        "shN": {"files": ["c", "l"], "count": 65536, "bands": 3, "codebook": [0.3] * 256},
    }  # fmt: skip
    (tmp_path / "b").write_bytes(sogwriter.bundle(meta, files, deflate=True))
    scene_or_line(tmp_path / "b")
    assert load_scene(tmp_path / "b").sh.shape == (10, 16, 3)


def test_texts_in_a_png_are_not_unpacked(tmp_path):
    """63 texts of a megabyte in 63 kB, which Pillow alone would read before the picture."""

    def chunk(kind, content):
        return (
            struct.pack(">I", len(content)) + kind + content
            + struct.pack(">I", zlib.crc32(kind + content))
        )  # fmt: skip

    meta, images, _ = sogwriter.random_scene(4, 0, kind="PNG")
    text = zlib.compress(b"a" * (1 << 20), 9)
    texts = b"".join(chunk(b"zTXt", b"k%d\0\0" % i + text) for i in range(63))
    (tmp_path / "plain").write_bytes(sogwriter.bundle(meta, images))
    for name, content in images.items():
        images[name] = content[:33] + texts + content[33:]
    assert len(Image.open(io.BytesIO(images["sh0.webp"])).info) == 63
    (tmp_path / "a").write_bytes(sogwriter.bundle(meta, images))
    scene_or_line(tmp_path / "a")
    assert np.array_equal(load_scene(tmp_path / "a").means, load_scene(tmp_path / "plain").means)


def test_one_data_uri_for_many_buffers_is_decoded_once(tmp_path):
    """300 buffers that name the megabyte of the first, by the mark that stands in its place."""
    builder = gltfwriter.one(gltfwriter.random_arrays(1, 0))
    root, count = builder.root, 300
    content = base64.b64encode(builder.binary + bytes(1 << 20)).decode()
    size = {"byteLength": len(builder.binary)}
    root["buffers"] = [{**size, "uri": f"data:;base64,{content}"}]
    root["buffers"] += [{**size, "uri": "data:#0"}] * count
    primitive = root["meshes"][0]["primitives"][0]
    accessor = root["accessors"][primitive["attributes"]["POSITION"]]
    view = root["bufferViews"][accessor["bufferView"]]
    primitives = []
    for i in range(count):
        root["bufferViews"].append({**view, "buffer": i + 1})
        root["accessors"].append({**accessor, "bufferView": len(root["bufferViews"]) - 1})
        attributes = {**primitive["attributes"], "POSITION": len(root["accessors"]) - 1}
        primitives.append({**primitive, "attributes": attributes})
    root["meshes"][0]["primitives"] = primitives
    (tmp_path / "a").write_bytes(json.dumps(root).encode())
    scene_or_line(tmp_path / "a")


def test_places_at_the_end_of_float32_are_no_warning(tmp_path):
    """Buckets of a ksplat and chunks of a compressed PLY whose middle float32 does not hold."""
    from tests.io.splatwriter import drawn, write_compressed, write_ksplat

    path = tmp_path / "a"
    write_ksplat(path, [(drawn(8), 0)], 1, bucket=2)
    content = bytearray(path.read_bytes())
    buckets, other = (int.from_bytes(content[4096 + i : 4100 + i], "little") for i in (12, 36))
    at = 5120 + 4 * other
    content[at : at + 12 * buckets] = np.full(3 * buckets, 3.3e38, "<f4").tobytes()
    path.write_bytes(content)
    assert "can be drawn (mean not finite: 8)" in refusal(path)
    write_compressed(path, drawn(512))
    content = bytearray(path.read_bytes())
    at = content.index(b"end_header\n") + 11
    for chunk in (at, at + 72):
        content[chunk : chunk + 24] = np.full(6, 3.3e38, "<f4").tobytes()
    path.write_bytes(content)
    assert "can be drawn (mean not finite: 512)" in refusal(path)


def test_lists_of_nothing_are_read_without_a_warning(tmp_path):
    """A face of no corners before the vertices of a text file."""
    (tmp_path / "a").write_bytes(
        TEXT + b"element face 1\nproperty list uchar int a\n" + VERTEX + END + b"0\n"
        + b"1 0 0 0 0 0 0 0 0 1 1 1 1 1 0 0 1\n"
    )  # fmt: skip
    assert len(load_scene(tmp_path / "a")) == 1


def test_numbers_at_both_ends_of_float64_are_no_warning(tmp_path):
    """A range of SOG that is wider than float64: its Gaussians cannot be drawn, that is all."""
    for version, part in ((2, "means"), (1, "scales"), (1, "means")):
        meta, images, _ = sogwriter.random_scene(4, 0, version)
        meta[part]["mins"], meta[part]["maxs"] = [-1.7e308] * 3, [1.7e308] * 3
        (tmp_path / "a").write_bytes(sogwriter.bundle(meta, images))
        assert "none of its Gaussians can be drawn" in refusal(tmp_path / "a")
    meta, images, _ = sogwriter.random_scene(4, 0, 1)
    meta["sh0"]["mins"][3] = meta["sh0"]["maxs"][3] = 1e300
    (tmp_path / "a").write_bytes(sogwriter.bundle(meta, images))
    assert "so they are logits" in refusal(tmp_path / "a", raw_opacity=True)


@pytest.mark.skipif(not spzwriter.HAVE_ZSTD, reason=spzwriter.NO_ZSTD)
def test_a_window_of_zstd_is_not_taken_at_its_word(tmp_path):
    """A frame that asks for 128 MB to unpack 9 bytes a Gaussian (RFC 8878, 3.1.1.1.2)."""
    planes = spzwriter.random_planes(3, 4, 0)
    content = spzwriter.packed(3, 4, 0, planes)
    at = 32 + 16 * 5
    frame = b"\x28\xb5\x2f\xfd" + bytes([0, (27 - 10) << 3])  # no size, window 2^27
    block = struct.pack("<I", len(planes[0]) << 3 | 1)[:3] + planes[0]  # the last one, raw
    was = int.from_bytes(content[32:40], "little")
    made = content[:32] + struct.pack("<Q", len(frame + block)) + content[40:at] + frame + block
    (tmp_path / "a").write_bytes(made + content[at + was :])
    assert "stream positions cannot be unpacked" in refusal(tmp_path / "a")
    small = frame[:5] + bytes([(20 - 10) << 3])
    made = content[:32] + struct.pack("<Q", len(small + block)) + content[40:at] + small + block
    (tmp_path / "b").write_bytes(made + content[at + was :])
    assert len(load_scene(tmp_path / "b")) == 3


def unbundled(tmp_path):
    """A folder with a SOG in it, and a picture beside it that it may not read."""
    meta, images, _ = sogwriter.random_scene(4, 0)
    folder = sogwriter.unbundled(tmp_path / "inside", meta, images)
    (tmp_path / "scales.webp").write_bytes(images["scales.webp"])
    assert len(load_scene(folder)) == 4
    return folder


def test_links_out_of_a_folder_are_not_followed(tmp_path):
    """Neither to a file nor through a folder, nor in a circle; a link within it is."""
    folder = unbundled(tmp_path)
    meta = json.loads((folder / "meta.json").read_text())
    (folder / "out").symlink_to("../scales.webp")
    (folder / "up").symlink_to("..")
    (folder / "round").symlink_to("round")
    (folder / "in").symlink_to("scales.webp")
    for name, expected in (
        ("out", "not a link out of it"),
        ("up/scales.webp", "not a link out of it"),
        ("round", "which is not in the folder|not a link"),
        ("../scales.webp", "the name of a file beside this one"),
        ("/dev/zero", "the name of a file beside this one"),
        ("%2e%2e/scales.webp", "the name of a file beside this one"),
    ):
        meta["scales"]["files"] = [name]
        (folder / "meta.json").write_text(json.dumps(meta))
        assert re.search(expected, refusal(folder)), name
    meta["scales"]["files"] = ["in"]
    (folder / "meta.json").write_text(json.dumps(meta))
    assert len(load_scene(folder)) == 4


def test_pipes_and_devices_are_not_waited_for(tmp_path):
    """Named by the user, as meta.json of a folder, in a SOG's folder and by a glTF."""
    folder = unbundled(tmp_path)
    meta = json.loads((folder / "meta.json").read_text())
    os.mkfifo(folder / "pipe")
    meta["quats"]["files"] = ["pipe"]
    (folder / "meta.json").write_text(json.dumps(meta))
    assert "names pipe, which is not in the folder" in refusal(folder)
    (folder / "meta.json").unlink()
    os.mkfifo(folder / "meta.json")
    assert "is a directory" in refusal(folder)
    builder = gltfwriter.one(gltfwriter.random_arrays(1, 0))
    (folder / "a.gltf").write_bytes(builder.gltf(uri="pipe"))
    assert "names pipe, which is not in the folder" in refusal(folder / "a.gltf")
    for device in ("/dev/zero", "/dev/tty", "/dev/stdin"):
        if os.path.exists(device) and not os.path.isfile(device):  # noqa: PTH110, PTH113
            from tsplat.core.errors import SceneError

            with pytest.raises(SceneError, match="not a regular file"):
                load_scene(device)


def test_members_behind_a_gzip_stream_are_not_read(tmp_path):
    """What comes after the stream is not unpacked: 300 MB of zeros, a thousandth as large."""
    content = spzwriter.packed(3, 3, 0, spzwriter.random_planes(3, 3, 0))
    (tmp_path / "a").write_bytes(content + gzip.compress(bytes(100 << 20), 1) * 3)
    scene_or_line(tmp_path / "a")
    assert len(load_scene(tmp_path / "a")) == 3
