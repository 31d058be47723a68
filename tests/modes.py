"""Modes of a terminal: what it answers that has them, and what is left on in the end."""

from __future__ import annotations

import re

TELLS = b"\x1b[?0u\x1b[?1016;2$y\x1b[?2048;2$y"
"""What a terminal answers that tells releases of keys, px of the mouse and its size."""


def left_on(output, alternate=False):
    """Names of what ``output`` leaves switched on, as a terminal understands it.

    Kitty's keyboard flags are on a stack, one for each screen: "keys 31" is on the main screen's,
    "keys 31 (alternate)" on the other's. ``alternate``: the screen that the output begins on.
    """
    stacks, modes = {False: [], True: []}, set()
    for private, numbers, final in re.findall(rb"\x1b\[([?<>=])([0-9;]*)([a-z])", output):
        if final == b"u" and private == b">":
            stacks[alternate].append(int(numbers or 0))
        elif final == b"u" and private == b"<":
            del stacks[alternate][-int(numbers or 1) :]
        elif final in b"hl" and private == b"?":
            for mode in map(int, numbers.split(b";")):
                if mode == 1049:
                    alternate = final == b"h"
                elif final == b"h":
                    modes.add(mode)
                else:
                    modes.discard(mode)
    names = {f"keys {flags}" for flags in stacks[False]}
    names |= {f"keys {flags} (alternate)" for flags in stacks[True]}
    return names | {str(mode) for mode in modes - {25}} | ({"alternate"} if alternate else set())
