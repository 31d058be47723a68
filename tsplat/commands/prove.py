"""``tsplat check --full`` and ``--presenter``: the checks of the test kit, on drawn examples."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from tsplat.commands.common import print_json, say
from tsplat.core.errors import ParamsError, PluginError, printable
from tsplat.core.params import RenderParams
from tsplat.core.types import Scene
from tsplat.io.progress import progress_bar
from tsplat.plan import why_not
from tsplat.plugins import plugins

if TYPE_CHECKING:
    from tsplat.testing.checks import Check
    from tsplat.testing.kit import Outcome
    from tsplat.testing.presenting import Decoding

EXAMPLES = 100
EXAMPLE_LINES = 12  # of a failing example, on the screen


def run(arguments: argparse.Namespace) -> int:
    """Collects the checks, runs them, reports; 1 if any is not as expected."""
    for option in ("scene", "camera", "size", "threads", "antialias"):
        if getattr(arguments, option) is not None:
            raise ParamsError(f"--full and --presenter draw their own examples: leave out {option}")
    if arguments.decode and arguments.presenter is None:
        raise ParamsError("--decode is for one presenter: name it with --presenter")
    try:
        import hypothesis
        from hypothesis.configuration import set_hypothesis_home_dir
    except ImportError as error:
        raise PluginError(
            f'these checks need hypothesis ({error}): pip install "tsplat[test]"'
        ) from None
    examples = arguments.examples or EXAMPLES
    # The same examples on every run: what passes today is not broken tomorrow by chance
    hypothesis.settings.register_profile(
        "tsplat-check", derandomize=True, print_blob=False, max_examples=examples
    )
    hypothesis.settings.load_profile("tsplat-check")
    with TemporaryDirectory() as home:
        set_hypothesis_home_dir(home)  # nothing is left where we are called
        return _run(arguments, examples)


def _run(arguments: argparse.Namespace, examples: int) -> int:
    from tsplat.testing.kit import expected_names, outcomes

    checks, skipped = _checks(arguments, examples)
    expected = expected_names(_expected(arguments.expect_fail or []), checks)
    done: list[Outcome] = []
    with progress_bar("checking") as progress:
        progress(0, len(checks))
        for outcome in outcomes(checks, expected):
            done.append(outcome)
            progress(len(done), len(checks))
    passed = all(outcome.good for outcome in done)
    if arguments.json:
        facts = [_facts(outcome) for outcome in done]
        print_json({"examples": examples, "passed": passed, "checks": facts, "skipped": skipped})
    else:
        _show(done, skipped, examples)
    return 0 if passed else 1


def _checks(arguments: argparse.Namespace, examples: int) -> tuple[list[Check], dict[str, str]]:
    """The checks of what is named, or of all that is installed; and what cannot run here."""
    from tsplat.testing.kit import all_backend_checks, all_presenter_checks

    registry = plugins()
    checks: list[Check] = []
    skipped: dict[str, str] = {}
    if arguments.backend is not None:
        backends = [registry.find("backend", arguments.backend)]
    elif arguments.presenter is not None:
        backends = []
    else:
        backends = sorted(registry.backends.values(), key=lambda b: b.rank)
    for backend in backends:
        reason = why_not(backend, _empty(), RenderParams())
        if reason is None:
            checks += all_backend_checks(backend, examples)
        elif arguments.backend is not None:
            raise PluginError(f"backend {backend.name!r} cannot be used: {reason}")
        else:
            skipped[backend.name] = reason
    if arguments.presenter is not None:
        presenters = [registry.find("presenter", arguments.presenter)]
    else:
        presenters = [] if arguments.backend else list(registry.presenters.values())
    decoding = _decoding(arguments.decode) if arguments.decode else None
    for presenter in presenters:
        checks += all_presenter_checks(presenter, decoding, examples)
    return checks, skipped


def _empty() -> Scene:
    import numpy as np

    means, quats, scales, opacities, sh = (
        np.zeros((0, *shape), np.float32) for shape in ((3,), (4,), (3,), (), (1, 3))
    )
    return Scene(means, quats, scales, opacities, sh)


def _decoding(text: str) -> Decoding:
    """The decoder called ``kitty`` and the like, or ``MODULE:NAME``."""
    from tsplat.testing.presenting import DECODINGS, Decoding

    if text in DECODINGS:
        return DECODINGS[text]
    module, colon, name = text.partition(":")
    if not colon:
        known = ", ".join(DECODINGS)
        raise ParamsError(f"--decode: expected {known} or MODULE:NAME, got {text!r}")
    try:
        found: Any = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ParamsError(f"--decode {text}: {error}") from None
    return found if isinstance(found, Decoding) else Decoding(found)


def _expected(words: list[str]) -> list[str]:
    """``--expect-fail``: names with commas between them, or @FILE with one a line, # for notes."""
    names: list[str] = []
    for word in words:
        if word.startswith("@"):
            try:
                text = Path(word[1:]).read_text(encoding="utf-8")
            except (OSError, UnicodeDecodeError) as error:
                raise ParamsError(f"--expect-fail {word}: {error}") from None
            lines = [line.partition("#")[0].strip() for line in text.splitlines()]
            names += [line for line in lines if line]
        else:
            names += [name.strip() for name in word.split(",") if name.strip()]
    return names


def _facts(outcome: Outcome) -> dict[str, Any]:
    return {
        "name": outcome.check.subject,
        "check": outcome.check.name,
        "verdict": outcome.word.lower(),
        "passed": outcome.fault is None,
        "expected_to_fail": outcome.expected,
        "fault": outcome.fault,
        "example": outcome.example or None,
    }


_COLORS = {
    "holds": "green",
    "fails as expected": "yellow",
    "holds unexpectedly": "red bold",
    "BROKEN": "red bold",
}


def _show(done: list[Outcome], skipped: dict[str, str], examples: int) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{examples} examples a check", title_justify="left")
    for heading in ("name", "check", "verdict"):
        table.add_column(heading)
    before = None
    for outcome in done:
        if before not in (None, outcome.check.subject):
            table.add_section()
        before = outcome.check.subject
        color = _COLORS[outcome.word]
        table.add_row(before, outcome.check.name, f"[{color}]{outcome.word}[/{color}]")
    Console().print(table)
    for outcome in done:
        if outcome.good:
            continue
        if outcome.fault is None:
            say(f"{outcome.check}: holds, although a failure is expected: expect it no longer")
            continue
        say(f"{outcome.check}: {printable(outcome.fault, 1000)}")
        lines = outcome.example.splitlines()
        for line in lines[:EXAMPLE_LINES]:
            say(f"  {printable(line)}")
        if len(lines) > EXAMPLE_LINES:
            say(f"  ... {len(lines) - EXAMPLE_LINES} lines more with --json")
    for name, reason in skipped.items():
        say(f"{name} was not checked: {reason}")
