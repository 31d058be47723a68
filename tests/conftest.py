"""What every test needs: hypothesis settings, real scenes where they are, small scenes."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from tsplat.core.camera import Camera, intrinsics
from tsplat.core.types import Scene
from tsplat.core.workspace import default_threads

settings.register_profile(
    "tsplat", deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)
settings.load_profile("tsplat")

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("TSPLAT_DATA") or ROOT.parent / "shared" / "data")
SH_C0 = 0.28209479177387814


def gaussians(means, scales=0.1, opacities=0.8, colors=(1.0, 0.5, 0.25), quats=None, sh=None):
    """A scene from as little as means; scalars and single rows are repeated."""
    means = np.atleast_2d(np.asarray(means, np.float32)).reshape(-1, 3)
    n = len(means)
    if quats is None:
        quats = (1, 0, 0, 0)
    if sh is None:
        sh = (np.broadcast_to(colors, (n, 3))[:, None, :] - 0.5) / SH_C0

    def rows(value, *shape):
        value = np.asarray(value, np.float32)
        if value.ndim == 1 and shape and len(value) == n != shape[0]:
            value = value[:, None]
        return np.ascontiguousarray(np.broadcast_to(value, (n, *shape)))

    return Scene(
        means, rows(quats, 4), rows(scales, 3), rows(opacities),
        np.ascontiguousarray(np.asarray(sh, np.float32)),
    )  # fmt: skip


def straight(width=21, height=21, focal=100.0, **kwargs):
    """A camera at the origin that looks along +z, square pixels, centred."""
    k = intrinsics(width, height, 90)
    k[0, 0] = k[1, 1] = focal
    return Camera(np.eye(4), k, width, height, **kwargs)


def hear_signals():
    """For a child before exec: signals that nohup or a background shell ignored are heard again."""
    for signum in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, signal.SIG_DFL)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config):
    """The suite is shared out among processes, up to four; a file or a test alone is not."""
    return min(4, default_threads()) if config.args == ["tests"] else 0


@pytest.fixture(scope="session")
def data():
    """The folder of real scenes; a test that needs it is skipped where it is not there."""
    if not DATA.is_dir():
        pytest.skip(f"no real scenes at {DATA}; set TSPLAT_DATA")
    return DATA
