"""Discovery of plugins: what works enters, what is broken is reported and stops nothing."""

from __future__ import annotations

import sys
import textwrap

import pytest

from tsplat.core.errors import PluginError
from tsplat.core.stages import Backend, Stages
from tsplat.plugins import find_plugins, load_backend

GOOD = """
    from tsplat import Backend, Presenter, Reader, Stages, hookimpl

    def sort(splats, workspace):
        raise AssertionError("not called here")

    @hookimpl
    def tsplat_backends():
        return [Backend("fake", "sorts", lambda: Stages(sort=sort), stages=("sort",))]

    @hookimpl
    def tsplat_presenters():
        return [Presenter("nothing", "shows nothing", lambda f, t, p: b"", lambda t: (1, 1),
                          lambda t: "never")]

    @hookimpl
    def tsplat_readers():
        return [Reader("fakefile", "reads nothing", lambda start: False, lambda: None)]
"""
RAISES = "raise RuntimeError('no \\x1b[31mGPU\\n here')"
EXITS = "raise SystemExit(3)"
SYNTAX = "def broken(:"
NO_HOOKS = "x = 1"
MISSPELT = """
    from tsplat import hookimpl

    @hookimpl
    def tsplat_backend():
        return []
"""
NOT_A_LIST = """
    from tsplat import hookimpl

    @hookimpl
    def tsplat_backends():
        return "numba"
"""
NOT_A_ROW = """
    from tsplat import hookimpl

    @hookimpl
    def tsplat_backends():
        return [42]
"""
BAD_NAME = """
    from tsplat import Backend, Stages, hookimpl

    @hookimpl
    def tsplat_backends():
        return [Backend("a b", "", Stages), Backend("none", "", Stages, stages=("paint",))]
"""
TAKEN = """
    from tsplat import Backend, Stages, hookimpl

    @hookimpl
    def tsplat_backends():
        return [Backend("numpy", "an impostor", Stages), Backend("mine", "fine", Stages)]
"""
HOOK_RAISES = """
    from tsplat import hookimpl

    @hookimpl
    def tsplat_presenters():
        raise ValueError("no display")
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """A function that fakes an installed distribution with one plugin module."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delenv("TSPLAT_PLUGINS", raising=False)
    made = []

    def install(name, source):
        module = f"fake_{name}"
        (tmp_path / f"{module}.py").write_text(textwrap.dedent(source))
        info = tmp_path / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: dist-{name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[tsplat]\n{name} = {module}\n")
        made.append(module)

    yield install
    for module in made:
        sys.modules.pop(module, None)


def test_everything_built_in_is_there():
    """Backends, presenters and the PLY reader enter by the hooks, in order, without a problem."""
    registry = find_plugins()
    assert {"numpy", "numba", "cffi"} <= set(registry.backends)
    assert {"kitty", "iterm2", "sixel", "halfblock"} <= set(registry.presenters)
    assert "ply" in registry.readers
    assert registry.distributions["backend", "numba"] == "tsplat"


def test_an_installed_plugin_is_found(install):
    """A distribution with an entry point in the group tsplat adds its rows under its name."""
    install("good", GOOD)
    registry = find_plugins()
    assert not registry.problems
    assert registry.backends["fake"].stages == ("sort",)
    assert registry.distributions["backend", "fake"] == "dist-good"
    assert registry.distributions["presenter", "nothing"] == "dist-good"
    assert registry.distributions["reader", "fakefile"] == "dist-good"


@pytest.mark.parametrize(
    ("name", "source", "reason"),
    [
        ("raises", RAISES, "RuntimeError: no"),
        ("exits", EXITS, "SystemExit: 3"),
        ("syntax", SYNTAX, "SyntaxError"),
        ("nohooks", NO_HOOKS, "implements none of"),
        ("misspelt", MISSPELT, "tsplat_backend"),
        ("notalist", NOT_A_LIST, "expected a list, got str"),
        ("notarow", NOT_A_ROW, "expected a Backend, got int"),
        ("hookraises", HOOK_RAISES, "tsplat_presenters: ValueError: no display"),
    ],
)
def test_a_broken_plugin_is_reported_and_stops_nothing(install, name, source, reason):
    """Its distribution and the reason are told in one printable line; the rest still works."""
    install(name, source)
    install("good", GOOD)
    registry = find_plugins()
    (problem,) = registry.problems
    assert problem.plugin == name
    assert problem.distribution == f"dist-{name}"
    assert reason in problem.reason
    assert str(problem).isprintable()
    assert {"fake", "numpy"} <= set(registry.backends)


def test_each_bad_row_is_reported_by_itself(install):
    """Rows of one plugin with an unusable name or an unknown stage are told one by one."""
    install("badname", BAD_NAME)
    reasons = [p.reason for p in find_plugins().problems]
    assert "printable word" in reasons[0]
    assert "must name some of project, sort, bin, composite" in reasons[1]


def test_a_name_that_is_taken_stays_with_its_first_owner(install):
    """The built-in keeps its name, the impostor is reported, its other rows enter."""
    install("taken", TAKEN)
    registry = find_plugins()
    assert registry.backends["numpy"].summary != "an impostor"
    assert "mine" in registry.backends
    (problem,) = registry.problems
    assert "'numpy' is already taken by tsplat" in problem.reason


@pytest.mark.parametrize(
    ("value", "found"),
    [("", set()), ("good", {"fake"}), ("other,good", {"fake"}), ("other", set())],
)
def test_tsplat_plugins_picks_third_party_plugins(install, monkeypatch, value, found):
    """Empty: none. Names: these. What is not picked is not even imported."""
    install("good", GOOD)
    install("raises", RAISES)
    monkeypatch.setenv("TSPLAT_PLUGINS", value)
    registry = find_plugins()
    assert [p.plugin for p in registry.problems] == (["other"] if "other" in value else [])
    assert {"fake"} & set(registry.backends) == found


def test_a_picked_plugin_that_is_not_there_is_reported(monkeypatch):
    """A misspelt name in TSPLAT_PLUGINS does not pass in silence."""
    monkeypatch.setenv("TSPLAT_PLUGINS", "nonsense")
    (problem,) = find_plugins().problems
    assert "TSPLAT_PLUGINS names it" in problem.reason


def test_an_unknown_name_lists_those_there_are():
    """The error names what was asked for and what is installed."""
    with pytest.raises(PluginError, match=r"no backend named 'nunba'; installed: .*numba"):
        find_plugins().find("backend", "nunba")


def test_a_backend_is_loaded_once_and_its_failure_remembered():
    """load() runs once; a failure is told again without running it again."""
    calls = []

    def fail():
        calls.append(1)
        raise OSError("libfoo.so not found")

    row = Backend("failing", "", fail)
    for _ in range(2):
        with pytest.raises(PluginError, match=r"'failing' failed to load: OSError: libfoo.so"):
            load_backend(row)
    assert len(calls) == 1


@pytest.mark.parametrize(
    ("load", "word"), [(lambda: None, "must return Stages"), (Stages, "promises .* loads nothing")]
)
def test_a_backend_that_loads_something_else_is_refused(load, word):
    """What load() returns must be what the row promised."""
    with pytest.raises(PluginError, match=word):
        load_backend(Backend("odd", "", load))
