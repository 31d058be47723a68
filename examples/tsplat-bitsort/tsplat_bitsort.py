"""A tsplat backend that offers one stage: it sorts by the bits of the depth."""

import numpy as np

from tsplat import Backend, Splats, Stages, Workspace, break_ties, hookimpl


def sort(splats: Splats, workspace: Workspace) -> np.ndarray:
    """See tsplat.core.stages.Sort. Positive float32s order like their bits."""
    keys = splats.depths.view(np.uint32).astype(np.uint64) << np.uint64(32)
    keys |= np.arange(len(splats), dtype=np.uint64)
    keys.sort()
    order = (keys & np.uint64(0xFFFFFFFF)).astype(np.int32)
    return break_ties(order, splats.depths, splats.numbers)


BITSORT = Backend(
    name="bitsort",
    summary="sorts 64-bit (depth, index) keys",
    load=lambda: Stages(sort=sort),  # on first use; heavy imports would go in here
    stages=("sort",),
)


@hookimpl
def tsplat_backends() -> list[Backend]:
    return [BITSORT]
