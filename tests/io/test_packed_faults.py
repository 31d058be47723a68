""".splat, .ksplat and compressed PLY that are damaged, and files that are none of them.

Not established here: that every fault is found. What is: each file gives a Scene of finite numbers
or one line, within 4 times its size and 64 MB, and no other file is taken for one of these.
"""

from __future__ import annotations

import os
import re
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.io.loading import refusal, scene_or_line
from tests.io.mutate import damaged
from tests.io.realdata import DATA, manifest, needs_data
from tests.io.splatwriter import drawn, write_compressed, write_ksplat, write_splat
from tests.io.test_packed import FORMATS, file  # noqa: F401 - a fixture
from tsplat.core.errors import SceneError
from tsplat.io import compressed, ksplat, load_scene, ply, splat, sweeps

FUNCTION = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
READERS = {
    ".splat": splat.SPLAT, ".ksplat": ksplat.KSPLAT, ".compressed.ply": compressed.COMPRESSED,
    ".ply": ply.PLY,
}  # fmt: skip


def starts():
    """First bytes of files that are no splats: name -> bytes."""
    rng = np.random.default_rng(0)
    count = 1024
    walk = np.cumsum(rng.normal(size=(count // 4, 4)), 0)
    positive = {
        "depths": rng.uniform(0.5, 10, count),
        "distances": np.abs(rng.normal(size=count)),
        "a ramp": np.linspace(1, 2, count),
        "exponentials": np.exp(rng.uniform(-9, 9, count)),
    }
    columns = "".join(f"{x:.3f} {y:.3f}\n" for x, y in rng.uniform(size=(300, 2)))
    return {
        **{name: values.astype("<f4").tobytes() for name, values in positive.items()},
        "noise": rng.bytes(4096),
        "zeros": bytes(4096),
        "ones": b"\xff" * 4096,
        "small integers": rng.integers(0, 1000, count).astype("<i4").tobytes(),
        "large integers": rng.integers(0, 2**31, count).astype("<i4").tobytes(),
        "doubles": rng.uniform(1, 2, count // 2).tobytes(),
        "points": walk.astype("<f4").tobytes(),
        "halves": rng.uniform(1, 2, 2048).astype("<f2").tobytes(),
        "text": columns.encode()[:4096],
        "letters": b"the quick brown fox jumps over the lazy dog\n" * 90,
        "Latin-1": "Grüße aus Köln, es regnet hier für immer.\n".encode("latin-1") * 90,
        "a picture": bytes(rng.integers(60, 200, 4096).astype(np.uint8)),
        "a font": struct.pack(">IHHHH", 0x10000, 15, 128, 3, 112) + rng.bytes(4084),
        "an icon": struct.pack("<HHH", 0, 1, 1) + bytes(4090),
        "machine code": b"\x7fELF\x02\x01\x01" + bytes(9) + rng.bytes(4080),
    }


@pytest.mark.parametrize("name", starts())
def test_other_files_are_not_taken_for_splats(tmp_path, name):
    """They get the line that says the format is unknown, whatever they are called."""
    path = tmp_path / "a.splat"
    path.write_bytes(starts()[name])
    assert "unknown format: named .splat, but its first rows of 32 bytes are no" in refusal(path)


@settings(max_examples=300)
@given(start=st.binary(min_size=32, max_size=256))
def test_bytes_at_random_are_no_splats(start):
    """Not even one row of 32: positions, scales and a quaternion would have to be as they are."""
    assert not splat.recognises(start)
    assert not ksplat.recognises(start)


@settings(max_examples=60)
@given(n=st.integers(1, 128), seed=st.integers(0, 999), size=st.sampled_from([1e-4, 1.0, 1e6]))
def test_rows_of_splats_are_taken_for_them(tmp_path_factory, n, seed, size):
    """However few and however large, a tenth of them spoilt, and with a scale of zero."""
    path = tmp_path_factory.mktemp("a") / "a"
    g = drawn(n, seed=seed, size=size)
    g.scales[:, 2] = 0
    g.means[: n // 10] = np.nan
    write_splat(path, g)
    assert splat.recognises(path.read_bytes()[:4096])


@needs_data
def test_no_real_file_is_taken_for_another():
    """Of all files there, each is recognised by the reader of its format and by no other."""
    taken = dict.fromkeys(READERS, 0)
    for path in manifest():
        with (DATA / path).open("rb") as stream:
            start = stream.read(4096)
        for suffix, reader in READERS.items():
            if not reader.recognises(start):
                continue
            if suffix == ".ply" and compressed.recognises(start):
                continue  # the reader that is asked before
            assert path.endswith(suffix) or path == "pc-engine/test.ply", (path, suffix)
            taken[suffix] += 1
    assert taken[".splat"] == sum(path.endswith(".splat") for path in manifest())
    assert taken[".ksplat"] == sum(path.endswith(".ksplat") for path in manifest())
    assert taken[".compressed.ply"] == 4


@pytest.mark.parametrize("over", [1, 16, 31])
def test_a_splat_that_is_no_whole_rows(tmp_path, over):
    """What is left over is counted."""
    path = tmp_path / "a.splat"
    write_splat(path, drawn(9), trailing=bytes(over))
    assert f"truncated .splat: {288 + over} bytes, which are 9 rows of 32 and {over}" in refusal(
        path
    )


def test_rows_that_cannot_be_drawn_are_counted(tmp_path):
    """A .splat may hold anything; reasons are those of PLY, and the others stay."""
    path = tmp_path / "a.splat"
    g = drawn(100)
    write_splat(path, g)
    rows = np.fromfile(
        path, np.dtype([("m", "<f4", 3), ("s", "<f4", 3), ("c", "u1", 4), ("q", "u1", 4)])
    )
    rows["m"][3, 1], rows["s"][5, 0], rows["s"][7, 2], rows["q"][9] = np.nan, np.inf, -1, 128
    path.write_bytes(rows.tobytes())
    scene = load_scene(path)
    assert dict(scene.dropped) == {
        "mean not finite": 1, "scale not finite": 1, "negative scale": 1,
        "quaternion of length zero": 1,
    }  # fmt: skip
    good = np.delete(np.arange(100), [3, 5, 7, 9])
    np.testing.assert_array_equal(scene.means, g.means[good].astype(np.float32))


def poked(content: bytes, *changes: tuple[int, str, object]) -> bytes:
    """``content`` with numbers packed into it at so many bytes."""
    made = bytearray(content)
    for at, kind, value in changes:
        struct.pack_into("<" + kind, made, at, value)
    return bytes(made)


SECTION = 4096
KSPLAT = {
    "level": ([(20, "H", 3)], "byte 20: compression level 3, expected 0, 1 or 2"),
    "sections": ([(4, "I", 5000)], "byte 4: 5000 sections, expected 1 to 4096"),
    "more sections": ([(4, "I", 2000)], "truncated: headers of 2000 sections ends at byte 2052096"),
    "splats": ([(SECTION, "I", 10**9), (SECTION + 4, "I", 10**9)], "truncated: ksplat section 0"),
    "room": ([(SECTION, "I", 601)], r"section 0 \(header at byte 4096\): 601 Gaussians in room"),
    "all room": ([(SECTION + 4, "I", 2**32 - 1)], "truncated: ksplat section 1"),
    "bucket bytes": ([(SECTION + 20, "H", 16)], "buckets of 16 bytes, expected 12|truncated"),
    "bucket size": ([(SECTION + 8, "I", 0)], "buckets of 0 Gaussians and size 5"),
    "block": ([(SECTION + 16, "f", float("nan"))], "size nan, expected more than 0"),
    "full": ([(SECTION + 32, "I", 10**9)], "1000000000 full and .* other buckets, expected"),
    "partial": ([(SECTION + 36, "I", 2**32 - 1)], "truncated"),
    "lengths": ([(SECTION + 8, "I", 1)], "buckets for .* Gaussians, expected 600; the file"),
    "degree": ([(SECTION + 40, "H", 3)], "spherical harmonics of degree 3, expected 0 to 2"),
    "total": ([(16, "I", 1199)], "byte 16: 1199 Gaussians, but its sections have 1200"),
    "empty": (
        [(SECTION, "I", 0), (SECTION + 1024, "I", 0)], "holds no Gaussians .ksplat of 2 sections"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", KSPLAT)
def test_ksplat_headers_that_cannot_be(tmp_path, case):
    """Each number is held against the others and the file's size; the line says where it is."""
    path = tmp_path / "a.ksplat"
    write_ksplat(path, [(drawn(600, 1), 1), (drawn(600, seed=1), 0)], 1, bucket=16)
    changes, expected = KSPLAT[case]
    path.write_bytes(poked(path.read_bytes(), *changes))
    assert re.search(expected, refusal(path)), refusal(path)


COMPRESSED = {
    "text": ("binary_little_endian", "ascii", "in text .format ascii., expected binary"),
    "no chunk": ("element chunk", "element chunks", "without an element chunk"),
    "chunks": ("element chunk 3", "element chunk 2", "with 2 chunks, expected 3 for its 600"),
    "no floats": ("property float min_x", "property int min_x", "has no float min_x"),
    "no uint": ("uint packed_scale", "int packed_scale", "element vertex has no uint packed_scale"),
    "no rotation": ("packed_rotation", "packed_turn", "element vertex has no uint packed_rotation"),
    "half the colours": ("min_g", "least_g", "element chunk has no float min_g"),
    "no uchar": ("uchar f_rest_3", "char f_rest_3", "element sh has no uchar f_rest_3"),
    "a gap": ("f_rest_3\n", "f_rest_9\n", "element sh has no uchar f_rest_3"),
    "rows of sh": ("element sh 600", "element sh 599", "element sh has 599 rows, expected 600"),
    "rows": ("element vertex 600", "element vertex 600000000", "truncated: its header promises"),
    "nothing": ("element vertex 600", "element vertex 0", "holds no Gaussians"),
    "coefficients": (
        "property uchar f_rest_8\n", "", "element sh has 8 properties, expected 9, 24 or 45"
    ),
    "a list": (
        "property float min_x", "property list uchar float min_x", "chunk has no float min_x"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", COMPRESSED)
def test_headers_of_compressed_ply_that_cannot_be(tmp_path, case):
    """Elements, counts and types are held against each other and the file's size."""
    path = tmp_path / "a.ply"
    write_compressed(path, drawn(600, 1))
    old, new, expected = COMPRESSED[case]
    content = path.read_bytes()
    assert old.encode() in content
    path.write_bytes(content.replace(old.encode(), new.encode(), 1) + bytes(999))
    assert re.search(expected, refusal(path)), refusal(path)


def test_rows_of_lists_come_after_or_not_at_all(tmp_path):
    """An element of lists behind the Gaussians is no matter; before them they are not found."""
    path = tmp_path / "a.ply"
    write_compressed(path, drawn(600, 1))
    content = path.read_bytes()
    faces = b"element face 1\nproperty list uchar int i\n"
    path.write_bytes(content.replace(b"end_header", faces + b"end_header") + bytes(9))
    assert len(load_scene(path)) == 600
    path.write_bytes(content.replace(b"element chunk", faces + b"element chunk") + bytes(9))
    assert "with rows of lists (element face) before its Gaussians" in refusal(path)


@pytest.mark.parametrize("bits", [0x7FC00000, 0x7F800001, 0x7F800000])
@pytest.mark.parametrize("place", ["min_x", "max_scale_z", "max_b"])
def test_a_range_that_is_no_number_costs_its_chunk(tmp_path, place, bits):
    """Its 256 Gaussians are dropped and counted; the other chunks stay."""
    path = tmp_path / "a.ply"
    write_compressed(path, drawn(600))
    content = path.read_bytes()
    names = re.findall(rb"property float (\w+)", content)
    at = content.index(b"end_header\n") + 11 + 4 * (names.index(place.encode()) + len(names))
    path.write_bytes(poked(content, (at, "I", bits)))
    scene = load_scene(path)
    assert len(scene) == 344
    assert list(scene.dropped.values()) == [256]


def test_reasons_come_in_one_order(tmp_path, monkeypatch):
    """Where nothing can be drawn the line is the same, whichever thread met a fault first."""
    monkeypatch.setattr(sweeps, "CHUNK", 5)
    monkeypatch.setattr(sweeps, "PIECE", 5)
    path = tmp_path / "a.ksplat"
    g = drawn(40)
    g.quats[:20], g.scales[20:] = np.nan, np.inf
    for order in (slice(None), slice(None, None, -1)):
        write_ksplat(path, [(g.take(order), 0)], 0)
        expected = "(quaternion not finite: 20, scale not finite: 20)"
        assert expected in refusal(path)


@pytest.mark.parametrize("left", [0.3, 0.9, 0.999])
def test_files_cut_short_while_they_are_read(file, monkeypatch, left):  # noqa: F811
    """Refused in one line, as files that never were whole are; the process lives on."""
    whole = file.stat().st_size
    fill = sweeps.Bytes.fill

    def cut(self, room, at):
        if at >= 5000 or splat.recognises(file.read_bytes()):
            os.truncate(file, int(whole * left))
        fill(self, room, at)

    monkeypatch.setattr(sweeps.Bytes, "fill", cut)
    assert re.search("ended at byte .* while it was read, expected", refusal(file))


def test_every_cut_of_a_file_is_refused(file):  # noqa: F811
    """None gives another exception, nor a scene: but a .splat that ends between two rows."""
    whole = file.read_bytes()
    rows = splat.recognises(whole)
    for size in range(0, len(whole), max(1, len(whole) // 97)):
        file.write_bytes(whole[:size])
        if rows and size and size % 32 == 0:
            assert len(load_scene(file)) == size // 32
        else:
            refusal(file)


@settings(max_examples=120, suppress_health_check=FUNCTION)
@given(data=st.data())
@pytest.mark.parametrize("name", FORMATS)
def test_damage_gives_a_scene_or_a_line(tmp_path, name, data):
    """Bits, numbers at their extremes, pieces moved, ends cut off, in headers above all."""
    path = tmp_path / "scene"
    FORMATS[name](path, drawn(40, 2))
    head = 4096 + 1024 if name.startswith("ksplat") else 256
    path.write_bytes(data.draw(damaged(path.read_bytes(), head)))
    scene_or_line(path)


REAL = [
    "formats/leica-8k-sh3/leica-8k-sh3.am15.splat",
    "formats/leica-8k-sh3/leica-8k-sh3.mk-l0-sh2.ksplat",
    "formats/leica-8k-sh3/leica-8k-sh3.mk-l1-sh2.ksplat",
    "formats/leica-8k-sh3/leica-8k-sh3.mk-l2-sh2.ksplat",
    "formats/leica-8k-sh3/leica-8k-sh3.compressed.ply",
    "pc-engine/test.ply",
]


@settings(max_examples=25, suppress_health_check=FUNCTION)
@given(draw=st.data())
@pytest.mark.parametrize("name", REAL)
def test_damage_to_real_files_gives_a_scene_or_a_line(data, tmp_path, name, draw):
    """The same of files by other people's tools."""
    content = (data / name).read_bytes()
    path = tmp_path / "scene"
    path.write_bytes(draw.draw(damaged(content, 4096 + 64)))
    scene_or_line(path)


def test_the_writers_tell_faults(tmp_path):
    """What the tests above write is read: the faults found there are those that were made."""
    write_ksplat(tmp_path / "a", [(drawn(600, 1), 1), (drawn(600, seed=1), 0)], 1, bucket=16)
    assert len(load_scene(tmp_path / "a")) == 1200
    write_compressed(tmp_path / "b", drawn(600, 1))
    assert len(load_scene(tmp_path / "b")) == 600
    with pytest.raises(SceneError):
        load_scene(tmp_path / "c")
