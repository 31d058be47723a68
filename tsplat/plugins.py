"""Finds backends, presenters, readers and writers. A broken plugin is reported, never fatal.

pluggy's own entry-point loader stops the host at the first plugin that fails to import, so
this one loads them one by one, checks what each returns, and keeps a list of problems.

``TSPLAT_PLUGINS`` picks third-party plugins by entry-point name: unset, all; empty, none;
``a,b``, these two.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import pluggy

from tsplat import hookspecs
from tsplat.core.errors import PluginError, printable
from tsplat.core.stages import STAGES, Backend, Stages
from tsplat.io.base import Reader
from tsplat.io.write.base import Writer
from tsplat.presenters.base import Presenter

BUILT_IN = (
    "tsplat.backends.numpy",
    "tsplat.backends.numba",
    "tsplat.backends.cffi",
    "tsplat.presenters.kitty",
    "tsplat.presenters.iterm2",
    "tsplat.presenters.sixel",
    "tsplat.presenters.blocks",
    "tsplat.presenters.halfblock",
    "tsplat.presenters.braille",
    "tsplat.presenters.letters",
    "tsplat.io.compressed",
    "tsplat.io.ply",
    "tsplat.io.ksplat",
    "tsplat.io.splat",
    "tsplat.io.spz",
    "tsplat.io.sog",
    "tsplat.io.gltf",
    "tsplat.io.write.built_in",
)
ENVIRONMENT = "TSPLAT_PLUGINS"
OWN = "tsplat"

KINDS: dict[str, tuple[type, str]] = {
    "backend": (Backend, "tsplat_backends"),
    "presenter": (Presenter, "tsplat_presenters"),
    "reader": (Reader, "tsplat_readers"),
    "writer": (Writer, "tsplat_writers"),
}


@dataclass(frozen=True)
class Problem:
    """A plugin, or a part of one, that was left out."""

    plugin: str  # entry-point name
    distribution: str
    reason: str  # one line

    def __str__(self) -> str:
        return f"plugin {self.plugin!r} of {self.distribution}: {self.reason}"


@dataclass
class Registry:
    """What was found. ``distributions`` says for (kind, name) who brought it."""

    backends: dict[str, Backend] = field(default_factory=dict)
    presenters: dict[str, Presenter] = field(default_factory=dict)
    readers: dict[str, Reader] = field(default_factory=dict)
    writers: dict[str, Writer] = field(default_factory=dict)
    distributions: dict[tuple[str, str], str] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)

    def table(self, kind: str) -> dict[str, Any]:
        """The table of one kind: ``backend``, ``presenter``, ``reader`` or ``writer``."""
        tables: dict[str, dict[str, Any]] = {
            "backend": self.backends,
            "presenter": self.presenters,
            "reader": self.readers,
            "writer": self.writers,
        }
        return tables[kind]

    def find(self, kind: str, name: str) -> Any:
        """The row called ``name``.

        Raises:
            PluginError: there is none; the text lists those there are.
        """
        table = self.table(kind)
        if name not in table:
            known = ", ".join(sorted(table))
            broken = "".join(f"; {problem}" for problem in self.problems)
            raise PluginError(f"no {kind} named {printable(name)!r}; installed: {known}{broken}")
        return table[name]


def _wanted() -> set[str] | None:
    """The names that ``TSPLAT_PLUGINS`` picks; None for all."""
    wanted = os.environ.get(ENVIRONMENT)
    return None if wanted is None else {n.strip() for n in wanted.split(",")} - {""}


def _chosen(points: Iterable[EntryPoint]) -> Iterator[EntryPoint]:
    names = _wanted()
    for point in points:
        if names is None or point.name in names:
            yield point


def _one_line(error: BaseException) -> str:
    text = printable(" ".join(str(error).split()))
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _fault(kind: str, row: object) -> str | None:
    """Why ``row`` is not a usable row of ``kind``, or None."""
    wanted = KINDS[kind][0]
    if not isinstance(row, wanted):
        return f"expected a {wanted.__name__}, got {type(row).__name__}"
    name = row.name  # type: ignore[attr-defined]
    if not (isinstance(name, str) and name.isprintable() and name and not set(name) & set(" ,=")):
        return f"{wanted.__name__}.name must be a printable word without space, comma or =, " + (
            f"got {printable(repr(name))}"
        )
    if isinstance(row, Writer) and not all(
        isinstance(suffix, str) and suffix.startswith(".") for suffix in row.suffixes
    ):
        return f"Writer.suffixes must each begin with a dot, got {printable(row.suffixes)}"
    if isinstance(row, Backend) and not (row.stages and set(row.stages) <= set(STAGES)):
        return f"Backend.stages must name some of {', '.join(STAGES)}, got {row.stages!r}"
    return None


def _add(registry: Registry, plugin: str, distribution: str, module: object) -> None:
    """Registers one module by itself, so that its fault is its own."""
    host = pluggy.PluginManager(hookspecs.PROJECT)
    host.add_hookspecs(hookspecs)

    def report(reason: str) -> None:
        registry.problems.append(Problem(plugin, distribution, reason))

    try:
        host.register(module, plugin)
        host.check_pending()
    except Exception as error:  # a plugin's code may raise anything
        report(_one_line(error))
        return
    offered = 0
    for kind, (_, hook) in KINDS.items():
        try:
            answers = getattr(host.hook, hook)()
        except Exception as error:
            report(f"{hook}: {_one_line(error)}")
            offered += 1
            continue
        for answer in answers:
            offered += 1
            if not isinstance(answer, list | tuple):
                report(f"{hook}: expected a list, got {type(answer).__name__}")
                continue
            for row in answer:
                fault = _fault(kind, row)
                table = registry.table(kind)
                if fault is None and row.name in table:
                    owner = registry.distributions[kind, row.name]
                    fault = f"the {kind} name {row.name!r} is already taken by {owner}"
                if fault is not None:
                    report(fault)
                    continue
                table[row.name] = row
                registry.distributions[kind, row.name] = distribution
    if not offered:
        report(f"{printable(module)} implements none of: {', '.join(h for _, h in KINDS.values())}")


def find_plugins() -> Registry:
    """Everything built in, then every third-party plugin that works; cheap, imports no kernel."""
    registry = Registry()
    for name in BUILT_IN:
        _add(registry, name, OWN, importlib.import_module(name))
    for problem in registry.problems:
        raise PluginError(str(problem))  # tsplat's own rows must be right
    points = entry_points(group=hookspecs.PROJECT)
    for name in sorted(_wanted() or set()):
        if name not in points.names:
            reason = f"{ENVIRONMENT} names it, but no such plugin is installed"
            registry.problems.append(Problem(printable(name), "no distribution", reason))
    for point in sorted(_chosen(points), key=lambda p: p.name):
        distribution = printable(point.dist.name if point.dist else "unknown")
        name = printable(point.name)
        try:
            module = point.load()
        except (Exception, SystemExit) as error:
            registry.problems.append(Problem(name, distribution, _one_line(error)))
        else:
            _add(registry, name, distribution, module)
    return registry


@cache
def plugins() -> Registry:
    """:func:`find_plugins`, once per process."""
    return find_plugins()


_loaded: dict[int, tuple[Backend, Stages | PluginError]] = {}  # the row keeps its id its own


def load_backend(backend: Backend) -> Stages:
    """``backend.load()``, once; a failure is remembered and raised again at once.

    Raises:
        PluginError: it failed to load, or what it loaded is not what its row promises.
    """
    key = id(backend)
    if key not in _loaded:
        _loaded[key] = backend, _load(backend)
    result = _loaded[key][1]
    if isinstance(result, PluginError):
        raise result
    return result


def _load(backend: Backend) -> Stages | PluginError:
    try:
        stages: object = backend.load()
    except Exception as error:
        return PluginError(f"backend {backend.name!r} failed to load: {_one_line(error)}")
    if not isinstance(stages, Stages):
        return PluginError(
            f"backend {backend.name!r}: load() must return Stages, got {type(stages).__name__}"
        )
    if stages.offered() != tuple(s for s in STAGES if s in backend.stages):
        return PluginError(
            f"backend {backend.name!r} promises {', '.join(backend.stages)} "
            f"but loads {', '.join(stages.offered()) or 'nothing'}"
        )
    return stages


def ask(question: Callable[..., str | None], *arguments: object) -> str | None:
    """A plugin's answer to "why not?"; an exception counts as a reason."""
    try:
        answer = question(*arguments)
    except Exception as error:
        return _one_line(error)
    return None if answer is None else printable(answer, 600)
