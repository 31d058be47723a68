"""Readers that do what no reader may; run as a program, it prints what is found of each.

python -m tests.fuzz.wrong    # {"name": "kind: text", ...}; "" where nothing is

A second line is of those that take memory, with bytes counted.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.fuzz import contract
from tests.io.splatwriter import drawn, write_splat
from tsplat.core.errors import SceneError
from tsplat.io import load_scene

OPEN = []


def raises(path):
    return {}[path.name]


def wrong_family(path):
    raise ValueError(f"{path}: expected something else")


def believes_a_claim(path):
    room = np.empty(1 << 31, np.uint8)
    return load_scene(path) if len(room) else None


def hides_a_claim(path):
    try:
        np.empty(1 << 31, np.uint8)
    except MemoryError as error:
        raise SceneError(f"{path}: not enough memory; load fewer, expected less") from error
    return load_scene(path)


def fills_memory(path):
    np.ones(200 << 20, np.uint8)
    return load_scene(path)


def loops(path):
    while True:
        pass


def swallows(path):
    while True:
        try:
            while True:
                pass
        except Exception:
            pass


def waits(path):
    os.mkfifo(path.parent / "pipe")
    return (path.parent / "pipe").read_bytes()


def not_a_number(path):
    scene = load_scene(path)
    scene.means[0, 0] = np.nan
    return scene


def long_quaternions(path):
    scene = load_scene(path)
    return replace(scene, quats=scene.quats * np.float32(2))


def leaves_open(path):
    OPEN.append(path.open("rb"))
    return load_scene(path)


def forgets_to_close(path):
    path.open("rb")
    return load_scene(path)


def reads_another(path):
    (path.parent.parent / "other").read_bytes()
    return load_scene(path)


def writes(path):
    (path.parent / "made").write_bytes(b"")
    return load_scene(path)


def warns(path):
    warnings.warn("something", UserWarning, stacklevel=1)
    return load_scene(path)


def two_lines(path):
    raise SceneError(f"{path}: expected\nless")


def endless_line(path):
    raise SceneError(f"{path}: expected {'x' * 999}")


def nameless(path):
    raise SceneError("expected something else")


def helpless(path):
    raise SceneError(f"{path}: no")


def right(path):
    return load_scene(path)


def refuses(path):
    raise SceneError(f"{path}: expected something else")


WRONG = (
    raises, wrong_family, believes_a_claim, hides_a_claim, fills_memory, loops, swallows, waits,
    not_a_number, long_quaternions, leaves_open, forgets_to_close, reads_another, writes, warns,
    two_lines, endless_line, nameless, helpless,
)  # fmt: skip
GREEDY = (believes_a_claim, hides_a_claim, fills_memory)
RIGHT = (right, refuses)


def found(guard: contract.Guard, path: Path, read, **more) -> str:
    """What the guard says."""
    try:
        guard.load(path, read, **more)
    except contract.Finding as finding:
        return str(finding)
    return ""


def main() -> None:
    contract.SECONDS, contract.TICK, contract.TICKS_MAX = 0.1, 0.5, 4
    with tempfile.TemporaryDirectory() as folder:
        inside = Path(folder) / "case"
        inside.mkdir()
        (Path(folder) / "other").touch()
        path = inside / "a.splat"
        write_splat(path, drawn(9))
        load_scene(path)
        guard = contract.Guard(inside)
        guard.load(path, load_scene)
        guard.load(path, load_scene, precisely=True)
        guard.arm()
        for readers, more in ((WRONG, {}), (GREEDY, {"precisely": True})):
            json.dump(
                {r.__name__: found(guard, path, r, **more) for r in (*RIGHT, *readers)}, sys.stdout
            )
            print(flush=True)


if __name__ == "__main__":
    main()
