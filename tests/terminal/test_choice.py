"""Which presenter a terminal gets, and the reason given."""

import pytest

from tsplat.core.errors import PluginError, TerminalError
from tsplat.presenters import blocks, braille, halfblock, iterm2, kitty, letters, sixel
from tsplat.presenters.base import Presenter, Terminal
from tsplat.terminal import choose_presenter

ROWS = {
    row.name: row for module in (kitty, iterm2, sixel, blocks, halfblock, braille, letters)
    for row in module.tsplat_presenters()
}  # fmt: skip
ALL = {"kitty": True, "iterm2": True, "sixel": True}


@pytest.mark.parametrize(
    ("terminal", "name"),
    [
        (Terminal(kitty=True, name="kitty(0.48.2)"), "kitty"),
        (Terminal(**ALL, name="Konsole 26.08.2"), "iterm2"),
        (Terminal(**ALL, name="xterm.js(6.1.0-beta.304)"), "iterm2"),
        (Terminal(iterm2=True, sixel=True, name="mlterm(3.9.4)"), "sixel"),
        (Terminal(kitty=True, sixel=True, name="Konsole 22.04"), "kitty"),
        (Terminal(iterm2=True, sixel=True), "iterm2"),
        (Terminal(sixel=True, name="foot(1.28.0)"), "sixel"),
        (Terminal(sixel=True, draws_blocks=True), "sixel"),
        (Terminal(draws_blocks=True, name="VTE(7600)"), "blocks"),
        (Terminal(), "halfblock"),
        (Terminal(glyphs="octants"), "halfblock"),
        (Terminal(kitty=True, iterm2=True, multiplexer="tmux"), "halfblock"),
        (Terminal(sixel=True, multiplexer="tmux"), "sixel"),
        (Terminal(**ALL, multiplexer="tmux", around="kitty(0.48.2)", placeholders=True), "kitty"),
        (Terminal(kitty=True, multiplexer="tmux", around="WezTerm 1"), "halfblock"),
    ],
)
def test_auto(terminal, name):
    """The highest rank that is supported, but the quickest where that was measured."""
    for wanted in (None, "auto"):
        presenter, reason = choose_presenter(ROWS, terminal, wanted)
        assert presenter.name == name
        assert reason.isprintable()


def test_the_wanted_one_is_obeyed():
    """Also against the facts, but then the reason says so."""
    presenter, reason = choose_presenter(ROWS, Terminal(), "sixel")
    assert presenter.name == "sixel"
    assert "sixel among its attributes" in reason
    assert choose_presenter(ROWS, Terminal(), "halfblock")[1] == "asked for"


def test_an_unknown_name_lists_the_known():
    """The error says what is installed."""
    with pytest.raises(PluginError, match=r"'sixl'; installed: blocks, .*, kitty, letters, sixel"):
        choose_presenter(ROWS, Terminal(), "sixl")


def test_nothing_can_be_shown():
    """Without a terminal the error has each presenter's reason."""
    with pytest.raises(TerminalError, match="halfblock: the output is not a terminal"):
        choose_presenter(ROWS, Terminal(tty=False), None)


def test_a_plugin_that_raises_is_passed_over():
    """A third party's fault is a reason against its presenter, not the end."""

    def broken(terminal):
        raise RuntimeError("no")

    rows = {**ROWS, "x": Presenter("x", "", lambda f, t, p: b"", lambda t: (1, 1), broken, rank=99)}
    assert choose_presenter(rows, Terminal(), None)[0].name == "halfblock"
