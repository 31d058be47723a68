"""What a conversion did: every number of the file read back against the source's, and pictures.

Neither knows the format: the file is read by its reader, drawn by a backend, and compared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tsplat.core.camera import Camera
from tsplat.core.constants import SH_C0
from tsplat.core.errors import OutputError
from tsplat.core.params import RenderParams
from tsplat.core.types import F64, I64, Frame, Scene
from tsplat.io.write.base import logs, parts
from tsplat.io.write.source import Source
from tsplat.plan import make_plan
from tsplat.quality.measure import Error, measure
from tsplat.views import ring

LEVELS = 255

RING = 4
"""Standard views: so many round the scene."""

FROM_FILE = 4
"""And at most so many of the scene's own cameras, evenly among them."""

SIZE = 480, 270


@dataclass(frozen=True)
class FieldError:
    """How far one field of the Gaussians is off."""

    field: str
    unit: str
    worst: float
    rms: float  # of a position the distance, of a rotation the angle, else of each number


UNITS = {
    "position": "world units",
    "scale": "ln",
    "rotation": "degrees",
    "opacity": "0..1",
    "base colour": "0..1",
    "harmonics": "coefficient",
}
"""Fields, and what they are counted in. A scale is compared by its natural logarithm; harmonics are
those of degree 1 and more that the file has."""


def field_errors(source: Source, order: I64 | None, back: Source) -> list[FieldError]:
    """Each field of ``back`` against the Gaussians ``order`` of ``source``.

    Raises:
        OutputError: the file holds another number of Gaussians than was written.
    """
    if len(back) != len(source):
        raise OutputError(
            f"read back, the file holds {len(back)} Gaussians, expected {len(source)}"
        )
    worst = dict.fromkeys(UNITS, 0.0)
    squares = dict.fromkeys(UNITS, 0.0)
    counts = dict.fromkeys(UNITS, 0)
    for part in parts(len(source)):
        for name, off in _offs(source, part if order is None else order[part], back, part).items():
            if off.size:
                worst[name] = max(worst[name], float(off.max()))
                squares[name] += float((off * off).sum())
                counts[name] += off.size
    return [
        FieldError(name, unit, worst[name], math.sqrt(squares[name] / counts[name]))
        for name, unit in UNITS.items()
        if counts[name]
    ]


def _offs(a: Source, rows: slice | I64, b: Source, part: slice) -> dict[str, F64]:
    """What each number of ``rows`` of ``a`` and ``part`` of ``b`` are apart, >= 0."""
    moved = a.means(rows).astype(np.float64) - b.means(part)
    kept = min(a.coefficients, b.coefficients)
    wide = [x.sh(r).astype(np.float64) for x, r in ((a, rows), (b, part))]
    return {
        "position": np.sqrt((moved * moved).sum(1)),
        "scale": np.abs(logs(a.scales(rows)) - logs(b.scales(part))),
        "rotation": angles(a.quats(rows).astype(np.float64), b.quats(part).astype(np.float64)),
        "opacity": np.abs(a.opacities(rows).astype(np.float64) - b.opacities(part)),
        "base colour": SH_C0 * np.abs(wide[0][:, 0] - wide[1][:, 0]),
        "harmonics": np.abs(wide[0][:, 1:kept] - wide[1][:, 1:kept]),
    }


def angles(a: F64, b: F64) -> F64:
    """[n] degrees between rotations of unit quaternions [n, 4], also where they are small.

    The arc between two unit vectors is 2 atan2(|a - b|, |a + b|) (W. Kahan); a rotation turns by
    twice that of its quaternions, the nearer one of q and -q.
    """
    apart = [np.sqrt((d * d).sum(1)) for d in (a - b, a + b)]
    return np.asarray(np.degrees(4 * np.arctan2(np.minimum(*apart), np.maximum(*apart))))


def standard_views(
    scene: Scene, own: Sequence[Camera], size: tuple[int, int] = SIZE
) -> list[Camera]:
    """RING cameras round ``scene`` and up to FROM_FILE of its own, about ``size`` px."""
    width, height = size
    chosen = [own[i * len(own) // FROM_FILE] for i in range(FROM_FILE)] if own else []
    chosen = list(own) if len(own) < FROM_FILE else chosen
    small = []
    for camera in chosen:
        share = math.sqrt(width * height / (camera.width * camera.height))
        small.append(
            camera.resized(
                max(round(camera.width * share), 1), max(round(camera.height * share), 1)
            )
        )
    return [*ring(scene, RING, width, height), *small]


def picture_errors(
    scene: Scene,
    back: Scene,
    cameras: Sequence[Camera],
    *,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Error]:
    """The contract's pictures of ``back`` against those of ``scene``, one of each camera."""
    antialias = bool(scene.antialias)
    pictures: list[list[Frame]] = []
    for i, drawn in enumerate((scene, back)):
        drawn_alike = replace(drawn, antialias=scene.antialias)
        plan = make_plan(
            drawn_alike, backend=backend, threads=threads, params=RenderParams(antialias=antialias)
        )
        pictures.append([])
        for j, camera in enumerate(cameras):
            pictures[-1].append(plan.run(drawn_alike, camera).frame)
            if progress is not None:
                progress(i * len(cameras) + j + 1, 2 * len(cameras))
    return [measure(b, a) for a, b in zip(*pictures, strict=True)]
