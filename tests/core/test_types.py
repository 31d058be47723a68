"""Scenes and frames: what is accepted, what is said of the rest, and the 8-bit rule."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import gaussians
from tsplat.core.errors import ParamsError, SceneError, printable
from tsplat.core.params import RenderParams
from tsplat.core.types import Frame
from tsplat.core.workspace import Workspace


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"means": np.zeros((2, 3))}, r"Scene.means: .* float32 \[N, 3\], got float64 \[2, 3\]"),
        ({"quats": np.zeros((3, 4), np.float32)}, r"\[2, 4\], got float32 \[3, 4\].*w, x, y, z"),
        ({"scales": np.zeros((3, 2), np.float32).T}, "not contiguous"),
        ({"opacities": [0.5, 0.5]}, "got list"),
        ({"sh": np.zeros((2, 5, 3), np.float32)}, "1, 4, 9 or 16"),
        ({"sh": np.zeros((2, 4, 3))}, r"float32 \[2, K, 3\], got float64 .* float16 will do too"),
        ({"numbers": np.arange(2)}, r"Scene.numbers: .* int32 \[2\], got int64"),
        ({"sh": np.zeros((2, 4), np.float16)}, r"float16 \[2, K, 3\], got float16 \[2, 4\]"),
    ],
)  # fmt: skip
def test_a_wrong_array_is_named_with_what_was_expected_and_what_came(change, text):
    """Every field's error says where, what was expected, what came, and what it means."""
    scene = gaussians([[0, 0, 1], [0, 0, 2]])
    with pytest.raises(SceneError, match=text):
        replace(scene, **change)


def test_eight_bits_round_to_nearest():
    """floor(clip(x, 0, 1) * 255 + 0.5): halves go up, nothing is truncated or wraps."""
    values = np.array([-1, 0, 0.4999 / 255, 0.5 / 255, 1.5 / 255, 254.5 / 255, 1, 7], np.float32)
    rgb = np.repeat(values[None, :, None], 3, axis=2)
    got = Frame(rgb, np.zeros(rgb.shape[:2], np.float32)).to_uint8()
    assert got[0, :, 0].tolist() == [0, 0, 0, 1, 2, 255, 255, 255]


def test_a_background_shows_through_what_is_transparent():
    """rgb + transmittance * background, and opaque afterwards."""
    frame = Frame(np.full((1, 1, 3), 0.2, np.float32), np.full((1, 1), 0.5, np.float32))
    over = frame.over((1.0, 0.0, 0.5))
    np.testing.assert_allclose(over.rgb[0, 0], [0.7, 0.2, 0.45], rtol=1e-6)
    assert over.transmittance.max() == 0
    assert over.rgb.dtype == np.float32


@pytest.mark.parametrize(
    "bad", [{"sh_degree": 4}, {"alpha_threshold": 1.0}, {"transmittance_min": float("nan")}]
)
def test_settings_outside_their_range_are_refused(bad):
    """A setting that no picture can be made with is an error at once."""
    with pytest.raises(ParamsError, match=next(iter(bad))):
        RenderParams(**bad)


def test_a_workspace_keeps_and_grows_its_memory():
    """The same name gives the same memory again, aligned to 64 bytes, larger when needed."""
    workspace = Workspace()
    first = workspace.array("a", (10, 3), np.float32)
    assert first.ctypes.data % 64 == 0
    assert workspace.array("a", (5, 3), np.float32).ctypes.data == first.ctypes.data
    grown = workspace.array("a", (1000,), np.float64)
    assert grown.shape == (1000,)
    assert workspace.array("b", (0,), np.int32).shape == (0,)
    with pytest.raises(ParamsError, match="threads"):
        Workspace(0)


def test_text_of_unknown_origin_loses_its_control_characters():
    """Escape sequences in a file name or comment never reach the terminal."""
    assert "\x1b" not in printable("a\x1b[2Jb\x07\n")
    assert len(printable("x" * 1000)) == 200


def test_a_workspace_converts_once():
    """float32 is passed through; float16 is copied when it is another array, and let go."""
    workspace = Workspace()
    full = np.ones((4, 3), np.float32)
    assert workspace.float32(full) is full
    assert workspace.nbytes == 0
    half = np.arange(12, dtype=np.float16).reshape(4, 3)
    copy = workspace.float32(half)
    assert copy.dtype == np.float32
    np.testing.assert_array_equal(copy, half)
    assert workspace.float32(half) is copy
    assert workspace.nbytes == copy.nbytes
    other = half + np.float16(1)
    np.testing.assert_array_equal(workspace.float32(other), other)
    np.testing.assert_array_equal(workspace.float32(half), half)
