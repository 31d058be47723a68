"""What the user says of a terminal beats its answers."""

import pytest

from tsplat.core.errors import TerminalError
from tsplat.presenters import halfblock, iterm2, kitty, sixel
from tsplat.presenters.base import Terminal
from tsplat.terminal import choose_presenter, parse_answers
from tsplat.terminal.profiles import FEATURES, PROFILES, overridden

ROWS = {
    row.name: row for module in (kitty, iterm2, sixel, halfblock)
    for row in module.tsplat_presenters()
}  # fmt: skip
KITTY = Terminal(99, 33, 7.0, 15.0, kitty=True, synchronized=True, media="st", name="kitty(0.48.2)")


@pytest.mark.parametrize(
    ("name", "presenter"),
    {
        "plain": "halfblock", "kitty": "kitty", "ghostty": "kitty", "konsole": "iterm2",
        "wezterm": "iterm2", "iterm2": "iterm2", "vscode": "iterm2", "foot": "sixel",
        "mlterm": "sixel",
    }.items(),
)  # fmt: skip
def test_profiles(name, presenter):
    """A named terminal gets the presenter that suits it; its size is what was found."""
    terminal = overridden(KITTY, name)
    assert choose_presenter(ROWS, terminal, None)[0].name == presenter
    assert (terminal.columns, terminal.cell_width) == (99, 7.0)
    assert name in PROFILES


def test_profiles_of_input():
    """What a named terminal tells of keys and the mouse; nothing where that is not known."""
    told = {
        name: (terminal.keyboard, terminal.pixel_mouse, terminal.in_band_resize)
        for name in PROFILES
        for terminal in [overridden(overridden(Terminal(), "+keys,+pixel-mouse,+resize"), name)]
    }
    assert told["kitty"] == told["ghostty"] == told["foot"] == (True, True, True)
    assert told["konsole"] == (True, True, False)
    assert told["vscode"] == (False, True, False)
    for name in ("plain", "iterm2", "mlterm", "wezterm"):
        assert told[name] == (False, False, False)


@pytest.mark.parametrize("feature", FEATURES)
def test_features(feature):
    """Each can be added and taken away, and nothing else changes."""
    on, off = overridden(Terminal(), f"+{feature}"), overridden(KITTY, f"-{feature}")
    assert getattr(on, FEATURES[feature]) is True
    assert getattr(off, FEATURES[feature]) is False
    assert overridden(on, f"-{feature}") == Terminal()


def test_words_are_taken_in_order():
    """The last word wins."""
    terminal = overridden(KITTY, "foot, -sixel,colors=256,-sharing")
    assert (terminal.name, terminal.kitty, terminal.sixel) == ("foot", False, False)
    assert (terminal.colors, terminal.media) == (256, "")
    assert overridden(KITTY, "") == overridden(KITTY, " ,") == KITTY


@pytest.mark.parametrize("spec", ["xtrem", "+sixl", "sixel", "colors=7", "foot,\x1b[2J"])
def test_misspelt(spec):
    """An error lists what is known, and is fit to print."""
    with pytest.raises(TerminalError, match="TSPLAT_TERMINAL: expected one of plain, kitty") as e:
        overridden(KITTY, spec)
    assert str(e.value).isprintable()


def test_answers_are_overridden():
    """The variable has the last word on what was answered."""
    answers = b"\x1b_Gi=31;OK\x1b\\\x1b[?62;4c"
    terminal = parse_answers(answers, {"TSPLAT_TERMINAL": "-kitty,+sync"}, (30, 90, 900, 570))
    assert (terminal.kitty, terminal.sixel, terminal.synchronized) == (False, True, True)
