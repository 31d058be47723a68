"""``tsplat check --full`` and ``--presenter``, as a script would call them."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from tests.test_cli import tsplat
from tsplat.core.errors import ContractError, ParamsError
from tsplat.plugins import plugins
from tsplat.testing.checks import Check
from tsplat.testing.kit import all_backend_checks, expected_names, outcomes

MIRRORED = """
from dataclasses import replace
from tsplat import Backend, Stages, hookimpl
from tsplat.presenters.kitty import KITTY

def encode(frame, terminal, previous):
    return KITTY.encode(replace(frame, rgb=frame.rgb[:, ::-1].copy()), terminal, None)

@hookimpl
def tsplat_presenters():
    return [replace(KITTY, name="mirrored", encode=encode, fill=None)]
"""


@pytest.fixture
def mirrored(tmp_path):
    """The environment of a program that has a plugin with a presenter that mirrors."""
    (tmp_path / "mirrored_plugin.py").write_text(MIRRORED)
    info = tmp_path / "mirrored-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mirrored\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[tsplat]\nmirrored = mirrored_plugin\n")
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def check(*words, **kwargs):
    """``tsplat check`` of few examples."""
    return tsplat("check", *words, "--examples", 15, **kwargs)


def test_a_wrong_presenter_fails_the_command(mirrored, tmp_path):
    """Exit code 1; the fault says what it looks like; nothing is left in the folder."""
    folder = tmp_path / "empty"
    folder.mkdir()
    words = ("--presenter", "mirrored", "--decode", "kitty")
    result = check(*words, code=1, env=mirrored, cwd=folder)
    assert result.stdout.count(b"holds") == 7
    assert result.stdout.count(b"BROKEN") == 1
    assert b"it looks like the frame mirrored" in b" ".join(result.stderr.split())
    assert not list(folder.iterdir())
    again = check(*words, code=1, env=mirrored, cwd=folder)
    assert again.stderr == result.stderr  # the same examples


def test_a_failure_may_be_expected_and_must_then_come(mirrored, tmp_path):
    """--expect-fail makes exit code 0 of a known fault, and 1 of one that does not come."""
    words = ("--presenter", "mirrored", "--decode", "tsplat.testing.decoders:kitty", "--json")
    listed = tmp_path / "expected.txt"
    listed.write_text("# it mirrors\n\nmirrored-picture  # on purpose\n")
    facts = json.loads(check(*words, "--expect-fail", f"@{listed}", env=mirrored).stdout)
    verdicts = {c["check"]: c["verdict"] for c in facts["checks"]}
    assert facts["passed"] is True
    assert facts["examples"] == 15
    assert verdicts.pop("picture") == "fails as expected"
    assert set(verdicts.values()) == {"holds"}
    result = check(*words, "--expect-fail", "picture,size", code=1, env=mirrored)
    facts = json.loads(result.stdout)
    assert facts["passed"] is False
    assert {c["check"]: c["verdict"] for c in facts["checks"]}["size"] == "holds unexpectedly"


def test_without_a_decoder_only_the_bytes_are_judged(mirrored):
    """Four checks, which a mirrored picture passes: the kit claims no more."""
    facts = json.loads(check("--presenter", "mirrored", "--json", env=mirrored).stdout)
    assert [c["check"] for c in facts["checks"]] == ["size", "controls", "pure", "rounding"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--presenter", "kitty", "--expect-fail", "sizes"), "no check named 'sizes'"),
        (("--presenter", "kitty", "--expect-fail", "@missing.txt"), "missing.txt"),
        (("--presenter", "kitty", "--decode", "png"), "expected kitty, iterm2, sixel"),
        (("--presenter", "kitty", "--decode", "nowhere:decode"), "nowhere"),
        (("--presenter", "teletype"), "no presenter named 'teletype'"),
        (("--full", "--backend", "gpu"), "no backend named 'gpu'"),
        (("scene.ply", "--full"), "leave out"),
        (("--full", "--decode", "kitty"), "name it with --presenter"),
        ((), "--full or --presenter"),
    ],
)
def test_errors_name_what_was_expected(words, text):
    """A wrong word is one line and exit code 1."""
    assert text in check(*words, code=1).stderr.decode()


def test_without_hypothesis_it_says_what_to_install():
    """One line with the remedy; the check on a scene goes without."""
    code = (
        "import sys; sys.modules['hypothesis'] = None\n"
        "from tsplat.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    run = [sys.executable, "-c", code, "check", "--backend", "cffi"]
    full = subprocess.run([*run, "--full"], capture_output=True, text=True, check=False)
    assert full.returncode == 1
    assert 'pip install "tsplat[test]"' in full.stderr
    assert full.stderr.count("\n") == 1
    assert subprocess.run([*run, "--size", "8x8"], capture_output=True, check=False).returncode == 0


def test_outcomes():
    """A check holds or fails, and either may be expected; names may have the subject or not."""

    def fail():
        raise ContractError("broken")

    def crash():
        raise ZeroDivisionError("by nought")

    checks = [Check(n, "x", run) for n, run in (("a", lambda: None), ("b", fail), ("c", crash))]
    assert expected_names(["x-a", "b"], checks) == {"x-a", "x-b"}
    with pytest.raises(ParamsError, match="there are: a, b, c"):
        expected_names(["d"], checks)
    plain = list(outcomes(checks, set()))
    assert [o.word for o in plain] == ["holds", "BROKEN", "BROKEN"]
    assert [o.fault for o in plain] == [None, "broken", "ZeroDivisionError: by nought"]
    other = list(outcomes(checks, {"x-a", "x-b"}))
    assert [o.word for o in other] == ["holds unexpectedly", "fails as expected", "BROKEN"]
    assert [o.good for o in other] == [False, True, False]


def test_names_are_unique_and_can_be_listed():
    """No two checks of a backend share a name, and none has a comma, a space or an @."""
    names = [check.name for check in all_backend_checks(plugins().backends["cffi"], 1)]
    assert len(set(names)) == len(names) > 40
    assert not set("".join(names)) & set(", @#")
    assert {"sort", "memory", "laws/ties"} <= set(names)
    assert any(name.startswith("stiff/") for name in names)
