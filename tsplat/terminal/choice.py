"""Which presenter a terminal gets."""

from __future__ import annotations

from tsplat.core.errors import PluginError, TerminalError, printable
from tsplat.presenters.base import Presenter, Terminal

# Begin of the terminal's name, lower case -> presenter: exceptions to the presenters' ranks,
# measured with moving pictures or reported.
PREFERRED = {
    "konsole": "iterm2",  # 1280x720: 13 ms a JPEG, 25 ms sixel, 86 to 190 ms kitty
    "xterm.js": "iterm2",  # 640x360: 37 ms a JPEG, 105 ms sixel, 302 ms kitty
    "iterm2": "iterm2",  # its kitty protocol was long without a=T
    "wezterm": "iterm2",  # grows and freezes under kitty pictures: wezterm issue 7400
    "mlterm": "sixel",  # 640x360: 5 ms sixel
}


def choose_presenter(
    presenters: dict[str, Presenter], terminal: Terminal, wanted: str | None
) -> tuple[Presenter, str]:
    """The presenter to use, and why, in a few words fit to show.

    ``wanted`` is a name, and is obeyed even where the terminal is not known to support it; None
    or "auto" takes what suits the terminal best, else the highest rank that it supports.

    Raises:
        PluginError: no presenter has the name.
        TerminalError: none can show anything here.
    """
    from tsplat.plugins import ask

    if wanted not in (None, "auto"):
        if wanted not in presenters:
            known = ", ".join(sorted(presenters))
            raise PluginError(f"no presenter named {printable(repr(wanted))}; installed: {known}")
        reason = ask(presenters[wanted].unsupported, terminal)
        return presenters[wanted], "asked for" + (f", though {reason}" if reason else "")
    reasons = {name: ask(row.unsupported, terminal) for name, row in presenters.items()}
    usable = [presenters[name] for name, reason in reasons.items() if reason is None]
    if not usable:
        why = "; ".join(f"{name}: {reason}" for name, reason in reasons.items())
        raise TerminalError(f"no presenter can show pictures here ({why or 'none installed'})")
    for prefix, name in PREFERRED.items():
        if terminal.name.lower().startswith(prefix):
            for row in usable:
                if row.name == name:
                    return row, f"fastest in {terminal.name}"
    best = max(usable, key=lambda row: row.rank)
    return best, f"the best {terminal.name or 'this terminal'} supports"
