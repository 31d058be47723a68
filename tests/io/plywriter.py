"""Writes every variant of PLY that splat files come in, and decodes the slow, plain way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
LITTLE, BIG, TEXT = "binary_little_endian", "binary_big_endian", "ascii"
FORMATS = (LITTLE, BIG, TEXT)
REST = {0: 0, 1: 9, 2: 24, 3: 45}


@dataclass
class Other:
    """An element that has nothing to do with Gaussians; a list column holds lists."""

    name: str
    columns: dict[str, Sequence]
    types: dict[str, str]  # "float", or "list uchar int"


FACE = Other("face", {"vertex_indices": [[0, 1, 2], [2, 1]]}, {"vertex_indices": "list uchar int"})
EXTRINSIC = Other("extrinsic", {"extrinsic": np.arange(16.0)}, {"extrinsic": "float"})
NO_ROWS = Other("edge", {"a": [], "b": []}, {"a": "int", "b": "uchar"})


def names_inria(degree: int, normals: bool = True) -> list[str]:
    """Property names in the order of INRIA's trainer."""
    return [
        *"xyz",
        *(["nx", "ny", "nz"] if normals else []),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(REST[degree])),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def raw_columns(n: int, degree: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Columns as a trainer has them: logits, logarithms, quaternions of any length."""
    rng = np.random.default_rng(seed)
    return {name: rng.normal(0, 2, n) for name in names_inria(degree)}


def _row(values: list, types: list[str], fmt: str) -> bytes:
    if fmt == TEXT:
        words = []
        for value, kind in zip(values, types, strict=True):
            many = value if kind.startswith("list") else [value]
            words += [str(len(many))] if kind.startswith("list") else []
            scalar = np.dtype(TYPES[kind.split()[-1]]).type
            words += [repr(scalar(v).item()) if scalar is not np.float32 else f"{np.float32(v):.9g}"
                      for v in many]  # fmt: skip
        return (" ".join(words) + "\n").encode()
    order = "<" if fmt == LITTLE else ">"
    out = b""
    for value, kind in zip(values, types, strict=True):
        if kind.startswith("list"):
            _, count, item = kind.split()
            out += np.array(len(value), order + TYPES[count]).tobytes()
            out += np.array(value, order + TYPES[item]).tobytes()
        else:
            out += np.array(value).astype(order + TYPES[kind]).tobytes()
    return out


def _element(other: Other, fmt: str) -> tuple[list[str], bytes]:
    columns = list(other.columns.values())
    head = [f"element {other.name} {len(columns[0])}"]
    head += [f"property {other.types[name]} {name}" for name in other.columns]
    types = [other.types[name] for name in other.columns]
    return head, b"".join(_row(list(v), types, fmt) for v in zip(*columns, strict=True))


def write_ply(
    path: Path,
    columns: dict[str, np.ndarray],
    *,
    order: Sequence[str] | None = None,
    types: dict[str, str] | None = None,
    fmt: str = LITTLE,
    before: Sequence[Other] = (),
    after: Sequence[Other] = (),
    comments: Sequence[str] = (),
    line_end: str = "\n",
    trailing: bytes = b"",
) -> Path:
    """A PLY file of ``columns``; each is a float unless ``types`` says otherwise."""
    kinds = {name: (types or {}).get(name, "float") for name in columns}
    names = list(order if order is not None else columns)
    vertex = Other("vertex", {n: columns[n] for n in names}, {n: kinds[n] for n in names})
    head, body = ["ply", f"format {fmt} 1.0", *(f"comment {c}" for c in comments)], b""
    for element in (*before, vertex, *after):
        lines, rows = _element(element, fmt)
        head += lines
        body += rows
    text = "".join(line + line_end for line in [*head, "end_header"])
    path.write_bytes(text.encode() + body + trailing)
    return path


def as_stored(columns: dict[str, np.ndarray], types: dict[str, str]) -> dict[str, np.ndarray]:
    """What a reader finds: the columns after rounding to their types in the file."""
    with np.errstate(over="ignore"):
        return {
            name: values.astype(TYPES[types.get(name, "float")]).astype(np.float64)
            for name, values in columns.items()
        }


def decode_plainly(stored: dict[str, np.ndarray]) -> list[dict[str, object]]:
    """Row by row with Python's floats: what the arrays of a Scene must hold."""
    rest = sum(name.startswith("f_rest_") for name in stored) // 3
    gaussians = []
    for row in range(len(stored["x"])):
        at = {name: float(values[row]) for name, values in stored.items()}
        quat = [at[f"rot_{i}"] for i in range(4)]
        length = math.hypot(*quat)
        gaussians.append(
            {
                "means": [at["x"], at["y"], at["z"]],
                "quats": [q / length for q in quat],
                "scales": [math.exp(at[f"scale_{i}"]) for i in range(3)],
                "opacities": 1 / (1 + math.exp(-at["opacity"])),
                "sh": [[at[f"f_dc_{c}"] for c in range(3)]]
                + [[at[f"f_rest_{c * rest + k}"] for c in range(3)] for k in range(rest)],
            }
        )
    return gaussians
