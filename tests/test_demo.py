"""The built-in scene: reproducible, well formed, and with the contents that it promises."""

import hashlib

import numpy as np
import pytest

from tsplat.core.reference import rotations, sh_basis
from tsplat.core.types import Scene
from tsplat.demo import demo_camera, demo_scene, light, parts
from tsplat.views import frame_orbit, scene_extent

ARRAYS = ("means", "quats", "scales", "opacities", "sh")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return demo_scene()


def digest(scene: Scene) -> str:
    whole = hashlib.sha256()
    for name in ARRAYS:
        whole.update(getattr(scene, name).tobytes())
    return whole.hexdigest()


def colours(scene: Scene, rows: np.ndarray, eye: list[float]) -> np.ndarray:
    away = scene.means[rows].astype(np.float64) - eye
    basis = sh_basis(away / np.linalg.norm(away, axis=1, keepdims=True), 3)
    return np.clip(0.5 + np.einsum("nk,nkc->nc", basis, scene.sh[rows].astype(np.float64)), 0, 1)


def test_the_same_scene_every_time(scene: Scene) -> None:
    """Two calls give the same bits in every array, whatever NumPy's global generator holds."""
    np.random.seed(1)  # noqa: NPY002 - the legacy state is what must not matter
    assert digest(demo_scene()) == digest(scene)


def test_count(scene: Scene) -> None:
    """There are 80,000 to 150,000 Gaussians, none of them dropped."""
    assert 80_000 <= len(scene) <= 150_000
    assert not scene.dropped


@pytest.mark.parametrize("name", ARRAYS)
def test_finite(scene: Scene, name: str) -> None:
    """Every number in every array is finite."""
    assert np.isfinite(getattr(scene, name)).all()


def test_ranges(scene: Scene) -> None:
    """Quaternions have length 1 within float32's rounding, scales are > 0, opacities in 0..1."""
    assert np.abs(np.linalg.norm(scene.quats.astype(np.float64), axis=1) - 1).max() < 1e-6
    assert scene.scales.min() > 0
    assert scene.opacities.min() > 0
    assert scene.opacities.max() <= 1


def test_harmonics_to_degree_3(scene: Scene) -> None:
    """Room for degree 3 is there, and each degree is used by at least 10,000 Gaussians."""
    assert scene.sh_degree == 3
    for first, last in ((1, 4), (4, 9), (9, 16)):
        used = np.abs(scene.sh[:, first:last]).max(axis=(1, 2)) > 0.01
        assert used.sum() >= 10_000


def test_colours_move_with_the_eye(scene: Scene) -> None:
    """Half-way round the orbit over 5,000 Gaussians change a channel by more than 0.1.

    A quarter of the way round, some change by more than 0.5: these are highlights.
    """
    rows = np.flatnonzero(np.linalg.norm(scene.means, axis=1) < 5)
    front = colours(scene, rows, [-3, -1.5, -5])
    assert (np.abs(front - colours(scene, rows, [3, -1.5, 5])).max(1) > 0.1).sum() > 5_000
    assert np.abs(front - colours(scene, rows, [-5, -1.5, 3])).max() > 0.5


def test_shapes_of_every_kind(scene: Scene) -> None:
    """Needles over 20 times longer than both widths, flat surfels, large soft balls."""
    small, middle, large = np.sort(scene.scales, axis=1).T
    assert (large > 20 * middle).sum() > 1_000
    assert ((middle > 0.99 * large) & (small < 0.2 * large)).sum() > 50_000
    assert ((small > 0.99 * large) & (large > 0.1) & (scene.opacities < 0.25)).sum() > 50


def test_faint_and_opaque(scene: Scene) -> None:
    """Thousands of Gaussians are translucent, most are opaque."""
    assert (scene.opacities < 0.5).sum() > 2_000
    assert np.median(scene.opacities) > 0.9


def test_extent(scene: Scene) -> None:
    """What is framed lies within 0.5 of the origin and within a radius of 2.5 to 3.5.

    Stars and moon are beyond 30, and hold less than 3 % of all opacity.
    """
    extent = scene_extent(scene)
    assert np.linalg.norm(extent.centre) < 0.5
    assert 2.5 < extent.radius < 3.5
    far = np.linalg.norm(scene.means, axis=1) > 10
    assert np.linalg.norm(scene.means[far], axis=1).min() > 30
    assert scene.opacities[far].sum() < 0.03 * scene.opacities.sum()


def test_up_is_negative_y(scene: Scene) -> None:
    """The pink crown is above the ground, the cyan crystals below it: at smaller and larger y."""
    rgb = 0.5 + 0.28209479 * scene.sh[:, 0]
    near = np.linalg.norm(scene.means, axis=1) < 5
    pink = near & (rgb[:, 0] > rgb[:, 1] + 0.25) & (rgb[:, 2] > rgb[:, 1] + 0.1)
    cyan = near & (rgb[:, 2] > rgb[:, 0] + 0.4) & (rgb[:, 1] > rgb[:, 0] + 0.3)
    green = near & (rgb[:, 1] > rgb[:, 0] + 0.04) & (rgb[:, 1] > rgb[:, 2] + 0.1)
    heights = [float(np.median(scene.means[rows, 1])) for rows in (pink, green, cyan)]
    assert heights[0] < -0.8 < heights[1] < 0.2 < heights[2]


def test_the_opal_is_closed(scene: Scene) -> None:
    """Every ray at the opal's face meets surfels that let less than 5 % through, from 6 sides."""
    centre, radius = np.array([-0.98, -0.52, -0.34]), 0.29
    shell = np.abs(np.linalg.norm(scene.means - centre, axis=1) - radius) < 0.01
    rows = np.flatnonzero(shell & (scene.opacities > 0.98))
    assert len(rows) > 2_000
    normals = rotations(scene.quats[rows])[:, :, 2]
    out = (scene.means[rows] - centre) / radius
    assert np.einsum("ni,ni->n", normals, out).min() > 0.99
    rng = np.random.default_rng(0)
    for target in parts.unit(rng.normal(size=(6, 3))) * radius + centre:
        away = ((scene.means[rows] - target) ** 2).sum(1)
        near = rows[away < 0.05**2]
        scale = scene.scales[near].max(1)
        alpha = np.exp(-away[away < 0.05**2] / (2 * scale**2)) * scene.opacities[near]
        assert np.prod(1 - alpha) < 0.05


def test_the_camera_looks_down_at_the_garden() -> None:
    """The picture's camera stands above the water, 5 to 7 from the origin, which it has in view."""
    camera = demo_camera(1280, 720)
    assert camera.centre[1] < -0.5
    assert 5 < np.linalg.norm(camera.centre) < 7
    x, y, z = camera.K @ camera.viewmat[:3, 3]
    assert abs(x / z - 640) < 64
    assert abs(y / z - 360) < 64


def test_the_default_framing_is_near(scene: Scene) -> None:
    """A 120 x 80 terminal shows the island from a distance below 7: strays do not push it away."""
    assert frame_orbit(scene, 120, 80).distance < 7


def test_zonal_is_a_projection() -> None:
    """A cubic of the cosine between view and axis comes back exactly, and so does the mirror."""
    rng = np.random.default_rng(1)
    axis, views = parts.unit(rng.normal(size=(1, 3))), parts.unit(rng.normal(size=(50, 3)))
    sh = light.zonal(axis, lambda c: (1 + 2 * c - 3 * c**3)[:, None] * [1.0, 0.5, -1.0])[0]
    cosine = (views @ axis.T)[:, 0]
    want = (1 + 2 * cosine - 3 * cosine**3)[:, None] * [1.0, 0.5, -1.0]
    assert np.abs(sh_basis(views, 3) @ sh - want).max() < 1e-5
    part = parts.blobs(axis, 0.1, 1.0, sh[None])
    flipped = parts.mirrored(part, 1.0)
    again = sh_basis(views * [1, -1, 1], 3) @ flipped.sh[0]
    assert np.abs(again - want).max() < 1e-5


def test_mirrored_shapes() -> None:
    """A mirrored Gaussian's covariance is its own with y's sign changed."""
    rng = np.random.default_rng(2)
    axes = parts.unit(rng.normal(size=(20, 3)))
    part = parts.gaussians(rng.normal(size=(20, 3)), axes, 0.1, 0.5, 1.0, light.flat([0.2] * 3))
    flipped = parts.mirrored(part, 1.0)
    flip = np.array([1.0, -1.0, 1.0])
    for a, b in ((part, flipped), (flipped, part)):
        spread = [rotations(p.quats) * p.scales[:, None, :] for p in (a, b)]
        one, other = (m @ m.swapaxes(1, 2) for m in spread)
        assert np.abs(other - one * flip[:, None] * flip).max() < 1e-6
