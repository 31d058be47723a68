"""Facts about a terminal that the user knows better than its answers: ``TSPLAT_TERMINAL``.

Words separated by commas: the name of a terminal, whose features replace what was found out, and
``+sixel`` or ``-kitty`` to add or take away one; ``colors=256``. ``TSPLAT_TERMINAL=foot,-sync``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tsplat.core.errors import TerminalError, printable
from tsplat.presenters.base import Terminal

TRUECOLOR = 1 << 24
FEATURES = {
    "kitty": "kitty", "iterm2": "iterm2", "sixel": "sixel", "sync": "synchronized",
    "placeholders": "placeholders", "remote": "remote", "keys": "keyboard",
    "resize": "in_band_resize", "pixel-mouse": "pixel_mouse",
}  # fmt: skip
"""Word -> the field of Terminal."""

_INPUT = "keyboard", "in_band_resize", "pixel_mouse"
_NONE = dict.fromkeys(("kitty", "iterm2", "sixel", "synchronized", "placeholders", *_INPUT), False)
_ALL_INPUT = dict.fromkeys(_INPUT, True)
PROFILES: dict[str, dict[str, Any]] = {
    "plain": {**_NONE, "name": ""},
    "kitty": {
        **_NONE, **_ALL_INPUT, "kitty": True, "synchronized": True, "placeholders": True,
        "name": "kitty",
    },
    "ghostty": {
        **_NONE, **_ALL_INPUT, "kitty": True, "synchronized": True, "placeholders": True,
        "name": "ghostty",
    },
    "konsole": {
        **_NONE, "kitty": True, "iterm2": True, "sixel": True, "keyboard": True,
        "pixel_mouse": True, "name": "Konsole",
    },
    "wezterm": {
        **_NONE, "kitty": True, "iterm2": True, "sixel": True, "synchronized": True,
        "name": "WezTerm",
    },
    "iterm2": {**_NONE, "iterm2": True, "sixel": True, "synchronized": True, "name": "iTerm2"},
    "vscode": {
        **_NONE, "iterm2": True, "sixel": True, "synchronized": True, "pixel_mouse": True,
        "name": "xterm.js",
    },
    "foot": {**_NONE, **_ALL_INPUT, "sixel": True, "synchronized": True, "name": "foot"},
    "mlterm": {**_NONE, "iterm2": True, "sixel": True, "name": "mlterm"},
}  # fmt: skip
"""What a terminal has in versions of today; its size and colours stay as they were found."""


def overridden(terminal: Terminal, spec: str) -> Terminal:
    """``terminal`` as ``spec`` says it is; "" changes nothing.

    Raises:
        TerminalError: a word is none of those above.
    """
    for word in filter(None, (part.strip().lower() for part in spec.split(","))):
        if word in PROFILES:
            terminal = replace(terminal, **PROFILES[word])
        elif word[0] in "+-" and word[1:] in FEATURES:
            change: dict[str, Any] = {FEATURES[word[1:]]: word[0] == "+"}
            terminal = replace(terminal, **change)
        elif word == "-sharing":
            terminal = replace(terminal, media="", share=None)
        elif word in ("colors=2", "colors=16", "colors=256", f"colors={TRUECOLOR}"):
            terminal = replace(terminal, colors=int(word.removeprefix("colors=")))
        else:
            raise TerminalError(
                f"TSPLAT_TERMINAL: expected one of {', '.join(PROFILES)}, a feature with + or - "
                f"({', '.join(FEATURES)}, -sharing) or colors=N, got {printable(repr(word))}"
            )
    return terminal
