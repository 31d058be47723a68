"""Named scenes that are hard for a renderer, and what it must make of them all the same.

``stiff_checks(backend)`` has one check for each; :mod:`tsplat.testing.oracle` knows the answers.
In every case nothing may be NaN or infinite, transmittance stays in 0..1, no warning is given, and
no channel of a pixel is farther off than ``bound``; pixels that sit on a threshold may flip, but
must be few, as in :mod:`tsplat.testing.compare`. docs/stability.md has the figures.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any

import numpy as np

from tsplat.core.camera import Camera
from tsplat.core.errors import CameraError
from tsplat.core.params import RenderParams
from tsplat.core.stages import Backend, Stages
from tsplat.core.types import Frame, Scene
from tsplat.core.workspace import Workspace
from tsplat.io import clean
from tsplat.plugins import load_backend
from tsplat.testing import stiff_scenes as scenes
from tsplat.testing.checks import Case, Check, Verdict, pipeline, require, run_stages
from tsplat.testing.compare import CROSSING, TOLERANCE, Comparison, compare_frames
from tsplat.testing.oracle import Oracle, draw


@dataclass(frozen=True, eq=False)
class Stiff:
    """A hard scene, and what must hold."""

    name: str
    why: str  # it is hard
    make: Callable[[], tuple[Scene, Camera, RenderParams]]
    bound: float = TOLERANCE  # largest error of a channel, outside pixels on a threshold
    bound_why: str = ""  # it is not 1e-4
    crossing: float = CROSSING  # relative distance from a threshold within which pixels may flip
    dropped: Mapping[str, int] = field(default_factory=dict)  # what the loader must leave out

    def __str__(self) -> str:
        return self.name.replace(" ", "-")


@dataclass(frozen=True, eq=False)
class Refusal:
    """A camera that no picture can be made with."""

    name: str
    make: Callable[[], Camera]  # raises CameraError
    words: str  # its text has these

    def __str__(self) -> str:
        return self.name.replace(" ", "-")


# A float32 is off by 2^-24 of itself at most. At D px from the middle of a needle, which is s px
# wide, the two terms of w = u11 dx + u12 dy are D / (2 s) at most, and cancel. Six roundings enter:
# of u11, u12, a factor of both, dx, dy, and a product. s is sqrt(0.3) at least; exp(-w^2 / 2)
# changes by 0.61 of what w does at most, and by w of itself, which is 3.0 on the threshold.
_W = 6 * 2.0**-24 / (2 * 0.3**0.5)
_FAR = "that far from a needle's middle, rounding its factor to float32 moves it by so much"


def _far(distance: int) -> Stiff:
    return Stiff(
        f"needles whose middle is {distance:,} px away",
        "A tilt rounded by 1e-7 moves what is seen of it by that much of the distance.",
        partial(scenes.far_needles, float(distance)),
        bound=0.61 * scenes.FAR_OPACITY * _W * distance, bound_why=_FAR,
        crossing=3.0 * _W * distance,
    )  # fmt: skip


CASES: tuple[Stiff, ...] = (
    *(
        Stiff(
            f"needles of 1 to {ratio:.0e}, {length:,.0f} px long".replace("e+0", "e"),
            "The covariance is singular in float32, and a c - b^2 cancels to anything.",
            partial(scenes.needles, ratio, length),
        )
        for ratio, length in ((1e3, 1e2), (1e4, 1e3), (1e5, 1e4), (1e6, 1e5), (1e7, 1e5))
    ),
    _far(5_000),
    _far(20_000),
    Stiff(
        "discs from the side",
        "Without the low-pass filter they have no area; nearly upright, hardly any.",
        scenes.discs,
    ),
    Stiff(
        "scales from 1e-12 to 1e6",
        "One formula for a point and for what is a million times as large as the picture.",
        scenes.sizes,
    ),
    Stiff(
        "the largest that are drawn",
        "Boxes of 3e9 px do not fit into an int32, and variances are at their limit of 1e18.",
        scenes.largest,
    ),
    Stiff(
        "camera within giants",
        "Their middles are nearly in the camera, where the projection has a pole, or behind it.",
        scenes.giant,
    ),
    Stiff(
        "antialiased points, needles and discs",
        "Opacity is multiplied by a quotient of determinants of which one is 0, or nearly.",
        scenes.antialiased,
    ),
    Stiff(
        "on the near and the far plane",
        "A float32 to the wrong side, and an opaque wall covers the picture or a splat is missing.",
        scenes.near_plane,
    ),
    Stiff(
        "one float64 in front of a turned near plane",
        "z is a sum of three products; in another order, or fused, this one is not in front.",
        partial(scenes.turned_near_plane, True),
    ),
    Stiff(
        "exactly on a turned near plane",
        "Likewise: in another order, or fused, it is in front. Nothing is to be seen.",
        partial(scenes.turned_near_plane, False),
    ),
    Stiff(
        "beyond float32",
        "Projected they are infinite, and infinity times 0 is no number. Dropped, and counted.",
        scenes.beyond_float32,
    ),
    Stiff(
        "depths up to 1e31",
        "The far plane is at infinity; no depth may be.",
        partial(scenes.far_out, 0.0, 32),
    ),
    Stiff(
        "depths beyond the end of float32",
        "Up to 4e38, which is infinity, and infinity times 0 no number. Nothing is to be seen.",
        partial(scenes.far_out, 1e38, 32),
    ),
    Stiff(
        "depths of 12 bits up to 1e31",
        "To be rounded they are multiplied by a million, which must not make them infinite.",
        partial(scenes.far_out, 0.0, 12),
    ),
    Stiff(
        "centres at 1e7 m",
        "float32 has steps of a metre there, as large as the scene.",
        scenes.georeferenced,
    ),
    Stiff(
        "focal length of 1e7 px",
        "A direction, or an offset from the camera, rounded to float32 is off by a pixel.",
        partial(scenes.telephoto, 1e7, 1e6, turned=True),
    ),
    Stiff(
        "focal length of 1e24 px",
        "At a distance of 6e30, where Gaussians are 1e7 across and squares of depths infinite.",
        partial(scenes.telephoto, 1e24, 6e30),
    ),
    Stiff(
        "focal length of 1e200 px",
        "Squares of it overflow float64 as well. All are dropped and counted.",
        partial(scenes.pinhole, 1e200),
    ),
    Stiff(
        "focal length of 0.001 px",
        "The whole scene falls on one spot; slopes reach 20,000 and are not clamped.",
        partial(scenes.pinhole, 1e-3),
    ),
    Stiff(
        "focal length of 1e-100 px",
        "Slopes of the picture's edges are 1e101.",
        partial(scenes.pinhole, 1e-100),
    ),
    Stiff(
        "picture of 1x1", "Less than a block, less than a vector.", partial(scenes.picture, 1, 1)
    ),
    Stiff(
        "picture of 1x10000",
        "Slopes and means of thousands, and a picture that no tile fits.",
        partial(scenes.picture, 1, 10_000),
    ),
    Stiff("picture of 10000x1", "The same across.", partial(scenes.picture, 10_000, 1)),
    Stiff(
        "principal point outside the picture",
        "Slopes are clamped beside the picture's borders, not symmetrically about the axis.",
        scenes.off_centre,
    ),
    Stiff(
        "pixels that are not square",
        "Two focal lengths, 2000 and 3 px: nothing that is worked out for one serves both.",
        scenes.oblong_pixels,
    ),
    Stiff(
        "3,000 at equal depth",
        "Only their numbers say which is in front, and rows are in another order.",
        scenes.equal_depths,
    ),
    Stiff(
        "3,000 large ones at five depths",
        "Who cuts a crowded frame into slabs of depth must not cut between equals.",
        scenes.crowd,
    ),
    Stiff(
        "depths by one ulp",
        "Neighbours are half a float32 apart: they tie in pairs if and only if z is rounded once.",
        scenes.depths_by_one_ulp,
    ),
    Stiff(
        "10,000 opaque layers",
        "Each pixel stops within a few, and alpha is held at 0.999.",
        scenes.opaque_layers,
    ),
    Stiff(
        "100,000 faint layers",
        "Pixels stop at the 2,340th, unless each of 2,339 alphas is off by 6e-7 to the same side.",
        scenes.faint_layers,
    ),
    Stiff(
        "5,000 layers without a stop",
        "Transmittance falls below the smallest float32, through those that have few bits.",
        scenes.endless_layers,
    ),
    Stiff(
        "logits at the ends of float32",
        "Infinite logits are 0 and 1, a log-scale of -inf is a point, NaN is dropped.",
        scenes.logits,
        dropped={clean.OPACITY: 1},
    ),
    Stiff(
        "opacities one ulp from 1/255",
        "The test of the threshold is decided by the last bit.",
        scenes.at_the_threshold,
    ),
    Stiff(
        "colours that overflow",
        "Coefficients are finite and their sum is not, or is infinity less infinity. Dropped.",
        scenes.overflowing_colors,
        dropped={clean.SH: 5},
    ),
    Stiff(
        "colours of 1e36",
        "Close to the end of float32, but not beyond.",
        scenes.bright_colors,
        bound=TOLERANCE * scenes.BRIGHT,
        bound_why="1e-4 of such a colour",
    ),
    Stiff(
        "colours that cancel",
        "Sixteen terms of some hundred whose sum is below 1.",
        scenes.cancelling_colors,
        bound=8 * 2.0**-24 * 16 * scenes.CANCELLING,
        bound_why="eight roundings of sixteen terms of a hundred",
    ),
    Stiff(
        "quaternions of any length",
        "Squares of 1e-300 and 1e300 are 0 and infinity. Without a length they are dropped.",
        scenes.quaternions,
        dropped={clean.QUAT: 2, clean.QUAT_ZERO: 1},
    ),
    Stiff(
        "NaN and infinity in each field",
        "One NaN that comes through spreads over all its pixels. All are dropped.",
        scenes.bad_fields,
        dropped={
            clean.MEAN: 3,
            clean.QUAT: 3,
            clean.SCALE: 3,
            clean.SCALE_NEGATIVE: 1,
            clean.OPACITY: 1,
            clean.OPACITY_RANGE: 3,
            clean.SH: 3,
        },
    ),
    Stiff(
        "a world of 1e-40 units",
        "Means, scales and depths are subnormal: squares of them are 0 in float32.",
        scenes.subnormal_world,
    ),
    Stiff(
        "subnormal fields",
        "Numbers below 1e-38 among usual ones; a logarithm of them by bits is wrong.",
        scenes.subnormal_fields,
    ),
)
"""In the order of docs/stability.md."""


@contextmanager
def strict() -> Iterator[None]:
    """Any warning, and anything that NumPy calls an error in arithmetic, is raised."""
    with warnings.catch_warnings(), np.errstate(all="raise"):
        warnings.simplefilter("error")
        yield


@cache
def prepared(case: Stiff) -> tuple[Scene, Camera, RenderParams, Oracle]:
    """Scene, camera, parameters and the right picture of ``case``, made once."""
    with strict():
        scene, camera, params = case.make()
    return scene, camera, params, draw(scene, camera, params)


def check_stiff(stages: Stages, case: Stiff, threads: int = 2) -> Verdict:
    """``stages`` on ``case``: the fused frame, if there is one, and that of the four stages."""
    scene, camera, params, oracle = prepared(case)
    faults: list[str] = []
    if dict(scene.dropped) != dict(case.dropped):
        faults.append(f"dropped: expected {dict(case.dropped)}, got {dict(scene.dropped)}")
    worst: Comparison | None = None
    for way in (stages, replace(stages, fused=None)) if stages.fused else (stages,):
        prefix = "fused: " if way.fused else ""
        try:
            with strict():
                frame, overflowed = _run(way, Case(scene, camera, params, threads))
        except (ArithmeticError, Warning) as error:
            faults.append(f"{prefix}{type(error).__name__}: {error}")
            continue
        found = compare_frames(
            frame, oracle.frame, oracle.margins, case.bound, crossing=case.crossing
        )
        t = frame.transmittance
        if not ((t >= 0) & (t <= 1)).all():
            faults.append(f"{prefix}transmittance outside 0..1: {t.min()} to {t.max()}")
        if overflowed != oracle.overflowed:
            faults.append(
                f"{prefix}overflowed: expected {oracle.overflowed}, got {overflowed} Gaussians"
            )
        faults += [prefix + fault for fault in found.faults]
        if worst is None or found.max_error > worst.max_error:
            worst = found
    return Verdict(case.name, tuple(faults), worst)


def _run(stages: Stages, case: Case) -> tuple[Frame, int]:
    """The picture, and how many Gaussians overflowed."""
    workspace = Workspace(case.threads)
    if stages.fused is not None:
        frame, counts = stages.fused(case.scene, case.camera, case.params, workspace)
        return frame, counts.overflowed
    frame = run_stages(stages, case, workspace)
    project = pipeline(stages)[0]
    return frame, project(case.scene, case.camera, case.params, Workspace(1)).overflowed


def stiff_checks(backend: Backend) -> list[Check]:
    """A check of ``backend`` for every case."""

    def run(case: Stiff) -> None:
        require(check_stiff(load_backend(backend), case), f"backend {backend.name!r}")

    return [Check(str(case), backend.name, partial(run, case)) for case in CASES]


# --- cameras -----------------------------------------------------------------------------------


def _camera(**changes: Any) -> Camera:
    good: dict[str, Any] = {
        "viewmat": np.eye(4), "K": np.array([[50.0, 0, 24], [0, 50, 24], [0, 0, 1]]),
        "width": 48, "height": 48,
    }  # fmt: skip
    return Camera(**{**good, **changes})


def _entry(name: str, row: int, column: int, value: float) -> Callable[[], Camera]:
    """A camera with one number of a matrix changed."""

    def make() -> Camera:
        matrix = np.array(getattr(_camera(), name))
        matrix[row, column] = value
        return _camera(**{name: matrix})

    return make


_NAN, _INF = float("nan"), float("inf")
REFUSALS: tuple[Refusal, ...] = (
    Refusal("reflected viewmat", _entry("viewmat", 0, 0, -1), "got a reflection"),
    Refusal("sheared viewmat", _entry("viewmat", 0, 1, 0.1), "off orthonormal by 0.1"),
    Refusal(
        "scaled viewmat", partial(_camera, viewmat=np.diag([2.0, 2, 2, 1])), "off orthonormal by 3"
    ),
    Refusal("huge viewmat", partial(_camera, viewmat=np.diag([1e200, 1, 1, 1])), "off orthonormal"),
    Refusal(
        "viewmat whose products are not a number",
        partial(
            _camera,
            viewmat=[[1e200, 1e200, 0, 0], [1e200, -1e200, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        ),
        "off orthonormal",
    ),
    Refusal("flat viewmat", _entry("viewmat", 2, 2, 0), "off orthonormal"),
    Refusal("transposed viewmat", _entry("viewmat", 3, 0, 1.5), "as its last row"),
    Refusal("projective viewmat", _entry("viewmat", 3, 3, 2), "as its last row"),
    Refusal("NaN in viewmat", _entry("viewmat", 1, 1, _NAN), "1 of 16 not finite"),
    Refusal("infinite camera position", _entry("viewmat", 0, 3, _INF), "1 of 16 not finite"),
    Refusal("viewmat of 3 x 4", partial(_camera, viewmat=np.eye(3, 4)), "expected 4 x 4"),
    Refusal("skewed K", _entry("K", 0, 1, 0.1), "skew or another last row"),
    Refusal("skew below", _entry("K", 1, 0, 1e-300), "skew or another last row"),
    Refusal("K of another scale", _entry("K", 2, 2, 2), "skew or another last row"),
    Refusal("transposed K", _entry("K", 2, 0, 24), "skew or another last row"),
    Refusal("reflected K", _entry("K", 0, 0, -50), "expected positive focal lengths"),
    Refusal("focal length of 0", _entry("K", 1, 1, 0), "expected positive focal lengths"),
    Refusal("NaN in K", _entry("K", 0, 2, _NAN), "1 of 9 not finite"),
    Refusal("infinite focal length", _entry("K", 0, 0, _INF), "1 of 9 not finite"),
    Refusal("no columns", partial(_camera, width=0), "expected a size"),
    Refusal("negative rows", partial(_camera, height=-48), "expected a size"),
    Refusal(
        "more pixels than memory", partial(_camera, width=2**20, height=2**20), "expected a size"
    ),
    Refusal("near plane at 0", partial(_camera, near=0.0), "expected 0 < near < far"),
    Refusal("near plane behind the far one", partial(_camera, near=2.0, far=1.0), "0 < near < far"),
    Refusal("NaN for the near plane", partial(_camera, near=_NAN), "expected 0 < near < far"),
    Refusal("NaN for the far plane", partial(_camera, far=_NAN), "expected 0 < near < far"),
)
"""Cameras that are refused, and in which words."""


def check_refusal(refusal: Refusal) -> Verdict:
    """Whether the camera is refused, with its reason, and with no warning besides."""
    try:
        with strict():
            refusal.make()
    except CameraError as error:
        if refusal.words in str(error):
            return Verdict(refusal.name, ())
        return Verdict(refusal.name, (f"expected words {refusal.words!r}, got {str(error)!r}",))
    except (ArithmeticError, Warning) as error:
        return Verdict(refusal.name, (f"{type(error).__name__}: {error}",))
    return Verdict(refusal.name, ("it was taken",))
