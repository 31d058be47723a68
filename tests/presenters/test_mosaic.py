"""Sets of block characters: what each looks like, and which one a cell gets."""

import itertools
import unicodedata

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tsplat.presenters.cells import token
from tsplat.presenters.mosaic import NOT_DRAWN, fit, mosaic
from tsplat.testing import decoders

SETS = ("quadrants", "sextants", "octants")


def characters(name):
    """Character -> its px [h, 2] in the set, ink 1, as the set's masks have it."""
    chars = mosaic(name)
    found = {}
    for mask, glyph, complement in zip(chars.masks, chars.glyphs, chars.complements, strict=True):
        px = mask.reshape(-1, 2)
        for code, share in ((glyph, px), (complement, 1 - px)):
            if code:
                found[int(code).to_bytes(4, "little").rstrip(b"\0").decode()] = share
    return found


@pytest.mark.parametrize("name", SETS)
def test_characters_look_as_unicode_says(name):
    """Each character's px are those that the decoder has from its Unicode name or chart."""
    coverage = decoders.block_coverage(mosaic(name).height)
    found = characters(name)
    assert {character: px.tolist() for character, px in found.items()} == {
        character: px.tolist() for character, px in coverage.items() if character in found
    }


@pytest.mark.parametrize(("name", "count"), [("quadrants", 22), ("sextants", 64), ("octants", 250)])
def test_how_many_there_are(name, count):
    """16 quadrants and six eighths more; 64; 256 less six that others show, colours exchanged."""
    found = characters(name)
    assert len(found) == count
    assert not NOT_DRAWN & {ord(character) for character in found}
    masks = mosaic(name).masks
    assert not masks[:, 0].any()
    assert len(np.unique(masks, axis=0)) == len(masks)


def test_octants_by_name():
    """The characters are in the order of the chart: the first is octant 3, the last all but 1."""
    coverage = decoders.block_coverage(4)
    assert len(coverage) == 256
    known = {0x1CD00: "3", 0x1CD01: "23", 0x1CDE5: "2345678"}
    if tuple(map(int, unicodedata.unidata_version.split("."))) >= (16, 0, 0):
        names = {code: unicodedata.name(chr(code)) for code in range(0x1CD00, 0x1CDE6)}
        known |= {code: name.removeprefix("BLOCK OCTANT-") for code, name in names.items()}
    for code, digits in known.items():
        expected = sum(1 << int(digit) - 1 for digit in digits)
        assert coverage[chr(code)].tolist() == decoders.squares(expected, 4).tolist()


@pytest.mark.parametrize("name", SETS)
def test_every_pattern_of_dots_has_its_character(name):
    """For dithering: bit by bit from left to right and from the top down."""
    chars = mosaic(name)
    coverage = decoders.block_coverage(chars.height)
    shown = {token(character): px for character, px in coverage.items()}
    for bits, glyph in enumerate(chars.dots):
        px = shown[int(glyph)][:: chars.height // chars.grid]
        assert px.tolist() == decoders.squares(bits, chars.grid).tolist()


def brute_force(cell, masks):
    """Least squared error of a cell [n, 3] over all splits."""
    best = np.inf
    for mask in masks.astype(bool):
        groups = [group for group in (cell[mask], cell[~mask]) if len(group)]
        best = min(best, sum(((group - group.mean(0)) ** 2).sum() for group in groups))
    return best


@pytest.mark.parametrize("name", SETS)
@given(data=st.data())
def test_the_best_of_all(name, data):
    """No other character, in any two colours, is nearer to a cell than the one that is chosen."""
    chars = mosaic(name)
    tones = data.draw(st.sampled_from([(0, 255), (0, 1), (3, 90, 200), tuple(range(256))]))
    cells = data.draw(
        hnp.arrays(np.uint8, (3, chars.height, 2, 3), elements=st.sampled_from(tones))
    )
    found = fit(cells, chars)
    for n in range(3):
        cell = cells[..., n].reshape(3, -1).T.astype(float)
        ink = chars.masks[found.splits[n]][:, None]
        shown = found.inks[:, n] * ink + found.papers[:, n] * (1 - ink)
        error = ((cell - shown) ** 2).sum()
        assert error == pytest.approx(brute_force(cell, chars.masks), rel=1e-4, abs=1e-2)


def test_any_two_colours_in_a_cell_are_kept_by_octants():
    """Each of the 256 patterns of two colours is found, however near the colours are."""
    chars = mosaic("octants")
    patterns = np.array(list(itertools.product((0, 1), repeat=8)), np.uint8)  # [256, 8]
    for dark, light in ((0, 255), (100, 101)):
        levels = (dark + patterns * (light - dark)).astype(np.uint8).T.reshape(4, 2, -1)
        cells = np.stack([levels, levels, np.full_like(levels, 7)])
        found = fit(cells, chars)
        ink = chars.masks[found.splits].T.reshape(4, 2, -1)
        shown = found.inks[:, None, None] * ink + found.papers[:, None, None] * (1 - ink)
        np.testing.assert_array_equal(np.rint(shown), cells)
