"""The fuzzer finds what it is for, and finds nothing in the readers as they are.

Everything runs in processes of its own: a guard stays in a process for good. $TSPLAT_FUZZ_RUNS
executions of each reader, 150 unless it is set; more, and by coverage: docs/fuzzing.md.
"""

from __future__ import annotations

import json
import os
import random
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.fuzz import mutators, seeds, wrong
from tsplat.io import load_scene

RUNS = int(os.environ.get("TSPLAT_FUZZ_RUNS", "150"))
pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's /proc")

KINDS = {
    "raises": "exception: KeyError", "wrong_family": "exception: ValueError",
    "believes_a_claim": "exception: MemoryError|memory", "hides_a_claim": "memory",
    "fills_memory": "exception: MemoryError|memory", "loops": "time", "swallows": "time",
    "waits": "time", "not_a_number": "scene: unsound: means",
    "long_quaternions": "scene: unsound: quats", "leaves_open": "side effect: .*left open",
    "forgets_to_close": "side effect: ResourceWarning", "reads_another": "side effect: .*/other",
    "writes": "side effect: .*/made", "warns": "exception: UserWarning",
    "two_lines": "line: not one printable line", "endless_line": "line: not one printable line",
    "nameless": "line: does not begin", "helpless": "line: neither expectation nor remedy",
}  # fmt: skip


def python(*arguments: str) -> str:
    """What a Python of its own prints."""
    done = subprocess.run(
        [sys.executable, "-m", *arguments], cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, "TSPLAT_PLUGINS": "", "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def faults():
    """Of each reader of ``wrong.py`` what is found: by the process's map, and by counted bytes."""
    return [json.loads(line) for line in python("tests.fuzz.wrong").splitlines()]


@pytest.mark.parametrize("name", KINDS)
def test_what_no_reader_may_is_found(faults, name):
    """Each wrong reader, by the fault that it has, however memory is watched."""
    for found in faults:
        if name in found:
            assert re.match(KINDS[name], found[name], re.DOTALL), found[name]


def test_what_readers_may_is_not(faults):
    """A Scene and a refusal are no findings; every wrong reader is looked at above."""
    assert [found[name] for found in faults for name in ("right", "refuses")] == [""] * 4
    assert {*faults[0]} - {"right", "refuses"} == set(KINDS)
    assert {*faults[1]} - {"right", "refuses"} == {r.__name__ for r in wrong.GREEDY}


@pytest.mark.parametrize("reader", seeds.READERS)
def test_damaged_files_are_refused_or_read(tmp_path, reader):
    """Whatever is done to files of the tests' writers, the readers keep to what they may."""
    python("tests.fuzz", reader, "--runs", str(RUNS), "--state", str(tmp_path))
    counts = json.loads((tmp_path / f"{reader}-random.json").read_text())
    assert counts["findings"] == {}
    assert counts["executions"] >= RUNS
    assert 0 < counts["scenes"] < counts["executions"]


def test_files_that_change_while_they_are_read():
    """Cut or grown between two of the times that they are opened: a Scene or a refusal."""
    found = json.loads(python("tests.fuzz.cut"))
    assert set(found) == set(seeds.READERS)
    for counts in found.values():
        assert counts["faults"] == []
        assert counts["refused"] >= 5, "some cuts came in time"
        assert counts["read"] >= 5, "some came too late"


def test_counts_go_on_from_where_they_were(tmp_path):
    """A second run adds to the first, up to a total; the table shows it."""
    for total in ("60", "90"):
        python("tests.fuzz", "splat", "--total", total, "--state", str(tmp_path))
    assert re.search(
        r"splat +random +90 ", python("tests.fuzz", "--report", "--state", str(tmp_path))
    )


@pytest.mark.parametrize("reader", seeds.READERS)
def test_seeds_are_scenes_and_mutations_are_repeated(tmp_path, reader):
    """Mutation starts from files that are read; the same random numbers make the same damage."""
    (tmp_path / "folder").mkdir()
    made = seeds.written(reader)
    for content in made:
        assert len(load_scene(seeds.lay_out(tmp_path, reader, content))) > 0
    mutate = mutators.mutator(reader, made)
    rounds = [[mutate(random.Random(i), made[i % len(made)]) for i in range(40)] for _ in range(2)]
    assert rounds[0] == rounds[1]
    assert len(set(rounds[0])) > 30
