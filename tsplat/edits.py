"""Changes to a scene that are made for looking at it: it is drawn as if its file had been so.

An edit makes another scene of Gaussians that are as good as the first one's: every backend draws
it, and the contract says what the picture is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from tsplat.core.errors import ParamsError, SceneError
from tsplat.core.types import F32, F64, Scene
from tsplat.io.clean import SH_MAX

Bools = np.ndarray[tuple[int], np.dtype[np.bool_]]

LUMA = np.array([0.2126, 0.7152, 0.0722])
"""Shares of red, green and blue in what is seen as brightness (ITU-R BT.709-6, item 3.2)."""

ROWS = 1 << 16  # Gaussians whose colours are mixed at a time


@dataclass(frozen=True)
class Box:
    """Upright in the world's axes; both corners are in it."""

    low: tuple[float, float, float]  # world units
    high: tuple[float, float, float]

    def __post_init__(self) -> None:
        for axis, low, high in zip("xyz", self.low, self.high, strict=True):
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise ParamsError(f"crop: expected {axis} from low to high, got {low} to {high}")


LIMITS = {
    "splat_scale": 100.0, "saturation": 10.0, "min_opacity": 1.0, "max_scale": 1e38, "trim": 49.0,
}  # fmt: skip
"""The largest value of each number."""


@dataclass(frozen=True)
class Edits:
    """What is changed; the defaults change nothing.

    Raises:
        ParamsError: a value outside its range.
    """

    splat_scale: float = 1.0  # times every Gaussian's standard deviations
    min_opacity: float = 0.0  # Gaussians of less opacity are not drawn
    max_scale: float | None = None  # nor those with a larger standard deviation, world units
    trim: float = 0.0  # nor those before this percentile of x, y or z, or as far behind
    saturation: float = 1.0  # of all colours; 0 is grey
    raw_opacity: bool = False  # the file's opacities were 0..1 and not logits after all
    crop: Box | None = None  # Gaussians whose mean is outside are not drawn

    def __post_init__(self) -> None:
        for name, most in LIMITS.items():
            value = getattr(self, name)
            if value is not None and not 0 <= value <= most:
                raise ParamsError(f"{name}: expected 0 to {most:g}, got {value}")

    def text(self) -> str:
        """What is changed, as ``name=value`` words; nothing for nothing."""
        changed = [f.name for f in fields(self) if getattr(self, f.name) != f.default]
        words = []
        for name in changed:
            value = getattr(self, name)
            words.append(
                name if value is True else "crop" if name == "crop" else f"{name}={value:g}"
            )
        return ",".join(words)


NOTHING = Edits()


def edited(scene: Scene, edits: Edits) -> Scene:
    """``scene`` with ``edits`` made to it; itself if there are none.

    Rows stay in their places: what is not drawn has opacity 0, which no backend draws. Opacities
    that were clipped to 0..1 by a sigmoid are known to 2^-24 of 1, so an opacity near 1 that is
    taken back through it (``raw_opacity``) is above 1 there and clipped again.
    """
    if edits == NOTHING:
        return scene
    return _made(scene, edits, cut(scene, edits)[0])


def _made(scene: Scene, edits: Edits, drawn: Bools) -> Scene:
    opacities = _opacities(scene, edits)
    scales = scene.scales
    if edits.splat_scale != 1:
        with np.errstate(over="ignore"):
            scales = np.minimum(scales * np.float32(edits.splat_scale), np.finfo(np.float32).max)
    made = replace(
        scene,
        opacities=np.where(drawn, opacities, np.float32(0)),
        scales=np.ascontiguousarray(scales),
    )
    return made if edits.saturation == 1 else _saturated(made, edits.saturation)


def nothing_left(scene: Scene, edits: Edits) -> SceneError:
    """What to raise where ``edits`` leave no Gaussian of ``scene``."""
    return SceneError(
        f"{scene.name}: nothing is left of {len(scene)} Gaussians ({edits.text()}); filter less"
    )


def filtered(scene: Scene, edits: Edits) -> Scene:
    """The picture of :func:`edited`, of a scene that has no rows that are not drawn.

    ``Scene.dropped`` says how many each edit leaves out; of those that several do, the first.

    Raises:
        SceneError: nothing is left.
    """
    left, dropped = cut(scene, edits)
    if left.all():
        return scene if edits == NOTHING else _made(scene, edits, left)
    if not left.any():
        raise nothing_left(scene, edits)
    made = _made(scene, edits, left).take(left)
    return replace(made, dropped={**scene.dropped, **dropped})


def cut(scene: Scene, edits: Edits) -> tuple[Bools, dict[str, int]]:
    """[N] which Gaussians are left, and how many of the others are cut by which edit.

    Of those that several cut, the first counts.
    """
    left, counts = np.ones(len(scene), bool), {}
    for reason, kept in _keeps(scene, edits).items():
        if count := int(np.count_nonzero(left & ~kept)):
            counts[reason] = count
        left &= kept
    return left, counts


def _keeps(scene: Scene, edits: Edits) -> dict[str, Bools]:
    """[N] which Gaussians each edit leaves in, by why it leaves out the others."""
    keeps: dict[str, Bools] = {}
    if edits.crop is not None:
        keeps["outside --crop"] = _inside(scene, edits.crop)
    if edits.trim > 0:
        keeps[f"outside --trim {edits.trim:g}"] = _within(scene, edits.trim)
    if edits.max_scale is not None:
        keeps[f"above --max-scale {edits.max_scale:g}"] = scene.scales.max(
            axis=1, initial=0
        ) <= np.float32(edits.max_scale)
    if edits.min_opacity > 0:
        keeps[f"below --min-opacity {edits.min_opacity:g}"] = _opacities(
            scene, edits
        ) >= np.float32(edits.min_opacity)
    return keeps


def _opacities(scene: Scene, edits: Edits) -> F32:
    return _logits(scene.opacities) if edits.raw_opacity else scene.opacities


def _within(scene: Scene, trim: float) -> Bools:
    """Means between the percentiles ``trim`` and 100 - ``trim`` of each axis."""
    inside = np.ones(len(scene), bool)
    for along in scene.means.T:
        low, high = np.percentile(along, (trim, 100 - trim))
        inside &= (along >= low) & (along <= high)
    return inside


def _logits(opacities: F32) -> F32:
    """What a sigmoid makes ``opacities`` of, kept to 0..1."""
    wide = opacities.astype(np.float64)
    with np.errstate(divide="ignore"):
        logits = np.log(wide) - np.log1p(-wide)
    return np.asarray(np.clip(logits, 0, 1), np.float32)


def _inside(scene: Scene, crop: Box) -> Bools:
    low: F64 = np.asarray(crop.low, np.float64) - scene.origin
    high: F64 = np.asarray(crop.high, np.float64) - scene.origin
    inside = np.ones(len(scene), bool)
    for axis in range(3):
        along = scene.means[:, axis]
        inside &= (along >= low[axis]) & (along <= high[axis])
    return inside


def _saturated(scene: Scene, factor: float) -> Scene:
    """Colours are linear in the coefficients and grey is 0.5 of each channel: so mix those.

    Where a channel falls below 0 it is 0, as ever: the mix is of what it would have been.
    """
    mix = (factor * np.eye(3) + (1 - factor) * LUMA).T.astype(np.float32)  # row by row: rgb @ mix
    sh = np.empty(scene.sh.shape, np.float32)
    for start in range(0, len(sh), ROWS):
        part = slice(start, start + ROWS)
        with np.errstate(over="ignore"):  # and is clipped
            np.matmul(scene.sh[part].astype(np.float32), mix, out=sh[part])
    np.clip(sh, -SH_MAX, SH_MAX, out=sh)
    grown = float(np.abs(mix).sum(axis=0).max())
    return replace(scene, sh=sh, sh_error=scene.sh_error * grown)
