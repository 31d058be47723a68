"""A scene as the C kernel likes it: along a space-filling curve, in vectors, with bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from tsplat.backends.cffi._kernel import ffi, lib
from tsplat.backends.cffi.call import check, pointer, scene_struct
from tsplat.core.constants import ALPHA_FLOOR
from tsplat.core.curve import curve_order
from tsplat.core.params import RenderParams
from tsplat.core.types import F32, F64, I32, Scene
from tsplat.core.workspace import Workspace


@dataclass(frozen=True, eq=False)
class Packed:
    """What :func:`pack` made, for one scene, one alpha threshold and one kind of colour."""

    columns: F32  # [G, width, 16]  G groups of sixteen; see tsplat_packed in kernel.h
    bounds: F64  # [clusters, 8]
    count: int  # Gaussians that can reach the threshold
    struct: Any  # tsplat_packed *
    scene: Any  # tsplat_scene *
    key: tuple[float, bool, bool]

    @property
    def slots(self) -> int:
        """Places for splats: whole clusters."""
        return len(self.bounds) * int(lib.TSPLAT_CLUSTER)


_packed: WeakKeyDictionary[Scene, dict[bool, Packed]] = WeakKeyDictionary()
"""The last one of each scene, without and with everything."""


def pack(
    scene: Scene, params: RenderParams, degree: int, workspace: Workspace, everything: bool
) -> Packed:
    """``scene`` packed for ``params``; made on first use and kept as long as the scene lives.

    Left out are Gaussians whose opacity is below the alpha threshold. If only SH degree 0 counts,
    the colour is worked out here. Not so if ``everything`` is to be done in each frame.
    """
    key = (params.alpha_threshold, degree == 0, everything)
    both = _packed.setdefault(scene, {})
    if everything not in both or both[everything].key != key:
        both[everything] = _pack(scene, key, workspace.threads)
    return both[everything]


def _pack(scene: Scene, key: tuple[float, bool, bool], threads: int) -> Packed:
    threshold, plain, everything = key
    struct = scene_struct(scene)
    order = _order(scene, 0 if everything else threshold)
    count = len(order)
    width = lib.TSPLAT_COLUMNS + 3 * (plain and not everything)
    store = Workspace()  # for its alignment
    columns = store.array("columns", (-(-count // 16), width, 16), np.float32)
    bounds = np.empty((-(-count // lib.TSPLAT_CLUSTER), lib.TSPLAT_BOUNDS))
    packed = ffi.new(
        "tsplat_packed *",
        {
            "columns": pointer(columns, "float"), "bounds": pointer(bounds, "double"),
            "count": count, "width": width, "numbers": pointer(scene.numbers, "int32_t"),
        },
    )  # fmt: skip
    check(
        lib.tsplat_pack(
            struct, pointer(order, "int32_t"), threshold, packed,
            pointer(columns, "float"), pointer(bounds, "double"), threads,
        ),
        "pack",
    )  # fmt: skip
    return Packed(columns, bounds, count, packed, struct, key)


def _order(scene: Scene, threshold: float) -> I32:
    """Rows that can reach ``threshold`` [count], along the curve."""
    seen = scene.opacities >= np.float32(max(threshold, ALPHA_FLOOR))
    if scene.numbers is not None:  # the loader moved them there
        return np.arange(len(scene), dtype=np.int32)[seen]
    order = curve_order(scene.means)
    return order[seen[order]]
