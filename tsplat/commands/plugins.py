"""``tsplat plugins``: what is installed, what works here, and what does not and why."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from tsplat.commands.common import print_json, say
from tsplat.plugins import Registry, ask, plugins


def run(arguments: argparse.Namespace) -> int:
    """Lists backends, presenters, readers and problems."""
    registry = plugins()
    facts = describe(registry)
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
    for kind in ("presenters", "readers"):
        show(
            kind.capitalize(),
            ("name", "what it is", "from"),
            [(r["name"], r["summary"], r["distribution"]) for r in facts[kind]],
        )
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
        for kind in ("presenter", "reader")
    }
    return {
        "backends": backends, **others, "problems": [vars(p) for p in registry.problems],
    }  # fmt: skip
