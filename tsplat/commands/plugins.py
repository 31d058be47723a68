"""``tsplat plugins``: what is installed, what works here, and what does not and why."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from typing import Any

from tsplat.commands.common import print_json, say, terminal_environ
from tsplat.core.errors import TerminalError
from tsplat.plugins import Registry, ask, plugins
from tsplat.presenters.base import Terminal


def run(arguments: argparse.Namespace) -> int:
    """Lists backends, presenters, readers, writers and problems."""
    registry = plugins()
    facts = {**describe(registry), "terminal": describe_terminal(registry, arguments.terminal)}
    if arguments.json:
        print_json(facts)
        return 0
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()

    def show(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        table = Table(title=title, title_justify="left", title_style="bold")
        for heading in headings:
            table.add_column(heading)
        for row in rows:
            table.add_row(*map(escape, row))
        console.print(table)

    show(
        "Backends, fastest first",
        ("name", "stages", "what it is", "available", "from"),
        [
            (b["name"], " ".join(b["stages"]), b["summary"], b["reason"] or "yes",
             b["distribution"])
            for b in facts["backends"]
        ],
    )  # fmt: skip
    for kind in ("presenters", "readers", "writers"):
        show(
            kind.capitalize(),
            ("name", "what it is", "from"),
            [(r["name"], r["summary"], r["distribution"]) for r in facts[kind]],
        )
    if facts["terminal"]["asked"]:
        show(
            "This terminal",
            ("asked", "answered", "so"),
            [(f["question"], f["answer"], f["conclusion"]) for f in facts["terminal"]["asked"]],
        )
        show(
            "Presenters here",
            ("name", "chosen", "why, or why not"),
            [
                (p["name"], "yes" if p["chosen"] else "", p["reason"] or "works")
                for p in facts["terminal"]["presenters"]
            ],
        )
    else:
        console.print("Run it in a terminal to see what that is asked and answers.")
    for problem in facts["problems"]:
        say(
            f"plugin {problem['plugin']!r} of {problem['distribution']} "
            f"was left out: {problem['reason']}"
        )
    return 0


def describe(registry: Registry) -> dict[str, Any]:
    """The registry as plain data."""
    backends = []
    for row in sorted(registry.backends.values(), key=lambda b: -b.rank):
        reason = ask(row.unavailable)
        backends.append(
            {
                "name": row.name,
                "summary": row.summary,
                "stages": list(row.stages),
                "available": reason is None,
                "reason": reason,
                "distribution": registry.distributions["backend", row.name],
            }
        )
    others = {
        kind + "s": [
            {
                "name": row.name,
                "summary": row.summary,
                "distribution": registry.distributions[kind, row.name],
            }
            for row in registry.table(kind).values()
        ]
        for kind in ("presenter", "reader", "writer")
    }
    return {
        "backends": backends, **others, "problems": [vars(p) for p in registry.problems],
    }  # fmt: skip


def describe_terminal(registry: Registry, spec: str | None) -> dict[str, Any]:
    """What the terminal was asked, answered, and is; "asked" is empty where there is none.

    ``spec`` overrides the answers, see tsplat.terminal.profiles. Standard output may go elsewhere
    if standard error is the terminal.
    """
    from dataclasses import fields

    from tsplat.terminal import choose_presenter, device
    from tsplat.terminal.findings import findings
    from tsplat.terminal.profiles import overridden

    environ = terminal_environ(spec)
    out = next((fd for fd in (1, 2) if os.isatty(fd)), None)
    heard = None if out is None else device.hear(0, out, environ)
    wanted = environ.get("TSPLAT_PRESENTER") or "auto"
    if heard is None or out is None:
        terminal, rows = overridden(Terminal(tty=False), environ.get("TSPLAT_TERMINAL", "")), []
    else:
        size = device.window_size(out)
        terminal = heard.terminal(environ, size)
        rows = [vars(row) for row in findings(heard, environ, size, terminal)]
    try:
        chosen, why = choose_presenter(registry.presenters, terminal, wanted)
        name = chosen.name
    except TerminalError as error:
        name, why = "", str(error)
    reasons = {row.name: ask(row.unsupported, terminal) for row in registry.presenters.values()}
    return {
        "asked": rows,
        "facts": {f.name: getattr(terminal, f.name) for f in fields(terminal) if f.name != "share"},
        "presenters": [
            {"name": n, "chosen": n == name, "reason": why if n == name else reason}
            for n, reason in reasons.items()
        ],
        "chosen": name or None,
        "why": why,
    }
