"""Files cut or grown between two of the times that a reader opens them; run as a program.

python -m tests.fuzz.cut    # {reader: {"refused": n, "read": n, "faults": [...]}, ...}
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import warnings
from pathlib import Path

from tests.fuzz import seeds
from tests.fuzz.mutators import FOLDER
from tsplat.core.errors import SceneError
from tsplat.io import load_scene


class Cut:
    """Changes the size of a file as it is opened for the ``turn``-th time."""

    def __init__(self, path: Path, turn: int, size: int) -> None:
        self.path, self.turn, self.size = path, turn, size


def main() -> None:
    warnings.simplefilter("error")
    cut: Cut | None = None

    def opened(event: str, args: tuple) -> None:
        if cut is not None and event == "open" and str(args[0]) == str(cut.path):
            cut.turn -= 1
            if cut.turn == 0:
                os.truncate(cut.path, cut.size)

    sys.addaudithook(opened)
    found = {reader: {"refused": 0, "read": 0, "faults": []} for reader in seeds.READERS}
    with tempfile.TemporaryDirectory() as folder:
        for reader, content in ((r, c) for r in seeds.READERS for c in seeds.written(r)[:4]):
            if content.startswith(FOLDER):
                continue
            counts: dict = found[reader]
            whole = len(content)
            for turn in (2, 3, 4):
                for size in (0, 10, whole // 2, whole - 1, whole + 1, 2 * whole):
                    path = seeds.lay_out(Path(folder), reader, content)
                    cut = Cut(path, turn, size)
                    try:
                        load_scene(path)
                        counts["read"] += 1
                    except SceneError as error:
                        counts["refused"] += str(error).isprintable()
                    except BaseException as error:
                        counts["faults"].append(f"{turn} {size} {error!r}")
                    cut = None
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
