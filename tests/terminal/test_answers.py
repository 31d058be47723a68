"""Facts from recorded answers.

Each row holds what a terminal of that version sent back when asked (90x30 cells), in the order
asked, without what it did not answer. tmux 3.3a ran inside kitty, 3.8 inside foot.
"""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsplat.core.errors import TerminalError
from tsplat.presenters.base import Terminal
from tsplat.terminal.answers import (
    KITTY_QUESTION,
    QUESTIONS,
    parse_answers,
    resized,
    split_answers,
    told_size,
)

TRUECOLOR = 1 << 24
WINSIZE = 30, 90, 900, 570
XTERM = {"TERM": "xterm"}
COLOR = {"COLORTERM": "truecolor"}
XTERM256 = {"TERM": "xterm-256color", **COLOR}

OK = b"\x1b_Gi=31;OK\x1b\\"
SYNC, NO_SYNC = b"\x1b[?2026;2$y", b"\x1b[?2026;0$y"
PIXELS = b"\x1b[4;570;900t\x1b[6;19;10t"
KEPT = b"\x1bP1$r0;48:2::1:2:3m\x1b\\"


def version(text):
    return b"\x1bP>|" + text + b"\x1b\\"


def modes(sizes, mouse, keys=b""):
    """Answers to DECRQM of 2048 and 1016, and to kitty's keyboard query."""
    return b"\x1b[?2048;%d$y\x1b[?1016;%d$y" % (sizes, mouse) + keys


KEYS = b"\x1b[?0u"

KITTY26 = (
    OK + version(b"kitty(0.26.5)") + SYNC + modes(0, 2, KEYS) + PIXELS
    + b"\x1bP0+r524742\x1b\\\x1bP0+r5463\x1b\\\x1bP1$r48:2:1:2:3m\x1b\\\x1b[?62;c"
)  # fmt: skip
KITTY48 = (
    OK + version(b"kitty(0.48.2)") + SYNC + modes(2, 2, KEYS) + PIXELS
    + b"\x1bP0+r524742\x1b\\\x1bP1+r5463\x1b\\\x1bP1$r0;48:2:1:2:3m\x1b\\\x1b[?62;52;c"
)  # fmt: skip
KONSOLE = (
    b"\x1b[?1;0;256S\x1b[?2;0;16384;16384S\x1b]1337;ReportCellSize=19.0;10.0;1.0\x07\x1b[?62;1;4c"
)
KONSOLE22 = OK + version(b"Konsole 22.12.3") + PIXELS + KONSOLE
KONSOLE26 = OK + version(b"Konsole 26.08.2") + KEYS + PIXELS + KONSOLE
XTERM_PLAIN = (
    version(b"XTerm(379)") + NO_SYNC + modes(0, 2) + PIXELS + b"\x1b[?1;3S\x1b[?2;3S" + KEPT
    + b"\x1b[?64;1;2;6;9;15;16;17;18;21;22;28c"
)  # fmt: skip
XTERM_VT340 = (
    version(b"XTerm(379)") + NO_SYNC + modes(0, 2) + PIXELS
    + b"\x1b[?1;0;1024S\x1b[?2;0;1000;1000S" + KEPT + b"\x1b[?63;1;2;4;6;9;15;16;22;28c"
)  # fmt: skip
MLTERM = (
    NO_SYNC + modes(0, 0) + PIXELS + b"\x1b[?1;0;1024S\x1b[?1;3;0S\x1bP0+r\x1b\\\x1bP0+r\x1b\\"
    b"\x1bP1$r0;48;5;16m\x1b\\\x1b[?63;1;2;3;4;6;7;15;18;22;29c"
)
FOOT13 = (
    version(b"foot(1.13.1)") + SYNC + modes(0, 2, KEYS) + b"\x1b[4;600;900t\x1b[6;20;10t"
    b"\x1b[?1;0;1024S\x1b[?2;0;10000;10000S\x1bP1+r524742=38\x1b\\\x1bP1+r5463\x1b\\"
    + KEPT + b"\x1b[?62;4;22c"
)  # fmt: skip
XTERM_JS = (
    SYNC + modes(0, 2) + b"\x1b[4;570;867t\x1b[6;19;10t\x1b[?1;0;256S\x1b[?2;0;4096;4096S"
    b"\x1bP1$r0m\x1b\\\x1b[?62;4;9;22c"
)
XTERM_JS_BETA = (
    OK + version(b"xterm.js(6.1.0-beta.304)") + SYNC + modes(0, 2) + b"\x1b[4;570;867t\x1b[6;19;10t"
    b"\x1b[?1;0;4096S\x1b[?2;0;4096;4096S\x1b]1337;ReportCellSize=19.000;9.633;1.000\x1b\\"
    b"\x1bP1$r0m\x1b\\\x1b[?62;4;9;22c"
)
TMUX33 = version(b"tmux 3.3a") + b"\x1b[?1;2c"
TMUX38 = (
    version(b"tmux 3.8")
    + SYNC
    + modes(0, 0)
    + b"\x1b[4;460;800t\x1b[6;20;10t\x1b[?1;0;1024S\x1b[?2;3;0S"
    b"\x1bP0$r\x1b\\\x1b[?1;2;4c"
)
TMUX = {"TERM": "tmux-256color", "TERM_PROGRAM": "tmux", "TMUX": "/tmp/tmux,1,0", **COLOR}

ALLOW = "tmux lets no pictures through until told `tmux set -g allow-passthrough on`"

# name: answers, environment, TIOCGWINSZ, and what to make of them
RECORDED = {
    "kitty 0.26": (KITTY26, {"TERM": "xterm-kitty", **COLOR}, WINSIZE, Terminal(
        90, 30, 10, 19, kitty=True, synchronized=True, draws_blocks=True,
        name="kitty(0.26.5)", keyboard=True, pixel_mouse=True)),
    "kitty 0.48": (KITTY48, {"TERM": "xterm-kitty"}, WINSIZE, Terminal(
        90, 30, 10, 19, kitty=True, synchronized=True, draws_blocks=True,
        name="kitty(0.48.2)", placeholders=True, keyboard=True, in_band_resize=True,
        pixel_mouse=True)),
    "konsole 22": (KONSOLE22, XTERM256, WINSIZE, Terminal(
        90, 30, 10, 19, kitty=True, iterm2=True, sixel=True, sixel_max=(16384, 16384),
        draws_blocks=True,
        name="Konsole 22.12.3")),
    "konsole 26": (KONSOLE26, XTERM256, (30, 90, 904, 570), Terminal(
        90, 30, 10, 19, kitty=True, iterm2=True, sixel=True, sixel_max=(16384, 16384),
        draws_blocks=True,
        name="Konsole 26.08.2", keyboard=True, pixel_mouse=True)),
    "xterm": (XTERM_PLAIN, XTERM, WINSIZE, Terminal(90, 30, 10, 19, name="XTerm(379)",
        pixel_mouse=True)),
    "xterm vt340": (XTERM_VT340, XTERM, WINSIZE, Terminal(
        90, 30, 10, 19, sixel=True, sixel_registers=1024, sixel_max=(1000, 1000),
        name="XTerm(379)", pixel_mouse=True)),
    "mlterm 3.9.0": (MLTERM, {"TERM": "mlterm"}, WINSIZE, Terminal(
        90, 30, 10, 19, colors=256, iterm2=True, sixel=True, sixel_registers=1024,
        name="mlterm")),
    "mlterm 3.9.4": (version(b"mlterm(3.9.4)") + MLTERM, {"TERM": "mlterm", **COLOR}, WINSIZE,
        Terminal(90, 30, 10, 19, iterm2=True, sixel=True, sixel_registers=1024,
                 name="mlterm(3.9.4)")),
    "foot 1.13": (FOOT13, {"TERM": "foot"}, (30, 90, 900, 600), Terminal(
        90, 30, 10, 20, sixel=True, sixel_registers=1024, sixel_max=(10000, 10000),
        synchronized=True, draws_blocks=True,
        name="foot(1.13.1)", keyboard=True, pixel_mouse=True)),
    "xterm.js 6.0": (XTERM_JS, XTERM256, (30, 90, 867, 570), Terminal(
        90, 30, 867 / 90, 19, sixel=True, sixel_max=(4096, 4096), synchronized=True,
        pixel_mouse=True)),
    "xterm.js 6.0, no pixels": (XTERM_JS, XTERM256, (30, 90, 0, 0), Terminal(
        90, 30, 867 / 90, 19, sixel=True, sixel_max=(4096, 4096), synchronized=True,
        pixel_mouse=True)),
    "xterm.js 6.1 beta": (XTERM_JS_BETA, XTERM256, (30, 90, 867, 570), Terminal(
        90, 30, 867 / 90, 19, kitty=True, iterm2=True, sixel=True, sixel_registers=4096,
        sixel_max=(4096, 4096), synchronized=True, name="xterm.js(6.1.0-beta.304)",
        pixel_mouse=True)),
    "tmux 3.3a": (TMUX33, TMUX, (23, 80, 800, 437), Terminal(
        80, 23, 10, 19, name="tmux 3.3a", multiplexer="tmux", advice=ALLOW)),
    "tmux 3.8": (TMUX38, TMUX, (23, 80, 800, 460), Terminal(
        80, 23, 10, 20, sixel=True, sixel_registers=1024, synchronized=True, name="tmux 3.8",
        multiplexer="tmux")),
    "ghostty-web": (b"", XTERM256, (30, 90, 0, 0), Terminal(90, 30, cell_told=False)),
}  # fmt: skip


@pytest.mark.parametrize("name", RECORDED)
def test_recorded_answers(name):
    """Every fact of each recorded terminal; foot, kitty and xterm need no COLORTERM for 24 bits."""
    answers, environ, winsize, expected = RECORDED[name]
    assert parse_answers(answers, environ, winsize) == expected


@pytest.mark.parametrize("name", RECORDED)
def test_typed_text_is_what_is_left(name):
    """Keys pressed before and after the answers are kept, and nothing else is."""
    answers = RECORDED[name][0]
    assert split_answers(b"q" + answers + b"\x1b[A") == (answers, b"q\x1b[A")


@pytest.mark.parametrize(
    ("answers", "environ", "colors"),
    [
        (b"", {"TERM": "xterm", "COLORTERM": "truecolor", "NO_COLOR": "1"}, 2),
        (b"", {"TERM": "xterm", "COLORTERM": "24bit", "NO_COLOR": ""}, TRUECOLOR),
        (b"", {"TERM": "linux", "COLORTERM": "truecolor"}, 16),
        (b"", {"TERM": "vt220"}, 2),
        (b"", {"TERM": "xterm"}, 16),
        (b"", {"TERM": "xterm-256color"}, 256),
        (b"", {"TERM": "xterm-direct"}, TRUECOLOR),
        (b"", {"TERM": "screen-256color", "STY": "1.tty", "COLORTERM": "truecolor"}, 256),
        (b"\x1bP1+r524742=38\x1b\\", {"TERM": "foot"}, TRUECOLOR),
        (b"\x1bP0+r524742\x1b\\", {"TERM": "xterm"}, 16),
        (b"\x1bP1$r0;48;2;1;2;3m\x1b\\", {"TERM": "xterm"}, TRUECOLOR),
        (b"\x1bP1$r0;48;5;16m\x1b\\", {"TERM": "xterm"}, 16),
        (version(b"WezTerm 20240203"), {"TERM": "xterm-256color"}, TRUECOLOR),
    ],
)
def test_colours(answers, environ, colors):
    """NO_COLOR first, then what is known to lie, then every way to say 24 bits, then TERM."""
    assert parse_answers(answers, environ, WINSIZE).colors == colors


# What came through tmux 3.3a in kitty: first tmux's own answers, then these
AROUND26 = OK + b"\x1b_Gi=32;OK\x1b\\" + version(b"kitty(0.26.5)") + b"\x1b[?62;c"
AROUND48 = OK + b"\x1b_Gi=32;OK\x1b\\" + version(b"kitty(0.48.2)") + b"\x1b[?62;52;c"
AROUND_FOOT = version(b"foot(1.28.0)") + b"\x1b[?62;4;22c"


@pytest.mark.parametrize(
    ("around", "expected"),
    [
        (b"", (False, "", False, "", ALLOW)),
        (AROUND48, (True, "kitty(0.48.2)", True, "s", "")),
        (AROUND26, (True, "kitty(0.26.5)", False, "s", "")),
        (AROUND_FOOT, (False, "foot(1.28.0)", False, "", "")),
        (OK + version(b"WezTerm 20240203") + b"\x1b[?65;4c",
         (True, "WezTerm 20240203", False, "", "")),
        (OK + version(b"ghostty 1.3.0") + b"\x1b[?62c", (True, "ghostty 1.3.0", True, "", "")),
    ],
)  # fmt: skip
def test_around_tmux(around, expected):
    """Kitty's pictures count as there if the terminal around answers; advice if it does not."""
    told = parse_answers(TMUX33, TMUX, WINSIZE, around)
    facts = told.kitty, told.around, told.placeholders, told.media, told.advice
    assert facts == expected
    assert told.name == "tmux 3.3a"


@pytest.mark.parametrize(
    ("answers", "around", "features", "sixel"),
    [
        (TMUX38, b"", "", True),  # nothing known: tmux is believed
        (TMUX38, b"", "256,RGB,sixel,title", True),
        (TMUX38, b"", "256,RGB,title", False),
        (TMUX38, AROUND_FOOT, "", True),
        (TMUX38, AROUND48, "256,sixel", False),
        (TMUX33, AROUND_FOOT, "256,sixel", False),
    ],
)
def test_sixel_in_tmux(answers, around, features, sixel):
    """Tmux and the terminal around it must both have it, or words are shown instead."""
    told = parse_answers(answers, TMUX, WINSIZE, around, features)
    assert told.sixel is sixel


@pytest.mark.parametrize(
    ("answers", "environ", "iterm2"),
    [
        (b"", {"TERM_PROGRAM": "vscode"}, True),
        (b"", {"LC_TERMINAL": "iTerm2"}, True),
        (b"", {"TERM_PROGRAM": "Apple_Terminal"}, False),
        (version(b"XTerm(379)"), {"TERM_PROGRAM": "vscode"}, False),
        (version(b"kitty(0.48.2)"), {"LC_TERMINAL": "iTerm2"}, False),
        (version(b"iTerm2 3.5.11"), {}, True),
        (version(b"tmux 3.4"), {"LC_TERMINAL": "iTerm2"}, False),
        (b"", {"TERM": "screen", "LC_TERMINAL": "iTerm2"}, False),
    ],
)
def test_iterm2_is_known_by_name(answers, environ, iterm2):
    """Its own name beats inherited variables; behind a multiplexer nothing is known."""
    assert parse_answers(answers, environ, WINSIZE).iterm2 is iterm2


@pytest.mark.parametrize(
    ("answers", "environ", "mux"),
    [
        (b"", {"TMUX": "/tmp/x", "TERM": "screen"}, "tmux"),
        (b"", {"TERM": "screen.xterm-256color"}, "screen"),
        (b"", {"STY": "123.pts-0", "TERM": "xterm"}, "screen"),
        (version(b"kitty(0.48.2)"), {"TMUX": "/tmp/x"}, ""),
        (version(b"tmux 3.8"), {"TERM": "xterm"}, "tmux"),
    ],
)
def test_multiplexer(answers, environ, mux):
    """By name where there is one, so that a window opened out of tmux is not taken for it."""
    assert parse_answers(answers, environ, WINSIZE).multiplexer == mux


def test_names_are_printable():
    """A name with control characters cannot get at the terminal again."""
    terminal = parse_answers(version(b"x\x9b\x07\xff"), {}, WINSIZE)
    assert terminal.name.isprintable()


def test_kitty_must_say_ok():
    """An error is no support."""
    answers = b"\x1b_Gi=31;ENOTSUPPORTED:\x1b\\\x1b[?62c"
    assert not parse_answers(answers, {}, WINSIZE).kitty


def test_sizes_without_a_window_size():
    """No TIOCGWINSZ: COLUMNS and LINES, else 80x24; ReportCellSize in points times scale."""
    told = parse_answers(b"\x1b]1337;ReportCellSize=17.5;8.0;2.0\x07", {}, (0, 0, 0, 0))
    assert (told.columns, told.rows, told.cell_width, told.cell_height) == (80, 24, 16, 35)
    environ = {"COLUMNS": "100", "LINES": "40"}
    told = parse_answers(b"", environ, (0, 0, 0, 0))
    assert (told.columns, told.rows, told.cell_width, told.cell_height) == (100, 40, 10, 20)


def test_resizing_keeps_the_cell():
    """The margin that Konsole counts in does not widen cells; another font does."""
    terminal = parse_answers(KONSOLE26, XTERM256, WINSIZE)
    wider = resized(terminal, (40, 120, 1204, 760))
    assert (wider.columns, wider.rows, wider.cell_width, wider.cell_height) == (120, 40, 10, 19)
    zoomed = resized(terminal, (15, 45, 900, 570))
    assert (zoomed.cell_width, zoomed.cell_height) == (20, 38)
    assert resized(terminal, (40, 120, 0, 0)).cell_width == 10


def test_a_size_told_in_band():
    """It counts as one that the kernel tells; numbers that no window has do not."""
    terminal = Terminal(90, 30, 10, 19)
    told = told_size(terminal, (40, 120, 1200, 760))
    assert (told.columns, told.rows, told.cell_width) == (120, 40, 10)
    assert told_size(terminal, (40, 120, 0, 0)) == Terminal(120, 40, 10, 19)
    wall = told_size(terminal, (216, 768, 7680, 4320))  # 8K
    assert (wall.columns, wall.rows) == (768, 216)
    for hostile in (
        (0, 0, 0, 0), (0, 80, 800, 456), (24, 0, 800, 456), (999999, 80, 800, 456),
        (4096, 4096, 0, 0), (24, 80, 999999, 999999), (24, 80, 60000, 60000), (1, 1, 65535, 65535),
    ):  # fmt: skip
        assert told_size(terminal, hostile) is terminal


@given(st.tuples(*[st.integers(0, 5000) | st.integers(0, 999999)] * 4))
def test_whatever_size_is_told(size):
    """The picture for it has pixels, and no more than memory for it."""
    width, height = told_size(Terminal(90, 30, 10, 19), size).pixels
    assert 0 < width * height <= 1 << 27


@pytest.mark.parametrize("value", range(6))
def test_modes_by_number(value):
    """DECRPM: 1 to 3 are there; 0 is unknown, 4 can never be set. One says nothing of another."""
    for mode, field in ((2026, "synchronized"), (2048, "in_band_resize"), (1016, "pixel_mouse")):
        facts = parse_answers(b"\x1b[?%d;%d$y\x1b[?62;c" % (mode, value), XTERM, WINSIZE)
        assert getattr(facts, field) is (value in (1, 2, 3))
        expected = Terminal(90, 30, 10, 19, colors=16)
        assert facts == replace(expected, **{field: value in (1, 2, 3)})


def test_the_keyboard_protocol():
    """Any answer to its query, whatever flags are on; an older Konsole has no pixels either."""
    for flags in (b"0", b"1", b"31"):
        assert parse_answers(b"\x1b[?" + flags + b"u\x1b[?62c", XTERM, WINSIZE).keyboard
    assert not parse_answers(b"\x1b[u\x1b[?u\x1b[?62c", XTERM, WINSIZE).keyboard
    for name, has in ((b"Konsole 25.04.2", False), (b"Konsole 26.08.0", True), (b"Konsole", False)):
        assert parse_answers(version(name), XTERM, WINSIZE).pixel_mouse is has


def test_questions_are_only_asked():
    """Nothing is tried out on the screen, and tmux gets no title: kitty's query is by itself."""
    assert b"a=q" in KITTY_QUESTION
    assert b"\x1b_" not in QUESTIONS
    assert b"\x1b[c" not in QUESTIONS


@pytest.mark.parametrize(
    ("said", "media"),
    [
        (b"32;OK", "s"),
        (b"33;OK", "t"),
        (b"32;ENOTSUPPORTED:", ""),
        (b"32;OK\x1b\\\x1b_Gi=33;OK", "st"),
        (b"132;OK", ""),
    ],
)
def test_media(said, media):
    """Each medium by the answer to its own question; an error is none."""
    answers = OK + b"\x1b_Gi=" + said + b"\x1b\\\x1b[?62c"
    assert parse_answers(answers, {}, WINSIZE).media == media


@pytest.mark.parametrize("name", ["SSH_CONNECTION", "SSH_TTY", "SSH_CLIENT"])
def test_remote(name):
    """Any of sshd's variables says that a network is in between."""
    assert parse_answers(b"", {name: "x"}, WINSIZE).remote
    assert not parse_answers(b"", {name: ""}, WINSIZE).remote


@given(st.binary(max_size=200))
def test_noise_is_harmless(noise):
    """Whatever comes, there is a terminal of a positive size."""
    answers, typed = split_answers(noise)
    terminal = parse_answers(answers, {}, (0, 0, 0, 0))
    assert terminal.cell_width > 0
    assert terminal.columns > 0
    assert len(answers) + len(typed) == len(noise)


@pytest.mark.parametrize(
    ("name", "environ", "facts"),
    [
        (b"kitty(0.48.2)", {}, ("quadrants", True)),
        (b"kitty(0.26.5)", {}, ("quadrants", True)),
        (b"kitty(0.19.3)", {}, ("quadrants", False)),
        (b"foot(1.28.0)", {}, ("quadrants", True)),
        (b"foot(1.13.1)", {}, ("quadrants", True)),
        (b"ghostty 1.3.0-main+5cb2fa6f", {}, ("quadrants", True)),
        (b"ghostty 1.0.2", {}, ("quadrants", True)),
        (b"Konsole 26.08.2", {}, ("quadrants", True)),
        (b"WezTerm 20240203-110809-5046fc22", {}, ("quadrants", True)),
        (b"VTE(7600)", {}, ("quadrants", True)),
        (b"XTerm(412)", {}, ("quadrants", False)),
        (b"xterm.js(6.1.0-beta.304)", {}, ("quadrants", False)),
        (b"tmux 3.8", {"TERM_PROGRAM": "tmux"}, ("quadrants", False)),
        (b"XTerm(412)", {"TSPLAT_GLYPHS": "sextants"}, ("sextants", True)),
        (b"kitty(0.48.2)", {"TSPLAT_GLYPHS": "halves"}, ("halves", False)),
        (b"tmux 3.8", {"TSPLAT_GLYPHS": "octants"}, ("octants", True)),
        (b"kitty(0.48.2)", {"TSPLAT_GLYPHS": ""}, ("quadrants", True)),
    ],
)
def test_block_characters(name, environ, facts):
    """Quadrants, sure where the terminal is known to draw them itself; or what is asked for."""
    terminal = parse_answers(version(name) + b"\x1b[?62;c", {**XTERM, **environ}, WINSIZE)
    assert (terminal.glyphs, terminal.draws_blocks) == facts


def test_alacritty_is_known_by_its_terminfo():
    """It answers no XTVERSION; in tmux the name would be that of the terminal outside."""
    environ = {"TERM": "alacritty"}
    assert parse_answers(b"\x1b[?6c", environ, WINSIZE).draws_blocks
    assert not parse_answers(b"\x1b[?6c", {**environ, "TMUX": "1"}, WINSIZE).draws_blocks


def test_it_is_known_whether_a_cell_is_a_guess():
    """By the kernel's px, the text area's or the cell's answer it is not; without any it is."""
    bare = (24, 80, 0, 0)
    assert not parse_answers(b"", XTERM, bare).cell_told
    assert parse_answers(b"", XTERM, (24, 80, 800, 480)).cell_told
    assert parse_answers(b"\x1b[4;480;800t", XTERM, bare).cell_told
    assert parse_answers(b"\x1b[6;20;10t", XTERM, bare).cell_told
    assert resized(parse_answers(b"", XTERM, bare), (24, 80, 800, 480)).cell_told
    assert resized(parse_answers(b"\x1b[6;20;10t", XTERM, bare), bare).cell_told


def test_the_number_of_samples_can_be_set():
    """TSPLAT_SAMPLES, 1 to 8; nothing else is understood."""
    assert parse_answers(b"", {**XTERM, "TSPLAT_SAMPLES": "3"}, WINSIZE).samples == 3
    assert parse_answers(b"", XTERM, WINSIZE).samples == 0
    with pytest.raises(TerminalError, match="TSPLAT_SAMPLES: expected 1 to 8, got '0'"):
        parse_answers(b"", {**XTERM, "TSPLAT_SAMPLES": "0"}, WINSIZE)


def test_unknown_block_characters_are_an_error():
    """The text lists those there are."""
    with pytest.raises(TerminalError, match=r"TSPLAT_GLYPHS: expected one of halves, quad.*'dots'"):
        parse_answers(b"", {**XTERM, "TSPLAT_GLYPHS": "dots"}, WINSIZE)
