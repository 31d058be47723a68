"""What the panel of settings and figures has in it: a table of rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from tsplat.core.constants import ALPHA_FLOOR, ALPHA_THRESHOLD, EPS2D
from tsplat.core.params import CONTRACT, KNOBS, LOW_PASS, PRESETS, settings_text
from tsplat.core.workspace import default_threads
from tsplat.edits import Box
from tsplat.viewer.controls import BACKGROUNDS, FOVS, SPEEDS, View
from tsplat.viewer.look import FPS
from tsplat.views import FOV

T = TypeVar("T")

THRESHOLDS = (0.0, 1 / 4080, 1 / 1020, ALPHA_THRESHOLD, 2 / 255, 4 / 255, 8 / 255, 16 / 255)
STOPS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 5e-2)
SHARES = (0.05, 0.1, 0.25, 0.5, 0.75, 1.0)
SCALES = (0.1, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
BITS = (16, 20, 24, 32)
RATES = (100e3, 250e3, 500e3, 1e6, 2e6, 5e6, 10e6, None)  # bits/s
FRAMES = (5.0, 10.0, 15.0, 20.0, 24.0, 30.0, 60.0, 120.0)
PICTURES = (None, (640, 360), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160))
CUTS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9)
RAW = "raw opacity"
CROP_STEP = 0.02  # of the distance, per key press


@dataclass(frozen=True)
class Facts:
    """What the rows say that no setting holds; words are for a person."""

    presenters: Sequence[str] = ()  # that this terminal can show
    backends: Sequence[str] = ()  # that can be used here
    chosen: Mapping[str, str] = field(default_factory=dict)  # for "auto": setting -> name
    figures: Sequence[tuple[str, str]] = ()  # name, words
    read_raw: bool = False  # the file was read with --raw-opacity: nothing is to be taken back


@dataclass(frozen=True)
class Row:
    """One line: a name, words for its value and, unless it only says, what a step does to it.

    ``step(view, by, facts)`` is the view with the next value or, at -1, the one before;
    ``first(view)`` is the view with the value that one starts with.
    """

    name: str
    text: Callable[[View, Facts], str]
    step: Callable[[View, int, Facts], View] | None = None
    first: Callable[[View], View] | None = None


Section = tuple[str, Sequence[Row]]


def _stepped(values: Sequence[T], now: T, by: int) -> T:
    """The value after ``now``, or before; it stays at the ends. ``now`` joins ``values``."""
    numbers: list[T] = list(values)
    if now not in numbers:
        numbers.append(now)
        numbers.sort(key=lambda value: (value is None, value))
    return numbers[min(max(numbers.index(now) + by, 0), len(numbers) - 1)]


def _turned(values: Sequence[T], now: T, by: int) -> T:
    """Likewise, but round and round."""
    if not values:
        return now
    place = values.index(now) if now in values else -1 if by > 0 else 0
    return values[(place + by) % len(values)]


# --- rows of one kind


def _param(name: str, field: str, values: Sequence[float], text: Callable[[float], str]) -> Row:
    return Row(
        name,
        lambda view, facts: text(getattr(view.look.params, field)),
        lambda view, by, facts: view.shading(
            **{field: _stepped(values, getattr(view.look.params, field), by)}
        ),
        lambda view: view.shading(**{field: getattr(CONTRACT, field)}),
    )


def _switch(name: str, get: Callable[[View], bool], put: Callable[[View, bool], View]) -> Row:
    return Row(
        name,
        lambda view, facts: "on" if get(view) else "off",
        lambda view, by, facts: put(view, not get(view)),
        lambda view: put(view, False) if get(view) else view,
    )


def _factor(
    name: str, get: Callable[[View], float], put: Callable[[View, float], View],
    by: float, low: float, high: float,
) -> Row:  # fmt: skip
    """A number whose steps are a factor; 1 is among them, and so are ``low`` and ``high``."""

    def place(value: float) -> int:
        return round(math.log(max(value, 1e-9)) / math.log(by))

    def step(view: View, steps: int, facts: Facts) -> View:
        return put(view, by ** min(max(place(get(view)) + steps, place(low)), place(high)))

    return Row(name, lambda view, facts: f"{get(view):.3g}", step, lambda view: put(view, 1.0))


def _speed(name: str, field: str) -> Row:
    return _factor(
        name,
        lambda view: float(getattr(view.look, field)),
        lambda view, value: view.looking(**{field: value}),
        2**0.5, *SPEEDS,
    )  # fmt: skip


def _of_look(name: str, field: str, values: Sequence[T], text: Callable[[T], str], first: T) -> Row:
    return Row(
        name,
        lambda view, facts: text(getattr(view.look, field)),
        lambda view, by, facts: view.looking(
            **{field: _stepped(values, getattr(view.look, field), by)}
        ),
        lambda view: view.looking(**{field: first}),
    )


def _named(name: str, field: str, values: Callable[[Facts], Sequence[str]]) -> Row:
    def text(view: View, facts: Facts) -> str:
        now = str(getattr(view.look, field))
        chosen = facts.chosen.get(field, "")
        return f"{now}: {chosen}" if now == "auto" and chosen else now

    return Row(
        name,
        text,
        lambda view, by, facts: view.looking(
            **{field: _turned(["auto", *values(facts)], getattr(view.look, field), by)}
        ),
        lambda view: view.looking(**{field: "auto"}),
    )


# --- words


def _fraction(value: float) -> str:
    if value and abs(255 * value - round(255 * value)) < 1e-9:
        return f"{round(255 * value)}/255"
    return f"{value:.3g}"


def _percent(value: float) -> str:
    return f"{100 * value:.3g} %"


def _color(value: tuple[float, float, float]) -> str:
    names = dict(zip(BACKGROUNDS, ("black", "grey", "white"), strict=True))
    return names.get(value) or ",".join(f"{channel:.2g}" for channel in value)


def _bits(value: float | None) -> str:
    if value is None:
        return "as it goes"
    return f"{value / 1e6:g} Mbit/s" if value >= 1e6 else f"{value / 1e3:g} kbit/s"


def _size(value: tuple[int, int] | None) -> str:
    return "as shown" if value is None else f"{value[0]}x{value[1]}"


def _sigmas(view: View, facts: Facts) -> str:
    """How far a Gaussian of opacity 1 is drawn: where its alpha falls to the threshold."""
    threshold = max(view.look.params.alpha_threshold, ALPHA_FLOOR)
    return f"{math.sqrt(-2 * math.log(threshold)):.2f} of opacity 1"


def _up(view: View, facts: Facts) -> str:
    axis = view.home.up / max(abs(view.home.up).max(), 1e-300)
    place = int(abs(axis).argmax())
    return f"{'-' if axis[place] < 0 else '+'}{'xyz'[place]}"


# --- steps that are no list of values


def _preset(view: View, by: int, facts: Facts) -> View:
    now = settings_text(view.look.params)
    return _as_preset(view, _turned(list(PRESETS), now, by) if now in PRESETS else "contract")


def _as_preset(view: View, name: str) -> View:
    return view.shading(**{knob: getattr(PRESETS[name], knob) for knob in KNOBS})


def _threads(view: View, by: int, facts: Facts) -> View:
    now = view.look.threads or default_threads()
    return view.looking(threads=min(max(now + by, 1), default_threads()))


def _fov(view: View, by: int, facts: Facts) -> View:
    return view.with_fov(min(max(round(view.fov + 5 * by), FOVS[0]), FOVS[1]))


def _axis(axis: int, high: bool) -> Row:
    """One side of the box."""

    def text(view: View, facts: Facts) -> str:
        crop = view.look.edits.crop
        return "" if crop is None else f"{(crop.high if high else crop.low)[axis]:.4g}"

    def step(view: View, by: int, facts: Facts) -> View:
        crop = view.look.edits.crop
        if crop is None:
            return view.cropped()
        low, up = list(crop.low), list(crop.high)
        move = by * CROP_STEP * view.home.distance
        if high:
            up[axis] = max(up[axis] + move, low[axis])
        else:
            low[axis] = min(low[axis] + move, up[axis])
        return view.editing(crop=Box(tuple(low), tuple(up)))  # type: ignore[arg-type]

    return Row(f"  {'xyz'[axis]} {'to' if high else 'from'}", text, step)


CAMERA: Sequence[Row] = (
    _switch("fly", lambda v: v.flying, lambda v, on: v.flown(on)),
    _switch("turn by itself", lambda v: v.spinning, lambda v, on: v.spinning_is(on)),
    Row("field of view", lambda v, f: f"{v.fov:.3g} degrees", _fov, lambda v: v.with_fov(FOV)),
    Row("up", _up, lambda v, by, f: v.next_axis(by)),
    _speed("move speed", "move_speed"),
    _speed("turn speed", "turn_speed"),
    _speed("zoom speed", "zoom_speed"),
)
QUALITY: Sequence[Row] = (
    Row("quality", lambda v, f: settings_text(v.look.params) if
        settings_text(v.look.params) in PRESETS else "your own", _preset,
        lambda v: _as_preset(v, "contract")),
    _param("SH degree", "sh_degree", range(4), lambda value: f"{value} at most"),
    _switch("antialias", lambda v: v.look.params.antialias, lambda v, on: v.shading(antialias=on)),
    _param("pixel density", "scale", SCALES, _percent),
    _param("share of splats", "share", SHARES, _percent),
    _param("alpha threshold", "alpha_threshold", THRESHOLDS, _fraction),
    Row("  reach in sigmas", _sigmas),
    _param("stop at", "transmittance_min", STOPS, lambda value: f"{value:g} of light"),
    _param("depth bits", "depth_bits", BITS, str),
    _param("low-pass filter", "low_pass", (0.01, 0.03, 0.1, EPS2D, 0.5, 1.0, 2.0, 5.0, LOW_PASS[1]),
           lambda value: f"{value:g} px^2"),
)  # fmt: skip
SCENE: Sequence[Row] = (
    _factor("splat scale", lambda v: v.look.edits.splat_scale,
            lambda v, value: v.editing(splat_scale=value), 2**0.25, 1 / 64, 16.0),
    Row("opacity cut", lambda v, f: f"{v.look.edits.min_opacity:g}",
        lambda v, by, f: v.editing(min_opacity=_stepped(CUTS, v.look.edits.min_opacity, by)),
        lambda v: v.editing(min_opacity=0.0)),
    _switch(RAW, lambda v: v.look.edits.raw_opacity,
            lambda v, on: v.editing(raw_opacity=on)),
    Row("saturation", lambda v, f: f"{v.look.edits.saturation:.3g}",
        lambda v, by, f: v.editing(
            saturation=round(min(max(v.look.edits.saturation + by / 10, 0.0), 4.0), 1)),
        lambda v: v.editing(saturation=1.0)),
    _of_look("background", "background", BACKGROUNDS, _color, BACKGROUNDS[0]),
    _switch("crop", lambda v: v.look.edits.crop is not None, lambda v, on: v.cropped()),
)  # fmt: skip
BOX: Sequence[Row] = tuple(_axis(axis, high) for axis in range(3) for high in (False, True))
SHOWING: Sequence[Row] = (
    _named("presenter", "presenter", lambda facts: facts.presenters),
    _named("backend", "backend", lambda facts: facts.backends),
    Row("threads", lambda v, f: str(v.look.threads or default_threads()), _threads,
        lambda v: v.looking(threads=None)),
    _of_look("frames a second", "fps", FRAMES, lambda value: f"{value:g}", FPS),
    _of_look("link at most", "max_rate", RATES, _bits, None),
    Row("kept pictures", lambda v, f: _size(v.look.picture),
        lambda v, by, f: v.looking(picture=_turned(PICTURES, v.look.picture, by)),
        lambda v: v.looking(picture=None)),
)  # fmt: skip


def _figure(name: str, words: str) -> Row:
    """A row that only says something."""
    return Row(name, lambda view, facts: words)


def sections(view: View, facts: Facts) -> list[Section]:
    """All rows, under their titles; those of the box while there is one."""
    box = BOX if view.look.edits.crop is not None else ()
    scene = [row for row in SCENE if not (facts.read_raw and row.name == RAW)]
    figures = [_figure(name, words) for name, words in facts.figures]
    return [
        ("Camera", CAMERA),
        ("Quality", QUALITY),
        ("Scene", (*scene, *box)),
        ("Showing", SHOWING),
        ("Figures", figures),
    ]
