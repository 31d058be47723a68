"""kitty's bytes, decoded again, are the frame."""

import re
import zlib
from base64 import b64encode
from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest
from pictures import frame_of, photo

from tsplat.presenters.base import Shared, Terminal
from tsplat.presenters.kitty import KITTY
from tsplat.testing import decoders
from tsplat.testing.presenting import Decoding, presenter_checks, terminals

ROOM = Terminal(columns=400, rows=100, kitty=True)


def commands(data):
    """The commands of a stream that breaks no rule for chunks."""
    faults = []
    found = decoders.kitty_commands(data, faults)
    assert faults == []
    return found


@pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 7), (64, 36), (255, 129)])
def test_pixels_arrive_exactly(width, height):
    """The decoded picture is the frame's 8-bit one, whatever its size."""
    image = photo(width, height)
    shown = decoders.kitty(KITTY.encode(frame_of(image), ROOM, None), ROOM)
    assert shown.faults == ()
    np.testing.assert_array_equal(shown.picture, image)


def test_keys_replace_in_place_and_stay_silent():
    """One image and one placement id for all frames, cursor kept (C=1), no answers (q=2)."""
    ids = set()
    for seed in (1, 2):
        [(keys, _)] = commands(KITTY.encode(frame_of(photo(8, 8, seed)), ROOM, None))
        assert (keys["a"], keys["C"], keys["q"]) == ("T", "1", "2")
        ids.add((keys["i"], keys["p"]))
    [(image_id, _)] = ids
    assert 0 < int(image_id) < 1 << 31


def test_chunks_are_short_and_the_first_has_data():
    """No base64 chunk is over 4096 bytes, all but the last are full; the decoder agrees."""
    data = KITTY.encode(frame_of(photo(200, 100)), ROOM, None)
    commands(data)
    chunks = re.findall(rb"m=([01]);([^\x1b]*)", data)
    assert len(chunks) > 2
    assert [more for more, _ in chunks] == [b"1"] * (len(chunks) - 1) + [b"0"]
    assert all(len(body) == 4096 for _, body in chunks[:-1])


def test_an_unchanged_picture_costs_nothing():
    """Frames equal at 8 bits send nothing; another size or pixel sends all."""
    image = photo(20, 10)
    frame = frame_of(image)
    assert KITTY.encode(frame, ROOM, frame_of(image)) == b""
    other = image.copy()
    other[3, 3, 1] ^= 1
    assert KITTY.encode(frame, ROOM, frame_of(other)) != b""
    assert KITTY.encode(frame, ROOM, frame_of(image[:-1])) != b""


def test_clear_deletes_that_image_and_its_data():
    """Clear is d=I with the id that encode uses."""
    [(sent, _)] = commands(KITTY.encode(frame_of(photo(2, 2)), ROOM, None))
    [(keys, _)] = commands(KITTY.clear(ROOM))
    assert (keys["a"], keys["d"], keys["i"]) == ("d", "I", sent["i"])


@pytest.mark.parametrize(
    ("terminal", "reason"),
    [
        (Terminal(), "query"),
        (Terminal(kitty=True, multiplexer="tmux"), "tmux"),
        (Terminal(kitty=True, tty=False), "not a terminal"),
    ],
)
def test_unsupported_says_why(terminal, reason):
    """Only a terminal that answered, with nothing in between, is sent pictures."""
    assert reason in KITTY.unsupported(terminal)
    assert KITTY.unsupported(ROOM) is None


def shelf():
    """Memory that a terminal and we both see: a way to share, and one to read."""
    held = {}

    def share(data):
        name = sha256(data).hexdigest().encode()
        held[name] = bytes(data)
        return Shared("s", b64encode(name))

    def read(medium, name):
        return held.get(name) if medium == "s" else None

    return share, read


def test_shared_memory():
    """Where memory is shared the frame goes there as it is, and a hundred bytes to the tty."""
    share, read = shelf()
    terminal = replace(ROOM, share=share)
    image = photo(64, 36)
    data = KITTY.encode(frame_of(image), terminal, None)
    assert len(data) < 200
    [(keys, _)] = commands(data)
    assert (keys["t"], keys["f"], keys["S"]) == ("s", "24", str(image.size))
    shown = decoders.kitty(data, terminal, read)
    assert shown.faults == ()
    np.testing.assert_array_equal(shown.picture, image)


def test_no_room_to_share():
    """When nothing can be shared after all, the bytes go into the sequence."""
    terminal = replace(ROOM, share=lambda data: None)
    image = photo(9, 7)
    shown = decoders.kitty(KITTY.encode(frame_of(image), terminal, None), terminal)
    np.testing.assert_array_equal(shown.picture, image)


def test_in_the_sequence():
    """A PNG, a quarter smaller at least than zlib makes the bare pixels."""
    image = photo(320, 180)
    [(keys, file)] = commands(KITTY.encode(frame_of(image), ROOM, None))
    assert keys["f"] == "100"
    assert len(file) < 0.75 * len(zlib.compress(image.tobytes(), 1))


@pytest.mark.parametrize(
    "name", ["size", "controls", "pure", "rounding", "stream", "shape", "picture", "changes"]
)
def test_conformance_with_shared_memory(name):
    """All that holds of bytes in the sequence holds of shared memory."""
    share, read = shelf()
    screens = terminals().map(lambda terminal: replace(terminal, share=share))
    decoding = Decoding(lambda data, terminal: decoders.kitty(data, terminal, read))
    [check] = [c for c in presenter_checks(KITTY, decoding, 40, screens) if c.name == name]
    check()
