"""Fewer shades for slow links: how far off they may be, and what stays as it is."""

from __future__ import annotations

import numpy as np
import pytest

from tsplat.core.types import Frame
from tsplat.presenters.base import Terminal
from tsplat.presenters.enlarge import cropped, enlarged
from tsplat.presenters.halfblock import HALFBLOCK
from tsplat.presenters.kitty import KITTY
from tsplat.viewer.pace import Pace
from tsplat.viewer.shades import shaded


def frame(rgb):
    rgb = np.asarray(rgb, np.float32)
    return Frame(rgb, np.zeros(rgb.shape[:2], np.float32))


def photo(shift=0.0):
    """Smooth, all colours; ``shift`` moves it."""
    y, x = np.mgrid[0:66, 0:100] / 25.0
    waves = [np.sin(x + shift + k) * np.cos(y - k) for k in range(3)]
    return frame(np.stack(waves, -1) * 0.6 + 0.5)  # below 0 and above 1, too


@pytest.mark.parametrize("shades", [8, 16])
def test_a_new_picture_is_off_by_half_a_shade(shades):
    """At most; black and white are exact, and there are so many of each channel."""
    got = shaded(photo(), shades, None).rgb
    want = np.clip(photo().rgb, 0, 1)
    assert np.abs(got - want).max() <= 0.5 / (shades - 1) + 1e-6
    assert len(np.unique(got[..., 0])) == shades
    assert set(np.unique(shaded(frame([[[0, 1, 1]], [[-1, 2, 0]]]), shades, None).rgb)) == {0, 1}


@pytest.mark.parametrize("shades", [8, 16])
def test_what_is_nearly_right_stays(shades):
    """Most pixels of a picture that hardly moved; none is ever off by a shade."""
    before, now = shaded(photo(), shades, None), photo(0.02)
    got = shaded(now, shades, before)
    kept = (got.rgb == before.rgb).all(-1)
    assert kept.mean() > 0.95
    assert (shaded(now, shades, None).rgb == before.rgb).all(-1).mean() < kept.mean()
    for step in range(40):  # errors do not add up
        got = shaded(photo(0.02 * step), shades, got)
        wrong = np.abs(got.rgb - np.clip(photo(0.02 * step).rgb, 0, 1)).max()
        assert wrong <= 1 / (shades - 1) + 1e-6


def test_a_picture_of_another_size_does_not_matter():
    """After a resize."""
    got = shaded(photo(), 8, frame(np.zeros((4, 4, 3))))
    assert (got.rgb == shaded(photo(), 8, None).rgb).all()


@pytest.mark.parametrize(("presenter", "least"), [(HALFBLOCK, 0.6), (KITTY, 0.6)])
def test_fewer_shades_are_fewer_bytes(presenter, least):
    """Less than ``least`` of them with 16, and fewer still with 8."""
    terminal = Terminal(columns=100, rows=34, kitty=True)
    sizes = []
    for shades in (None, 16, 8):
        pictures = [photo(), photo(0.2)]
        if shades:
            pictures[0] = shaded(pictures[0], shades, None)
            pictures[1] = shaded(pictures[1], shades, pictures[0] if not presenter.fill else None)
        sizes.append(len(presenter.encode(pictures[1], terminal, pictures[0])))
    assert sizes[1] < least * sizes[0]
    assert sizes[2] < sizes[1]


def test_blocks_end_where_cells_do():
    """Repeated to what they cover and cropped: every cell of a block is as the others."""
    pace = Pace((100, 66), 30.0, far=True)
    rng = np.random.default_rng(1)
    for level in range(len(pace._levels)):
        if pace.shades(level) is None:
            continue
        width, height = pace.size(level)
        few = frame(rng.uniform(size=(height, width, 3)))
        got = cropped(enlarged(few, *pace.covered(level)), 100, 66).rgb
        block = pace.covered(level)[0] // width
        y, x = np.mgrid[0:66, 0:100]
        assert (got == few.rgb[y // block, x // block]).all()


def test_whole_cells_stay_or_none_of_their_pixels():
    """One px of a cell that is off, and all of it is new; the others' stay, coarse or not."""
    before = frame(np.full((8, 8, 3), 0.52))
    now = frame(np.full((8, 8, 3), 0.5))
    now.rgb[5, 3] = 0.9
    got = shaded(now, 16, before, (2, 4)).rgb
    assert (got[4:8, 2:4] == shaded(now, 16, None).rgb[4:8, 2:4]).all()
    got[4:8, 2:4] = before.rgb[4:8, 2:4]
    assert (got == before.rgb).all()
    alone = shaded(now, 16, before).rgb
    assert (alone != before.rgb).any(-1).sum() == 1
