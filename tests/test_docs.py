"""The documents say what the code does."""

from __future__ import annotations

import inspect
import re

import pytest

from tests.conftest import ROOT
from tsplat import hookspecs
from tsplat.cli import COMMANDS, make_parser

DOCS = ROOT / "docs"


def blocks(path, language):
    """Code blocks of a Markdown file."""
    return re.findall(rf"```{language}\n(.*?)```", path.read_text(), re.S)


def without_docstring(source):
    """A module's text after its docstring."""
    return source.split('"""\n', 1)[1].lstrip("\n")


@pytest.mark.parametrize(
    ("page", "module"),
    [
        ("backends.md", "tsplat-bitsort/tsplat_bitsort.py"),
        ("presenters.md", "tsplat-ascii/tsplat_ascii.py"),
    ],
)
def test_the_tutorials_show_the_examples_as_they_are(page, module):
    """The code on the page is the code that the tests install and run."""
    shown = blocks(DOCS / page, "python")[0]
    assert shown == without_docstring((ROOT / "examples" / module).read_text())


def test_every_hook_is_documented():
    """Each hook of hookspecs.py is on the page about plugins, with its arguments."""
    text = (DOCS / "backends.md").read_text()
    hooks = [n for n in vars(hookspecs) if n.startswith("tsplat_")]
    assert hooks
    for name in hooks:
        arguments = ", ".join(inspect.signature(getattr(hookspecs, name)).parameters)
        assert f"`{name}({arguments})`" in text


def test_the_readme_names_every_command():
    """Every command is on the first screens, and no other."""
    text = (ROOT / "README.md").read_text()
    for name in COMMANDS:
        assert name == "view" or f"tsplat {name}" in text


def test_the_readmes_python_runs(tmp_path, monkeypatch):
    """The four lines make a picture, given a file of that name."""
    import tsplat

    monkeypatch.chdir(tmp_path)
    scene = tsplat.demo_scene()
    monkeypatch.setattr(tsplat, "load_scene", lambda path: scene.take(slice(0, 5000)))
    (code,) = blocks(ROOT / "README.md", "python")
    assert len(code.strip().splitlines()) <= 5
    exec(compile(code, "README.md", "exec"), {})
    assert (tmp_path / "garden.png").stat().st_size > 1000


def test_every_option_has_help():
    """--help leaves no option unexplained, except where its name and metavar say it all."""
    parser = make_parser()
    commands = parser._subparsers._group_actions[0].choices
    for name, sub in commands.items():
        for action in sub._actions:
            assert action.help or name == "check", (name, action.option_strings)
