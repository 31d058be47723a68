"""An independent witness: tsplat's reference against gsplat's published PyTorch code, in float64.

gsplat (https://github.com/nerfstudio-project/gsplat, 1.5.3) has a twin in plain PyTorch beside
each of its CUDA kernels, in ``gsplat/cuda/_torch_impl.py``; it needs no GPU. How to get it:

    pip install -e ".[test,witness]" && pytest tests/witness -s

or, without gsplat, name that one file: ``TSPLAT_GSPLAT=/path/to/_torch_impl.py``. Without torch,
or without either, the module is skipped. With ``-s`` it prints what it measured.

Compared: means, depths, the inverse covariances, the antialias factor, and colours, of every
Gaussian that tsplat's antialiased projection keeps. Not compared: which ones are kept (gsplat cuts
at 3.33 sigma, tsplat where alpha falls below its threshold), and compositing, which gsplat has in
CUDA only.

Two things are given to both alike so that only arithmetic is left: quaternions are of unit length
in float64 (gsplat normalises what it is given, tsplat's loader has done so in float32), and where
digits must cancel in one of the two, exact rational arithmetic says in which.
"""

from __future__ import annotations

import importlib.util
import math
import os
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tsplat.core import reference
from tsplat.core.camera import Camera, look_at
from tsplat.core.params import RenderParams
from tsplat.testing.strategies import make_scene

HOW = "see tests/witness/test_gsplat.py"
torch = pytest.importorskip("torch", reason=f"torch is not installed; {HOW}")

EPS = 2.0**-52
AGREE = 1e-9
PARAMS = RenderParams(float64=True)
N = 1000
SEEDS = range(8)
DISTANCES = 0.5, 2.5, 6.0, 30.0
FOVS = 50.0, 90.0, 20.0, 140.0

SCENES = {
    "random": frozenset(),
    "tiny": frozenset({"tiny"}),
    "giants": frozenset({"giants"}),
    "walls": frozenset({"walls"}),
    "behind": frozenset({"behind"}),
    "discs": frozenset({"discs"}),
    "bright and dark": frozenset({"bright", "dark"}),
    "half": frozenset({"half"}),
    "shuffled": frozenset({"shuffled"}),
}
STIFF = {"needles": frozenset({"needles"}), "threads": frozenset({"threads"})}


def _file():
    """Where gsplat's code is, without importing the package, which would look for CUDA."""
    if path := os.environ.get("TSPLAT_GSPLAT"):
        return Path(path)
    spec = importlib.util.find_spec("gsplat")
    if spec is None:
        pytest.skip(f"gsplat is not installed; {HOW}", allow_module_level=True)
    return Path(spec.submodule_search_locations[0]) / "cuda" / "_torch_impl.py"


def _load(path):
    spec = importlib.util.spec_from_file_location("gsplat_torch_impl", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


gsplat = _load(_file())


def make_case(seed, oddities, unit=True):
    """A scene, and a camera inside or outside it with oblong pixels and an off-centre axis."""
    scene = make_scene(seed, N, seed % 4, oddities)
    if unit:  # float64, which a Scene made by hand would refuse
        quats = scene.quats.astype(np.float64)
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        object.__setattr__(scene, "quats", quats)
    rng = np.random.default_rng(seed + 100)
    direction = rng.normal(size=3)
    eye = scene.origin + DISTANCES[seed % 4] * direction / np.linalg.norm(direction)
    camera = look_at(eye, scene.origin, rng.normal(size=3), FOVS[seed // 2], 640, 400)
    k = camera.K.copy()
    k[:2, 2] += rng.uniform(-0.7, 0.7, 2) * (640, 400)
    k[0, 0] *= rng.uniform(0.5, 2)
    return scene, Camera(camera.viewmat, k, 640, 400)


def tensor(array):
    return torch.from_numpy(np.array(array, np.float64))


@dataclass
class Projected:
    """What is compared, of M Gaussians."""

    means2d: np.ndarray  # [M, 2]  px
    depths: np.ndarray  # [M]
    conics: np.ndarray  # [M, 3]  a, b, c
    compensations: np.ndarray  # [M]
    colors: np.ndarray  # [M, 3]


def ours(scene, camera):
    """tsplat's, and the rows of the scene they are of."""
    splats = reference.project(scene, camera, replace(PARAMS, antialias=True))
    ids = splats.gaussian_ids
    u11, u12, u22 = splats.factors.T
    _, p = reference.camera_space(scene, camera, slice(0, len(scene)))
    assert np.array_equal(splats.depths, p[ids, 2].astype(np.float32))
    return ids, Projected(
        splats.means2d, p[ids, 2], np.stack([u11**2, u11 * u12, u12**2 + u22**2], 1),
        splats.opacities / scene.opacities[ids], splats.colors,
    )  # fmt: skip


def theirs(scene, camera, ids):
    """gsplat's of those rows."""
    means = tensor(scene.means[ids].astype(np.float64) + scene.origin)
    covars, _ = gsplat._quat_scale_to_covar_preci(
        tensor(scene.quats[ids]), tensor(scene.scales[ids]), compute_preci=False
    )
    _, means2d, depths, conics, compensations = gsplat._fully_fused_projection(
        means, covars, tensor(camera.viewmat)[None], tensor(camera.K)[None], camera.width,
        camera.height, near_plane=camera.near, far_plane=camera.far, calc_compensations=True,
    )  # fmt: skip
    sums = gsplat._spherical_harmonics(
        scene.sh_degree, means - tensor(camera.centre), tensor(scene.sh[ids])
    )
    # As gsplat.rendering.rasterization does after it
    colors = torch.clamp_min(sums + 0.5, 0.0)
    return Projected(
        *(a[0].numpy() for a in (means2d, depths, conics, compensations)), colors.numpy()
    )


def length(conics):
    """Frobenius norm of symmetric matrices given as a, b, c."""
    a, b, c = conics.T
    return np.sqrt(a**2 + 2 * b**2 + c**2)


def differences(mine, other):
    """Largest relative difference of each quantity, [M] each."""
    size = np.maximum(abs(other.means2d).max(1), 640)
    brightness = np.maximum(abs(other.colors).max(1), 1)
    return {
        "means2d": abs(mine.means2d - other.means2d).max(1) / size,
        "depths": abs(mine.depths / other.depths - 1),
        "conics": length(mine.conics - other.conics) / length(other.conics),
        "compensations": abs(mine.compensations - other.compensations),
        "colors": abs(mine.colors - other.colors).max(1) / brightness,
    }


def measured(name, oddities, unit=True):
    """The largest differences over all seeds; printed."""
    worst, count = {}, 0
    for seed in SEEDS:
        scene, camera = make_case(seed, oddities, unit)
        ids, mine = ours(scene, camera)
        count += len(ids)
        for key, values in differences(mine, theirs(scene, camera, ids)).items():
            worst[key] = max(worst.get(key, 0.0), float(values.max(initial=0)))
    assert count > 500
    figures = ", ".join(f"{key} {value:.1e}" for key, value in worst.items())
    print(f"\n{name}, {count} splats: {figures}")
    return worst


@pytest.mark.parametrize("name", SCENES)
def test_both_say_the_same(name):
    """Means, depths, conics, antialias factors and colours agree to 1e-9."""
    for quantity, difference in measured(name, SCENES[name]).items():
        assert difference < AGREE, quantity


@pytest.mark.parametrize(
    ("number", "value", "quantity"),
    [
        ("EPS2D", 0.3000001, "conics"),
        ("CLAMP_MARGIN", 0.300001, "conics"),
        ("SH_C1", 0.488602, "colors"),
        ("SH_C2", (1.092548, -1.0925484, 0.31539156, -1.0925484, 0.5462742), "colors"),
    ],
)
def test_a_number_a_little_off_would_be_noticed(monkeypatch, number, value, quantity):
    """The same comparison, one constant changed from the sixth digit on."""
    monkeypatch.setattr(reference, number, value)
    assert measured(f"{number} = {value}", frozenset())[quantity] > 10 * AGREE


def test_gsplats_quaternions_are_normalised_once_more():
    """float32 quaternions are off unit length by 1e-7; so much, and no more, is the difference.

    Both variances of a Gaussian scale by the square of that, and a disc's thin one suffers most.
    """
    scene, _ = make_case(0, frozenset(), unit=False)
    off = abs(np.linalg.norm(scene.quats.astype(np.float64), axis=1) - 1).max()
    assert 1e-8 < off < 1.2e-7
    worst = measured("float32 quaternions", frozenset(), unit=False)
    assert AGREE < worst["conics"] < 1e-6
    assert AGREE < worst["compensations"] < 1e-6
    assert max(worst[key] for key in ("means2d", "depths", "colors")) < AGREE


# --- where digits cancel


def exact(scene, camera, row):
    """Conic and compensation of one Gaussian, rational to the last step: rules 1 to 4 and 7."""
    w, x, y, z = map(Fraction, scene.quats[row].tolist())
    s = 2 / (w * w + x * x + y * y + z * z)
    turn = [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]
    scales = [Fraction(v) for v in scene.scales[row].tolist()]
    view = [[Fraction(v) for v in line] for line in camera.viewmat.tolist()]
    places = zip(scene.means[row].tolist(), scene.origin.tolist(), strict=True)
    mean = [Fraction(a) + Fraction(b) for a, b in places]
    px, py, pz = (sum(r * m for r, m in zip(line, mean, strict=False)) + line[3]
                  for line in view[:3])  # fmt: skip
    axes = [[sum(view[i][j] * turn[j][k] for j in range(3)) * scales[k] for k in range(3)]
            for i in range(3)]  # fmt: skip
    rows = []
    for i, p, size in ((0, px, camera.width), (1, py, camera.height)):
        f, c = Fraction(float(camera.K[i, i])), Fraction(float(camera.K[i, 2]))
        margin = Fraction(0.3) * size / (2 * f)
        slope = min(max(p / pz, -c / f - margin), (size - c) / f + margin)
        rows.append([f / pz * (axes[i][k] - slope * axes[2][k]) for k in range(3)])
    a, b, c = (sum(p * q for p, q in zip(rows[i], rows[j], strict=True))
               for i, j in ((0, 0), (0, 1), (1, 1)))  # fmt: skip
    sharp = a * c - b * b
    a, c = a + Fraction(0.3), c + Fraction(0.3)
    det = a * c - b * b
    return np.array([float(v / det) for v in (c, -b, a)]), math.sqrt(sharp / det)


def off(projected, k, conic, compensation):
    """How far Gaussian ``k`` is from the exact one: the conic relatively, the factor absolutely."""
    apart = length(projected.conics[k : k + 1] - conic) / length(conic[None])
    return float(apart[0]), abs(float(projected.compensations[k]) - compensation)


@pytest.mark.parametrize("name", STIFF)
def test_where_they_differ_tsplat_is_the_nearer(name):
    """A needle's covariance has lost its width when it is multiplied out; its factor has not.

    The Gaussians on which the two differ most are worked out exactly: tsplat is within 1e-12 of
    that, gsplat as far off as the two are apart. All else agrees.
    """
    worst = measured(name, STIFF[name])
    assert max(worst[key] for key in ("means2d", "depths", "colors")) < AGREE
    mine_off, other_off = np.zeros(2), np.zeros(2)
    for seed in SEEDS:
        scene, camera = make_case(seed, STIFF[name])
        ids, mine = ours(scene, camera)
        other = theirs(scene, camera, ids)
        apart = differences(mine, other)
        for quantity in ("conics", "compensations"):
            for k in np.argsort(apart[quantity])[-10:]:
                truth = exact(scene, camera, ids[k])
                mine_off = np.maximum(mine_off, off(mine, k, *truth))
                other_off = np.maximum(other_off, off(other, k, *truth))
    figures = " and ".join("{:.1e} {:.1e}".format(*pair) for pair in (mine_off, other_off))
    print(f"{name}, conics and compensations off the exact ones, tsplat and gsplat: {figures}")
    assert mine_off.max() < 1e-12
    assert other_off == pytest.approx([worst["conics"], worst["compensations"]], rel=0.01)


def test_the_arbiter_says_what_both_say():
    """On a scene that is not stiff."""
    scene, camera = make_case(2, frozenset())
    ids, mine = ours(scene, camera)
    other = theirs(scene, camera, ids)
    for k in range(0, len(ids), 40):
        truth = exact(scene, camera, ids[k])
        assert max(*off(mine, k, *truth), *off(other, k, *truth)) < 1e-12


def test_a_million_units_away_they_differ_by_what_float64_holds_there():
    """gsplat adds R mean and t, which are of size 1e6; tsplat takes the camera's place off first.

    Depths differ by no more than such sums must; colours, which depend on directions only, agree.
    """
    worst = measured("far origin", frozenset({"far origin"}))
    assert worst["colors"] < AGREE
    farthest = 0.0
    for seed in SEEDS:
        scene, camera = make_case(seed, frozenset({"far origin"}))
        ids, mine = ours(scene, camera)
        apart = abs(mine.depths - theirs(scene, camera, ids).depths)
        spacing = EPS * abs(scene.origin).max()  # of float64 there, world units
        farthest = max(farthest, float((apart / spacing).max(initial=0)))
    print(f"far origin, depths apart: {farthest:.1f} roundings of a coordinate")
    assert 0.5 < farthest < 8
