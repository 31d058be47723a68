"""The documents say what the code does."""

from __future__ import annotations

import inspect
import re

import numpy as np
import pytest
from hypothesis import Phase, settings

from tests.conftest import ROOT
from tests.viewer.rules import VIEW
from tsplat import Frame, Terminal, hookspecs
from tsplat.cli import COMMANDS, make_parser
from tsplat.commands.texts import VIEW_EXAMPLES
from tsplat.core.errors import ContractError
from tsplat.core.params import KNOBS
from tsplat.plugins import OWN, find_plugins
from tsplat.testing.conformance import backend_checks
from tsplat.testing.presenting import BYTES_ALONE, DECODED, DECODINGS, presenter_checks
from tsplat.viewer.controls import HELP, MOTIONS
from tsplat.viewer.controls import KEYS as KEY_ACTS
from tsplat.viewer.keep import free_name
from tsplat.viewer.settings import Facts, sections
from tsplat.viewer.text import KEYS

DOCS = ROOT / "docs"


def blocks(path, language):
    """Code blocks of a Markdown file."""
    return re.findall(rf"```{language}\n(.*?)```", path.read_text(), re.S)


def without_docstring(source):
    """A module's text after its docstring."""
    return source.split('"""\n', 1)[1].lstrip("\n")


@pytest.mark.parametrize(
    ("page", "file"),
    [
        ("backends.md", "tsplat-bitsort/tsplat_bitsort.py"),
        ("backends.md", "tsplat-bitsort/test_bitsort.py"),
        ("presenters.md", "tsplat-ascii/tsplat_ascii.py"),
    ],
)
def test_the_tutorials_show_the_examples_as_they_are(page, file):
    """The code on the page is the code that the tests install and run."""
    text = without_docstring((ROOT / "examples" / file).read_text())
    assert text in blocks(DOCS / page, "python")


def test_the_tutorial_shows_the_entry_point_of_the_example():
    """What the page wants in pyproject.toml is in the example's."""
    (shown,) = blocks(DOCS / "backends.md", "toml")
    assert shown in (ROOT / "examples" / "tsplat-bitsort" / "pyproject.toml").read_text()


@pytest.fixture
def quick():
    """Failing examples are not made small: that they exist is enough."""
    settings.register_profile("docs", settings.default, phases=[Phase.generate], database=None)
    settings.load_profile("docs")
    yield
    settings.load_profile("tsplat")


@pytest.fixture
def on_path(monkeypatch):
    """The example's module can be imported, as where it is installed."""
    monkeypatch.syspath_prepend(ROOT / "examples" / "tsplat-bitsort")


def run_page(page):
    """Runs the Python blocks of a page in order, in one namespace; the errors that they raise."""
    namespace, errors = {}, []
    for number, code in enumerate(blocks(DOCS / page, "python")):
        try:
            exec(compile(code, f"{page}, block {number}", "exec"), namespace)
        except ContractError as error:
            errors.append(str(error))
    return namespace, errors


def caught(checks):
    """Names of those that fail."""
    names = set()
    for check in checks:
        try:
            check()
        except ContractError:
            names.add(check.name)
    return names


def shown_errors(page):
    """What the page says is raised, as patterns."""
    found = re.findall(r"raises `ContractError: (.*?)`", (DOCS / page).read_text(), re.S)
    return [re.escape(" ".join(text.split())).replace(r"\.\.\.", ".*") for text in found]


@pytest.mark.usefixtures("on_path", "quick")
def test_the_backend_tutorial_runs():
    """The first try fails as the page says; the second passes; the page's tests have all checks."""
    namespace, errors = run_page("backends.md")
    (pattern,) = shown_errors("backends.md")
    assert len(errors) == 1
    assert re.match(pattern, errors[0])
    assert caught(backend_checks(namespace["BITSORT"], max_examples=10)) == set()
    marks = [namespace[name].pytestmark[0] for name in ("test_conformance", "test_laws")]
    assert {check.name for check in marks[0].args[1]} == {"sort", "picture", "bits", "memory"}
    assert len(marks[1].args[1]) > 10


@pytest.mark.usefixtures("quick")
def test_the_presenter_tutorial_runs():
    """The first try breaks the one rule that the page says; the second keeps all."""
    namespace, errors = run_page("presenters.md")
    (pattern,) = shown_errors("presenters.md")
    assert len(errors) == 1
    assert re.match(pattern, errors[0])
    kitty = DECODINGS["kitty"]
    assert caught(presenter_checks(namespace["FIRST_TRY"], kitty, max_examples=40)) == {"stream"}
    assert caught(presenter_checks(namespace["SECOND_TRY"], kitty, max_examples=40)) == set()
    shown = namespace["test_conformance"].pytestmark[0].args[1]
    assert {check.name for check in shown} == {*BYTES_ALONE, *DECODED} - {"fill", "rest"}
    few = Frame(np.array([[[0, 0, 0], [1, 1, 1]]], np.float32), np.zeros((1, 2), np.float32))
    filled = namespace["FILLING"].fill(few, Terminal(columns=4, rows=3), None)
    assert filled == b"  @@\r\n  @@"


def test_every_hook_is_documented():
    """Each hook of hookspecs.py is on the page about plugins, with its arguments."""
    text = (DOCS / "backends.md").read_text()
    hooks = [n for n in vars(hookspecs) if n.startswith("tsplat_")]
    assert hooks
    for name in hooks:
        arguments = ", ".join(inspect.signature(getattr(hookspecs, name)).parameters)
        assert f"`{name}({arguments})`" in text


def test_the_page_of_formats_lists_every_reader():
    """Each built-in reader has a row in its table."""
    text = (DOCS / "formats.md").read_text()
    found = find_plugins()
    for name in found.readers:
        if found.distributions["reader", name] != OWN:
            continue
        assert f"\n| `{name}` |" in text


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


def table(path):
    """First cells of all tables on a page -> the other cells of all rows that begin so."""
    rows = {}
    for name, rest in re.findall(r"^\| *(.*?) *\|(.*)\|$", path.read_text(), re.M):
        rows[name] = rows.get(name, "") + rest
    return rows


def test_the_viewers_page_has_every_key():
    """With the words of the help page, of which it may say more."""
    rows = table(DOCS / "viewer.md")
    for line in HELP.splitlines():
        keys, words = " ".join(line[:KEYS].split()), line[KEYS:]
        assert keys in rows, keys
        said = "the list of keys" if words == "this help" else words
        first, *more = re.split("[;:(,]", said)
        assert first.strip() in rows[keys]
        assert all(part.strip(" )") in rows[keys] for part in more)


def test_the_viewers_page_has_every_setting():
    """Each row of the panel, and by which option it is had; of options that there are."""
    rows = table(DOCS / "viewer.md")
    named = [name for cell in rows for name in cell.split(", ")]
    for title, settings_rows in sections(VIEW, Facts()):
        for row in settings_rows:
            said = row.name.strip()
            assert said in named or f'"{said}"' in rows["alpha threshold"], (title, said)
    view = make_parser()._subparsers._group_actions[0].choices["view"]
    options = {option for action in view._actions for option in action.option_strings}
    text = (DOCS / "viewer.md").read_text()
    shown = set(re.findall(r"`(--[a-z-]+)", text))
    assert len(shown) > 20
    assert shown - {"--path"} <= options
    knobs = set(re.findall(r"--set ([a-z_]+)=", text))
    assert knobs == set(KNOBS) - {"half", "sh_degree"}


def test_the_viewers_page_names_the_files_as_they_are_called(tmp_path):
    """With SCENE for the scene's name."""
    text = (DOCS / "viewer.md").read_text()
    for stem, suffix in (("SCENE", ".png"), ("SCENE", ".json"), ("SCENE-path", ".json")):
        place = free_name(tmp_path, stem, suffix)
        assert f"`{place.name}`" in text
        place.unlink()


def test_the_usage_line_of_keys_is_true():
    """`tsplat view --help` names keys that there are, and no letter that does nothing."""
    (line,) = re.findall(r"keys: (.*?)\Z", VIEW_EXAMPLES, re.S)
    named = set(re.findall(r"\b[A-Z]\b", line))
    assert {"W", "P", "V", "Q", "Z"} <= named
    for letter in named:
        assert letter.lower() in KEY_ACTS or letter.lower() in MOTIONS, letter


def test_every_option_has_help():
    """--help leaves no option unexplained, except where its name and metavar say it all."""
    parser = make_parser()
    commands = parser._subparsers._group_actions[0].choices
    for name, sub in commands.items():
        for action in sub._actions:
            assert action.help or name == "check", (name, action.option_strings)
