"""The decoder in C against the NumPy path that takes over where it does not apply.

Compared are bits of whole files and of rows of any bit pattern, on both instruction sets. The bound
of what float16 does is summed in another order: it agrees to 1 part in 100,000, and the decision
that hangs on it is the same. exp is the C library's in one and NumPy's own in the other; both are
good to a bit or so of float64, so a float32 can differ where the true value lies within some 1e-9
of a step of the middle between two: about one in a billion. None of the values here does.
"""

from __future__ import annotations

import os
import random

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tests.backends.test_guard_pages import FAULTS, child
from tests.io.plywriter import BIG, LITTLE, REST, TEXT, names_inria, raw_columns, write_ply
from tests.io.test_half import between_halves
from tsplat.core.curve import curve_keys
from tsplat.core.errors import KernelError, SceneError
from tsplat.io import curve, load_scene, native, ply, sweeps
from tsplat.io.clean import SceneBuilder
from tsplat.io.half import SH_ERROR_MAX

ARRAYS = ("means", "quats", "scales", "opacities", "sh")
SOUND = {"scale": (-80.0, 80.0), "opacity": (-700.0, 700.0)}


@pytest.fixture(autouse=True, params=["best", "generic"])
def instructions(request, monkeypatch):
    """Every test on both instruction sets."""
    monkeypatch.setenv("TSPLAT_ISA", request.param if request.param == "generic" else "")


def in_c(dtype, rest, rows, *, half=False, to=None, capacity=None):
    """The arrays that C makes of ``rows``, and the bound, which is None if it gives up."""
    decoder = ply.Layout(dtype, rest)._decoder
    size = capacity or len(rows)
    shapes = ((size, 3), (size, 4), (size, 3), (size,), (size, 1 + rest // 3, 3))
    types = (*[np.float32] * 4, np.float16 if half else np.float32)
    arrays = [np.zeros(s, t) for s, t in zip(shapes, types, strict=True)]
    return arrays, decoder(rows, *arrays, slice(0, len(rows)) if to is None else to)


def in_numpy(dtype, rest, rows, *, half=False):
    """The arrays that NumPy makes, and the bound."""
    layout = ply.Layout(dtype, rest)
    layout._decoder = None
    builder = SceneBuilder(len(rows), 1 + rest // 3, half=half)
    layout.add(builder, slice(0, len(rows)), rows, False)
    return [getattr(builder, f"_{name}") for name in ARRAYS], builder.sh_error, builder.dropped


def make_rows(n, degree, seed=0):
    names = names_inria(degree)
    rows = np.zeros(n, [(name, "<f4") for name in names])
    for name, column in raw_columns(n, degree, seed).items():
        rows[name] = column
    return rows


def assert_same(got, expected):
    for name, a, b in zip(ARRAYS, got, expected, strict=True):
        np.testing.assert_array_equal(a.view(f"u{a.itemsize}"), b.view(f"u{b.itemsize}"), name)


def test_it_is_there():
    """The compiler of this machine has made the decoder, and usual files are read by it."""
    assert native.lib is not None
    for degree in REST:
        assert ply.Layout(make_rows(1, degree).dtype, REST[degree])._decoder is not None


@settings(deadline=None)
@given(
    degree=st.integers(0, 3),
    seed=st.integers(0, 2**32 - 1),
    size=st.sampled_from([1e-9, 1e-5, 0.05, 0.3, 3.0, 1e5, 1e30]),
    half=st.booleans(),
)
def test_the_bits_are_numpys(degree, seed, size, half):
    """Properties in any order and at odd addresses, numbers small and large."""
    rng = np.random.default_rng(seed)
    names = names_inria(degree)
    fields = [(name, "<f4") for name in names] + [("label", "u1"), ("area", "<f8")]
    rng.shuffle(fields)
    rows = np.zeros(40, [tuple(f) for f in fields])
    for name, column in raw_columns(40, degree, seed).items():
        rows[name] = column * (size if name.startswith("f_") else 1)
    for quat in ("rot_0", "rot_1", "rot_2", "rot_3"):
        rows[quat] *= size
    rows["x"] *= rng.choice([1e-45, 1, 1e37], 40)
    got, bound = in_c(rows.dtype, REST[degree], rows, half=half)
    expected, error, dropped = in_numpy(rows.dtype, REST[degree], rows, half=half)
    assert not dropped
    assert_same(got, expected)
    if half:
        assert bound == pytest.approx(error, rel=1e-5)
        assert (bound < SH_ERROR_MAX) == (error < SH_ERROR_MAX)
    else:
        assert bound == error == 0


@settings(deadline=None)
@given(
    patterns=st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=62),
    places=st.randoms(use_true_random=False),
)
@example(patterns=[0x7F800000], places=random.Random(0))
@example(patterns=[0xFFC00000], places=random.Random(1))
def test_any_bit_pattern_is_the_same_or_given_up(patterns, places):
    """C gives up if NumPy drops a row, and only then; else the bits are the same."""
    rows = make_rows(3, 3)
    numbers = rows.view(np.uint32).reshape(3, 62)
    for pattern in patterns:
        numbers[places.randrange(3), places.randrange(62)] = pattern
    for half in (False, True):
        got, bound = in_c(rows.dtype, 45, rows, half=half)
        expected, error, dropped = in_numpy(rows.dtype, 45, rows, half=half)
        assert (bound is None) == bool(dropped)
        if bound is not None:
            assert_same(got, expected)
            assert (bound < SH_ERROR_MAX) == (error < SH_ERROR_MAX)


def test_a_million_logarithms_and_logits():
    """exp and the sigmoid of random numbers over all of their ranges round to the same float32."""
    rng = np.random.default_rng(1)
    rows = make_rows(300_000, 0)
    for name in ("scale_0", "scale_1", "scale_2"):
        rows[name] = rng.uniform(-110, 88, len(rows))
    rows["opacity"] = rng.uniform(-800, 40, len(rows))
    rows["opacity"][:5] = [-np.inf, np.inf, 0, -0.0, 1e38]
    rows["scale_0"][:3] = [-np.inf, -1e38, 0]
    got, bound = in_c(rows.dtype, 0, rows)
    assert bound == 0
    assert_same(got, in_numpy(rows.dtype, 0, rows)[0])


def test_all_borders_between_halves_are_numpys():
    """Every float16, every half-way point and what is next to it, as NumPy's cast rounds them."""
    values = between_halves()
    rows = make_rows(len(values), 0)
    for channel in range(3):
        rows[f"f_dc_{channel}"] = values[:, 0, channel]
    got, bound = in_c(rows.dtype, 0, rows, half=True)
    with np.errstate(over="ignore"):
        expected = values.astype(np.float16)
    np.testing.assert_array_equal(got[4].view(np.uint16), expected.view(np.uint16))
    assert bound == np.inf  # 65520


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("x", np.nan), ("z", np.inf), ("scale_1", np.nan), ("scale_2", 89.0), ("scale_0", np.inf),
        ("rot_3", np.nan), ("rot_0", np.inf), ("rot_0", None), ("opacity", np.nan),
        ("f_dc_2", np.nan), ("f_rest_44", -np.inf),
    ],
)  # fmt: skip
@pytest.mark.parametrize("row", [0, 7])
def test_what_cannot_be_drawn_is_left_to_numpy(row, name, value):
    """One such number in any row, and no bound is given; without it, one is."""
    rows = make_rows(8, 3)
    assert in_c(rows.dtype, 45, rows)[1] is not None
    for column in ("rot_0", "rot_1", "rot_2", "rot_3") if value is None else (name,):
        rows[column][row] = value or 0
    assert in_c(rows.dtype, 45, rows)[1] is None


def test_rows_go_to_their_places():
    """Each to the one that is named, or one after the other from the first on; nowhere else."""
    rows = make_rows(60, 2)
    plain, _ = in_c(rows.dtype, 24, rows, half=True)
    places = np.random.default_rng(0).permutation(100)[:60].astype(np.int32)
    for to in (places, slice(17, 77)):
        got, _ = in_c(rows.dtype, 24, rows, half=True, to=to, capacity=100)
        others = np.setdiff1d(np.arange(100), np.arange(100)[to])
        assert_same([a[to] for a in got], plain)
        assert not any(a[others].any() for a in got)


@pytest.mark.parametrize("to", [slice(1, 9), slice(-1, 7), np.arange(8), -np.arange(8)])
def test_places_out_of_range_are_refused(to):
    """An error, not a write beyond the arrays."""
    rows = make_rows(8, 0)
    to = to if isinstance(to, slice) else to.astype(np.int32)
    capacity = 7 if isinstance(to, np.ndarray) and to[-1] > 0 else 8
    with pytest.raises(KernelError, match="out of range"):
        in_c(rows.dtype, 0, rows, to=to, capacity=capacity)


def test_offsets_out_of_range_are_refused():
    """A row ends where its stride says."""
    rows = make_rows(2, 0)
    arrays, _ = in_c(rows.dtype, 0, rows)
    for offset in (-1, rows.itemsize - 3):
        offsets = np.zeros(14, np.int32)
        offsets[-1] = offset
        with pytest.raises(KernelError, match="out of range"):
            native.Decoder(offsets, rows.itemsize)(rows, *arrays, slice(0, 2))


@pytest.mark.parametrize(
    ("types", "fmt"), [({"x": "double"}, LITTLE), ({"f_rest_3": "short"}, LITTLE), ({}, BIG)]
)
def test_other_numbers_are_left_to_numpy(tmp_path, types, fmt):
    """Neither doubles nor integers nor big-endian files are handed to C; they load all the same."""
    path = write_ply(tmp_path / "a.ply", raw_columns(5, 1), types=types, fmt=fmt)
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "Decoder", lambda *arguments: seen.append(arguments))
        assert len(load_scene(path)) == 5
        assert not seen
        load_scene(write_ply(tmp_path / "b.ply", raw_columns(5, 1)))
        assert seen


def loaded(path, **options):
    """The scene, or what the error says."""
    try:
        return load_scene(path, **options)
    except SceneError as error:
        return str(error)


def without_c(path, **options):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "lib", None)
        return loaded(path, **options)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    degree=st.integers(0, 3),
    faults=st.sampled_from([0, 0.002, 0.05, 0.9]),
    many=st.booleans(),
    fmt=st.sampled_from([LITTLE, TEXT]),
    options=st.fixed_dictionaries(
        {}, optional={"sh_float32": st.booleans(), "max_splats": st.sampled_from([1, 50, 99])}
    ),
)
def test_files_load_the_same_without_a_compiler(
    tmp_path, monkeypatch, seed, degree, faults, many, fmt, options
):
    """Arrays, numbers, what is dropped and whether float16 will do, of files with faults too."""
    monkeypatch.setattr(sweeps, "CHUNK", 7)
    monkeypatch.setattr(sweeps, "PIECE", 21)
    monkeypatch.setattr(curve, "ROWS_MIN", 40 if many else 10**6)
    rng = np.random.default_rng(seed)
    columns = raw_columns(100, degree, seed)
    for name in columns:
        if name.startswith("f_"):
            columns[name] *= 0.1
        columns[name][rng.random(100) < faults / 10] = rng.choice([np.nan, np.inf, 1e30])
    path = write_ply(tmp_path / "a.ply", columns, fmt=fmt)
    got, expected = loaded(path, **options), without_c(path, **options)
    if isinstance(expected, str):
        assert got == expected
        return
    assert_same([getattr(got, n) for n in ARRAYS], [getattr(expected, n) for n in ARRAYS])
    assert got.sh.dtype == expected.sh.dtype
    assert got.sh_error == pytest.approx(expected.sh_error, rel=1e-5)
    assert dict(got.dropped) == dict(expected.dropped)
    assert (got.numbers is None) == (expected.numbers is None)
    if got.numbers is not None:
        np.testing.assert_array_equal(got.numbers, expected.numbers)


@given(
    patterns=st.lists(st.integers(0, 2**32 - 1), min_size=3, max_size=300),
    limits=st.lists(st.floats(-(2.0**100), 2.0**100, width=32), min_size=6, max_size=6),
)
@example(patterns=[0x7F800000, 0xFF800000, 0x7FC00000], limits=[0.0] * 6)
@example(
    patterns=np.linspace(0, 9, 999, dtype="f4").view("u4").tolist(), limits=[0, 1, 2] + [99] * 3
)
def test_the_keys_are_numpys(patterns, limits):
    """Positions of any bit pattern, on any grid."""
    means = np.array(patterns[: len(patterns) // 3 * 3], np.uint32).view(np.float32).reshape(-1, 3)
    low, scale = np.array(limits, np.float32).reshape(2, 3)
    expected = curve_keys(means, low, scale)
    np.testing.assert_array_equal(native.curve_keys(means, low, scale), expected)


@pytest.mark.skipif(os.name != "posix", reason="guard pages need mmap and mprotect")
@pytest.mark.parametrize("side", ["begin", "end"])
@pytest.mark.parametrize("what", ["decode", "unpack"])
def test_it_stays_within_its_arrays(what, side):
    """With a guard page at this side of every array, the bits are the same as without."""
    args = what, side, random.randrange(2**32)
    run = child(*args, tests="io")
    assert run.returncode == 0, f"{args}: exit code {run.returncode}\n{run.stderr[-4000:]}"


@pytest.mark.skipif(os.name != "posix", reason="guard pages need mmap and mprotect")
@pytest.mark.parametrize("what", ["decode", "unpack"])
def test_a_row_too_many_dies(what):
    """The guard is real: told of one row more than there is, C ends the process."""
    assert child("overrun", what, tests="io").returncode in FAULTS


@pytest.mark.parametrize(("bits", "kept"), [(0x7D7FFFFF, True), (0x7D800000, False)])
@pytest.mark.parametrize("sign", [0, 0x80000000])
def test_coefficients_end_where_numpy_lets_them_end(bits, kept, sign):
    """FLT_MAX / 16 is drawn, the next float is not, by the C function as by NumPy."""
    rows = make_rows(3, 1)
    rows["f_rest_5"][1] = np.uint32(bits | sign).view(np.float32)
    _, bound = in_c(rows.dtype, REST[1], rows)
    *_, dropped = in_numpy(rows.dtype, REST[1], rows)
    assert (bound is not None) == kept == (not dropped)
