"""Keys, mouse and answers out of the bytes a terminal sends.

A :class:`Decoder` takes the bytes as they come, in any pieces, and makes the same events of them.
Sources: https://invisible-island.net/xterm/ctlseqs/ctlseqs.html (keys, mouse modes 1000 to 1016,
focus, DSR); the shape of control sequences is ECMA-48's, section 5.4. What kitty's keyboard
protocol sends is read by :mod:`tsplat.terminal.keys`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from tsplat.terminal.keys import CONTROLS, Key, decoded

ESC = 0x1B
BEL = 0x07
STRING_LIMIT = 1 << 16  # bytes; no answer we ask for is longer, so it is noise
_STRINGS = frozenset(b"P]_^X")  # DCS, OSC, APC, PM, SOS: a string up to ST

# CSI parameters, intermediates, final byte
_CSI = re.compile(rb"\x1b\[([0-?]*)([ -/]*)([@-~])")
_CSI_PART = re.compile(rb"\x1b\[[0-?]*[ -/]*")
# SGR mouse report: button, x, y. Pixels (1016) outside the window are negative in some terminals
_MOUSE = re.compile(rb"\x1b\[<(\d{1,6});(-?\d{1,6});(-?\d{1,6})([Mm])")
_MOUSE_PART = re.compile(rb"\x1b\[<[\d;-]{0,23}")
_RESIZE = re.compile(rb"48;(\d{1,6});(\d{1,6});(\d{1,6});(\d{1,6})")

_BUTTONS = ("left", "middle", "right")
_WHEEL = ("up", "down", "left", "right")


@dataclass(frozen=True)
class Event:
    """Something that happened at the terminal.

    ``kind`` is "key" (with ``key``, ``action``, ``code``), "mouse" (with ``action``, ``button``,
    ``x``, ``y``, ``modifiers``), "focus" (with ``action``), "resize" (sizes changed or the screen
    was lost: draw everything again), "ready" (the frame sent last was taken), "terminal" (late
    answers changed what is known of the terminal), "watched" (there is something to read where
    :attr:`Screen.watched` points) or whatever another thread has posted.

    The release of a key has the ``code`` of its press. Its ``key`` may differ: Shift may have been
    released before. Repeats and releases come only from terminals with kitty's keyboard protocol;
    elsewhere a key held down is pressed again and again.
    """

    kind: str
    key: str = ""  # a printable character, or a name such as "up", "shift+tab", "ctrl+c"
    action: str = (
        "press"  # of keys also repeat, release; mouse: release, drag, wheel; focus: in, out
    )
    button: str = ""  # left, middle, right; of a wheel also up, down
    x: float = 0  # cells from the left edge; whole (the cell) where a terminal tells no pixels
    y: float = 0  # cells from the top
    modifiers: frozenset[str] = frozenset()  # of shift, alt, ctrl; keys have them in their name
    code: str = ""  # of the key, whatever Shift makes of it; "": its release will not be told
    size: tuple[int, int, int, int] | None = None  # told by the terminal: rows, columns, px, px


class Decoder:
    """Bytes in, events out.

    Answers to queries are no events: they gather in ``answers`` until somebody takes them.
    ``pending`` says that an escape sequence is unfinished; when nothing more comes for some 50 ms
    :meth:`flush` takes what is there for keys.

    ``keyboard`` says that kitty's keyboard protocol is on, so that releases will be told also of
    keys whose press looks as ever; ``places``, that it is right about where keys are on a US
    keyboard. ``cell``, its width and height in px, says that the mouse is told in pixels (mode
    1016).
    """

    keyboard: bool = False
    places: bool = True
    cell: tuple[float, float] | None = None

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
            if data[2] == ESC or data[2] < 0x20:
                return 2, Event("key", "alt+O")
            return 3, _key(decoded("", chr(data[2]), self.keyboard))
        if second in _STRINGS:
            return self._string(data)
        if second in (ESC, 0x03):  # Escape, then a sequence of its own; Ctrl+C is always one
            return 1, Event("key", "escape")
        used, event = _character(data[1:])
        if not used:
            return 0, None
        return used + 1, None if event is None else Event("key", f"alt+{event.key}")

    def _csi(self, data: bytes) -> tuple[int, Event | None]:
        if mouse := _MOUSE.match(data):
            b, x, y = map(int, mouse.groups()[:3])
            return mouse.end(), _mouse(b, x, y, mouse.group(4) == b"m", self.cell)
        if _MOUSE_PART.fullmatch(data):
            return 0, None
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
        if (parameters, middle, final) == (b"0", b"", b"n"):
            return match.end(), Event("ready")
        if (parameters, middle) == (b"", b"") and final in b"IO":
            return match.end(), Event("focus", action="in" if final == b"I" else "out")
        if final == b"t" and not middle and (size := _RESIZE.match(parameters)):
            rows, columns, height, width = map(int, size.groups())
            return match.end(), Event("resize", size=(rows, columns, width, height))
        if middle or parameters[:1] in (b"?", b">", b"=", b"<") or final in b"cnty":
            self.answers += match.group()
            return match.end(), None
        return match.end(), _key(
            decoded(parameters.decode(), final.decode(), self.keyboard, self.places)
        )

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


def _key(key: Key | None) -> Event | None:
    return None if key is None else Event("key", key.key, key.action, code=key.code)


def _character(data: bytes) -> tuple[int, Event | None]:
    first = data[0]
    if first in CONTROLS:
        return 1, Event("key", CONTROLS[first])
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


def _mouse(
    b: int, across: int, down: int, released: bool, cell: tuple[float, float] | None = None
) -> Event | None:
    modifiers = frozenset(name for bit, name in ((4, "shift"), (8, "alt"), (16, "ctrl")) if b & bit)
    x: float = max(0, across - 1)
    y: float = max(0, down - 1)
    if cell is not None:  # px, counted from 0 or 1
        x, y = x / cell[0], y / cell[1]
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
        action = "press" if button and not released else "release"  # Konsole: "press of none"
    return Event("mouse", action=action, button=button, x=x, y=y, modifiers=modifiers)
