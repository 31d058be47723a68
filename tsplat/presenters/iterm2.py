"""iTerm2's inline images (https://iterm2.com/documentation-images.html).

JPEG, because these are moving pictures: a 640x360 frame takes 2 ms to encode and some 65 kB, a
PNG 12 ms and 370 kB, and Konsole shows a JPEG in 4 ms, a PNG in 29. Both formats are understood
everywhere; nothing is gained from PNG but exactness, for which there is kitty's protocol.
"""

from __future__ import annotations

from binascii import b2a_base64

from tsplat.core.types import Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters.base import Presenter, Terminal, changed, no_pictures, pixels

OSC = b"\x1b]"  # Operating System Command
BEL = b"\x07"  # ends it; older terminals know no ST here
QUALITY = 85
REMOTE_QUALITY = 75  # over a network: 41 kB a frame for 63, 34.3 dB for 36.4
FULL_COLOR = 0  # no chroma subsampling: quality 75 without is 1.7 dB better than 85 with, as large


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame as a JPEG file; b"" if it looks like ``previous``.

    Width and height are the picture's own in px, so that preserveAspectRatio makes no difference
    and is left out.
    """
    return _encode(frame, terminal, previous, frame.width, frame.height, b"")


def fill(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame scaled by the terminal.

    The aspect may be off by a rounded px, which is not to leave a gap: preserveAspectRatio=0.
    Konsole has that the other way round.
    """
    keep = b"1" if terminal.name.startswith("Konsole") else b"0"
    return _encode(frame, terminal, previous, *terminal.pixels, b";preserveAspectRatio=" + keep)


def _encode(
    frame: Frame, terminal: Terminal, previous: Frame | None, width: int, height: int, more: bytes
) -> bytes:
    """``frame`` shown at ``width`` x ``height`` px.

    ``size`` is there because VS Code shows no picture without it. doNotMoveCursor keeps Konsole
    from scrolling; who does not know it ignores it.
    """
    from io import BytesIO

    from PIL import Image

    image = pixels(frame)
    if not changed(image, previous):
        return b""
    file = BytesIO()
    quality = REMOTE_QUALITY if terminal.remote else QUALITY
    Image.fromarray(image).save(file, "JPEG", quality=quality, subsampling=FULL_COLOR)
    data = file.getvalue()
    keys = b"inline=1;size=%d;width=%dpx;height=%dpx;doNotMoveCursor=1" % (
        len(data),
        width,
        height,
    )
    return OSC + b"1337;File=" + keys + more + b":" + b2a_base64(data, newline=False) + BEL


def unsupported(terminal: Terminal) -> str | None:
    """None, or why not."""
    if reason := no_pictures(terminal):
        return reason
    return None if terminal.iterm2 else "the terminal is not known to take OSC 1337 pictures"


ITERM2 = Presenter(
    name="iterm2",
    summary="iTerm2's inline images, JPEG",
    encode=encode,
    size=lambda terminal: terminal.pixels,
    unsupported=unsupported,
    rank=30,
    fill=fill,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The iterm2 presenter."""
    return [ITERM2]
