"""The viewer's pipeline, with stages that wait for the test."""

from __future__ import annotations

import threading

import pytest

from tsplat.viewer.pipeline import Pipeline

SECONDS = 10.0  # until a test gives up; none waits so long when it passes


class Stage:
    """A stage's function that says when it has begun and ends when the test lets it."""

    def __init__(self, name):
        self.name, self.begun, self.calls = name, threading.Semaphore(0), []
        self.go = threading.Semaphore(0)
        self.error = None

    def __call__(self, *given):
        self.calls.append(given)
        self.begun.release()
        assert self.go.acquire(timeout=SECONDS)
        if self.error is not None:
            raise self.error
        return f"{self.name}({given[0]})"

    def wait(self):
        """Until one more call has begun."""
        assert self.begun.acquire(timeout=SECONDS)

    def finish(self):
        """Lets one call end."""
        self.go.release()


class Rig:
    """A pipeline, its stages, and how often the viewer was told."""

    def __init__(self):
        self.pipeline = Pipeline()
        self.render, self.encode = Stage("r"), Stage("e")
        self.told = threading.Semaphore(0)
        self.pipeline.start(self.render, self.encode, self.told.release)

    def heard(self):
        assert self.told.acquire(timeout=SECONDS)

    def through(self, wanted):
        """One picture from the wish to its being taken."""
        self.pipeline.ask(wanted)
        for stage in (self.render, self.encode):
            stage.wait()
            stage.finish()
        self.heard()
        return self.pipeline.take()


@pytest.fixture
def rig():
    made = Rig()
    with made.pipeline:
        yield made
        made.pipeline.close()
        for stage in (made.render, made.encode):  # whoever is at it
            stage.go.release(10)
    assert not any(thread.is_alive() for thread in made.pipeline._threads)


def test_one_picture_goes_through_both_stages(rig):
    """What is taken is what encode made of what render made; then nothing is there any more."""
    assert rig.pipeline.take() is None
    assert not rig.pipeline.busy
    assert rig.through(1) == ("r(1)", "e(r(1))")
    assert rig.pipeline.take() is None
    assert not rig.pipeline.busy


def test_stages_work_at_once(rig):
    """The second picture is rendered while the first is encoded."""
    rig.pipeline.ask(1)
    rig.render.wait()
    rig.render.finish()
    rig.encode.wait()  # at work on 1, and stays so
    rig.pipeline.ask(2)
    rig.render.wait()
    assert rig.render.calls == [(1,), (2,)]
    assert len(rig.encode.calls) == 1


def test_a_newer_wish_replaces_one_that_is_not_begun(rig):
    """Of those asked for while the first is rendered only the newest is made."""
    rig.pipeline.ask(1)
    rig.render.wait()
    for wanted in (2, 3, 4):
        rig.pipeline.ask(wanted)
    rig.render.finish()
    rig.render.wait()
    assert rig.render.calls == [(1,), (4,)]


def test_nothing_piles_up_when_nothing_is_taken(rig):
    """One ready, one rendered, none begun; of what was wanted meanwhile the newest comes next."""
    rig.render.go.release(10)
    rig.encode.go.release(10)
    rig.pipeline.ask(1)
    rig.heard()
    rig.pipeline.ask(2)
    for _ in range(2):
        rig.render.wait()
    for wanted in range(3, 100):
        rig.pipeline.ask(wanted)
    assert not rig.render.begun.acquire(timeout=0.05)
    assert (len(rig.render.calls), len(rig.encode.calls)) == (2, 1)
    assert rig.pipeline.take() == ("r(1)", "e(r(1))")
    rig.heard()
    rig.render.wait()
    assert rig.render.calls[2] == (99,)
    assert rig.pipeline.take() == ("r(2)", "e(r(2))")


def test_encode_is_told_what_was_taken_last(rig):
    """None at first, then the picture before; after forget None again, after drop not."""
    for wanted in (1, 2):
        rig.through(wanted)
    rig.pipeline.drop()
    rig.through(3)
    rig.pipeline.forget()
    rig.through(4)
    befores = [before for _, before in rig.encode.calls]
    assert befores == [None, "r(1)", "r(2)", None]


def test_what_is_dropped_is_never_ready(rig):
    """Wherever it was: wanted, being rendered, being encoded, ready."""
    rig.pipeline.ask(1)
    rig.render.wait()
    rig.pipeline.ask(2)
    rig.pipeline.drop()
    rig.render.finish()  # 1, into nothing
    assert rig.through(3)[0] == "r(3)"
    rig.pipeline.ask(4)
    rig.render.wait()
    rig.render.finish()
    rig.encode.wait()
    rig.pipeline.drop()
    rig.encode.finish()
    rig.heard()
    assert rig.pipeline.take() is None
    rig.pipeline.ask(5)
    for stage in (rig.render, rig.encode):
        stage.wait()
        stage.finish()
    rig.heard()
    rig.pipeline.drop()
    assert rig.pipeline.take() is None
    assert rig.render.calls == [(1,), (3,), (4,), (5,)]


@pytest.mark.parametrize("failing", ["render", "encode"])
def test_an_error_in_a_thread_is_the_viewers(rig, failing):
    """It is told at once, take raises it, and both threads end."""
    getattr(rig, failing).error = ValueError("no picture")
    rig.pipeline.ask(1)
    rig.render.wait()
    rig.render.finish()
    rig.encode.finish()
    rig.heard()
    with pytest.raises(ValueError, match="no picture"):
        rig.pipeline.take()
    for thread in rig.pipeline._threads:
        thread.join(SECONDS)
        assert not thread.is_alive()


def test_close_does_not_wait():
    """A stage that is at it goes on; nothing of it comes out, nothing more is begun."""
    made = Rig()
    made.pipeline.ask(1)
    made.render.wait()
    made.pipeline.close()
    made.pipeline.ask(2)
    made.render.finish()
    for thread in made.pipeline._threads:
        thread.join(SECONDS)
        assert not thread.is_alive()
    assert made.pipeline.take() is None
    assert made.render.calls == [(1,)]
