"""The whole plugin surface on one page.

A plugin is a distribution with an entry point in the group ``tsplat`` that names a module:

    [project.entry-points.tsplat]
    bitsort = "tsplat_bitsort"

The module implements any of these hooks; tsplat's own backends, presenters, readers and writers
enter by the same door:

    from tsplat import Backend, Stages, hookimpl

    @hookimpl
    def tsplat_backends():
        return [Backend(name="bitsort", summary="...", stages=("sort",), load=load)]

Importing the module and making the rows must be cheap: both happen whenever plugins are listed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pluggy

if TYPE_CHECKING:
    from tsplat.core.stages import Backend
    from tsplat.io.base import Reader
    from tsplat.io.write.base import Writer
    from tsplat.presenters.base import Presenter

PROJECT = "tsplat"

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def tsplat_backends() -> list[Backend]:  # type: ignore[empty-body]
    """Backends this plugin offers; each may offer some of the four stages or all."""


@hookspec
def tsplat_presenters() -> list[Presenter]:  # type: ignore[empty-body]
    """Presenters this plugin offers: ways to show a frame in a terminal."""


@hookspec
def tsplat_readers() -> list[Reader]:  # type: ignore[empty-body]
    """Scene file formats this plugin reads."""


@hookspec
def tsplat_writers() -> list[Writer]:  # type: ignore[empty-body]
    """Scene file formats this plugin writes."""
