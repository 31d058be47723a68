"""SPZ: every version against a decoder that goes Gaussian by Gaussian; options; faults; damage."""

from __future__ import annotations

import gzip
import re
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.io import spzwriter
from tests.io.loading import covariances, in_file_order, refusal, scene_or_line
from tests.io.mutate import damaged
from tests.io.spzwriter import NO_ZSTD, header, packed, random_planes
from tsplat.core.errors import OutputError
from tsplat.io import curve, load_scene, save_scene, spz, sweeps
from tsplat.io.gather import COUNT_FREE
from tsplat.io.turn import axes
from tsplat.io.write import spz as write_spz
from tsplat.io.write.base import WriteOptions

needs_zstd = pytest.mark.skipif(not spzwriter.HAVE_ZSTD, reason=NO_ZSTD)
VERSIONS = [1, 2, 3, pytest.param(4, marks=needs_zstd)]
quick = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def write(path, n, version, degree, seed=0, **more):
    planes = random_planes(n, version, degree, seed)
    path.write_bytes(packed(n, version, degree, planes, **more))
    return planes


@pytest.mark.parametrize("version", VERSIONS)
@quick
@given(n=st.integers(1, 40), degree=st.integers(0, 3), seed=st.integers(0, 999), data=st.data())
def test_values_are_those_of_the_plain_decoder(tmp_path, version, n, degree, seed, data):
    """Any planes: positions exact, the rest to float32's rounding, all in tsplat's axes."""
    fraction = 12 if version == 1 else data.draw(st.integers(0, 23))
    planes = write(tmp_path / "a", n, version, degree, seed, fraction=fraction)
    scene = load_scene(tmp_path / "a", sh_float32=True)
    assert (len(scene), scene.sh_degree, dict(scene.dropped)) == (n, degree, {})
    # y, z, x; xy, yz, zz, xz, xx; yxx, xyz, yzz, zzz, xzz, zxx, xxx: how often y and z stand there
    powers = [0, 1, 1, 0, 1, 2, 0, 1, 0, 1, 2, 1, 1, 0, 1, 0]
    signs = [(-1) ** p for p in powers]
    for i in range(n):
        mean, quat, scales, opacity, sh = spzwriter.decoded(i, version, degree, planes, fraction)
        assert scene.means[i].tolist() == [mean[0], -mean[1], -mean[2]]
        flipped = [quat[0], quat[1], -quat[2], -quat[3]]
        np.testing.assert_allclose(scene.quats[i], flipped, atol=3e-7)
        np.testing.assert_allclose(scene.scales[i], scales, rtol=1e-6)
        np.testing.assert_allclose(scene.opacities[i], opacity, atol=1e-7)
        wanted = np.array(sh) * np.array(signs[: len(sh)])[:, None]
        np.testing.assert_allclose(scene.sh[i], wanted, atol=1e-6)


@pytest.mark.parametrize("version", VERSIONS)
def test_what_the_file_says_of_antialiasing_is_kept(tmp_path, version):
    """Flag 1 becomes Scene.antialias and is named; without it, it is False, not unknown."""
    write(tmp_path / "on", 2, version, 1, flags=1)
    write(tmp_path / "off", 2, version, 1)
    on, off = load_scene(tmp_path / "on"), load_scene(tmp_path / "off")
    assert (on.antialias, on.source) == (True, f"spz {version}, SH 1, antialiased")
    assert (off.antialias, off.source) == (False, f"spz {version}, SH 1")


@needs_zstd
@pytest.mark.parametrize("value", range(17))
def test_axes_of_the_extension(tmp_path, value):
    """Each system that SPZ_ADOBE_coordinate_system names takes Gaussians where it says.

    The table is splat-types.h's; 0 is unspecified, and RUB as in a file without extension.
    """
    right, up, front, z_up = ((value - 1) >> bit & 1 for bit in range(4))
    x, y, z = "LR"[right], "DU"[up], ("FB" if z_up else "BF")[front]
    name = "RUB" if value == 0 else x + (z + y if z_up else y + z)
    other = spzwriter.extension(0xADBE0002, bytes(12))
    told = other + spzwriter.extension(0xADBE0003, struct.pack("<I", value))
    planes = write(tmp_path / "a", 5, 4, 0, extensions=told)
    scene = load_scene(tmp_path / "a")
    matrix = axes(name)
    (tmp_path / "plain").write_bytes(packed(5, 4, 0, planes))
    plain = load_scene(tmp_path / "plain")
    back = matrix @ axes("RUB").T
    np.testing.assert_allclose(scene.means, plain.means @ back.T, rtol=1e-6)
    np.testing.assert_allclose(
        covariances(scene), back @ covariances(plain) @ back.T, rtol=1e-4, atol=1e-12
    )
    assert ("axes" in scene.source) == (name != "RUB")


def test_without_compression(tmp_path):
    """A version 2 stream that is not packed is read too, as splat-transform does."""
    planes = random_planes(3, 2, 1)
    (tmp_path / "bare").write_bytes(header(3, 2, 1) + b"".join(planes))
    (tmp_path / "zip").write_bytes(packed(3, 2, 1, planes))
    assert (load_scene(tmp_path / "bare").sh == load_scene(tmp_path / "zip").sh).all()


def test_a_name_in_the_gzip_header_of_any_length(tmp_path):
    """A stream whose own header is longer than what readers are shown is read."""
    plain = packed(2, 2, 0, random_planes(2, 2, 0))
    name = b"\x08" + plain[4:10] + b"n" * 9000 + b"\0"  # flag 8: a name follows
    (tmp_path / "a").write_bytes(plain[:3] + name + plain[10:])
    assert len(load_scene(tmp_path / "a")) == 2


def test_a_sample_is_rows_of_the_whole(tmp_path):
    """max_splats keeps rows of the file as they are, the same every time, and counts the rest."""
    write(tmp_path / "a", 500, 3, 2)
    whole, some = load_scene(tmp_path / "a"), load_scene(tmp_path / "a", max_splats=50)
    assert dict(some.dropped) == {"beyond max_splats": 450}
    rows = [int(np.flatnonzero((whole.means == mean).all(1))[0]) for mean in some.means]
    assert rows == sorted(rows)
    assert len(set(rows)) == 50
    assert (some.sh == whole.sh[rows]).all()
    assert (some.quats == whole.quats[rows]).all()


def test_many_rows_lie_along_the_curve(tmp_path):
    """From ROWS_MIN rows on they are moved; put back by their numbers they are the file's."""
    n = curve.ROWS_MIN
    planes = write(tmp_path / "a", n, 2, 0)
    scene = load_scene(tmp_path / "a")
    assert scene.numbers is not None
    assert (np.diff(scene.numbers) != 1).any()
    back = in_file_order(scene)
    for i in (0, 1, n // 2, n - 1):
        mean = spzwriter.decoded(i, 2, 0, planes)[0]
        assert back.means[i].tolist() == [mean[0], -mean[1], -mean[2]]
    steps = np.linalg.norm(np.diff(scene.means, axis=0), axis=1)
    assert np.median(steps) < 0.5 * np.median(np.linalg.norm(np.diff(back.means, axis=0), axis=1))


def test_coefficients_are_half_or_not(tmp_path):
    """float16 unless float32 is asked for; the values of degree 1 and up fit exactly."""
    write(tmp_path / "a", 50, 3, 3)
    half, full = load_scene(tmp_path / "a"), load_scene(tmp_path / "a", sh_float32=True)
    assert (half.sh.dtype, full.sh.dtype) == (np.float16, np.float32)
    assert (half.sh[:, 1:] == full.sh[:, 1:]).all()
    assert 0 < half.sh_error < 1 / 1020


def test_progress_goes_up_to_its_end(tmp_path):
    """Calls never go back and end where they said they would: unpacked, along a curve, decoded."""
    write(tmp_path / "a", max(curve.ROWS_MIN, 4 * sweeps.PIECE), 3, 1)
    calls = []
    load_scene(tmp_path / "a", progress=lambda done, total: calls.append(done / total))
    assert calls == sorted(calls)
    assert calls[-1] == 1
    assert len(calls) > 8


def test_positions_that_are_not_finite_are_left_out(tmp_path):
    """float16 has infinities and NaN: such rows are counted, the others stay in order."""
    planes = random_planes(4, 1, 0)
    bad = np.frombuffer(planes[0], "<f2").copy()
    bad[3], bad[8] = np.inf, np.nan
    planes[0] = bad.tobytes()
    (tmp_path / "a").write_bytes(packed(4, 1, 0, planes))
    scene = load_scene(tmp_path / "a")
    assert dict(scene.dropped) == {"mean not finite": 2}
    assert scene.means[:, 0].tolist() == bad[[0, 9]].tolist()


def four(planes, **changes):
    """A version 4 file with fields of its header changed."""
    made = bytearray(packed(2, 4, 0, planes))
    for at, value in changes.values():
        made[at : at + len(value)] = value
    return bytes(made)


TWO = random_planes(2, 2, 0)
OLD = header(2, 2, 0) + b"".join(TWO)
MANY = gzip.compress(header(2**32 - 1, 2, 0))
CASES = {
    "version 0": (gzip.compress(header(2, 0, 0)), r"SPZ version 0 \(byte 4\), expected 1 to 4"),
    "version 9": (header(2, 9, 0) + bytes(16), "SPZ version 9.* update tsplat"),
    "gzip of version 4": (gzip.compress(header(2, 4, 0)), "version 4 in a gzip stream"),
    "no Gaussians": (gzip.compress(header(0, 2, 0)), r"holds no Gaussians \(SPZ header's number"),
    "too many": (
        MANY, rf"byte 8\) promises 4294967295 Gaussians, .* at most {COUNT_FREE + 2 * len(MANY)};",
    ),
    "many more than there are": (
        gzip.compress(header(100_000, 2, 3)),
        "truncated: SPZ of 100000 Gaussians needs 6400000 bytes, its gzip stream has 0; copy",
    ),
    "degree 4": (gzip.compress(header(2, 2, 4)), r"SPZ of SH degree 4 \(byte 12\), expected 0 to"),
    "degree 5": (gzip.compress(header(2, 2, 5)), r"SH degree \(byte 12\) is 5, expected 0 to 3"),
    "fraction": (gzip.compress(header(2, 2, 0, 31)), r"fractional bits \(byte 13\) are 31"),
    "one byte short": (gzip.compress(OLD[:-1]), "needs 38 bytes, its gzip stream has 37"),
    "one byte more": (gzip.compress(OLD + b"x"), "its gzip stream holds more than 2 Gaussians"),
    "cut stream": (gzip.compress(OLD)[:-9], "truncated: .*download"),
    "checksum": (gzip.compress(OLD)[:-8] + b"12345678", "cannot be unpacked near byte .*incorrect"),
    "bare, short": (OLD[:-1], "without compression has 54 bytes, the file 53; copy"),
    "bare header": (OLD[:12], "truncated: SPZ header: expected 16 bytes, got 12"),
    "short header 4": (header(2, 4, 0)[:16] + bytes(4), "SPZ 4 header: expected 32 bytes, got 20"),
    "streams": (header(2, 4, 0, last=6) + bytes(300), r"streams \(byte 15\) is 6, expected 5 of"),
    "table": (header(2, 4, 0, last=5) + bytes(300), r"table offset \(byte 16\) is 0, expected 32"),
    "far table": (
        header(2, 4, 0, last=5) + b"\xff" * 300, "truncated: the table of its streams ends at"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_refused_with_one_line(tmp_path, case):
    """Field or byte, what was expected, what came, and what to do, on one line."""
    content, expected = CASES[case]
    (tmp_path / "a.spz").write_bytes(content)
    line = refusal(tmp_path / "a.spz")
    assert re.search(expected, line), line


@needs_zstd
@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda b: b + b"x", "its streams end at byte .*, the file at"),
        (lambda b: b[:-1], "its streams end at byte .*, the file at"),
        (lambda b: b[:40] + b"\xff" + b[41:], "stream positions promises .* expected 18 of 2 G"),
        (lambda b: b[:32] + struct.pack("<Q", 2**60) + b[40:], "its streams end at byte"),
        (lambda b: b[:116] + b"zzz" + b[119:], "stream positions cannot be unpacked near byte"),
        (lambda b: b[:14] + b"\2" + b[15:20] + b[20:], None),
    ],
)
def test_version_4_is_checked_before_it_is_unpacked(tmp_path, damage, expected):
    """The table has to fit the header and the file; a flag of extensions without any does."""
    planes = random_planes(2, 4, 0)
    (tmp_path / "a").write_bytes(damage(packed(2, 4, 0, planes)))
    if expected is None:
        assert len(load_scene(tmp_path / "a")) == 2
    else:
        line = refusal(tmp_path / "a")
        assert re.search(expected, line), line


@needs_zstd
@pytest.mark.parametrize(
    ("records", "expected"),
    [
        (spzwriter.extension(0xADBE0003, b"\x11\0\0\0"), "extension of axes: 17, expected 0 to 16"),
        (spzwriter.extension(0xADBE0003, b""), "extension of axes: -1"),
        (struct.pack("<II", 7, 99), "extension at byte 32 promises 99 bytes, 0 are left"),
    ],
)
def test_extensions_that_are_wrong(tmp_path, records, expected):
    """A record that is longer than what is there, or of no known axes, is refused."""
    planes = random_planes(2, 4, 0)
    (tmp_path / "a").write_bytes(packed(2, 4, 0, planes, extensions=records))
    assert expected in refusal(tmp_path / "a")


def test_without_zstd_it_says_what_to_install(tmp_path, monkeypatch):
    """Version 4 needs zstd, and only version 4."""

    def missing():
        raise ImportError

    monkeypatch.setattr(spz, "zstd_module", missing)
    content = header(2, 4, 0, last=5) + struct.pack("<I12x", 32) + bytes(5 * 16)
    (tmp_path / "a").write_bytes(content)
    assert "pip install backports.zstd" in refusal(tmp_path / "a")
    write(tmp_path / "old", 2, 3, 0)
    scene = load_scene(tmp_path / "old")
    assert len(scene) == 2
    monkeypatch.setattr(write_spz, "zstd_module", missing)
    with pytest.raises(OutputError, match=r"new.spz: .*backports.zstd; or write version 3"):
        save_scene(scene, tmp_path / "new.spz", options=WriteOptions(version=4))
    assert not (tmp_path / "new.spz").exists()


def test_raw_opacity_has_no_meaning(tmp_path):
    """SPZ has one kind of opacities; to ask for another is an error, not a guess."""
    write(tmp_path / "a", 2, 2, 0)
    assert "opacities of SPZ are always 0..1" in refusal(tmp_path / "a", raw_opacity=True)


def test_a_bomb_takes_little_memory(tmp_path):
    """100 MB of zeros in 100 kB are refused by what the header may say, or unpacked no further."""
    (tmp_path / "a").write_bytes(gzip.compress(header(9, 2, 0) + bytes(100 << 20), 9))
    scene_or_line(tmp_path / "a")
    assert "holds more than 9 Gaussians" in refusal(tmp_path / "a")
    (tmp_path / "b").write_bytes(gzip.compress(header(5 << 20, 2, 0) + bytes(100 << 20), 9))
    assert "made to fill the memory" in refusal(tmp_path / "b")
    scene_or_line(tmp_path / "b")


@pytest.mark.parametrize("version", VERSIONS)
@settings(quick, max_examples=120)
@given(data=st.data())
def test_damage_gives_a_scene_or_a_line(tmp_path, version, data):
    """Bits, numbers and pieces of the file changed, or of what is packed in it."""
    planes = random_planes(9, version, 1)
    inside = version < 4 and data.draw(st.booleans())
    if inside:
        stream = header(9, version, 1) + b"".join(planes)
        content = gzip.compress(data.draw(damaged(stream, 20)), 1)
    else:
        content = data.draw(damaged(packed(9, version, 1, planes), 120))
    (tmp_path / "a").write_bytes(content)
    scene_or_line(tmp_path / "a")
