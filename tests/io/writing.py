"""Scenes to write, and what files hold by decoders that are not tsplat's.

INRIA's PLY is read by plyfile, .splat by a few lines here, compressed PLY and SPZ by gsply.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st
from plyfile import PlyData

from tsplat.core.types import Scene
from tsplat.io.write.base import Written

SH_C0 = 0.28209479177387814
ROWS = (1, 2, 3, 17, 255, 256, 257, 700)
FORMATS = ("ply", "compressed.ply", "splat", "spz")


@dataclass
class Decoded:
    """What a file holds: logarithms and 0..1, rows as they stand there."""

    means: np.ndarray
    quats: np.ndarray  # w, x, y, z
    logs: np.ndarray
    opacities: np.ndarray
    sh: np.ndarray  # [n, K, 3]


def drawn(n, degree, seed, spread=3.0, wild=0.05):
    """A scene of ``n``; a share ``wild`` of each field's numbers are at some end of the range."""
    rng = np.random.default_rng(seed)

    def some(values, *ends):
        """``values`` with some of them at ``ends``."""
        chosen = rng.random(values.shape) < wild
        return np.where(chosen, rng.choice(np.array(ends), values.shape), values).astype(np.float32)

    quats = rng.normal(size=(n, 4))
    odd = rng.random(n) < 4 * wild
    ends = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1], [1, -1, 1, 1], [1e-4, 1, 1, 0]])
    quats[odd] = ends[rng.integers(0, len(ends), int(odd.sum()))]
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = rng.normal(0, 0.3, (n, (degree + 1) ** 2, 3))
    sh[:, 0] *= 4
    return Scene(
        some(rng.normal(0, spread, (n, 3)), 0, 20 * spread, -30 * spread),
        np.ascontiguousarray(quats, np.float32),
        some(np.exp(rng.uniform(-9, 1, (n, 3))), 0, 1e-7, 30, 1e4),
        some(rng.random(n), 0, 1, 1 / 255, 1e-6, 1 - 1e-6),
        some(sh, 0, 0.999, -1, 5, -6),
    )


scenes = st.builds(
    drawn,
    st.sampled_from(ROWS),
    st.integers(0, 3),
    st.integers(0, 10_000),
    st.sampled_from([1e-3, 3.0, 50.0]),
    st.sampled_from([0.0, 0.05, 0.5]),
)


def _columns(vertex, *names):
    return np.stack([vertex[name] for name in names], 1)


def by_plyfile(path):
    vertex = PlyData.read(str(path))["vertex"]
    rest = sum(p.name.startswith("f_rest_") for p in vertex.properties) // 3
    sh = [_columns(vertex, "f_dc_0", "f_dc_1", "f_dc_2")[:, None]]
    if rest:
        names = [[f"f_rest_{c * rest + k}" for c in range(3)] for k in range(rest)]
        sh += [_columns(vertex, *of)[:, None] for of in names]
    logits = vertex["opacity"].astype(np.float64)
    return Decoded(
        _columns(vertex, "x", "y", "z"),
        _columns(vertex, "rot_0", "rot_1", "rot_2", "rot_3"),
        _columns(vertex, "scale_0", "scale_1", "scale_2"),
        1 / (1 + np.exp(-logits)),
        np.concatenate(sh, 1),
    )


def by_hand(path):
    """antimatter15's main.js: (byte - 128) / 128 of a quaternion, not normalised."""
    raw = path.read_bytes()
    floats = np.frombuffer(raw, "<f4").reshape(-1, 8)
    small = np.frombuffer(raw, np.uint8).reshape(-1, 32)[:, 24:].astype(np.float64)
    with np.errstate(divide="ignore"):
        logs = np.log(floats[:, 3:6].astype(np.float64))
    colors = (small[:, :3] / 255 - 0.5) / SH_C0
    quats = (small[:, 4:] - 128) / 128
    return Decoded(floats[:, :3], quats, logs, small[:, 3] / 255, colors[:, None])


def by_gsply(path):
    """SPZ as it stands in the file (RUB), turned here to a PLY's axes."""
    import gsply

    spz = path.suffix == ".spz"
    found = gsply.read_spz(str(path)) if spz else gsply.plyread(str(path))
    means, quats = np.array(found.means), np.array(found.quats)
    sh = [np.array(found.sh0)[:, None]]
    if found.shN is not None and found.shN.shape[1]:
        sh.append(np.array(found.shN))
    sh = np.concatenate(sh, 1)
    if spz:
        means, quats = means * [1, -1, -1], quats * [1, 1, -1, -1]
        # of y, z, x; xy, yz, zz, xz, xx; ...: how often y and z stand in each
        powers = np.array([0, 1, 1, 0, 1, 2, 0, 1, 0, 1, 2, 1, 1, 0, 1, 0])
        sh = sh * ((-1.0) ** powers[: sh.shape[1]])[None, :, None]
    opacities = 1 / (1 + np.exp(-np.array(found.opacities, np.float64).reshape(-1)))
    return Decoded(means, quats, np.array(found.scales), opacities, sh)


READ = {"ply": by_plyfile, "compressed.ply": by_gsply, "splat": by_hand, "spz": by_gsply}


def within(what, off, bound):
    """``off`` is nowhere more than ``bound``; says where it is."""
    over = np.abs(off) - bound
    worst = int(np.argmax(over)) if np.size(over) else 0
    assert not np.size(over) or np.max(over) <= 0, (
        f"{what}: number {worst} is off by {np.abs(off).flat[worst]:.6g}, "
        f"{np.broadcast_to(bound, np.shape(off)).flat[worst]:.6g} allowed"
    )


def same_sign(quats, wanted):
    """``quats``, each with the sign that brings it nearer to ``wanted``."""
    return quats * np.where((quats * wanted).sum(1) < 0, -1, 1)[:, None]


def logs_of(scene, floor=-105.0):
    with np.errstate(divide="ignore"):
        return np.maximum(np.log(scene.scales.astype(np.float64)), floor)


def check(fmt, scene: Scene, found: Decoded, written: Written, **told):
    """``found`` is ``scene``, rows in the order that the writer says, to the format's last step."""
    order = np.arange(len(scene)) if written.order is None else written.order
    assert sorted(order) == list(range(len(scene)))
    assert len(found.means) == len(scene)
    CHECKS[fmt](replace(scene.take(order)), found, **told)


def check_ply(scene, found):
    """Nothing is rounded but logarithms and logits, to float32."""
    assert np.array_equal(found.means, scene.means)
    assert np.array_equal(found.quats, scene.quats)
    assert np.array_equal(found.sh, scene.sh)
    assert np.isfinite(found.logs).all()
    scales = np.exp(found.logs.astype(np.float64)).astype(np.float32)
    within("scales", scales.astype(np.float64) - scene.scales, 8e-6 * scene.scales)  # 0 stays 0
    within("opacities", found.opacities - scene.opacities, 6e-8)


def check_splat(scene, found):
    assert np.array_equal(found.means, scene.means)
    with np.errstate(divide="ignore"):
        assert np.array_equal(found.logs, np.log(scene.scales.astype(np.float64)))
    within("opacities", found.opacities - scene.opacities, 0.5 / 255 + 1e-9)
    colors = np.clip(0.5 + SH_C0 * scene.sh[:, 0].astype(np.float64), 0, 1)
    within("colours", 0.5 + SH_C0 * found.sh[:, 0] - colors, 0.5 / 255 + 1e-9)
    within("quats", same_sign(found.quats, scene.quats) - scene.quats, 0.5 / 128 + 1e-7)


def _per_chunk(values):
    """[n, 3] the width of each number's chunk of 256."""
    starts = np.arange(0, len(values), 256)
    width = np.maximum.reduceat(values, starts) - np.minimum.reduceat(values, starts)
    return width.repeat(256, 0)[: len(values)]


def check_compressed(scene, found):
    steps = np.array([2047, 1023, 2047])
    room = 1 + 1e-3
    rounding = 2.0**-22 * np.abs(scene.means).max()
    wide = scene.means.astype(np.float64)
    within("means", found.means - wide, _per_chunk(wide) / steps / 2 * room + rounding)
    logs = logs_of(scene)
    chunk_max = np.maximum.reduceat(logs, np.arange(0, len(logs), 256)).repeat(256, 0)[: len(logs)]
    logs = np.maximum(logs, chunk_max - 20)
    within("scales", found.logs - logs, _per_chunk(logs) / steps / 2 * room + 2e-5)
    quats = same_sign(found.quats / np.linalg.norm(found.quats, axis=1)[:, None], scene.quats)
    off = np.abs(quats - scene.quats)
    within("quats", np.sort(off, 1)[:, :3], math.sqrt(2) / 1023 / 2 * 1.05)
    within("quats, the largest", off.max(1), math.sqrt(2) / 1023 * 3)
    inside = (scene.opacities > 0.5 / 255) & (scene.opacities < 1 - 0.5 / 255)
    slack = np.where(inside, 1e-6, 2e-3)  # gsply keeps logits finite
    within("opacities", found.opacities - scene.opacities, 0.5 / 255 + slack)
    colors = 0.5 + SH_C0 * scene.sh[:, 0].astype(np.float64)
    bound = _per_chunk(colors) / 255 / 2 * room + 1e-6
    within("colours", 0.5 + SH_C0 * found.sh[:, 0] - colors, bound)
    assert found.sh.shape == scene.sh.shape
    within("sh", found.sh[:, 1:] - np.clip(scene.sh[:, 1:], -4, 4), 1 / 64 + 1e-5)


def check_spz(scene, found, version=3, fraction=12, sh_bits=(5, 4)):
    within("means", found.means - scene.means.astype(np.float64), 2.0 ** -(fraction + 1) + 1e-9)
    within("scales", found.logs - np.clip(logs_of(scene), -10, 255 / 16 - 10), 1 / 32 + 1e-5)
    within("opacities", found.opacities - scene.opacities, 0.5 / 255 + 2e-3)
    base = np.clip(scene.sh[:, 0].astype(np.float64), -0.5 / 0.15, 0.5 / 0.15)
    within("colours", found.sh[:, 0] - base, 0.5 / 255 / 0.15 + 1e-5)
    quats = same_sign(found.quats / np.linalg.norm(found.quats, axis=1)[:, None], scene.quats)
    off = np.abs(quats - scene.quats)
    if version > 2:
        within("quats", np.sort(off, 1)[:, :3], math.sqrt(0.5) / 511 / 2 * 1.05)
        within("quats, the largest", off.max(1), math.sqrt(0.5) / 511 * 3)
    else:  # w follows from three components of half a step of 1/127.5 each: 3.3 degrees and more
        within("quats", np.sqrt((off * off).sum(1)), 0.063)
    assert found.sh.shape == scene.sh.shape
    for bands, bits in ((slice(1, 4), sh_bits[0]), (slice(4, None), sh_bits[1])):
        wanted = np.clip(scene.sh[:, bands].astype(np.float64), -1, 1)
        within("sh", found.sh[:, bands] - wanted, max(2.0**-bits, 1 / 128) + 1e-6)


CHECKS = {
    "ply": check_ply, "compressed.ply": check_compressed, "splat": check_splat, "spz": check_spz,
}  # fmt: skip
