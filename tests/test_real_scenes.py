"""Every backend on scenes that nobody here made, through the loader and the default view."""

from __future__ import annotations

import pytest

import tsplat
from tests.conftest import DATA
from tsplat.plugins import load_backend, plugins
from tsplat.testing.checks import Case, check_stages

SCENES = (
    "formats/leica-8k-sh3/leica-8k-sh3.gf.ply",
    "formats/plant-114k-sh0/plant-114k-sh0.st.ply",
    "formats/playbot-31k-sh2/playbot-31k-sh2.st.ply",
    "gaussforge/tiny_gauss.ply",
    "gausplat-renderer/sixstars.3dgs.ply",
    "splatapult/test.ply",
    "epfl-web/pc_short.ply",
    "jsplat/unitCube-ascii.ply",
    "usd3dgs/equivalence/equiv-degree3-exact-binary-le.ply",
    "usd3dgs/fixtures-ply/reordered-properties.ply",
)

FEW = 30_000  # numpy takes 20 s for the largest


@pytest.mark.parametrize("path", SCENES)
def test_every_backend_keeps_the_contract(data, path):
    """All checks hold at 192x120: for numba and cffi on all of it, for numpy on 30,000 at most."""
    scene = tsplat.load_scene(data / path)
    few = scene if len(scene) <= FEW else tsplat.load_scene(data / path, max_splats=FEW)
    case = Case(scene, tsplat.frame_scene(scene, 192, 120))
    small = case if few is scene else Case(few, tsplat.frame_scene(few, 192, 120))
    assert case.composited[0].transmittance.min() < 0.9  # there is something to see
    for name, held in (("numpy", small), ("numba", case), ("cffi", case)):
        for verdict in check_stages(load_backend(plugins().backends[name]), held):
            assert verdict.passed, (name, verdict)


def test_nothing_here_is_skipped_unseen():
    """Where the folder of real scenes is, all of these are in it."""
    if DATA.is_dir():
        assert [path for path in SCENES if not (DATA / path).is_file()] == []
