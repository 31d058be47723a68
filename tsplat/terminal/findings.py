"""What was asked of a terminal, what it answered and what follows, for people and scripts."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tsplat.core.errors import printable
from tsplat.presenters.base import Terminal
from tsplat.terminal.answers import DA1_ANSWER, KITTY_ID, Winsize, multiplexer, name_in
from tsplat.terminal.device import Heard
from tsplat.terminal.sharing import QUESTION_IDS

NOTHING = "no answer"

Done = str | Callable[[Terminal], str]


def _other(terminal: Terminal) -> str:
    others = [name for name in ("iterm2", "sixel") if getattr(terminal, name)]
    return f"{others[0]} is chosen before kitty" if others else "nothing: there is no other way"


def _cell(terminal: Terminal) -> str:
    return f"the smaller cell is believed: {terminal.cell_width:.4g}x{terminal.cell_height:.4g} px"


def _mouse(terminal: Terminal) -> str:
    return (
        "believed to, by its version" if terminal.pixel_mouse else "nothing: this version is older"
    )


def _releases(terminal: Terminal) -> str:
    if not terminal.keyboard:
        return "nothing: this one tells no releases"
    return "a release counts after 20 ms; one that fits no press ends all keys"


def _colours(terminal: Terminal) -> str:
    if terminal.colors == 1 << 24:
        return "24 bits are sent: it, or its environment, says that it keeps them"
    return f"{terminal.colors} colours are sent"


def _listed(terminal: Terminal) -> str:
    if terminal.sixel:
        return "the terminal around is asked, and does not say that it has none"
    return "no sixel is sent"


def _covered(terminal: Terminal) -> str:
    if not terminal.sixel:
        return "nothing: this one shows no sixel"
    return "pictures are scrolled out whenever the screen is cleared"


# Begin of the name, lower case -> what it says that is not so, or does not say that is; and what is
# done about it. Measured with the versions named, read in their sources, or reported.
LIARS: dict[str, tuple[tuple[str, Done], ...]] = {
    "konsole": (
        ("answers kitty's query with OK, but has neither placeholders nor animation (source)",
         lambda terminal: f"neither is used; {_other(terminal)}"),
        ("takes synchronized output (2026 on) and does not answer the question for it",
         "each frame is sent as such an update, to all terminals"),
        ("counts its scroll marker in: 904 px for 90 columns of 10 (26.08)", _cell),
        ("tells the mouse in px (26.08) and does not answer the question for it", _mouse),
        ("tells a repeat as a release and a press, and of Shift and / two keys (26.08)", _releases),
    ),
    "wezterm": (
        ("answers kitty's query with OK, then grows and freezes under moving pictures (issue 7400)",
         _other),
    ),
    "iterm2": (("answers kitty's query with OK; a=T without an id was long broken", _other),),
    "xterm.js": (("rounds its cell: 9.63 px are told as 10", _cell),),
    "xterm(": (
        ("keeps 24-bit colours and sets no COLORTERM", _colours),
        ("looks through sixel pictures long covered for each letter: 0.3 s a screenful", _covered),
    ),
    "mlterm": (
        ("3.9.0 runs out of colours when sent 24 bits of them, and shows speckles", _colours),
    ),
    "tmux": (
        ("lists sixel (3.4 on, where built with it) whatever the terminal around it has", _listed),
        ("takes kitty's query for a window title", "the terminal around is asked, past tmux"),
    ),
    "ghostty": (
        ("kept the last frame's picture under the new one before 2026-08",
         "pictures are sent opaque: what is under one is not seen"),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One row of the table."""

    question: str
    answer: str
    conclusion: str


def findings(
    heard: Heard, environ: Mapping[str, str], winsize: Winsize, terminal: Terminal
) -> list[Finding]:
    """The rows, in the order in which a presenter is chosen by them.

    ``terminal`` is what was made of the answers in the end.
    """
    rows: list[Finding] = []

    def row(question: str, answer: str, conclusion: str) -> None:
        rows.append(Finding(question, answer or NOTHING, conclusion))

    asked = heard.around if terminal.multiplexer == "tmux" else heard.answers
    where = " past tmux" if terminal.multiplexer == "tmux" else ""
    row(
        "DA1", _found(DA1_ANSWER.pattern, heard.answers),
        "it answers questions" if DA1_ANSWER.search(heard.answers)
        else "nothing is known but the environment; late answers still count",
    )  # fmt: skip
    row("XTVERSION", name_in(heard.answers), f"name: {terminal.name or 'unknown'}")
    if terminal.multiplexer:
        row(
            f"around {terminal.multiplexer}: XTVERSION", name_in(heard.around),
            terminal.advice or f"name: {terminal.around or 'unknown'}",
        )  # fmt: skip
    if mux := multiplexer("", environ):
        row("TMUX, STY, TERM", f"{mux} by the environment", terminal.multiplexer or "inherited")
    row(
        f"kitty a=q{where}", _kitty(asked, KITTY_ID),
        "kitty graphics" if terminal.kitty else "no kitty graphics",
    )  # fmt: skip
    for medium, what in (("s", "shared memory"), ("t", "temporary files")):
        said = _kitty(asked, QUESTION_IDS[medium])
        if terminal.remote:
            said = "not asked over ssh"
        read = medium in terminal.media
        row(f"kitty a=q,t={medium}{where}", said, f"{what} {'read' if read else 'not read'}")
    if terminal.kitty and where:
        has = "has" if terminal.placeholders else "is not known to have"
        row("placeholders", f"by name: {terminal.around}", f"{has} them")
    row(
        "ReportCellSize", _found(rb"\x1b\]1337;ReportCellSize=[0-9.;]+", heard.answers),
        ("" if terminal.iterm2 else "not known to take ") + "iTerm2 pictures"
        + (" by answer or name" if terminal.iterm2 else ""),
    )  # fmt: skip
    features = f", tmux: {heard.features}" if heard.features else ""
    row(
        "DA1 attribute 4", ("listed" if _lists_sixel(heard.answers) else "not listed") + features,
        "sixel" if terminal.sixel else "no sixel",
    )  # fmt: skip
    row(
        "XTSMGRAPHICS", _found(rb"\x1b\[\?[12];[0-9;]+S", heard.answers),
        f"{terminal.sixel_registers} registers, "
        + ("x".join(map(str, terminal.sixel_max)) + " px" if any(terminal.sixel_max)
           else "any size"),
    )  # fmt: skip
    row(
        "DECRQM 2026", _found(rb"\x1b\[\?2026;[0-9]\$y", heard.answers),
        "synchronized output" if terminal.synchronized else "sent all the same: harmless",
    )  # fmt: skip
    row(
        "kitty keyboard CSI ?u", _found(rb"\x1b\[\?[0-9]{1,5}u", heard.answers),
        "told when a key is let go" if terminal.keyboard
        else "a key is let go when it is not repeated",
    )  # fmt: skip
    row(
        "DECRQM 1016", _found(rb"\x1b\[\?1016;[0-9]\$y", heard.answers),
        "the mouse moves in " + ("px" if terminal.pixel_mouse else "cells"),
    )  # fmt: skip
    row(
        "DECRQM 2048", _found(rb"\x1b\[\?2048;[0-9]\$y", heard.answers),
        "it tells its new size" if terminal.in_band_resize else "the kernel tells a new size",
    )  # fmt: skip
    rows_, columns, xpixel, ypixel = winsize
    row(
        "TIOCGWINSZ", f"{columns}x{rows_} cells, {xpixel}x{ypixel} px",
        f"{terminal.columns}x{terminal.rows} cells",
    )  # fmt: skip
    row(
        "XTWINOPS 14, 16", _found(rb"\x1b\[[46];[0-9;]+t", heard.answers),
        f"a cell is {terminal.cell_width:.4g}x{terminal.cell_height:.4g} px",
    )  # fmt: skip
    colors = _found(rb"\x1bP1\+r[^\x1b]*|\x1bP1\$r[^\x1b]*", heard.answers)
    said = environ.get("COLORTERM", "")
    row(
        "XTGETTCAP, DECRQSS, COLORTERM", " ".join(filter(None, (colors, said))),
        "24-bit colour" if terminal.colors == 1 << 24 else f"{terminal.colors} colours",
    )  # fmt: skip
    row(
        "SSH_CONNECTION, SSH_TTY", "set" if terminal.remote else "not set",
        "over a network: fewer bytes" if terminal.remote else "on this machine",
    )  # fmt: skip
    if spec := environ.get("TSPLAT_TERMINAL"):
        row("TSPLAT_TERMINAL", printable(spec), "overrides the answers")
    for prefix, lies in LIARS.items():
        for name in filter(None, (terminal.name, terminal.around)):
            if name.lower().startswith(prefix):
                for lie, done in lies:
                    row(f"known of {prefix.strip('(')}", lie, _done(done, name, terminal))
    return rows


def _done(done: Done, name: str, terminal: Terminal) -> str:
    """What is done about it. Of a terminal around tmux only the placeholders are used."""
    if name == terminal.around:
        shows = terminal.kitty and terminal.placeholders
        return "only placeholders are sent past tmux" if shows else "no pictures are sent past tmux"
    return done if isinstance(done, str) else done(terminal)


def _found(pattern: bytes, data: bytes) -> str:
    """All that matches, as text without ESC."""
    found = (m.group().replace(b"\x1b", b"") for m in re.finditer(pattern, data))
    return printable(" ".join(text.decode("ascii", "replace") for text in found), 200)


def _kitty(answers: bytes, number: int) -> str:
    match = re.search(rb"\x1b_Gi=%d[^;\x1b]*;([^\x1b]*)\x1b" % number, answers)
    return printable(match.group(1).decode("ascii", "replace")) if match else ""


def _lists_sixel(answers: bytes) -> bool:
    match = DA1_ANSWER.search(answers)
    return match is not None and b"4" in match.group(1).split(b";")[1:]
