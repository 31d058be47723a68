"""A presenter's bytes as a terminal reads them: sequences, and what they do to a screen of cells.

ECMA-48 as xterm has it: https://invisible-island.net/xterm/ctlseqs/ctlseqs.html . What is in a
picture's string (APC, DCS, OSC) is not looked into here; the decoders do that.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass

from tsplat.core.errors import ContractError
from tsplat.presenters.base import Terminal

HOME = b"\x1b[H"
"""The caller sends it before each of a presenter's payloads."""

_TOKEN = re.compile(
    rb"\x1b\[(?P<csi>[0-?]*[ -/]*[@-~])"
    rb"|\x1b(?P<string>\][^\x07\x18\x1a\x1b]*)(?:\x07|\x1b\\)"  # OSC: BEL or ST ends it
    rb"|\x1b(?P<string2>[PX^_][^\x18\x1a\x1b]*)\x1b\\"  # DCS, SOS, PM, APC: only ST does
    rb"|\x1b(?P<escape>[ -/]*[0-OQ-WYZ\\`-~])"
    rb"|(?P<control>[\x00-\x1a\x1c-\x1f\x7f])"
    rb"|(?P<text>[^\x00-\x1f\x7f]+)"
)
_NAMES = {"string2": "string"}
_PICTURES = re.compile(
    rb"_G|P[0-9;]*q|\]1337;(?:File=|MultipartFile=|FilePart=|FileEnd)|\]8;", re.DOTALL
)
"""Strings that show something: kitty, sixel, iTerm2; and hyperlinks."""

_VERTICAL = {"A": -1, "B": 1, "E": 1, "F": -1}
_HARMLESS = "KX"  # erase in the cursor's line


@dataclass(frozen=True)
class Token:
    """``csi``, ``escape``, ``string``, ``control`` or ``text``; ``body`` without its frame."""

    kind: str
    body: bytes  # csi: parameters and the final byte; string: from the byte after ESC on
    at: int  # where it begins


def tokens(data: bytes) -> Iterator[Token]:
    """The sequences and texts of ``data`` in order.

    Raises:
        ContractError: a sequence is not closed; it would swallow what follows.
    """
    at = 0
    while at < len(data):
        match = _TOKEN.match(data, at)
        if match is None:
            raise ContractError(f"the sequence {data[at : at + 12]!r} at byte {at} is never closed")
        kind = str(match.lastgroup)
        yield Token(_NAMES.get(kind, kind), match[kind], at)
        at = match.end()


def numbers(parameters: bytes) -> list[int]:
    """``1;;3`` as [1, 0, 3]; [] for none."""
    return [int(n) if n.isdigit() else 0 for n in parameters.split(b";")] if parameters else []


def columns_of(character: str) -> int:
    """Cells that ``character`` takes: 0, 1 or 2."""
    if unicodedata.category(character) in ("Mn", "Me", "Cf"):
        return 0
    if unicodedata.category(character) == "Cn":  # newer than Python's tables, as octants may be
        return 1
    return 2 if unicodedata.east_asian_width(character) in "WF" else 1


def area_faults(data: bytes, terminal: Terminal) -> tuple[str, ...]:
    """What ``data`` does, sent with the cursor at home, that a presenter may not do.

    It may move the cursor, set colours, print and show pictures, in all rows but the last (a
    screen of one row has no last). It may not clear, scroll, switch modes or ask, and leaves the
    colours as they were at first. Each kind of fault is told once.
    """
    walk = _Walk(terminal)
    try:
        for token in tokens(data):
            walk.take(token)
    except ContractError as error:
        walk.faults.append(str(error))
    if walk.pen and not walk.faults:
        walk.faults.append("colours are left set at the end: SGR 0 is missing")
    return tuple(dict.fromkeys(walk.faults))


class _Walk:
    """A cursor on its way through a stream."""

    def __init__(self, terminal: Terminal) -> None:
        self.columns, self.rows = terminal.columns, terminal.rows
        self.free = max(1, terminal.rows - 1)
        self.x = self.y = 0
        self.saved = 0, 0
        self.pen: set[int] = set()
        self.faults: list[str] = []

    def take(self, token: Token) -> None:
        getattr(self, f"_{token.kind}")(token.body)

    def _fault(self, text: str) -> None:
        self.faults.append(text)

    def _text(self, body: bytes) -> None:
        try:
            text = body.decode()
        except UnicodeDecodeError:
            self._fault("text that is not UTF-8")
            return
        for character in text:
            if "\x80" <= character <= "\x9f":
                self._fault(f"the control character U+{ord(character):04X}")
            self._print(columns_of(character))

    def _print(self, cells: int) -> None:
        if cells and self.y >= self.free:
            self._fault("something is printed in the last row, which is the viewer's")
        if self.x + cells > self.columns:
            self._fault("something is printed past the last column")
        self.x += cells

    def _control(self, body: bytes) -> None:
        if body == b"\r":
            self.x = 0
        elif body == b"\n":
            self.y += 1
            if self.y >= self.rows:
                self._fault("a line feed in the last row scrolls the screen")
                self.y = self.rows - 1
        else:
            self._fault(f"the control character {body!r}")

    def _escape(self, body: bytes) -> None:
        if body == b"7":
            self.saved = self.x, self.y
        elif body == b"8":
            self.x, self.y = self.saved
        elif body != b"\\":  # ST by itself ends nothing and does nothing
            self._fault(f"ESC {body.decode()} is not for presenters")

    def _string(self, body: bytes) -> None:
        if not _PICTURES.match(body):
            self._fault(f"the string {body[:12]!r} shows nothing: it asks, or sets something")

    def _csi(self, body: bytes) -> None:
        final = chr(body[-1])
        parameters = body[:-1]
        if not re.fullmatch(rb"[0-9;:]*", parameters):
            self._fault(f"CSI {body.decode()} switches a mode or asks")
            return
        values = numbers(parameters)
        n = max(1, values[0] if values else 1)
        if final in "Hf":
            row, column = [*values, 1, 1][:2]
            self.y, self.x = max(row, 1) - 1, max(column, 1) - 1
        elif final in _VERTICAL:
            self.y = min(max(self.y + _VERTICAL[final] * n, 0), self.rows - 1)
            if final in "EF":
                self.x = 0
        elif final in "CD":
            self.x = min(max(self.x + (n if final == "C" else -n), 0), self.columns - 1)
        elif final in "G`":
            self.x = n - 1
        elif final == "d":
            self.y = n - 1
        elif final == "b":  # the character before, n times
            self._print(n)
        elif final == "m":
            self._sgr(values if b":" not in parameters else [38])
        elif final in _HARMLESS:
            self._print(0)
        else:
            self._fault(f"CSI {body.decode()} clears, scrolls, switches a mode or asks")

    def _sgr(self, values: list[int]) -> None:
        rest = list(values or [0])
        while rest:
            n = rest.pop(0)
            if n in (38, 48):
                del rest[: {2: 4, 5: 2}.get(rest[0] if rest else 0, 0)]
            if n == 0:
                self.pen.clear()
            elif n in (39, 49, 59):
                self.pen.discard(n - 1)
            elif 22 <= n <= 29:
                self.pen -= {1, 2} if n == 22 else {n - 20}
            elif 30 <= n <= 37 or 90 <= n <= 97:
                self.pen.add(38)
            elif 40 <= n <= 47 or 100 <= n <= 107:
                self.pen.add(48)
            else:
                self.pen.add(n)
