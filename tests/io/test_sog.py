"""SOG: both versions against a decoder that goes pixel by pixel; containers; faults; damage."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from tests.io.loading import in_file_order, refusal, scene_or_line
from tests.io.mutate import altered, damaged
from tests.io.sogwriter import bundle, decoded, random_scene, unbundled, webp
from tsplat.io import curve, load_scene, pixels

quick = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.mark.parametrize("version", [1, 2])
@quick
@given(n=st.integers(1, 40), degree=st.integers(0, 3), seed=st.integers(0, 999))
def test_values_are_those_of_the_plain_decoder(tmp_path, version, n, degree, seed):
    """Any pixels, to float32's rounding: positions, turns, sizes, opacities, colours."""
    meta, images, pixels = random_scene(n, degree, version, seed)
    (tmp_path / "a").write_bytes(bundle(meta, images))
    scene = load_scene(tmp_path / "a", sh_float32=True)
    assert (len(scene), scene.sh_degree, dict(scene.dropped)) == (n, degree, {})
    for i in range(n):
        mean, quat, scales, opacity, sh = decoded(i, degree, meta, pixels)
        np.testing.assert_allclose(scene.means[i], mean, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(scene.quats[i], quat, atol=3e-7)
        np.testing.assert_allclose(scene.scales[i], scales, rtol=1e-6)
        np.testing.assert_allclose(scene.opacities[i], opacity, atol=1e-7)
        np.testing.assert_allclose(scene.sh[i], sh, rtol=1e-6, atol=1e-6)


def test_each_container_holds_the_same_scene(tmp_path):
    """Stored, deflated, with meta.json last or in a folder of the archive, PNG; a real folder."""
    meta, images, _ = random_scene(30, 2)
    (tmp_path / "a.sog").write_bytes(bundle(meta, images))
    first = load_scene(tmp_path / "a.sog")
    assert (first.name, first.source, first.antialias) == ("a.sog", "sog 2, SH 2", None)
    pngs = random_scene(30, 2, kind="PNG")[1]
    for content in (
        bundle(meta, images, deflate=True, last=True), bundle(meta, images, prefix="x/y/"),
        bundle(meta, pngs),
    ):  # fmt: skip
        (tmp_path / "b").write_bytes(content)
        assert (load_scene(tmp_path / "b").sh == first.sh).all()
    folder = unbundled(tmp_path / "garden", meta, images)
    for path in (folder, folder / "meta.json"):
        scene = load_scene(path)
        assert (scene.sh == first.sh).all()
        assert (scene.name, scene.source) == ("garden", "sog 2, SH 2, unbundled")


@pytest.mark.parametrize("told", [True, False])
def test_what_the_file_says_of_antialiasing_is_kept(tmp_path, told):
    """meta.json's antialias becomes the scene's; named where it is on."""
    meta, images, _ = random_scene(3, 0)
    (tmp_path / "a").write_bytes(bundle({**meta, "antialias": told}, images))
    scene = load_scene(tmp_path / "a")
    assert scene.antialias is told
    assert ("antialiased" in scene.source) is told


def test_raw_opacity_is_for_version_1(tmp_path):
    """There alphas are logits between two bounds, or opacities if so asked; version 2 has none."""
    meta, images, pixels = random_scene(20, 0, version=1)
    meta["sh0"]["mins"][3], meta["sh0"]["maxs"][3] = 0.25, 0.75
    (tmp_path / "a").write_bytes(bundle(meta, images))
    raw = load_scene(tmp_path / "a", raw_opacity=True).opacities
    np.testing.assert_allclose(raw, 0.25 + 0.5 * pixels["sh0"][:20, 3] / 255, atol=1e-7)
    np.testing.assert_allclose(load_scene(tmp_path / "a").opacities, 1 / (1 + np.exp(-raw)), 1e-6)
    meta["sh0"]["mins"][3], meta["sh0"]["maxs"][3] = -9, 9
    (tmp_path / "a").write_bytes(bundle(meta, images))
    assert "outside 0..1, so they are logits" in refusal(tmp_path / "a", raw_opacity=True)
    (tmp_path / "b").write_bytes(bundle(*random_scene(3, 0)[:2]))
    assert "opacities of SOG 2 are always 0..1" in refusal(tmp_path / "b", raw_opacity=True)


def test_a_rotation_without_tag_is_left_out(tmp_path):
    """An alpha below 252 says no component is the largest: no rotation, counted, not guessed."""
    meta, images, pixels = random_scene(4, 0)
    pixels["quats"][1, 3] = 251
    images["quats.webp"] = webp(pixels["quats"], 2, 2)
    (tmp_path / "a").write_bytes(bundle(meta, images))
    scene = load_scene(tmp_path / "a")
    assert dict(scene.dropped) == {"quaternion of length zero": 1}
    np.testing.assert_allclose(scene.means[1], decoded(2, 0, meta, pixels)[0], rtol=1e-5)


def test_bytes_beyond_a_codebook_are_left_out(tmp_path):
    """A codebook of fewer than 256 numbers says nothing of the other bytes."""
    meta, images, pixels = random_scene(60, 0)
    meta["scales"]["codebook"] = meta["scales"]["codebook"][:200]
    (tmp_path / "a").write_bytes(bundle(meta, images))
    beyond = int((pixels["scales"][:60, :3] >= 200).any(1).sum())
    assert dict(load_scene(tmp_path / "a").dropped) == {"scale not finite": beyond}


def test_many_rows_lie_along_the_curve_and_samples_are_rows(tmp_path):
    """Rows that are moved keep their numbers; a sample has rows of the whole."""
    n = curve.ROWS_MIN
    meta, images, pixels = random_scene(n, 1)
    (tmp_path / "a").write_bytes(bundle(meta, images))
    back = in_file_order(load_scene(tmp_path / "a"))
    for i in (0, n // 3, n - 1):
        np.testing.assert_allclose(back.means[i], decoded(i, 1, meta, pixels)[0], rtol=1e-5)
    some = load_scene(tmp_path / "a", max_splats=100)
    assert dict(some.dropped) == {"beyond max_splats": n - 100}
    whole = {mean.tobytes() for mean in back.means}
    assert all(mean.tobytes() in whole for mean in some.means)


GOOD = random_scene(6, 1)


def changed(*path, value=None):
    """meta.json with one value replaced, or taken away if it is None."""
    meta = json.loads(json.dumps(GOOD[0]))
    at = meta
    for key in path[:-1]:
        at = at[key]
    if value is None:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return bundle(meta, GOOD[1])


def replaced(name, content):
    return bundle(GOOD[0], {**GOOD[1], name: content})


def image(width, height, kind="WEBP", **options):
    return webp(np.zeros((width * height, 4), np.uint8), width, height, kind, **options)


BIG = b"RIFF\x20\0\0\0WEBPVP8L\x14\0\0\0/" + struct.pack("<I", 16383 | 16383 << 14) + bytes(19)
CASES = {
    "version 3": (changed("version", value=3), r"version: expected 2 \(version 1 says none\), got"),
    "version word": (changed("version", value="2"), "version: expected a whole number"),
    "no count": (changed("count"), "meta.json: count is missing"),
    "count 0": (changed("count", value=0), r"holds no Gaussians \(meta.json: count is 0\)"),
    "count of 1e300": (changed("count", value=1e300), "count: expected a whole number"),
    "count too large": (changed("count", value=10**9), "promises 1000000000 Gaussians, a file of"),
    "count beyond": (changed("count", value=99), r"means_l.webp: 3x2 pixels, expected 99 or more"),
    "no means": (changed("means"), "means is missing"),
    "means a list": (changed("means", value=[1]), "means: expected an object, got a list of 1"),
    "mins": (changed("means", "mins", value=[0, 1]), "means.mins: expected a list of 3 numbers"),
    "mins text": (changed("means", "mins", value=["a", 1, 2]), "means.mins: expected numbers"),
    "mins huge": (changed("means", "mins", value=[10**400, 1, 2]), "expected a?.*float64|numbers"),
    "codebook": (changed("scales", "codebook", value=[]), "a list of 1 to 256 numbers"),
    "files": (changed("means", "files", value=["a"]), "means.files: expected 2 items, got 1"),
    "file is a number": (changed("sh0", "files", value=[3]), "names 3|expected a string, got 3"),
    "no such file": (changed("sh0", "files", value=["a.webp"]), "names a.webp, which is not in"),
    "bands": (changed("shN", "bands", value=2), "shN.bands: expected 1, because .* 192 pixels"),
    "bands 4": (changed("shN", "bands", value=4), "bands: expected a whole number, 1 to 3"),
    "not json": (bundle(b"{,", GOOD[1]), "meta.json: JSON that cannot be read: "),
    "deep json": (bundle(b"[" * 100_000, GOOD[1]), "nested too deeply|cannot be read"),
    "a list": (bundle(b"[]", GOOD[1]), "expected a JSON object, got a list of 0"),
    "not utf-8": (bundle(b'{"a": "\xff"}', GOOD[1]), "cannot be read: 'utf-8' codec"),
    "large json": (bundle(b" " * (1 << 21) + b"{}", {}), "meta.json has 2097154 bytes, expected"),
    "wide image": (replaced("quats.webp", BIG), "16384x16384 pixels, expected at most 65548"),
    "small image": (replaced("quats.webp", image(2, 2)), "2x2 pixels, expected 6 or more"),
    "lossy": (
        replaced("sh0.webp", image(3, 2, lossless=False)), "a lossy WebP, expected a lossless one",
    ),
    "jpeg": (replaced("sh0.webp", b"\xff\xd8\xff\xe0" + bytes(99)), "neither WebP nor PNG"),
    "no image": (replaced("sh0.webp", b""), "neither WebP nor PNG"),
    "cut image": (replaced("sh0.webp", GOOD[1]["sh0.webp"][:40]), "cannot be decoded"),
    "centroids": (
        replaced("shN_centroids.webp", image(100, 1)), r"100 pixels wide, expected 192, 512, 960",
    ),
    "labels": (
        replaced("shN_labels.webp", webp(np.full((6, 4), 250), 3, 2)), "a label is 64250, the pal",
    ),
    "empty meta": (bundle({}, {"a.webp": b""}), "means is missing"),
    "cut archive": (bundle(*GOOD[:2])[:-30], "a zip archive without its directory"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_refused_with_one_line(tmp_path, case):
    """Which value of meta.json or which image, what was expected and what came, on one line."""
    content, expected = CASES[case]
    (tmp_path / "a.sog").write_bytes(content)
    line = refusal(tmp_path / "a.sog")
    assert re.search(expected, line), line


def test_an_archive_of_images_without_meta(tmp_path):
    """A zip archive that only looks like a SOG is told by what it holds."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("holiday.webp", b"x")
    (tmp_path / "a.zip").write_bytes(buffer.getvalue())
    assert "without meta.json, expected a SOG's; it holds holiday.webp" in refusal(
        tmp_path / "a.zip"
    )


@pytest.mark.parametrize(
    "name", ["../out.webp", "/etc/passwd", "a\\b.webp", "C:x.webp", "link.webp", "", "x\0.webp",
             "..", "sub/../../out.webp", "%2e%2e/out.webp", "n" * 300, "fifo"]
)  # fmt: skip
def test_no_name_leads_out_of_the_folder(tmp_path, name):
    """Absolute, upward, linked, encoded and odd names are refused; nothing outside is read."""
    import os

    meta, images, _ = random_scene(6, 0)
    folder = unbundled(tmp_path / "s", meta, images)
    (tmp_path / "out.webp").write_bytes(images["sh0.webp"])
    (folder / "link.webp").symlink_to(tmp_path / "out.webp")
    os.mkfifo(folder / "fifo")
    meta["sh0"]["files"] = [name]
    (folder / "meta.json").write_text(json.dumps(meta))
    line = refusal(folder)
    assert re.search(r"sh0.files\[0\]", line), line


def test_an_archive_with_a_large_directory(tmp_path):
    """A directory of many members is refused by its size: objects would take ten times as much."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for i in range(2000):
            archive.writestr(f"{i}.webp", b"")
    (tmp_path / "a").write_bytes(buffer.getvalue())
    assert "expected at most 65536 and no zip64" in refusal(tmp_path / "a")


def test_a_bomb_takes_little_memory(tmp_path):
    """A member that unpacks to more than four times the archive is refused by what it promises."""
    content = bundle(GOOD[0], {**GOOD[1], "sh0.webp": bytes(60 << 20)}, deflate=True)
    (tmp_path / "a").write_bytes(content)
    scene_or_line(tmp_path / "a")
    assert re.search("sh0.webp has 62914560 bytes, expected at most", refusal(tmp_path / "a"))


def test_an_encrypted_archive(tmp_path):
    """A member that is encrypted is refused by name."""
    content = bytearray(bundle(*GOOD[:2]))
    for magic, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = content.find(magic)
        while at >= 0:
            content[at + flags] |= 1
            at = content.find(magic, at + 4)
    (tmp_path / "a").write_bytes(content)
    assert "meta.json is encrypted or packed in a way that is not read" in refusal(tmp_path / "a")


def test_sizes_of_images_are_those_of_pillow():
    """The header that is read before decoding says what decoding finds."""
    for width, height in ((1, 1), (3, 7), (960, 16), (130, 1)):
        for kind, options in (("WEBP", {}), ("PNG", {}), ("WEBP", {"exif": b"Exif\0\0x"})):
            content = image(width, height, kind, **options)
            assert pixels.image_size(None, "", content) == Image.open(io.BytesIO(content)).size


@settings(quick, max_examples=150)
@given(data=st.data())
def test_damage_gives_a_scene_or_a_line(tmp_path, data):
    """Bits, numbers and pieces of the archive, of an image or of meta.json changed."""
    meta, images, _ = random_scene(6, 1, data.draw(st.sampled_from([1, 2])))
    kind = data.draw(st.sampled_from(["archive", "image", "json", "text"]))
    if kind == "json":
        meta = data.draw(altered(meta))
    elif kind == "text":
        meta = data.draw(damaged(json.dumps(meta).encode()))
    elif kind == "image":
        name = data.draw(st.sampled_from(sorted(images)))
        images[name] = data.draw(damaged(images[name], 40))
    content = bundle(meta, images, deflate=data.draw(st.booleans()))
    if kind == "archive":
        content = data.draw(damaged(content))
    (tmp_path / "a").write_bytes(content)
    scene_or_line(tmp_path / "a")
