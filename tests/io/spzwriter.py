"""SPZ files of given planes, and what they mean, worked out one Gaussian at a time."""

from __future__ import annotations

import gzip
import math
import struct

import numpy as np

from tsplat.io import spz

try:
    spz._zstd()
    HAVE_ZSTD = True
except ImportError:
    HAVE_ZSTD = False

NO_ZSTD = "no zstd: Python before 3.14 without backports.zstd"


def sizes(version, degree):
    """Bytes a Gaussian, plane by plane."""
    return (6 if version == 1 else 9, 1, 3, 3, 3 if version < 3 else 4, 3 * ((degree + 1) ** 2 - 1))


def random_planes(n, version, degree, seed=0):
    """Any bytes are a scene, but for positions of version 1 that are not finite."""
    rng = np.random.default_rng(seed)
    planes = [rng.integers(0, 256, n * size, np.uint8) for size in sizes(version, degree)]
    if version == 1:
        planes[0] = rng.normal(0, 3, 3 * n).astype("<f2").view(np.uint8)
    return [p.tobytes() for p in planes]


def header(n, version, degree, fraction=12, flags=0, last=0):
    return struct.pack("<4sIIBBBB", b"NGSP", version, n, degree, fraction, flags, last)


def compressed(content):
    """A zstd frame."""
    import sys

    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd.compress(content)


def packed(n, version, degree, planes, fraction=12, flags=0, extensions=b""):
    """A whole file."""
    if version < 4:
        return gzip.compress(
            header(n, version, degree, fraction, flags) + b"".join(planes), 1, mtime=0
        )
    full = [p for p in planes if p]
    streams = [compressed(p) for p in full]
    flags |= 2 if extensions else 0
    start = header(n, version, degree, fraction, flags, len(full))
    start += struct.pack("<I12x", 32 + len(extensions)) + extensions
    for stream, plane in zip(streams, full, strict=True):
        start += struct.pack("<QQ", len(stream), len(plane))
    return start + b"".join(streams)


def extension(kind, payload):
    return struct.pack("<II", kind, len(payload)) + payload


def decoded(i, version, degree, planes, fraction=12):
    """Gaussian ``i`` in the file's axes: position, w x y z, sizes, opacity, [K][3] coefficients."""
    parts = [
        p[i * size : (i + 1) * size] for p, size in zip(planes, sizes(version, degree), strict=True)
    ]
    position, alpha, color, scale, rotation, sh = parts
    if version == 1:
        mean = struct.unpack("<3e", position)
    else:
        mean = [
            int.from_bytes(position[3 * a : 3 * a + 3], "little", signed=True) / 2**fraction
            for a in range(3)
        ]
    if version < 3:
        x, y, z = (b / 127.5 - 1 for b in rotation)
        quat = [math.sqrt(max(0, 1 - x * x - y * y - z * z)), x, y, z]
    else:
        word = int.from_bytes(rotation, "little")
        largest = word >> 30
        xyzw = [0.0] * 4
        for component in (3, 2, 1, 0):
            if component != largest:
                size = (word & 511) / 511 * math.sqrt(0.5)
                xyzw[component] = -size if word & 512 else size
                word >>= 10
        xyzw[largest] = math.sqrt(max(0, 1 - sum(c * c for c in xyzw)))
        quat = [xyzw[3], *xyzw[:3]]
    length = math.sqrt(sum(c * c for c in quat))
    coefficients = [[(b / 255 - 0.5) / 0.15 for b in color]]
    coefficients += [[(b - 128) / 128 for b in sh[j : j + 3]] for j in range(0, len(sh), 3)]
    return (
        mean,
        [c / length for c in quat],
        [math.exp(b / 16 - 10) for b in scale],
        alpha[0] / 255,
        coefficients,
    )
