"""Names of keys, out of what terminals send for them.

Control characters and the sequences of xterm:
https://invisible-island.net/xterm/ctlseqs/ctlseqs.html . Kitty's keyboard protocol, with the
numbers of its functional keys: https://sw.kovidgoyal.net/kitty/keyboard-protocol/ ; whatever a key
is called without that protocol, it is called with it. Letters of other scripts are called what a US
keyboard has in their place, as what keys do is said in Latin letters.
"""

from __future__ import annotations

import unicodedata
from typing import NamedTuple

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
CONTROLS = {
    0x00: "ctrl+space",
    0x08: "backspace",
    0x09: "tab",
    0x0A: "enter",
    0x0D: "enter",
    0x1B: "escape",
    0x1C: "ctrl+\\",
    0x1D: "ctrl+]",
    0x1E: "ctrl+^",
    0x1F: "ctrl+_",
    0x7F: "backspace",
    **{n: f"ctrl+{chr(n + 96)}" for n in range(1, 27) if n not in (8, 9, 10, 13)},
}
"""Control character -> key."""

_PLAIN = {9: "tab", 13: "enter", 27: "escape", 127: "backspace"}  # of CSI u
_KEYPAD = dict(
    zip(
        range(57399, 57427),
        (
            *"0123456789./*-+", "enter", "=", ",", "left", "right", "up", "down", "pageup",
            "pagedown", "home", "end", "insert", "delete",
        ),
        strict=True,
    )
)  # fmt: skip
_PRIVATE = range(57344, 63744)  # other functional keys; modifiers, too: none that means anything

_SHIFT, _ALT, _CTRL = 1, 2, 4
_MODIFIERS = (
    (32, "meta+"), (16, "hyper+"), (8, "super+"), (4, "ctrl+"), (2, "alt+"), (1, "shift+"),
)  # fmt: skip
_LOCKS = 64 | 128  # Caps, Num
_ACTIONS = {0: "press", 1: "press", 2: "repeat", 3: "release"}


class Key(NamedTuple):
    """What happened to a key: fields of :class:`~tsplat.terminal.events.Event`."""

    key: str
    action: str
    code: str


def decoded(parameters: str, final: str, told: bool = False, places: bool = True) -> Key | None:
    """The key of ``CSI parameters final``, or of SS3; None for one that has no name.

    ``told`` says that releases will be told, though this press does not say so; ``places``, that
    the places of keys on a US keyboard are to be believed, also without Ctrl.
    """
    fields = [[_number(part) for part in field.split(":")] for field in parameters.split(";")]
    first = fields[0][0]
    held, action = 0, "press"
    if len(fields) > 1:
        held = max(0, fields[1][0] - 1) & ~_LOCKS
        kind = fields[1][1] if len(fields[1]) > 1 else 0
        if kind not in _ACTIONS:
            return None
        action = _ACTIONS[kind]
    if final == "u":
        text = "".join(map(_character, fields[2])) if len(fields) > 2 else ""
        return _unicode_key(fields[0], held, action, text, places)
    if final == "~":
        name = _NUMBERS.get(first, "")
    elif (final == "M" and parameters) or (final in "PQRS" and first not in (0, 1)):
        name = ""  # CSI row;col R is a cursor position, nobody asked for it
    else:
        name = _LETTERS.get(final, "")
    if not name:
        return None
    code = name.removeprefix("shift+") if told or action != "press" else ""
    if name == "shift+tab":
        held = 0
    return Key(_prefix(held) + name, action, code)


def _unicode_key(codes: list[int], held: int, action: str, text: str, places: bool) -> Key | None:
    """A key by its code point, the one with Shift, and the one of a US keyboard."""
    code, shifted, base = (*codes, 0, 0)[:3]
    if code in _PLAIN:
        name = _PLAIN[code]
        if name != "tab":
            held &= ~_SHIFT
        return Key(_prefix(held & ~_CTRL) + name, action, name)  # as ever: others were not told
    if code in _KEYPAD:
        name, known = _KEYPAD[code], f"keypad {_KEYPAD[code]}"
        if len(name) == 1:
            held &= ~_SHIFT
            name = name if held else text or name
        elif name == "enter":
            held &= ~(_SHIFT | _CTRL)
        return Key(_prefix(held) + name, action, known)
    plain = "" if code in _PRIVATE else _character(code)
    if not plain:  # text of no key, as input methods make it: no release
        return Key(text, action, "") if text and code == 0 and action == "press" else None
    capital = _character(shifted) if held & _SHIFT else ""
    if held & ~_SHIFT == 0:
        latin = _character(base) if places and _foreign(plain) else ""
        if latin.isascii() and latin:
            return Key(latin.upper() if held else latin, action, plain)
        return Key(text or capital or plain, action, plain)
    if held & ~_SHIFT == _ALT and text and text not in (plain, capital):
        return Key(text, action, plain)  # Option composes
    if not held & _CTRL:
        return Key(_prefix(held & ~_SHIFT) + (capital or plain), action, plain)
    latin = plain if plain.isascii() else _character(base) or plain
    name = f"ctrl+{latin}"
    if latin.isascii() and (latin in " ?" or 0x40 <= ord(latin) < 0x7F):
        name = CONTROLS[0x7F if latin == "?" else ord(latin) & 0x1F]
    return Key(_prefix(held & ~(_SHIFT | _CTRL)) + name, action, plain)


def _foreign(letter: str) -> bool:
    """Whether it is a letter of another script than the Latin one."""
    return letter.isalpha() and not unicodedata.name(letter, "").startswith("LATIN")


def _prefix(held: int) -> str:
    return "".join(word for bit, word in _MODIFIERS if held & bit)


def _number(text: str) -> int:
    return int(text) if text.isdecimal() and len(text) < 8 else 0


def _character(code: int) -> str:
    """The character, "" if it is none to be shown."""
    if not 0x20 <= code < 0x110000 or 0xD800 <= code < 0xE000:
        return ""
    text = chr(code)
    return text if text.isprintable() else ""
