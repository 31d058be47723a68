"""Scenes and cameras that are hard, small enough to be drawn in milliseconds.

Unless said otherwise the camera stands at the origin and looks along +z with a focal length of
100 px. :mod:`tsplat.testing.stiff` says why each is hard and what must hold.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsplat.core.camera import Camera, look_at
from tsplat.core.constants import ALPHA_THRESHOLD, SH_C0
from tsplat.core.params import RenderParams
from tsplat.core.types import F32, I32, Scene
from tsplat.io import load_scene, scene_from_arrays
from tsplat.testing.oracle import contract_depth, harmonics

Made = tuple[Scene, Camera, RenderParams]
FOCAL = 100.0
PLAIN = RenderParams()
WITH_DEPTH = RenderParams(depth=True)
SUBNORMAL = 1e-40
"""float32 holds it, with a few bits only."""


def _camera(
    width: int = 48, height: int = 48, fx: float = FOCAL, fy: float | None = None, **more: Any
) -> Camera:
    k = np.array([[fx, 0, width / 2], [0, fy or fx, height / 2], [0, 0, 1]])
    return Camera(np.eye(4), k, width, height, **more)


def _colors(n: int) -> NDArray[np.float64]:
    """[n, 3] neighbours differ much, so that a wrong order shows."""
    return np.random.default_rng(n).uniform(0, 1, (n, 3))


def _scene(
    means: ArrayLike, *, scales: ArrayLike = 0.1, quats: ArrayLike = (1, 0, 0, 0),
    opacities: ArrayLike = 0.5, sh: ArrayLike | None = None, numbers: I32 | None = None,
) -> Scene:  # fmt: skip
    """Rows are repeated; scales [N] are round. The bits of float32 arrays are kept."""
    with np.errstate(under="ignore"):  # subnormal on purpose
        centres = np.array(means, np.float32, order="C").reshape(-1, 3)
    n = len(centres)
    scales = np.asarray(scales)
    if scales.ndim == 1 and len(scales) == n:
        scales = scales[:, None]

    def rows(values: ArrayLike, *shape: int) -> F32:
        with np.errstate(under="ignore"):
            narrow = np.asarray(values, np.float32)
        return np.ascontiguousarray(np.broadcast_to(narrow, (n, *shape)))

    if sh is None:
        sh = ((_colors(n) - 0.5) / SH_C0)[:, None]
    coefficients = np.asarray(sh)
    return Scene(
        centres, rows(quats, 4), rows(scales, 3), rows(opacities),
        rows(coefficients, *coefficients.shape[1:]), numbers=numbers,
    )  # fmt: skip


def _around(axis: ArrayLike, angle: ArrayLike) -> NDArray[np.float64]:
    """Quaternions [N, 4] that turn by ``angle`` [N] about ``axis`` [3] of unit length."""
    half = np.atleast_1d(np.asarray(angle, np.float64)) / 2
    return np.column_stack([np.cos(half), np.sin(half)[:, None] * np.asarray(axis)])


def _times(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternion products [N, 4]: first q, then p."""
    (a, b, c, d), (w, x, y, z) = p.T, q.T
    return np.stack([
        a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w,
    ], 1)  # fmt: skip


def _unit(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Quaternions of any direction."""
    quats = rng.normal(size=(n, 4))
    return np.asarray(quats / np.linalg.norm(quats, axis=1, keepdims=True))


def _strewn(n: int, seed: int = 1, z: float = 5.0, spread: float = 1.0) -> NDArray[np.float64]:
    """Means [n, 3] in the picture, ``z`` and a bit away."""
    rng = np.random.default_rng(seed)
    return rng.uniform([-spread, -spread, z], [spread, spread, 1.2 * z], (n, 3))


# --- shapes ----------------------------------------------------------------------------------


def needles(ratio: float, length: float) -> Made:
    """24 in the picture's plane at even angles, 24 at any; standard deviation ``length`` px."""
    n, z = 24, 10.0
    rng = np.random.default_rng(3)
    means = rng.uniform([-2, -2, z], [2, 2, z + 1], (2 * n, 3))
    quats = np.concatenate([_around((0, 0, 1), np.arange(n) * np.pi / n), _unit(rng, n)])
    long = length * z / FOCAL
    return _scene(means, scales=[long, long / ratio, long / ratio], quats=quats), _camera(), PLAIN


FAR_OPACITY = 0.3


def far_needles(distance: float) -> Made:
    """24 across the picture whose middles are ``distance`` px away from it."""
    n, z = 24, 10.0
    angle = np.arange(n) * 2 * np.pi / n + 0.01
    out = distance * z / FOCAL
    means = np.stack([out * np.cos(angle), out * np.sin(angle), z + np.arange(n) / n], 1)
    means[:, :2] *= means[:, 2:] / z
    scene = _scene(
        means, scales=[2 * out, 0.02, 0.02], quats=_around((0, 0, 1), angle),
        opacities=FAR_OPACITY,
    )  # fmt: skip
    return scene, _camera(), PLAIN


def discs() -> Made:
    """30 seen from the side, exactly and but for a little tilt, at even angles."""
    n = 30
    tilt = np.resize([0, 1e-8, 1e-6, 1e-4, 1e-2], n)
    upright = _around((1, 0, 0), np.pi / 2 + tilt)
    quats = _times(_around((0, 0, 1), np.arange(n) * np.pi / n), upright)
    means = _strewn(n, z=10, spread=2)
    means[:6, :2] = 0  # on the axis, where the line of sight lies in the disc
    return _scene(means, scales=[1, 1, 1e-7], quats=quats), _camera(), PLAIN


def sizes() -> Made:
    """One of every power of ten from 1e-12 to 1e6."""
    scales = np.logspace(-12, 6, 19)
    return _scene(_strewn(19), scales=scales, opacities=0.2), _camera(), WITH_DEPTH


def largest() -> Made:
    """As large as may be drawn, in the picture and a billion px beside it, and a little larger."""
    px = 5 / FOCAL  # world units at z = 5
    round_, long = [7e8] * 3, [9.9e8, 0.5, 0.5]
    scales = px * np.array([round_, long, round_, [2e8] * 3, [7.2e8] * 3, [1.01e9, 0.5, 0.5]])
    x = px * np.array([0, 3, 1e9, -3e8, 0, 0])
    means = np.column_stack([x, -0.2 * x, np.full(6, 5.0)])
    quats = _around((0, 0, 1), [0, 1, 0, 0, 0, 1])
    return _scene(means, scales=scales, quats=quats, opacities=0.4), _camera(), PLAIN


def giant() -> Made:
    """Around the camera: middles beside it, ahead of it and behind it; and small ones within."""
    means = [[0, 0, 1], [0, 0, 0.02], [300, -200, 5], [0, 0, 0], [0, 0, -1], *_strewn(20)]
    scales = [1000.0, 50, 400, 1000, 1000] + [0.1] * 20
    quats = _unit(np.random.default_rng(7), 25)
    sh = np.random.default_rng(8).normal(0, 0.4, (25, 4, 3))
    scene = _scene(means, scales=scales, quats=quats, opacities=[0.4] * 5 + [0.8] * 20, sh=sh)
    return scene, _camera(), WITH_DEPTH


def antialiased() -> Made:
    """Points, needles and discs thinner than a pixel, which grow fainter."""
    rng = np.random.default_rng(9)
    points, others = [[0] * 3, [1e-12] * 3, [1e-3] * 3], [[1, 1e-3, 1e-3], [1, 1, 1e-7], [9, 0, 0]]
    scales = np.repeat(np.array(points + others), 5, axis=0)
    scene = _scene(_strewn(30), scales=scales, quats=_unit(rng, 30), opacities=0.9)
    return scene, _camera(), RenderParams(antialias=True)


# --- places ----------------------------------------------------------------------------------


def near_plane() -> Made:
    """On the planes, one float32 to either side, and behind the camera; on and off the axis.

    All that is not to be drawn is opaque and as large as the picture.
    """
    near, far = np.float32(0.01), np.float32(100)
    outside = [near, np.nextafter(near, np.float32(0)), near / 2, 0, -near, -1, far, 2 * far]
    inside = [np.nextafter(near, np.float32(1)), 2 * near, np.nextafter(far, np.float32(0))]
    means, scales, opacities = [], [], []
    for slope in (0.0, 3.0, 50.0):
        for z in (*outside, *inside):
            means.append([slope * abs(z), -0.5 * slope * abs(z), z])
            scales.append(abs(z) * (0.03 + 0.5 * slope) if z in inside else 10 * abs(z) + 1)
            opacities.append(0.3 if z in inside else 1.0)
    camera = _camera(near=float(near), far=float(far))
    return _scene(means, scales=scales, opacities=opacities), camera, PLAIN


def turned_near_plane(drawn: bool) -> Made:
    """A single Gaussian by one float64 in front of the near plane of a turned camera, or on it.

    The means are such that z = r . d summed from the other end, or fused, is one float64 less
    where it is to be drawn, and one more where it is not.
    """
    mean = [-0.16, 0.332, 0.33] if drawn else [-0.168, 0.335, 0.331]
    scene = _scene([mean], scales=0.05, opacities=0.9)
    view = np.eye(4)
    view[:3, :3] = np.array([[2, -1, 2], [2, 2, -1], [-1, 2, 2]]) / 3
    camera = replace(_camera(), viewmat=view)
    z = float(contract_depth(scene, camera)[0])
    return scene, replace(camera, near=math.nextafter(z, 0) if drawn else z), PLAIN


def beyond_float32() -> Made:
    """Too large, too far out or too near, among some that are none of it."""
    means = [[0, 0, 1], [0, 0, 1], [3e38, 0, 1], [0, -3e38, 5], [1e-3, 0, 1e-30], *_strewn(9)]
    scales = [1e12, 3e38, 1, 1e30, 1, *[0.1] * 9]
    return _scene(means, scales=scales), _camera(near=1e-35), PLAIN


def far_out(shift: float, bits: int) -> Made:
    """Depths up to the end of float32, and ``shift`` beyond; ``far`` is infinite."""
    z = np.array([1.0, 1e10, 1e20, 8e30, 9e30, 1.1e31, 1e38, 3e38])
    means = np.column_stack([0 * z, 0 * z, z])
    view = np.eye(4)
    view[2, 3] = shift
    camera = replace(_camera(far=math.inf), viewmat=view)
    return (
        _scene(means, scales=0.03 * z, opacities=0.3),
        camera,
        replace(WITH_DEPTH, depth_bits=bits),
    )


def georeferenced() -> Made:
    """200 in metres of a national grid, a few metres from the camera."""
    base = np.array([1e7 + 0.1, -2.3e7, 5e6 + 0.7])
    rng = np.random.default_rng(11)
    scene = scene_from_arrays(
        base + rng.uniform(-1, 1, (200, 3)), _unit(rng, 200), np.exp(rng.normal(-3, 1, (200, 3))),
        rng.uniform(0.1, 1, 200), rng.normal(0, 0.4, (200, 4, 3)),
    )  # fmt: skip
    eye = base + np.array([0.5, -1.2, -3.3])
    return scene, look_at(eye, base, (0, -1, 0), 40, 48, 48), PLAIN


def telephoto(focal: float, distance: float, turned: bool = False) -> Made:
    """40 that fill the picture at ``distance``, perhaps askew to the world's axes."""
    means = _strewn(40, z=distance, spread=20 * distance / focal)
    camera = _camera(fx=focal, far=1e300)
    if turned:
        k, camera = camera.K, look_at((0, 0, 0), (3, -1, 2), (0.1, -1, 0.2), 50, 48, 48)
        means = means @ camera.rotation
        camera = replace(camera, K=k)
    return _scene(means, scales=2 * distance / focal), camera, PLAIN


def pinhole(focal: float) -> Made:
    """Everything falls on one spot, but for what is more than sideways."""
    means = _strewn(40)
    means[::4, :2] *= min(100 / focal, 1e30)  # so far off the axis that they are apart still
    return _scene(means, opacities=0.2), _camera(fx=focal), PLAIN


def picture(width: int, height: int) -> Made:
    """60 strewn over a picture of any shape, half of them less than a pixel wide."""
    rng = np.random.default_rng(12)
    z = rng.uniform(4, 6, 60)
    x, y = (rng.uniform(-0.5, 0.5, 60) * size * z / FOCAL for size in (width, height))
    scales = np.exp(rng.uniform(-7, 0, (60, 3)))
    scene = _scene(np.stack([x, y, z], 1), scales=scales, opacities=1)
    return scene, _camera(width, height), PLAIN


def off_centre() -> Made:
    """The optical axis meets the image plane far outside the picture."""
    scene, camera, params = picture(48, 48)
    k = camera.K.copy()
    k[:2, 2] = -500, 700
    shift = (24 - k[:2, 2]) * scene.means[:, 2:] / FOCAL
    moved = np.column_stack([scene.means[:, :2] + shift, scene.means[:, 2]])
    return replace(scene, means=moved.astype(np.float32)), replace(camera, K=k), params


def oblong_pixels() -> Made:
    """Pixels some 700 times as high as wide."""
    scene, camera, params = picture(48, 48)
    k = camera.K.copy()
    k[0, 0], k[1, 1] = 2000.0, 3.0
    moved = scene.means * np.array([FOCAL / 2000, FOCAL / 3, 1], np.float32)
    return replace(scene, means=moved), replace(camera, K=k), params


# --- order -----------------------------------------------------------------------------------


def equal_depths() -> Made:
    """3,000 at one depth, their rows in another order than their numbers."""
    rng = np.random.default_rng(13)
    means = rng.uniform([-1.5, -1.5, 5], [1.5, 1.5, 5], (3000, 3))
    numbers = rng.permutation(3000).astype(np.int32)
    return _scene(means, opacities=0.6, numbers=numbers), _camera(20, 20), PLAIN


def crowd() -> Made:
    """3,000 as large as half the picture at five depths, a float32 apart."""
    rng = np.random.default_rng(20)
    z = (np.float32(5).view(np.int32) + rng.integers(0, 5, 3000, np.int32)).view(np.float32)
    means = np.column_stack([rng.uniform(-1.5, 1.5, (3000, 2)).astype(np.float32), z])
    numbers = rng.permutation(3000).astype(np.int32)
    scene = _scene(means, scales=0.5, opacities=0.5, numbers=numbers)
    return scene, _camera(64, 64), WITH_DEPTH


def depths_by_one_ulp() -> Made:
    """500 a float32 apart in the scene, and half of that from the camera: pairs tie."""
    rng = np.random.default_rng(14)
    z = (np.float32(5).view(np.int32) + rng.permutation(500).astype(np.int32)).view(np.float32)
    means = np.column_stack([rng.uniform(-1.5, 1.5, (500, 2)).astype(np.float32), z])
    view = np.eye(4)
    view[2, 3] = 4
    camera = replace(_camera(20, 20), viewmat=view)
    return _scene(means, scales=0.2, opacities=0.6), camera, WITH_DEPTH


# --- opacity ---------------------------------------------------------------------------------


def opaque_layers() -> Made:
    """10,000 of opacity 1 behind one another."""
    z = np.random.default_rng(15).uniform(4, 6, 10_000)
    means = np.column_stack([0 * z, 0 * z, z])
    return _scene(means, scales=0.2, opacities=1.0), _camera(3, 3), WITH_DEPTH


def _layers(n: int, opacity: float) -> Scene:
    z = np.random.default_rng(16).uniform(4, 6, n)
    return _scene(np.column_stack([0 * z, 0 * z, z]), scales=100, opacities=opacity)


def faint_layers() -> Made:
    """100,000 of an alpha 0.2 % above the threshold."""
    return _layers(100_000, 1.002 * ALPHA_THRESHOLD), _camera(3, 2), PLAIN


def endless_layers() -> Made:
    """5,000 of alpha 0.03 and no stop: what is left of the light is 1e-66."""
    return _layers(5_000, 0.03), _camera(3, 2), RenderParams(transmittance_min=0.0)


def logits() -> Made:
    """Read from a file: logits and log-scales from one end of float32 to the other."""
    most = np.finfo(np.float32).max
    opacity = [math.inf, -math.inf, 0, 30, -30, 90, -90, most, -most, 1e-45, math.nan, 2]
    scale = [-2, -2, -math.inf, -most, -110, -90, -2, -2, -2, 0, -2, -50]
    columns: dict[str, Any] = {
        "x": np.linspace(-1, 1, 12), "y": np.linspace(-1, 1, 12)[::-1], "z": [5.0] * 12,
        "opacity": opacity, **{f"scale_{i}": scale for i in range(3)},
        **{f"f_dc_{i}": _colors(12)[:, i] for i in range(3)},
        **{f"rot_{i}": [float(i == 0)] * 12 for i in range(4)},
    }  # fmt: skip
    return _from_ply(columns), _camera(), PLAIN


def _from_ply(columns: dict[str, Any]) -> Scene:
    rows = np.stack([np.asarray(c, "<f4") for c in columns.values()], 1)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    head += [f"property float {name}" for name in columns] + ["end_header", ""]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "stiff.ply")
        path.write_bytes("\n".join(head).encode() + rows.tobytes())
        return load_scene(path)


def at_the_threshold() -> Made:
    """Points on pixel centres with opacities about 1/255: those of a float32 or two, and 0.1 %."""
    least = np.float32(ALPHA_THRESHOLD)  # rounded up: the first that is drawn
    below = np.nextafter(least, np.float32(0))
    above = np.nextafter(least, np.float32(1))
    lower = np.nextafter(below, np.float32(0))
    opacities = [least, below, above, lower, 0.999 * below, 1.001 * above]
    x, y = np.meshgrid([-20.5, 0.5, 19.5], [-10.5, 10.5])
    means = np.column_stack([x.ravel() / 16, y.ravel() / 16, np.full(6, 4.0)])  # exact
    return _scene(means, scales=0, opacities=opacities), _camera(64, 64, 64.0), PLAIN


# --- colours ---------------------------------------------------------------------------------


def _sh(n: int, size: float) -> NDArray[np.float64]:
    return np.random.default_rng(17).normal(0, size, (n, 16, 3))


def overflowing_colors() -> Made:
    """Five of 20 have coefficients that float32 holds, but not what they sum to."""
    sh = _sh(20, 0.3)
    sh[:5] = 3e38
    sh[1, ::2] *= -1
    sh[2, 1:] = 0
    sh[3, :15] = 0
    sh[4, :, 1:] = 0
    scene = scene_from_arrays(
        _strewn(20).astype(np.float32), [[1, 0, 0, 0]] * 20, np.full((20, 3), 0.1),
        np.full(20, 0.7), sh.astype(np.float32),
    )  # fmt: skip
    return scene, _camera(), PLAIN


BRIGHT = 1e36


def bright_colors() -> Made:
    """Coefficients near the largest that are drawn."""
    return _scene(_strewn(20), sh=_sh(20, BRIGHT / 10), opacities=0.7), _camera(), PLAIN


CANCELLING = 100.0


def cancelling_colors() -> Made:
    """Terms of about CANCELLING that sum to a colour between 0 and 1."""
    means, sh = _strewn(40).astype(np.float32), _sh(40, CANCELLING)
    d = means.astype(np.float64)
    basis = harmonics(d / np.linalg.norm(d, axis=1, keepdims=True), 3)
    rest = (basis[:, 1:, None] * sh[:, 1:]).sum(1)
    sh[:, 0] = (_colors(40) - 0.5 - rest) / SH_C0
    return _scene(means, sh=sh, opacities=0.9), _camera(), PLAIN


# --- what comes in ---------------------------------------------------------------------------


def quaternions() -> Made:
    """A quaternion of every length, three of none."""
    rng = np.random.default_rng(18)
    lengths = [1e-320, 1e-300, 1e-45, 1e-30, 1e-3, 3, 1e3, 1e30, 1e38, 1e300]
    quats = _unit(rng, 14)
    with np.errstate(under="ignore"):  # subnormal on purpose
        quats[:10] *= np.array(lengths)[:, None]
    quats[10:] = np.array([[0.0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1], [1, 1e-200, 0, 0]])
    scene = scene_from_arrays(
        _strewn(14).astype(np.float32), quats, np.tile([0.3, 0.05, 0.01], (14, 1)),
        np.full(14, 0.7), _colors(14),
    )  # fmt: skip
    return scene, _camera(), PLAIN


def bad_fields() -> Made:
    """NaN, both infinities and what is out of range in each field in turn; four rows are good."""
    any_: Any = math.nan, math.inf, -math.inf
    bad: dict[str, Any] = {
        "means": any_, "quats": any_, "scales": (*any_, -0.1),
        "opacities": (math.nan, math.inf, -0.5, 1.5), "sh": any_,
    }  # fmt: skip
    n = 4 + sum(map(len, bad.values()))
    arrays: dict[str, Any] = {
        "means": _strewn(n), "quats": np.tile([1.0, 0, 0, 0], (n, 1)),
        "scales": np.full((n, 3), 0.2), "opacities": np.full((n, 1), 0.7),
        "sh": np.random.default_rng(19).normal(0, 0.3, (n, 12)),
    }  # fmt: skip
    row = 4
    for name, values in bad.items():
        for value in values:
            arrays[name][row, row % arrays[name].shape[1]] = value
            row += 1
    shapes = {
        **{name: array.shape for name, array in arrays.items()},
        "opacities": n,
        "sh": (n, 4, 3),
    }
    fields: dict[str, Any] = {k: v.reshape(shapes[k]).astype(np.float32) for k, v in arrays.items()}
    return scene_from_arrays(**fields), _camera(), PLAIN


def subnormal_world() -> Made:
    """A whole scene of 1e-40 units across."""
    means = _strewn(30) * SUBNORMAL / 5
    scene = _scene(means, scales=np.linspace(0.01, 0.1, 30) * SUBNORMAL)
    return scene, _camera(near=1e-44), WITH_DEPTH


def subnormal_fields() -> Made:
    """Subnormal float32s in every field but the depth."""
    means = _strewn(30)
    means[:10, :2] = SUBNORMAL
    scales = np.full((30, 3), 0.1)
    scales[::3], scales[1::3, 0] = SUBNORMAL, 1e-45
    quats = np.tile([1.0, SUBNORMAL, -SUBNORMAL, 1e-45], (30, 1))
    opacities = np.resize([0.5, SUBNORMAL, 1e-45, 0.3], 30)
    sh = np.full((30, 16, 3), SUBNORMAL)
    sh[:, 1] = 0.5
    return _scene(means, scales=scales, quats=quats, opacities=opacities, sh=sh), _camera(), PLAIN
