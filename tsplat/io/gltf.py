"""glTF 2.0 and GLB with ``KHR_gaussian_splatting``: points that have rotations, scales and colours.

Formats: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html and, of the extension,
KhronosGroup/glTF ``extensions/2.0/Khronos/KHR_gaussian_splatting/README.md``. Scales are linear; in
the review draft of 2025 they were logarithms, and a negative one shows that: no size is negative.

glTF's axes are left, up, forward (LUF) in tsplat's words. Nodes move, turn and scale what is in
them, colours too. What is no splat (meshes, cameras, animations) is passed over.
"""

from __future__ import annotations

import base64
import binascii
import math
import re
import struct
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from tsplat.core.errors import printable
from tsplat.core.types import F32, F64, I64, UPWARDS, Floats, Scene, Up
from tsplat.hookspecs import hookimpl
from tsplat.io.base import (
    Read,
    Reader,
    ReadOptions,
    check_memory,
    refuse,
    refuse_raw_opacity,
)
from tsplat.io.fields import ITEMS_MAX, Field, parse
from tsplat.io.gather import check_count, gather
from tsplat.io.table import DC, MEAN, OPACITY, QUAT, SCALE, turned
from tsplat.io.turn import Turn, axes

EXTENSION = "KHR_gaussian_splatting"
MAGIC = b"glTF"
JSON_CHUNK, BIN_CHUNK = 0x4E4F534A, 0x004E4942
TYPES: dict[int, type[np.generic]] = {
    5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32,
    5126: np.float32,
}  # fmt: skip
"""componentType -> what it is; glTF 2.0, 3.6.2.2."""

SHAPES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
PLAIN = {
    "POSITION": "VEC3", f"{EXTENSION}:ROTATION": "VEC4", f"{EXTENSION}:SCALE": "VEC3",
    f"{EXTENSION}:OPACITY": "SCALAR",
}  # fmt: skip
PRIMITIVES_MAX = 1024
"""Of splats, in all nodes; each takes half a millisecond. Exporters write one a scene."""

POINTS = 0
STRIDE_MAX = 252
DATA = "data:"
LONG = re.compile(rb'"data:[^"\\]{256,}"')
"""Buffers within the JSON: they are taken out before it is parsed."""

SAME_SCALE = 1e-5
"""How far a node's three scales may be apart and count as the same: float32's rounding and more."""

EXACT = 1e-12
"""Entries of a rotation this near to -1, 0 or 1 are that: rounding of float64."""

DRAWN_AS_IS = "srgb_rec709_display"


@dataclass(frozen=True)
class Accessor:
    """Numbers of a buffer, as they lie there."""

    table: NDArray[Any]  # [count, components], strided
    normalized: bool

    def rows(self, rows: slice | I64) -> F32:
        """Some of them; integers that are normalised become -1..1 or 0..1 (glTF 2.0, 3.6.2.2)."""
        found = self.table[rows].astype(np.float32)
        if not self.normalized:
            return found
        kind = np.iinfo(self.table.dtype)
        return np.asarray(np.maximum(found / np.float32(kind.max), -1), np.float32)


@dataclass(frozen=True)
class Primitive:
    """Gaussians of one primitive in one node."""

    columns: dict[str, Accessor]
    harmonics: tuple[Accessor, ...]
    turn: Turn
    logarithms: bool = False

    def __len__(self) -> int:
        return len(self.harmonics[0].table)

    def means(self, rows: slice | I64) -> Floats:
        """[n, 3]."""
        return self.turn.means(self.columns["POSITION"].rows(rows))

    def fill(self, rows: slice | I64, table: F32) -> Floats | None:
        """See :class:`tsplat.io.gather.Source`. Coefficients that it lacks are 0."""
        table[:, MEAN] = self.columns["POSITION"].rows(rows)
        table[:, QUAT] = self.columns[f"{EXTENSION}:ROTATION"].rows(rows)[:, [3, 0, 1, 2]]
        scales: Floats = self.columns[f"{EXTENSION}:SCALE"].rows(rows)
        table[:, SCALE] = np.exp(scales.astype(np.float64)) if self.logarithms else scales
        table[:, OPACITY] = self.columns[f"{EXTENSION}:OPACITY"].rows(rows)
        end = DC.start
        for accessor in self.harmonics:
            table[:, end : end + 3] = accessor.rows(rows)
            end += 3
        table[:, end:] = 0
        return turned(table, self.turn)


class Splats:
    """All primitives, one after the other; see :class:`tsplat.io.gather.Source`."""

    def __init__(self, primitives: list[Primitive]) -> None:
        self._primitives = primitives
        self._starts = np.cumsum([0, *(len(p) for p in primitives)])
        self.count = int(self._starts[-1])
        self.coefficients = max(len(p.harmonics) for p in primitives)
        self.wide = any(p.turn.shift.any() or p.turn.scale != 1 for p in primitives)

    def _parts(self, rows: slice | I64) -> list[tuple[Primitive, slice | I64]]:
        """Which primitives ``rows`` are in, and where."""
        first, last = (
            (rows.start, rows.stop) if isinstance(rows, slice) else (rows[0], rows[-1] + 1)
        )
        parts: list[tuple[Primitive, slice | I64]] = []
        at = int(np.searchsorted(self._starts, first, "right")) - 1
        for i in range(at, len(self._primitives)):
            start, stop = int(self._starts[i]), int(self._starts[i + 1])
            if start >= last:
                break
            if isinstance(rows, slice):
                inside: slice | I64 = slice(
                    max(rows.start - start, 0), min(rows.stop, stop) - start
                )
            else:
                low, high = np.searchsorted(rows, (start, stop))
                inside = rows[low:high] - start
            if isinstance(inside, slice) or len(inside):
                parts.append((self._primitives[i], inside))
        return parts

    def means(self, rows: slice | I64) -> Floats:
        """See :class:`tsplat.io.gather.Source`."""
        return np.concatenate([p.means(inside) for p, inside in self._parts(rows)])

    def fill(self, rows: slice | I64, table: F32) -> Floats | None:
        """See :class:`tsplat.io.gather.Source`."""
        means = np.empty((len(table), 3)) if self.wide else None
        start = 0
        for primitive, inside in self._parts(rows):
            part = inside.stop - inside.start if isinstance(inside, slice) else len(inside)
            place = slice(start, start + part)
            found = primitive.fill(inside, table[place])
            if means is not None:
                means[place] = table[place, MEAN] if found is None else found
            start += part
        return means


class _File:
    """A glTF file: its JSON, and buffers as they are asked for."""

    def __init__(
        self, path: Path, root: Field, chunk: memoryview | None, data: list[bytes]
    ) -> None:
        """``chunk`` is a GLB's binary one, ``data`` are URIs that were taken out of the JSON."""
        self.path = path
        self.root = root
        self.bytes = path.stat().st_size
        self._chunk = chunk
        self._data = data
        self._buffers: dict[int, memoryview] = {}
        self._files: dict[Path, memoryview] = {}
        self._unpacked: dict[int, memoryview] = {}

    def buffer(self, index: Field) -> memoryview:
        """The bytes of a buffer, as many as it promises."""
        found = self.root.get("buffers").at(index)
        number = index.integer(0)
        if number not in self._buffers:
            length = found.get("byteLength").integer(1)
            content = self._content(found, number)
            if len(content) < length:
                refuse(
                    self.path,
                    f"truncated: {found.place} promises {length} bytes, there are {len(content)}; "
                    "copy or download all files of the scene again",
                )
            self._buffers[number] = content[:length]
        return self._buffers[number]

    def _content(self, buffer: Field, number: int) -> memoryview:
        uri = buffer.maybe("uri")
        if uri is None:
            if self._chunk is None or number != 0:
                refuse(
                    self.path,
                    f"{buffer.place} has no uri, and no binary chunk is for it; it is damaged",
                )
            return self._chunk
        text = uri.text()
        if text.startswith(DATA):
            return self._decoded(uri, text)
        if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", text):
            uri.wrong("the name of a file beside this one; nothing is fetched from a network")
        file = uri.inside().resolve()
        if file not in self._files:
            self._files[file] = memoryview(file.read_bytes())
            self.bytes += len(self._files[file])
        return self._files[file]

    def _decoded(self, uri: Field, text: str) -> memoryview:
        taken = re.fullmatch(r"data:#([0-9]{1,6})", text)
        number = int(taken[1]) if taken else len(self._data)
        if number in self._unpacked:  # many buffers may name it
            return self._unpacked[number]
        inside = number >= len(self._data)
        whole = text.encode("ascii", "replace") if inside else self._data[number]
        head, _, body = whole.partition(b",")
        if not head.endswith(b";base64"):
            uri.wrong("data in base64")
        try:
            found = memoryview(base64.b64decode(body, validate=True))
            if not inside:
                self._unpacked[number] = found
                self._data[number] = b""
            return found
        except binascii.Error as error:
            refuse(
                self.path, f"{uri.place}: data that is no base64: {printable(error)}; it is damaged"
            )

    def accessor(self, index: Field, kind: str) -> Accessor:
        """What ``index`` counts, which must be of type ``kind``."""
        found = self.root.get("accessors").at(index)
        if found.maybe("sparse") is not None or found.maybe("bufferView") is None:
            refuse(self.path, f"{found.place}: sparse accessors are not read; write it in full")
        shape = found.get("type")
        if shape.text() != kind:
            shape.wrong(kind)
        number = found.get("componentType")
        if number.integer(0) not in TYPES:
            number.wrong("5120 to 5126")
        dtype = np.dtype(TYPES[number.integer(0)]).newbyteorder("<")
        count = found.get("count").integer(1)
        normalized = found.maybe("normalized")
        view = self.root.get("bufferViews").at(found.get("bufferView"))
        content = self.buffer(view.get("buffer"))
        start = _or(view, "byteOffset", 0)
        length = view.get("byteLength").integer(1)
        if start + length > len(content):
            refuse(
                self.path,
                f"{view.place} ends at byte {start + length} of a buffer of {len(content)}; "
                "the file is damaged",
            )
        row = dtype.itemsize * SHAPES[kind]
        stride = _or(view, "byteStride", row)
        offset = _or(found, "byteOffset", 0)
        if not row <= stride <= max(STRIDE_MAX, row):
            refuse(
                self.path,
                f"{view.place}.byteStride is {stride}, expected {row} to {STRIDE_MAX}",
            )
        needed = offset + stride * (count - 1) + row
        if needed > length:
            refuse(
                self.path,
                f"{found.place} needs {needed} bytes of {view.place}, which has {length}; "
                "the file is damaged",
            )
        table: NDArray[Any] = np.ndarray(
            (count, SHAPES[kind]), dtype, content, start + offset, (stride, dtype.itemsize)
        )
        integers = dtype.kind in "iu"
        return Accessor(table, integers and normalized is not None and normalized.value is True)


def _or(field: Field, key: str, default: int) -> int:
    found = field.maybe(key)
    return default if found is None else found.integer(0)


def _opened(path: Path) -> _File:
    """The JSON and the binary chunk.

    Raises:
        SceneError: the container is not what it says.
    """
    content = path.read_bytes()
    chunk: memoryview | None = None
    text = content
    if content.startswith(MAGIC):
        text, chunk = _chunks(path, content)
    data: list[bytes] = []

    def taken(found: re.Match[bytes]) -> bytes:
        data.append(found[0][1:-1])
        return f'"{DATA}#{len(data) - 1}"'.encode()

    root = parse(path, "", LONG.sub(taken, text))
    version = root.get("asset").get("version")
    if not version.text().startswith("2."):
        version.wrong("glTF version 2")
    return _File(path, root, chunk, data)


def _chunks(path: Path, content: bytes) -> tuple[bytes, memoryview | None]:
    """Of a GLB: its JSON and its binary chunk (glTF 2.0, 4.4)."""
    if len(content) < 20:
        refuse(path, f"truncated: GLB header: expected 20 bytes, got {len(content)}")
    version, length, size, kind = struct.unpack_from("<IIII", content, 4)
    if version != 2:
        refuse(path, f"GLB version {version} (byte 4), expected 2")
    if length > len(content):
        refuse(
            path,
            f"truncated: its header promises {length} bytes, the file has {len(content)}; "
            "copy or download it again",
        )
    if kind != JSON_CHUNK or 20 + size > len(content):
        refuse(path, f"GLB whose first chunk (byte 12) is no JSON of {size} bytes; it is damaged")
    at = 20 + size
    chunk = None
    if at + 8 <= length:
        size_2, kind_2 = struct.unpack_from("<II", content, at)
        if kind_2 == BIN_CHUNK:
            if at + 8 + size_2 > len(content):
                refuse(
                    path,
                    f"truncated: its binary chunk (byte {at}) promises {size_2} bytes, "
                    f"{len(content) - at - 8} are left; copy or download it again",
                )
            chunk = memoryview(content)[at + 8 : at + 8 + size_2]
    return content[20:at], chunk


def _matrix(node: Field) -> F64:
    """[4, 4] what a node does to what is in it (glTF 2.0, 5.25)."""
    given = node.maybe("matrix")
    if given is not None:
        return given.numbers(16).reshape(4, 4).T
    matrix = np.eye(4)
    turned, scaled, moved = (node.maybe(k) for k in ("rotation", "scale", "translation"))
    if turned is not None:
        from tsplat.core.reference import rotations

        quat = turned.numbers(4)
        length = float(np.linalg.norm(quat))
        if not 0.5 < length < 2:
            turned.wrong("a quaternion of length 1")
        matrix[:3, :3] = rotations(quat[[3, 0, 1, 2]] / length)
    if scaled is not None:
        matrix[:3, :3] *= scaled.numbers(3)
    if moved is not None:
        matrix[:3, 3] = moved.numbers(3)
    return matrix


def _turn(place: str, path: Path, matrix: F64) -> Turn:
    """What ``matrix`` and then tsplat's axes do to Gaussians."""
    linear = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        scale = float(np.sqrt((linear * linear).sum() / 3))
        fine = np.isfinite(matrix).all() and 1e-12 < scale < 1e12
        off = np.abs(linear.T @ linear / scale**2 - np.eye(3)).max() if fine else math.inf
    if not off <= SAME_SCALE:
        with np.errstate(over="ignore", under="ignore"):
            lengths = np.linalg.norm(np.nan_to_num(linear), axis=0)
        sizes = ", ".join(f"{s:.4g}" for s in lengths)
        refuse(
            path,
            f"{place} stretches its splats by {sizes} along its axes, expected one size for all; "
            "apply its transform in the program that made it",
        )
    if abs(scale - 1) <= EXACT:
        scale = 1.0
    left, _, right = np.linalg.svd(linear)  # the nearest orthogonal one
    orthogonal = left @ right
    nearest = np.round(orthogonal)
    orthogonal = np.where(np.abs(orthogonal - nearest) < EXACT, nearest, orthogonal)
    world = axes("LUF")
    return Turn(world @ orthogonal, scale, world @ matrix[:3, 3])


def _nodes(file: _File) -> list[tuple[Field, F64]]:
    """Nodes of the scene with their matrices, parents before children."""
    nodes = file.root.maybe("nodes")
    if nodes is None:
        return []
    scenes = file.root.maybe("scenes")
    if scenes is not None:
        chosen = file.root.maybe("scene")
        scene = scenes.at(chosen) if chosen is not None else scenes.at(Field(file.path, "scene", 0))
        listed = scene.maybe("nodes")
        roots = [] if listed is None else listed.items()
    else:
        below = {
            child.integer(0)
            for node in nodes.items()
            if (children := node.maybe("children")) is not None
            for child in children.items()
        }
        roots = [
            Field(file.path, node.place, i)
            for i, node in enumerate(nodes.items())
            if i not in below
        ]
    found: list[tuple[Field, F64]] = []
    seen: set[int] = set()
    world = np.eye(4)
    waiting = [(index, world) for index in reversed(roots)]
    while waiting:
        if len(waiting) + len(seen) > ITEMS_MAX:
            refuse(file.path, f"glTF scene of more than {ITEMS_MAX} nodes, expected at most that")
        index, above = waiting.pop()
        node = nodes.at(index)
        number = index.integer(0)
        if number in seen:
            refuse(file.path, f"{node.place} has two parents, or is its own; the file is damaged")
        seen.add(number)
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            matrix = above @ _matrix(node)
        found.append((node, matrix))
        children = node.maybe("children")
        if children is not None:
            waiting += [(child, matrix) for child in reversed(children.items())]
    return found


def _harmonics(attributes: Field) -> list[Field]:
    """Accessors of the coefficients, those of a degree all or none."""
    found = [attributes.get(f"{EXTENSION}:SH_DEGREE_0_COEF_0")]
    for degree in range(1, 4):
        names = [f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{i}" for i in range(2 * degree + 1)]
        if not any(attributes.maybe(name) for name in names):
            break
        found += [attributes.get(name) for name in names]
    return found


def _columns(file: _File, field: Field) -> tuple[dict[str, Accessor], tuple[Accessor, ...]]:
    """What :class:`Primitive` has of a primitive of splats."""
    mode = field.maybe("mode")
    if mode is None or mode.integer(0) != POINTS:
        refuse(file.path, f"{field.place}.mode: expected 0 (points) of splats")
    more = field.get("extensions").get(EXTENSION).maybe("extensions")
    attributes = field.get("attributes")
    if more is not None and attributes.maybe(f"{EXTENSION}:SCALE") is None:
        if not isinstance(more.value, dict):
            more.wrong("an object")
        names = ", ".join(printable(n, 60) for n in islice(more.value, 3)) or "nothing"
        refuse(
            file.path,
            f"{field.place}: its splats are packed by {names}, which is not read; "
            "write them without compression",
        )
    columns = {name: file.accessor(attributes.get(name), kind) for name, kind in PLAIN.items()}
    harmonics = [file.accessor(index, "VEC3") for index in _harmonics(attributes)]
    counts = {len(a.table) for a in (*columns.values(), *harmonics)}
    if len(counts) > 1:
        refuse(
            file.path,
            f"{field.place}: its attributes have {min(counts)} to {max(counts)} rows, "
            "expected as many of each",
        )
    return columns, tuple(harmonics)


@dataclass(frozen=True)
class Mesh:
    """Primitives of a mesh; nodes may share it."""

    splats: list[tuple[Field, dict[str, Accessor], tuple[Accessor, ...]]]
    others: int
    spaces: set[str]


def _mesh(file: _File, mesh: Field) -> Mesh:
    splats: list[tuple[Field, dict[str, Accessor], tuple[Accessor, ...]]] = []
    others, spaces = 0, set()
    for field in mesh.get("primitives").items():
        extensions = field.maybe("extensions")
        extension = None if extensions is None else extensions.maybe(EXTENSION)
        if extension is None:
            others += 1
            continue
        if len(splats) == PRIMITIVES_MAX:
            _too_many(file.path)
        splats.append((field, *_columns(file, field)))
        space = extension.maybe("colorSpace")
        spaces.add(DRAWN_AS_IS if space is None else printable(space.text(), 40))
    return Mesh(splats, others, spaces)


def _too_many(path: Path) -> NoReturn:
    refuse(
        path,
        f"glTF scene of more than {PRIMITIVES_MAX} primitives of splats, expected at most that; "
        "join them in the program that made it",
    )


def _primitives(file: _File) -> tuple[list[Primitive], set[str]]:
    """All splats of the scene, and the colour spaces that they name."""
    found: list[Primitive] = []
    spaces: set[str] = set()
    meshes: dict[int, Mesh] = {}
    passed = total = most = 0
    for node, matrix in _nodes(file):
        number = node.maybe("mesh")
        if number is None:
            continue
        index = number.integer(0)
        if index not in meshes:
            meshes[index] = _mesh(file, file.root.get("meshes").at(number))
        mesh = meshes[index]
        passed += mesh.others
        spaces |= mesh.spaces
        turn = None
        for field, columns, harmonics in mesh.splats:
            if len(found) == PRIMITIVES_MAX:
                _too_many(file.path)
            turn = turn or _turn(node.place, file.path, matrix)
            found.append(Primitive(columns, harmonics, turn))
            total += len(found[-1])
            check_count(file.path, total, file.bytes, f"{field.place} and those before it")
            most = max(most, len(harmonics))
            check_memory(file.path, total, most, 0, file.bytes)
    if not found:
        what = f"{passed} meshes" if passed else "nothing"
        refuse(
            file.path,
            f"this is a glTF scene of {what}, without {EXTENSION}; open it in a mesh viewer",
        )
    return found, spaces


def _logarithmic(primitives: list[Primitive]) -> list[Primitive]:
    """Scales of the review draft are logarithms, which only a negative one shows."""
    name = f"{EXTENSION}:SCALE"
    tables = {id(p.columns[name]): p.columns[name].table for p in primitives}
    if not any(table.dtype.kind != "u" and (table < 0).any() for table in tables.values()):
        return primitives
    return [Primitive(p.columns, p.harmonics, p.turn, logarithms=True) for p in primitives]


def read(path: Path, options: ReadOptions) -> Scene:
    """See :class:`tsplat.io.base.Read`.

    Memory: the file and the scene, which is at most 0.8 times as large where numbers are float32.
    """
    refuse_raw_opacity(path, options, "KHR_gaussian_splatting")
    file = _opened(path)
    primitives, spaces = _primitives(file)
    primitives = _logarithmic(primitives)
    source = Splats(primitives)
    about = f"glTF, SH {math.isqrt(source.coefficients) - 1}"
    if primitives[0].logarithms:
        about += ", scales are logarithms (draft of 2025)"
    for space in sorted(spaces - {DRAWN_AS_IS}):
        about += f", colours {space} (drawn as they are)"
    up = Up(UPWARDS, "y is up in glTF; turned to x right, y down, z forward")
    return gather(path, source, options, about=about, up=up)


def recognises(start: bytes) -> bool:
    """Whether a file begins like a GLB, or like JSON with glTF's words."""
    if start.startswith(MAGIC):
        return True
    words = rb'"(asset|accessors|bufferViews|buffers|extensionsUsed|meshes|scenes)"\s*:'
    return (
        re.match(rb"(\xef\xbb\xbf)?\s*\{", start) is not None
        and re.search(words, start) is not None
        and b'"means"' not in start
    )


def _load() -> Read:
    return read


GLTF = Reader(
    name="gltf",
    summary="glTF 2.0, .glb and .gltf, with KHR_gaussian_splatting",
    recognises=recognises,
    load=_load,
)


@hookimpl
def tsplat_readers() -> list[Reader]:
    """See :func:`tsplat.hookspecs.tsplat_readers`."""
    return [GLTF]
