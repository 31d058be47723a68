"""Bytes from the terminal and the events made of them."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsplat.terminal.events import Decoder, Event

KEYS = {
    b"a": "a", b" ": " ", b"~": "~", "é".encode(): "é", "🙂".encode(): "🙂",
    b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left",
    b"\x1bOA": "up", b"\x1bOH": "home", b"\x1bOF": "end", b"\x1b[H": "home", b"\x1b[F": "end",
    b"\x1b[1~": "home", b"\x1b[3~": "delete", b"\x1b[5~": "pageup", b"\x1b[6~": "pagedown",
    b"\x1b[1;5A": "ctrl+up", b"\x1b[1;2D": "shift+left", b"\x1b[5;3~": "alt+pageup",
    b"\x1b[Z": "shift+tab", b"\x1b[1;2Z": "shift+tab", b"\t": "tab", b"\r": "enter",
    b"\n": "enter", b"\x7f": "backspace", b"\x08": "backspace", b"\x03": "ctrl+c",
    b"\x1a": "ctrl+z", b"\x00": "ctrl+space", b"\x1bx": "alt+x", b"\x1b\r": "alt+enter",
    b"\x1bOP": "f1", b"\x1b[15~": "f5", b"\x1b[24~": "f12", b"\x1b[1;2R": "shift+f3",
    b"\x1bOM": "enter",
}  # fmt: skip

CTRL = frozenset({"ctrl"})
MOUSE = {
    b"\x1b[<0;1;1M": Event("mouse", action="press", button="left"),
    b"\x1b[<2;10;5m": Event("mouse", action="release", button="right", x=9, y=4),
    b"\x1b[<32;300;200M": Event("mouse", action="drag", button="left", x=299, y=199),
    b"\x1b[<64;3;4M": Event("mouse", action="wheel", button="up", x=2, y=3),
    b"\x1b[<81;3;4M": Event("mouse", action="wheel", button="down", x=2, y=3, modifiers=CTRL),
    b"\x1b[M !!": Event("mouse", action="press", button="left"),
    b"\x1b[M#\"#": Event("mouse", action="release", x=1, y=2),
}  # fmt: skip

ANSWERS = [
    b"\x1b_Gi=31;OK\x1b\\",
    b"\x1bP>|kitty(0.48.2)\x1b\\",
    b"\x1b]1337;ReportCellSize=19.0;10.0;1.0\x07",
    b"\x1b]10;rgb:dddd/dddd/dddd\x1b\\",
    b"\x1b[?62;4;22c",
    b"\x1b[?2026;2$y",
    b"\x1b[4;570;900t",
    b"\x1b[?1;0;256S",
    b"\x1b[?0u",
    b"\x1bP1$r0;48:2::1:2:3m\x1b\\",
]


def decode(*pieces):
    decoder = Decoder()
    events = [event for piece in pieces for event in decoder.feed(piece)]
    return events + decoder.flush()


@pytest.mark.parametrize("data", KEYS)
def test_keys(data):
    """Each key's bytes, in both cursor modes and with modifiers, have one name."""
    assert decode(data) == [Event("key", KEYS[data])]


@pytest.mark.parametrize("data", MOUSE)
def test_mouse(data):
    """SGR and X10 reports: cells count from 0, motion with a button down is a drag."""
    assert decode(data) == [MOUSE[data]]


def test_motion_without_a_button_is_nothing():
    """Nor are buttons beyond the wheel, and wheels have no release."""
    assert decode(b"\x1b[<35;3;4M\x1b[<128;3;4M\x1b[<64;3;4m") == []


@pytest.mark.parametrize("data", ANSWERS)
def test_answers_are_no_keys(data):
    """An answer, whenever it comes, is set aside whole."""
    decoder = Decoder()
    assert decoder.feed(b"a" + data + b"b") == [Event("key", "a"), Event("key", "b")]
    assert bytes(decoder.answers) == data


def test_device_status_is_ready():
    """CSI 0 n, the answer to CSI 5 n, is the event "ready"."""
    assert decode(b"\x1b[0n") == [Event("ready")]


def test_a_lone_escape_waits_for_flush():
    """ESC is the beginning of something until flush says nothing more came."""
    decoder = Decoder()
    assert decoder.feed(b"\x1b") == []
    assert decoder.pending
    assert decoder.flush() == [Event("key", "escape")]
    assert not decoder.pending
    assert decode(b"\x1b[") == [Event("key", "alt+[")]
    assert decode(b"\x1b\x1b") == [Event("key", "escape"), Event("key", "escape")]


def test_flush_keeps_a_half_sent_report():
    """A slow mouse report or answer is not typed into the program."""
    decoder = Decoder()
    decoder.feed(b"\x1b[<0;1")
    assert decoder.flush() == []
    assert decoder.feed(b"2;3M") == [Event("mouse", action="press", button="left", x=11, y=2)]


@pytest.mark.parametrize("start", [b"\x1b[", b"\x1b[<0;1", b"\x1bP", b"\x1b]x", b"\x1b_G", b"\x1b",
                                   b"\x1bO", b"\xc3"])  # fmt: skip
def test_ctrl_c_always_gets_through(start):
    """Garbage before it cannot swallow Ctrl+C."""
    assert decode(start + b"\x03")[-1] == Event("key", "ctrl+c")


def test_endless_strings_end():
    """A string that is never closed is dropped after 64 kB, and keys work again."""
    decoder = Decoder()
    for _ in range(70):
        events = decoder.feed(b"\x1bP" + b"x" * 1024 if _ == 0 else b"x" * 1024)
    assert events[-1] == Event("key", "x")


def test_invalid_utf8_is_dropped():
    """Bytes that are no character vanish; what follows is read."""
    assert decode(b"\xff\xc3(\xe2\x82a\xf5") == [Event("key", "("), Event("key", "a")]


PIECES = st.sampled_from([*KEYS, *MOUSE, *ANSWERS, b"\x1b[0n"]) | st.binary(max_size=6)


@given(st.lists(PIECES, max_size=8).map(b"".join), st.data())
def test_any_split_gives_the_same_events(data, draw):
    """Events do not depend on how the bytes arrive."""
    cuts = sorted(draw.draw(st.lists(st.integers(0, len(data)), max_size=6)))
    edges = [0, *cuts, len(data)]
    assert decode(*(data[a:b] for a, b in pairwise(edges))) == decode(data)


@given(st.lists(st.sampled_from([*KEYS, *MOUSE]), max_size=8))
def test_sequences_are_independent(parts):
    """One after another gives the events of each, in order."""
    expected = [Event("key", KEYS[part]) if part in KEYS else MOUSE[part] for part in parts]
    assert decode(b"".join(parts)) == expected
