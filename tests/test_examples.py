"""The two example distributions, installed into a venv of their own and used from there."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import sysconfig
import venv

import pytest

from tests.conftest import ROOT
from tests.viewer.session import Session

EXAMPLES = ("tsplat-bitsort", "tsplat-ascii")
FEW = ("--max-splats", "5000")  # of the demo's: the float64 reference takes its time


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The interpreter of a fresh venv that sees this one's packages, examples installed by pip."""
    home = tmp_path_factory.mktemp("venv")
    venv.create(home, with_pip=False, symlinks=True)
    paths = sysconfig.get_paths(vars={"base": str(home), "platbase": str(home)})
    here = [sysconfig.get_paths()["purelib"], str(ROOT)]
    hook = "".join(f"import site; site.addsitedir({path!r})\n" for path in here)
    (home / paths["purelib"] / "outer.pth").write_text(hook)
    interpreter = home / "bin" / "python"
    sources = [
        shutil.copytree(ROOT / "examples" / name, home / "source" / name) for name in EXAMPLES
    ]
    wheels = home / "wheels"
    offline = ["--quiet", "--no-deps", "--no-index", "--disable-pip-version-check"]
    pip = [interpreter, "-m", "pip"]
    for command in (
        ["wheel", *offline, "--no-build-isolation", "--wheel-dir", wheels, *sources],
        ["install", *offline, "--find-links", wheels, *EXAMPLES],
    ):
        subprocess.run([*pip, *command], check=True, capture_output=True)
    return interpreter


def tsplat(python, *words, cwd=None):
    """Runs tsplat in that venv; what it wrote to stdout."""
    result = subprocess.run(
        [python, "-m", "tsplat", *map(str, words)], capture_output=True, check=True, cwd=cwd
    )
    return result.stdout


def test_installed_plugins_are_listed(python):
    """`tsplat plugins` shows both, with the distribution that brought them; elsewhere neither."""
    facts = json.loads(tsplat(python, "plugins", "--json"))
    rows = {row["name"]: row for row in facts["backends"] + facts["presenters"]}
    assert rows["bitsort"]["distribution"] == "tsplat-bitsort"
    assert rows["bitsort"]["stages"] == ["sort"]
    assert rows["ascii"]["distribution"] == "tsplat-ascii"
    assert facts["problems"] == []
    assert b"bitsort" not in tsplat(sys.executable, "plugins", "--json")


def test_the_backend_runs_its_stage_and_keeps_the_contract(python, tmp_path):
    """--backend bitsort sorts with it and fills in the rest; check agrees."""
    out = tmp_path / "x.png"
    facts = json.loads(
        tsplat(python, "render", "-o", out, "--size", "64x40", "--backend", "bitsort", "--json")
    )
    assert facts["backend"]["sort"] == "bitsort"
    assert facts["backend"]["composite"] == "cffi"
    checked = json.loads(
        tsplat(python, "check", *FEW, "--backend", "bitsort", "--size", "64x40", "--json")
    )
    assert checked["passed"] is True
    assert {c["check"] for c in checked["checks"]} == {"sort", "picture", "bits", "memory"}


def commands(page):
    """The command lines of a page in docs."""
    text = (ROOT / "docs" / page).read_text()
    lines = "".join(re.findall(r"```sh\n(.*?)```", text, re.S)).splitlines()
    assert lines
    return [line.split() for line in lines]


@pytest.mark.parametrize("page", ["backends.md", "presenters.md"])
def test_the_tutorials_commands_run(python, tmp_path, page):
    """Each command of the page does what the page says, of few examples; the proofs pass."""
    for program, *words in commands(page):
        assert program == "tsplat"
        drawn = words[0] == "check" and ("--full" in words or "--presenter" in words)
        more: tuple[str, ...] = ("--examples", "2", "--json") if drawn else ()
        if words[0] == "check" and not drawn:
            more = FEW
        said = tsplat(python, *words, *more, cwd=tmp_path)
        if drawn:
            facts = json.loads(said)
            assert facts["passed"] is True
            assert {check["verdict"] for check in facts["checks"]} == {"holds"}
            assert {check["name"] for check in facts["checks"]} <= {"bitsort", "ascii"}


@pytest.mark.parametrize("name", EXAMPLES)
def test_their_own_tests_pass(python, name):
    """Each example's test file passes where it is installed."""
    folder = ROOT / "examples" / name
    result = subprocess.run(
        [python, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", folder],
        capture_output=True,
        cwd=python.parent, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stdout.decode()


def test_the_presenter_shows_a_picture(python):
    """The viewer draws through it: rows of characters from its ramp."""
    session = Session("--presenter", "ascii", "--max-splats", "2000", python=python)
    try:
        session.pump(lambda: session.frames() >= 1)
        shown = session.output[session.output.index(b"\x1b[?2026h") :]
        assert sum(shown.count(character) for character in (b".", b":", b"#", b"@")) > 20
        session.press(b"q")
        session.end(0)
    finally:
        session.close()
