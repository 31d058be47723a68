"""kitty's graphics protocol (https://sw.kovidgoyal.net/kitty/graphics-protocol/).

Every frame goes under the same image and placement id, so that it takes the last one's place;
inside a synchronized update no terminal shows the moment in between. Its bytes are in the escape
sequence itself (t=d), which works over ssh and in every terminal that has the protocol.
"""

from __future__ import annotations

import zlib
from binascii import b2a_base64

from tsplat.core.types import Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters.base import Presenter, Terminal, changed, no_pictures

APC = b"\x1b_G"  # Application Program Command; G for graphics
ST = b"\x1b\\"  # String Terminator
CHUNK = 4096  # bytes of base64 in one sequence, at most
IMAGE_ID = 0x7473706C  # "tspl"; below 2^31, because Konsole reads ids as signed
PLACEMENT_ID = 1
ZLIB_LEVEL = 1  # 640x360: 10 ms; level 6 takes 46 ms for 1 % less


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame pixel by pixel; b"" if it looks like ``previous``."""
    return _encode(frame, previous, b"")


def fill(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame scaled by the terminal to all columns, and all rows but the last."""
    return _encode(frame, previous, b"c=%d,r=%d," % (terminal.columns, max(1, terminal.rows - 1)))


def _encode(frame: Frame, previous: Frame | None, scaled: bytes) -> bytes:
    """Zlib-compressed RGB in chunks; ``scaled`` are more keys.

    The first chunk has all keys and data: xterm.js refuses one without. C=1 leaves the cursor
    where it is, so that nothing scrolls; q=2 asks for no answer.
    """
    image = frame.to_uint8()
    if not changed(image, previous):
        return b""
    data = b2a_base64(zlib.compress(image.data, ZLIB_LEVEL), newline=False)
    keys = b"a=T,f=24,o=z,s=%d,v=%d,i=%d,p=%d,C=1,q=2,%s" % (
        frame.width,
        frame.height,
        IMAGE_ID,
        PLACEMENT_ID,
        scaled,
    )
    parts: list[bytes] = []
    for start in range(0, len(data), CHUNK):
        more = start + CHUNK < len(data)
        parts += APC, keys, b"m=%d;" % more, data[start : start + CHUNK], ST
        keys = b""
    return b"".join(parts)


def still(frame: Frame, terminal: Terminal) -> bytes:
    """The frame without an id: nothing that comes later can replace or delete it."""
    identity = b"i=%d,p=%d," % (IMAGE_ID, PLACEMENT_ID)
    return encode(frame, terminal, None).replace(identity, b"", 1)


def clear(terminal: Terminal) -> bytes:
    """Deletes the image and frees its data (d=I)."""
    return APC + b"a=d,d=I,i=%d,q=2" % IMAGE_ID + ST


def unsupported(terminal: Terminal) -> str | None:
    """None, or why not."""
    if reason := no_pictures(terminal):
        return reason
    return None if terminal.kitty else "the terminal does not answer kitty's graphics query"


KITTY = Presenter(
    name="kitty",
    summary="kitty's graphics protocol, exact colours",
    encode=encode,
    size=lambda terminal: terminal.pixels,
    unsupported=unsupported,
    still=still,
    clear=clear,
    rank=40,
    fill=fill,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The kitty presenter."""
    return [KITTY]
