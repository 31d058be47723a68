""".splat, .ksplat and compressed PLY: what is written comes back within the format's steps.

Compared with the arrays the files were written of. Each bound is derived from the format where it
stands; none is measured. The last digit of float32 is allowed for besides (``ULP``). Not compared
here: files by other people's tools (test_real), damage (test_packed_faults).
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.io import gltfwriter, sogwriter, spzwriter
from tests.io.loading import in_file_order
from tests.io.splatwriter import C0, drawn, write_compressed, write_ksplat, write_splat
from tsplat.core.errors import SceneError
from tsplat.io import curve, load_scene, native, sweeps, unpack
from tsplat.io.base import sample_rows

ULP = 2.0**-23
BYTE = 1 / 255  # a step of an opacity, and of a colour
HALF = 2.0**-11  # float16 rounds by this share of a number at most, where it is above 2^-14
TINY = 2.0**-25  # and by this below

FUNCTION = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]


@pytest.fixture
def small(monkeypatch):
    """Chunks of 70 rows, pieces of 210; from 300 rows on they come along the curve."""
    monkeypatch.setattr(sweeps, "CHUNK", 70)
    monkeypatch.setattr(sweeps, "PIECE", 210)
    monkeypatch.setattr(curve, "ROWS_MIN", 300)


def within(found, wanted, below, above=None):
    """``found`` is at most ``below`` smaller and ``above`` (else ``below``) larger."""
    wanted = np.asarray(wanted)
    slack = ULP * (1 + np.abs(wanted))
    off = found - wanted
    assert (off >= -below - slack).all(), (off.min(), below)
    assert (off <= (below if above is None else above) + slack).all(), (off.max(), above)


def turned(found, wanted, error):
    """Unit quaternions whose numbers were off by a vector of this length before they were unit.

    The sine of the angle between them is that length at most.
    """
    sign = np.sign((found * wanted).sum(1))[:, None]
    chord = 2 * np.sin(np.arcsin(error) / 2)
    assert (np.linalg.norm(found * sign - wanted, axis=1) <= chord + 4 * ULP).all()
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=4 * ULP)


def cut_off_bytes(scene, g):
    """Opacity and colour are cut off to 255ths; colours beyond 0..1 are held."""
    within(scene.opacities, g.opacities, BYTE, 0)
    color = np.clip(0.5 + C0 * g.sh[:, 0], 0, 1)
    within(scene.sh[:, 0], (color - 0.5) / C0, BYTE / C0, 0)


def loaded(path, **options):
    return in_file_order(load_scene(path, sh_float32=True, **options))


@settings(max_examples=40, suppress_health_check=FUNCTION)
@given(n=st.integers(1, 700), seed=st.integers(0, 99), size=st.sampled_from([1e-3, 1.0, 1e5]))
def test_splat(tmp_path, small, n, seed, size):
    """Positions and scales are float32; colours and quaternions are cut off to bytes."""
    g = drawn(n, seed=seed, size=size)
    path = tmp_path / "a.splat"
    write_splat(path, g)
    scene = loaded(path)
    assert (len(scene), scene.sh_degree, scene.source) == (n, 0, ".splat")
    np.testing.assert_array_equal(scene.means, g.means.astype(np.float32))
    np.testing.assert_array_equal(scene.scales, g.scales.astype(np.float32))
    cut_off_bytes(scene, g)
    turned(scene.quats, g.quats, 2 / 128)  # four numbers, each cut off by a step of 1/128 at most


@settings(max_examples=60, suppress_health_check=FUNCTION)
@given(data=st.data())
def test_ksplat(tmp_path, small, data):
    """Any level, degrees and numbers of sections, buckets of any size, room to spare."""
    level = data.draw(st.integers(0, 2), label="level")
    counts = data.draw(st.lists(st.integers(1, 400), min_size=1, max_size=3), label="counts")
    degrees = [data.draw(st.integers(0, 2)) for _ in counts]
    seed = data.draw(st.integers(0, 99))
    block, sh_range = 4.0, (-0.25, 0.75)
    parts = [drawn(c, 2, seed + i, data.draw(st.sampled_from([0.1, 9.0])))
             for i, c in enumerate(counts)]  # fmt: skip
    path = tmp_path / "a.ksplat"
    order = write_ksplat(
        path, list(zip(parts, degrees, strict=True)), level, block=block,
        bucket=data.draw(st.sampled_from([1, 16, 256])), sh_range=sh_range,
        spare=data.draw(st.integers(0, 3)),
    )  # fmt: skip
    scene = loaded(path)
    degree = max(degrees)
    assert (len(scene), scene.sh_degree) == (sum(counts), degree)
    assert scene.source == f"ksplat level {level}, SH {degree}"
    for part, own in zip(parts, degrees, strict=True):
        part.sh[:, (own + 1) ** 2 :] = 0
    g = drawn(0, 2)
    for name in vars(g):
        setattr(g, name, np.concatenate([getattr(part, name) for part in parts])[order])
    cut_off_bytes(scene, g)
    rest = g.sh[:, 1 : scene.sh.shape[1]]
    known = np.repeat(degrees, counts)[order][:, None, None]
    known = np.arange(1, scene.sh.shape[1])[:, None] < (known + 1) ** 2
    if level == 0:
        np.testing.assert_array_equal(scene.means, g.means.astype(np.float32))
        np.testing.assert_array_equal(scene.scales, g.scales.astype(np.float32))
        np.testing.assert_array_equal(scene.sh[:, 1:], rest.astype(np.float32))
        turned(scene.quats, g.quats, 2 * ULP)
        return
    # half a step, and the bucket's centre is float32
    within(scene.means, g.means, block / 2 / 32767 / 2 + ULP * np.abs(g.means).max())
    within(scene.scales, g.scales, HALF * g.scales + TINY)
    turned(scene.quats, g.quats, HALF)
    if level == 1:
        within(scene.sh[:, 1:], rest, HALF * np.abs(rest) + TINY)
    else:
        low, high = sh_range
        step = np.where(known, (high - low) / 255, 0)
        within(scene.sh[:, 1:], np.where(known, np.clip(rest, low, high), 0), step, 0)


@settings(max_examples=60, suppress_health_check=FUNCTION)
@given(
    n=st.integers(1, 700), degree=st.integers(0, 3), seed=st.integers(0, 99),
    size=st.sampled_from([1e-3, 1.0, 1e5]), colors=st.booleans(), big=st.booleans(),
    comments=st.sampled_from([0, 3, 400]),
    order=st.permutations(["chunk", "vertex", "sh"]),
)  # fmt: skip
def test_compressed_ply(tmp_path, small, n, degree, seed, size, colors, big, comments, order):
    """With and without colours by chunk; elements and bytes in any order; any length of header."""
    g = drawn(n, degree, seed, size)
    path = tmp_path / "a.ply"
    write_compressed(path, g, colors=colors, comments=comments, order=tuple(order), big=big)
    scene = loaded(path)
    assert (len(scene), scene.sh_degree) == (n, degree)
    assert scene.source == f"compressed PLY, {-(-n // 256)} chunks, SH {degree}"

    def half_steps(values, steps):
        """[n, 3] half a step of each chunk's range, whose ends are float32."""
        chunks = [values[i : i + 256] for i in range(0, n, 256)]
        spans = [np.ptp(c, axis=0) / steps / 2 + ULP * np.abs(c).max(0) for c in chunks]
        return np.repeat(spans, 256, axis=0)[:n]

    steps = np.array([2047, 1023, 2047])
    within(scene.means + scene.origin, g.means, half_steps(g.means, steps))
    logs = np.log(g.scales)
    within(np.log(scene.scales.astype(float)), logs, half_steps(logs, steps) + ULP)
    within(scene.opacities, g.opacities, BYTE / 2)
    color = 0.5 + C0 * g.sh[:, 0]
    if colors:
        within(scene.sh[:, 0] * C0 + 0.5, color, half_steps(color, 255))
    else:
        within(scene.sh[:, 0] * C0 + 0.5, np.clip(color, 0, 1), BYTE / 2)
    # Half a step each of the three smaller numbers s. The largest, m >= 1/2, is off by |s| / m
    # times the length of that, and |s| <= sqrt(3)/2: sqrt(1 + 3) times it in all. Beyond the first
    # order it is less than a hundredth more.
    turned(scene.quats, g.quats, 2 * np.sqrt(3) * np.sqrt(2) / 1023 / 2 * 1.01)
    within(scene.sh[:, 1:], g.sh[:, 1:], 1 / 64)  # half of 8 / 256


def test_harmonics_of_compressed_ply_at_their_ends(tmp_path):
    """Byte 0 is -4 and 255 is 4, others the middle of their step: of 256, all are told apart."""
    g = drawn(256, 1)
    g.sh[:, 1, 0] = np.linspace(-4, 4, 256, endpoint=False) + 1 / 64
    write_compressed(tmp_path / "a.ply", g)
    wanted = (np.arange(256) + 0.5) / 32 - 4
    wanted[[0, 255]] = -4, 4
    np.testing.assert_array_equal(loaded(tmp_path / "a.ply").sh[:, 1, 0], wanted)


def test_smaller_numbers_of_a_quaternion_that_are_too_large(tmp_path):
    """Three numbers of sqrt(1/2), whose squares sum to 1.5, still give a unit quaternion."""
    g = drawn(1)
    path = tmp_path / "a.ply"
    write_compressed(path, g)
    content = path.read_bytes()
    path.write_bytes(content[:-12] + b"\xff\xff\xff\x3f" + content[-8:])
    np.testing.assert_allclose(loaded(path).quats[0], [0, *[3**-0.5] * 3], atol=1e-6)


def write_gltf(path, g, **node):
    """A glTF of as many Gaussians as ``g`` has, others, in a node that may turn and move them."""
    builder = gltfwriter.Builder()
    builder.node(builder.primitive(gltfwriter.random_arrays(len(g.means), 2)), **node)
    path.write_bytes(builder.glb())


def write_sog(path, g):
    """A SOG of as many."""
    path.write_bytes(sogwriter.bundle(*sogwriter.random_scene(len(g.means), 2)[:2]))


def write_spz(path, g, version=3):
    """An SPZ of as many."""
    n = len(g.means)
    planes = spzwriter.random_planes(n, version, 2)
    path.write_bytes(spzwriter.packed(n, version, 2, planes))


def write_turned(path, g):
    """A glTF whose colours are turned as well, and whose positions are float64."""
    write_gltf(path, g, rotation=[0.6, 0, 0, 0.8], translation=[1, 2, 3], scale=[2, 2, 2])


FORMATS = {
    "splat": write_splat,
    "ksplat 0": lambda path, g: write_ksplat(path, [(g, 2)], 0),
    "ksplat 1": lambda path, g: write_ksplat(path, [(g, 2)], 1, bucket=16),
    "ksplat 2": lambda path, g: write_ksplat(path, [(g, 1), (g, 2)], 2, bucket=16),
    "compressed": write_compressed,
}
OTHERS = {
    "spz 2": lambda path, g: write_spz(path, g, 2),
    "spz 3": write_spz,
    "sog": write_sog,
    "gltf": write_gltf,
    "gltf, turned": write_turned,
}


@pytest.fixture(params=FORMATS)
def file(request, tmp_path):
    """A file of 500 Gaussians, or twice as many, in each format."""
    path = tmp_path / "scene"
    FORMATS[request.param](path, drawn(500, 2))
    return path


@pytest.fixture(params=FORMATS | OTHERS)
def any_file(request, tmp_path):
    """The same, in other formats, too, whose numbers are any."""
    path = tmp_path / "scene"
    (FORMATS | OTHERS)[request.param](path, drawn(500, 2))
    return path


def assert_same(a, b):
    for name in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)


def test_a_sample_is_of_the_rows_that_it_is_of_in_ply(any_file, small):
    """max_splats picks rows of the file as base.sample_rows says, and counts the others."""
    whole, some = loaded(any_file), loaded(any_file, max_splats=320)
    assert_same(some, whole.take(sample_rows(len(whole), 320)))
    assert dict(some.dropped) == {"beyond max_splats": len(whole) - 320}
    few = loaded(any_file, max_splats=7)
    assert_same(few, whole.take(sample_rows(len(whole), 7)))


@pytest.mark.parametrize("compiled", [True, False])
def test_a_sample_may_leave_whole_chunks_out(any_file, small, monkeypatch, compiled):
    """One row of all, of which most chunks have none; so does the last of a few."""
    whole = loaded(any_file)
    if not compiled:
        monkeypatch.setattr(native, "lib", None)
        monkeypatch.setattr(unpack, "lib", None)
    for keep in (1, 2, 5):
        some = loaded(any_file, max_splats=keep)
        assert_same(some, whole.take(sample_rows(len(whole), keep)))


def test_rows_lie_along_the_curve(any_file, small):
    """They are moved where they are many, with numbers that say where they were."""
    scene = load_scene(any_file)
    assert (np.diff(scene.numbers) < 0).any()
    np.testing.assert_array_equal(np.sort(scene.numbers), np.arange(len(scene)))
    np.testing.assert_array_equal(curve.rows_along_curve(scene.means), np.arange(len(scene)))


def test_c_and_numpy_agree(any_file, small, monkeypatch):
    """Without a compiler the arrays have the same bits, in float16 as in float32."""
    with_c = [load_scene(any_file), load_scene(any_file, sh_float32=True)]
    assert native.lib is not None
    monkeypatch.setattr(native, "lib", None)
    monkeypatch.setattr(unpack, "lib", None)
    for mine, wide in zip(with_c, (False, True), strict=True):
        assert_same(mine, load_scene(any_file, sh_float32=wide))


def test_colours_are_kept_in_float16_where_that_will_do(file):
    """As in PLY: unless it is asked for, float32 is not kept; the error is bounded."""
    scene, exact = load_scene(file), load_scene(file, sh_float32=True)
    assert (scene.sh.dtype, exact.sh.dtype) == (np.float16, np.float32)
    assert 0 < scene.sh_error < 0.25 / 255
    assert exact.sh_error == 0


def test_raw_opacity_has_no_meaning(file):
    """It is refused in a line that says so: these opacities are never logits."""
    with pytest.raises(SceneError, match=r"are always 0\.\.1; leave out raw_opacity"):
        load_scene(file, raw_opacity=True)


def test_progress_goes_from_nothing_to_all(file, small):
    """It never goes back, within each of the goals it is given."""
    calls = []
    scene = load_scene(file, progress=lambda *call: calls.append(call))
    done, goals = zip(*calls, strict=True)
    assert set(goals) == {2 * len(scene)}
    assert done[0] == 0
    assert done[-1] == goals[-1]
    assert list(done) == sorted(done)


@pytest.mark.parametrize("level", [1, 2])
def test_ksplat_far_from_zero_keeps_its_steps(tmp_path, level):
    """At 4e6, where float32 has steps of 1/4, positions keep those of the file, by an origin."""
    g = drawn(300, size=1.0)
    g.scales[:] = 1e-3
    g.means += [4e6, -4e6, 0]
    centre = np.float32([4e6, -4e6, 0])
    path = tmp_path / "a.ksplat"
    order = write_ksplat(path, [(g, 0)], level, block=64.0, bucket=1000)
    content = bytearray(path.read_bytes())
    low = g.means.min(0)
    assert np.frombuffer(content, "<f4", 3, 4096 + 1024 + 4) == pytest.approx(low + 32, abs=0.5)
    scene = loaded(path)
    assert np.abs(scene.origin - centre).max() < 9
    step = 32 / 32767
    within(scene.means + scene.origin, g.means[order], step / 2 + 0.25)  # the centre is float32
    found = np.sort((scene.means[:, 0] + scene.origin[0] - scene.means[0, 0]) / step)
    spread = np.diff(found)[np.diff(found) > 1e-3]
    assert spread.min() < 1.5  # in float32 alone the least would be 1/4 / step = 256


def test_compressed_ply_far_from_zero_keeps_its_steps(tmp_path):
    """Likewise: 256 positions along an axis within 1 unit at 4e6 are not four or five."""
    g = drawn(256)
    g.scales[:] = 1e-3
    g.means[:, 0] = 4e6 + np.linspace(0, 1, 256)
    path = tmp_path / "a.ply"
    write_compressed(path, g)
    scene = loaded(path)
    assert scene.origin[0] > 3.9e6
    assert len(np.unique(scene.means[:, 0])) == 256
    write_compressed(path, drawn(300))
    assert not loaded(path).origin.any()


def test_a_ksplat_that_counts_nothing_in_its_header(tmp_path):
    """Writers that leave the totals out are read by their sections; a wrong total is refused."""
    path = tmp_path / "a.ksplat"
    write_ksplat(path, [(drawn(9), 0)], 0)
    content = bytearray(path.read_bytes())
    content[8:20] = bytes(12)
    path.write_bytes(content)
    assert len(load_scene(path)) == 9
    content[16] = 8
    path.write_bytes(content)
    with pytest.raises(SceneError, match="byte 16: 8 Gaussians, but its sections have 9"):
        load_scene(path)


def test_the_range_of_harmonics_that_a_header_leaves_out(tmp_path):
    """Zeros mean -1.5 to 1.5."""
    path = tmp_path / "a.ksplat"
    write_ksplat(path, [(drawn(9, 1), 1)], 2)
    content = bytearray(path.read_bytes())
    said = loaded(path)
    content[36:44] = bytes(8)
    path.write_bytes(content)
    assert_same(loaded(path), said)
