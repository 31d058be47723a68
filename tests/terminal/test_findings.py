"""The table of what a terminal was asked, answered, and what follows."""

import json
from dataclasses import replace

import pytest
from fakes import FakeTerminal
from test_answers import (
    AROUND48,
    KITTY48,
    KONSOLE26,
    RECORDED,
    TMUX,
    TMUX33,
    TMUX38,
    WINSIZE,
    XTERM256,
)

from tsplat.terminal.device import Heard
from tsplat.terminal.findings import LIARS, NOTHING, findings


def table(heard, environ, winsize=WINSIZE):
    """question -> (answer, conclusion); what is known of it by name, apart."""
    rows = findings(heard, environ, winsize, heard.terminal(environ, winsize))
    known = [(r.question, r.answer) for r in rows if r.question.startswith("known of")]
    return {r.question: (r.answer, r.conclusion) for r in rows}, known


@pytest.mark.parametrize("name", RECORDED)
def test_every_recorded_terminal(name):
    """All rows are filled and fit to print; conclusions are the facts that presenters get."""
    answers, environ, winsize, facts = RECORDED[name]
    rows, _ = table(Heard(answers), environ, winsize)
    for question, (answer, conclusion) in rows.items():
        assert question.isprintable()
        assert answer.isprintable()
        assert answer
        assert conclusion
    where = " past tmux" if facts.multiplexer else ""
    assert rows["DA1 attribute 4"][1] == ("sixel" if facts.sixel else "no sixel")
    assert (rows["kitty a=q" + where][1] == "kitty graphics") is facts.kitty
    assert rows["ReportCellSize"][1].startswith("iTerm2") is facts.iterm2
    assert (rows["DECRQM 2026"][1] == "synchronized output") is facts.synchronized
    assert (rows["DECRQM 1016"][1] == "the mouse moves in px") is facts.pixel_mouse
    assert (rows["DECRQM 2048"][1] == "it tells its new size") is facts.in_band_resize
    told = "told when a key is let go"
    assert (rows["kitty keyboard CSI ?u"][1] == told) is facts.keyboard
    assert (rows["DA1"][0] == NOTHING) is (name == "ghostty-web")


def test_answers_are_shown():
    """As they came, without ESC."""
    rows, _ = table(Heard(KITTY48 + b"\x1b_Gi=32;EBADF:no\x1b\\"), {})
    assert rows["kitty a=q"] == ("OK", "kitty graphics")
    assert rows["kitty a=q,t=s"] == ("EBADF:no", "shared memory not read")
    assert rows["XTVERSION"][0] == "kitty(0.48.2)"
    assert rows["kitty keyboard CSI ?u"][0] == "[?0u"
    assert rows["DECRQM 1016"][0] == "[?1016;2$y"
    assert rows["DECRQM 2048"][0] == "[?2048;2$y"
    assert rows["DA1"][0] == "[?62;52;c"


def test_past_tmux():
    """The terminal around has rows of its own; where nothing comes through, what to do."""
    rows, known = table(Heard(TMUX33, around=AROUND48), TMUX)
    assert rows["around tmux: XTVERSION"] == ("kitty(0.48.2)", "name: kitty(0.48.2)")
    assert rows["kitty a=q past tmux"] == ("OK", "kitty graphics")
    assert rows["placeholders"][1] == "has them"
    assert {question for question, _ in known} == {"known of tmux"}
    rows, _ = table(Heard(TMUX33), TMUX)
    assert "allow-passthrough on" in rows["around tmux: XTVERSION"][1]
    rows, _ = table(Heard(TMUX38, features="256,title"), TMUX)
    assert rows["DA1 attribute 4"] == ("listed, tmux: 256,title", "no sixel")


def test_liars_by_name():
    """What is known of a terminal is told for that one, and each has a reason."""
    _, known = table(Heard(KONSOLE26), XTERM256)
    assert known == [("known of konsole", lie) for lie, _ in LIARS["konsole"]]
    assert table(Heard(KITTY48), {})[1] == []
    assert all(len(lie) > 20 for lies in LIARS.values() for lie, _ in lies)


def done(heard, environ, **changes):
    """What is done about each lie, where the terminal is as it is but for ``changes``."""
    terminal = replace(heard.terminal(environ, WINSIZE), **changes)
    rows = findings(heard, environ, WINSIZE, terminal)
    return [row.conclusion for row in rows if row.question.startswith("known of")]


def test_what_is_done_about_liars():
    """It is said of each, and only where it is so."""
    konsole = Heard(KONSOLE26)
    first, sync, cell, mouse, releases = done(konsole, XTERM256)
    assert first == "neither is used; iterm2 is chosen before kitty"
    assert "all terminals" in sync
    assert cell.endswith(" px")
    assert mouse == "believed to, by its version"
    assert "20 ms" in releases
    old = done(konsole, XTERM256, pixel_mouse=False, keyboard=False, iterm2=False, sixel=False)
    assert [words.partition("nothing: ")[2] for words in (old[0], *old[3:])] == [
        "there is no other way", "this version is older", "this one tells no releases",
    ]  # fmt: skip
    xterm = Heard(b"\x1bP>|XTerm(379)\x1b\\")
    assert done(xterm, XTERM256, colors=256, sixel=False) == [
        "256 colours are sent", "nothing: this one shows no sixel",
    ]  # fmt: skip
    assert "scrolled out" in done(xterm, XTERM256, sixel=True)[1]
    assert done(Heard(TMUX38), TMUX)[0].startswith("the terminal around is asked")
    assert done(Heard(TMUX38, features="256,title"), TMUX)[0] == "no sixel is sent"
    past = done(Heard(TMUX33, around=KONSOLE26), TMUX)
    assert past.count("no pictures are sent past tmux") == len(LIARS["konsole"])


def test_over_ssh_and_overridden():
    """Media are not asked for over ssh; the user's words are listed."""
    environ = {"SSH_TTY": "/dev/pts/1", "TSPLAT_TERMINAL": "-kitty"}
    rows, _ = table(Heard(KITTY48), environ)
    assert rows["kitty a=q,t=s"][0] == "not asked over ssh"
    assert rows["kitty a=q"] == ("OK", "no kitty graphics")
    assert rows["TSPLAT_TERMINAL"] == ("-kitty", "overrides the answers")


def test_plugins_tells_scripts():
    """``tsplat plugins --json`` in a terminal: what was asked, answered, chosen, and why."""
    code = "import sys; from tsplat.cli import main; sys.exit(main(['plugins', '--json']))"
    with FakeTerminal(extra=b"\x1bP>|foot(1.28.0)\x1b\\") as terminal:
        process = terminal.spawn(code)
        assert process.communicate(timeout=60)[1] == ""
        terminal.settle()
        text = terminal.output[terminal.output.rindex(b"\x1b[?1049l") + 8 :]
    told = json.loads(text)["terminal"]
    assert told["chosen"] == "sixel"
    assert told["why"] == "the best foot(1.28.0) supports"
    rows = {row["question"]: row["answer"] for row in told["asked"]}
    assert rows["XTVERSION"] == "foot(1.28.0)"
    reasons = {row["name"]: row["reason"] for row in told["presenters"]}
    assert "kitty's graphics query" in reasons["kitty"]
    assert told["facts"]["columns"] == 80
