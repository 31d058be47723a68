"""Writes .splat, .ksplat and compressed PLY, in NumPy and as their own tools do.

Each writer is given the same plain arrays and returns which of them stands where in the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

C0 = 0.28209479177387814
AXES = "xyz"


@dataclass
class Gaussians:
    """What a file is made of, in float64."""

    means: np.ndarray  # [n, 3]
    quats: np.ndarray  # [n, 4] w, x, y, z of length 1
    scales: np.ndarray  # [n, 3] linear
    opacities: np.ndarray  # [n]
    sh: np.ndarray  # [n, K, 3]

    def __len__(self) -> int:
        return len(self.means)

    def take(self, rows) -> Gaussians:
        return Gaussians(*(a[rows] for a in vars(self).values()))


def drawn(n: int, degree: int = 0, seed: int = 0, size: float = 3.0) -> Gaussians:
    """Gaussians as trainers make them; colours may be beyond what a byte holds."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return Gaussians(
        rng.normal(0, size, (n, 3)),
        quats / np.linalg.norm(quats, axis=1)[:, None],
        np.exp(rng.uniform(-9, 1, (n, 3))),
        rng.uniform(0, 1, n),
        rng.normal(0, [[1.0], *[[0.05]] * ((degree + 1) ** 2 - 1)], (n, (degree + 1) ** 2, 3)),
    )


def rgba(g: Gaussians) -> np.ndarray:
    """[n, 4] colours and opacity in 255ths, cut off as JavaScript and NumPy do."""
    color = np.concatenate([0.5 + C0 * g.sh[:, 0], g.opacities[:, None]], 1)
    return np.clip(color * 255, 0, 255).astype(np.uint8)


def write_splat(path: Path, g: Gaussians, trailing: bytes = b"") -> np.ndarray:
    """antimatter15's convert.py without its sorting."""
    rows = np.zeros(len(g), [("f", "<f4", 6), ("rgba", "u1", 4), ("q", "u1", 4)])
    rows["f"] = np.concatenate([g.means, g.scales], 1)
    rows["rgba"] = rgba(g)
    rows["q"] = np.clip(g.quats * 128 + 128, 0, 255).astype(np.uint8)
    path.write_bytes(rows.tobytes() + trailing)
    return np.arange(len(g))


def _banded(sh: np.ndarray, degree: int) -> np.ndarray:
    """[n, 3 (K - 1)] the harmonics behind the first, band by band, channel by channel."""
    bands = [sh[:, d * d : (d + 1) ** 2].transpose(0, 2, 1) for d in range(1, degree + 1)]
    return np.concatenate([b.reshape(len(sh), -1) for b in bands] or [np.empty((len(sh), 0))], 1)


def _buckets(means: np.ndarray, block: float, size: int) -> tuple[list, list, list, list]:
    """Rows and centres of the full buckets, and of the others."""
    low = means.min(0)
    cells = np.floor((means - low) / block)
    _, which = np.unique(cells, axis=0, return_inverse=True)
    which = which.reshape(-1)
    full, other = [], []
    order = np.argsort(which, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(which[order])) + 1):
        for start in range(0, len(rows), size):
            bucket = rows[start : start + size]
            (full if len(bucket) == size else other).append(bucket)
    centers = [low + cells[b[0]] * block + block / 2 for b in [*full, *other]]
    return full, other, [len(b) for b in other], centers


def write_ksplat(
    path: Path,
    sections: list[tuple[Gaussians, int]],
    level: int,
    *,
    block: float = 5.0,
    bucket: int = 256,
    sh_range: tuple[float, float] = (-1.5, 1.5),
    spare: int = 0,
) -> np.ndarray:
    """Gaussians and degree of each section; ``spare`` rows of room behind each but the last.

    Returns rows of all sections' Gaussians put one after the other.
    """
    heads = np.zeros((len(sections), 1024), np.uint8)
    body, rows, total = b"", [], 0
    for index, (g, degree) in enumerate(sections):
        order, lengths, full, centers = np.arange(len(g)), [], [], []
        if level:
            full, other, lengths, centers = _buckets(g.means, block, bucket)
            order = np.concatenate([*full, *other])
        placed = g.take(order)
        room = len(g) + (spare if index < len(sections) - 1 else 0)
        kind = ("<f4", "<f2", "<f2")[level]
        table = np.zeros(
            room,
            [
                ("m", "<u2" if level else "<f4", 3), ("s", kind, 3), ("q", kind, 4),
                ("c", "u1", 4), ("h", ("<f4", "<f2", "u1")[level], 3 * ((degree + 1) ** 2 - 1)),
            ],
        )  # fmt: skip
        here = table[: len(g)]
        here["m"] = placed.means
        if level:
            sizes = [len(b) for b in [*full, *other]]
            centre = np.repeat(np.array(centers, np.float32), sizes, axis=0)
            steps = np.floor((placed.means - centre) * (32767 / (block / 2)) + 0.5) + 32767
            here["m"] = np.clip(steps, 0, 65535)
        with np.errstate(under="ignore", over="ignore"):
            here["s"], here["q"] = placed.scales, placed.quats
        here["c"] = rgba(placed)
        banded = _banded(placed.sh, degree)
        if level == 2:
            low, high = sh_range
            banded = np.clip(
                np.floor((np.clip(banded, low, high) - low) / (high - low) * 255), 0, 255
            )
        here["h"] = banded
        words, halves = heads[index].view("<u4"), heads[index].view("<u2")
        words[0], words[1] = len(g), room
        if level:
            words[2], words[3], halves[10] = bucket, len(centers), 12
            heads[index].view("<f4")[4] = block
            words[6], words[8], words[9] = 32767, len(full), len(lengths)
        halves[20] = degree
        body += np.array(lengths, "<u4").tobytes() + np.array(centers, "<f4").tobytes()
        body += table.tobytes()
        rows.append(total + order)
        total += len(g)
    head = np.zeros(4096, np.uint8)
    head[1] = 1
    head.view("<u4")[1:5] = len(sections), len(sections), total, total
    head.view("<u2")[10] = level
    head.view("<f4")[9:11] = sh_range
    path.write_bytes(head.tobytes() + heads.tobytes() + body)
    return np.concatenate(rows)


def _ends(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[C, 3] the range of each 256 rows, as float32 holds it, and the rows as 0..1 of it."""
    pieces = [values[i : i + 256] for i in range(0, len(values), 256)]
    ends = np.array([[p.min(0), p.max(0)] for p in pieces], np.float32).astype(np.float64)
    low, high = np.repeat(ends, 256, axis=0)[: len(values)].transpose(1, 0, 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        parts = np.where(high > low, (values - low) / (high - low), 0)
    return ends, np.clip(parts, 0, 1)


def _packed(parts: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """[n] parts [n, k] as so many bits each, the first one highest."""
    number = np.zeros(len(parts), np.uint32)
    for column, count in enumerate(bits):
        part = np.floor(parts[:, column] * (2**count - 1) + 0.5)
        number = number << np.uint32(count) | part.astype(np.uint32)
    return number


def _packed_quats(quats: np.ndarray) -> np.ndarray:
    n = len(quats)
    largest = np.abs(quats).argmax(1)
    signed = quats * np.where(quats[np.arange(n), largest] < 0, -1, 1)[:, None]
    rest = signed[np.arange(4) != largest[:, None]].reshape(n, 3)
    number = _packed(np.clip(rest / np.sqrt(2) + 0.5, 0, 1), (10, 10, 10))
    return largest.astype(np.uint32) << np.uint32(30) | number


def write_compressed(
    path: Path,
    g: Gaussians,
    *,
    colors: bool = True,
    comments: int = 0,
    order: tuple[str, ...] = ("chunk", "vertex", "sh"),
    big: bool = False,
) -> np.ndarray:
    """What splat-transform writes, in the order given; without colours by chunk as older tools."""
    end = ">" if big else "<"
    positions, position = _ends(g.means)
    scales, scale = _ends(np.log(g.scales))
    ranges, color = _ends(0.5 + C0 * g.sh[:, 0])
    if not colors:
        color = np.clip(0.5 + C0 * g.sh[:, 0], 0, 1)
    names = [f"{e}_{a}" for e in ("min", "max") for a in AXES]
    names += [f"{e}_scale_{a}" for e in ("min", "max") for a in AXES]
    names += [f"{e}_{a}" for e in ("min", "max") for a in "rgb"] if colors else []
    chunk = np.concatenate(
        [a.reshape(len(a), 6) for a in (positions, scales, *([ranges] if colors else []))], 1
    )
    vertex = np.stack(
        [
            _packed(position, (11, 10, 11)),
            _packed_quats(g.quats),
            _packed(scale, (11, 10, 11)),
            _packed(np.concatenate([color, g.opacities[:, None]], 1), (8, 8, 8, 8)),
        ],
        1,
    )
    rest = g.sh[:, 1:].transpose(0, 2, 1).reshape(len(g), -1)
    sh = np.clip(np.floor((rest / 8 + 0.5) * 256), 0, 255).astype(np.uint8)
    parts = {
        "chunk": (len(chunk), "float", names, chunk.astype(end + "f4").tobytes()),
        "vertex": (
            len(g), "uint", [f"packed_{n}" for n in ("position", "rotation", "scale", "color")],
            vertex.astype(end + "u4").tobytes(),
        ),
        "sh": (len(g), "uchar", [f"f_rest_{i}" for i in range(sh.shape[1])], sh.tobytes()),
    }  # fmt: skip
    lines = ["ply", f"format binary_{'big' if big else 'little'}_endian 1.0"]
    lines += ["comment nothing"] * comments
    body = b""
    for name in order:
        count, kind, properties, content = parts[name]
        if properties:
            lines += [f"element {name} {count}", *(f"property {kind} {p}" for p in properties)]
            body += content
    path.write_bytes("\n".join([*lines, "end_header\n"]).encode() + body)
    return np.arange(len(g))
