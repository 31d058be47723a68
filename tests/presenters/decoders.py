"""What a terminal would make of a presenter's bytes: small decoders, written to the specifications.

They know nothing of the encoders, and fail on anything that a strict terminal might not take.
"""

import base64
import io
import re
import zlib

import numpy as np
from PIL import Image

KITTY_CHUNK = re.compile(rb"\x1b_G([^;\x1b]*)(?:;([A-Za-z0-9+/=]*))?\x1b\\")
SGR_TABLE = {38: 0, 48: 1}


def kitty(data):
    """Commands in order: (keys, payload), chunks joined; checks the rules for chunks."""
    commands, at, open_keys, body = [], 0, None, b""
    for match in KITTY_CHUNK.finditer(data):
        assert match.start() == at, f"stray bytes at {at}: {data[at : at + 20]!r}"
        at = match.end()
        keys = dict(pair.split("=") for pair in match.group(1).decode().split(","))
        chunk = match.group(2) or b""
        assert len(chunk) <= 4096, "chunk too long"
        if open_keys is None:
            open_keys, body = keys, b""
        else:
            assert set(keys) <= {"m", "q"}, "only m and q in later chunks"
        more = keys.get("m", "0") == "1"
        assert chunk or not more, "an empty chunk"
        assert not more or len(chunk) % 4 == 0, "only the last chunk may end anywhere"
        body += chunk
        if not more:
            commands.append((open_keys, base64.b64decode(body, validate=True)))
            open_keys = None
    assert at == len(data), f"stray bytes at {at}"
    assert open_keys is None, "the last chunk is missing"
    return commands


def kitty_picture(keys, payload):
    """The [H, W, 3] pixels that a transmission carries."""
    assert (keys["f"], keys["o"]) == ("24", "z")
    raw = zlib.decompress(payload)
    return np.frombuffer(raw, np.uint8).reshape(int(keys["v"]), int(keys["s"]), 3)


def iterm2(data):
    """(keys, pixels) of one OSC 1337 File."""
    match = re.fullmatch(rb"\x1b\]1337;File=([^:]*):([A-Za-z0-9+/=]*)(?:\x07|\x1b\\)", data)
    assert match, data[:80]
    keys = dict(pair.split("=") for pair in match.group(1).decode().split(";"))
    file = base64.b64decode(match.group(2), validate=True)
    assert int(keys["size"]) == len(file)
    picture = Image.open(io.BytesIO(file))
    return keys, picture.format, np.asarray(picture.convert("RGB"))


SIXEL = re.compile(
    rb'"(?P<raster>[0-9;]*)|#(?P<color>[0-9;]*)|!(?P<repeat>[0-9]+)(?P<repeated>[?-~])'
    rb"|(?P<data>[?-~])|(?P<back>\$)|(?P<next>-)"
)


def sixel(data):
    """The [H, W, 3] percent of each pixel, -1 where none was drawn; registers used undefined fail.

    The size is that of the raster attributes; a pixel outside fails.
    """
    match = re.fullmatch(rb"\x1bP([0-9;]*)q(.*)\x1b\\", data, re.DOTALL)
    assert match, data[:40]
    assert match.group(1) == b"0;1;0"
    body, at = match.group(2), 0
    registers, color, x, top, picture = {}, None, 0, 0, None
    while at < len(body):
        token = SIXEL.match(body, at)
        assert token, body[at : at + 20]
        at = token.end()
        kind = token.lastgroup
        if kind == "raster":
            pan, pad, width, height = map(int, token.group("raster").split(b";"))
            assert (pan, pad) == (1, 1)
            picture = np.full((height, width, 3), -1)
        elif kind == "color":
            number, *definition = map(int, token.group("color").split(b";"))
            assert number < 256
            if definition:
                kind, *registers[number] = definition
                assert kind == 2
                assert all(0 <= c <= 100 for c in registers[number])
            color = registers[number]  # KeyError: used before it is defined
        elif kind == "back":
            x = 0
        elif kind == "next":
            x, top = 0, top + 6
        else:
            count = int(token.group("repeat") or 1)
            bits = ord(token.group("repeated") or token.group("data")) - 63
            for bit in range(6):
                if bits >> bit & 1:
                    assert top + bit < len(picture)
                    assert x + count <= picture.shape[1]
                    picture[top + bit, x : x + count] = color
            x += count
    return picture


def sixel_pixels(data):
    """The picture as a terminal with 8 bits a channel shows it."""
    percent = sixel(data)
    assert (percent >= 0).all(), "pixels left out"
    return np.rint(percent * 2.55).astype(np.uint8)


class Cells:
    """A screen of cells that takes what halfblock.py sends: CUP, CUF, SGR, four characters."""

    def __init__(self, columns, rows):
        self.columns, self.rows = columns, rows
        self.upper = np.full((rows, columns), None, object)  # colour shown, None: default
        self.lower = self.upper.copy()

    def feed(self, data):
        """From home on; a character beyond the last column or row fails."""
        x = y = 0
        pen = [None, None]
        for match in re.finditer(r"\x1b\[([0-9;]*)([A-Za-z])|([^\x1b])", data.decode()):
            parameters, final, character = match.groups()
            numbers = [int(n) if n else 0 for n in (parameters or "").split(";")]
            if final == "H":
                y, x = (max(n, 1) - 1 for n in ([*numbers, 1][:2] if parameters else (1, 1)))
            elif final == "C":
                x += max(numbers[0], 1)
            elif final == "m":
                self._sgr(numbers, pen)
            else:
                assert final is None, final
                assert 0 <= x < self.columns, x
                assert 0 <= y < self.rows, y
                front, back = pen
                upper, lower = {
                    " ": (back, back), "▀": (front, back), "▄": (back, front), "█": (front, front)
                }[character]  # fmt: skip
                self.upper[y, x], self.lower[y, x] = upper, lower
                x += 1
        assert pen == [None, None], "colours left set"

    def _sgr(self, numbers, pen):
        numbers = list(numbers)
        while numbers:
            n = numbers.pop(0)
            if n == 0:
                pen[:] = [None, None]
            elif n in SGR_TABLE:
                kind = numbers.pop(0)
                count = {2: 3, 5: 1}[kind]
                pen[SGR_TABLE[n]] = (kind, *numbers[:count])
                del numbers[:count]
            elif 30 <= n <= 37 or 90 <= n <= 97:
                pen[0] = ("ansi", n - 30 if n < 90 else n - 82)
            elif 40 <= n <= 47 or 100 <= n <= 107:
                pen[1] = ("ansi", n - 40 if n < 100 else n - 92)
            else:
                raise AssertionError(f"SGR {n}")

    def halves(self):
        """[2 * rows, columns] of colours."""
        return np.stack([self.upper, self.lower], 1).reshape(2 * self.rows, self.columns)
