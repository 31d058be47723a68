"""Writers: what they write is the scene, as decoders that are not tsplat's read it.

Tolerances are half a step of each format, and float32's rounding in the decoder: see writing.py.
"""

from __future__ import annotations

import gzip
import io
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.conftest import gaussians
from tests.io.realdata import needs_data
from tests.io.writing import FORMATS, READ, check, drawn, scenes
from tsplat import WriteOptions, load_scene, save_scene
from tsplat.core.errors import OutputError, ParamsError, PluginError
from tsplat.core.types import Up
from tsplat.io.spz import HEADER
from tsplat.io.write import base, compressed, ply, spz
from tsplat.io.write.gzip import Gzip
from tsplat.io.write.source import Source

try:
    import gsply  # noqa: F401

    HAVE = set(FORMATS)
except ImportError:
    HAVE = {"ply", "splat"}

quick = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


MISSING = pytest.mark.skip(reason="nothing else reads it: no gsply; pip install 'tsplat[test]'")
UNREAD = {fmt: MISSING for fmt in FORMATS if fmt not in HAVE}


def every(formats=FORMATS):
    """Each format; skipped where nothing independent reads it."""
    return pytest.mark.parametrize(
        "fmt", [pytest.param(fmt, marks=UNREAD.get(fmt, ())) for fmt in formats]
    )


def fraction_of(path):
    """Fractional bits of an SPZ file of versions 1 to 3."""
    return HEADER.unpack_from(gzip.decompress(path.read_bytes()))[4]


def round_trip(tmp_path, fmt, scene, options=None):
    """Writes ``scene`` and checks what another's decoder makes of the file."""
    path = tmp_path / f"a.{fmt}"
    written = save_scene(scene, path, options=options, force=True)
    told = {"fraction": fraction_of(path)} if fmt == "spz" else {}
    if options and fmt == "spz":
        told |= {"version": options.version or 3, "sh_bits": options.sh_bits or (5, 4)}
    if fmt == "splat":
        scene = gaussians(
            scene.means, scene.scales, scene.opacities, quats=scene.quats, sh=scene.sh[:, :1]
        )
    check(fmt, scene, READ[fmt](path), written, **told)
    return path


@every()
@quick
@given(scene=scenes)
def test_a_written_scene_is_read_by_other_decoders(tmp_path, fmt, scene):
    """Any scene, ends of ranges among it: each number is the nearest that the format has."""
    round_trip(tmp_path, fmt, scene)


@every(["spz"])
@quick
@given(
    scene=scenes,
    version=st.integers(2, 3),
    fraction=st.none() | st.integers(4, 12),
    bits=st.none() | st.tuples(st.integers(1, 8), st.integers(1, 8)),
)
def test_spz_is_written_as_asked_for(tmp_path, fmt, scene, version, fraction, bits):
    """Version, fractional bits and bits of harmonics are in the file."""
    options = WriteOptions(version, fraction, bits)
    path = round_trip(tmp_path, fmt, scene, options)
    assert fraction is None or fraction_of(path) == fraction
    if bits and scene.sh_degree:
        planes = gzip.decompress(path.read_bytes())[16:]
        first = np.frombuffer(planes[-len(scene) * 3 * (scene.sh.shape[1] - 1) :], np.uint8)
        values = first.reshape(len(scene), -1, 3)[:, :3].astype(int) - 128
        bucket = 1 << (8 - bits[0])
        assert np.all((values % bucket == 0) | (values == 127))


class Floors:
    """NumPy that cuts off what it should round."""

    rint = staticmethod(np.floor)

    def __getattr__(self, name):
        return getattr(np, name)


def _quats_rolled(patch):
    good = Source.quats
    patch.setattr(Source, "quats", lambda s, rows: np.roll(good(s, rows), 1, axis=1))


def _conjugated(patch):
    good = Source.quats
    patch.setattr(Source, "quats", lambda s, rows: good(s, rows) * np.float32([1, -1, -1, -1]))


def _y_flipped(patch):
    good = Source.means
    patch.setattr(Source, "means", lambda s, rows: good(s, rows) * np.float32([1, -1, 1]))


def _bands_swapped(patch):
    good = Source.sh

    def swapped(self, rows, first=0):
        sh = good(self, rows, 0)[:, [0, 1, 3, 2, *range(4, self.coefficients)]]
        return sh[:, first:]

    patch.setattr(Source, "sh", swapped)


def _channels_swapped(patch):
    good = Source.sh
    patch.setattr(Source, "sh", lambda s, rows, first=0: good(s, rows, first)[..., ::-1])


def _halves(patch):
    good = Source.scales
    patch.setattr(
        Source, "scales", lambda s, rows: good(s, rows).astype(np.float16).astype(np.float32)
    )


def _cut_off(patch):
    for module in ("compressed", "splat", "spz"):
        patch.setattr(f"tsplat.io.write.{module}.np", Floors())


def _coefficient_major(patch):
    def put(rows, sh):
        rows["dc"] = sh[:, 0]
        rows["rest"] = sh[:, 1:].reshape(len(sh), -1)

    patch.setattr(ply, "_put_sh", put)
    patch.setattr(
        compressed, "_rest",
        lambda sh, clipped: np.clip((sh + 4) * 32, 0, 255).astype(np.uint8).reshape(len(sh), -1),
    )  # fmt: skip


def _not_turned(patch):
    patch.setattr(spz, "DEFAULT", "RDF")


def _colours_as_harmonics(patch):
    """SPZ's colours with SH_C0 instead of its own 0.15."""
    good = Source.sh

    def scaled(self, rows, first=0):
        sh = good(self, rows, first).copy()
        if not first:
            sh[:, 0] *= 0.28209479 / 0.15
        return sh

    patch.setattr(Source, "sh", scaled)


def _largest_last(patch):
    def wrong(quats, order):
        return base.smallest_three(quats, order[::-1])

    patch.setattr(compressed, "smallest_three", wrong)
    patch.setattr(spz, "smallest_three", wrong)


BENDS = {
    _quats_rolled: FORMATS,
    _conjugated: FORMATS,
    _y_flipped: FORMATS,
    _channels_swapped: FORMATS,
    _bands_swapped: ("ply", "compressed.ply", "spz"),
    _halves: ("ply", "splat"),
    _cut_off: ("compressed.ply", "splat", "spz"),
    _coefficient_major: ("ply", "compressed.ply"),
    _not_turned: ("spz",),
    _colours_as_harmonics: FORMATS,
    _largest_last: ("compressed.ply", "spz"),
}
"""Faults of writers, and the formats that have the thing which is wrong."""


@pytest.mark.parametrize(
    ("fmt", "bend"),
    [
        pytest.param(fmt, bend, id=f"{fmt}-{bend.__name__[1:]}", marks=UNREAD.get(fmt, ()))
        for bend, formats in BENDS.items()
        for fmt in formats
    ],
)
def test_wrong_writers_are_caught(tmp_path, monkeypatch, fmt, bend):
    """Each thing that writers get wrong makes the check fail."""
    scene = drawn(300, 3, 7, wild=0.0)
    round_trip(tmp_path, fmt, scene)
    bend(monkeypatch)
    with pytest.raises(AssertionError):
        round_trip(tmp_path, fmt, scene)


@pytest.mark.parametrize(
    ("fmt", "version"), [*((fmt, None) for fmt in FORMATS), ("spz", 2), ("spz", 4)]
)
def test_readers_of_tsplat_read_what_it_writes(tmp_path, fmt, version):
    """Fields come back within steps, rows where the writer says they are; SPZ in all versions."""
    from tsplat.quality.converted import field_errors

    scene = drawn(700, 3, 3, wild=0.0)
    path = tmp_path / f"a.{fmt}"
    written = save_scene(scene, path, options=WriteOptions(version))
    back = load_scene(path, sh_float32=True)
    about = {"ply": "ply", "splat": ".splat", "compressed.ply": "compressed PLY", "spz": "spz"}
    assert back.source.startswith(about[fmt])
    errors = {e.field: e for e in field_errors(Source(scene), written.order, Source(back))}
    assert ("harmonics" in errors) == (fmt != "splat")
    limit = {
        "ply": (0, 1e-5, 1e-5, 1e-7), "compressed.ply": (0.02, 0.01, 0.25, 2e-3),
        "splat": (0, 1e-5, 0.95, 2e-3), "spz": (3e-4, 0.032, 11 if version == 2 else 0.25, 2e-3),
    }[fmt]  # fmt: skip
    for name, most in zip(("position", "scale", "rotation", "opacity"), limit, strict=True):
        assert errors[name].worst <= most, errors[name]
    backwards = np.arange(len(scene))[::-1]
    wrong = {e.field: e for e in field_errors(Source(scene), backwards, Source(back))}
    assert wrong["position"].worst > 1, "rows that do not belong together are not like"


def test_rows_go_back_to_the_order_of_the_file_they_came_from(tmp_path):
    """A scene of many rows is in another order in memory, and in the first one in a file again."""
    scene = drawn(20_000, 0, 1, wild=0.0)
    save_scene(scene, tmp_path / "a.ply")
    back = load_scene(tmp_path / "a.ply")
    assert back.numbers is not None
    assert not np.array_equal(back.means, scene.means)
    for fmt in ("ply", "splat"):
        save_scene(back, tmp_path / f"b.{fmt}")
        assert np.array_equal(READ[fmt](tmp_path / f"b.{fmt}").means, scene.means)


def test_chunks_of_compressed_ply_are_small_in_space(tmp_path):
    """Shuffled rows come into compact chunks, and strays do not spoil the others' ranges."""
    rng = np.random.default_rng(0)
    means = rng.uniform(-1, 1, (40_000, 3)).astype(np.float32)
    means[rng.integers(0, 40_000, 40)] *= 1e4
    scene = gaussians(means)
    written = save_scene(scene, tmp_path / "a.compressed.ply")
    back = load_scene(tmp_path / "a.compressed.ply")
    off = np.abs(back.means[np.argsort(back.numbers)] - means[written.order]).max(1)
    # 157 chunks of a cube of 2: ranges of 2 / 157^(1/3) = 0.37 where they are cubes themselves
    assert np.quantile(off, 0.5) < 0.37 / 1023 / 2
    assert np.quantile(off, 0.98) < 1.2 * 0.37 / 1023 / 2


def test_scenes_far_from_zero_keep_their_detail_or_are_refused(tmp_path):
    """1e6 units out: PLY has doubles, chunks are as exact as near zero, .splat and SPZ say no."""
    near = drawn(300, 0, 5, spread=1.0, wild=0.0)
    far = gaussians(near.means, 1e-3, near.opacities, quats=near.quats, sh=near.sh)
    object.__setattr__(far, "origin", np.array([1e7, -2e7, 3e6]))
    save_scene(far, tmp_path / "a.ply")
    wanted = far.means + far.origin
    assert np.array_equal(READ["ply"](tmp_path / "a.ply").means, wanted)
    written = save_scene(far, tmp_path / "a.compressed.ply")
    back = load_scene(tmp_path / "a.compressed.ply")
    off = back.means.astype(np.float64) + back.origin - wanted[written.order]
    assert np.abs(off).max() < 10 / 1023
    for fmt in ("splat", "spz"):
        with pytest.raises(OutputError, match=r"from zero|24 bits"):
            save_scene(far, tmp_path / f"a.{fmt}")
        assert not (tmp_path / f"a.{fmt}").exists()


@pytest.mark.parametrize(
    ("reach", "size", "bits"), [(10, 0.1, 12), (3000, 0.1, 11), (10, 1e-3, 15), (10, 1e-9, 19)]
)
def test_fractional_bits_fit_the_range_and_the_gaussians(tmp_path, reach, size, bits):
    """12 as Niantic's library, fewer where the range is wide, more for small Gaussians."""
    scene = gaussians([[reach, 0, 0], [0, -reach, 0]], size)
    written = save_scene(scene, tmp_path / "a.spz")
    assert fraction_of(tmp_path / "a.spz") == bits
    assert any("fractional bits instead" in note for note in written.notes) == (bits < 12)
    with pytest.raises(OutputError, match="do not fit into 24 bits"):
        save_scene(scene, tmp_path / "b.spz", options=WriteOptions(fractional_bits=23))


@pytest.mark.parametrize("smooth", [True, False])
def test_antialiasing_and_up_are_kept_where_the_format_says_them(tmp_path, smooth):
    """A PLY header's comments and SPZ's flag come back; what a format cannot say is noted."""
    scene = drawn(3, 0, 0)
    object.__setattr__(scene, "antialias", smooth)
    object.__setattr__(scene, "up", Up((0.0, 0.125, -1.0), "told so"))
    for fmt in FORMATS:
        written = save_scene(scene, tmp_path / f"a.{fmt}")
        back = load_scene(tmp_path / f"a.{fmt}")
        assert back.antialias is (None if fmt == "splat" else smooth)
        said = {"splat": None, "spz": (0.0, -1.0, 0.0)}.get(fmt, (0.0, 0.125, -1.0))
        assert (back.up and back.up.direction) == said
        assert any("antialiasing" in note for note in written.notes) == (fmt == "splat")
        assert any("told so" in note for note in written.notes) == (fmt in ("splat", "spz"))
    object.__setattr__(scene, "up", Up((0.0, -2.0, 0.0), "told so"))
    notes = save_scene(scene, tmp_path / "a.spz", force=True).notes
    assert not any("told so" in note for note in notes), "that is what SPZ's axes say"


def test_what_is_clipped_is_counted(tmp_path):
    """Notes name how many numbers were beyond the range, and by how much."""
    sh = np.zeros((4, 4, 3), np.float32)
    sh[0, 0, 0], sh[1, 1, 1] = 9, -5
    scene = gaussians(np.zeros((4, 3)), [1, 1e-9, 1], sh=sh)
    spz_notes = " ".join(save_scene(scene, tmp_path / "a.spz").notes)
    assert "1 base coefficients are beyond 3.33" in spz_notes
    assert "1 coefficients are beyond 1 and clipped (by 4 at most)" in spz_notes
    assert "4 scales are below e^-10" in spz_notes
    assert "1 coefficients are beyond 4" in " ".join(
        save_scene(scene, tmp_path / "a.compressed.ply").notes
    )
    splat = " ".join(save_scene(scene, tmp_path / "a.splat").notes)
    assert "1 base colours are outside 0..1" in splat
    assert "degree 1 to 1 are left out" in splat
    assert save_scene(scene, tmp_path / "a.ply").notes == ()


def test_what_cannot_be_asked_for_is_refused(tmp_path):
    """Names, options and degrees that a format has not: one line, and no file."""
    scene = drawn(3, 1, 0)
    for name, options, error, text in (
        ("a.obj", {}, OutputError, "known: .compressed.ply, .ply, .splat, .spz"),
        ("a.ply", {"to": "usd"}, PluginError, "no writer named 'usd'; installed: compressed-ply"),
        (
            "a.ply",
            {"options": WriteOptions(version=2)},
            ParamsError,
            "version .* is not for ply",
        ),
        ("a.splat", {"sh_degree": 1}, ParamsError, "splat holds harmonics up to degree 0, got 1"),
        ("a.spz", {"options": WriteOptions(version=7)}, ParamsError, "versions 2, 3 and 4, got 7"),
        ("no/a.ply", {}, OutputError, "no directory"),
        (".", {}, OutputError, "is a directory; name a file in it"),
    ):
        with pytest.raises(error, match=text):
            save_scene(scene, tmp_path / name, **options)
    with pytest.raises(OutputError, match="not written to standard output; name a file"):
        save_scene(scene, "-", to="ply")
    with pytest.raises(OutputError, match="no Gaussians are left"):
        save_scene(scene.take(np.zeros(0, int)), tmp_path / "a.ply")
    with pytest.raises(ParamsError, match=r"\(--fractional-bits\): expected 0 to 23"):
        WriteOptions(fractional_bits=24)
    with pytest.raises(ParamsError, match="sh_bits"):
        WriteOptions(sh_bits=(5, 9))
    assert list(tmp_path.iterdir()) == []


def test_a_fault_leaves_what_was_there(tmp_path, monkeypatch):
    """An error or Ctrl-C in the middle: the old file is whole, and nothing lies beside it."""
    path = tmp_path / "a.ply"
    path.write_bytes(b"old")
    scene = drawn(3, 0, 0)
    with pytest.raises(OutputError, match="exists; choose another name, or --force"):
        save_scene(scene, path)

    def interrupted(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_scene(scene, path, options=WriteOptions(progress=interrupted), force=True)

    def full(source, out, options):
        out.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ply, "write", full)
    with pytest.raises(OutputError, match=r"a\.ply: cannot be written: No space left"):
        save_scene(scene, path, force=True)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@given(
    sizes=st.lists(st.integers(0, 700), max_size=12),
    piece=st.sampled_from([1, 7, 64, 500]),
    level=st.integers(1, 9),
)
def test_gzip_in_pieces_is_one_stream(sizes, piece, level):
    """Python's gzip and a single inflate read it, checksum and size included, however it is cut."""
    rng = np.random.default_rng(sum(sizes))
    parts = [rng.integers(0, 5, n, np.uint8).tobytes() for n in sizes]
    out = io.BytesIO()
    with Gzip(out, level, piece) as stream:
        for part in parts:
            stream.write(part)
    assert gzip.decompress(out.getvalue()) == b"".join(parts)
    single = zlib.decompressobj(wbits=31)
    assert single.decompress(out.getvalue()) == b"".join(parts)
    assert single.eof
    assert not single.unused_data


def test_pieces_compress_as_well_as_one(tmp_path):
    """Dictionaries of what went before: the size is within a part in 200 of a single stream's."""
    rng = np.random.default_rng(0)
    content = np.repeat(rng.integers(0, 50, 300_000, np.uint8), 4).tobytes()
    out = io.BytesIO()
    with Gzip(out, 6, 1 << 17) as stream:
        stream.write(content)
    assert len(out.getvalue()) < 1.005 * len(gzip.compress(content, 6))


@needs_data
@pytest.mark.parametrize("fmt", FORMATS)
def test_real_scenes_go_through_every_format(tmp_path, data, fmt):
    """A capture of degree 3: read back, its typical errors are a fraction of a step."""
    from tsplat.quality.converted import field_errors

    scene = load_scene(data / "formats" / "leica-8k-sh3" / "leica-8k-sh3.gf.ply", sh_float32=True)
    written = save_scene(scene, tmp_path / f"a.{fmt}")
    back = load_scene(tmp_path / f"a.{fmt}", sh_float32=True)
    rms = {e.field: e.rms for e in field_errors(Source(scene), written.order, Source(back))}
    most = {
        "ply": {"position": 0, "scale": 1e-6, "rotation": 1e-5, "opacity": 1e-7, "harmonics": 0},
        "compressed.ply": {"position": 1.7e-3, "rotation": 0.1, "harmonics": 0.01},
        "splat": {"position": 0, "rotation": 0.5, "opacity": 0.0012},
        "spz": {"position": 1.3e-4, "rotation": 0.1, "opacity": 0.0012, "harmonics": 0.032},
    }[fmt]
    assert {name: rms[name] for name in most if rms[name] > most[name]} == {}
