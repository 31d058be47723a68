"""The kernels as stages: check arrays, lend buffers, spread the work, turn faults into errors."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsplat.backends.numba_kernels import composite as pixels
from tsplat.backends.numba_kernels import order as lists
from tsplat.backends.numba_kernels import project as geometry
from tsplat.backends.numba_kernels.jit import spread
from tsplat.core.camera import Camera
from tsplat.core.constants import ALPHA_FLOOR, CLAMP_MARGIN
from tsplat.core.errors import KernelError, check_array
from tsplat.core.params import RenderParams
from tsplat.core.types import F64, I32, I64, Bins, Frame, Scene, Splats
from tsplat.core.workspace import Workspace

TILE_SIZE_MAX = 64
"""px; wider tiles would only repeat the test of every splat for more patches."""

_SPLAT_ARRAYS: tuple[tuple[str, tuple[int, ...], type], ...] = (
    ("means2d", (2,), np.float64),
    ("factors", (3,), np.float32),
    ("depths", (), np.float32),
    ("opacities", (), np.float32),
    ("colors", (3,), np.float32),
    ("radii", (2,), np.float32),
    ("gaussian_ids", (), np.int32),
)
_FEW = 1 << 14  # rows that are not worth a second thread


def _arrays(splats: Splats) -> dict[str, Any]:
    """Its arrays, checked."""
    if splats.width < 1 or splats.height < 1:
        raise KernelError(f"Splats: expected a picture, got {splats.width}x{splats.height}")
    m = len(splats)
    return {
        name: check_array(f"Splats.{name}", getattr(splats, name), dtype, (m, *shape))
        for name, shape, dtype in _SPLAT_ARRAYS
    }


def _runs(count: int, pieces: int) -> list[tuple[int, int]]:
    """``count`` rows in ``pieces`` runs of nearly equal length."""
    return list(pairwise(count * i // pieces for i in range(pieces + 1)))


def _at_least(rows: int, array: Any) -> Any:
    """``array``, or if it is too short for a vector, a copy with rows that nobody looks at."""
    if len(array) >= rows:
        return array
    return np.concatenate([array, np.zeros((rows, *array.shape[1:]), array.dtype)])


def _pieces(threads: int) -> int:
    """Into how many runs to cut work that may be lopsided."""
    return 1 if threads == 1 else 4 * threads


def _view(camera: Camera, scene: Scene) -> F64:
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    width, height = camera.width, camera.height
    margin_x, margin_y = CLAMP_MARGIN * width / (2 * fx), CLAMP_MARGIN * height / (2 * fy)
    return np.array([
        *camera.rotation.ravel(), *(camera.centre - scene.origin), fx, fy, cx, cy,
        camera.near, camera.far,
        -cx / fx - margin_x, (width - cx) / fx + margin_x,
        -cy / fy - margin_y, (height - cy) / fy + margin_y,
        width, height,
    ], np.float64)  # fmt: skip


def project(scene: Scene, camera: Camera, params: RenderParams, workspace: Workspace) -> Splats:
    """See :class:`tsplat.core.stages.Project`."""
    n, lanes = len(scene), geometry.LANES
    threads = workspace.threads if n > _FEW else 1
    gaussians: list[Any] = [scene.means, scene.quats, scene.scales, scene.opacities, scene.sh]
    gaussians = [_at_least(lanes, array) for array in gaussians]
    view, threshold = _view(camera, scene), max(params.alpha_threshold, ALPHA_FLOOR)
    degree = min(params.sh_degree, scene.sh_degree)
    arrays = {
        name: workspace.array(f"numba.{name}", (n, *shape), dtype)
        for name, shape, dtype in _SPLAT_ARRAYS
    }
    runs = [(lanes * i, min(lanes * j, n)) for i, j in _runs(-(-n // lanes), _pieces(threads))]
    space = workspace.array("numba.project", (len(runs), geometry.SPACE), np.float32)
    space64 = workspace.array("numba.project64", (len(runs), 2 * lanes), np.float64)
    counts = spread(
        threads, len(runs),
        lambda i: geometry.project_rows(
            *runs[i], *gaussians, view, degree, params.antialias, threshold, space[i], space64[i],
            *arrays.values(),
        ),
    )  # fmt: skip
    m = 0
    for (first, _), (visible, _) in zip(runs, counts, strict=True):
        if m < first:  # closes the gap that Gaussians out of sight leave
            for array in arrays.values():
                array[m : m + visible] = array[first : first + visible]
        m += visible
    splats = {name: array[:m] for name, array in arrays.items()}
    overflowed = sum(overflowed for _, overflowed in counts)
    return Splats(**splats, width=camera.width, height=camera.height, overflowed=overflowed)


def sort(splats: Splats, workspace: Workspace) -> I32:
    """See :class:`tsplat.core.stages.Sort`."""
    m = len(splats)
    bits = check_array("Splats.depths", splats.depths, np.float32, (m,)).view(np.uint32)
    threads = workspace.threads if m > _FEW else 1
    runs = _runs(m, threads)
    order: I32 = workspace.array("numba.order", (m,), np.int32)
    pairs, spare = workspace.array("numba.pairs", (2, m), np.uint64)
    least, most = (int(bits.min()), int(bits.max())) if m else (0, 0)
    length = max((most - least).bit_length(), 1)
    digits = -(-length // lists.DIGIT_BITS)
    digit_bits = -(-length // digits)
    histograms: I64 = workspace.array("numba.histograms", (threads, 1 << digit_bits), np.int64)
    spread(threads, threads, lambda i: lists.make_pairs(*runs[i], bits, least, pairs))
    for digit in range(digits):
        _place_digit(
            lists.KEY + digit * digit_bits, pairs, order if digit == digits - 1 else spare, runs,
            histograms,
        )  # fmt: skip
        pairs, spare = spare, pairs
    return order


def _place_digit(
    shift: int, pairs: NDArray[np.uint64], out: NDArray[Any], runs: list[tuple[int, int]],
    histograms: I64,
) -> None:  # fmt: skip
    """Sorts ``pairs`` by one digit into ``out``."""
    threads = len(runs)
    spread(
        threads, threads, lambda i: lists.count_digits(*runs[i], pairs, shift, histograms[i])
    )  # fmt: skip
    lists.first_places(histograms)
    spread(
        threads, threads, lambda i: lists.place_pairs(*runs[i], pairs, shift, histograms[i], out)
    )  # fmt: skip


def bin(splats: Splats, order: I32, workspace: Workspace) -> Bins:
    """See :class:`tsplat.core.stages.Bin`."""
    arrays = _arrays(splats)
    m, size, lanes = len(splats), lists.TILE, lists.LANES
    check_array("order", order, np.int32, (m,))
    threads = workspace.threads if m > _FEW else 1
    runs, width, height = _runs(m, threads), splats.width, splats.height
    across, down = -(-width // size), -(-height // size)
    if max(across, down) > lists.TILES_MAX:
        raise KernelError(f"bin: expected at most {lists.TILES_MAX * size} px, got {width}x{height}")
    boxes = workspace.array("numba.boxes", (max(m, lanes),), np.int64)
    ordered = workspace.array("numba.ordered", (m,), np.int64)
    slots = workspace.array("numba.slots", (threads, down + 1, across + 1), np.int64)
    offsets = workspace.array("numba.offsets", (across * down + 1,), np.int64)
    means2d, radii = _at_least(lanes, arrays["means2d"]), _at_least(lanes, arrays["radii"])
    spread(
        threads, threads, lambda i: lists.box_tiles(*runs[i], means2d, radii, width, height, boxes)
    )  # fmt: skip
    good = spread(
        threads, threads,
        lambda i: lists.count_tiles(*runs[i], order, boxes, across, down, ordered, slots[i]),
    )  # fmt: skip
    if not all(good):
        raise KernelError("bin: order points outside the splats")
    lists.first_slots(slots, offsets)
    total = int(offsets[-1])
    ids: I32 = workspace.array("numba.ids", (total,), np.int32)
    # Looking at every box once per band pays where a box has many tiles.
    bands = min(max(total // (8 * m + 1), 1), down)
    spread(
        threads, threads,
        lambda i: lists.fill_tiles(*runs[i], bands, order, ordered, slots[i], ids),
    )  # fmt: skip
    return Bins(offsets, ids, size)


def composite(splats: Splats, bins: Bins, params: RenderParams, workspace: Workspace) -> Frame:
    """See :class:`tsplat.core.stages.Composite`."""
    arrays = _arrays(splats)
    m, height, width, size = len(splats), splats.height, splats.width, bins.tile_size
    threads = workspace.threads
    if not 1 <= size <= TILE_SIZE_MAX:
        raise KernelError(f"composite: expected tiles of 1 to {TILE_SIZE_MAX} px, got {size}")
    tiles = -(-width // size) * -(-height // size)
    offsets: Any = check_array("Bins.tile_offsets", bins.tile_offsets, np.int64, (tiles + 1,))
    ids: Any = check_array(
        "Bins.splat_ids", bins.splat_ids, np.int32, (int(bins.tile_offsets[-1]),)
    )
    if offsets[0] != 0 or (np.diff(offsets) < 0).any():
        raise KernelError("composite: Bins.tile_offsets must start at 0 and never fall")
    # Extents end at the floor where there is no threshold.
    threshold = max(params.alpha_threshold, ALPHA_FLOOR)
    records = workspace.array("numba.records", (m, pixels.RECORD), np.float32)
    records64 = records.view(np.float64)
    rgb = workspace.array("numba.rgb", (height, width, 3), np.float32)
    transmittance = workspace.array("numba.transmittance", (height, width), np.float32)
    depth = workspace.array("numba.depth", (height, width), np.float32) if params.depth else None
    rows = _runs(m, threads)
    opacities = _at_least(pixels.LANES, arrays["opacities"])
    spread(
        threads, threads,
        lambda i: pixels.pack_splats(
            *rows[i], arrays["means2d"], arrays["factors"], arrays["depths"], opacities,
            arrays["colors"], records, records64,
        ),
    )  # fmt: skip
    patches = tiles * (-(-size // pixels.SIDE)) ** 2
    runs = _runs(patches, min(patches, 16 * threads))
    space = workspace.array("numba.space", (len(runs), pixels.SPACE), np.float32)
    entries = workspace.array("numba.entries", (len(runs), pixels.LIST), np.int32)
    good = spread(
        threads, len(runs),
        lambda i: pixels.composite_patches(
            *runs[i], records, records64, offsets, ids, size, width, height, threshold,
            params.transmittance_min, params.depth, space[i], entries[i], rgb, transmittance,
            transmittance if depth is None else depth,
        ),
    )  # fmt: skip
    if not all(good):
        raise KernelError("composite: Bins.splat_ids points outside the splats")
    return Frame(rgb, transmittance, depth)
