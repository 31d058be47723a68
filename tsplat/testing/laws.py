"""What every right picture obeys, whatever made it: laws that need no second renderer.

Each law takes a backend's stages and a drawn example, makes two or more pictures that the contract
(docs/contract.md) ties to one another, and returns what is wrong::

    @pytest.mark.parametrize("check", law_checks(MY_BACKEND), ids=str)
    def test_laws(check):
        check()

Compared: pictures of one backend with each other. The reference says only which pixels sit on a
threshold (its margins) and in which order Gaussians lie. A fused path is used where there is one;
that it has the bits of the four stages is part of the law ``bits``.

Where two pictures are of the same thing, each may be TOLERANCE off the contract's picture, and so
they may be twice that apart; where margins are below CROSSING each may flip. Scenes are moved by
amounts that float32 and float64 hold exactly (half turns, whole shifts of the origin, powers of
two), so that nothing else is rounded; where that cannot be, the law derives what rounding does.
Not compared: bits, but where the contract promises them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from tsplat.core import reference
from tsplat.core.camera import Camera, look_at
from tsplat.core.constants import (
    ALPHA_MAX,
    ALPHA_THRESHOLD,
    CLAMP_MARGIN,
    SH_C0,
)
from tsplat.core.params import RenderParams
from tsplat.core.stages import Backend, Stages
from tsplat.core.types import F64, Bins, Floats, Frame, Scene
from tsplat.core.workspace import Workspace
from tsplat.plugins import load_backend
from tsplat.testing.checks import Case, Verdict, pipeline, run_stages
from tsplat.testing.compare import CROSSING, TOLERANCE, compare_frames
from tsplat.testing.conformance import Check, require
from tsplat.testing.strategies import cameras, make_scene, params, scenes

SIDE = 24
"""px; pictures are no larger, but for those that a law enlarges."""

HALF_TURNS = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))
"""Diagonals of the rotations that only change signs: exact in any arithmetic."""

_GENERIC = np.array([[0.48, 0.6, 0.64]])
"""A unit direction at which no harmonic is 0."""


# Scenes and cameras, changed without rounding


def flipped(scene: Scene, signs: ArrayLike) -> Scene:
    """The scene with its axes multiplied by ``signs`` [3] (1 or -1): turned, or mirrored.

    With D = diag(signs), a covariance R S S R^T becomes (D R D) S S (D R D)^T, since D S S D is
    S S. D and -D do the same to R, one of them is a half turn, and its quaternion takes i, j and k
    to themselves or their opposites. So nothing is rounded, not even where a quaternion's length
    is. Every harmonic is even or odd in each of x, y and z.
    """
    d = np.asarray(signs, np.float32)
    degree = scene.sh_degree
    parity = np.sign(
        reference.sh_basis(_GENERIC * d, degree) * reference.sh_basis(_GENERIC, degree)
    )
    return replace(
        scene,
        means=scene.means * d,
        quats=scene.quats * np.append(np.float32(1), d * d.prod()),
        sh=scene.sh * parity.reshape(-1, 1).astype(scene.sh.dtype),
        origin=scene.origin * d.astype(np.float64),
    )


def moved(camera: Camera, turn: F64, shift: F64) -> Camera:
    """The camera carried along when the world is turned by ``turn`` [3, 3], then shifted [3]."""
    viewmat = np.eye(4)
    viewmat[:3, :3] = camera.rotation @ turn.T
    viewmat[:3, 3] = -viewmat[:3, :3] @ (turn @ camera.centre + shift)
    return replace(camera, viewmat=viewmat)


def joined(scene: Scene, more: Scene, rng: np.random.Generator) -> Scene:
    """``scene`` with the rows of ``more`` put in anywhere; its own keep their order."""
    n, m = len(scene), len(more)
    numbers = scene.numbers
    if numbers is not None:
        last = int(numbers.max(initial=-1))
        numbers = np.concatenate([numbers, last + 1 + np.arange(m)]).astype(np.int32)
    places = np.concatenate([np.arange(n), rng.integers(0, n + 1, m) - 0.5])
    both = replace(
        scene,
        means=np.concatenate([scene.means, more.means]),
        quats=np.concatenate([scene.quats, more.quats]),
        scales=np.concatenate([scene.scales, more.scales]),
        opacities=np.concatenate([scene.opacities, more.opacities]),
        sh=np.concatenate([scene.sh, more.sh]),
        numbers=numbers,
    )
    return both.take(np.argsort(places, kind="stable"))


def placed(
    scene: Scene, camera: Camera, pixels: ArrayLike, depths: ArrayLike, scales: ArrayLike,
    opacities: ArrayLike, color: ArrayLike = (1.0, 1.0, 1.0),
) -> Scene:  # fmt: skip
    """Balls that would join ``scene``: at ``pixels`` [M, 2] and ``depths`` [M] of ``camera``.

    ``scales`` and ``opacities`` [M]; ``color`` [3] from all sides. Depths may be negative.
    """
    z = np.atleast_1d(np.asarray(depths, np.float64))
    m = len(z)
    k = camera.K
    slopes = (np.broadcast_to(pixels, (m, 2)) - k[:2, 2]) / np.diag(k)[:2]
    p = np.concatenate([slopes, np.ones((m, 1))], 1) * z[:, None]
    sh = np.zeros((m, *scene.sh.shape[1:]), scene.sh.dtype)
    sh[:, 0] = (np.asarray(color) - 0.5) / SH_C0
    return Scene(
        (p @ camera.rotation + (camera.centre - scene.origin)).astype(np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (m, 1)),
        np.repeat(np.broadcast_to(scales, m).astype(np.float32)[:, None], 3, axis=1),
        np.broadcast_to(opacities, m).astype(np.float32),
        sh,
        scene.origin,
    )


def camera_depths(scene: Scene, camera: Camera) -> F64:
    """Camera z [N] as the contract evaluates it; as float32 it orders the Gaussians."""
    return reference.camera_space(scene, camera, slice(0, len(scene)))[1][:, 2]


def sh_rotation(rotation: F64, degree: int) -> F64:
    """[K, K]: what coefficients are multiplied by when their Gaussian is turned by ``rotation``.

    Y(R v) = M Y(v) for every direction v, and M, which is orthogonal, is solved for from samples of
    the basis: colours stay if Y(R v) . sh' = Y(v) . sh, and so sh' = M sh.
    """
    samples = np.random.default_rng(0).normal(size=(64, 3))
    samples /= np.linalg.norm(samples, axis=1, keepdims=True)
    basis = reference.sh_basis(samples, degree)
    turned = reference.sh_basis(samples @ rotation.T, degree)
    return np.asarray(np.linalg.lstsq(basis, turned, rcond=None)[0].T, np.float64)


# Pictures, and what may lie between two


def picture(
    stages: Stages, case: Case, scene: Scene | None = None, camera: Camera | None = None,
    params: RenderParams | None = None,
) -> Frame:  # fmt: skip
    """The backend's picture of ``case`` with some of it changed, in memory of its own."""
    changed = Case(
        case.scene if scene is None else scene, camera or case.camera, params or case.params
    )
    return run_stages(stages, changed, Workspace(case.threads))


def margins(case: Case, scene: Scene, params: RenderParams | None = None) -> F64:
    """How near each pixel [H, W] of ``scene`` comes to a threshold; see reference.composite."""
    return Case(scene, case.camera, params or case.params).contract[1]


def same_picture(got: Frame, want: Frame, margins: F64, tolerance: float = TOLERANCE) -> list[str]:
    """Faults of two pictures that show the same: see the module about what may lie between."""
    return list(compare_frames(got, want, margins, tolerance, pictures=2).faults)


def same_bits(got: Frame, want: Frame, what: str) -> list[str]:
    """A fault if a bit differs."""
    for name in ("rgb", "transmittance", "depth"):
        a, b = getattr(got, name), getattr(want, name)
        if a is not b and (a is None or b is None or a.tobytes() != b.tobytes()):
            return [f"{what}: Frame.{name} has other bits"]
    return []


def at_most(low: Floats, high: Floats, margins: F64, what: str) -> list[str]:
    """A fault if ``low`` exceeds ``high`` anywhere, by more than two pictures' tolerance.

    Pixels on a threshold are excused; what is not a number is not at most anything.
    """
    excess = np.subtract(low, high, dtype=np.float64)
    if excess.ndim > margins.ndim:
        excess = excess.max(axis=2)
    wrong = ~(excess <= 2 * TOLERANCE) & (margins >= CROSSING)
    if not wrong.any():
        return []
    y, x = np.unravel_index(np.argmax(np.where(wrong, excess, 0)), wrong.shape)
    return [f"{what} at {int(wrong.sum())} pixels; the worst, ({x}, {y}), by {excess[y, x]:.3g}"]


# The laws


def rigid_motion(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Scene and camera turned and shifted together: the same picture.

    Half turns change signs, shifts go into the float64 origin and are whole. What is rounded is
    the camera's centre: by 1e-9 at 1e6 units, and nothing that float32 would show.
    """
    signs = rng.choice(HALF_TURNS)
    shift = np.round(rng.uniform(-1e5, 1e5, 3))
    scene = flipped(case.scene, signs)
    scene = replace(scene, origin=scene.origin + shift)
    camera = moved(case.camera, np.diag(signs).astype(np.float64), shift)
    got = picture(stages, case, scene, camera)
    return same_picture(got, picture(stages, case), case.contract[1])


def mirror(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """The mirrored scene makes the mirrored picture, left to right and top to bottom."""
    axis, camera = int(rng.integers(2)), case.camera
    seen = np.ones(3)
    seen[axis] = -1
    world = -np.asarray(rng.choice(HALF_TURNS), np.float64)  # a reflection as well
    viewmat = np.eye(4)
    viewmat[:3, :3] = seen[:, None] * camera.rotation * world
    viewmat[:3, 3] = seen * camera.viewmat[:3, 3]
    k = camera.K.copy()
    k[axis, 2] = (camera.width, camera.height)[axis] - k[axis, 2]
    mirrored = replace(camera, viewmat=viewmat, K=k)
    got = picture(stages, case, flipped(case.scene, world), mirrored)
    back = Frame(
        np.flip(got.rgb, 1 - axis),
        np.flip(got.transmittance, 1 - axis),
        None if got.depth is None else np.flip(got.depth, 1 - axis),
    )
    return same_picture(back, picture(stages, case), case.contract[1])


def uniform_scale(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Everything that has world units times a power of two: the same picture, depth times it."""
    factor = 2.0 ** int(rng.integers(-8, 9))
    scene, camera = case.scene, case.camera
    viewmat = camera.viewmat.copy()
    viewmat[:3, 3] *= factor
    scaled = replace(
        scene, means=scene.means * np.float32(factor), scales=scene.scales * np.float32(factor),
        origin=scene.origin * factor,
    )  # fmt: skip
    nearer = replace(camera, viewmat=viewmat, near=camera.near * factor, far=camera.far * factor)
    got = picture(stages, case, scaled, nearer)
    if got.depth is not None:
        got = replace(got, depth=got.depth / np.float32(factor))
    return same_picture(got, picture(stages, case), case.contract[1])


def row_order(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Gaussians of distinct depths, however near, in any order of rows: the same picture."""
    n, means = len(case.scene), case.scene.means.copy()
    if n:
        close = rng.random(n) < 0.5
        off = 1e-4 * rng.normal(size=(int(close.sum()), 3))
        means[close] = means[rng.integers(n)] + off.astype(np.float32)
    scene = replace(case.scene, means=means, numbers=None)
    depths = reference.rounded_depths(camera_depths(scene, case.camera), case.params)
    _, distinct = np.unique(depths, return_index=True)
    scene = scene.take(np.sort(distinct))
    got = picture(stages, case, scene.take(rng.permutation(len(scene))))
    return same_picture(got, picture(stages, case, scene), margins(case, scene))


def ties(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Equal depths in any order of rows, with numbers that keep the file's: the same picture."""
    n, means = len(case.scene), case.scene.means.copy()
    if n:
        tied = rng.random(n) < 0.5
        means[tied] = means[rng.integers(n)]  # the same place, each in its own shape and colour
    numbers = case.scene.numbers
    scene = replace(
        case.scene,
        means=means,
        numbers=np.arange(n, dtype=np.int32) if numbers is None else numbers,
    )
    got = picture(stages, case, scene.take(rng.permutation(n)))
    return same_picture(got, picture(stages, case, scene), margins(case, scene))


def invisible(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Gaussians that reach no pixel's centre change no bit, wherever their rows lie.

    Behind the camera, before its near plane, beyond far, below the threshold, beside the picture,
    and between the centres of pixels, where one that barely passes the threshold reaches none.
    """
    m, camera, near = 4, replace(case.camera, far=100.0), case.camera.near
    size = np.array([camera.width, camera.height])
    middle, z = size / 2, rng.uniform(0.5, 5, m) + near
    # A quarter of a px on the image plane: the slopes of J, held within half a picture of the
    # border at most, do not stretch it further. Of opacity 1 it reaches 3.33 sqrt(0.25^2 + 0.3) =
    # 2 px, of 1.02 thresholds sqrt(2 ln 1.02 (0.25^2 + 0.3)) = 0.12 px.
    focal, principal = np.diag(camera.K)[:2], camera.K[:2, 2]
    slopes = (np.maximum(abs(principal), abs(size - principal)) + size / 2) / focal
    quarter = 0.25 * z / (focal.max() * np.sqrt(1 + slopes @ slopes))
    outside = rng.uniform(0, size, (m, 2))
    outside[:, int(rng.integers(2))] = -10 if rng.random() < 0.5 else size.max() + 10
    corners = rng.integers(0, size + 1, (m, 2))  # 0.7 px from the nearest centre
    kinds = (
        placed(case.scene, camera, middle, -z, z, 1.0),
        placed(case.scene, camera, middle, np.linspace(0, 0.99, m) * near, near, 1.0),
        placed(case.scene, camera, middle, 101 + z, 50.0, 1.0),
        placed(case.scene, camera, middle, z, z, ALPHA_THRESHOLD * rng.uniform(0, 0.99, m)),
        placed(case.scene, camera, outside, z, quarter, 1.0),
        placed(case.scene, camera, corners, z, quarter, ALPHA_THRESHOLD * 1.02),
    )
    want = picture(stages, case, camera=camera)
    faults = []
    names = ("behind", "before near", "beyond far", "too faint", "outside", "between pixels")
    for name, more in zip(names, kinds, strict=True):
        got = picture(stages, case, joined(case.scene, more, rng), camera)
        faults += same_bits(got, want, f"with Gaussians {name}")
    return faults


def crop(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """A picture is the part of any larger one whose principal point is shifted by as much.

    The contract's rule 3 holds the slopes of the Jacobian within the picture and a margin, which
    depends on its borders. Only Gaussians whose means lie within are drawn here: for them the
    slopes of the larger picture are the same.
    """
    camera = case.camera
    size = np.array([camera.width, camera.height])
    focal, middle = np.diag(camera.K)[:2], camera.K[:2, 2]
    _, p = reference.camera_space(case.scene, camera, slice(0, len(case.scene)))
    ahead = p[:, 2] > camera.near
    slopes = p[:, :2] / np.where(ahead, p[:, 2], 1)[:, None]
    low, high = -middle / focal, (size - middle) / focal
    margin = (CLAMP_MARGIN - 1e-9) * size / (2 * focal)
    within = ((slopes >= low - margin) & (slopes <= high + margin)).all(axis=1)
    scene = case.scene.take(within & ahead)
    left, top, right, bottom = (int(v) for v in rng.integers(0, SIDE, 4))
    k = camera.K.copy()
    k[:2, 2] += left, top
    width, height = camera.width, camera.height
    large = replace(camera, K=k, width=width + left + right, height=height + top + bottom)
    whole = picture(stages, case, scene, large)
    part = slice(top, top + height), slice(left, left + width)
    got = Frame(
        whole.rgb[part],
        whole.transmittance[part],
        None if whole.depth is None else whole.depth[part],
    )
    return same_picture(got, picture(stages, case, scene), margins(case, scene))


def resolution(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """At twice the resolution and averaged 2x2 a picture changes, and each time a quarter as much.

    A picture of r pixels for one holds point samples of splats that the low-pass filter widens by
    0.3 px^2, which is 0.3 / r^2 of the first picture's: what it adds shrinks with the pixel. So
    does the error of r^2 samples in place of the mean over a pixel. Both are k / r^2 and terms in
    1 / r^4, which are 0.3 / 3^2 as large for splats of 3 px or more. Then D(r), the mean change
    from r to 2 r, falls to 1/4 at each doubling; it would fall to 1/2 for half a pixel's offset.
    The bound is 0.35. Thresholds are set below what shows, for they are steps, which are smooth at
    no resolution.
    """
    base = look_at((0, 0, -6), (0, 0, 0), (0, -1, 0), 50, 12, 12)
    n = int(rng.integers(1, 7))
    scene = make_scene(int(rng.integers(2**32)), n, case.scene.sh_degree, frozenset())
    pixel = (camera_depths(scene, base) / base.K[0, 0])[:, None]
    scales = rng.uniform(3, 6, (n, 3)) * pixel
    opacities = rng.uniform(0.2, 0.8, n)  # 0.2^6 > 1e-6: no pixel stops
    scene = replace(scene, scales=scales.astype(np.float32), opacities=opacities.astype(np.float32))
    fine = replace(case.params, alpha_threshold=1e-6, transmittance_min=1e-6)
    means = []
    for r in (1, 2, 4, 8):
        rgb = picture(stages, case, scene, base.resized(12 * r, 12 * r), fine).rgb
        means.append(rgb.astype(np.float64).reshape(12, r, 12, r, 3).mean(axis=(1, 3)))
    changes = [float(abs(b - a).mean()) for a, b in pairwise(means)]
    # Each picture may be TOLERANCE off, so each change twice that.
    slack = 2 * TOLERANCE * 1.35
    return [
        f"from {2**i} to {2 ** (i + 1)} times the resolution the mean change falls from "
        f"{changes[i - 1]:.3g} to {changes[i]:.3g}, not to 0.35 of it"
        for i in (1, 2)
        if not changes[i] <= 0.35 * changes[i - 1] + slack
    ]


def _split(case: Case, rng: np.random.Generator) -> tuple[Scene, Scene]:
    """The Gaussians nearer than some depth, and the rest, by the contract's order."""
    scene = case.scene
    depths = reference.rounded_depths(camera_depths(scene, case.camera), case.params)
    numbers = np.arange(len(scene)) if scene.numbers is None else scene.numbers
    order = np.lexsort((numbers, depths))
    k = int(rng.integers(len(scene) + 1))
    return scene.take(np.sort(order[:k])), scene.take(np.sort(order[k:]))


def added_behind(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Gaussians added behind all others: T nowhere rises, no channel falls.

    And T stays above 1e-4: a splat that would take it there is not drawn, and that test is exact
    but for the crossing that any test may be off by.
    """
    front, _ = _split(case, rng)
    less, more = picture(stages, case, front), picture(stages, case)
    sure = np.minimum(margins(case, front), case.contract[1])
    faults = at_most(more.transmittance, less.transmittance, sure, "T rises")
    faults += at_most(less.rgb, more.rgb, sure, "a channel falls")
    stop = case.params.transmittance_min
    if not (more.transmittance >= stop * (1 - CROSSING)).all():
        faults.append(f"T falls to {more.transmittance.min():.3g}; pixels stop above {stop:g}")
    return faults


def added_in_front(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Gaussians added in front of all others: T does not rise where no pixel stops.

    A pixel may now stop before a splat that it drew. It was going to take T to 1e-4 or below with
    an alpha of 0.999 at most, so T was 0.1 at most, and stays so: T' <= max(T, 0.1).
    """
    _, back = _split(case, rng)
    less, more = picture(stages, case, back), picture(stages, case)
    sure = np.minimum(margins(case, back), case.contract[1])
    stopped = case.params.transmittance_min / (1 - ALPHA_MAX)
    faults = at_most(more.transmittance, np.maximum(less.transmittance, stopped), sure, "T rises")
    endless = replace(case.params, transmittance_min=0.0)
    less, more = (picture(stages, case, s, params=endless) for s in (back, case.scene))
    sure = margins(case, case.scene, endless)  # all tests of the back are among these
    return faults + at_most(more.transmittance, less.transmittance, sure, "without a stop T rises")


def product(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Without the stop, T of a scene is the product of T of any two parts of it."""
    endless = replace(case.params, transmittance_min=0.0)
    part = rng.random(len(case.scene)) < 0.5
    scenes = (case.scene, case.scene.take(part), case.scene.take(~part))
    frames = [picture(stages, case, scene, params=endless) for scene in scenes]
    whole, a, b = (f.transmittance.astype(np.float64) for f in frames)
    # a b is off by the errors of a and of b, each at most 1: with whole's own, 3 tolerances.
    off = abs(whole - a * b)
    wrong = ~(off <= 3 * TOLERANCE) & (margins(case, case.scene, endless) >= CROSSING)
    return [f"T is off its parts' product by up to {off[wrong].max():.3g}"] if wrong.any() else []


def sh_turns(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Turned by any rotation, coefficients too, the scene looks to a turned camera as before.

    Now means, quaternions and coefficients are rounded to float32 anew. At 2.5 to 9.5 units from
    the camera and 26 px of focal length a mean moves by 2.2e-6 px: 4e-6 of a splat's least
    deviation, 0.55 px. Lengths and directions of quaternions turn a splat of up to 3.2 px (0.3
    units) by 5e-7: at u deviations by 3e-6 u of the least. Antialiasing multiplies opacity by an
    area, which that changes by 3e-6 of itself where no axis is 6 times another.

    Alpha falls with u as exp(-u^2 / 2), so it changes by 0.61 * 4e-6 + 0.74 * 3e-6 = 4.6e-6 at
    most; colours are below 4, and 10 splats change a channel by 1.8e-4, their opacities by 1.2e-5:
    a TOLERANCE for each picture. At the threshold u is 3.33 and alpha changes by 5e-5 of itself.
    T changes by d alpha / (1 - alpha), for opacities of 0.8 at most by 1.2 * 4e-6 + 0.93 * 3e-6 +
    4 * 3e-6 for each of 10 splats, 2e-4 of itself. That is twice CROSSING, and so a pixel is on a
    threshold if its margin is below three times that.
    """
    n, degree = int(rng.integers(1, 11)), int(rng.integers(1, 4))
    scene = make_scene(int(rng.integers(2**32)), n, degree, frozenset())
    scene = replace(
        scene, scales=np.clip(scene.scales, np.float32(0.05), np.float32(0.3)),
        opacities=np.minimum(scene.opacities, np.float32(0.8)),
    )  # fmt: skip
    eye = rng.normal(size=3)
    eye *= 6 / np.linalg.norm(eye)
    camera = look_at(eye, (0, 0, 0), rng.normal(size=3), 50, SIDE, SIDE)
    quat = rng.normal(size=4)
    quat /= np.linalg.norm(quat)
    turn = reference.rotations(quat)
    turned = replace(
        scene,
        means=(scene.means @ turn.T).astype(np.float32),
        quats=_product(quat, scene.quats).astype(np.float32),
        sh=np.ascontiguousarray(
            np.einsum("jk,nkc->njc", sh_rotation(turn, degree), scene.sh), np.float32
        ),
    )
    still = Case(scene, camera, case.params, case.threads)
    got = picture(stages, still, turned, moved(camera, turn, np.zeros(3)))
    want = picture(stages, still)
    return same_picture(got, want, still.contract[1] / 3, tolerance=2 * TOLERANCE)


def _product(a: F64, b: ArrayLike) -> F64:
    """Quaternions [N, 4]: the rotation ``a`` [4] after each of ``b`` [N, 4]."""
    w, x, y, z = a
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(np.asarray(b, np.float64) @ left.T)


def energy(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Antialiased, a Gaussian far below a pixel keeps its energy: 2 pi opacity sqrt(det(A A^T)).

    That is the integral of alpha: of what it is before the low-pass filter, which widens it, and of
    what it is after, because opacity falls by as much. The sum over pixels is that integral on
    average over the places within a pixel: over 2 x 2 of them to exp(-2 pi^2 0.3 4) = 5e-11, since
    filtered variances are 0.3 px^2 or more (Poisson's sum formula). Each of the pixels may be
    TOLERANCE off. The axes on the image plane are found by moving the mean along them.
    """
    size = 12
    camera = look_at((0, 0, -6), (0, 0, 0), (0, -1, 0), 40, size, size)
    camera = moved(camera, reference.rotations(_unit(rng, 4)), rng.uniform(-1, 1, 3))
    z = rng.uniform(3, 9)
    ball = placed(
        make_scene(0, 0, 0, frozenset()), camera, rng.uniform(5.5, 6.5, (1, 2)), z, 1.0, 1.0
    )
    opacity = np.float32(rng.uniform(0.5, 1))
    scales = rng.uniform(0.1, 0.35, (1, 3)) * z / camera.K[0, 0]
    tiny = replace(
        ball, quats=_unit(rng, 4)[None].astype(np.float32), scales=scales.astype(np.float32),
        opacities=np.full(1, opacity),
    )  # fmt: skip
    sharp = replace(case.params, antialias=True, alpha_threshold=0.0)
    axes = reference.rotations(tiny.quats[0]) * tiny.scales[0]
    step = 1e-4  # central differences are off by its square
    ends = tiny.means[0] + step * np.stack([axes.T, -axes.T])  # [2, 3, 3]
    p = (ends - camera.centre) @ camera.rotation.T
    pixels = p[..., :2] / p[..., 2:] * np.diag(camera.K)[:2]
    a = (pixels[0] - pixels[1]).T / (2 * step)  # [2, 3]
    want = 2 * np.pi * float(opacity) * float(np.sqrt(np.linalg.det(a @ a.T)))
    total = 0.0
    for x, y in ((0, 0), (0, 0.5), (0.5, 0), (0.5, 0.5)):
        k = camera.K.copy()
        k[:2, 2] += x, y
        frame = picture(stages, case, tiny, replace(camera, K=k), sharp)
        total += float((1 - frame.transmittance.astype(np.float64)).sum()) / 4
    if abs(total - want) <= size**2 * TOLERANCE:
        return []
    return [f"alphas sum to {total:.4g} px^2, not to {want:.4g}"]


def _unit(rng: np.random.Generator, n: int) -> F64:
    """A random unit vector [n]."""
    v = rng.normal(size=n)
    return np.asarray(v / np.linalg.norm(v), np.float64)


def background(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """A wall behind everything is a background: rgb + 0.999 T color, as Frame.over says.

    The wall's alpha is the cap's 0.999 at every pixel: at 1e5 px of standard deviation
    exp(-sigma) is above 1 - 1e-6 over 40 px. No pixel may stop before it, so the stop is off.
    """
    endless = replace(case.params, transmittance_min=0.0, depth=False)
    camera, color = case.camera, rng.uniform(0, 1, 3)
    z = 2 * max(1.0, camera.near, float(camera_depths(case.scene, camera).max(initial=0)))
    middle = (camera.width / 2, camera.height / 2)
    scale = 1e5 * z / np.diag(camera.K)[:2].min()
    # Its own scene has float32 coefficients, so that its color is not rounded to float16.
    scene = replace(case.scene, sh=case.scene.sh.astype(np.float32))
    wall = placed(scene, camera, middle, z, scale, 1.0, color)
    got = picture(stages, case, joined(scene, wall, rng), params=endless)
    bare = picture(stages, case, scene, params=endless)
    red, green, blue = (float(v) for v in ALPHA_MAX * color)
    want = bare.over((red, green, blue))
    sure = margins(case, scene, endless)
    behind = Frame(got.rgb, got.transmittance - np.float32(1 - ALPHA_MAX) * bare.transmittance)
    return same_picture(behind, want, sure)


def bits(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """The same bits on any number of threads, on every run, and after other pictures.

    And of a fused frame and the four stages.
    """
    want = run_stages(stages, case, Workspace(1))
    some = case.scene.take(rng.permutation(len(case.scene))[: len(case.scene) // 2])
    elsewhere = moved(case.camera, np.diag(HALF_TURNS[1]).astype(np.float64), np.ones(3))
    others = {
        "scene": Case(some, case.camera, case.params),
        "view": Case(case.scene, elsewhere, case.params),
        "size": Case(case.scene, case.camera.resized(31, 9), case.params),
    }
    faults = []
    for threads, (what, other) in zip((1, 2, 5), others.items(), strict=True):
        used = Workspace(threads)
        run_stages(stages, other, used)
        got = run_stages(stages, case, used)
        faults += same_bits(got, want, f"after another {what}, {threads} threads")
        got = run_stages(stages, case, used)
        faults += same_bits(got, want, f"again, {threads} threads")
    if stages.fused is not None:
        apart = run_stages(replace(stages, fused=None), case, Workspace(2))
        faults += same_bits(apart, want, "the four stages")
    return faults


def tiles(stages: Stages, case: Case, rng: np.random.Generator) -> list[str]:
    """Composite makes the same picture of bins of any tile size, and of tiles listed in vain.

    Not the same bits: a backend may work out what it can from the corner of a tile.
    """
    composite, splats, order = pipeline(stages)[3], case.splats, case.order
    want = composite(splats, case.bins, case.params, Workspace(case.threads))
    faults = []
    for size in (8, 32, int(rng.integers(1, 40))):
        bins = reference.bin(splats, order, tile_size=size)
        got = composite(splats, bins, case.params, Workspace(case.threads))
        faults += same_picture(got, want, case.composited[1])
    count = len(case.bins.tile_offsets) - 1
    offsets = np.arange(count + 1, dtype=np.int64) * len(order)
    vain = Bins(offsets, np.tile(order, count), case.bins.tile_size)
    got = composite(splats, vain, case.params, Workspace(case.threads))
    return faults + same_picture(got, want, case.composited[1])


LAWS: dict[str, Callable[[Stages, Case, np.random.Generator], list[str]]] = {
    function.__name__: function
    for function in (
        rigid_motion, mirror, uniform_scale, row_order, ties, invisible, crop, resolution,
        added_behind, added_in_front, product, sh_turns, energy, background, bits, tiles,
    )
}  # fmt: skip
"""Name -> law: faults of a backend's stages on an example, which the law may change at random."""


@st.composite
def views(draw: st.DrawFn) -> Case:
    """Small scenes of all kinds, seen from anywhere in small pictures."""
    scene = draw(scenes(max_gaussians=40))
    camera = draw(cameras(scene, max_size=SIDE))
    return Case(scene, camera, draw(params()), threads=draw(st.sampled_from((1, 2, 3))))


def law_checks(backend: Backend, max_examples: int = 30) -> list[Check]:
    """A check for every law, on drawn examples; stages it does not offer are the reference's."""

    def make(name: str) -> Check:
        @settings(
            max_examples=max_examples,
            deadline=None,
            suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
        )
        @given(case=views(), seed=st.integers(0, 2**32 - 1))
        def run(case: Case, seed: int) -> None:
            note(f"{len(case.scene)} Gaussians, {case.camera}, {case.params}")
            faults = LAWS[name](load_backend(backend), case, np.random.default_rng(seed))
            require(Verdict(name, tuple(faults)), f"backend {backend.name!r}")

        return Check(name, backend.name, run)

    return [make(name) for name in LAWS]
