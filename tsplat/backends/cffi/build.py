"""Builds the C kernel with cffi in API mode; run by setup.py, importable without NumPy.

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


def declarations() -> str:
    """``kernel.h`` without its preprocessor lines, as cffi's cdef."""
    text = (HERE / "kernel.h").read_text()
    return "".join(line for line in text.splitlines(True) if not line.startswith("#"))


def make_ffi(compile_args: list[str], link_args: list[str]) -> Any:
    """The ffi builder of the extension module; paths are relative to the project's root."""
    from cffi import FFI

    ffi = FFI()
    ffi.cdef(declarations())
    here = HERE.relative_to(ROOT)
    ffi.set_source(
        MODULE,
        '#include "kernel.h"',
        sources=[(here / "kernel.c").as_posix()],
        include_dirs=[here.as_posix()],
        depends=[(here / name).as_posix() for name in sorted(p.name for p in HERE.glob("*.h"))],
        extra_compile_args=compile_args,
        extra_link_args=link_args,
    )
    return ffi


if __name__ == "__main__":
    if sys.argv[1:] != ["--constants"]:
        sys.exit(__doc__)
    (HERE / "constants.h").write_text(constants_h())
