"""Every built-in presenter under the checks that any presenter must pass."""

import numpy as np
import pytest

from tsplat.core.errors import ContractError
from tsplat.plugins import plugins
from tsplat.presenters.base import Terminal
from tsplat.presenters.cells import palette
from tsplat.testing import decoders
from tsplat.testing.presenting import DECODINGS, presenter_checks
from tsplat.testing.stream import area_faults, tokens

CHECKS = [
    check
    for name, decoding in DECODINGS.items()
    for check in presenter_checks(plugins().presenters[name], decoding, max_examples=40)
]
SCREEN = Terminal(columns=4, rows=3)


@pytest.mark.parametrize("check", CHECKS, ids=str)
def test_conformance(check):
    """The presenter does what the viewer relies on."""
    check()


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (b"\x1b[2J", "clears"),
        (b"\x1b[?7l", "mode"),
        (b"\x1b[5n", "asks"),
        (b"\x1bc", "not for presenters"),
        (b"\x07", "control character"),
        (b"\x1b]0;title\x07", "shows nothing"),
        (b"\x1b[3;1Hx", "last row"),
        (b"abcde", "last column"),
        ("\uff21\uff21\uff21".encode(), "last column"),
        (b"\n\n\n", "scrolls"),
        (b"\x1b[31mx", "left set"),
        (b"\x1b_Ga=T;AAAA", "never closed"),
        (b"\xff", "UTF-8"),
        ("\u009b".encode(), "U+009B"),
    ],
)
def test_what_a_presenter_may_not_do(data, part):
    """Each forbidden thing is found, alone and with a picture before it."""
    [fault] = area_faults(data, SCREEN)
    assert part in fault
    assert part in area_faults(b"\x1b[H\x1b[1;38;2;1;2;3mabc\x1b[m\r\nabcd\x1b[H" + data, SCREEN)[0]


def test_what_it_may():
    """Moves, colours, texts and pictures in all rows but the last are no faults."""
    data = b"\x1b[Hab\x1b[2;3H\x1b[7;38;5;9mc\x1b[27;39md\x1b[2A\x1b[3D\x1b7\x1b8\x1b[3b\r"
    assert area_faults(data + b"\x1b_Ga=T;AAAA\x1b\\\x1bP0;1;0q~\x1b\\", SCREEN) == ()
    assert [t.kind for t in tokens(b"a\x1b[1m\x1b]8;;x\x07\r\x1b7")] == [
        "text", "csi", "string", "control", "escape",
    ]  # fmt: skip


def test_the_decoders_colours_are_the_presenters():
    """Two tables of xterm's colours, written apart, agree."""
    assert (np.array([decoders.xterm_rgb(n) for n in range(16, 256)]) == palette(256)).all()
    assert (np.array([decoders.ansi_rgb(n) for n in range(16)]) == palette(16)).all()


@pytest.mark.parametrize("decode", [d.decode for d in DECODINGS.values()])
@pytest.mark.parametrize(
    "data", [b"", b"\x1b[H", b"\x1b_Gq=2\x1b\\", b"\x1bPq!\x1b\\", b"\x1b]1337;File=:\x07"]
)
def test_no_picture_is_an_error(decode, data):
    """Where no picture can be made out, a decoder raises and returns nothing."""
    with pytest.raises(ContractError):
        decode(data, SCREEN)
