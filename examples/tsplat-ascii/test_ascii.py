"""A presenter is pure, so its test needs no terminal."""

import numpy as np
import pytest
from tsplat_ascii import ASCII, encode, size

from tsplat import Frame, Terminal
from tsplat.testing.presenting import presenter_checks


def test_bright_is_dense():
    terminal = Terminal(columns=3, rows=3)
    width, height = size(terminal)
    rgb = np.zeros((height, width, 3), np.float32)
    rgb[0, 1], rgb[1, 2] = 0.5, 1.0
    shown = encode(Frame(rgb, np.zeros((height, width), np.float32)), terminal, None)
    assert shown == b" + \r\n  @"


@pytest.mark.parametrize("check", presenter_checks(ASCII), ids=str)
def test_conformance(check):
    check()
