"""The panel and where it goes: at any size, after anything that is done to it."""

from __future__ import annotations

import re

import pytest

from tests.viewer import rules
from tests.viewer.rules import FACTS, VIEW, check_lines, plain, press
from tsplat.presenters.base import Terminal
from tsplat.terminal import Event
from tsplat.viewer.layout import PANEL, PICTURE, Area, layout
from tsplat.viewer.panel import MORE, Panel, placed
from tsplat.viewer.text import BOLD, help_lines, help_page, help_top, padded, width, wrapped

AREA = Area(0, 0, 41, 20)


@pytest.mark.parametrize("rule", rules.PANEL_RULES, ids=lambda rule: rule.__name__)
def test_the_panel(rule):
    """What the rule says holds of it."""
    rule(Panel)


def test_only_what_changed_is_written():
    """And what is written makes the screen what it is to be."""
    rules.check_placed(placed)


def test_picture_and_panel_are_apart():
    """On every screen from 1x1 cells to 500x150."""
    rules.check_layout(layout)


def test_a_closed_panel_takes_nothing():
    """The picture has the whole screen."""
    screen = Terminal(columns=200, rows=50)
    assert layout(screen, False).picture is screen
    assert layout(screen, False).panel is None


def test_the_panel_is_beside_the_picture_where_there_is_room():
    """On wide screens it has the columns at the right, on others the rows below, or all."""
    wide = layout(Terminal(columns=PANEL + PICTURE, rows=10), True)
    assert wide.picture.columns == PICTURE
    assert (wide.panel.left, wide.panel.top, wide.panel.rows) == (PICTURE + 1, 0, 9)
    high = layout(Terminal(columns=PANEL + PICTURE - 1, rows=40), True)
    assert high.picture.columns == high.panel.columns == PANEL + PICTURE - 1
    assert (high.panel.top, high.panel.rows) == (27, 12)
    small = layout(Terminal(columns=40, rows=10), True)
    assert small.picture is None
    assert (small.panel.columns, small.panel.rows) == (40, 9)


@pytest.mark.parametrize("columns", [1, 2, 7, 20, 41, 90])
def test_words_of_others_are_harmless(columns):
    """Figures with control characters and wide ones neither leave their lines nor the area."""
    area = Area(0, 0, columns, 60)
    now = Panel()
    for _ in range(80):
        now, _ = now.after(Event("key", "down"), VIEW, FACTS, area)
    lines = now.lines(VIEW, FACTS, area)
    check_lines(lines, area)
    assert columns < 7 or "日" in b"".join(lines).decode()


def test_a_narrow_panel_shows_whole_names_and_values():
    """20 columns: what does not fit beside each other is below each other, nothing is cut."""
    area = Area(0, 0, 20, 200)
    text = [plain(line).strip() for line in Panel().lines(VIEW, FACTS, area)]
    for words in ("alpha threshold", "1/255", "share of splats", "100 %"):
        assert any(words in line for line in text), words
    assert "field of view" in text
    assert "50 degrees" in text


def test_a_click_on_the_value_below_a_name():
    """In a narrow panel that line is the value's: its left half steps back, its right half on."""
    area = Area(0, 0, 20, 40)
    text = [plain(line).strip() for line in Panel().lines(VIEW, FACTS, area)]
    y = text.index("field of view") + 1
    assert Panel().after(press(15, y), VIEW, FACTS, area)[1].fov == 55
    assert Panel().after(press(4, y), VIEW, FACTS, area)[1].fov == 45
    there, view = Panel().after(press(4, y - 1), VIEW, FACTS, area)
    assert view is VIEW
    assert there.chosen(VIEW, FACTS).name == "field of view"


def test_more_below_can_be_clicked():
    """It shows what is there; a title is no row, and nothing happens."""
    lines = Panel().lines(VIEW, FACTS, AREA)
    assert plain(lines[-1]).rstrip() == MORE
    assert lines[0].startswith(BOLD)
    there, view = Panel().after(press(5, AREA.rows - 1), VIEW, FACTS, AREA)
    assert view is VIEW
    assert plain(there.lines(VIEW, FACTS, AREA)[0]) != plain(lines[0])
    assert Panel().after(press(30, 0), VIEW, FACTS, AREA) == (Panel(), VIEW)


def test_other_keys_are_not_the_panels():
    """The camera still moves by letters; the panel has the arrows."""
    for key in ("w", "p", "tab", "escape", "shift+left", " "):
        assert Panel().after(Event("key", key), VIEW, FACTS, AREA) is None


def test_lines_are_wrapped_by_columns():
    """Wide characters count twice, long words are broken, nothing is lost."""
    assert wrapped("ab cd efg", 5) == ["ab cd", "efg"]
    assert wrapped("日本語のテスト", 5) == ["日本", "語の", "テス", "ト"]
    assert wrapped("", 5) == [""]
    assert wrapped("abcdefgh i", 3) == ["abc", "def", "gh", "i"]
    assert width("日e\u0301") == 3
    assert padded("日本", 3) == "日 "


@pytest.mark.parametrize("columns", [20, 40, 60, 100])
def test_every_word_of_the_help_is_seen(columns):
    """Page by page, on a narrow screen as on a wide one."""
    screen = Terminal(columns=columns, rows=8, advice="set -g allow-passthrough on")
    seen, top = [], 0
    while True:
        page = help_page(screen, top)
        for row, text in re.findall(rb"\x1b\[(\d+);\d+H([^\x1b]*)", page):
            assert 1 <= int(row) <= 8
            assert width(text.decode()) <= columns
            if int(row) < 8:
                seen += text.decode().split()
        later = help_top(top + 7, screen)
        if later == top:
            break
        top = later
    assert set(" ".join(help_lines(Terminal(columns=200))).split()) <= set(seen)
    assert "passthrough" in " ".join(seen)
