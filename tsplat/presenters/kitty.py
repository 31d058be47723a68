"""kitty's graphics protocol (https://sw.kovidgoyal.net/kitty/graphics-protocol/).

Every frame goes under the same image and placement id, so that it takes the last one's place;
inside a synchronized update no terminal shows the moment in between.

Where the terminal reads our memory the frame goes there, untouched. Else its bytes are in the
escape sequence itself (t=d), as a PNG: that costs us more than bare pixels, but the terminal less,
even without a network in between (Konsole takes a 640x360 PNG in a third of the time).

Inside tmux the frame goes past it, under an id of its own, and cells of text stand for its parts;
they are written once, and show whatever the id stands for by then.
"""

from __future__ import annotations

import re
from binascii import b2a_base64
from collections.abc import Iterator
from dataclasses import replace
from math import ceil
from zlib import crc32

from tsplat.core.types import U8, Frame
from tsplat.hookspecs import hookimpl
from tsplat.presenters.base import Presenter, Terminal, changed, no_pictures, pixels
from tsplat.presenters.placeholders import IDS, MARKS, cells, image_id, through_tmux
from tsplat.presenters.png import png

APC = b"\x1b_G"  # Application Program Command; G for graphics
ST = b"\x1b\\"  # String Terminator
CHUNK = 4096  # bytes of base64 in one sequence, at most
IMAGE_ID = 0x7473706C  # "tspl"; below 2^31, because Konsole reads ids as signed
PLACEMENT_ID = 1
TMUX_ID = image_id(0)  # that of moving pictures; the others are for those that stay
VERSION = re.compile(r"kitty\((\d+)\.(\d+)")
TRANSIENT = 0, 48  # kitty's first version that has usage hints


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame pixel by pixel, exactly; b"" if it looks like ``previous``."""
    return _encode(frame, terminal, previous, None, TMUX_ID, _hint(terminal))


def fill(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """The frame scaled by the terminal to all columns, and all rows but the last."""
    return _encode(frame, terminal, previous, _area(terminal), TMUX_ID, _hint(terminal))


def _area(terminal: Terminal) -> tuple[int, int]:
    """All columns, and all rows but the last."""
    return terminal.columns, max(1, terminal.rows - 1)


def _hint(terminal: Terminal) -> bytes:
    """N=1 where it is known: that the picture is soon replaced, so that no disk need keep it."""
    version = VERSION.match(terminal.around if terminal.multiplexer else terminal.name)
    known = version is not None and (int(version[1]), int(version[2])) >= TRANSIENT
    return b"N=1," if known else b""


def _encode(
    frame: Frame,
    terminal: Terminal,
    previous: Frame | None,
    area: tuple[int, int] | None,
    tmux_id: int,
    hint: bytes,
) -> bytes:
    """The frame at its size, or over ``area``: columns and rows.

    C=1 leaves the cursor where it is, so that nothing scrolls; q=2 asks for no answer.
    """
    image = pixels(frame)
    if not changed(image, previous):
        return b""
    keys, data = transmission(image, terminal)
    if terminal.multiplexer:
        columns, rows = _marked(*area) if area else _cells(frame, terminal)
        keys = b"a=T,U=1,i=%d,c=%d,r=%d,q=2,%s%s" % (tmux_id, columns, rows, hint, keys)
        there = previous is not None and _shown(previous, terminal) == (columns, rows)
        text = b"" if there else cells(columns, rows, tmux_id)
        return b"".join(map(through_tmux, in_chunks(keys, data))) + text
    scaled = b"" if area is None else b"c=%d,r=%d," % area
    keys = b"a=T,i=%d,p=%d,C=1,q=2,%s%s%s" % (IMAGE_ID, PLACEMENT_ID, scaled, hint, keys)
    return b"".join(in_chunks(keys, data))


def _cells(frame: Frame, terminal: Terminal) -> tuple[int, int]:
    """Columns and rows that hold ``frame``. The terminal fits it in, its shape kept."""
    return (
        min(ceil(frame.width / terminal.cell_width), terminal.columns, len(MARKS)),
        min(ceil(frame.height / terminal.cell_height), max(1, terminal.rows - 1), len(MARKS)),
    )


def _shown(frame: Frame, terminal: Terminal) -> tuple[int, int]:
    """Columns and rows where ``frame`` is shown: all of them if it has fewer px than those."""
    if (frame.width, frame.height) == size(terminal):
        return _cells(frame, terminal)
    return _marked(*_area(terminal))


def _marked(columns: int, rows: int) -> tuple[int, int]:
    """So many that there are marks for them."""
    return min(columns, len(MARKS)), min(rows, len(MARKS))


def size(terminal: Terminal) -> tuple[int, int]:
    """All rows but the last, in px; inside tmux no more cells than there are marks for."""
    if not terminal.multiplexer:
        return terminal.pixels
    most = replace(
        terminal,
        columns=min(terminal.columns, len(MARKS)),
        rows=min(terminal.rows, len(MARKS) + 1),
    )
    return most.pixels


def transmission(image: U8, terminal: Terminal) -> tuple[bytes, bytes]:
    """How ``image`` [H, W, 3] gets to the terminal: keys, and the base64 payload."""
    if terminal.share and (shared := terminal.share(image.data)):
        height, width = image.shape[:2]
        keys = b"f=24,s=%d,v=%d,t=%s,S=%d" % (
            width, height, shared.medium.encode(), image.nbytes,
        )  # fmt: skip
        return keys, shared.name
    return b"f=100", b2a_base64(png(image), newline=False)


def in_chunks(keys: bytes, data: bytes) -> Iterator[bytes]:
    """A command whose base64 payload may be long, in sequences.

    The first has all keys, and data: xterm.js refuses one without.
    """
    keys += b","
    for start in range(0, len(data), CHUNK):
        more = start + CHUNK < len(data)
        yield b"".join((APC, keys, b"m=%d;" % more, data[start : start + CHUNK], ST))
        keys = b""


def still(frame: Frame, terminal: Terminal) -> bytes:
    """The frame without an id: nothing that comes later can replace or delete it.

    Inside tmux its cells have to name one: one of :data:`IDS`, by what it shows, so that another
    picture hardly ever takes its place.
    """
    number = 1 + crc32(pixels(frame).data, frame.width) % (IDS - 1)
    identity = b"i=%d,p=%d," % (IMAGE_ID, PLACEMENT_ID)
    return _encode(frame, terminal, None, None, image_id(number), b"").replace(identity, b"", 1)


def clear(terminal: Terminal) -> bytes:
    """Deletes the image and frees its data (d=I)."""
    if terminal.multiplexer:
        return through_tmux(APC + b"a=d,d=I,i=%d,q=2" % TMUX_ID + ST)
    return APC + b"a=d,d=I,i=%d,q=2" % IMAGE_ID + ST


def unsupported(terminal: Terminal) -> str | None:
    """None, or why not."""
    if not terminal.multiplexer or not terminal.tty:
        if reason := no_pictures(terminal):
            return reason
        return None if terminal.kitty else "the terminal does not answer kitty's graphics query"
    if not terminal.kitty:
        return no_pictures(terminal)
    if not terminal.placeholders:
        name = terminal.around or "the terminal"
        return f"{name}, around {terminal.multiplexer}, is not known to have kitty's placeholders"
    return None


KITTY = Presenter(
    name="kitty",
    summary="kitty's graphics protocol, exact colours",
    encode=encode,
    size=size,
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
