"""iTerm2's inline images (https://iterm2.com/documentation-images.html).

JPEG as long as the picture moves: a 640x360 frame takes 2 ms to encode and some 50 kB, a PNG 12 ms
and 250 kB, and Konsole shows a JPEG in 4 ms, a PNG in 29. One that stays is a PNG, exact, or over a
network a better JPEG. Both formats are understood everywhere.
"""

from __future__ import annotations

from binascii import b2a_base64
from math import inf

from tsplat.core.types import U8, Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters.base import Presenter, Terminal, changed, no_pictures, pixels
from tsplat.presenters.png import png

OSC = b"\x1b]"  # Operating System Command
BEL = b"\x07"  # ends it; older terminals know no ST here
QUALITY = 85
REMOTE_QUALITY = 75  # over a network: 41 kB a frame for 63, 34.3 dB for 36.4
KEPT_QUALITY = 60  # where every picture is kept
REST_QUALITY = 95  # of one that stays, over a network
FULL_COLOR = 0  # no chroma subsampling: quality 75 without is 1.7 dB better than 85 with, as large
KEPT_FPS = 10.0  # iTerm2 keeps all pictures that it was sent: half a megabyte a second is enough


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame as a JPEG file; b"" if it looks like ``previous``."""
    image = pixels(frame)
    if not changed(image, previous):
        return b""
    return _exactly(_jpeg(image, _quality(terminal)), frame, terminal)


def fill(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame scaled by the terminal."""
    image = pixels(frame)
    if not changed(image, previous):
        return b""
    return _scaled(_jpeg(image, _quality(terminal)), terminal)


def rest(frame: Frame, terminal: Terminal) -> bytes:
    """The frame as a PNG file, exactly; over a network as a JPEG file of a third of that."""
    image = pixels(frame)
    file = _jpeg(image, REST_QUALITY) if terminal.remote else png(image)
    return _exactly(file, frame, terminal)


def fps(terminal: Terminal) -> float:
    """Pictures a second at most: in iTerm2, which keeps them all, few."""
    return KEPT_FPS if _keeps(terminal) else inf


def _keeps(terminal: Terminal) -> bool:
    return terminal.name.startswith("iTerm2")


def _quality(terminal: Terminal) -> int:
    if _keeps(terminal):
        return KEPT_QUALITY
    return REMOTE_QUALITY if terminal.remote else QUALITY


def _jpeg(image: U8, quality: int) -> bytes:
    from io import BytesIO

    from PIL import Image

    file = BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=quality, subsampling=FULL_COLOR)
    return file.getvalue()


def _exactly(file: bytes, frame: Frame, terminal: Terminal) -> bytes:
    """``file`` pixel by pixel: what is as large as it is needs no preserveAspectRatio.

    Where nobody said how large a cell is, over the cells that it was made for.
    """
    if not terminal.cell_told:
        return _scaled(file, terminal)
    return _sequence(file, b"%dpx" % frame.width, b"%dpx" % frame.height, b"")


def _scaled(file: bytes, terminal: Terminal) -> bytes:
    """``file`` over all rows but the last.

    The aspect may be off by a rounded px, which is not to leave a gap: preserveAspectRatio=0.
    Konsole has that the other way round.
    """
    keep = b"1" if terminal.name.startswith("Konsole") else b"0"
    if terminal.cell_told:
        width, height = (b"%dpx" % n for n in terminal.pixels)
    else:
        width, height = b"%d" % terminal.columns, b"%d" % max(1, terminal.rows - 1)
    return _sequence(file, width, height, b";preserveAspectRatio=" + keep)


def _sequence(file: bytes, width: bytes, height: bytes, more: bytes) -> bytes:
    """``file`` shown at ``width`` x ``height``.

    ``size`` is there because VS Code shows no picture without it. doNotMoveCursor keeps Konsole
    from scrolling; who does not know it ignores it.
    """
    keys = b"inline=1;size=%d;width=%s;height=%s;doNotMoveCursor=1" % (len(file), width, height)
    return OSC + b"1337;File=" + keys + more + b":" + b2a_base64(file, newline=False) + BEL


def unsupported(terminal: Terminal) -> str | None:
    """None, or why not."""
    if reason := no_pictures(terminal):
        return reason
    return None if terminal.iterm2 else "the terminal is not known to take OSC 1337 pictures"


ITERM2 = Presenter(
    name="iterm2",
    summary="iTerm2's inline images: JPEG, and PNG at rest",
    encode=encode,
    size=lambda terminal: terminal.pixels,
    unsupported=unsupported,
    fps=fps,
    rank=30,
    fill=fill,
    rest=rest,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The iterm2 presenter."""
    return [ITERM2]
