"""What a presenter is, and the facts about a screen that it may use."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING

from tsplat.core.errors import PluginError, printable

BLOCK = 16  # rows compared at once
LIMIT_TOLD = 2000  # px; xterm's own limit is 1000

if TYPE_CHECKING:  # tsplat.terminal needs Terminal, but not NumPy
    from tsplat.core.types import U8, Frame

    Buffer = bytes | memoryview
else:
    Buffer = object


@dataclass(frozen=True)
class Shared:
    """Bytes left where a terminal on the same machine finds them."""

    medium: str  # "s": POSIX shared memory, "t": a temporary file; kitty's letters
    name: bytes  # base64 of its name


@dataclass(frozen=True)
class Terminal:
    """A screen in plain facts. Nothing here touches a tty; ``tsplat.terminal`` finds them out."""

    columns: int = 80
    rows: int = 24
    cell_width: float = 10.0  # px
    cell_height: float = 20.0  # px
    cell_told: bool = True  # False: nobody said how large a cell is, the two above are a guess
    colors: int = 1 << 24  # 1 << 24, 256, 16 or 2 (none, NO_COLOR): what SGR may show
    kitty: bool = False  # answered a kitty graphics query with OK
    iterm2: bool = False  # takes OSC 1337 File=
    sixel: bool = False  # DA1 lists attribute 4
    sixel_registers: int = 256  # colour registers at most
    sixel_max: tuple[int, int] = (0, 0)  # px, largest sixel picture; 0 for unknown
    glyphs: str = "quadrants"  # blocks worth showing: halves, quadrants, sextants or octants
    samples: int = 0  # px rendered for each one shown, each way; 0: as many as the presenter says
    draws_blocks: bool = False  # known to draw those itself, whatever the font has
    synchronized: bool = False  # DEC mode 2026
    name: str = ""  # what it calls itself (XTVERSION), printable
    multiplexer: str = ""  # "tmux" or "screen" when one is in between
    tty: bool = True  # False: output is not a terminal
    remote: bool = False  # a network is in between: bytes are dear
    around: str = ""  # name of the terminal around tmux, if tmux lets a question through to it
    placeholders: bool = False  # knows kitty's cells that stand for parts of a picture
    advice: str = ""  # what the user can do to see better pictures
    media: str = ""  # kitty's letters of what it said it can read: "s", "t"
    keyboard: bool = False  # kitty's keyboard protocol: keys are told when they are let go, too
    in_band_resize: bool = False  # DEC mode 2048: tells its size when that changes
    pixel_mouse: bool = False  # DEC mode 1016: tells where the mouse is in px
    share: Callable[[Buffer], Shared | None] | None = field(default=None, compare=False, repr=False)
    """Leaves bytes where the terminal finds them; None, or returns None, where that is not to be
    had. The one thing here that is no plain fact: presenters without it send all bytes."""

    @property
    def picture_rows(self) -> int:
        """Rows that a picture may have: all but the last."""
        return max(1, self.rows - 1)

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height in px of the area a picture may fill."""
        width, height = self.columns * self.cell_width, self.picture_rows * self.cell_height
        return max(1, int(width)), max(1, int(height))

    @property
    def sixel_cut(self) -> str:
        """That its largest sixel picture is smaller than the area, and what helps; "" if not."""
        most = self.sixel_max
        fits = all(not n or n >= px for n, px in zip(most, self.pixels, strict=True))
        if fits or not self.sixel:
            return ""
        words = f"sixel pictures of at most {most[0]}x{most[1]} px here, the window has more"
        if not self.name.startswith("XTerm"):
            return words
        wanted = max(LIMIT_TOLD, *self.pixels)
        return f"{words}: start xterm -xrm '*maxGraphicSize: {wanted}x{wanted}'"


def _nothing(terminal: Terminal) -> bytes:
    return b""


def _any(terminal: Terminal) -> float:
    return inf


def _square(terminal: Terminal) -> tuple[float, float]:
    return 1.0, 1.0


@dataclass(frozen=True)
class Presenter:
    """A way to show a frame: one row of the table that ``tsplat plugins`` prints.

    ``encode(frame, terminal, previous)`` is pure: the bytes that turn a screen showing
    ``previous`` (``None``: nothing, or unknown) into one that shows ``frame`` from the top left
    cell on, leaving the last row alone. The caller homes the cursor, wraps the bytes into a
    synchronized update and writes them at once. Rounding to 8 bits is ``Frame.to_uint8``'s.

    While the picture moves it may have fewer pixels than ``size``. ``fill(frame, terminal,
    previous)``, where it is offered, is ``encode`` for those: the picture covers what one of
    ``size`` would. Of both the ``previous`` frame may be of either kind. ``rest(frame, terminal)``,
    where it is offered, are the bytes for a picture of ``size`` that stays for a while, whatever
    the screen shows: better than ``encode``'s, which then may be as quick as moving pictures want.
    """

    name: str
    summary: str  # one line
    encode: Callable[[Frame, Terminal, Frame | None], bytes]
    size: Callable[[Terminal], tuple[int, int]]  # px (width, height) worth rendering
    unsupported: Callable[[Terminal], str | None]  # None, or why this terminal cannot show it
    pixel: Callable[[Terminal], tuple[float, float]] = _square  # screen px that one px covers
    # the bytes of a picture that later ones must not replace; None: those of encode
    still: Callable[[Frame, Terminal], bytes] | None = None
    clear: Callable[[Terminal], bytes] = _nothing  # takes the picture away again
    fps: Callable[[Terminal], float] = _any  # pictures a second at most
    # px rendered for each one shown, each way: Gaussians are widened to a pixel, so where pixels
    # are as large as half a cell, the mean of smaller ones is nearer to the scene
    samples: int = 1
    rank: int = -1  # "auto" takes the highest that is supported
    # encode for a frame that stays for a while; None: encode's are as good as can be
    rest: Callable[[Frame, Terminal], bytes] | None = None
    # encode for a frame of fewer px, shown over the same area; None: the viewer repeats pixels
    fill: Callable[[Frame, Terminal, Frame | None], bytes] | None = None


def proportions(size: tuple[int, int], pixel: tuple[float, float]) -> tuple[int, int]:
    """A picture of ``size`` px, each ``pixel`` screen px wide and high, in screen px."""
    width, height = (max(1, round(n * unit)) for n, unit in zip(size, pixel, strict=True))
    return width, height


def sampling(presenter: Presenter, terminal: Terminal) -> int:
    """How many px are rendered for each one shown, each way, at full size."""
    return terminal.samples or presenter.samples


def no_pictures(terminal: Terminal) -> str | None:
    """Why no graphics protocol gets through to ``terminal``; None if one may."""
    if not terminal.tty:
        return "the output is not a terminal"
    if terminal.multiplexer:
        return terminal.advice or f"{terminal.multiplexer} does not let pictures through"
    return None


def pixels(frame: Frame) -> U8:
    """``frame.to_uint8()``, [H, W, 3]; by C where that was built."""
    from tsplat.presenters import native

    if native.lib is None or frame.rgb.dtype.char != "f":
        return frame.to_uint8()
    return native.to_uint8(frame.rgb)


def changed_rows(image: U8, previous: Frame | None) -> range | None:
    """From the first to the last row of ``image`` [H, W, 3], 8 bits, that ``previous`` has not.

    None if there is none; all if nothing is known. ``image`` may be cut off where it does not fit.
    """
    every = range(len(image))
    if previous is None or previous.rgb.shape[:2] != image.shape[:2]:
        return every
    first = _first_change(image, previous, every)
    if first is None:
        return None
    last = _first_change(image, previous, every[::-1])
    return range(first, first + 1 if last is None else last + 1)


def _first_change(image: U8, previous: Frame, rows: range) -> int | None:
    """The first of ``rows`` that differs; looked for in blocks, because most often it is near."""
    for start in range(0, len(rows), BLOCK):
        part = rows[start : start + BLOCK]
        block = slice(min(part), max(part) + 1)
        shown = replace(
            previous, rgb=previous.rgb[block], transmittance=previous.transmittance[block]
        )
        differs = (pixels(shown) != image[block]).any((1, 2))
        if differs.any():
            found = differs.argmax() if part.step > 0 else len(part) - 1 - differs[::-1].argmax()
            return int(block.start + found)
    return None


def changed(image: U8, previous: Frame | None) -> bool:
    """Whether ``image`` [H, W, 3], 8 bits, differs from ``previous`` as shown."""
    if previous is None or previous.rgb.shape != image.shape:
        return True
    return _first_change(image, previous, range(len(image))) is not None


def encoded(
    presenter: Presenter, frame: Frame, terminal: Terminal, previous: Frame | None = None
) -> bytes:
    """``presenter.encode``'s bytes; of one that stays, ``still``'s or ``rest``'s if there are.

    Raises:
        PluginError: the presenter failed.
    """
    with failures_named(presenter):
        for stays in (presenter.still, presenter.rest):
            if previous is None and stays is not None:
                return stays(frame, terminal)
        return presenter.encode(frame, terminal, previous)


@contextmanager
def failures_named(presenter: Presenter) -> Iterator[None]:
    """Whatever ``presenter``, which may be a plugin's, raises meanwhile is a PluginError."""
    try:
        yield
    except Exception as error:
        raise PluginError(
            f"presenter {presenter.name!r} failed: {type(error).__name__}: {printable(error)}; "
            "try another with --presenter"
        ) from error
