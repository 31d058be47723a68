"""What a terminal shows after a presenter's bytes: decoders of the built-in protocols.

Written to the specifications, each of them linked below, and knowing nothing of the encoders. A
decoder takes a whole session, payloads joined by :data:`~tsplat.testing.stream.HOME`, and returns
what is on the screen at the end. Where a rule is broken although the picture can be made out, it
says so in :class:`Decoded`; where no picture can be made out it raises.
"""

from __future__ import annotations

import binascii
import io
import re
import unicodedata
import zlib
from base64 import b64decode
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tsplat.core.errors import ContractError
from tsplat.core.types import U8
from tsplat.presenters.base import Terminal
from tsplat.testing.stream import Token, numbers, tokens

KITTY_CHUNK = 4096  # bytes of base64 in one sequence
KITTY_IDS = 1 << 31  # Konsole reads ids as signed
SIXEL_BAND = 6  # px
NOT_DRAWN = -1


@dataclass(frozen=True, eq=False)
class Decoded:
    """A picture, and the rules that were broken although it can be made out."""

    picture: U8  # [H, W, 3]
    faults: tuple[str, ...] = ()


Decoder = Callable[[bytes, Terminal], U8 | Decoded]
"""Bytes, sent to an empty screen with the cursor at home -> what is shown, [H, W, 3] uint8.

Raises ContractError where no picture can be made out.
"""


def decoded(decode: Decoder, data: bytes, terminal: Terminal) -> Decoded:
    """What ``decode`` makes of ``data``, whichever of the two it returns.

    Raises:
        ContractError: it made no picture of it.
    """
    result = decode(data, terminal)
    return result if isinstance(result, Decoded) else Decoded(result)


def _scaled(picture: U8, width: int, height: int) -> U8:
    """To ``width`` x ``height`` px, each with the colour that lies under its centre."""
    if min(width, height) < 1:
        raise ContractError(f"a picture scaled to {width}x{height} px")
    y = (2 * np.arange(height) + 1) * len(picture) // (2 * height)
    x = (2 * np.arange(width) + 1) * picture.shape[1] // (2 * width)
    return picture[y][:, x]


class _Canvas:
    """Pictures painted over each other from the top left corner on."""

    def __init__(self) -> None:
        self.pixels: NDArray[np.int16] = np.empty((0, 0, 3), np.int16)

    def paint(self, picture: NDArray[np.integer], top: int = 0) -> None:
        """From row ``top`` on; pixels of ``NOT_DRAWN`` keep what is there."""
        height = max(len(self.pixels), top + len(picture))
        width = max(self.pixels.shape[1], picture.shape[1])
        grown = np.full((height, width, 3), NOT_DRAWN, np.int16)
        grown[: len(self.pixels), : self.pixels.shape[1]] = self.pixels
        part = grown[top : top + len(picture), : picture.shape[1]]
        part[...] = np.where(picture == NOT_DRAWN, part, picture)
        self.pixels = grown

    def shown(self, terminal: Terminal, faults: list[str]) -> Decoded:
        height, width = self.pixels.shape[:2]
        if not self.pixels.size:
            raise ContractError("no picture is shown")
        if (self.pixels == NOT_DRAWN).any():
            raise ContractError(f"of {width}x{height} px some are never drawn")
        most_wide, most_high = terminal.pixels
        if width > most_wide or height > most_high:
            faults.append(
                f"the picture, {width}x{height} px, is larger than all rows but the last, "
                f"{most_wide}x{most_high} px"
            )
        return Decoded(self.pixels.astype(np.uint8), tuple(dict.fromkeys(faults)))


def _strings(data: bytes, start: bytes, what: str) -> Iterator[Token]:
    """The strings of ``data`` that begin with ``start``; cursor moves and erasure between them."""
    for token in tokens(data):
        if token.kind == "string" and token.body.startswith(start):
            yield token
        elif token.kind != "csi":  # those are the business of area_faults
            raise ContractError(f"between {what}: {token.kind} {token.body[:20]!r}")


def _base64(text: bytes) -> bytes:
    try:
        return b64decode(text, validate=True)
    except binascii.Error as error:
        raise ContractError(f"base64: {error}") from None


def _keys(text: bytes, separator: str) -> dict[str, str]:
    pairs = [pair.partition("=") for pair in text.decode("latin-1").split(separator)]
    for key, equals, _ in pairs:
        if not (key and equals):
            raise ContractError(f"expected key=value, got {key!r}")
    return {key: value for key, _, value in pairs}


# --- kitty: https://sw.kovidgoyal.net/kitty/graphics-protocol/


def kitty_commands(data: bytes, faults: list[str]) -> list[tuple[dict[str, str], bytes]]:
    """The graphics commands of ``data`` as (keys, payload), chunks joined.

    Appends to ``faults`` the rules for chunks that are broken: at most 4096 bytes of base64, a
    multiple of 4 in all but the last, none empty but the last, no keys but m and q after the first.

    Raises:
        ContractError: a payload is not base64, or its last chunk is missing.
    """
    commands: list[tuple[dict[str, str], bytes]] = []
    first: dict[str, str] | None = None
    body = b""
    for token in _strings(data, b"_G", "kitty's commands"):
        control, _, chunk = token.body[2:].partition(b";")
        keys = _keys(control, ",")
        if len(chunk) > KITTY_CHUNK:
            faults.append(f"a chunk of {len(chunk)} bytes; {KITTY_CHUNK} are allowed")
        if first is None:
            first, body = keys, b""
        elif not set(keys) <= {"m", "q"}:
            faults.append("keys other than m and q in a later chunk")
        more = keys.get("m", "0") == "1"
        if more and not chunk:
            faults.append("an empty chunk that is not the last")
        if more and len(chunk) % 4:
            faults.append("a chunk that is not the last ends within four bytes of base64")
        body += chunk
        if not more:
            commands.append((first, _base64(body)))
            first = None
    if first is not None:
        raise ContractError("the last chunk (m=0) is missing")
    return commands


Reader = Callable[[str, bytes], bytes | None]
"""Medium ("s" or "t") and name -> what it holds, which is gone then; None for nothing."""


def _read_nothing(medium: str, name: bytes) -> bytes | None:
    return None


def _kitty_pixels(keys: dict[str, str], payload: bytes, read: Reader) -> U8:
    """[H, W, 3] of a transmission; an alpha channel must be opaque."""
    if (medium := keys.get("t", "d")) != "d":
        found = read(medium, payload)
        if found is None:
            raise ContractError(f"t={medium}: there is nothing of the name {payload!r}")
        payload = found[: int(keys.get("S", len(found)))]
    if keys.get("f") == "100":
        return _picture_file(payload, ("PNG",))
    try:
        if keys.get("o") == "z":
            payload = zlib.decompress(payload)
        width, height = int(keys["s"]), int(keys["v"])
    except (zlib.error, KeyError, ValueError) as error:
        raise ContractError(f"transmitted data: {type(error).__name__}: {error}") from None
    channels = {"24": 3, "32": 4}.get(keys.get("f", "32"))
    if channels is None or len(payload) != width * height * channels:
        raise ContractError(
            f"f={keys.get('f', '32')}, {width}x{height} px, cannot be {len(payload)} bytes"
        )
    pixels = np.frombuffer(payload, np.uint8).reshape(height, width, channels)
    if channels == 4 and (pixels[..., 3] != 255).any():
        raise ContractError("pixels that are not opaque")
    return pixels[..., :3]


def kitty(data: bytes, terminal: Terminal, read: Reader = _read_nothing) -> Decoded:
    """Pictures transmitted and displayed (a=T), replaced and deleted, as kitty shows them.

    ``read`` finds what is not in the sequence itself (t=s, t=t).

    Also demanded: C=1, or a picture as large as the screen scrolls it; q=2, or the answer is typed
    into the program; an id below 2^31.
    """
    faults: list[str] = []
    shown: dict[tuple[str, str], U8] = {}
    for keys, payload in kitty_commands(data, faults):
        action, image = keys.get("a", "t"), keys.get("i", "0")
        if keys.get("q") != "2":
            faults.append("q=2 is missing: the terminal's answer would be taken for typing")
        if not image.isdigit() or int(image) >= KITTY_IDS:
            faults.append(f"i={image}: expected a number below 2^31")
        if action == "T":
            if keys.get("C") != "1":
                faults.append("C=1 is missing: the cursor moves, and a full screen scrolls")
            pixels = _kitty_pixels(keys, payload, read)
            if "U" not in keys and ("c" in keys or "r" in keys):
                if not (keys.get("c", "").isdigit() and keys.get("r", "").isdigit()):
                    raise ContractError("c and r: Konsole needs both, as numbers")
                width, height = (
                    int(keys["c"]) * terminal.cell_width,
                    int(keys["r"]) * terminal.cell_height,
                )
                pixels = _scaled(pixels, int(width), int(height))
            # Data for an id that is there already delete its placements first
            shown = {place: p for place, p in shown.items() if place[0] != image or image == "0"}
            shown[image, keys.get("p", str(len(shown)))] = pixels
        elif action == "d":
            what = keys.get("d", "a").lower()
            if what not in "ai":
                raise ContractError(f"d={keys['d']} is not understood by this decoder")
            shown = {place: p for place, p in shown.items() if what == "i" and place[0] != image}
        else:
            raise ContractError(f"a={action} is not understood by this decoder")
    canvas = _Canvas()
    for picture in shown.values():
        canvas.paint(picture)
    return canvas.shown(terminal, faults)


# --- iTerm2: https://iterm2.com/documentation-images.html


def _picture_file(file: bytes, forms: tuple[str, ...]) -> U8:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(file)) as picture:
            if picture.format not in forms:
                raise ContractError(f"expected {' or '.join(forms)}, got {picture.format}")
            return np.asarray(picture.convert("RGB"))
    except (UnidentifiedImageError, OSError) as error:
        raise ContractError(f"a picture file that cannot be read: {error}") from None


def iterm2_files(data: bytes) -> list[tuple[dict[str, str], bytes]]:
    """(keys, file) of each OSC 1337 File= of ``data``."""
    files = []
    for token in _strings(data, b"]1337;File=", "iTerm2's pictures"):
        control, _, text = token.body[len(b"]1337;File=") :].partition(b":")
        files.append((_keys(control, ";"), _base64(text)))
    return files


def iterm2(data: bytes, terminal: Terminal) -> Decoded:
    """Pictures painted over each other, each from the top left corner on.

    Also demanded: inline=1, or it is a download; size in bytes, or VS Code shows nothing; width and
    height in px as the file has them, so that nothing is scaled, or those of all rows but the last
    and preserveAspectRatio=0 (to Konsole 1: it has them the other way round), so that nothing is
    left out; both in cells where nobody said how large one is; doNotMoveCursor=1, or Konsole
    scrolls.
    """
    faults: list[str] = []
    canvas = _Canvas()
    for keys, file in iterm2_files(data):
        picture = _picture_file(file, ("JPEG", "PNG", "GIF"))
        wanted = {"inline": "1", "size": str(len(file)), "doNotMoveCursor": "1"}
        if "preserveAspectRatio" in keys:
            picture = _scaled(picture, *terminal.pixels)
            konsole = terminal.name.startswith("Konsole")
            wanted["preserveAspectRatio"] = "1" if konsole else "0"
        wanted["width"] = f"{picture.shape[1]}px"
        wanted["height"] = f"{len(picture)}px"
        if not terminal.cell_told:
            wanted["width"], wanted["height"] = (
                f"{terminal.columns}",
                f"{max(1, terminal.rows - 1)}",
            )
            picture = _scaled(picture, *terminal.pixels)
        for key, value in wanted.items():
            if keys.get(key) != value:
                faults.append(f"{key}: expected {value}, got {keys.get(key, 'nothing')}")
        canvas.paint(picture)
    return canvas.shown(terminal, faults)


# --- sixel: https://vt100.net/docs/vt3xx-gp/chapter14.html

_SIXEL = re.compile(
    rb'"(?P<raster>[0-9;]*)|#(?P<color>[0-9;]*)|!(?P<repeat>[0-9]+)(?P<repeated>[?-~])'
    rb"|(?P<data>[?-~])|(?P<back>\$)|(?P<next>-)"
)


def sixel_percent(body: bytes, terminal: Terminal, faults: list[str]) -> NDArray[np.int16]:
    """[H, W, 3] of one picture in percent, ``NOT_DRAWN`` where no sixel was set.

    ``body`` is what stands between DCS and ST. The size is that of the raster attributes.

    Raises:
        ContractError: a colour that is not defined, a value out of range, a pixel outside the
            raster, something that is no sixel data.
    """
    _, q, body = body.partition(b"q")
    at = 0
    registers: dict[int, list[int]] = {}
    color: list[int] | None = None
    picture: NDArray[np.int16] | None = None
    x = top = 0
    while at < len(body):
        token = _SIXEL.match(body, at)
        if not q or token is None:
            raise ContractError(f"no sixel data: {body[at : at + 20]!r}")
        at = token.end()
        if token["raster"] is not None:
            pan, pad, width, height = ([*numbers(token["raster"]), 0, 0, 0, 0])[:4]
            if (pan, pad) != (1, 1) or not width or not height:
                raise ContractError(f"raster attributes {token['raster']!r}: expected 1;1;W;H")
            picture = np.full((height, width, 3), NOT_DRAWN, np.int16)
        elif token["color"] is not None:
            number, *definition = numbers(token["color"]) or [0]
            if definition:
                if len(definition) != 4 or definition[0] != 2 or max(definition[1:]) > 100:
                    raise ContractError(
                        f"register {number}: expected 2;R;G;B with 0 to 100, got {definition}"
                    )
                registers[number] = definition[1:]
            if number not in registers:
                raise ContractError(f"register {number} is used before it is defined")
            color = registers[number]
        elif token["back"]:
            x = 0
        elif token["next"]:
            x, top = 0, top + SIXEL_BAND
        else:
            count = int(token["repeat"] or 1)
            bits = ord(token["repeated"] or token["data"]) - 63
            if picture is None or color is None:
                raise ContractError("sixels before raster attributes and a colour")
            if x + count > picture.shape[1] or top + bits.bit_length() > len(picture):
                raise ContractError("sixels outside the raster")
            for bit in range(bits.bit_length()):
                if bits >> bit & 1:
                    picture[top + bit, x : x + count] = color
            x += count
    if picture is None:
        raise ContractError("a sixel picture without raster attributes")
    if max(registers, default=0) >= 256 or len(registers) > terminal.sixel_registers:
        faults.append(
            f"{len(registers)} registers up to number {max(registers)}; the terminal has "
            f"{terminal.sixel_registers}, and beyond 256 few have any"
        )
    most_wide, most_high = terminal.sixel_max
    if picture.shape[1] > (most_wide or picture.shape[1]) or len(picture) > (
        most_high or len(picture)
    ):
        faults.append(f"larger than the terminal takes, {most_wide}x{most_high} px")
    return picture


def sixel(data: bytes, terminal: Terminal) -> Decoded:
    """Sixel pictures painted over each other, each from the cursor's cell on.

    A percent is 2.55 levels.

    Registers are private to a picture: some terminals keep the last picture's, some do not. A
    picture that is drawn over a part of another must end with a cell and a band, or with that
    other: a terminal may take away all of a cell, or draw all of a band.
    """
    faults: list[str] = []
    canvas = _Canvas()
    row = 0
    for token in tokens(data):
        if token.kind == "csi":
            if token.body.endswith(b"H"):
                row, column = ([n or 1 for n in numbers(token.body[:-1])] + [1, 1])[:2]
                if column != 1:
                    faults.append("a sixel picture that does not begin in the first column")
                row -= 1
            continue
        if token.kind != "string" or not token.body.startswith(b"P"):
            raise ContractError(f"between sixel pictures: {token.kind} {token.body[:20]!r}")
        percent = sixel_percent(token.body[1:], terminal, faults)
        shown = np.where(percent == NOT_DRAWN, NOT_DRAWN, np.rint(percent * 2.55))
        top = row * terminal.cell_height
        end = top + len(shown)
        if top != int(top):
            faults.append(f"a picture from px {top} on, and cells of {terminal.cell_height} px")
        if end < len(canvas.pixels) and (end % terminal.cell_height or len(shown) % SIXEL_BAND):
            faults.append(
                f"a picture within another that ends in the middle of a cell, at {end} px"
            )
        canvas.paint(shown.astype(np.int16), int(top))
    return canvas.shown(terminal, faults)


# --- characters: https://invisible-island.net/xterm/ctlseqs/ctlseqs.html (CUP, CUF, CR, LF, SGR)

Rgb = tuple[int, int, int]
Coverage = NDArray[np.float32]
"""The share of each px of a cell that is ink, [h, w], 0..1."""
_LEVELS = 0, 95, 135, 175, 215, 255
INK, PAPER = (255, 255, 255), (0, 0, 0)  # where no colour is set


def ansi_rgb(number: int) -> Rgb:
    """The sixteen colours as xterm has them by default (XTerm-col.ad)."""
    if number in (7, 8, 12):
        return {7: (229, 229, 229), 8: (127, 127, 127), 12: (92, 92, 255)}[number]
    high = 255 if number > 8 else 205
    r, g, b = (high * (number >> bit & 1) for bit in range(3))
    return r, g, 238 if number == 4 else b


def xterm_rgb(number: int) -> Rgb:
    """The 256 colours: 16 of the theme, a cube of 6x6x6, 24 greys (256colres.pl)."""
    if number < 16:
        return ansi_rgb(number)
    if number >= 232:
        grey = 8 + 10 * (number - 232)
        return grey, grey, grey
    r, g, b = (_LEVELS[(number - 16) // step % 6] for step in (36, 6, 1))
    return r, g, b


# Bits: the squares of a cell from left to right and from the top down, first the lowest
_QUARTERS = {name: 1 << n for n, name in enumerate(("UL", "UR", "LL", "LR"))}
_HALVES = {
    "LEFT HALF": "UL LL",
    "RIGHT HALF": "UR LR",
    "UPPER HALF": "UL UR",
    "LOWER HALF": "LL LR",
}
_EIGHTHS = {"ONE EIGHTH": 1, "ONE QUARTER": 2, "THREE EIGHTHS": 3, "HALF": 4, "FIVE EIGHTHS": 5,
            "THREE QUARTERS": 6, "SEVEN EIGHTHS": 7}  # fmt: skip
# Block octants that have a character of their own elsewhere, but for those of quadrants: Unicode
# 16, charts U1CC00 and U1FB00. One quarter of a half, a middle quarter, quarters of the whole.
_OTHER_OCTANTS = {
    "\U0001cea8": 0b00000001, "\U0001ceab": 0b00000010, "\U0001cea3": 0b01000000,
    "\U0001cea0": 0b10000000, "\U0001fbe6": 0b00010100, "\U0001fbe7": 0b00101000,
    "\U0001fb82": 0b00000011, "▂": 0b11000000, "\U0001fb85": 0b00111111, "▆": 0b11111100,
}  # fmt: skip


def squares(bits: int, high: int) -> Coverage:
    """Two by ``high`` squares as [high, 2]."""
    return np.array([[bits >> 2 * y + x & 1 for x in (0, 1)] for y in range(high)], np.float32)


def _grown(coverage: Coverage, high: int) -> Coverage:
    """The same with ``high`` rows, a multiple."""
    return coverage.repeat(high // len(coverage), 0)


@cache
def quadrant_coverage() -> dict[str, Coverage]:
    """Space, full block, halves and quadrants by their names, [2, 2]."""
    found = {" ": 0, "█": 15}
    for character in map(chr, range(0x2580, 0x25A0)):
        name = unicodedata.name(character).removeprefix("QUADRANT ").removesuffix(" BLOCK")
        if name in _HALVES:
            found[character] = sum(_QUARTERS[part] for part in _HALVES[name].split())
        elif " AND " in name or name.split()[-1] in ("LEFT", "RIGHT"):
            parts = name.split(" AND ")
            found[character] = sum(_QUARTERS["".join(w[0] for w in p.split())] for p in parts)
    return {character: squares(bits, 2) for character, bits in found.items()}


@cache
def block_coverage(high: int) -> dict[str, Coverage]:
    """Characters of a grid of 2 x ``high``: 2 halves, 3 sextants, 4 octants, 8 eighths."""
    if high == 3:
        found = {character: _grown(c, 6)[::2] for character, c in quadrant_coverage().items()
                 if (c[0] == c[1]).all()}  # fmt: skip
        for character in map(chr, range(0x1FB00, 0x1FB3C)):  # BLOCK SEXTANT-135
            digits = unicodedata.name(character).partition("-")[2]
            found[character] = squares(sum(1 << int(d) - 1 for d in digits), 3)
        return found
    found = {character: _grown(c, high) for character, c in quadrant_coverage().items()}
    if high == 8:
        for character in map(chr, range(0x2581, 0x2588)):  # LOWER THREE EIGHTHS BLOCK
            name = unicodedata.name(character).removeprefix("LOWER ").removesuffix(" BLOCK")
            found[character] = (np.arange(8) >= 8 - _EIGHTHS[name])[:, None].repeat(
                2, 1
            ) * np.float32(1)
    if high == 4:
        found |= {character: squares(bits, 4) for character, bits in _OTHER_OCTANTS.items()}
        taken = {c.tobytes() for c in found.values()}
        rest = [c for c in (squares(bits, 4) for bits in range(256)) if c.tobytes() not in taken]
        # BLOCK OCTANT-3 to BLOCK OCTANT-2345678, in the order of their bits
        found |= {chr(0x1CD00 + n): c for n, c in enumerate(rest)}
    return found


@cache
def braille_coverage() -> dict[str, Coverage]:
    """Dots as whole squares, [4, 2]. U+2800 and a number whose bits are the dots 1 to 8."""
    dots = ((0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1), (3, 0), (3, 1))
    found = {" ": np.zeros((4, 2), np.float32)}
    for number in range(256):
        coverage = np.zeros((4, 2), np.float32)
        for bit, place in enumerate(dots):
            coverage[place] = number >> bit & 1
        found[chr(0x2800 + number)] = coverage
    return found


@cache
def letter_coverage() -> dict[str, Coverage]:
    """Printable ASCII, [4, 2]; measured, see :mod:`tsplat.presenters.letters`."""
    from tsplat.presenters.letters import FIRST, ink

    return {chr(FIRST + n): row.reshape(4, 2) for n, row in enumerate(ink())}


class Cells:
    """A screen of cells that takes CUP, CUF, CR, LF, SGR and the characters of ``coverage``."""

    def __init__(
        self, columns: int, rows: int, coverage: dict[str, Coverage] | None = None
    ) -> None:
        halves = {c: v[:, :1] for c, v in quadrant_coverage().items() if (v[:, 0] == v[:, 1]).all()}
        self.coverage = halves if coverage is None else coverage
        self.high, self.wide = self.coverage[" "].shape
        self.pixels: U8 = np.zeros((self.high * rows, self.wide * columns, 3), np.uint8)
        self.drawn = np.zeros((rows, columns), bool)

    def feed(self, data: bytes) -> None:
        """From home on, in plain colours.

        Raises:
            ContractError: a cell outside the screen, or anything that draws but is not named above.
        """
        x = y = 0
        pen = [INK, PAPER]
        for token in tokens(data):
            values = numbers(token.body[:-1]) if token.kind == "csi" else []
            if token.kind == "text":
                for character in token.body.decode(errors="replace"):
                    self._put(x, y, character, pen)
                    x += 1
            elif token.body == b"\r":
                x = 0
            elif token.body == b"\n":
                y += 1
            elif token.kind != "csi":
                raise ContractError(f"not understood by this decoder: {token.body[:20]!r}")
            elif token.body.endswith(b"H"):
                y, x = (max(n, 1) - 1 for n in [*values, 1, 1][:2])
            elif token.body.endswith(b"C"):
                x += max([*values, 1][0], 1)
            elif token.body.endswith(b"m"):
                _sgr(values or [0], pen)
            # other sequences draw nothing; area_faults tells what they must not do

    def _put(self, x: int, y: int, character: str, pen: list[Rgb]) -> None:
        rows, columns = self.drawn.shape
        if not (0 <= x < columns and 0 <= y < rows):
            raise ContractError(f"column {x + 1}, row {y + 1}: outside {columns}x{rows} cells")
        if character not in self.coverage:
            raise ContractError(f"the character {character!r} is not one of this decoder's")
        share = self.coverage[character][:, :, None]
        ink, paper = (np.array(color, np.float32) for color in pen)
        cell = self.pixels[y * self.high :, x * self.wide :][: self.high, : self.wide]
        cell[...] = np.rint(paper + share * (ink - paper))
        self.drawn[y, x] = True

    def picture(self) -> U8:
        """The rectangle of cells that were printed.

        Raises:
            ContractError: it is none, or does not begin at the top left.
        """
        if not self.drawn.any():
            raise ContractError("no picture is shown")
        rows = int(self.drawn.any(1).sum())
        columns = int(self.drawn.any(0).sum())
        if not self.drawn[:rows, :columns].all():
            raise ContractError("cells are left out, or the picture does not begin at the top left")
        return self.pixels[: self.high * rows, : self.wide * columns]


def _sgr(values: list[int], pen: list[Rgb]) -> None:
    rest = list(values)
    while rest:
        n = rest.pop(0)
        layer = int(40 <= n <= 49 or n >= 100)
        base = n - 10 * layer
        if n == 0:
            pen[:] = [INK, PAPER]
        elif base == 38:
            kind = rest.pop(0) if rest else 0
            count = {2: 3, 5: 1}.get(kind, 0)
            if not count or len(rest) < count or max(rest[:count]) > 255:
                raise ContractError(f"SGR {values}: expected 2;R;G;B or 5;N after {n}")
            color, rest = rest[:count], rest[count:]
            pen[layer] = (color[0], color[1], color[2]) if kind == 2 else xterm_rgb(color[0])
        elif base == 39:
            pen[layer] = (INK, PAPER)[layer]
        elif 30 <= base <= 37:
            pen[layer] = ansi_rgb(base - 30)
        elif 90 <= base <= 97:
            pen[layer] = ansi_rgb(base - 82)
        else:
            raise ContractError(f"SGR {n} is not understood by this decoder")


def _shown(data: bytes, terminal: Terminal, coverage: dict[str, Coverage] | None) -> U8:
    screen = Cells(terminal.columns, max(1, terminal.rows - 1), coverage)
    screen.feed(data)
    return screen.picture()


def halfblock(data: bytes, terminal: Terminal) -> U8:
    """Half cells as pixels; the picture is the rectangle of cells that were printed."""
    return _shown(data, terminal, None)


def blocks(data: bytes, terminal: Terminal) -> U8:
    """Halves, quadrants and eighths, sextants or octants as ``terminal.glyphs`` says, as pixels."""
    high = {"halves": 2, "quadrants": 8, "sextants": 3, "octants": 4}[terminal.glyphs]
    return _shown(data, terminal, block_coverage(high) if high > 2 else None)


def braille(data: bytes, terminal: Terminal) -> U8:
    """Dots as pixels, whole squares; what fonts draw is smaller and rounder."""
    return _shown(data, terminal, braille_coverage())


def letters(data: bytes, terminal: Terminal) -> U8:
    """Printable ASCII as DejaVu Sans Mono has it, in eighths of a cell, the densest as full."""
    return _shown(data, terminal, letter_coverage())
