"""What a terminal says of itself: the questions, and facts made of the answers.

Every question that is worth a frame's trouble goes out in one write with Primary Device
Attributes last: every terminal answers those, and in order, so whatever has not come by then does
not come. Sources:

- DA1, XTVERSION (``CSI > q``), XTWINOPS (``CSI 14 t``, ``CSI 16 t``), XTSMGRAPHICS, XTGETTCAP,
  DECRQM, DECRQSS: https://invisible-island.net/xterm/ctlseqs/ctlseqs.html
- kitty's query: https://sw.kovidgoyal.net/kitty/graphics-protocol/#querying-support
- ReportCellSize: https://iterm2.com/documentation-escape-codes.html
- synchronized output: https://github.com/contour-terminal/vt-extensions
- keyboard: https://sw.kovidgoyal.net/kitty/keyboard-protocol/#detection-of-support
- sizes told in-band (mode 2048):
  https://gist.github.com/rockorager/e695fb2924d36b2bcf1fff4a3704bd83
- NO_COLOR: https://no-color.org

Who draws which block characters itself, whatever the font has, was photographed (kitty 0.26.5 and
0.48.2, Konsole 22.12 and 26.08, foot 1.13 and 1.28) or is from
https://github.com/dankamongmen/notcurses/blob/master/TERMINALS.md (VTE),
https://github.com/ghostty-org/ghostty/pull/5433 (Ghostty's octants, 2025-01),
https://wezterm.org/config/lua/config/custom_block_glyphs.html , and
https://github.com/alacritty/alacritty/pull/7534 (Alacritty adds sextants to what it has). Windows
Terminal and xterm.js draw some depending on the renderer, which they do not tell.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from math import isfinite

from tsplat.core.errors import TerminalError, printable
from tsplat.presenters.base import Terminal
from tsplat.terminal.profiles import overridden
from tsplat.terminal.sharing import QUESTION_IDS, is_remote

Winsize = tuple[int, int, int, int]  # rows, columns, xpixel, ypixel as TIOCGWINSZ has them

DA1 = b"\x1b[c"
XTVERSION = b"\x1b[>q"
KITTY_ID = 31
KITTY_QUESTION = b"\x1b_Gi=%d,s=1,v=1,a=q,t=d,f=24;AAAA\x1b\\" % KITTY_ID
"""Kitty graphics: one pixel, not kept. tmux takes it, and those about media, for a title."""

QUESTIONS = (
    b"\x1b[>q"  # XTVERSION
    b"\x1b[?2026$p"  # DECRQM: synchronized output
    b"\x1b[?2048$p\x1b[?1016$p"  # DECRQM: sizes told in-band, the mouse in px
    b"\x1b[?u"  # kitty's keyboard protocol: its flags now
    b"\x1b[14t\x1b[16t"  # XTWINOPS: text area, cell; px
    b"\x1b[?1;1;0S\x1b[?2;4;0S"  # XTSMGRAPHICS: registers now, largest sixel picture
    b"\x1b]1337;ReportCellSize\x1b\\"
    b"\x1bP+q524742\x1b\\\x1bP+q5463\x1b\\"  # XTGETTCAP: RGB, Tc
    b"\x1b[48;2;1;2;3m\x1bP$qm\x1b\\\x1b[m"  # DECRQSS: is a 24-bit colour kept?
)
"""All but kitty's, and DA1, which ends them."""

DA1_ANSWER = re.compile(rb"\x1b\[\?([0-9;]*)c")
_ANSWER = re.compile(
    rb"\x1b\[[?>=][0-9;]*[ $]?[A-Za-z]"  # DA1, DECRPM, XTSMGRAPHICS
    rb"|\x1b\[[468](?:;[0-9]+)+t"  # XTWINOPS
    rb"|\x1b\[[0-9;]*[nR]"
    rb"|\x1b[P_][^\x1b\x07]*\x1b\\"  # DCS, APC
    rb"|\x1b\][^\x1b\x07]*(?:\x1b\\|\x07)"  # OSC
)
_XTVERSION = re.compile(rb"\x1bP>\|([^\x1b]*)\x1b\\")
_KITTY_OK = re.compile(rb"\x1b_Gi=([0-9]{1,9})[^;\x1b]*;OK\x1b\\")
_KONSOLE_VERSION = re.compile(r"Konsole ([0-9]{1,4})\.([0-9]{1,4})")
_KITTY_VERSION = re.compile(r"kitty\(([0-9]{1,4})\.([0-9]{1,4})")
_MODE = re.compile(rb"\x1b\[\?(2026|2048|1016);[123]\$y")  # DECRPM: set, reset or set for good
_KEYBOARD = re.compile(rb"\x1b\[\?[0-9]{1,5}u")
_AREA = re.compile(rb"\x1b\[4;([0-9]{1,6});([0-9]{1,6})t")
_CELL = re.compile(rb"\x1b\[6;([0-9]{1,6});([0-9]{1,6})t")
_REGISTERS = re.compile(rb"\x1b\[\?1;0;([0-9]{1,6})S")
_GEOMETRY = re.compile(rb"\x1b\[\?2;0;([0-9]{1,6});([0-9]{1,6})S")
_CELL_SIZE = re.compile(rb"\x1b\]1337;ReportCellSize=([0-9.]+);([0-9.]+)(?:;([0-9.]+))?")
_TRUECOLOR_CAP = re.compile(rb"\x1bP1\+r(?:524742|5463)", re.IGNORECASE)
_KEPT_COLOR = re.compile(rb"\x1bP1\$r[0-9:;]*48[:;]2[:;](?:[01]?[:;])?1[:;]2[:;]3m")

# Begin of XTVERSION's text, lower case. WezTerm, mintty, Rio, Warp, Tabby: by their documents.
_ITERM2_NAMES = (
    "iterm2", "konsole", "wezterm", "xterm.js", "mlterm", "mintty", "rio", "warp", "tabby",
)  # fmt: skip
_ITERM2_PROGRAMS = frozenset(
    ("iTerm.app", "WezTerm", "vscode", "mintty", "Tabby", "Hyper", "rio", "WarpTerminal")
)
_TRUECOLOR_NAMES = (
    "alacritty", "contour", "foot", "ghostty", "iterm2", "kitty", "konsole", "mintty", "rio",
    "vte", "warp", "wezterm", "xterm.js",
)  # fmt: skip


# Begin of the name, first version of those that draw block characters themselves. They draw
# sextants too, and kitty 0.48, foot 1.28 and Ghostty 1.2 octants; but quadrants with eighths show a
# picture as well as octants (mosaic.py), and look better, as they are made of more px.
_DRAWS = (
    ("kitty", (0, 26)), ("foot", (1, 13)), ("ghostty", (1,)), ("konsole", (22, 12)),
    ("wezterm", (20210314,)), ("vte", ()), ("alacritty", ()),
)  # fmt: skip
MOST_CELLS = 4096  # rows or columns; 8K with letters of 2 px
MOST_PIXELS = 1 << 27  # 16384x8192
GLYPHS = "TSPLAT_GLYPHS"
SAMPLES = "TSPLAT_SAMPLES"
SAMPLES_MAX = 8
GLYPH_SETS = ("halves", "quadrants", "sextants", "octants")


def holds_answer(data: bytes) -> bool:
    """Whether any answer is in ``data``: a terminal that begins to answer will end."""
    return _ANSWER.search(data) is not None


def split_answers(data: bytes) -> tuple[bytes, bytes]:
    """``data`` as (answers, the rest: what somebody typed meanwhile)."""
    return b"".join(m.group() for m in _ANSWER.finditer(data)), _ANSWER.sub(b"", data)


def name_in(answers: bytes) -> str:
    """What XTVERSION's answer among them says, printable; "" for none."""
    version = _XTVERSION.search(answers)
    return printable(version.group(1).decode("utf-8", "replace")) if version else ""


def parse_answers(
    answers: bytes,
    environ: Mapping[str, str],
    winsize: Winsize,
    around: bytes = b"",
    features: str = "",
) -> Terminal:
    """A terminal's facts from its answers to ``QUESTIONS``, the environment and the tty's size.

    Inside tmux ``around`` is what the terminal around it said to kitty's questions, XTVERSION and
    DA1, and ``features`` what tmux believes of it (its format ``client_termfeatures``).

    A protocol counts as there only if it was confirmed: kitty prints sixel data as text, and
    terminals without kitty graphics or OSC 1337 may print those. ``TSPLAT_TERMINAL`` has the last
    word.

    Raises:
        TerminalError: it is not understood.
    """
    said = name_in(answers)
    mux = multiplexer(said, environ)
    da1 = DA1_ANSWER.search(answers)
    attributes = da1.group(1).split(b";")[1:] if da1 else []
    registers = _REGISTERS.search(answers)
    geometry = _GEOMETRY.search(answers)
    modes = set(_MODE.findall(answers))
    name = said or _name_by_environment(environ)
    glyphs, draws_blocks = _glyphs(name, mux, environ)
    kitty_ok = {int(number) for number in _KITTY_OK.findall(around if mux == "tmux" else answers)}
    outside = name_in(around)
    sixel = b"4" in attributes
    if mux == "tmux":
        sixel = sixel and _shows_sixel(around, features)
    terminal = Terminal(
        cell_told=False,
        colors=_colors(answers, said, mux, environ),
        kitty=KITTY_ID in kitty_ok,
        iterm2=not mux and _has_iterm2(answers, said, environ),
        sixel=sixel,
        sixel_registers=max(2, int(registers.group(1))) if registers else 256,
        sixel_max=(int(geometry.group(1)), int(geometry.group(2))) if geometry else (0, 0),
        synchronized=b"2026" in modes,
        keyboard=_KEYBOARD.search(answers) is not None,
        in_band_resize=b"2048" in modes,
        pixel_mouse=b"1016" in modes or _has_pixel_mouse(said),
        glyphs=glyphs,
        samples=wanted_samples(environ),
        draws_blocks=draws_blocks,
        name=name,
        multiplexer=mux,
        around=outside,
        placeholders=_has_placeholders(outside or said),
        advice="" if sixel else _advice(mux, around),
        remote=is_remote(environ),
        media="".join(medium for medium, n in QUESTION_IDS.items() if n in kitty_ok),
    )
    terminal = _sized(terminal, _with_answers(winsize, answers, environ), _cell(answers))
    return overridden(terminal, environ.get("TSPLAT_TERMINAL", ""))


def _shows_sixel(around: bytes, features: str) -> bool:
    """Whether the terminal around a tmux that has sixel has it, too; text comes out if not.

    tmux (3.4 on, if built with it) lists attribute 4 whatever is around it. Where nothing can be
    found out about that, tmux is believed.
    """
    if da1 := DA1_ANSWER.search(around):
        return b"4" in da1.group(1).split(b";")[1:]
    return not features or "sixel" in features.split(",")


def _has_placeholders(name: str) -> bool:
    """Whether kitty's placeholders are shown: by kitty from 0.28 on, and by Ghostty.

    Others answer kitty's query, too, and show boxes instead.
    """
    if version := _KITTY_VERSION.match(name):
        return (int(version.group(1)), int(version.group(2))) >= (0, 28)
    return name.lower().startswith("ghostty")


def _has_pixel_mouse(name: str) -> bool:
    """Whether mode 1016 is there untold: Konsole, which answers no DECRQM, had it when measured."""
    version = _KONSOLE_VERSION.match(name)
    return version is not None and (int(version.group(1)), int(version.group(2))) >= (26, 8)


def _advice(mux: str, around: bytes) -> str:
    """What to do where a multiplexer lets no question through."""
    if mux == "tmux" and not DA1_ANSWER.search(around):
        return "tmux lets no pictures through until told `tmux set -g allow-passthrough on`"
    return "screen lets no pictures through; tmux can" if mux == "screen" else ""


def resized(terminal: Terminal, winsize: Winsize) -> Terminal:
    """The same terminal after a resize. Its cell changes only by more than half a px.

    What is less is a window's margin or rounding, see :func:`_sized`.
    """
    new = _sized(terminal, winsize, None)
    if abs(new.cell_width - terminal.cell_width) <= 0.5:
        new = replace(new, cell_width=terminal.cell_width)
    if abs(new.cell_height - terminal.cell_height) <= 0.5:
        new = replace(new, cell_height=terminal.cell_height)
    return new


def told_size(terminal: Terminal, winsize: Winsize) -> Terminal:
    """The same terminal, of the size that it tells in-band; itself if that is none to believe.

    The kernel's numbers are what somebody with access to the tty set; these come with what is
    typed. A picture of more than ``MOST_PIXELS`` is not begun for them.
    """
    if not all(1 <= cells <= MOST_CELLS for cells in winsize[:2]):
        return terminal
    new = resized(terminal, winsize)
    width, height = new.columns * new.cell_width, new.rows * new.cell_height
    return new if width * height <= MOST_PIXELS else terminal


def _sized(terminal: Terminal, winsize: Winsize, told: tuple[float, float] | None) -> Terminal:
    """``terminal`` with ``winsize``; ``told`` is the cell in px, if the terminal said it.

    A text area is finer than a cell in whole px (xterm.js: 867 px for 90 columns of 9.63, told
    as 10), but Konsole's may hold its margin, too (904 px for 90 columns of 10): the smaller is
    right. Without any px the cell stays what it was.
    """
    rows, columns, xpixel, ypixel = winsize
    rows, columns = rows or terminal.rows, columns or terminal.columns
    width, height = told or (terminal.cell_width, terminal.cell_height)
    known = xpixel >= 2 * columns and ypixel >= 2 * rows  # web ptys often say 0, some say cells
    if known:
        area = xpixel / columns, ypixel / rows
        width, height = (min(told[0], area[0]), min(told[1], area[1])) if told else area
    return replace(
        terminal, rows=rows, columns=columns, cell_width=width, cell_height=height,
        cell_told=terminal.cell_told or known or told is not None,
    )  # fmt: skip


def _with_answers(winsize: Winsize, answers: bytes, environ: Mapping[str, str]) -> Winsize:
    """``winsize``, its gaps filled from the environment and from the text area's answer."""
    rows, columns, xpixel, ypixel = winsize
    rows = rows or _number(environ.get("LINES")) or 24
    columns = columns or _number(environ.get("COLUMNS")) or 80
    area = _AREA.search(answers)
    if (xpixel < columns or ypixel < rows) and area:
        ypixel, xpixel = int(area.group(1)), int(area.group(2))
    return rows, columns, xpixel, ypixel


def _number(text: str | None) -> int:
    return int(text) if text and text.isdecimal() and len(text) < 5 else 0


def _cell(answers: bytes) -> tuple[float, float] | None:
    """Cell (width, height) in px, if the terminal said so."""
    if (cell := _CELL.search(answers)) and int(cell.group(1)) and int(cell.group(2)):
        return float(cell.group(2)), float(cell.group(1))
    if report := _CELL_SIZE.search(answers):  # points; the scale makes px of them
        try:
            height, width, scale = (float(n) for n in report.groups(b"1"))
        except ValueError:
            return None
        if 1 <= width * scale < 1e4 and 1 <= height * scale < 1e4 and isfinite(scale):
            return width * scale, height * scale
    return None


def multiplexer(said: str, environ: Mapping[str, str]) -> str:
    """tmux, screen or nothing. A name that is neither wins over variables a window inherited."""
    if said:
        return "tmux" if said.startswith("tmux") else ""
    term = environ.get("TERM", "")
    if environ.get("TMUX") or term.startswith("tmux"):
        return "tmux"
    return "screen" if environ.get("STY") or term.startswith("screen") else ""


def _name_by_environment(environ: Mapping[str, str]) -> str:
    """A name for terminals that do not answer XTVERSION."""
    for name in ("mlterm", "alacritty"):
        if environ.get("TERM", "").startswith(name):
            return name
    if version := environ.get("KONSOLE_VERSION"):
        return printable(f"Konsole {version}")
    words = environ.get("TERM_PROGRAM", ""), environ.get("TERM_PROGRAM_VERSION", "")
    return printable(" ".join(w for w in words if w)) or printable(environ.get("LC_TERMINAL", ""))


def _glyphs(name: str, mux: str, environ: Mapping[str, str]) -> tuple[str, bool]:
    """The set of block characters to use, and whether it is sure to be drawn well.

    Raises:
        TerminalError: ``TSPLAT_GLYPHS`` is none of them.
    """
    wanted = environ.get(GLYPHS, "").strip()
    if wanted and wanted not in GLYPH_SETS:
        raise TerminalError(
            f"{GLYPHS}: expected one of {', '.join(GLYPH_SETS)}, got {printable(repr(wanted))}"
        )
    if wanted:
        return wanted, wanted != "halves"
    version = tuple(int(n) for n in re.findall(r"\d{1,9}", name)[:2])
    draws = any(name.lower().startswith(start) and version >= first for start, first in _DRAWS)
    return "quadrants", draws and not mux  # a multiplexer's name says nothing of the terminal


def wanted_samples(environ: Mapping[str, str]) -> int:
    """Px rendered for each one shown; 0 for no wish.

    Raises:
        TerminalError: ``TSPLAT_SAMPLES`` is no number from 1 to 8.
    """
    wanted = environ.get(SAMPLES, "").strip()
    if wanted and wanted not in map(str, range(1, SAMPLES_MAX + 1)):
        raise TerminalError(
            f"{SAMPLES}: expected 1 to {SAMPLES_MAX}, got {printable(repr(wanted))}"
        )
    return int(wanted or 0)


def _has_iterm2(answers: bytes, said: str, environ: Mapping[str, str]) -> bool:
    """Whether OSC 1337 pictures are known to work; kitty, for one, prints them as text.

    Konsole and xterm.js 6.1 answer ReportCellSize. Variables count only where the terminal did
    not give a name: they are inherited by every window opened from such a terminal.
    """
    if _CELL_SIZE.search(answers):
        return True
    if said:
        return said.lower().startswith(_ITERM2_NAMES)
    return (
        environ.get("TERM_PROGRAM") in _ITERM2_PROGRAMS
        or environ.get("LC_TERMINAL") == "iTerm2"  # ssh passes it on
        or environ.get("TERM", "").startswith("mlterm")
    )


def _colors(answers: bytes, said: str, mux: str, environ: Mapping[str, str]) -> int:
    """How many colours SGR may show."""
    term = environ.get("TERM", "")
    if environ.get("NO_COLOR") or term.startswith(("vt1", "vt2")):
        return 2
    if term.startswith("linux"):
        return 16  # the console, whatever COLORTERM says
    if mux == "screen":
        return 256 if "256color" in term else 16  # no 24-bit before GNU screen 5
    if term.startswith("mlterm") and not said:
        return 256  # 3.9.0 runs out of colours with 24 bits and shows speckles; 3.9.4 has a name
    if (
        environ.get("COLORTERM") in ("truecolor", "24bit")
        or _TRUECOLOR_CAP.search(answers)
        or _KEPT_COLOR.search(answers)
        or term.endswith("-direct")
        or said.lower().startswith(_TRUECOLOR_NAMES)
    ):
        return 1 << 24
    return 256 if "256color" in term else 16
