"""kitty's graphics protocol (https://sw.kovidgoyal.net/kitty/graphics-protocol/).

Every frame goes under the same image and placement id, so that it takes the last one's place;
inside a synchronized update no terminal shows the moment in between.

Where the terminal reads our memory the frame goes there, untouched. Else its bytes are in the
escape sequence itself (t=d), as a PNG: that costs us more than bare pixels, but the terminal less,
even without a network in between (Konsole takes a 640x360 PNG in a third of the time).
"""

from __future__ import annotations

from binascii import b2a_base64

from tsplat.core.types import U8, Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters.base import Presenter, Terminal, changed, no_pictures
from tsplat.presenters.png import png

APC = b"\x1b_G"  # Application Program Command; G for graphics
ST = b"\x1b\\"  # String Terminator
CHUNK = 4096  # bytes of base64 in one sequence, at most
IMAGE_ID = 0x7473706C  # "tspl"; below 2^31, because Konsole reads ids as signed
PLACEMENT_ID = 1


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame, exactly; b"" if it looks like ``previous``.

    C=1 leaves the cursor where it is, so that nothing scrolls; q=2 asks for no answer.
    """
    image = frame.to_uint8()
    if not changed(image, previous):
        return b""
    keys, data = transmission(image, terminal)
    return in_chunks(b"a=T,i=%d,p=%d,C=1,q=2,%s" % (IMAGE_ID, PLACEMENT_ID, keys), data)


def transmission(image: U8, terminal: Terminal) -> tuple[bytes, bytes]:
    """How ``image`` [H, W, 3] gets to the terminal: keys, and the base64 payload."""
    if terminal.share and (shared := terminal.share(image.data)):
        height, width = image.shape[:2]
        keys = b"f=24,s=%d,v=%d,t=%s,S=%d" % (
            width, height, shared.medium.encode(), image.nbytes,
        )  # fmt: skip
        return keys, shared.name
    return b"f=100", b2a_base64(png(image), newline=False)


def in_chunks(keys: bytes, data: bytes) -> bytes:
    """A command whose base64 payload may be long. The first chunk has all keys and data.

    xterm.js refuses a first chunk without data.
    """
    keys += b","
    parts: list[bytes] = []
    for start in range(0, len(data), CHUNK):
        more = start + CHUNK < len(data)
        parts += APC, keys, b"m=%d;" % more, data[start : start + CHUNK], ST
        keys = b""
    return b"".join(parts)


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
    clear=clear,
    rank=40,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    """The kitty presenter."""
    return [KITTY]
