"""What unpacks numbers, in C and with NumPy: known values, and the same bits.

exp is the C library's in one and NumPy's own in the other; see test_native on how seldom a float32
can differ for that.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsplat.io import unpack
from tsplat.io.unpack import PLACES, Parts, Ranges, fixed_24, in_ranges, look_up, smallest_three

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(params=["C", "NumPy"])
def either(request, monkeypatch):
    """Tests of known values are of both."""
    if request.param == "NumPy":
        monkeypatch.setattr(unpack, "lib", None)


def apart(rng, array):
    """The same numbers, rows at a distance, perhaps at an odd address."""
    gap = int(rng.integers(0, 9)) * (1 if array.dtype == np.uint8 else array.itemsize)
    if not array.size:
        return array
    width = array[0].nbytes
    room = rng.integers(0, 256, (len(array), width + gap), dtype=np.uint8)
    room[:, :width] = array.reshape(len(array), -1).view(np.uint8)
    rows = np.ndarray(array.shape, array.dtype, room, strides=(width + gap, *array.strides[1:]))
    assert (rows == array).all()
    return rows


def calls(rng):
    """Room for a result, and what fills it from arrays that ``lend`` may put elsewhere."""
    n = int(rng.integers(0, 60))
    words = rng.integers(0, 2**32, n, dtype=np.uint32)
    tables = rng.normal(size=(int(rng.integers(1, 50)), 256)).astype(np.float32)
    tables[:, :3] = np.nan, np.inf, -0.0
    which = rng.integers(0, 256, (n, len(tables)), dtype=np.uint8)
    many = rng.integers(0, 256, (n, int(rng.integers(0, 50))), dtype=np.uint8)
    yield np.zeros(which.shape, "f4"), lambda lend, out: look_up(lend(which), lend(tables), out)
    yield np.zeros(many.shape, "f4"), lambda lend, out: look_up(lend(many), lend(tables[:1]), out)
    raw = rng.integers(0, 256, (n, 9), dtype=np.uint8)
    factor = float(rng.normal())
    yield np.zeros((n, 3), "f4"), lambda lend, out: fixed_24(lend(raw), factor, out)
    values = rng.uniform(-0.8, 0.8, 1024)
    places = PLACES[:, rng.permutation(4)].copy()
    places[rng.integers(4)] = -1
    quats = np.zeros((n, 4), "f4")
    yield (
        quats,
        lambda lend, out: smallest_three(
            lend(words), (20, 10, 0), lend(values), 30, lend(places), out
        ),
    )
    tagged = np.resize(places, (256, 4))
    yield (
        quats,
        lambda lend, out: smallest_three(
            lend(words), (0, 8, 16), lend(values[:256]), 24, lend(tagged), out
        ),
    )
    size = int(rng.integers(1, 5))
    chunks = rng.integers(0, size, n)
    low, step = rng.normal(size=(2, size, 3)) * 10.0 ** rng.integers(-9, 3)
    low[0, 0], step[0, 1] = rng.choice([0, np.inf, np.nan, 1e308], 2)
    parts = Parts((21, 11, 0), (11, 10, 11)) if rng.integers(2) else Parts((24, 16, 8), (8, 8, 8))
    for kind, exponent in (("f4", False), ("f4", True), ("f8", False)):
        yield (
            np.zeros((n, 3), kind),
            lambda lend, out, exponent=exponent: in_ranges(
                lend(words),
                parts,
                lend(chunks),
                Ranges(lend(low), lend(step)),
                out,
                exponent=exponent,
            ),
        )


@given(seeds)
def test_c_and_numpy_agree(seed):
    """To the bit, whatever the tables hold and wherever the rows are."""
    rng = np.random.default_rng(seed)

    def lend(array):
        return apart(rng, array) if array.dtype in (np.uint8, np.uint32) else array

    for room, call in calls(rng):
        found = apart(rng, room) if room.dtype == np.float32 and room.size else room.copy()
        call(lend, found)
        wanted = room.copy()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(unpack, "lib", None)
            call(lambda array: array, wanted)
        np.testing.assert_array_equal(found, wanted)
        signs = np.signbit(found) == np.signbit(wanted)
        assert (signs | np.isnan(wanted)).all()


def test_it_is_there():
    """The compiler of this machine has made what is in C."""
    assert unpack.lib is not None


@pytest.mark.usefixtures("either")
def test_bytes_by_tables():
    """A table for each column, or one for all."""
    tables = np.arange(512, dtype=np.float32).reshape(2, 256)
    numbers = np.array([[3, 5], [255, 0]], np.uint8)
    out = np.empty((2, 2), np.float32)
    look_up(numbers, tables, out)
    assert out.tolist() == [[3, 261], [255, 256]]
    look_up(numbers, tables[1:], out)
    assert out.tolist() == [[259, 261], [511, 256]]


@pytest.mark.usefixtures("either")
def test_integers_of_three_bytes():
    """Lowest byte first; the highest has the sign."""
    raw = [[1, 0, 0, 0, 1, 0, 0, 0, 1], [255, 255, 255, 0, 0, 128, 255, 255, 127]]
    out = np.empty((2, 3), np.float32)
    fixed_24(np.array(raw, np.uint8), 0.5, out)
    assert out.tolist() == [[0.5, 128, 32768], [-0.5, -4194304, 4194303.5]]


@pytest.mark.usefixtures("either")
def test_quaternions_without_their_largest_component():
    """The largest makes them one long, is 0 if there is no room for it; a tag may mean nothing."""
    values = np.array([0, 0.5, -0.5, 0.9])
    words = np.array([(tag << 30) | 0b01_10_00 for tag in range(4)] + [0b11_11_11], np.uint32)
    out = np.empty((5, 4), np.float32)
    smallest_three(words, (4, 2, 0), values, 30, PLACES, out)
    root = np.float32(np.sqrt(0.5))
    large = np.float32(0.9)
    assert out.tolist() == [
        [root, 0.5, -0.5, 0], [0.5, root, -0.5, 0], [0.5, -0.5, root, 0], [0.5, -0.5, 0, root],
        [0, large, large, large],
    ]  # fmt: skip
    nothing = PLACES.copy()
    nothing[2] = -1
    smallest_three(words, (4, 2, 0), values, 30, nothing, out)
    assert (out.any(1) == [True, True, False, True, True]).all()


@pytest.mark.usefixtures("either")
def test_parts_of_ranges():
    """The range is the chunk's; float32 is rounded once, from float64."""
    ranges = Ranges(np.array([[0, 1, 2], [1e9, 0, 0.0]]), np.array([[1, 0.5, 2], [2.0**-20, 1, 0]]))
    words = np.array([0x01020300, 0x01020300], np.uint32)
    parts = Parts((24, 16, 8), (8, 8, 8))
    wide, narrow = np.empty((2, 3)), np.empty((2, 3), np.float32)
    in_ranges(words, parts, np.array([0, 1]), ranges, wide)
    assert wide.tolist() == [[1, 2, 8], [1e9 + 2.0**-20, 2, 0]]
    in_ranges(words, parts, np.array([0, 1]), ranges, narrow)
    assert narrow.tolist() == [[1, 2, 8], [1e9, 2, 0]]
    in_ranges(words, parts, np.array([0, 0]), ranges, narrow, exponent=True)
    np.testing.assert_allclose(narrow, np.exp([[1, 2, 8]] * 2), rtol=1e-7)
