"""The C kernel touches no byte before or after the arrays it is lent.

AddressSanitizer does not see that: arrays of a Workspace are parts of larger buffers, and vector
instructions may read past what it watches.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys

import pytest

from tests.conftest import ROOT
from tsplat.backends.cffi import isa

pytestmark = pytest.mark.skipif(os.name != "posix", reason="guard pages need mmap and mprotect")

FAULTS = (-signal.SIGSEGV, -signal.SIGBUS)  # the latter on macOS


def child(*args, tests="backends"):
    """``guarded.py`` of a folder of tests in a process of its own, since a guard page kills."""
    return subprocess.run(
        [sys.executable, "-X", "faulthandler", "-m", f"tests.{tests}.guarded", *map(str, args)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("side", ["begin", "end"])
@pytest.mark.parametrize("name", isa.offered())
def test_the_kernel_stays_within_its_arrays(name, side):
    """With a guard page at this side of every array the pictures have the same bits as without."""
    args = "render", name, side, random.randrange(2**32)
    run = child(*args)
    assert run.returncode == 0, f"{args}: exit code {run.returncode}\n{run.stderr[-4000:]}"


@pytest.mark.parametrize("place", ["before", "after", "sort"])
def test_a_touched_guard_page_kills(place):
    """One byte before or after an array does it, and so does the kernel when told a wrong count."""
    assert child("touch", place).returncode in FAULTS


@pytest.mark.parametrize("place", ["first", "last"])
def test_a_guarded_array_may_be_used_to_its_ends(place):
    """Its first and its last byte are writable: what kills is the page beside it."""
    assert child("touch", place).returncode == 0


def test_every_array_goes_through_pointer():
    """An address is taken in call.pointer alone, where the guards are put."""
    folder = ROOT / "tsplat" / "backends" / "cffi"
    found = [path.name for path in folder.glob("*.py") for line in path.read_text().splitlines()
             if "ctypes.data" in line or "from_buffer" in line]  # fmt: skip
    assert found == ["call.py"]
