"""The oracle is right: its arithmetic, its harmonics, and its pictures."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from tests.conftest import gaussians, straight
from tsplat.core import reference
from tsplat.core.params import RenderParams
from tsplat.testing.compare import compare_frames
from tsplat.testing.oracle import draw, harmonics
from tsplat.testing.stiff import CASES, prepared
from tsplat.testing.wide import Wide


def exact(wide):
    """A Wide's numbers, exactly."""
    pairs = zip(np.ravel(wide.high), np.ravel(wide.low), strict=True)
    return [Fraction(float(high)) + Fraction(float(low)) for high, low in pairs]


@pytest.mark.parametrize("name", ["__add__", "__sub__", "__mul__", "__truediv__"])
def test_wide_numbers_are_good_to_100_bits(name):
    """Each operation on 2,000 pairs of numbers of any size, against fractions."""
    rng = np.random.default_rng(1)
    size = 10.0 ** rng.uniform(-30, 30, (2, 2000)) * rng.choice([-1, 1], (2, 2000))
    a, b = (Wide(high, high * rng.uniform(-(2.0**-54), 2.0**-54, 2000)) for high in size)
    for x, y, got in zip(exact(a), exact(b), exact(getattr(a, name)(b)), strict=True):
        want = getattr(x, name)(y)
        # a sum is good to 2^-100 of its terms, a product or a quotient of itself
        scale = abs(x) + abs(y) if name in ("__add__", "__sub__") else abs(want)
        assert abs(got - want) <= scale * Fraction(1, 2**100)


def test_wide_numbers_keep_what_cancels():
    """(1e16 + 1) - 1e16, the case of a needle's a c - b^2, is 1; float64 says 0 or 2."""
    a = Wide.of(1e16) + 1
    assert (a - 1e16).float64() == 1
    assert (a * a - a * 1e16).float64() == 1e16
    assert float(a.float64()) - 1e16 != 1


def test_wide_numbers_mix_with_arrays():
    """Arrays on either side are taken as Wides, not the other way round."""
    a, two = Wide.of([1.0, 3.0]), np.array([2.0, 2.0])
    for got, want in (
        (two - a, [1, -1]),
        (two * a, [2, 6]),
        (two / a, [2, 2 / 3]),
        (a / two, [0.5, 1.5]),
    ):
        assert isinstance(got, Wide)
        np.testing.assert_allclose(got.float64(), want, rtol=1e-16)


def test_harmonics_by_definition_are_those_of_the_reference():
    """Legendre's functions and forward.cu's polynomials: same order, signs and numbers."""
    d = np.random.default_rng(2).normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    for degree in range(4):
        np.testing.assert_allclose(harmonics(d, degree), reference.sh_basis(d, degree), atol=1e-14)


def test_one_gaussian_by_hand():
    """Alpha and margin of a round splat on a pixel's centre and beside it."""
    scene = gaussians([0, 0, 4], scales=0.08, opacities=0.5, colors=(1, 0.25, 0))
    oracle = draw(scene, straight(), RenderParams(depth=True))
    variance = (100 / 4 * float(np.float32(0.08))) ** 2 + 0.3
    beside = 0.5 * np.exp(-1 / (2 * variance))
    np.testing.assert_allclose(1 - oracle.frame.transmittance[10, 10:12], [0.5, beside], rtol=1e-15)
    np.testing.assert_allclose(oracle.frame.rgb[10, 10], [0.5, 0.125, 0], atol=1e-7)
    np.testing.assert_allclose(oracle.frame.depth[10, 10], 2.0, rtol=1e-15)
    np.testing.assert_allclose(oracle.margins[10, 10], 0.5 * 255 - 1, rtol=1e-12)
    assert oracle.overflowed == 0


# Where the contract's float64 cannot do better: the camera's centre, worked out from viewmat, is
# rounded to 4e-9 m; three products of 1e6 cancel to a few metres of 10 px.
COARSE = {"centres at 1e7 m": 1e-7, "focal length of 1e7 px": 1e-9}


@pytest.mark.parametrize("case", CASES, ids=str)
def test_reference_and_oracle_agree_in_float64(case):
    """Two ways that share no arithmetic, to 1e-10 of what may be 1: both are right."""
    scene, camera, params, oracle = prepared(case)
    frame = reference.render(scene, camera, replace(params, float64=True))
    size = max(1.0, float(abs(oracle.frame.rgb).max()))
    found = compare_frames(frame, oracle.frame, oracle.margins, size * COARSE.get(case.name, 1e-10))
    assert found.passed, found
    assert found.flips == 0
