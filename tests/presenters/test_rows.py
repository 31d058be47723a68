"""What holds for every built-in presenter."""

import subprocess
import sys

import pytest
from pictures import frame_of, photo

from tsplat.presenters import blocks, braille, halfblock, iterm2, kitty, letters, sixel
from tsplat.presenters.base import Terminal

MODULES = kitty, iterm2, sixel, blocks, halfblock, braille, letters
ROWS = [row for module in MODULES for row in module.tsplat_presenters()]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (80, 24)])
def test_size_fits_above_the_last_row(row, shape):
    """A frame of ``size`` is above the last row, except on screens of one or two rows."""
    terminal = Terminal(*shape, kitty=True, iterm2=True, sixel=True)
    width, height = row.size(terminal)
    assert width >= 1
    assert height >= 1
    if shape == (80, 24):
        across, down = row.pixel(terminal)
        assert width * across <= 800
        assert height * down <= 23 * 20
    assert row.encode(frame_of(photo(width, height)), terminal, None)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_encoding_is_a_function(row):
    """The same frame gives the same bytes."""
    frame, terminal = frame_of(photo(30, 20)), Terminal()
    assert row.encode(frame, terminal, None) == row.encode(frame, terminal, None)


def test_ranks_differ():
    """``auto`` is never in doubt."""
    assert len({row.rank for row in ROWS}) == len(ROWS)


def test_imports_are_cheap():
    """Listing presenters loads neither Pillow nor a backend, and the terminal part no NumPy."""
    code = (
        "import sys, tsplat.terminal; assert 'numpy' not in sys.modules;"
        "import tsplat.presenters.kitty, tsplat.presenters.iterm2, tsplat.presenters.sixel,"
        "tsplat.presenters.blocks, tsplat.presenters.braille, tsplat.presenters.letters;"
        "assert not {'PIL', 'numba'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
