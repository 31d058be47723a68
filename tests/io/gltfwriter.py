"""glTF files of given arrays."""

from __future__ import annotations

import base64
import json
import struct

import numpy as np

EXT = "KHR_gaussian_splatting"
KINDS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "f4": 5126}
TOP = {"i1": 127, "u1": 255, "i2": 32767, "u2": 65535}


def random_arrays(n, degree, seed=0):
    """Decoded arrays of a scene, in the file's axes."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return {
        "means": rng.normal(size=(n, 3)).astype(np.float32),
        "quats": (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        "scales": rng.uniform(0.01, 2, (n, 3)).astype(np.float32),
        "opacities": rng.uniform(0, 1, n).astype(np.float32),
        "sh": rng.normal(size=(n, (degree + 1) ** 2, 3)).astype(np.float32),
    }


def columns(arrays):
    """Attribute -> values."""
    made = {
        "POSITION": arrays["means"], f"{EXT}:ROTATION": arrays["quats"][:, [1, 2, 3, 0]],
        f"{EXT}:SCALE": arrays["scales"], f"{EXT}:OPACITY": arrays["opacities"][:, None],
    }  # fmt: skip
    k = 0
    for degree in range(4):
        for i in range(2 * degree + 1):
            if k < arrays["sh"].shape[1]:
                made[f"{EXT}:SH_DEGREE_{degree}_COEF_{i}"] = arrays["sh"][:, k]
            k += 1
    return made


class Builder:
    """Collects primitives into one buffer."""

    def __init__(self):
        self.binary = b""
        self.root = {
            "asset": {"version": "2.0"}, "extensionsUsed": [EXT], "scene": 0,
            "scenes": [{"nodes": []}], "nodes": [], "meshes": [], "accessors": [],
            "bufferViews": [], "buffers": [],
        }  # fmt: skip

    def accessor(self, values, kind="f4", normalized=False, stride=0, offset=0):
        """``stride`` bytes more than needed between rows, ``offset`` before the first."""
        values = np.asarray(values)
        stored = np.round(values * TOP[kind]) if normalized else values
        rows = stored.astype("<" + kind)
        size = rows.shape[1] * rows.itemsize
        content = b"".join(row.tobytes() + b"\xee" * stride for row in rows)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": offset + len(content)}
        if stride:
            view["byteStride"] = size + stride
        self.binary += b"\xee" * offset + content
        self.root["bufferViews"].append(view)
        self.root["accessors"].append(
            {
                "bufferView": len(self.root["bufferViews"]) - 1, "byteOffset": offset,
                "componentType": KINDS[kind], "count": len(rows), "normalized": normalized,
                "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[rows.shape[1]],
            }
        )  # fmt: skip
        return len(self.root["accessors"]) - 1

    def primitive(self, arrays, kinds=None, space="srgb_rec709_display", **layout):
        """``kinds`` says of some attributes how they are stored: a type, and whether normalised."""
        attributes = {}
        for name, values in columns(arrays).items():
            kind, normalized = (kinds or {}).get(name.split(":")[-1], ("f4", False))
            attributes[name] = self.accessor(values, kind, normalized, **layout)
        return {
            "attributes": attributes, "mode": 0,
            "extensions": {EXT: {"kernel": "ellipse", "colorSpace": space}},
        }  # fmt: skip

    def node(self, *primitives, root=True, **more):
        """A node with a mesh of them."""
        if primitives:
            self.root["meshes"].append({"primitives": list(primitives)})
            more["mesh"] = len(self.root["meshes"]) - 1
        self.root["nodes"].append(more)
        number = len(self.root["nodes"]) - 1
        if root:
            self.root["scenes"][0]["nodes"].append(number)
        return number

    def gltf(self, uri=None):
        """JSON text; the buffer is ``uri``, or within."""
        data = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        buffer = {"byteLength": len(self.binary), "uri": data if uri is None else uri}
        return json.dumps({**self.root, "buffers": [buffer]}).encode()

    def glb(self, root=None):
        root = (
            {**self.root, "buffers": [{"byteLength": len(self.binary)}]} if root is None else root
        )
        return glb(json.dumps(root).encode(), self.binary)


def glb(text, binary):
    """The container."""
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def one(arrays, **more):
    """A builder of one primitive in one node."""
    builder = Builder()
    builder.node(builder.primitive(arrays, **more))
    return builder
