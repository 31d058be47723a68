"""kitty's pictures past tmux: what tmux passes on, and the cells that stand for the picture."""

import re
import unicodedata
from dataclasses import replace

import numpy as np
import pytest
from pictures import frame_of, photo

from tsplat.core.errors import ContractError
from tsplat.presenters.base import Terminal
from tsplat.presenters.kitty import KITTY
from tsplat.presenters.placeholders import IDS, MARKS, image_id, through_tmux
from tsplat.testing import decoders
from tsplat.testing.presenting import Decoding, presenter_checks, terminals

TMUX = Terminal(
    columns=40, rows=9, kitty=True, multiplexer="tmux", around="kitty(0.48.2)", placeholders=True
)
PASSED = re.compile(rb"\x1bPtmux;((?:[^\x1b]|\x1b\x1b)*)\x1b\\")
CELL = re.compile("\U0010eeee(.)(.)(.)")


def past_tmux(data):
    """What reaches the terminal around tmux by itself."""
    return b"".join(m.group(1).replace(b"\x1b\x1b", b"\x1b") for m in PASSED.finditer(data))


def seen_by_tmux(data):
    """What tmux takes for text and control sequences."""
    return PASSED.sub(b"", data)


def shown(data, terminal):
    """The picture that the cells on tmux's screen put together, as kitty does.

    Each cell shows the part of the picture that its marks name: the picture is cut into as many
    parts as the virtual placement has columns and rows.
    """
    faults = []
    commands = decoders.kitty_commands(past_tmux(data), faults)
    assert faults == []
    keys = commands[-1][0]
    assert all((k["a"], k["U"], k["q"]) == ("T", "1", "2") for k, _ in commands)
    columns, rows = int(keys["c"]), int(keys["r"])
    placed = {}
    y = x = color = 0
    for token in re.finditer("\x1b\\[([0-9;]*)([Hm])|" + CELL.pattern, seen_by_tmux(data).decode()):
        numbers, final, *marks = token.groups()
        if final == "H":
            y, x = (int(n) - 1 for n in ((numbers or "1;1").split(";")))
        elif final == "m":
            color = int(numbers.removeprefix("38;5;")) if numbers.startswith("38;5;") else 0
        else:
            row, column, top = map(MARKS.index, marks)
            assert int(keys["i"]) == top << 24 | color
            placed[y, x] = row, column
            x += 1
    whole = {(y, x): (y, x) for y in range(rows) for x in range(columns)}
    if placed != whole:
        raise ContractError("the cells do not show the picture's parts in their places")
    plain = b"\x1b_Ga=T,C=1," + past_tmux(data).rsplit(b"\x1b_Ga=T,U=1,", 1)[1]
    return decoders.kitty(plain, replace(terminal, multiplexer=""))


def test_marks_are_kittys():
    """As its table is made: 297 marks above the base, in order, that do not melt into letters."""
    assert len(MARKS) == 297
    assert sorted(set(MARKS)) == list(MARKS)
    assert all(unicodedata.combining(mark) == 230 for mark in MARKS)
    assert all(len(unicodedata.normalize("NFC", f"a{mark}")) == 2 for mark in MARKS)
    assert (ord(MARKS[0]), ord(MARKS[1]), ord(MARKS[296])) == (0x305, 0x30D, 0x1D244)


def test_through_tmux():
    """Every ESC inside is doubled, none outside."""
    assert through_tmux(b"\x1b_Ga\x1b\\") == b"\x1bPtmux;\x1b\x1b_Ga\x1b\x1b\\\x1b\\"


def test_the_picture_arrives():
    """Past tmux goes the picture, exactly; on its screen each cell names its part."""
    image = photo(400, 160)
    data = KITTY.encode(frame_of(image), TMUX, None)
    np.testing.assert_array_equal(shown(data, TMUX).picture, image)


def test_a_picture_that_stays_keeps_its_id():
    """Others under one of their own each; what moves later takes none of them away."""
    pictures = [frame_of(photo(40, 40, seed)) for seed in range(20)]
    ids = set()
    for frame in pictures:
        data = KITTY.still(frame, TMUX)
        assert data == KITTY.still(frame, TMUX)
        np.testing.assert_array_equal(shown(data, TMUX).picture, frame.to_uint8())
        ids |= {k["i"] for k, _ in decoders.kitty_commands(past_tmux(data), [])}
    moving = decoders.kitty_commands(past_tmux(KITTY.encode(pictures[0], TMUX, None)), [])
    assert len(ids) == len(pictures)
    assert moving[0][0]["i"] not in ids


def test_ids_differ_and_can_be_told_by_cells():
    """Two bytes each, a colour of the fixed ones of 256 and a mark; below 2^31."""
    ids = [image_id(number) for number in range(IDS)]
    assert len(set(ids)) == IDS
    for image in ids:
        assert 1 <= image >> 24 < 128
        assert 16 <= image & 0xFFFFFF <= 255


@pytest.mark.parametrize(
    ("name", "hint"),
    [("kitty(0.48.2)", True), ("kitty(0.47.9)", False), ("kitty(1.0.0)", True), ("", False),
     ("Konsole 26.08.2", False)],
)  # fmt: skip
def test_kitty_need_not_keep_moving_pictures(name, hint):
    """From 0.48 on it is told so, past tmux as well; not of one that stays."""
    frame = frame_of(photo(40, 40))
    for terminal in (replace(TMUX, around=name), replace(TMUX, multiplexer="", name=name)):
        sent = [KITTY.encode(frame, terminal, None), KITTY.fill(frame, terminal, None)]
        for data in sent:
            [(keys, _)] = decoders.kitty_commands(past_tmux(data) or data, [])
            assert keys.get("N") == ("1" if hint else None)
        assert b"N=1" not in KITTY.still(frame, terminal)


def test_cells_are_written_once():
    """A frame after the first writes no cells; one of another size does."""
    image = photo(400, 160)
    first = frame_of(image)
    data = KITTY.encode(frame_of(image[::-1]), TMUX, first)
    assert seen_by_tmux(data) == b""
    assert past_tmux(data)
    assert seen_by_tmux(KITTY.encode(frame_of(image[:80]), TMUX, first)) != b""


def test_cells_are_written_once_for_fewer_pixels_too():
    """Frames of few pixels after each other, and the full size after them, write no cells."""
    few, other, full = (frame_of(photo(w, h, w)) for w, h in ((100, 40), (50, 20), (400, 160)))
    assert seen_by_tmux(KITTY.fill(few, TMUX, None)) != b""
    for fill, frame, before in (
        (KITTY.fill, few, full), (KITTY.fill, other, few), (KITTY.encode, full, other),
    ):  # fmt: skip
        data = fill(frame, TMUX, before)
        assert seen_by_tmux(data) == b""
        [(keys, _)] = decoders.kitty_commands(past_tmux(data), [])
        assert (keys["c"], keys["r"]) == ("40", "8")


def test_size_is_held_to_the_marks():
    """297 columns and rows at most, however large the screen is."""
    huge = replace(TMUX, columns=500, rows=400)
    width, height = KITTY.size(huge)
    assert (width, height) == (297 * 10, 297 * 20)
    data = KITTY.encode(frame_of(np.zeros((height, width, 3), np.uint8)), huge, None)
    assert shown(data, huge).picture.shape == (height, width, 3)


def test_clear_goes_past_tmux():
    """It deletes the image that encode names."""
    data = KITTY.encode(frame_of(photo(20, 20)), TMUX, None)
    [(sent, _)] = decoders.kitty_commands(past_tmux(data), [])
    [(keys, _)] = decoders.kitty_commands(past_tmux(KITTY.clear(TMUX)), [])
    assert (keys["a"], keys["d"], keys["i"]) == ("d", "I", sent["i"])
    assert seen_by_tmux(KITTY.clear(TMUX)) == b""


@pytest.mark.parametrize(
    ("terminal", "reason"),
    [
        (replace(TMUX, kitty=False), "does not let"),
        (replace(TMUX, kitty=False, advice="do this"), "do this"),
        (replace(TMUX, placeholders=False, around="WezTerm 1"), "WezTerm 1, around tmux"),
    ],
)
def test_unsupported_says_why(terminal, reason):
    """What tmux lets through, and what is around it, decide."""
    assert reason in KITTY.unsupported(terminal)
    assert KITTY.unsupported(TMUX) is None


@pytest.mark.parametrize("name", ["size", "controls", "pure", "rounding"])
def test_conformance(name):
    """What tmux sees breaks no rule for presenters: cells within the area, colours set back."""
    seen = replace(
        KITTY,
        encode=lambda *given: seen_by_tmux(KITTY.encode(*given)),
        clear=lambda terminal: seen_by_tmux(KITTY.clear(terminal)),
    )
    screens = terminals().map(
        lambda t: replace(t, multiplexer="tmux", around="kitty(0.48.2)", placeholders=True)
    )
    [check] = [c for c in presenter_checks(seen, None, 40, screens) if c.name == name]
    check()


def test_conformance_of_the_picture():
    """The picture checks hold of any frame on any screen."""
    screens = terminals().map(
        lambda t: replace(t, multiplexer="tmux", around="kitty(0.48.2)", placeholders=True)
    )
    for check in presenter_checks(KITTY, Decoding(shown), 40, screens):
        if check.name in ("shape", "picture"):
            check()
