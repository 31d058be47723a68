"""`tsplat view` on a terminal with kitty's keyboard protocol: the keys do what they always do."""

from __future__ import annotations

import select
import signal

import pytest

from tests.modes import TELLS, left_on
from tests.viewer.session import Session, showing


class Telling(Session):
    """It answers that it tells releases."""

    da1 = TELLS + Session.da1


@pytest.fixture
def session():
    """The viewer on the demo scene, its first frame shown."""
    with showing(Telling) as made:
        yield made


def rest(session):
    """Until nothing more is drawn."""
    session.pump(lambda: not select.select([session.master], [], [], 0.5)[0])


def test_a_key_moves_until_it_is_let_go(session):
    """J is pressed once: frames come, with no repeat of it, until its release, and then none.

    Modifiers are no keys.
    """
    rest(session)
    session.press(b"\x1b[13;1:3u\x1b[106;1:1;106u")  # Enter, that started it: releases are told
    frames = session.frames()
    session.pump(lambda: session.frames() >= frames + 4)
    session.press(b"\x1b[106;1:3u")
    rest(session)
    frames = session.frames()
    session.press(b"\x1b[57441;2u\x1b[57441;1:3u\x1b[106;1:3u")
    session.listen(0.3)
    assert session.frames() == frames
    session.press(b"\x1b[113;;113u")
    session.end(0)
    assert left_on(session.output) == set()


@pytest.mark.parametrize("key", [b"\x1b[27u", b"\x1b[99;5u", b"\x1b[81;65;81u"])
def test_keys_that_quit(session, key):
    """Escape, Ctrl+C, and Q with Caps Lock on."""
    session.press(key)
    session.end(0)
    assert left_on(session.output) == set()


def test_a_signal_undoes_the_keyboard(session):
    """The shell gets its own keys again."""
    assert "keys 31 (alternate)" in left_on(session.output)
    session.process.send_signal(signal.SIGTERM)
    session.end(128 + signal.SIGTERM)
    assert left_on(session.output) == set()
