"""Interpolation in C; the formula is that of ``tsplat/quality/upscale.py``."""

from __future__ import annotations

import numpy as np

from tsplat.backends.cffi._kernel import ffi, lib
from tsplat.backends.cffi.call import check, pointer
from tsplat.core.types import Frame
from tsplat.core.workspace import Workspace
from tsplat.quality.upscale import layers, room, taps


def upscale(frame: Frame, width: int, height: int, workspace: Workspace) -> Frame:
    """See :class:`tsplat.core.stages.Upscale`."""
    out = room(frame, width, height, workspace)
    (columns, column_weights), (rows, row_weights) = (
        taps(frame.width, width), taps(frame.height, height),
    )  # fmt: skip
    for small, large, most in layers(frame, out):
        channels = small.shape[2]
        source = np.ascontiguousarray(small, np.float32)
        size = (workspace.threads, frame.width * channels + 1)
        scratch = workspace.array("cffi.upscale", size, np.float32)
        layer = ffi.new(
            "tsplat_layer *",
            {
                "small": pointer(source, "float"), "large": pointer(large, "float"),
                "columns": pointer(columns, "int32_t"), "rows": pointer(rows, "int32_t"),
                "column_weights": pointer(column_weights, "float"),
                "row_weights": pointer(row_weights, "float"),
                "width": frame.width, "height": frame.height, "channels": channels,
                "out_width": width, "out_height": height, "most": most,
            },
        )  # fmt: skip
        check(lib.tsplat_upscale(layer, pointer(scratch, "float"), workspace.threads), "upscale")
    return out
