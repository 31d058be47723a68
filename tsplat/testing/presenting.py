"""``presenter_checks(presenter)``: what must hold for any presenter, on drawn screens and frames.

@pytest.mark.parametrize("check", presenter_checks(MY_PRESENTER, my_decoder), ids=str)
def test_conformance(check):
    check()

From the bytes alone:

- size: at least 1x1 px, and on the screen no larger than all rows but the last;
- controls: bytes, sequences that are closed, nothing outside the picture's cells, nothing that
  clears, scrolls, switches modes or asks, colours left as they were;
- pure: the same frame gives the same bytes whatever came before and whichever memory it lies in;
  no frame is changed or kept;
- rounding: only the frame's 8-bit picture counts, as ``Frame.to_uint8`` makes it, for values beyond
  0..1 too, in float32 and float64, with a background and with depth.

With a decoder, which reads the bytes as a terminal would:

- stream: it can read them, and no rule of the protocol is broken;
- shape: the picture shown is as large as the frame;
- picture: it is the frame's, as near as the protocol's bound says;
- changes: bytes for a screen that shows another frame lead to this one as well;
- fill, of a presenter that offers it: a frame of fewer pixels is shown as large as one of
  ``size``, the middle of each of its pixels in its colour, whatever was shown before; and what
  ``controls``, ``pure`` and ``rounding`` say holds for it, too;
- rest, of a presenter that offers it: what ``encode`` promises holds for a picture that stays,
  whatever was shown before, that frame too, and for the frame that follows.

Not checked: whether a real terminal agrees with the decoder, and how long encoding takes.
"""

from __future__ import annotations

import gc
import math
import weakref
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st

from tsplat.core.errors import ContractError
from tsplat.core.types import U8, Frame
from tsplat.presenters.base import Presenter, Terminal
from tsplat.testing import decoders
from tsplat.testing.checks import Check, Verdict, require
from tsplat.testing.conformance import drawn_check
from tsplat.testing.decoders import Decoded, Decoder, decoded
from tsplat.testing.stream import HOME, area_faults

TRUECOLOR = 1 << 24
SIZE_MAX = 2000  # px; a presenter that wants more of a small screen is told so by check_size

SMOOTH_MIN = 8  # px each way, of a picture of fewer pixels


@dataclass(frozen=True)
class Bound:
    """How near a protocol comes to a frame's 8-bit picture."""

    colors: float  # pictures of at most so many of the terminal's own colours; inf: all pictures
    worst: int  # are shown this near, in levels of 255, at each pixel and channel
    psnr: float  # dB, at least, of smooth pictures; 0 for no promise


EXACT = Bound(colors=math.inf, worst=0, psnr=math.inf)


def _exactly(terminal: Terminal) -> Bound:
    return EXACT


@dataclass(frozen=True)
class Decoding:
    """A protocol's decoder, and how near its picture comes to the frame on a given terminal."""

    decode: Decoder
    bound: Callable[[Terminal], Bound] = _exactly
    rest: Callable[[Terminal], Bound] | None = None  # of a picture that stays; None: the same


def _halfblock_bound(terminal: Terminal) -> Bound:
    """Exact in 24 bits; else the terminal's own colours are, if there are few in the picture."""
    return EXACT if terminal.colors == TRUECOLOR else Bound(4, 0, 17.0 * (terminal.colors == 256))


def _blocks_bound(terminal: Terminal) -> Bound:
    """Two colours a cell: octants and sextants show any two, the others any one."""
    any_two = terminal.glyphs in ("octants", "sextants")
    if terminal.colors == 2:
        return Bound(1 + any_two, 0, 0)
    if terminal.colors == TRUECOLOR:
        return EXACT if terminal.glyphs == "halves" else Bound(1 + any_two, 0, 20.0)
    return Bound(1, 0, 14.0 * (terminal.colors == 256))


def _braille_bound(terminal: Terminal) -> Bound:
    """Black and white are exact; of colours the mean is right, with black between the dots."""
    return Bound(2, 0, 0) if terminal.colors == 2 else Bound(0, 0, 9.0 * (terminal.colors > 16))


def _letters_bound(terminal: Terminal) -> Bound:
    """As braille, and darker: no letter is all ink."""
    return Bound(0, 0, 6.0 * (terminal.colors > 16))


def _sixel_bound(terminal: Terminal) -> Bound:
    """Percent: 2.55 levels a step, and two roundings. Smooth pictures need more registers."""
    enough = 29.0 if terminal.remote else 34.0
    return Bound(4, 2, enough if terminal.sixel_registers >= 256 else 24.0)


def _sixel_rest(terminal: Terminal) -> Bound:
    """The same near by and far away."""
    return _sixel_bound(replace(terminal, remote=False))


def _jpeg_bound(terminal: Terminal) -> Bound:
    """Of one colour, all but rounding; smooth pictures as quality 75 has them."""
    return Bound(1, 3, 34.0)


def _iterm2_rest(terminal: Terminal) -> Bound:
    """Exact, or over a network a better JPEG."""
    return Bound(1, 3, 38.0) if terminal.remote else EXACT


DECODINGS = {
    "kitty": Decoding(decoders.kitty),
    "iterm2": Decoding(decoders.iterm2, _jpeg_bound, _iterm2_rest),
    "sixel": Decoding(decoders.sixel, _sixel_bound, _sixel_rest),
    "blocks": Decoding(decoders.blocks, _blocks_bound),
    "halfblock": Decoding(decoders.halfblock, _halfblock_bound),
    "braille": Decoding(decoders.braille, _braille_bound),
    "letters": Decoding(decoders.letters, _letters_bound),
}
"""The built-in presenters' protocols."""


@st.composite
def terminals(draw: st.DrawFn) -> Terminal:
    """Small screens of two rows or more that take every protocol."""
    return Terminal(
        columns=draw(st.integers(1, 8)),
        rows=draw(st.integers(2, 4)),
        cell_width=draw(st.sampled_from((1.0, 5.0, 8.5, 9.63))),
        cell_height=draw(st.sampled_from((6.0, 7.0, 19.0))),
        colors=draw(st.sampled_from((TRUECOLOR, TRUECOLOR, 256, 16, 2))),
        kitty=True,
        iterm2=True,
        sixel=True,
        sixel_registers=draw(st.sampled_from((16, 256, 1024))),
        sixel_max=draw(st.sampled_from(((0, 0), (60, 40)))),
        glyphs=draw(st.sampled_from(("halves", "quadrants", "sextants", "octants"))),
        draws_blocks=True,
        synchronized=True,
        cell_told=draw(st.booleans()),
        remote=draw(st.booleans()),
        name=draw(st.sampled_from(("", "Konsole 26.08.2", "kitty(0.48.2)"))),
    )


KINDS = ("flat", "pair", "tones", "smooth", "noise")

# Levels that the colours of a terminal are made of, so that each of them is one of its own
_LEVELS = {
    TRUECOLOR: (0, 40, 128, 200, 255),
    256: (0, 95, 175, 255),  # of xterm's cube
    16: (0, 255),  # 0 and 9 to 15, all but bright blue
    2: (0, 255),
}


def make_pixels(seed: int, kind: str, width: int, height: int, colors: int) -> U8:
    """An [H, W, 3] picture of one of :data:`KINDS`.

    Of one, two or a few tones: colours that a terminal with ``colors`` has. Noise makes long
    streams.
    """
    rng = np.random.default_rng(seed)
    if kind == "noise":
        return rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    if kind == "smooth":
        y, x = np.mgrid[0:height, 0:width] / max(width, height)
        waves = rng.uniform(-1.5, 1.5, (3, 2))
        rgb = [
            np.sin(a * x + b * y + phase) for (a, b), phase in zip(waves, (0, 1, 2), strict=True)
        ]
        return np.rint(127.5 + 120 * np.stack(rgb, -1)).astype(np.uint8)
    levels = np.array(_LEVELS[colors], np.uint8)
    table = rng.choice(levels, ({"flat": 1, "pair": 2}.get(kind, 4), 3))
    if colors == 2:
        table[:] = table[:, :1]
    if colors == 16:
        table[(table == (0, 0, 255)).all(1)] = 255
    return table[rng.integers(0, len(table), (height, width))]


def make_frame(pixels: U8, seed: int, disguise: str) -> Frame:
    """A frame whose ``to_uint8`` is ``pixels``, as little like ``pixels / 255`` as possible.

    Values lie anywhere within their level, and beyond 0..1 where the level is an end.
    """
    rng = np.random.default_rng(seed)
    values = pixels + rng.uniform(-0.45, 0.45, pixels.shape)
    beyond = rng.choice((0.0, 0.3, 1e3, 1e6), pixels.shape)
    values = np.where(pixels == 0, -beyond, np.where(pixels == 255, 255 + beyond, values)) / 255
    clear = np.zeros(pixels.shape[:2], np.float32)
    if disguise == "background":
        background = 0.25, 0.5, 1.0
        rgb = values - 0.5 * np.array(background)
        return Frame(rgb.astype(np.float32), clear + np.float32(0.5)).over(background)
    depth = rng.uniform(0, 9, clear.shape).astype(np.float32) if disguise == "depth" else None
    if disguise == "float64":
        return Frame(values, clear.astype(np.float64))
    return Frame(values.astype(np.float32), clear, depth)


@dataclass(frozen=True, eq=False)
class Showing:
    """One example: a screen that shows ``before``, and the frame it is to show."""

    terminal: Terminal
    frame: Frame
    before: Frame  # as large
    kind: str  # of the frame, one of KINDS
    few: Frame  # no larger than it: what a moving picture may be

    def __repr__(self) -> str:
        return f"{self.kind}, {self.frame.width}x{self.frame.height} px, on {self.terminal}"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(repr(self))  # not every pixel


@st.composite
def _showings(
    draw: st.DrawFn, presenter: Presenter, screens: st.SearchStrategy[Terminal]
) -> Showing:
    terminal = draw(screens)
    assume(presenter.unsupported(terminal) is None)
    try:
        width, height = _size(presenter, terminal)
    except ContractError:
        width = height = 1  # check_size tells; the others need a frame
    size = min(width, SIZE_MAX), min(height, SIZE_MAX)
    kind = draw(st.sampled_from(KINDS))
    disguise = draw(st.sampled_from(("plain", "background", "depth", "float64")))
    seed = draw(st.integers(0, 2**32 - 1))
    pixels = make_pixels(seed, kind, *size, terminal.colors)
    earlier = draw(st.sampled_from(("same", "one pixel", "one column", "another")))
    other = pixels.copy()
    if earlier == "one pixel":
        other[seed % size[1], seed % size[0]] ^= 255
    elif earlier == "one column":
        other[:, seed % size[0]] ^= 255
    elif earlier == "another":
        other = make_pixels(seed + 1, draw(st.sampled_from(KINDS)), *size, terminal.colors)
    fewer = 1 + seed % size[0], 1 + seed // SIZE_MAX % size[1]
    few = make_pixels(seed + 3, kind, *fewer, terminal.colors)
    return Showing(
        terminal, make_frame(pixels, seed, disguise), make_frame(other, seed + 2, "plain"),
        kind, make_frame(few, seed + 4, disguise),
    )  # fmt: skip


def _size(presenter: Presenter, terminal: Terminal) -> tuple[int, int]:
    """``presenter.size``, whole numbers from 1 on.

    Raises:
        ContractError: it is anything else.
    """
    size: Any = presenter.size(terminal)
    whole = isinstance(size, tuple) and len(size) == 2 and all(isinstance(n, int) for n in size)
    if not whole or min(size) < 1:
        raise ContractError(f"size: expected two whole numbers from 1 on, got {size!r}")
    return int(size[0]), int(size[1])


def _encode(presenter: Presenter, frame: Frame, terminal: Terminal, before: Frame | None) -> bytes:
    data: object = presenter.encode(frame, terminal, before)
    if not isinstance(data, bytes):
        raise ContractError(f"encode: expected bytes, got {type(data).__name__}")
    return data


def _copy(frame: Frame) -> Frame:
    depth = None if frame.depth is None else frame.depth.copy()
    return Frame(frame.rgb.copy(), frame.transmittance.copy(), depth)


def _same(a: Frame, b: Frame) -> bool:
    pairs = [(a.rgb, b.rgb), (a.transmittance, b.transmittance)]
    if a.depth is not None and b.depth is not None:
        pairs.append((a.depth, b.depth))
    return all(x.tobytes() == y.tobytes() for x, y in pairs)


# --- from the bytes alone


def check_size(presenter: Presenter, case: Showing) -> Verdict:
    """See the module. Also ``pixel``: two numbers above 0."""
    terminal = case.terminal
    width, height = _size(presenter, terminal)
    across, down = presenter.pixel(terminal)
    if not (across > 0 and down > 0):
        return Verdict("size", (f"pixel: expected two numbers above 0, got {across}, {down}",))
    most = terminal.columns * terminal.cell_width, (terminal.rows - 1) * terminal.cell_height
    if width * across > most[0] + 1e-6 or height * down > most[1] + 1e-6:
        return Verdict(
            "size",
            (f"{width}x{height} px of {across:g}x{down:g} are more than all rows but the last, "
             f"{most[0]:g}x{most[1]:g}",),
        )  # fmt: skip
    return Verdict("size", ())


def check_controls(presenter: Presenter, case: Showing) -> Verdict:
    """See the module. ``clear`` may show nothing, but do no more than ``encode``."""
    terminal = case.terminal
    streams = [_encode(presenter, case.frame, terminal, b) for b in (None, case.before)]
    clear: object = presenter.clear(terminal)
    if not isinstance(clear, bytes):
        return Verdict("controls", (f"clear: expected bytes, got {type(clear).__name__}",))
    faults = [fault for data in (*streams, clear) for fault in area_faults(data, terminal)]
    return Verdict("controls", tuple(dict.fromkeys(faults)))


def check_pure(presenter: Presenter, case: Showing) -> Verdict:
    """See the module."""
    terminal, frame, before = case.terminal, _copy(case.frame), _copy(case.before)
    faults = []

    def encode(new: Frame, old: Frame | None) -> bytes:
        return _encode(presenter, new, terminal, old)

    first = encode(frame, None), encode(frame, before), encode(before, None)
    if not (_same(frame, case.frame) and _same(before, case.before)):
        return Verdict("pure", ("encode changes a frame that it was given",))
    again = encode(_copy(before), None), encode(_copy(frame), _copy(before)), encode(frame, None)
    if first != again[::-1]:
        faults.append("the same frames give other bytes the second time")
    # Frames live in memory that is used again: the same object, another picture
    seen = weakref.ref(frame), weakref.ref(frame.rgb)
    frame.rgb[...] = before.rgb
    if encode(frame, None) != encode(_copy(frame), None):
        faults.append("a frame's bytes depend on what its memory held before")
    frame.rgb[...] = case.frame.rgb
    if encode(frame, None) != first[0] and not faults:
        faults.append("a frame's bytes depend on what its memory held before")
    del frame
    if any(ref() is not None for ref in seen):
        gc.collect()
        if any(ref() is not None for ref in seen):
            faults.append("encode keeps a frame after it has returned")
    return Verdict("pure", tuple(faults))


def check_rounding(presenter: Presenter, case: Showing) -> Verdict:
    """See the module."""
    frame, terminal = case.frame, case.terminal
    levels = frame.to_uint8()
    plain = Frame(levels / np.float32(255), np.zeros(levels.shape[:2], np.float32))
    if _encode(presenter, frame, terminal, None) != _encode(presenter, plain, terminal, None):
        return Verdict(
            "rounding", ("two frames with the same Frame.to_uint8() give different bytes",)
        )
    return Verdict("rounding", ())


# --- with a decoder


def _show(presenter: Presenter, decode: Decoder, case: Showing, *frames: Frame) -> Decoded:
    """What is on the screen after ``frames``, each sent as a change of the one before."""
    stream, before = b"", None
    for frame in frames:
        stream += HOME + _encode(presenter, frame, case.terminal, before)
        before = frame
    return decoded(decode, stream, case.terminal)


def check_stream(presenter: Presenter, decoding: Decoding, case: Showing) -> Verdict:
    """See the module."""
    faults: list[str] = []
    for frames in ((case.frame,), (case.before, case.frame)):
        try:
            faults += _show(presenter, decoding.decode, case, *frames).faults
        except ContractError as error:
            faults.append(str(error))
    return Verdict("stream", tuple(dict.fromkeys(faults)))


def check_shape(presenter: Presenter, decoding: Decoding, case: Showing) -> Verdict:
    """See the module."""
    picture = _show(presenter, decoding.decode, case, case.frame).picture
    expected = (case.frame.height, case.frame.width, 3)
    if picture.shape != expected or picture.dtype != np.uint8:
        came = f"{picture.dtype} {list(picture.shape)}"
        return Verdict("shape", (f"expected uint8 {list(expected)}, shown is {came}",))
    return Verdict("shape", ())


def check_picture(presenter: Presenter, decoding: Decoding, case: Showing) -> Verdict:
    """See the module."""
    return _judge("picture", decoding, case, _show(presenter, decoding.decode, case, case.frame))


def check_changes(presenter: Presenter, decoding: Decoding, case: Showing) -> Verdict:
    """See the module. Of frames that are shown wrong by themselves check_picture tells."""
    for frame in (case.before, case.frame):
        alone = replace(case, frame=frame, kind=case.kind if frame is case.frame else "noise")
        try:
            shown = _show(presenter, decoding.decode, alone, frame)
        except ContractError:
            return Verdict("changes", ())
        if not _judge("changes", decoding, alone, shown).passed:
            return Verdict("changes", ())
    shown = _show(presenter, decoding.decode, case, case.before, case.frame)
    return _judge("changes", decoding, case, shown)


def check_fill(presenter: Presenter, decoding: Decoding, case: Showing) -> Verdict:
    """See the module."""
    if presenter.fill is None:
        return Verdict("fill", ())
    filling = replace(presenter, encode=presenter.fill, fill=None)
    # A smooth picture of a handful of pixels is not smooth: no promise is made of it
    steep = case.kind == "smooth" and min(case.few.width, case.few.height) < SMOOTH_MIN
    before = make_frame(255 - case.few.to_uint8(), 1, "plain")
    kind = "noise" if steep else case.kind
    small = replace(case, frame=case.few, before=before, kind=kind)
    faults: list[str] = []
    for name in ("controls", "pure", "rounding"):
        faults += BYTES_ALONE[name](filling, small).faults
    large, few = case.frame, case.few
    ways = {
        "an empty screen": filling.encode(few, case.terminal, None),
        "one of full size": presenter.encode(large, case.terminal, None)
        + HOME + filling.encode(few, case.terminal, large),
        "another of fewer pixels": filling.encode(small.before, case.terminal, None)
        + HOME + filling.encode(few, case.terminal, small.before),
    }  # fmt: skip
    for after, data in ways.items():
        shown = decoded(decoding.decode, HOME + data, case.terminal)
        faults += shown.faults
        if shown.picture.shape != (large.height, large.width, 3):
            faults.append(
                f"after {after}: expected {large.width}x{large.height} px, shown is "
                f"{list(shown.picture.shape)}"
            )
            continue
        y, x = (
            (2 * np.arange(n) + 1) * m // (2 * n)
            for n, m in ((few.height, large.height), (few.width, large.width))
        )
        picture = Decoded(np.ascontiguousarray(shown.picture[y][:, x]))
        faults += (
            f"after {after}: {fault}" for fault in _judge("fill", decoding, small, picture).faults
        )
    back = filling.encode(few, case.terminal, None) + HOME
    back += presenter.encode(large, case.terminal, few)
    shown = decoded(decoding.decode, HOME + back, case.terminal)
    faults += (f"full size after few: {f}" for f in _judge("fill", decoding, case, shown).faults)
    return Verdict("fill", tuple(dict.fromkeys(faults)))


def check_rest(presenter: Presenter, decoding: Decoding, case: Showing) -> Verdict:
    """See the module."""
    if presenter.rest is None:
        return Verdict("rest", ())
    rest, terminal = presenter.rest, case.terminal
    # What is known of the screen is nothing to a picture that comes whole
    resting = replace(presenter, encode=lambda frame, terminal, _: rest(frame, terminal), rest=None)
    faults: list[str] = []
    for name in ("controls", "pure", "rounding"):
        faults += BYTES_ALONE[name](resting, case).faults
    at_rest = replace(decoding, bound=decoding.rest or decoding.bound)
    for before in (None, case.before, case.frame):
        data = b"" if before is None else presenter.encode(before, terminal, None)
        data += HOME + rest(case.frame, terminal)
        shown = decoded(decoding.decode, data, terminal)
        if shown.picture.shape != (case.frame.height, case.frame.width, 3):
            faults.append(f"shown are {list(shown.picture.shape)}")
        faults += (*shown.faults, *_judge("rest", at_rest, case, shown).faults)
    moved = replace(case, frame=case.before, kind="noise")
    data += HOME + presenter.encode(case.before, terminal, case.frame)
    shown = decoded(decoding.decode, data, terminal)
    faults += (f"the next frame: {f}" for f in _judge("rest", decoding, moved, shown).faults)
    return Verdict("rest", tuple(dict.fromkeys(faults)))


_WAYS: dict[str, Callable[[U8], U8]] = {
    "mirrored": lambda p: p[:, ::-1],
    "upside down": lambda p: p[::-1],
    "with red and blue swapped": lambda p: p[..., ::-1],
    "with its channels turned round": lambda p: np.roll(p, 1, axis=2),
    "a pixel to the right": lambda p: np.roll(p, 1, axis=1),
    "a pixel to the left": lambda p: np.roll(p, -1, axis=1),
    "a pixel down": lambda p: np.roll(p, 1, axis=0),
    "a pixel up": lambda p: np.roll(p, -1, axis=0),
    "inverted": lambda p: 255 - p,
}
"""How a picture may come to be wrong, to say so."""


def _squared(a: U8, b: U8) -> float:
    return float(((a.astype(np.float64) - b) ** 2).mean())


def _judge(check: str, decoding: Decoding, case: Showing, shown: Decoded) -> Verdict:
    wanted, picture = case.frame.to_uint8(), shown.picture
    if picture.shape != wanted.shape:
        return Verdict(check, ())  # check_shape's business
    bound = decoding.bound(case.terminal)
    error = abs(picture.astype(np.int16) - wanted)
    colors = len(np.unique(wanted.reshape(-1, 3), axis=0))
    faults = []
    few = case.kind in ("flat", "pair", "tones") and colors <= bound.colors
    if (few or bound.colors == math.inf) and error.max() > bound.worst:
        y, x, _ = np.unravel_index(error.argmax(), error.shape)
        faults.append(
            f"{int((error.max(-1) > bound.worst).sum())} of {picture.size // 3} pixels are off by "
            f"more than {bound.worst} levels; ({x}, {y}) is {picture[y, x]} instead of "
            f"{wanted[y, x]}"
        )
    squared = _squared(picture, wanted)
    psnr = math.inf if squared == 0 else 10 * math.log10(255**2 / squared)
    if case.kind == "smooth" and psnr < bound.psnr and not faults:
        faults.append(f"a smooth picture is shown at {psnr:.1f} dB; {bound.psnr:g} are promised")
    if faults:
        nearest = min(_WAYS, key=lambda name: _squared(picture, _WAYS[name](wanted)))
        if _squared(picture, _WAYS[nearest](wanted)) < squared / 2:
            faults[0] += f"; it looks like the frame {nearest}"
    return Verdict(check, tuple(faults))


BYTES_ALONE = {
    "size": check_size,
    "controls": check_controls,
    "pure": check_pure,
    "rounding": check_rounding,
}
DECODED = {
    "stream": check_stream,
    "shape": check_shape,
    "picture": check_picture,
    "changes": check_changes,
    "fill": check_fill,
    "rest": check_rest,
}


def presenter_checks(
    presenter: Presenter,
    decode: Decoder | Decoding | None = None,
    max_examples: int = 100,
    screens: st.SearchStrategy[Terminal] | None = None,
) -> list[Check]:
    """The checks of ``presenter``: four, or eight with a decoder of its bytes, and one each for
    ``fill`` and ``rest``.

    ``decode`` alone promises the frame's 8-bit picture exactly; :class:`Decoding` states another
    bound. The built-in presenters' are :data:`DECODINGS`, and whoever uses such a protocol may take
    them. ``screens`` are those to draw from, for a presenter that none of :func:`terminals` suits.
    """
    decoding = decode if isinstance(decode, Decoding | None) else Decoding(decode)
    functions: dict[str, Callable[[Showing], Verdict]] = {}

    def bind(name: str) -> Callable[[Showing], Verdict]:
        if name in BYTES_ALONE:
            return lambda case: BYTES_ALONE[name](presenter, case)
        assert decoding is not None
        return lambda case: DECODED[name](presenter, decoding, case)

    names = [*BYTES_ALONE, *(DECODED if decoding is not None else ())]
    for name in ("fill", "rest"):
        if getattr(presenter, name) is None and decoding is not None:
            names.remove(name)
    for name in names:
        functions[name] = bind(name)

    cases = _showings(presenter, terminals() if screens is None else screens)

    def make(name: str) -> Check:
        def run(case: Showing) -> None:
            require(functions[name](case), f"presenter {presenter.name!r}")

        return drawn_check(name, presenter.name, cases, run, max_examples)

    return [make(name) for name in functions]
