"""Keys, mouse and answers out of the bytes a terminal sends.

A :class:`Decoder` takes the bytes as they come, in any pieces, and makes the same events of them.
Sources: https://invisible-island.net/xterm/ctlseqs/ctlseqs.html (keys, mouse modes 1000 to 1006,
DSR); the shape of control sequences is ECMA-48's, section 5.4.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

ESC = 0x1B
BEL = 0x07
STRING_LIMIT = 1 << 16  # bytes; no answer we ask for is longer, so it is noise
_STRINGS = frozenset(b"P]_^X")  # DCS, OSC, APC, PM, SOS: a string up to ST

# CSI parameters, intermediates, final byte
_CSI = re.compile(rb"\x1b\[([0-?]*)([ -/]*)([@-~])")
_CSI_PART = re.compile(rb"\x1b\[[0-?]*[ -/]*")
_MOUSE = re.compile(rb"<(\d{1,6});(\d{1,6});(\d{1,6})")

_LETTERS = {
    **dict(zip("ABCDHF", ("up", "down", "right", "left", "home", "end"), strict=True)),
    **dict(zip("PQRS", ("f1", "f2", "f3", "f4"), strict=True)),
    "M": "enter",  # SS3 M: the keypad's Enter
    "Z": "shift+tab",
}
_NUMBERS = {
    **dict(
        zip(
            (1, 2, 3, 4, 5, 6, 7, 8),
            ("home", "insert", "delete", "end", "pageup", "pagedown", "home", "end"),
            strict=True,
        )
    ),
    **dict(
        zip(
            (11, 12, 13, 14, 15, 17, 18, 19, 20, 21, 23, 24),
            (f"f{n}" for n in range(1, 13)),
            strict=True,
        )
    ),
}
_CONTROLS = {
    0x00: "ctrl+space",
    0x08: "backspace",
    0x09: "tab",
    0x0A: "enter",
    0x0D: "enter",
    0x1C: "ctrl+\\",
    0x1D: "ctrl+]",
    0x1E: "ctrl+^",
    0x1F: "ctrl+_",
    0x7F: "backspace",
    **{n: f"ctrl+{chr(n + 96)}" for n in range(1, 27) if n not in (8, 9, 10, 13)},
}
_BUTTONS = ("left", "middle", "right")
_WHEEL = ("up", "down", "left", "right")


@dataclass(frozen=True)
class Event:
    """Something that happened at the terminal.

    ``kind`` is "key" (with ``key``), "mouse" (with ``action``, ``button``, ``x``, ``y``,
    ``modifiers``), "resize" (sizes changed or the screen was lost: draw everything again),
    "ready" (the frame sent last was taken), "terminal" (late answers changed what is known of
    the terminal), "watched" (there is something to read where :attr:`Screen.watched` points) or
    whatever another thread has posted.
    """

    kind: str
    key: str = ""  # a printable character, or a name such as "up", "shift+tab", "ctrl+c"
    action: str = ""  # press, release, drag or wheel
    button: str = ""  # left, middle, right; of a wheel also up, down
    x: int = 0  # cell, 0 is the leftmost
    y: int = 0  # cell, 0 is the topmost
    modifiers: frozenset[str] = frozenset()  # of shift, alt, ctrl; keys have them in their name


class Decoder:
    """Bytes in, events out.

    Answers to queries are no events: they gather in ``answers`` until somebody takes them.
    ``pending`` says that an escape sequence is unfinished; when nothing more comes for some 50 ms
    :meth:`flush` takes what is there for keys.
    """

    def __init__(self) -> None:
        self.answers = bytearray()
        self._buffer = b""

    @property
    def pending(self) -> bool:
        return bool(self._buffer)

    def feed(self, data: bytes) -> list[Event]:
        """Events that ``data`` completes."""
        self._buffer += data
        return self._parse()

    def flush(self) -> list[Event]:
        """The Escape key, or Alt and a key, if that is what is pending; longer ones stay.

        A longer unfinished sequence is a slow answer or mouse report; any control character
        ends it, so that Ctrl+C always gets through.
        """
        waiting, self._buffer = self._buffer, b""
        if waiting == b"\x1b":
            return [Event("key", "escape")]
        if len(waiting) == 2 and waiting[0] == ESC and waiting[1] < 0x80:
            return [Event("key", f"alt+{chr(waiting[1])}")]
        self._buffer = waiting
        return []

    def _parse(self) -> list[Event]:
        events: list[Event] = []
        data, at = self._buffer, 0
        while at < len(data):
            if 0x20 <= data[at] < 0x7F:
                events.append(Event("key", chr(data[at])))
                at += 1
                continue
            used, event = self._one(data[at:])
            if not used:
                break
            at += used
            if event is not None:
                events.append(event)
        self._buffer = data[at:]
        return events

    def _one(self, data: bytes) -> tuple[int, Event | None]:
        """How many bytes the first thing in ``data`` takes (0: not complete), and its event."""
        first = data[0]
        if first != ESC:
            return _character(data)
        if len(data) == 1:
            return 0, None
        second = data[1]
        if second == 0x5B:  # [
            return self._csi(data)
        if second == 0x4F:  # O: SS3, one final byte
            if len(data) == 2:
                return 0, None
            name = _LETTERS.get(chr(data[2]), "")
            if data[2] == ESC or data[2] < 0x20:
                return 2, Event("key", "alt+O")
            return 3, Event("key", name) if name else None
        if second in _STRINGS:
            return self._string(data)
        if second in (ESC, 0x03):  # Escape, then a sequence of its own; Ctrl+C is always one
            return 1, Event("key", "escape")
        used, event = _character(data[1:])
        if not used:
            return 0, None
        return used + 1, None if event is None else Event("key", f"alt+{event.key}")

    def _csi(self, data: bytes) -> tuple[int, Event | None]:
        match = _CSI.match(data)
        if match is None:
            part = _CSI_PART.match(data)
            end = part.end() if part else 2
            if end == len(data) and end < STRING_LIMIT:
                return 0, None
            return end, None  # broken off by a control character, ESC or a byte above 0x7e
        parameters, middle, final = match.groups()
        if final == b"M" and not parameters and not middle:  # X10 mouse: three raw bytes
            if len(data) < match.end() + 3:
                return 0, None
            b, x, y = (n - 32 for n in data[match.end() : match.end() + 3])
            return match.end() + 3, _mouse(b, x, y, b & 67 == 3)
        if final in b"Mm" and (found := _MOUSE.fullmatch(parameters)) and not middle:
            b, x, y = map(int, found.groups())
            return match.end(), _mouse(b, x, y, final == b"m")
        if (parameters, middle, final) == (b"0", b"", b"n"):
            return match.end(), Event("ready")
        if middle or parameters[:1] in (b"?", b">", b"=", b"<") or final in b"cnty":
            self.answers += match.group()
            return match.end(), None
        return match.end(), _csi_key(parameters.decode("ascii"), final.decode("ascii"))

    def _string(self, data: bytes) -> tuple[int, Event | None]:
        """A DCS, OSC, APC, PM or SOS up to ST (or BEL); a control character breaks it off."""
        for i in range(2, len(data)):
            byte = data[i]
            if byte == ESC:
                if i + 1 == len(data):
                    return 0, None
                if data[i + 1] == 0x5C:
                    self.answers += data[: i + 2]
                    return i + 2, None
                return i, None
            if byte == BEL and data[1] == 0x5D:
                self.answers += data[: i + 1]
                return i + 1, None
            if byte < 0x20 or i > STRING_LIMIT:
                return i, None
        return 0, None


def _character(data: bytes) -> tuple[int, Event | None]:
    first = data[0]
    if first in _CONTROLS:
        return 1, Event("key", _CONTROLS[first])
    if first == ESC:
        return 1, Event("key", "escape")
    if first < 0x80:
        return 1, Event("key", chr(first))
    length = 2 if 0xC2 <= first < 0xE0 else 3 if first < 0xF0 else 4 if first < 0xF5 else 1
    if first < 0xC2 or length == 1:
        return 1, None  # no UTF-8
    for i in range(1, length):
        if i == len(data):
            return 0, None
        if not 0x80 <= data[i] < 0xC0:
            return i, None
    try:
        text = data[:length].decode("utf-8")
    except UnicodeDecodeError:
        return length, None
    return length, Event("key", text) if text.isprintable() else None


def _mouse(b: int, x: int, y: int, released: bool) -> Event | None:
    modifiers = frozenset(name for bit, name in ((4, "shift"), (8, "alt"), (16, "ctrl")) if b & bit)
    x, y = max(0, x - 1), max(0, y - 1)
    if b & 192 == 64:
        if released:
            return None
        wheel = _WHEEL[b & 3]
        return Event("mouse", action="wheel", button=wheel, x=x, y=y, modifiers=modifiers)
    if b >= 128 or b < 0:
        return None  # buttons 8 and up
    button = _BUTTONS[b & 3] if b & 3 < 3 else ""
    if b & 32:
        if not button:
            return None  # moved with no button down
        action = "drag"
    else:
        action = "release" if released else "press"
        if not button and not released:
            return None
    return Event("mouse", action=action, button=button, x=x, y=y, modifiers=modifiers)


def _csi_key(parameters: str, final: str) -> Event | None:
    numbers = [int(p) if p.isdecimal() and len(p) < 6 else 0 for p in parameters.split(";")]
    if final == "~":
        name = _NUMBERS.get(numbers[0], "")
    elif final == "M" or (final in "PQRS" and numbers[0] not in (0, 1)):
        name = ""  # CSI row;col R is a cursor position, nobody asked for it
    else:
        name = _LETTERS.get(final, "")
    if not name:
        return None
    held = max(0, numbers[1] - 1) if len(numbers) > 1 else 0
    if name == "shift+tab":
        held = 0
    prefix = "".join(word for bit, word in ((4, "ctrl+"), (2, "alt+"), (1, "shift+")) if held & bit)
    return Event("key", prefix + name)
