"""Readers that are wrong in a way that readers have been: the tests of each format catch them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.io import test_gltf, test_packed, test_ply_variants, test_sog, test_spz
from tsplat.io import load_scene


def _first_last(scene):
    order = [*range(1, len(scene)), 0]
    return replace(scene, means=np.ascontiguousarray(scene.means[order]))


def _by_channel(scene):
    rest = scene.sh[:, 1:].transpose(0, 2, 1).reshape(len(scene), -1, 3)
    return replace(scene, sh=np.ascontiguousarray(np.concatenate([scene.sh[:, :1], rest], 1)))


WRONG = {
    "quaternions x, y, z, w": lambda s: replace(
        s, quats=np.ascontiguousarray(np.roll(s.quats, -1, axis=1))
    ),
    "quaternions the other way": lambda s: replace(
        s, quats=np.ascontiguousarray(s.quats * np.float32([1, -1, -1, -1]))
    ),
    "y mirrored": lambda s: replace(
        s, means=np.ascontiguousarray(s.means * np.float32([1, -1, 1]))
    ),
    "sizes in another order": lambda s: replace(s, scales=np.ascontiguousarray(s.scales[:, ::-1])),
    "logarithms of sizes": lambda s: replace(s, scales=np.abs(np.log(s.scales + 1e-6))),
    "opacities cut by two steps": lambda s: replace(
        s, opacities=np.maximum(s.opacities - np.float32(2 / 255), 0)
    ),
    "opacities taken for logits": lambda s: replace(s, opacities=1 / (1 + np.exp(-s.opacities))),
    "blue, green, red": lambda s: replace(s, sh=np.ascontiguousarray(s.sh[:, :, ::-1])),
    "coefficients by channel": _by_channel,
    "band 1 forgotten": lambda s: replace(s, sh=np.where(
        (np.arange(s.sh.shape[1]) == 1)[:, None], np.float32(0), s.sh)),
    "positions of the next row": _first_last,
    "one row missing": lambda s: s.take(np.arange(len(s) - 1)),
}  # fmt: skip
"""Scene -> what a wrong reader makes of the same file."""

N = 20


def _plain(test):
    """The body of a test, without hypothesis round it."""
    return test.hypothesis.inner_test


def _drawing(**answers):
    """Stands in for ``st.data()``: each draw gives the least that its strategy can."""

    def draw(strategy, label=None):
        text = repr(strategy)
        return next(value for key, value in answers.items() if key in text)

    return SimpleNamespace(draw=draw)


FORMATS = {
    "ply": (test_ply_variants, lambda tmp: (
        test_ply_variants.test_every_degree_in_every_encoding(tmp, 2, test_ply_variants.FORMATS[0]),
    )),
    "splat": (test_packed, lambda tmp: _plain(test_packed.test_splat)(tmp, None, N, 3, 1.0)),
    "ksplat": (
        test_packed,
        lambda tmp: _plain(test_packed.test_ksplat)(
            tmp, None, _drawing(**{"lists": [N], "integers": 1, "0.1": 9.0, "sampled_from": 16})
        ),
    ),
    "compressed": (test_packed, lambda tmp: _plain(test_packed.test_compressed_ply)(
        tmp, None, N, 2, 3, 1.0, True, False, 0, ("chunk", "vertex", "sh"))),
    "spz": (test_spz, lambda tmp: _plain(test_spz.test_values_are_those_of_the_plain_decoder)(
        tmp, 3, N, 2, 3, _drawing(integers=12))),
    "sog": (test_sog, lambda tmp: _plain(test_sog.test_values_are_those_of_the_plain_decoder)(
        tmp, 2, N, 2, 3)),
    "gltf": (test_gltf, lambda tmp: _plain(test_gltf.test_values_are_the_files_in_other_axes)(
        tmp, N, 2, 3, _drawing(integers=0, sampled_from="glb"))),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMATS)
def test_the_true_reader_passes(tmp_path, name):
    """The checks that follow fail for the wrong readers alone."""
    FORMATS[name][1](tmp_path)


OF_SH = ("coefficients by channel", "band 1 forgotten")
CASES = [(name, wrong) for name in FORMATS for wrong in WRONG
         if not (name == "splat" and wrong in OF_SH)]  # fmt: skip


@pytest.mark.parametrize(("name", "wrong"), CASES)
def test_a_wrong_reader_is_caught(tmp_path, monkeypatch, name, wrong):
    """Every way to be wrong, in every format that has what it gets wrong."""
    module, check = FORMATS[name]
    monkeypatch.setattr(
        module, "load_scene", lambda *words, **more: WRONG[wrong](load_scene(*words, **more))
    )
    with pytest.raises((AssertionError, IndexError)):
        check(tmp_path)
