"""Terminals that stay open for a file's tests, and pictures to compare their screens with."""

from __future__ import annotations

import json
import math
import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.real.desk import Make, Terminal, opened, tsplat
from tsplat.core.camera import intrinsics
from tsplat.demo import demo_scene
from tsplat.io.cameras import camera_to_json
from tsplat.views import FOV, YAW, frame_scene

ASIDE = math.radians(20)
COLUMNS, ROWS = 80, 25  # of which the last is the status line's
HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All of these are marked ``real``."""
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.real)


@pytest.fixture(scope="module")
def terminal(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[Make], Terminal]]:
    """Opens a terminal, or gives the one that is open already."""
    with ExitStack() as stack:

        @cache
        def get(make: Make) -> Terminal:
            folder = tmp_path_factory.mktemp(make.name)
            return stack.enter_context(opened(make, folder, COLUMNS, ROWS))

        yield get


class Pictures:
    """What ``tsplat render`` makes of the demo scene, from cameras worked out here."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._scene = folder, demo_scene()
        self._made: dict[tuple[str, ...], np.ndarray] = {}

    def camera(self, first: tuple[int, int], window: tuple[int, int], aside: bool = False) -> Path:
        """A file with the camera that frames the scene in ``first`` px, in a window of any size.

        ``aside``: from farther round.
        """
        camera = frame_scene(self._scene, *first, yaw=YAW + ASIDE * aside)
        camera = replace(camera, K=intrinsics(*window, FOV), width=window[0], height=window[1])
        file = self._folder / "{}x{}-{}x{}-{}.json".format(*first, *window, aside)
        file.write_text(json.dumps([camera_to_json(camera)]))
        return file

    def render(self, *words: object) -> np.ndarray:
        """By the program; uint8 [H, W, 3]."""
        key = tuple(map(str, words))
        if key not in self._made:
            out = self._folder / f"{len(self._made)}.png"
            subprocess.run([*tsplat(), "render", "-o", out, *key], check=True, capture_output=True)
            with Image.open(out) as image:
                self._made[key] = np.asarray(image.convert("RGB"))
        return self._made[key]

    def framed(self, size: tuple[int, int]) -> np.ndarray:
        """The default view."""
        return self.render("--size", "{}x{}".format(*size))


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Pictures:
    """One picture of a kind is rendered once."""
    return Pictures(tmp_path_factory.mktemp("pictures"))


@pytest.fixture(scope="session", autouse=True)
def report() -> Iterator[dict[str, float]]:
    """PSNR per terminal and presenter; printed at the end where $TSPLAT_REAL_REPORT says so."""
    found: dict[str, float] = {}
    yield found
    if place := os.environ.get("TSPLAT_REAL_REPORT"):
        Path(place).write_text("".join(f"{name}: {value:.2f}\n" for name, value in found.items()))
