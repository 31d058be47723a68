"""The kernels as stages: check arrays, lend buffers, spread the work, turn faults into errors."""

from __future__ import annotations

import time
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsplat.backends.numba_kernels import composite as pixels
from tsplat.backends.numba_kernels import fused as whole
from tsplat.backends.numba_kernels import order as lists
from tsplat.backends.numba_kernels import project as geometry
from tsplat.backends.numba_kernels.jit import spread
from tsplat.core.camera import Camera
from tsplat.core.constants import ALPHA_FLOOR, CLAMP_MARGIN
from tsplat.core.errors import KernelError, check_array
from tsplat.core.params import RenderParams
from tsplat.core.stages import STAGES, Counts
from tsplat.core.ties import break_ties
from tsplat.core.types import F32, F64, I32, I64, Bins, Frame, Scene, Splats
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


def _view(camera: Camera, scene: Scene, params: RenderParams) -> F64:
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    width, height = camera.width, camera.height
    margin_x, margin_y = CLAMP_MARGIN * width / (2 * fx), CLAMP_MARGIN * height / (2 * fy)
    return np.array([
        *camera.rotation.ravel(), *(camera.centre - scene.origin), fx, fy, cx, cy,
        camera.near, camera.far,
        -cx / fx - margin_x, (width - cx) / fx + margin_x,
        -cy / fy - margin_y, (height - cy) / fy + margin_y,
        width, height, params.depth_split, params.low_pass,
    ], np.float64)  # fmt: skip


class _Projection:
    """What projecting takes, but for the memory that splats go to."""

    def __init__(
        self, scene: Scene, camera: Camera, params: RenderParams, workspace: Workspace
    ) -> None:
        n, lanes = len(scene), geometry.LANES
        self.threads = workspace.threads if n > _FEW else 1
        pieces = _runs(-(-n // lanes), _pieces(self.threads))
        self.runs = [(lanes * i, min(lanes * j, n)) for i, j in pieces]
        sh = workspace.float32(scene.sh)
        gaussians = (scene.means, scene.quats, scene.scales, scene.opacities, sh)
        self._shared = (
            *(_at_least(lanes, array) for array in gaussians), _view(camera, scene, params),
            min(params.sh_degree, scene.sh_degree), params.antialias,
            max(params.alpha_threshold, ALPHA_FLOOR),
        )  # fmt: skip
        runs = len(self.runs)
        self._space = workspace.array("numba.project", (runs, geometry.SPACE), np.float32)
        self._space64 = workspace.array("numba.project64", (runs, 2 * lanes), np.float64)

    def arguments(self, run: int) -> tuple[Any, ...]:
        """What a run of Gaussians takes."""
        return (*self._shared, self._space[run], self._space64[run])


def project(scene: Scene, camera: Camera, params: RenderParams, workspace: Workspace) -> Splats:
    """See :class:`tsplat.core.stages.Project`."""
    p = _Projection(scene, camera, params, workspace)
    arrays = {
        name: workspace.array(f"numba.{name}", (len(scene), *shape), dtype)
        for name, shape, dtype in _SPLAT_ARRAYS
    }
    counts = spread(
        p.threads, len(p.runs),
        lambda i: geometry.project_rows(
            *p.runs[i], p.runs[i][0], *p.arguments(i), *arrays.values()
        ),
    )  # fmt: skip
    m = 0
    for (first, _), (visible, _) in zip(p.runs, counts, strict=True):
        if m < first:  # closes the gap that Gaussians out of sight leave
            for array in arrays.values():
                array[m : m + visible] = array[first : first + visible]
        m += visible
    splats = {name: array[:m] for name, array in arrays.items()}
    overflowed = sum(overflowed for _, overflowed in counts)
    return Splats(
        **splats, width=camera.width, height=camera.height, overflowed=overflowed,
        numbers=scene.numbers_of(splats["gaussian_ids"]),
    )  # fmt: skip


def sort(splats: Splats, workspace: Workspace) -> I32:
    """See :class:`tsplat.core.stages.Sort`."""
    m = len(splats)
    depths: Any = check_array("Splats.depths", splats.depths, np.float32, (m,))
    order = _sort(depths, _runs(m, workspace.threads if m > _FEW else 1), workspace)
    return break_ties(order, depths, splats.numbers)


def _sort(depths: F32, runs: list[tuple[int, int]], workspace: Workspace) -> I32:
    """Rows of ``depths`` from near to far: those of ``runs``, which are in rising order."""
    bits = depths.view(np.uint32)
    used = [bits[first:last] for first, last in runs if first < last]
    least = min((int(b.min()) for b in used), default=0)
    length = max((max((int(b.max()) for b in used), default=0) - least).bit_length(), 1)
    digits = -(-length // lists.DIGIT_BITS)
    digit_bits = -(-length // digits)
    ends = list(accumulate(last - first for first, last in runs))
    m = ends[-1]
    order: I32 = workspace.array("numba.order", (m,), np.int32)
    pairs, spare = workspace.array("numba.pairs", (2, m), np.uint64)
    threads = workspace.threads if m > _FEW else 1
    histograms: I64 = workspace.array("numba.histograms", (threads, 1 << digit_bits), np.int64)
    spread(
        threads, len(runs),
        lambda i: lists.make_pairs(
            *runs[i], ends[i] - (runs[i][1] - runs[i][0]), bits, least, pairs
        ),
    )  # fmt: skip
    for digit in range(digits):
        out = order if digit == digits - 1 else spare
        _place_digit(lists.KEY + digit * digit_bits, pairs, out, _runs(m, threads), histograms)
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
    arrays, m, lanes = _arrays(splats), len(splats), lists.LANES
    check_array("order", order, np.int32, (m,))
    boxes = workspace.array("numba.boxes", (max(m, lanes),), np.int64)
    means2d, radii = _at_least(lanes, arrays["means2d"]), _at_least(lanes, arrays["radii"])
    threads = workspace.threads if m > _FEW else 1
    runs, width, height = _runs(m, threads), splats.width, splats.height
    spread(
        threads, threads, lambda i: lists.box_tiles(*runs[i], means2d, radii, width, height, boxes)
    )  # fmt: skip
    return _bin(order, boxes[:m], width, height, workspace)


def _bin(order: I32, boxes: I64, width: int, height: int, workspace: Workspace) -> Bins:
    """Lists the tiles of ``boxes`` in ``order``."""
    m, size = len(order), lists.TILE
    across, down = -(-width // size), -(-height // size)
    if max(across, down) > lists.TILES_MAX:
        most = lists.TILES_MAX * size
        raise KernelError(f"bin: expected at most {most} px a side, got {width}x{height}")
    threads = workspace.threads if m > _FEW else 1
    runs = _runs(m, threads)
    ordered = workspace.array("numba.ordered", (m,), np.int64)
    slots = workspace.array("numba.slots", (threads, down + 1, across + 1), np.int64)
    offsets = workspace.array("numba.offsets", (across * down + 1,), np.int64)
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
    if not 1 <= size <= TILE_SIZE_MAX:
        raise KernelError(f"composite: expected tiles of 1 to {TILE_SIZE_MAX} px, got {size}")
    tiles = -(-width // size) * -(-height // size)
    offsets = check_array("Bins.tile_offsets", bins.tile_offsets, np.int64, (tiles + 1,))
    check_array("Bins.splat_ids", bins.splat_ids, np.int32, (int(bins.tile_offsets[-1]),))
    if offsets[0] != 0 or (np.diff(offsets) < 0).any():
        raise KernelError("composite: Bins.tile_offsets must start at 0 and never fall")
    records = workspace.array("numba.records", (m, pixels.RECORD), np.float32)
    threads = workspace.threads if m > _FEW else 1
    rows = _runs(m, threads)
    opacities = _at_least(pixels.LANES, arrays["opacities"])
    spread(
        threads, threads,
        lambda i: pixels.pack_splats(
            *rows[i], arrays["means2d"], arrays["factors"], arrays["depths"], opacities,
            arrays["colors"], records, records.view(np.float64),
        ),
    )  # fmt: skip
    return _composite(records, bins, width, height, params, workspace)


def _composite(
    records: F32, bins: Bins, width: int, height: int, params: RenderParams, workspace: Workspace
) -> Frame:
    """The picture of packed splats."""
    threads, size = workspace.threads, bins.tile_size
    rgb = workspace.array("numba.rgb", (height, width, 3), np.float32)
    transmittance = workspace.array("numba.transmittance", (height, width), np.float32)
    depth = workspace.array("numba.depth", (height, width), np.float32) if params.depth else None
    # Extents end at the floor where there is no threshold.
    threshold = max(params.alpha_threshold, ALPHA_FLOOR)
    patches = (len(bins.tile_offsets) - 1) * (-(-size // pixels.SIDE)) ** 2
    runs = _runs(patches, min(patches, 16 * threads))
    space = workspace.array("numba.space", (len(runs), pixels.SPACE), np.float32)
    entries = workspace.array("numba.entries", (len(runs), pixels.LIST), np.int32)
    good = spread(
        threads, len(runs),
        lambda i: pixels.composite_patches(
            *runs[i], records, records.view(np.float64), bins.tile_offsets, bins.splat_ids, size,
            width, height, threshold, params.transmittance_min, params.depth, space[i], entries[i],
            rgb, transmittance, transmittance if depth is None else depth,
        ),
    )  # fmt: skip
    if not all(good):
        raise KernelError("composite: Bins.splat_ids points outside the splats")
    return Frame(rgb, transmittance, depth)


def fused(
    scene: Scene,
    camera: Camera,
    params: RenderParams,
    workspace: Workspace,
    everything: bool = False,
) -> tuple[Frame, Counts]:
    """See :class:`tsplat.core.stages.Fused`: splats are packed and boxed while they are cached.

    It leaves nothing out, so ``everything`` changes nothing.
    """
    clock = time.perf_counter
    times = [clock()]
    p = _Projection(scene, camera, params, workspace)
    n, pieces, width, height = len(scene), len(p.runs), camera.width, camera.height
    records = workspace.array("numba.records", (n, pixels.RECORD), np.float32)
    boxes = workspace.array("numba.boxes", (n,), np.int64)
    depths = workspace.array("numba.depths", (n,), np.float32)
    ids = workspace.array("numba.gaussian_ids", (n,), np.int32)
    chunk = [
        workspace.array(f"numba.chunk.{name}", (pieces, whole.CHUNK, *shape), dtype)
        for name, shape, dtype in (*_SPLAT_ARRAYS, ("boxes", (), np.int64))
    ]
    whole_frame: list[Any] = [width, height, records, records.view(np.float64), boxes, depths, ids]
    counts = spread(
        p.threads, pieces,
        lambda i: whole.project_records(
            *p.runs[i], *p.arguments(i), *(array[i] for array in chunk), *whole_frame
        ),
    )  # fmt: skip
    times.append(clock())
    visible = [(first, first + m) for (first, _), (m, _) in zip(p.runs, counts, strict=True)]
    order = _sort(depths, visible, workspace)
    if scene.numbers is not None:
        for first, last in visible:  # rows of the scene become their numbers
            ids[first:last] = scene.numbers[ids[first:last]]
        break_ties(order, depths, ids)
    times.append(clock())
    bins = _bin(order, boxes, width, height, workspace)
    times.append(clock())
    frame = _composite(records, bins, width, height, params, workspace)
    times.append(clock())
    seconds = {
        stage: end - start for stage, (start, end) in zip(STAGES, pairwise(times), strict=True)
    }
    overflowed = sum(overflowed for _, overflowed in counts)
    return frame, Counts(len(order), len(bins), overflowed, seconds)
