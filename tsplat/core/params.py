"""What picture is asked for, apart from scene and camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tsplat.core.constants import ALPHA_THRESHOLD, SH_DEGREE_MAX, TRANSMITTANCE_MIN
from tsplat.core.errors import ParamsError


@dataclass(frozen=True)
class RenderParams:
    """Settings of a picture; the defaults are the contract's.

    Raises:
        ParamsError: a value outside its range.
    """

    sh_degree: int = SH_DEGREE_MAX  # highest degree used, 0..3; a scene may have less
    antialias: bool = False  # opacity *= sqrt(det without / det with the low-pass filter)
    depth: bool = False  # also make Frame.depth
    alpha_threshold: float = ALPHA_THRESHOLD
    transmittance_min: float = TRANSMITTANCE_MIN
    float64: bool = False  # work in float64 throughout; only the reference can

    def __post_init__(self) -> None:
        if not 0 <= self.sh_degree <= SH_DEGREE_MAX:
            raise ParamsError(f"sh_degree: expected 0 to {SH_DEGREE_MAX}, got {self.sh_degree}")
        for name in ("alpha_threshold", "transmittance_min"):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0 <= value < 1):
                raise ParamsError(f"{name}: expected 0 <= value < 1, got {value}")


IDEAL = RenderParams(alpha_threshold=0.0, transmittance_min=0.0, float64=True)
"""The true value of the model: float64, no alpha threshold, no early stop."""
