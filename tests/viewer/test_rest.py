"""A picture that stays is sent again as good as can be, and one that moves as quickly as can be."""

import re

import numpy as np
import pytest

from tests.viewer.session import COLUMNS, ROWS, Session
from tsplat.demo import demo_scene
from tsplat.plan import make_plan
from tsplat.presenters.base import Terminal
from tsplat.presenters.enlarge import averaged
from tsplat.presenters.halfblock import HALFBLOCK
from tsplat.presenters.sixel import SIXEL
from tsplat.testing import decoders
from tsplat.views import FOV, frame_orbit

PICTURE = re.compile(rb"\x1bP[^\x1b]*\x1b\\")
UPDATE = re.compile(rb"\x1b\[\?2026h\x1b\[H(.*?)\x1b\[%d;1H" % ROWS, re.DOTALL)
TEXT = Terminal(COLUMNS, ROWS)
SCREEN = Terminal(30, 12, 10.0, 20.0, sixel=True)


class SixelSession(Session):
    """A terminal with sixel graphics."""

    da1 = b"\x1b[?62;4;22c"
    size = SCREEN.rows, SCREEN.columns, 300, 240

    @property
    def pictures(self):
        return PICTURE.findall(self.output)


def first_frame(presenter, terminal, samples):
    """The demo scene as it is seen first, each px of the screen the mean of some."""
    scene = demo_scene()
    size = presenter.size(terminal)
    wide, high = (round(n * unit) for n, unit in zip(size, presenter.pixel(terminal), strict=True))
    orbit = frame_orbit(scene, *terminal.pixels)
    camera = orbit.camera(FOV, wide, high).resized(*(n * samples for n in size))
    return averaged(make_plan(scene).run(scene, camera).frame.over((0.0, 0.0, 0.0)), samples)


def rests(pictures, expected):
    return bool(pictures) and pictures[-1] == expected


def test_what_stays_is_dithered_and_what_moves_is_not():
    """Once it rests the picture is sent as ``rest`` makes it, once; a key, and it moves again."""
    session = SixelSession()
    try:
        expected = SIXEL.rest(first_frame(SIXEL, SCREEN, 1), SCREEN)
        session.pump(lambda: rests(session.pictures, expected))
        count = len(session.pictures)
        session.listen(0.5)
        assert len(session.pictures) == count
        session.press(b"\x1b[D")
        session.pump(lambda: len(session.pictures) > count + 1)
        session.listen(0.8)
        moving, last = session.pictures[count], session.pictures[-1]
        assert moving != last
        assert last != expected
        assert last.count(b"#") > moving.count(b"#")
        session.press(b"q")
        session.end(0)
    finally:
        session.close()


@pytest.mark.parametrize("samples", [0, 1])
def test_half_blocks_are_the_mean_of_smaller_pixels(samples, monkeypatch):
    """Of 4x4 in the end, unless TSPLAT_SAMPLES says otherwise."""
    if samples:
        monkeypatch.setenv("TSPLAT_SAMPLES", str(samples))
    frame = first_frame(HALFBLOCK, TEXT, samples or 4)
    expected = HALFBLOCK.encode(frame, TEXT, None)
    session = Session("--presenter", "halfblock")
    try:
        session.pump(lambda: session.frames() > 0)
        session.listen(1.5)
        assert frame.width == COLUMNS
        shown = decoders.halfblock(expected, TEXT)
        updates = UPDATE.findall(session.output)
        seen = decoders.halfblock(b"".join(b"\x1b[H" + update for update in updates), TEXT)
        np.testing.assert_array_equal(seen, shown)
        session.press(b"q")
        session.end(0)
    finally:
        session.close()
