"""What picture is asked for, apart from scene and camera; and named settings of it.

The contract's picture is the default. Everything else is a shortcut with a price, or the opposite
of one: ``tsplat bench`` measures what each costs and saves on a scene.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any

from tsplat.core.constants import ALPHA_THRESHOLD, EPS2D, SH_DEGREE_MAX, TRANSMITTANCE_MIN
from tsplat.core.errors import ParamsError

DEPTH_BITS = 32
"""All bits of a float32 depth."""

LOW_PASS = 0.01, 100.0
"""px^2: what ``low_pass`` may be. Without any, a needle would fall between the pixels' centres."""


@dataclass(frozen=True)
class RenderParams:
    """Settings of a picture; the defaults are the contract's.

    ``scale``, ``share`` and ``half`` are for :class:`tsplat.plan.Plan` to see to, stages take no
    notice of them.

    Raises:
        ParamsError: a value outside its range.
    """

    sh_degree: int = SH_DEGREE_MAX  # highest degree used, 0..3; a scene may have less
    antialias: bool = False  # opacity *= sqrt(det without / det with the low-pass filter)
    depth: bool = False  # also make Frame.depth
    alpha_threshold: float = ALPHA_THRESHOLD
    transmittance_min: float = TRANSMITTANCE_MIN
    depth_bits: int = DEPTH_BITS  # that Splats.depths are rounded to, 10..32; 8 are its exponent
    scale: float = 1.0  # pixels are worked out at this share of width and height, then interpolated
    share: float = 1.0  # of the Gaussians that are drawn, as tsplat.quality.thin picks them
    low_pass: float = EPS2D  # px^2 added to the variances of projected Gaussians
    half: bool = False  # colours in float16 whatever that does to them
    float64: bool = False  # work in float64 throughout; only the reference can

    def __post_init__(self) -> None:
        if not 0 <= self.sh_degree <= SH_DEGREE_MAX:
            raise ParamsError(f"sh_degree: expected 0 to {SH_DEGREE_MAX}, got {self.sh_degree}")
        if not 10 <= self.depth_bits <= DEPTH_BITS:
            raise ParamsError(f"depth_bits: expected 10 to {DEPTH_BITS}, got {self.depth_bits}")
        for name in ("alpha_threshold", "transmittance_min"):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0 <= value < 1):
                raise ParamsError(f"{name}: expected 0 <= value < 1, got {value}")
        for name in ("scale", "share"):
            value = getattr(self, name)
            if not 0 < value <= 1:
                raise ParamsError(f"{name}: expected 0 < value <= 1, got {value}")

        if not LOW_PASS[0] <= self.low_pass <= LOW_PASS[1]:
            raise ParamsError(
                f"low_pass: expected {LOW_PASS[0]} to {LOW_PASS[1]:g} px^2, got {self.low_pass}"
            )

    @property
    def depth_split(self) -> float:
        """C in ``c = C z; z' = c - (c - z)``, all float32: z' is z in ``depth_bits`` bits.

        T. J. Dekker, "A Floating-Point Technique for Extending the Available Precision", 1971.
        With all bits C is 1, and z' is z.
        """
        cut = DEPTH_BITS - self.depth_bits
        return float(2**cut + 1) if cut else 1.0


IDEAL = RenderParams(alpha_threshold=0.0, transmittance_min=0.0, float64=True)
"""The true value of the model: float64, no alpha threshold, no early stop."""

CONTRACT = RenderParams()

PRESETS: Mapping[str, RenderParams] = MappingProxyType(
    {
        "exact": RenderParams(alpha_threshold=0.0, transmittance_min=0.0),
        "contract": CONTRACT,
        "balanced": RenderParams(alpha_threshold=2 / 255, transmittance_min=1e-2),
        "fast": RenderParams(alpha_threshold=4 / 255, transmittance_min=1e-2, share=0.5),
    }
)
"""Name -> settings. ``exact`` is the ideal picture as far as float32 goes."""

KNOBS = (
    "alpha_threshold", "transmittance_min", "sh_degree", "depth_bits", "scale", "share",
    "low_pass", "half",
)  # fmt: skip
"""The fields that a preset or ``--set`` may change."""


def parse_settings(text: str, base: RenderParams = CONTRACT) -> RenderParams:
    """``scale=0.5,sh_degree=1`` on top of ``base``; a fraction such as 1/64 is a number too.

    Raises:
        ParamsError: no such setting, or no value that it takes.
    """
    kinds = {field.name: field.type for field in fields(RenderParams)}
    changes: dict[str, Any] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        name, equals, value = (p.strip() for p in part.partition("="))
        if name not in KNOBS or not equals:
            raise ParamsError(f"{part!r}: expected NAME=VALUE with a name of {', '.join(KNOBS)}")
        changes[name] = _value(name, str(kinds[name]), value)
    return replace(base, **changes)


def _value(name: str, kind: str, text: str) -> float | int | bool:
    try:
        if kind == "bool":
            return {"true": True, "false": False, "1": True, "0": False}[text.lower()]
        if kind == "int":
            return int(text)
        over, _, under = text.partition("/")
        return float(over) / float(under) if under else float(over)
    except (KeyError, ValueError, ZeroDivisionError):
        what = {"bool": "true or false", "int": "a whole number"}.get(kind, "a number")
        raise ParamsError(f"{name}: expected {what}, got {text!r}") from None


def settings_text(params: RenderParams) -> str:
    """What differs from the contract, for :func:`parse_settings`; a preset has its name."""
    for name, preset in PRESETS.items():
        if all(getattr(params, knob) == getattr(preset, knob) for knob in KNOBS):
            return name
    parts = []
    for name in KNOBS:
        value = getattr(params, name)
        if value != getattr(CONTRACT, name):
            parts.append(f"{name}={_number(value) if isinstance(value, float) else value}")
    return ",".join(parts).replace("True", "true")


def _number(value: float) -> str:
    """The shortest that is read as ``value`` again: a fraction if that is one of whole numbers."""
    for over in (1, 2, 4, 8):
        under = over / value if value else math.inf
        if 0.5 < under < 1e6 and over / round(under) == value and len(repr(value)) > 6:
            return f"{over}/{round(under)}"
    return repr(value)
