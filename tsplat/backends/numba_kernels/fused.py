"""The geometry of a whole frame: Gaussians to records and boxes, while their splats are cached."""

from __future__ import annotations

from tsplat.backends.numba_kernels.composite import pack_splats
from tsplat.backends.numba_kernels.jit import kernel
from tsplat.backends.numba_kernels.order import box_tiles
from tsplat.backends.numba_kernels.project import project_rows
from tsplat.backends.numba_kernels.simd import item, put
from tsplat.core.types import F32, F64, I32, I64

CHUNK = 256  # Gaussians between two looks at their splats: what the first-level cache holds


@kernel
def project_records(
    first: int, last: int, means: F32, quats: F32, scales: F32, opacities: F32, sh: F32,
    view: F64, degree: int, antialias: bool, threshold: float, space: F32, space64: F64,
    means2d: F64, factors: F32, depths: F32, opacities2d: F32, colors: F32, radii: F32,
    gaussian_ids: I32, chunk_boxes: I64, width: int, height: int, records: F32, records64: F64,
    boxes: I64, all_depths: F32, ids: I32,
) -> tuple[int, int]:  # fmt: skip
    """Projects Gaussians ``first`` to ``last`` to rows of records, boxes, all_depths and ids
    from ``first`` on; returns how many are visible, and how many overflowed.

    The splats [CHUNK] and their boxes are lent; for the rest see the three stages.
    """
    row, overflowed = first, 0
    for start in range(first, last, CHUNK):
        count, over = project_rows(
            start, min(start + CHUNK, last), 0, means, quats, scales, opacities, sh, view, degree,
            antialias, threshold, space, space64, means2d, factors, depths, opacities2d, colors,
            radii, gaussian_ids,
        )  # fmt: skip
        pack_splats(
            0, count, means2d, factors, depths, opacities2d, colors, records[row:], records64[row:]
        )
        box_tiles(0, count, means2d, radii, width, height, chunk_boxes)
        for i in range(count):  # a slice would cost ten seconds of compiling
            put(boxes, row + i, item(chunk_boxes, i))
            put(all_depths, row + i, item(depths, i))
            put(ids, row + i, item(gaussian_ids, i))
        row += count
        overflowed += over
    return row - first, overflowed
