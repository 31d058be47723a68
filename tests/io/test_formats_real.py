"""SPZ, SOG and glTF by other people's tools, against what independent parsers found in them.

Compared: counts, degree, bounds and three Gaussians per file, in the file's own axes; then each
picture with that of the PLY that the file was made of. Skipped where the files are absent.

Both parsers read the same quantised numbers, so samples agree to the seven digits that the manifest
has: the formats' own steps do not enter. What a format lost of its PLY shows in the pictures.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tsplat
from tests.io.loading import in_file_order, refusal, scene_or_line
from tests.io.mutate import damaged
from tests.io.realdata import DATA, manifest, needs_data
from tests.io.spzwriter import HAVE_ZSTD, NO_ZSTD
from tsplat.core.errors import SceneError
from tsplat.io import load_scene
from tsplat.io.turn import Turn, axes, half_turned

# every file of these formats there that is refused, and why; what is not here must load
REFUSED = {
    r"bad-crc": "its gzip stream cannot be unpacked near byte 53: .*incorrect data check",
    r"bad-fhcrc|corrupt-deflate|gzip-not|truncated-gzip-h": "damaged: named .spz, but it begins n",
    r"count-exceeds-stream": "promises 1000000 Gaussians, a file of 55 bytes holds at most 262254",
    r"degree-?4": r"SPZ of SH degree 4 \(byte 12\), expected 0 to 3",
    r"empty-points": r"holds no Gaussians \(SPZ header's number of points \(byte 8\) is 0\)",
    r"not-spz|not-sog|plant\.meta": "unknown format",
    r"plaintext-v4": "truncated: the table of its streams ends at byte 128, the file at 96",
    r"sh-degree-5": r"SH degree \(byte 12\) is 5, expected 0 to 3",
    r"truncated-deflate": "truncated: SPZ of 3 Gaussians needs 57 bytes, its gzip stream has 29",
    r"version-0": r"SPZ version 0 \(byte 4\), expected 1 to 4",
    r"version-5": r"SPZ version 5 \(byte 4\), expected 1 to 4",
    r"bad-bands": "shN.bands: expected a whole number, 1 to 3, got 4",
    r"huge-bands": r"shN.bands: expected a whole number, 1 to 3, got 1e\+300",
    r"bad-quat-tag": r"none of its Gaussians can be drawn \(quaternion of length zero: 1\)",
    r"corrupt-plane": "scales.webp: 16384x16384 pixels, expected at most 65538",
    r"count-exceeds-plane": "means_l.webp: 1x1 pixels, expected 4096 or more",
    r"device-plane": "names NUL.webp, which is not in the archive",
    r"missing-plane": "names scales.webp, which is not in the archive",
    r"empty-count": r"holds no Gaussians \(meta.json: count is 0\)",
    r"huge-count": r"count: expected a whole number, 0 or more, got 1e\+300",
    r"huge-version|version-3\.sog": r"version: expected (a whole number|2)",
    r"version-1\.sog": "scales.mins is missing",
    r"malformed-meta": "meta.json: JSON that cannot be read: Unterminated string",
    r"labels-out": r"shN.files\[1\]: a label is 1, the palette has 1 entries",
    r"lod-meta": "a list of levels of detail, not a scene",
    # their images are not here
    r"playbot/._0/meta|sog_unbundled/meta|unbundled-kit": "means_l.webp, which is not in the fold",
}
FILES = {
    path: entry
    for path, entry in manifest().items()
    if re.search(r"\.(spz|sog|glb|gltf|json)$", path) and not re.search(r"cameras\.json$", path)
}


def reason(path):
    return next((why for which, why in REFUSED.items() if re.search(which, path)), None)


def zstd(path):
    """Skips version 4 where zstd is not installed."""
    if not HAVE_ZSTD and (DATA / path).read_bytes()[:5] == b"NGSP\4":
        pytest.skip(NO_ZSTD)


READ = sorted(path for path in FILES if reason(path) is None)
NOT_READ = sorted(path for path in FILES if reason(path) is not None)


@needs_data
def test_there_are_files_of_both_kinds():
    """Of each format some are read; neither test below is empty."""
    for suffix, least in (("spz", 20), ("sog", 8), ("glb", 2), ("gltf", 1)):
        assert sum(path.endswith(f".{suffix}") for path in READ) >= least
    assert len(NOT_READ) >= 30


def in_file_axes(scene, path):
    """The numbers as the file has them: turned back."""
    turn = Turn(axes({"spz": "RUB", "glb": "LUF"}.get(path.rsplit(".")[-1], "RDF")))
    return turn.means(scene.means), turn.quats(scene.quats), turn.sh(scene.sh)


@needs_data
@pytest.mark.parametrize("path", READ)
def test_values_are_those_other_parsers_found(path):
    """Count, degree, bounds, and position, scale, rotation, opacity, colour of three Gaussians."""
    zstd(path)
    entry = FILES[path]
    scene = load_scene(DATA / path, sh_float32=True)
    assert not scene.dropped
    if "bevy" in path:  # the parser read the first of 15 primitives, and scales as they stand
        assert (len(scene), scene.sh_degree) == (15, 3)
        if "samples" not in entry:
            entry = FILES[path.replace(".gltf", ".glb")]
        (sample,) = entry["samples"]
        assert scene.means[0].tolist() == [-1, -2, 3]
        np.testing.assert_allclose(scene.scales[0], np.exp(sample["scale_linear"]), rtol=1e-6)
        assert scene.opacities[0] == sample["opacity"]
        np.testing.assert_allclose(scene.sh[0, 0], sample["f_dc"], rtol=1e-6)
        return
    assert (len(scene), scene.sh_degree) == (entry["splats"], entry["sh_degree"])
    scene = in_file_order(scene)
    means, quats, sh = in_file_axes(scene, path)
    near = {"rtol": 1e-5, "atol": 1e-6}
    np.testing.assert_allclose(means.min(0), entry["bbox_min"], rtol=1e-5, atol=3e-6)
    np.testing.assert_allclose(means.max(0), entry["bbox_max"], rtol=1e-5, atol=3e-6)
    if path.endswith("spz"):
        header = entry.get("spz_header", {})
        assert scene.antialias is bool(header.get("aa", 0))
        assert scene.source.startswith(f"spz {header.get('version', 2)}, SH {scene.sh_degree}")
    for sample in entry["samples"]:
        row = sample["index"]
        np.testing.assert_allclose(means[row], sample["position"], rtol=1e-5, atol=3e-6)
        np.testing.assert_allclose(scene.scales[row], sample["scale_linear"], **near)
        wanted = np.array(sample["quat_wxyz"])
        wanted *= np.sign(wanted @ quats[row])  # a rotation has two quaternions
        np.testing.assert_allclose(quats[row], wanted, atol=1e-5)
        np.testing.assert_allclose(scene.opacities[row], sample["opacity"], **near)
        np.testing.assert_allclose(sh[row, 0], sample["f_dc"], **near)
        if scene.sh_degree:
            np.testing.assert_allclose(sh[row, 1], sample["sh_first_coef_rgb"], **near)
            np.testing.assert_allclose(sh[row, -1], sample["sh_last_coef_rgb"], **near)


@needs_data
@pytest.mark.parametrize("path", NOT_READ)
def test_malformed_and_foreign_files_are_refused_by_reason(path):
    """Each file that is no scene, or not whole, gets the line that fits it."""
    line = refusal(DATA / path)
    assert re.search(reason(path), line), line


LEICA, PLANT = "formats/leica-8k-sh3/leica-8k-sh3.", "formats/plant-114k-sh0/plant-114k-sh0."
PLAYBOT, EQUIV = "formats/playbot-31k-sh2/playbot-31k-sh2.", "usd3dgs/equivalence/equiv-degree"
CORPUS = "leica-sofort/leica-sofort-top8192."
TWINS = [
    # file, its PLY, dB that its pictures reach at least, axes that its writer left as they were
    (LEICA + "niantic-v2.spz", LEICA + "gf.ply", 34, ""),
    (LEICA + "niantic-v3.spz", LEICA + "gf.ply", 40, ""),
    (LEICA + "niantic-v4.spz", LEICA + "gf.ply", 40, ""),
    (LEICA + "st-v4.spz", LEICA + "gf.ply", 39, "RDF"),
    (LEICA + "gsply-v4.spz", LEICA + "gf.ply", 45, "RDF"),
    (LEICA + "sog", LEICA + "gf.ply", 43, ""),
    (LEICA + "gf.sog", LEICA + "gf.ply", 50, ""),
    (LEICA + "glb", LEICA + "gf.ply", 120, ""),
    (PLANT + "niantic-v4.spz", PLANT + "st.ply", 60, ""),
    (PLANT + "sog", PLANT + "st.ply", 60, ""),
    (PLAYBOT + "niantic-v3.spz", PLAYBOT + "st.ply", 47, ""),
    (PLAYBOT + "niantic-v4.spz", PLAYBOT + "st.ply", 47, ""),
    (PLAYBOT + "sog", PLAYBOT + "st.ply", 55, ""),
    ("usd3dgs/corpus-sog/" + CORPUS + "sog", "usd3dgs/corpus-ply/" + CORPUS + "ply", 43, ""),
    (EQUIV + "3-exact-v2.spz", EQUIV + "3-exact-binary-le.ply", 65, ""),
    (EQUIV + "3-exact-v3.spz", EQUIV + "3-exact-binary-le.ply", 75, ""),
    (EQUIV + "3-exact.sog", EQUIV + "3-exact-binary-le.ply", 65, ""),
    (EQUIV + "1-offgrid-v2.spz", EQUIV + "1-offgrid-binary-le.ply", 80, ""),
    (EQUIV + "1-offgrid.sog", EQUIV + "1-offgrid-binary-le.ply", 100, ""),
]


def psnr(first, second):
    """dB, of what is shown: 0..1."""
    off = np.clip(first.rgb, 0, 1).astype(np.float64) - np.clip(second.rgb, 0, 1)
    return -10 * np.log10(max(np.square(off).mean(), 1e-20))


@needs_data
@pytest.mark.parametrize(("path", "ply", "least", "left"), TWINS)
def test_the_picture_is_that_of_the_ply(path, ply, least, left):
    """The same scene makes the same picture, as far as the format kept it; turned it does not.

    What formats lose, by the manifest's ``vs_source``: SPZ clamps the base colour to +-3.3 and
    keeps four bits of colours seen from aside, version 2 turns Gaussians by half a degree and more;
    SOG's codebooks have 256 entries. The bounds are whole dB below what was measured; after half a
    turn about x, no file comes within 10 dB of its bound.
    """
    zstd(path)
    wanted, made = load_scene(DATA / ply), load_scene(DATA / path)
    if left:
        made = half_turned(made)
    camera = tsplat.frame_scene(wanted, 320, 200)
    picture = tsplat.render(wanted, camera)
    assert psnr(tsplat.render(made, camera), picture) > least
    assert psnr(tsplat.render(half_turned(made), camera), picture) < least - 10


@needs_data
def test_a_folder_is_the_scene_that_lies_in_it():
    """An unbundled SOG of 500,000 Gaussians looks like the same robot of 125,000."""
    folder = DATA / "large" / "playbot-500k-sh2.sog-unbundled"
    scene = load_scene(folder)
    assert (scene.name, scene.source) == (folder.name, "sog 2, SH 2, unbundled")
    ply = load_scene(DATA / "large" / "playbot-125k-sh2.ply")
    camera = tsplat.frame_scene(ply, 320, 200)
    assert psnr(tsplat.render(scene, camera), tsplat.render(ply, camera)) > 30


@needs_data
def test_a_list_of_levels_is_named():
    """A streamed SOG's index is told from a scene's meta.json."""
    with pytest.raises(SceneError, match="name the folder of one of them"):
        load_scene(DATA / "pc-engine" / "playbot" / "lod-meta.json")


SMALL = [
    LEICA + "niantic-v2.spz", LEICA + "niantic-v3.spz", LEICA + "niantic-v4.spz", LEICA + "sog",
    LEICA + "gf.sog", "usd3dgs/fixtures-sog/kit-multi-degree3-deflated.sog",
    "usd3dgs/fixtures-spz/decode-degree3-v2.spz", "bevy_khr/khr_conformance_matrix.glb",
    "bevy_khr/khr_conformance_matrix.gltf", "splat-transform-fixtures/minimal-v4.spz",
]  # fmt: skip


@needs_data
@pytest.mark.parametrize("path", SMALL)
@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damage_to_real_files_gives_a_scene_or_a_line(tmp_path, path, data):
    """Bits, numbers and pieces of files by other people's tools changed, or their end cut off."""
    zstd(path)
    (tmp_path / "a").write_bytes(data.draw(damaged((DATA / path).read_bytes())))
    scene_or_line(tmp_path / "a")
