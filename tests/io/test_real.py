"""Files by other people's tools, against what independent parsers found in them.

Compared: counts, degree, bounds, and three Gaussians per file to 1e-5, which is how many digits
the manifest keeps: both read the same quantised numbers, so no step of them is allowed for.
Skipped where the files are absent; they are no part of this repository.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.io.realdata import DATA, manifest, needs_data
from tsplat.core.errors import SceneError
from tsplat.io import load_scene

# every PLY there that is refused, and why; what is not here must load
REFUSED = {
    r"duplicate-format": "cannot be read: line 3",
    r"empty-element": "element face has 7 rows of no properties",
    r"empty-head": "without an element vertex; its elements: none",
    r"supported-data-types-common": "without an element vertex",
    r"supported-data-types-special": "cannot be read: line 6: field type 'byte'",
    r"valid-keyword": "cannot be read: line 8",
    r"loader/triangle": "a point cloud of 3 vertices",
    r"another-cube": r"a mesh \(element face 7\) of 8 vertices",
    r"custom-components-duplicate|float-indices-int-be-unaligned": "two properties with same name",
    r"magnum-ply/(extra-token|format-|in|unexpected|unknown)": "without an end_header line",
    r"magnum-ply/": r"a mesh \(element face",
    r"degree-4-sh": "72 f_rest properties, which is degree 4",
    r"duplicate-sh-index": "a property 'f_rest_00'",
    r"invalid-sh-name": "a property 'f_rest_1x'",
    r"list-property": "property opacity of element vertex is a list",
    r"missing-opacity": "lacks opacity",
    r"nan-opacity": r"none of its Gaussians can be drawn \(opacity not a number: 1\)",
    r"overflow-scale": r"none of its Gaussians can be drawn \(scale not finite: 1\)",
    r"sh-invalid-degree": "has 6 f_rest properties; expected 0, 9, 24 or 45",
}
SUFFIXES = (".ply", ".splat", ".ksplat")
FILES = {path: entry for path, entry in manifest().items() if path.endswith(SUFFIXES)}


def reason(path: str) -> str | None:
    return next((why for which, why in REFUSED.items() if re.search(which, path)), None)


READ = sorted(path for path in FILES if reason(path) is None)
NOT_READ = sorted(path for path in FILES if reason(path) is not None)


def quat(path: str, row: int, sample: dict) -> np.ndarray:
    """The sample's quaternion; that of a .splat's bytes as antimatter15's viewer reads them.

    The manifest's parser reads ``b / 127.5 - 1`` of them, the viewer ``(b - 128) / 128``.
    """
    if not path.endswith(".splat"):
        return np.array(sample["quat_wxyz"])
    stored = np.fromfile(DATA / path, np.uint8).reshape(-1, 32)[row, 28:].astype(float)
    theirs, ours = (q / np.linalg.norm(q) for q in (stored / 127.5 - 1, stored / 128 - 1))
    np.testing.assert_allclose(theirs, sample["quat_wxyz"], rtol=1e-5, atol=1e-6)
    return ours


@needs_data
def test_there_are_files_of_both_kinds():
    """The manifest lists scenes and malformed files, so neither test below is empty."""
    assert len(READ) >= 31
    assert len(NOT_READ) >= 50
    for suffix, count in ((".compressed.ply", 3), (".splat", 6), (".ksplat", 6)):
        assert sum(path.endswith(suffix) for path in READ) == count


@needs_data
@pytest.mark.parametrize("path", READ)
def test_values_are_those_other_parsers_found(path):
    """Count, degree, bounds, and position, scale, rotation, opacity, colour of three Gaussians."""
    entry = FILES[path]
    scene = load_scene(DATA / path, sh_float32=True)
    assert len(scene) == entry["splats"]
    assert scene.sh_degree == entry["sh_degree"]
    assert not scene.dropped
    near = {"rtol": 1e-5, "atol": 1e-6}
    np.testing.assert_allclose(scene.means.min(0), entry["bbox_min"], **near)
    np.testing.assert_allclose(scene.means.max(0), entry["bbox_max"], **near)
    if scene.numbers is not None:
        scene = scene.take(np.argsort(scene.numbers))
    for sample in entry["samples"]:
        row = sample["index"]
        np.testing.assert_allclose(scene.means[row], sample["position"], **near)
        np.testing.assert_allclose(scene.scales[row], sample["scale_linear"], **near)
        np.testing.assert_allclose(scene.quats[row], quat(path, row, sample), **near)
        np.testing.assert_allclose(scene.opacities[row], sample["opacity"], **near)
        np.testing.assert_allclose(scene.sh[row, 0], sample["f_dc"], **near)
        if scene.sh_degree:
            np.testing.assert_allclose(scene.sh[row, 1], sample["sh_first_coef_rgb"], **near)
            np.testing.assert_allclose(scene.sh[row, -1], sample["sh_last_coef_rgb"], **near)


@needs_data
@pytest.mark.parametrize("path", NOT_READ)
def test_malformed_and_foreign_files_are_refused_by_reason(path):
    """Each file of other projects' test suites that is no scene gets the line that fits it."""
    with pytest.raises(SceneError, match=reason(path)) as caught:
        load_scene(DATA / path)
    assert str(caught.value).isprintable()
