"""Builds what is in C with cffi in API mode; run by setup.py, importable without NumPy.

python -m tsplat.backends.cffi.build --constants    # rewrite constants.h from constants.py
"""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
CONSTANTS = HERE.parents[1] / "core" / "constants.py"
MODULE = "tsplat.backends.cffi._kernel"
DECODER = "tsplat.io._decode"
UNPACKER = "tsplat.io._unpack"
ENCODER = "tsplat.presenters._encode"


def constants_h() -> str:
    """The text of ``constants.h``: every number of ``core/constants.py`` as a #define."""
    lines = ["/* Written by `python -m tsplat.backends.cffi.build --constants`; do not edit. */"]
    for name, value in runpy.run_path(str(CONSTANTS)).items():
        if not re.fullmatch(r"[A-Z][A-Z0-9_]*", name):
            continue
        if isinstance(value, tuple):
            lines += [f"#define {name}_{i} {item!r}" for i, item in enumerate(value)]
        else:
            lines.append(f"#define {name} {value!r}")
    return "\n".join(lines) + "\n"


def declarations(header: Path) -> str:
    """``header`` without its preprocessor lines, as cffi's cdef."""
    return "".join(line for line in header.read_text().splitlines(True) if line[0] != "#")


def make_ffi(compile_args: list[str], link_args: list[str], module: str = MODULE) -> Any:
    """The ffi builder of an extension module; paths are relative to the project's root.

    Module ``a.b._c`` is made of a/b/c.c and its interface a/b/c.h.
    """
    from cffi import FFI

    *package, name = module.split(".")
    folder = Path(*package)
    header = folder / f"{name[1:]}.h"
    ffi = FFI()
    ffi.cdef(declarations(ROOT / header))
    ffi.set_source(
        module,
        f'#include "{header.name}"',
        sources=[header.with_suffix(".c").as_posix()],
        include_dirs=[folder.as_posix()],
        depends=[(folder / p.name).as_posix() for p in sorted((ROOT / folder).glob("*.h"))],
        extra_compile_args=compile_args,
        extra_link_args=link_args,
    )
    return ffi


if __name__ == "__main__":
    if sys.argv[1:] != ["--constants"]:
        sys.exit(__doc__)
    (HERE / "constants.h").write_text(constants_h())
