"""Rendering and encoding in two threads of their own, while the viewer's writes and listens.

There is room for one thing at each place and no queue anywhere::

    wanted -> [rendering] -> rendered -> [encoding] -> ready -> taken by the viewer
       ^ a newer one replaces it

A stage begins only when the place behind it is free, so a viewer that takes nothing stops both;
only ``wanted`` can be replaced, because work that is done is not thrown away: what is encoded says
what has changed since the frame before it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Generic, Self, TypeVar

JOIN_SECONDS = 1.0  # for a stage that is at it when the end comes; it is left behind then

Wanted = TypeVar("Wanted")
Rendered = TypeVar("Rendered")
Ready = TypeVar("Ready")


class Pipeline(Generic[Wanted, Rendered, Ready]):
    """Two threads, from :meth:`start` to :meth:`close`; a context manager that waits for their end.

    ``render(wanted)``, in one thread, and ``encode(rendered, before)``, in the other; ``before`` is
    the one taken last, None at first and after :meth:`forget`. ``tell()`` is called by a thread
    when there is something to take, or when it has failed. All methods are the viewer's.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._wanted: Wanted | None = None
        self._rendered: Rendered | None = None
        self._ready: tuple[Rendered, Ready] | None = None
        self._shown: Rendered | None = None
        self._working = 0  # stages
        self._round = 0  # what was begun in an earlier one is dropped when it is done
        self._error: BaseException | None = None
        self._closed = False
        self._threads: list[threading.Thread] = []

    def start(
        self,
        render: Callable[[Wanted], Rendered],
        encode: Callable[[Rendered, Rendered | None], Ready],
        tell: Callable[[], None],
    ) -> None:
        """Once."""
        self._render, self._encode, self._tell = render, encode, tell
        for stage in (self._run_render, self._run_encode):
            # daemons, so that a process can end although a frame takes forever
            thread = threading.Thread(target=self._guarded, args=(stage,), daemon=True)
            self._threads.append(thread)
            thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
        for thread in self._threads:
            thread.join(JOIN_SECONDS)

    # --- the viewer's side

    def ask(self, wanted: Wanted) -> None:
        """This next, instead of what has been asked for and not begun."""
        with self._changed:
            self._wanted = wanted
            self._changed.notify_all()

    def take(self) -> tuple[Rendered, Ready] | None:
        """What is ready, with what it was made of; it counts as shown. None if nothing is.

        Raises:
            BaseException: that a stage has raised.
        """
        with self._changed:
            if self._error is not None:
                raise self._error
            ready, self._ready = self._ready, None
            if ready is not None:
                self._shown = ready[0]
                self._changed.notify_all()
            return ready

    @property
    def busy(self) -> bool:
        """Whether anything is wanted, being made, or ready."""
        with self._changed:
            places = self._wanted, self._rendered, self._ready
            return self._working > 0 or any(place is not None for place in places)

    def drop(self) -> None:
        """Whatever is wanted, being made or ready is not any more."""
        with self._changed:
            self._round += 1
            self._wanted = self._rendered = self._ready = None
            self._changed.notify_all()

    def forget(self) -> None:
        """As :meth:`drop`; and nobody knows what the screen shows."""
        with self._changed:
            self.drop()
            self._shown = None

    def close(self) -> None:
        """No more work is begun. Does not wait for what is under way."""
        with self._changed:
            self._closed = True
            self.drop()

    # --- the threads'

    def _guarded(self, stage: Callable[[], None]) -> None:
        try:
            stage()
        except BaseException as error:  # the viewer's to raise, which gives the terminal back
            with self._changed:
                self._error = self._error or error
                self._closed = True
                self._changed.notify_all()
            self._tell()

    def _run_render(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._closed or (self._wanted is not None and self._rendered is None)
                )
                if self._closed or self._wanted is None:
                    return
                wanted, self._wanted = self._wanted, None
                begun, self._working = self._round, self._working + 1
            rendered = self._render(wanted)
            with self._changed:
                self._working -= 1
                if begun == self._round:
                    self._rendered = rendered
                del rendered
                self._changed.notify_all()

    def _run_encode(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._closed or (self._rendered is not None and self._ready is None)
                )
                if self._closed or self._rendered is None:
                    return
                rendered, self._rendered = self._rendered, None
                begun, self._working, before = self._round, self._working + 1, self._shown
                self._changed.notify_all()
            ready = self._encode(rendered, before)
            with self._changed:
                self._working -= 1
                if begun == self._round:
                    self._ready = rendered, ready
            del rendered, ready, before
            self._tell()
