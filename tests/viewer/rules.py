"""What must hold of the panel, of the layout and of what is kept, as functions of what is tested.

Each takes the thing itself, so that ``tests/meta`` can pass it one that is wrong. They fail with an
AssertionError.
"""

from __future__ import annotations

import re
import tempfile
from dataclasses import fields, is_dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from tsplat.core.camera import Orbit, look_at
from tsplat.paths import load_path
from tsplat.presenters.base import Terminal
from tsplat.terminal import Event
from tsplat.testing.stream import columns_of
from tsplat.viewer.controls import View
from tsplat.viewer.layout import PICTURE, PICTURE_ROWS, Area
from tsplat.viewer.panel import NAME
from tsplat.viewer.settings import Facts, sections
from tsplat.viewer.text import REVERSE, fitted

HOME = Orbit(np.zeros(3), 5.0, 0.3, 0.2, np.array([0.0, -1.0, 0.0]))
VIEW = View(HOME, HOME, 50.0)
HOSTILE = "日本語 \x1b[2J\r\n\x9b2J \u202e e\u0301\u0301 \U0001f600 " + "x" * 60
FIGURES = (("render", "1.2 ms"), ("without", "a: b"), ("without", "c: d"), ("terminal", HOSTILE))
FACTS = Facts(("kitty", "sixel"), ("cffi", "numpy"), {"presenter": "kitty"}, FIGURES)


def flat(thing, name=""):
    """All values in a dataclass and those in it: dotted name -> value."""
    if is_dataclass(thing):
        found = {}
        for field in fields(thing):
            found |= flat(getattr(thing, field.name), f"{name}.{field.name}".lstrip("."))
        return found
    return {name: tuple(thing.tolist()) if isinstance(thing, np.ndarray) else thing}


def changed(before, after):
    """Names of the values that differ."""
    a, b = flat(before), flat(after)
    return {name for name in a.keys() | b.keys() if a.get(name) != b.get(name)}


# --- the panel

KEYS = ("up", "down", "pageup", "pagedown", "left", "right", "enter", "backspace")
areas = st.builds(Area, st.integers(0, 9), st.integers(0, 9), st.integers(1, 120),
                  st.integers(1, 60))  # fmt: skip
DOWN = Event("key", "down")
AREA = Area(0, 0, 41, 20)
keys = st.builds(Event, st.just("key"), st.sampled_from(KEYS))
wheels = st.builds(
    lambda turn: Event("mouse", action="wheel", button=turn), st.sampled_from(("up", "down"))
)
clicks = st.builds(
    lambda x, y, button: Event("mouse", action="press", button=button, x=x, y=y),
    st.floats(0, 0.999), st.floats(0, 0.999), st.sampled_from(("left", "right")),
)  # fmt: skip


def inside(event, area):
    """``event`` of the mouse, its share of the area as a cell."""
    if event.kind != "mouse":
        return event
    x, y = area.left + event.x * area.columns, area.top + event.y * area.rows
    return Event("mouse", action=event.action, button=event.button, x=x, y=y)


def plain(line):
    """A line's text; its colours are taken off."""
    return re.sub(rb"\x1b\[[0-9;]*m", b"", line).decode()


def check_lines(lines, area):
    """As many as the area has rows, as wide as it is, and nothing in them but text and colours."""
    assert len(lines) == area.rows
    for line in lines:
        text = plain(line)
        assert text.isprintable(), text
        assert sum(map(columns_of, text)) == area.columns, text


def check_geometry(panel):
    """Whatever is done to it, it fills its area and nothing else."""

    @given(areas, st.lists(keys | wheels | clicks, max_size=8))
    def check(area, events):
        now, view = panel(), VIEW
        for event in events:
            now, view = now.after(inside(event, area), view, FACTS, area)
            check_lines(now.lines(view, FACTS, area), area)

    check()


def check_chosen_shown(panel):
    """After any key the chosen row is seen, and by its name, on screens of any size."""

    @given(areas, st.lists(keys | wheels | clicks, max_size=12), keys, areas, st.booleans())
    @example(AREA, [DOWN] * 30, DOWN, AREA, True)  # below the box's rows
    def check(area, events, last, later, cropped):
        now, view = panel(), VIEW
        for event in (*events, last):
            now, view = now.after(inside(event, area), view, FACTS, area)
        check_marked(now, view, area)
        check_marked(now, view, later)  # the window has another size
        if cropped:  # by a key that is not the panel's: rows come, or go
            name = now.chosen(view, FACTS).name
            view = view.cropped()
            check_marked(now, view, area)
            boxed = name.startswith("  ")
            assert boxed or now.chosen(view, FACTS).name == name

    check()


def check_marked(panel, view, area):
    """One row is marked: the chosen one."""
    marked = [line for line in panel.lines(view, FACTS, area) if REVERSE in line]
    assert marked
    name = panel.chosen(view, FACTS).name.strip()
    assert plain(marked[0]).strip().startswith(fitted(name, max(0, area.columns - 4)).strip())


def check_keys_reach_all(panel):
    """Down goes through every row that can be set and every figure, Up back again."""
    area = Area(0, 0, 41, 20)
    names = [row.name for title, rows in sections(VIEW, FACTS) for row in rows
             if row.step is not None or title == "Figures"]  # fmt: skip
    now, seen = panel(), []
    for _ in names:
        seen.append(now.chosen(VIEW, FACTS).name)
        now, _ = now.after(Event("key", "down"), VIEW, FACTS, area)
    assert seen == names
    for name in reversed(names):
        assert now.chosen(VIEW, FACTS).name == name
        now, _ = now.after(Event("key", "up"), VIEW, FACTS, area)


def check_steps(panel):
    """Left and right do to the view what the chosen row's step does; Backspace takes it back."""
    area = Area(0, 0, 41, 20)
    now = panel()
    for _ in range(40):
        row = now.chosen(VIEW, FACTS)
        for key, by in (("left", -1), ("right", 1), ("enter", 1)):
            _, after = now.after(Event("key", key), VIEW, FACTS, area)
            assert flat(after) == flat(row.step(VIEW, by, FACTS) if row.step else VIEW)
        moved = now.after(Event("key", "left"), VIEW, FACTS, area)[1]
        _, after = now.after(Event("key", "backspace"), moved, FACTS, area)
        assert flat(after) == flat(row.first(moved) if row.first else moved)
        now, _ = now.after(Event("key", "down"), VIEW, FACTS, area)


def press(x, y, button="left"):
    """A click."""
    return Event("mouse", action="press", button=button, x=x, y=y)


def check_mouse(panel):
    """A click chooses the row under it; on its value it is a step, back on the left half."""
    area = Area(50, 0, 41, 30)
    rows = {row.name: row for _, rows in sections(VIEW, FACTS) for row in rows}
    start, clicked = panel(), 0
    for scroll in range(0, 12, 3):
        now = start
        for _ in range(scroll // 3):
            now, _ = now.after(inside(Event("mouse", action="wheel", button="down"), area), VIEW,
                               FACTS, area)  # fmt: skip
        shown = now.lines(VIEW, FACTS, area)
        for y, line in enumerate(shown):
            row = rows.get(plain(line)[2:NAME].rstrip())
            if row is None or row.step is None:
                continue
            clicked += 1
            there, view = now.after(press(area.left + 1, y), VIEW, FACTS, area)
            assert there.chosen(VIEW, FACTS) is row
            assert view is VIEW
            middle = area.left + (NAME + area.columns) / 2
            for x, button, by in ((middle + 2, "left", 1), (middle - 2, "left", -1),
                                  (middle + 2, "right", -1)):  # fmt: skip
                there, view = now.after(press(x, y, button), VIEW, FACTS, area)
                assert there.chosen(VIEW, FACTS) is row
                assert flat(view) == flat(row.step(VIEW, by, FACTS))
    assert clicked > 60
    assert start.after(press(area.left - 1, 3), VIEW, FACTS, area) is None


def check_wheel(panel):
    """It scrolls to the last line and no farther, to the first and no farther; all is seen."""
    area = Area(3, 2, 41, 11)
    now, seen = panel(), []
    for turn in ("down", "up"):
        for _ in range(40):
            seen += [plain(line).strip() for line in now.lines(VIEW, FACTS, area)]
            event = Event("mouse", action="wheel", button=turn, x=5, y=4)
            now, view = now.after(event, VIEW, FACTS, area)
            assert view is VIEW
        lines = [plain(line) for line in now.lines(VIEW, FACTS, area)]
        if turn == "down":
            assert "more below" not in lines[-1]
            assert lines[-1].strip(), "scrolled past the end"
        else:
            assert lines[0].startswith("Camera")
    for title, rows in sections(VIEW, FACTS):
        assert title in seen
        for row in rows:
            assert any(line.startswith(row.name.strip()) for line in seen), row.name


PANEL_RULES = (check_geometry, check_chosen_shown, check_keys_reach_all, check_steps, check_mouse,
               check_wheel)  # fmt: skip


def check_placed(placed):
    """Only lines that changed are written; then the screen shows what it should."""
    line = st.sampled_from([b"a ", b"b ", b"\x1b[7mc \x1b[m"])

    @given(st.lists(line, max_size=6), st.lists(line, max_size=6), st.integers(0, 9))
    def check(lines, before, top):
        area = Area(7, top, 2, len(lines))
        written = placed(lines, before, area)
        found = re.findall(rb"\x1b\[(\d+);(\d+)H((?:\x1b\[7m)?. (?:\x1b\[m)?)", written)
        screen = dict(enumerate(before))
        for row, column, text in found:
            assert int(column) == area.left + 1
            assert screen.get(int(row) - 1 - top) != text
            screen[int(row) - 1 - top] = text
        assert [screen.get(i) for i in range(len(lines))] == lines
        assert bool(written) == bool(found)

    check()


# --- the layout

screens = st.builds(Terminal, columns=st.integers(1, 500), rows=st.integers(1, 150))


def check_layout(layout):
    """Picture and panel share no cell, are on the screen, and leave the last row alone."""

    @given(screens)
    def check(screen):
        found = layout(screen, True)
        picture, area = found.picture, found.panel
        if area is None:
            assert screen.rows == 1, "no panel"
            assert picture == screen
            return
        assert area.columns > 0
        assert area.rows > 0
        assert area.left + area.columns <= screen.columns
        assert area.top + area.rows <= screen.rows - 1
        if picture is None:
            assert screen.columns < 100 or screen.rows < 20, "there is room for both"
            return
        assert picture.columns >= min(PICTURE, screen.columns)
        assert picture.rows - 1 >= min(PICTURE_ROWS, screen.rows - 1)
        assert picture.columns <= screen.columns
        assert picture.rows <= screen.rows
        assert picture.columns <= area.left or picture.rows - 1 <= area.top, "on each other"
        assert (picture.cell_width, picture.cell_height) == (screen.cell_width, screen.cell_height)

    check()


# --- what is kept


def check_names(free_name):
    """In the folder, new each time, harmless, of a length that file systems take."""

    @given(st.text(max_size=300) | st.sampled_from(["../../x", "..", "/etc/passwd", "a/../../b",
           "\x1b]0;x\x07", "\ud800", "\U00020000" * 90, "con.ply", "-rf", ".hidden"]))  # fmt: skip
    def check(stem):
        with tempfile.TemporaryDirectory() as folder:
            place, again = (free_name(Path(folder), stem, ".png", ".json") for _ in range(2))
            assert place != again
            for path in (place, again):
                assert path.parent == Path(folder)
                assert path.name.startswith("tsplat-")
                assert path.name.endswith(".png")
                assert path.name.isprintable()
                assert not set(path.name) & set("/\\ '\"$`;&|<>*?")
                assert len(path.name.encode()) <= 200

    check()


def check_nothing_is_overwritten(free_name):
    """A file is there already, of either suffix: the next number is taken."""
    with tempfile.TemporaryDirectory() as folder:
        first = free_name(Path(folder), "a", ".png", ".json")
        first.unlink(missing_ok=True)
        first.with_suffix(".json").write_text("mine")
        assert free_name(Path(folder), "a", ".png", ".json").stem != first.stem
        third = free_name(Path(folder), "a", ".png", ".json")
        third.write_text("mine")
        taken = {path.stem for path in Path(folder).iterdir()}
        assert free_name(Path(folder), "a", ".png", ".json").stem not in taken
        assert third.read_text() == "mine"


SIZE = 64, 48
moments = st.lists(
    st.tuples(st.sampled_from([0.0, 1e-5, 0.01, 0.033, 0.1, 0.2, 4.0]), st.booleans()),
    min_size=2, max_size=30,
)  # fmt: skip


def camera_at(place, size=SIZE):
    """A camera that goes along a line, at ``place``."""
    return look_at((place, 0.1, -5), (place, 0, 0), (0, -1, 0), 50, *size)


def check_recording(recording):
    """It plays back: times from 0 that increase, the first place, the last; rests are rests."""

    @given(moments, st.booleans())
    def check(steps, resized):
        made, now, place, times, rests = recording(), 10.0, 0.0, [], []
        for step, (seconds, moves) in enumerate(steps):
            size = (90, 48) if resized and step % 3 == 1 else SIZE
            before, now = now, now + seconds
            if moves:
                place += 0.5
            elif times and seconds >= 0.2:
                rests.append((before, now, place))
            made.add(now, camera_at(place, size))
            times.append((now, place))
        if len(made.poses) < 2:
            return
        gaps = np.diff([time for time, _ in made.poses])
        assert (gaps > 0).all()
        if all(a[1] == b[1] for a, b in pairwise(times)):
            assert len(made.poses) <= 2  # a rest, and no more
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "path.json"
            file.write_text(made.text())
            path = load_path(file)
        begin = times[0][0]
        assert path.times[0] == 0
        assert path.camera(0).same(camera_at(0.5 if steps[0][1] else 0.0))
        assert abs(path.seconds - (now - begin)) < 0.002
        for since, until, where in rests:
            if until - since >= 1.0:  # whose begin is told, if not to the moment
                middle = path.camera(until - begin - 0.05)
                np.testing.assert_allclose(middle.centre, camera_at(where).centre, atol=1e-6)
                assert np.allclose(middle.K, camera_at(where).K)

    check()


def check_moves_are_followed(recording):
    """At every moment of a steady move, played back, it is where it was, to a tenth of a step."""
    made = recording()
    times = np.arange(0, 3, 1 / 30)
    for time in times:
        made.add(float(time), camera_at(float(time)))
    assert 20 <= len(made.poses) <= 32
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "path.json"
        file.write_text(made.text())
        path = load_path(file)
    for time in times:
        assert abs(path.camera(float(time)).centre[0] - time) < 0.003


KEPT_RULES = {
    "names": (check_names, check_nothing_is_overwritten),
    "recording": (check_recording, check_moves_are_followed),
}
