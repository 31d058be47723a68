"""A picture from the wish for it to the bytes that show it: what the pipeline's threads do."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

from tsplat.core.camera import Camera
from tsplat.core.types import Frame
from tsplat.plan import Rendered
from tsplat.presenters.base import (
    Presenter,
    Terminal,
    changed,
    failures_named,
    pixels,
    sampling,
)
from tsplat.presenters.enlarge import averaged, cropped, enlarged
from tsplat.viewer.controls import View
from tsplat.viewer.engine import Engine, Prepared
from tsplat.viewer.shades import shaded


@dataclass(frozen=True, eq=False)
class Picture:
    """One that is wanted."""

    view: View
    level: int  # of Pace; 0 has all pixels
    size: tuple[int, int]  # px
    covered: tuple[int, int]  # px of the full size that they are repeated to, the least beyond it
    shades: int | None  # of each channel; None: all
    terminal: Terminal
    presenter: Presenter
    begun: float  # s, monotonic
    heard: float | None = None  # s, when the input came that this is the first picture of
    rests: bool = False  # nothing moves: as good as the presenter can


@dataclass(eq=False)
class Drawn:
    """One that was rendered. Its frames are its own: the workspace goes on to the next."""

    picture: Picture
    camera: Camera
    frame: Frame  # as it is encoded: on its background, as large as encode wants it, in its shades
    rendered: Rendered  # its frame only where it is verified
    prepared: Prepared
    seconds: float


@dataclass(frozen=True)
class Encoded:
    """What is written for one."""

    payload: bytes
    seconds: float
    begins: bool = False  # in a raster of its own: the next ones say only what changes in it


def draw(picture: Picture, engine: Engine, keep: bool) -> Drawn:
    """Renders, in the pixels that encoding wants; ``keep`` the frame that came of it, too."""
    begin = time.perf_counter()
    look = picture.view.look
    full = picture.presenter.size(picture.terminal)
    pixel = picture.presenter.pixel(picture.terminal)
    samples = 1 if picture.level else sampling(picture.presenter, picture.terminal)
    repeated = picture.presenter.fill is None and picture.size != full
    camera = picture.view.camera(full, pixel)
    if repeated:
        camera = replace(camera, width=picture.covered[0], height=picture.covered[1])
    camera = camera.resized(*(n * samples for n in picture.size))
    prepared, rendered = engine.run(look, camera)
    frame = averaged(rendered.frame.over(look.background), samples)
    if repeated:
        frame = cropped(enlarged(frame, *picture.covered), *full)
    elif frame.rgb is rendered.frame.rgb:
        frame = Frame(frame.rgb.copy(), frame.transmittance)
    kept = rendered.frame
    if keep:
        kept = Frame(kept.rgb.copy(), kept.transmittance.copy())
    return Drawn(
        picture, camera, frame, replace(rendered, frame=kept), prepared,
        time.perf_counter() - begin,
    )  # fmt: skip


def _cell(presenter: Presenter, terminal: Terminal) -> tuple[int, int]:
    """Px of a picture that a cell shows, each way; 1 if they are not in whole cells."""
    pixel, (width, height) = presenter.pixel(terminal), presenter.size(terminal)
    wide = max(1, round(terminal.cell_width / pixel[0]))
    high = max(1, round(terminal.cell_height / pixel[1]))
    return (1, 1) if width % wide or height % high else (wide, high)


def encode(drawn: Drawn, before: Drawn | None) -> Encoded:
    """The bytes for a screen that shows ``before``; None: nothing, or who knows what.

    Raises:
        PluginError: the presenter failed.
    """
    begin = time.perf_counter()
    picture = drawn.picture
    presenter, terminal = picture.presenter, picture.terminal
    few = presenter.fill is not None and picture.size != presenter.size(terminal)
    write = presenter.fill if few and presenter.fill is not None else presenter.encode
    begins = False
    if picture.shades is not None:
        kept = before.frame if before and presenter.fill is None else None
        drawn.frame = shaded(drawn.frame, picture.shades, kept, _cell(presenter, terminal))
        fresh = before is None or before.picture.size != picture.size
        begins = presenter.fill is None and fresh
        registers = min(terminal.sixel_registers, picture.shades)
        terminal = replace(terminal, sixel_registers=registers)
    with failures_named(presenter):
        if picture.rests and presenter.rest is not None:
            same = (
                before is not None
                and before.picture.rests
                and not changed(pixels(drawn.frame), before.frame)
            )
            payload = b"" if same else presenter.rest(drawn.frame, terminal)
        else:
            payload = write(drawn.frame, terminal, before.frame if before else None)
    return Encoded(payload, time.perf_counter() - begin, begins)
