"""Tests of the tests: panels, layouts and what is kept, each wrong in one way, are caught."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from tests.viewer import rules
from tsplat.viewer import panel as module
from tsplat.viewer.keep import Recording, free_name
from tsplat.viewer.layout import PANEL, Area, Layout, layout
from tsplat.viewer.panel import Panel, placed
from tsplat.viewer.text import cup


class NeverScrolls(Panel):
    def _shown(self, view, facts, area):
        lines, _, chosen = super()._shown(view, facts, area)
        return lines, 0, chosen


class ScrollsPastTheEnd(Panel):
    def _scrolled(self, by, view, facts, area):
        return replace(self, top=max(self.top + by, 0), loose=True)

    def _shown(self, view, facts, area):
        lines, top, chosen = super()._shown(view, facts, area)
        return lines, self.top if self.loose else top, chosen


class HidesBehindMore(Panel):
    """As if the last row were not taken by the words that there is more."""

    def _shown(self, view, facts, area):
        if self.loose:
            return super()._shown(view, facts, area)
        lines, _, chosen = super()._shown(view, facts, area)
        at = next(i for i, line in enumerate(lines) if line.key == chosen.key)
        return lines, min(max(self.top, at + 1 - area.rows, 0), at), chosen


class KnowsRowsByNumber(Panel):
    """What is chosen becomes another row when rows come above it."""

    def _chosen(self, stops):
        place = min(self.place, len(stops) - 1)
        return place, stops[place]


class SkipsFigures(Panel):
    def _at(self, stops, place):
        settable = [i for i, stop in enumerate(stops) if stop.row.step is not None]
        return super()._at(stops, min(settable, key=lambda i: abs(i - place)))


class StepsBackwards(Panel):
    def _changed(self, view, facts, area, by):
        return super()._changed(view, facts, area, -by)


class OneRowOff(Panel):
    def _after_mouse(self, event, view, facts, area):
        return super()._after_mouse(replace(event, y=event.y + 1), view, facts, area)


class OneLineTooMany(Panel):
    def lines(self, view, facts, area):
        return super().lines(view, facts, replace(area, rows=area.rows + 1))


class OneColumnTooFew(Panel):
    def lines(self, view, facts, area):
        return super().lines(view, facts, replace(area, columns=max(1, area.columns - 1)))


class CountsCharacters(Panel):
    """Pads by the number of characters, whatever their width."""

    def lines(self, view, facts, area):
        def padded(text, cells):
            return text[:cells].ljust(cells)

        right, module.padded = module.padded, padded
        try:
            return super().lines(view, facts, area)
        finally:
            module.padded = right


PANELS = {
    NeverScrolls: {"check_chosen_shown", "check_wheel"},
    ScrollsPastTheEnd: {"check_wheel"},
    HidesBehindMore: {"check_chosen_shown"},
    KnowsRowsByNumber: {"check_chosen_shown"},
    SkipsFigures: {"check_keys_reach_all"},
    StepsBackwards: {"check_steps", "check_mouse"},
    OneRowOff: {"check_mouse"},
    OneLineTooMany: {"check_geometry"},
    OneColumnTooFew: {"check_geometry"},
    CountsCharacters: {"check_geometry"},
}


def caught(checks, thing):
    """Names of those that fail."""
    names = set()
    for check in checks:
        try:
            check(thing)
        except AssertionError:
            names.add(check.__name__)
    return names


@pytest.mark.parametrize("panel", PANELS, ids=lambda panel: panel.__name__)
def test_a_wrong_panel_is_caught(panel):
    """By each rule that is meant to."""
    meant = [rule for rule in rules.PANEL_RULES if rule.__name__ in PANELS[panel]]
    assert caught(meant, panel) == PANELS[panel]


def test_every_rule_of_panels_catches_something():
    """One that no wrong panel breaks would prove nothing."""
    assert set.union(*PANELS.values()) == {rule.__name__ for rule in rules.PANEL_RULES}


def all_again(lines, before, area):
    return placed(lines, [], area)


def none_that_is_new(lines, before, area):
    return placed(lines[: len(before)], before, area)


def a_row_too_low(lines, before, area):
    return placed(lines, before, replace(area, top=area.top + 1))


def columns_of_the_screen(lines, before, area):
    return re.sub(rb";\d+H", b";1H", placed(lines, before, area))


def homeless(lines, before, area):
    return cup(1, area.left + 1).join([b"", *(li for li in lines if li not in before)])


@pytest.mark.parametrize(
    "wrong", [all_again, none_that_is_new, a_row_too_low, columns_of_the_screen, homeless]
)
def test_wrong_places_are_caught(wrong):
    """Too much written, too little, or elsewhere."""
    assert caught([rules.check_placed], wrong)


def on_the_last_row(screen, panel):
    found = layout(screen, panel)
    if found.panel is None:
        return found
    return replace(found, panel=replace(found.panel, rows=found.panel.rows + 1))


def on_the_picture(screen, panel):
    found = layout(screen, panel)
    return replace(found, picture=found.picture and screen)


def always_beside(screen, panel):
    area = Area(screen.columns - PANEL + 1, 0, PANEL - 1, max(1, screen.rows - 1))
    return Layout(replace(screen, columns=max(1, screen.columns - PANEL)), area)


def never_a_picture(screen, panel):
    return Layout(None, Area(0, 0, screen.columns, max(1, screen.rows - 1)))


def one_column_shared(screen, panel):
    found = layout(screen, panel)
    if found.picture is None or found.panel is None or found.panel.left == 0:
        return found
    return replace(found, panel=replace(found.panel, left=found.picture.columns - 1))


def small_pictures(screen, panel):
    """As if there were always room below a picture, however low that gets."""
    if screen.columns > 72 or screen.rows < 8:
        return layout(screen, panel)
    top = 2
    area = Area(0, top, screen.columns, screen.rows - 1 - top)
    return Layout(replace(screen, rows=top + 1), area)


@pytest.mark.parametrize(
    "wrong",
    [on_the_last_row, on_the_picture, always_beside, never_a_picture, one_column_shared,
     small_pictures],
)  # fmt: skip
def test_a_wrong_layout_is_caught(wrong):
    """On each other, off the screen, on the status line, or no picture where there is room."""
    assert caught([rules.check_layout], wrong)


def as_it_is_called(folder, stem, *suffixes):
    """The scene's name with nothing taken out."""
    return folder / f"tsplat-{stem}-001{suffixes[0]}"


def not_reserved(folder, stem, *suffixes):
    place = free_name(folder, stem, *suffixes)
    place.unlink()
    return place


def long_in_characters(folder, stem, *suffixes):
    """Cut to 80 characters, which may be 320 bytes; and names of that length are made."""
    name = re.sub(r"[^\w.-]+", "-", stem)[:80].strip("-.") or "scene"
    return Path(folder) / f"tsplat-{name}-{len(list(folder.iterdir()))}{suffixes[0]}"


def first_suffix_only(folder, stem, *suffixes):
    return free_name(folder, stem, suffixes[0])


@pytest.mark.parametrize("wrong", [as_it_is_called, not_reserved, long_in_characters])
def test_wrong_names_are_caught(wrong):
    """Out of the folder, given twice, too long."""
    assert caught([rules.check_names], wrong)


def test_names_that_would_overwrite_are_caught():
    """A file of the second suffix is somebody's, too."""
    assert caught([rules.check_nothing_is_overwritten], first_suffix_only)


class EveryMoment(Recording):
    """All poses, at whatever time; some at the same."""

    def add(self, now, camera):
        self.poses.append((now, camera))


class TenthsOnly(Recording):
    """Only poses a tenth of a second apart: the last place of a move may be missed."""

    def add(self, now, camera):
        if not self.poses or now >= self.poses[-1][0] + 0.1:
            self.poses.append((now, camera))


class NoRests(Recording):
    """Time stands still while the camera does."""

    def add(self, now, camera):
        if not self.poses or not camera.same(self.poses[-1][1]):
            super().add(now, camera)


class AnySize(Recording):
    """Cameras of the sizes that the window had, which are stretched when they are read."""

    def add(self, now, camera):
        super().add(now, camera)
        self.poses[-1] = self.poses[-1][0], camera


class FewPoses(Recording):
    """One pose a second: curves are cut short."""

    def add(self, now, camera):
        if not self.poses or now >= self.poses[-1][0] + 1 or camera.same(self.poses[-1][1]):
            super().add(now, camera)


class Nothing(Recording):
    """A stub."""

    def add(self, now, camera):
        pass


@pytest.mark.parametrize("wrong", [Nothing, EveryMoment, TenthsOnly, NoRests, AnySize, FewPoses])
def test_a_wrong_recording_is_caught(wrong):
    """It does not load, goes where the camera was not, or when it was not."""
    assert caught(rules.KEPT_RULES["recording"], wrong)
