"""How kernels are compiled, and how they are spread over threads.

A kernel works on a range of its input and holds no lock, so that plain Python threads run it in
parallel. Unlike numba's own parallel loops that takes any number of threads, adds nothing to
compile time, and leaves the order of every sum to the kernel: the bits do not depend on it.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

from tsplat.core import constants

_F = TypeVar("_F", bound=Callable[..., Any])
_R = TypeVar("_R")

_config: Any = numba.config

OPTIONS: dict[str, Any] = {
    "nogil": True,
    # In words: off. It would let LLVM fuse and reorder sums, but depths must have the same bits
    # in every backend (their order and ties follow from them), and NaN tests must stay tests.
    # Where fusing is safe, a kernel says so with simd.fma.
    "fastmath": False,
    "error_model": "numpy",  # no ZeroDivisionError; also what lets loops become vectors
    "boundscheck": False,
}


def _cache_folder() -> str:
    """Where numba may keep what it compiled: one folder for each state of the kernels' sources.

    By itself numba drops what it cached when the function's own file changes, not when what it
    calls or imports does.
    """
    here = Path(__file__).parent
    sources = [*sorted(here.glob("*.py")), Path(constants.__file__)]
    state = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    if os.access(here, os.W_OK):
        usual = here / "__pycache__"
    else:
        usual = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tsplat"
    return str(Path(_config.CACHE_DIR or usual) / f"kernels-{state}")


_CACHE_FOLDER = _cache_folder()


def kernel(function: _F) -> _F:
    """``function`` compiled on its first call, then read from numba's cache on disk."""
    before, _config.CACHE_DIR = _config.CACHE_DIR, _CACHE_FOLDER
    try:
        compiled: Any = numba.njit(cache=True, **OPTIONS)(function)
    except (RuntimeError, OSError):  # nowhere to write a cache: compile in every process
        compiled = numba.njit(**OPTIONS)(function)
    finally:
        _config.CACHE_DIR = before
    return cast(_F, compiled)


class _Notice(event.Listener):
    """Says once, on a terminal, why the first frame takes seconds."""

    said = False

    def on_start(self, event: Any) -> None:
        """A compilation begins, which no cache could spare."""
        owner = getattr(event.data.get("dispatcher"), "__module__", None) or ""
        if not self.said and owner.startswith(__package__ or "?") and sys.stderr.isatty():
            self.said = True
            print(  # noqa: T201
                "tsplat: compiling the numba kernels (once; cached afterwards) ...",
                file=sys.stderr, flush=True,
            )  # fmt: skip

    def on_end(self, event: Any) -> None:
        """Nothing to say."""


cast(Any, event).register("numba:compile", _Notice())

_pools: dict[int, ThreadPoolExecutor] = {}
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pools.clear)  # threads do not survive a fork


def spread(threads: int, pieces: int, job: Callable[[int], _R]) -> list[_R]:
    """``[job(0), ..., job(pieces - 1)]``, on ``threads`` threads."""
    if threads == 1 or pieces <= 1:
        return [job(i) for i in range(pieces)]
    pool = _pools.get(threads)
    if pool is None:
        pool = _pools.setdefault(threads, ThreadPoolExecutor(threads, "tsplat-numba"))
    return list(pool.map(job, range(pieces)))
