"""Presenters that are wrong on purpose, each in one way, each with the checks that must catch it.

Each is a built-in presenter with its bytes, frames or sizes bent.
"""

from __future__ import annotations

import re
import weakref
from dataclasses import replace

import numpy as np

from tsplat.core.types import Frame
from tsplat.presenters import blocks, iterm2, kitty, sixel
from tsplat.presenters.base import Terminal
from tsplat.presenters.blocks import BLOCKS
from tsplat.presenters.braille import BRAILLE
from tsplat.presenters.cells import RESET
from tsplat.presenters.halfblock import HALFBLOCK

ITERM2, KITTY, SIXEL = (  # of what is wrong with encode, fill would tell as well
    replace(row, fill=None, rest=None) for row in (iterm2.ITERM2, kitty.KITTY, sixel.SIXEL)
)


# Never a strip of a picture: beside one the last frame's colours stay, which nobody judges
WHOLE_SIXEL = replace(SIXEL, encode=lambda f, t, p: sixel.encode(f, t, None))


def framed(row, change):
    """``row`` shown other frames than those given."""

    def encode(frame, terminal, previous):
        before = None if previous is None else change(previous)
        return row.encode(change(frame), terminal, before)

    return replace(row, encode=encode)


def rgb(row, change):
    """``row`` with ``change`` of the frames' [H, W, 3] values."""
    return framed(row, lambda frame: replace(frame, rgb=np.ascontiguousarray(change(frame.rgb))))


def bytewise(row, change):
    """``row`` with ``change`` of its bytes, where there are any."""

    def encode(frame, terminal, previous):
        data = row.encode(frame, terminal, previous)
        return change(data) if data else data

    return replace(row, encode=encode)


def sized(row, change):
    """``row`` that wants frames of another size."""
    return replace(row, size=lambda terminal: change(terminal, *row.size(terminal)))


def truncated(values):
    """8 bits by cutting off, as whole levels, which any rounding keeps."""
    return np.floor(np.clip(values, 0, 1) * 255) / 255


def one_row_less(frame):
    return replace(
        frame, rgb=frame.rgb[: max(1, frame.height - 1)],
        transmittance=frame.transmittance[: max(1, frame.height - 1)],
    )  # fmt: skip


def long_chunks(data):
    """Twice as long as allowed."""
    return re.sub(rb"m=1;([^\x1b]*)\x1b\\\x1b_Gm=([01]);", rb"m=\2;\1", data)


def all_keys_again(data):
    """Every chunk with the keys of the first; two of them at least."""
    if not data:
        return data
    keys = re.match(rb"\x1b_G(.*?),m=", data)[1]
    first = re.search(rb"m=([01]);([^\x1b]{4})", data)
    split = b"m=1;" + first[2] + b"\x1b\\\x1b_Gm=" + first[1] + b";"
    data = data[: first.start()] + split + data[first.end() :]
    return data.replace(b"\x1b_Gm=", b"\x1b_G" + keys + b",m=")


def registers_turned(data):
    """Each register defined with its neighbour's colour."""
    colors = re.findall(rb"#\d+;2;(\d+;\d+;\d+)", data)
    following = iter(colors[1:] + colors[:1])
    return re.sub(rb"(#\d+;2;)\d+;\d+;\d+", lambda m: m[1] + next(following), data)


def levels_for_percent(data):
    return re.sub(
        rb"(#\d+;2;)(\d+);(\d+);(\d+)",
        lambda m: m[1] + b";".join(b"%d" % round(int(c) * 2.55) for c in m.groups()[1:]),
        data,
    )


class Remembering:
    """Compares with what it sent last, whatever the screen shows now."""

    def __init__(self):
        self.last = None

    def __call__(self, frame, terminal, previous):
        image = frame.to_uint8().tobytes()
        if previous is not None and image == self.last:
            return b""
        self.last = image
        return KITTY.encode(frame, terminal, previous)


class Keeping:
    """Keeps the last frame, to compare with the next."""

    def __init__(self):
        self.frame = None

    def __call__(self, frame, terminal, previous):
        self.frame = frame
        return KITTY.encode(frame, terminal, previous)


class Caching:
    """Encodes each array once, whatever is written into it later."""

    def __init__(self):
        self.array, self.data = (lambda: None), b""

    def __call__(self, frame, terminal, previous):
        if previous is not None:
            return KITTY.encode(frame, terminal, previous)
        if self.array() is not frame.rgb:
            self.array, self.data = weakref.ref(frame.rgb), KITTY.encode(frame, terminal, None)
        return self.data


def clips_in_place(frame, terminal, previous):
    np.clip(frame.rgb, 0, 1, out=frame.rgb)
    return KITTY.encode(frame, terminal, previous)


def upper_halves_only(frame, terminal, previous):
    """A cell counts as changed only if its upper half did."""
    if previous is None:
        return HALFBLOCK.encode(frame, terminal, None)
    seen = previous.rgb.copy()
    seen[1::2] = frame.rgb[1::2]
    return HALFBLOCK.encode(frame, terminal, replace(previous, rgb=seen))


def nothing_after_the_first(frame, terminal, previous):
    return b"" if previous is not None else KITTY.encode(frame, terminal, None)


def poor_jpeg(frame, terminal, previous):
    """JPEG's own file, made worse: colours in 3 bits."""
    coarse = np.floor(np.clip(frame.to_uint8() / 255, 0, 1) * 7.999) / 7
    return ITERM2.encode(Frame(coarse, frame.transmittance), terminal, None)


def keeps_what_it_filled(frame, terminal, previous):
    """As if a picture of fewer pixels could not replace one of full size."""
    large = previous is not None and previous.rgb.size > frame.rgb.size
    return b"" if large else kitty.fill(frame, terminal, previous)


def strips_too_high(frame, terminal, previous):
    """The first picture whole; of the others the rows are sent a cell further up."""
    data = sixel.encode(frame, terminal, previous)

    def moved(match):
        return b"\x1b[%dH" % max(1, int(match[1]) - 1)

    return re.sub(rb"^\x1b\[(\d+)H", moved, data)


def strips_of_bands(frame, terminal, previous):
    """Whole bands from the first row that changed to the last, whatever the cells are."""
    one = replace(terminal, cell_height=1.0, rows=int(terminal.pixels[1]) + 1)
    data = sixel.encode(frame, one, previous)

    def moved(match):
        return b"\x1b[%dH" % (1 + (int(match[1]) - 1) // int(terminal.cell_height))

    return re.sub(rb"^\x1b\[(\d+)H", moved, data)


def few_levels_at_rest(frame, terminal):
    """A picture that stays is one that moves, in colours of 3 bits."""
    coarse = np.floor(np.clip(frame.to_uint8() / 255, 0, 1) * 7.999) / 7
    return iterm2.rest(Frame(coarse, frame.transmittance), terminal)


def all_rows(terminal: Terminal, width: int, height: int):
    return width, 2 * terminal.rows


def whole_screen(frame, terminal, previous):
    return HALFBLOCK.encode(frame, replace(terminal, rows=terminal.rows + 1), previous)


def other_glyphs(frame, terminal, previous):
    """Quadrants where the terminal draws octants."""
    other = {"octants": "quadrants"}.get(terminal.glyphs, terminal.glyphs)
    return blocks.encode(frame, replace(terminal, glyphs=other), previous)


def octants_in_order(data):
    """As if all 256 octants were in one row of code points."""

    def moved(match):
        return chr(ord(match[0]) + 1)

    return re.sub("[\U0001cd00-\U0001cde4]", moved, data.decode()).encode()


SHOWN = {"picture", "changes"}
UNREADABLE = {"stream", "shape", "picture", "changes"}
WRONG = {
    "kitty mirrored": (rgb(KITTY, lambda v: v[:, ::-1]), {"picture"}),
    "half blocks upside down": (rgb(HALFBLOCK, lambda v: v[::-1]), {"picture"}),
    "kitty, red and blue swapped": (rgb(KITTY, lambda v: v[..., ::-1]), {"picture"}),
    "half blocks, red and blue swapped": (rgb(HALFBLOCK, lambda v: v[..., ::-1]), {"picture"}),
    "iterm2 mirrored": (rgb(ITERM2, lambda v: v[:, ::-1]), {"picture"}),
    "sixel inverted": (rgb(SIXEL, lambda v: 1 - v), {"picture"}),
    "kitty shifted by a pixel": (rgb(KITTY, lambda v: np.roll(v, 1, axis=1)), {"picture"}),
    "kitty truncates": (rgb(KITTY, truncated), {"rounding", "picture"}),
    "half blocks truncate": (rgb(HALFBLOCK, truncated), {"rounding", "picture"}),
    "sixel truncates": (rgb(SIXEL, truncated), {"rounding"}),  # a level is within its bound
    "values beyond 1 wrap": (
        rgb(KITTY, lambda v: np.asarray(v * 255 + 0.5).astype(np.int64) % 256 / 255),
        {"rounding", "picture"},
    ),
    "sixel, palette turned": (bytewise(WHOLE_SIXEL, registers_turned), {"picture"}),
    "sixel, levels for percent": (bytewise(SIXEL, levels_for_percent), UNREADABLE - {"changes"}),
    "sixel, as many registers as it likes": (
        replace(
            SIXEL, encode=lambda f, t, p: SIXEL.encode(f, replace(t, sixel_registers=1024), p)
        ),
        {"stream"},
    ),
    "JPEG too poor": (replace(ITERM2, encode=poor_jpeg), {"picture"}),
    "iterm2 without its size": (
        bytewise(ITERM2, lambda d: re.sub(rb";size=\d+", b"", d)), {"stream"},
    ),
    "kitty, chunks too long": (bytewise(KITTY, long_chunks), {"stream"}),
    "kitty, all keys in each chunk": (bytewise(KITTY, all_keys_again), {"stream"}),
    "kitty moves the cursor": (bytewise(KITTY, lambda d: d.replace(b",C=1", b"")), {"stream"}),
    "kitty wants an answer": (bytewise(KITTY, lambda d: d.replace(b"q=2,", b"")), {"stream"}),
    "kitty, last chunk missing": (
        bytewise(KITTY, lambda d: re.sub(rb"m=0;", b"m=1;", d)), UNREADABLE - {"changes"},
    ),
    "kitty without a terminator": (
        bytewise(KITTY, lambda d: d[:-2]), {"controls", *UNREADABLE} - {"changes"},
    ),
    "kitty, one row short": (framed(KITTY, one_row_less), {"shape"}),
    "kitty, one row too many": (
        sized(KITTY, lambda terminal, width, height: (width, height + 1)), {"size", "stream"},
    ),
    "half blocks in the last row": (
        replace(sized(HALFBLOCK, all_rows), encode=whole_screen),
        {"size", "controls", *UNREADABLE} - {"changes"},
    ),
    "size of nothing": (sized(KITTY, lambda terminal, width, height: (0, height)), {"size"}),
    "clears the screen": (bytewise(HALFBLOCK, lambda d: b"\x1b[2J" + d), {"controls"}),
    "sets a mode": (bytewise(HALFBLOCK, lambda d: b"\x1b[?7l" + d), {"controls"}),
    "asks where the cursor is": (bytewise(HALFBLOCK, lambda d: d + b"\x1b[6n"), {"controls"}),
    "leaves colours set": (
        bytewise(HALFBLOCK, lambda d: d.removesuffix(RESET)), {"controls"},
    ),
    "remembers": (replace(KITTY, encode=Remembering()), {"pure"}),
    "keeps a frame": (replace(KITTY, encode=Keeping()), {"pure"}),
    "caches by memory": (replace(KITTY, encode=Caching()), {"pure"}),
    "clips in place": (replace(KITTY, encode=clips_in_place), {"pure"}),
    "changes of upper halves only": (replace(HALFBLOCK, encode=upper_halves_only), {"changes"}),
    "blocks, red and blue swapped": (rgb(BLOCKS, lambda v: v[..., ::-1]), {"picture"}),
    "blocks mirrored": (rgb(BLOCKS, lambda v: v[:, ::-1]), {"picture"}),
    "blocks truncate": (rgb(BLOCKS, truncated), {"rounding", "picture"}),
    "blocks of a wrong set": (replace(BLOCKS, encode=other_glyphs), UNREADABLE - {"changes"}),
    "octants in order": (bytewise(BLOCKS, octants_in_order), {"picture"}),
    "braille upside down": (rgb(BRAILLE, lambda v: v[::-1]), {"picture"}),
    "braille inverted": (rgb(BRAILLE, lambda v: 1 - v), {"picture"}),
    "kitty, few pixels left small": (replace(KITTY, fill=KITTY.encode), {"fill"}),
    "sixel, few pixels left small": (replace(SIXEL, fill=SIXEL.encode), {"fill"}),
    "iterm2 keeps the aspect of few pixels": (
        replace(ITERM2, fill=lambda f, t, p: iterm2.fill(f, t, p).replace(b"Ratio=0", b"Ratio=1")),
        {"fill"},
    ),
    "few pixels mirrored": (
        replace(
            KITTY, fill=rgb(replace(KITTY, encode=kitty.fill), lambda v: v[:, ::-1]).encode
        ),
        {"fill"},
    ),
    "few pixels after many are not shown": (
        replace(KITTY, fill=keeps_what_it_filled), {"fill"},
    ),
    "few pixels, last row, too": (
        replace(KITTY, fill=lambda f, t, p: kitty.fill(f, replace(t, rows=t.rows + 1), p)),
        {"fill"},
    ),
    "iterm2, what stays is poor": (replace(iterm2.ITERM2, fill=None, rest=few_levels_at_rest),
                                   {"rest"}),
    "sixel, what stays is mirrored": (
        replace(
            sixel.SIXEL, fill=None,
            rest=lambda f, t: sixel.rest(Frame(f.rgb[:, ::-1], f.transmittance), t),
        ),
        {"rest"},
    ),
    "iterm2, what stays is left out": (
        replace(
            iterm2.ITERM2, fill=None,
            rest=lambda f, t: iterm2.rest(f, t).replace(b"inline=1", b"inline=0"),
        ),
        {"rest"},
    ),
    "sixel, strips a cell too high": (replace(SIXEL, encode=strips_too_high), {"changes"}),
    "sixel, strips of bands": (replace(SIXEL, encode=strips_of_bands), {"stream", "changes"}),
    "sends no changes": (replace(KITTY, encode=nothing_after_the_first), {"changes"}),
}  # fmt: skip
"""Name -> the presenter, and the checks that must catch it, and no other."""
