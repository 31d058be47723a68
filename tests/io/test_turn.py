"""Axes: Gaussians that are turned, mirrored, scaled and shifted look the same from where they went.

Compared with covariances and colours worked out from matrices, not with another quaternion formula.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsplat.core.reference import rotations, sh_basis
from tsplat.io.turn import Turn, axes

SYSTEMS = [x + y + z for x in "LR" for y in "DU" for z in "BF"]
SYSTEMS += [x + z + y for x in "LR" for y in "DU" for z in "BF"]


def some(rng, n=9):
    """Positions, unit quaternions, scales, coefficients of degree 3."""
    quats = rng.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return rng.normal(size=(n, 3)), quats, rng.uniform(0.1, 2, (n, 3)), rng.normal(size=(n, 16, 3))


def covariances(quats, scales):
    half = rotations(quats) * scales[:, None]
    return half @ half.transpose(0, 2, 1)


def agree(turn, matrix, scale, shift, rng):
    """Positions, covariances, and colours from every side are those that the matrix says."""
    means, quats, scales, sh = some(rng)
    np.testing.assert_allclose(turn.means(means), scale * means @ matrix.T + shift, atol=1e-12)
    made = covariances(turn.quats(quats), turn.scales(scales))
    wanted = scale**2 * (matrix @ covariances(quats, scales) @ matrix.T)
    np.testing.assert_allclose(made, wanted, atol=1e-10)
    seen = rng.normal(size=(9, 3))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    for degree in range(4):
        few = sh[:, : (degree + 1) ** 2]
        before = np.einsum("dk,nkc->ndc", sh_basis(seen, degree), few)
        after = np.einsum("dk,nkc->ndc", sh_basis(seen @ matrix.T, degree), turn.sh(few))
        np.testing.assert_allclose(after, before, atol=1e-10)


@pytest.mark.parametrize("letters", SYSTEMS)
def test_every_system_of_axes(letters):
    """Each of the 16 orders and directions of axes, mirrored ones too."""
    matrix = axes(letters)
    agree(Turn(matrix), matrix, 1, np.zeros(3), np.random.default_rng(0))


@given(st.integers(0, 2**32), st.booleans(), st.floats(0.01, 100))
def test_any_turn(seed, mirrored, scale):
    """A turn about any axis by any angle, with or without a mirror, scaled and shifted."""
    rng = np.random.default_rng(seed)
    matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if (np.linalg.det(matrix) < 0) != mirrored:
        matrix[:, 0] *= -1
    shift = rng.normal(size=3)
    agree(Turn(matrix, scale, shift), matrix, scale, shift, rng)


def test_letters_are_directions_in_a_world_whose_y_is_down():
    """A PLY file's axes (RDF) are tsplat's; of RUB, y and z point the other way."""
    assert (axes("RDF") == np.eye(3)).all()
    assert (axes("RUB") @ [1, 2, 3] == [1, -2, -3]).all()
    assert (axes("LUF") @ [1, 2, 3] == [-1, -2, 3]).all()
    assert (axes("RFU") @ [1, 2, 3] == [1, -3, 2]).all()


def test_flips_are_exact():
    """float32 numbers keep their bits but for the sign, and their type."""
    rng = np.random.default_rng(1)
    means, quats, _, sh = (a.astype(np.float32) for a in some(rng))
    turn = Turn(axes("RUB"))
    for made, given_ in ((turn.means(means), means), (turn.quats(quats), quats), (turn.sh(sh), sh)):
        assert made.dtype == np.float32
        assert (np.abs(made) == np.abs(given_)).all()
    assert (turn.means(means) == means * np.float32([1, -1, -1])).all()
