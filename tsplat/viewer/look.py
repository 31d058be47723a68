"""Everything about a picture that can be set while one looks at it, but for where the camera is."""

from __future__ import annotations

from dataclasses import dataclass

from tsplat.core.params import CONTRACT, RenderParams
from tsplat.edits import NOTHING, Edits

FPS = 30.0


@dataclass(frozen=True)
class Look:
    """Settings; a change makes another one."""

    params: RenderParams = CONTRACT
    edits: Edits = NOTHING
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    backend: str = "auto"
    threads: int | None = None  # None: every CPU
    presenter: str = "auto"
    fps: float = FPS
    max_rate: float | None = None  # bits/s; None: what the link takes
    move_speed: float = 1.0  # times the usual
    turn_speed: float = 1.0
    zoom_speed: float = 1.0
    picture: tuple[int, int] | None = None  # px of one that is kept; None: as many as on the screen
