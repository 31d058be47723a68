"""What is under the cursor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tsplat.core.camera import Camera
from tsplat.core.types import F64
from tsplat.core.workspace import Workspace
from tsplat.plan import make_plan
from tsplat.viewer.engine import Prepared

WINDOW = 21  # px each way that are looked at
SEEN = 0.05  # of the light at least that must come from splats


def point_under(prepared: Prepared, camera: Camera, x: float, y: float) -> F64 | None:
    """Where in the world [3] the splats at px (x, y) of ``camera``'s picture are; None: no splats.

    Their depth is the mean of what is drawn, weighted by how much of it is seen, in the nearest of
    a few pixels about (x, y) that show anything.
    """
    K = camera.K.copy()
    K[:2, 2] -= np.array([x, y]) - WINDOW / 2
    small = Camera(camera.viewmat, K, WINDOW, WINDOW, camera.near, camera.far)
    plan = prepared.plan
    params = replace(plan.asked, depth=True, scale=1.0)
    names = ",".join(f"{stage}={name}" for stage, name in plan.backends.items())
    depth_plan = make_plan(prepared.scene, backend=names, threads=plan.threads, params=params)
    frame = depth_plan.run(prepared.scene, small, Workspace(plan.threads)).frame
    assert frame.depth is not None
    seen = 1 - frame.transmittance
    rows, columns = np.nonzero(seen > SEEN)
    if not len(rows):
        return None
    middle = (WINDOW - 1) / 2
    nearest = int(np.argmin((rows - middle) ** 2 + (columns - middle) ** 2))
    row, column = int(rows[nearest]), int(columns[nearest])
    z = float(frame.depth[row, column] / seen[row, column])
    return _at(small, column + 0.5, row + 0.5, z)


def _at(camera: Camera, x: float, y: float, z: float) -> F64:
    (fx, _, cx), (_, fy, cy), _ = camera.K
    ray = np.array([(x - cx) / fx, (y - cy) / fy, 1.0])
    return np.asarray(camera.centre + camera.rotation.T @ (z * ray), np.float64)
