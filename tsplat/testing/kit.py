"""Every check there is of a backend or a presenter: what ``tsplat check --full`` runs.

Needs hypothesis. A check's name is unique within its backend: those of the laws begin with
``laws/``, those of the named hard scenes with ``stiff/``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from tsplat.core.errors import ParamsError
from tsplat.core.stages import Backend
from tsplat.presenters.base import Presenter
from tsplat.testing.checks import Check
from tsplat.testing.conformance import backend_checks
from tsplat.testing.decoders import Decoder
from tsplat.testing.laws import law_checks
from tsplat.testing.presenting import DECODINGS, Decoding, presenter_checks
from tsplat.testing.stiff import stiff_checks


def _named(group: str, checks: Iterable[Check]) -> list[Check]:
    """Without commas, which --expect-fail has between names."""
    return [replace(c, name=f"{group}/{c.name.replace(',', '')}") for c in checks]


def all_backend_checks(backend: Backend, max_examples: int = 100) -> list[Check]:
    """The contract stage by stage, the laws, and the hard scenes; new sets of checks go here."""
    return [
        *backend_checks(backend, max_examples),
        *_named("laws", law_checks(backend, max_examples)),
        *_named("stiff", stiff_checks(backend)),
    ]


def all_presenter_checks(
    presenter: Presenter, decode: Decoder | Decoding | None = None, max_examples: int = 100
) -> list[Check]:
    """Those of ``presenter_checks``, by the decoder of a built-in presenter's own name if none."""
    return presenter_checks(presenter, decode or DECODINGS.get(presenter.name), max_examples)


@dataclass(frozen=True)
class Outcome:
    """What became of a check."""

    check: Check
    fault: str | None  # None: it holds
    example: str  # the smallest that fails, as far as it can be told
    expected: bool  # to fail

    @property
    def good(self) -> bool:
        """It holds, or fails as expected; one that holds against expectation is not good."""
        return (self.fault is not None) == self.expected

    @property
    def word(self) -> str:
        """``holds``, ``fails as expected``, ``holds unexpectedly`` or ``BROKEN``."""
        if self.fault is None:
            return "holds unexpectedly" if self.expected else "holds"
        return "fails as expected" if self.expected else "BROKEN"


def expected_names(words: Iterable[str], checks: Iterable[Check]) -> set[str]:
    """Which of ``checks`` may fail, as ``str(check)``; a word is that, or a check's bare name.

    Raises:
        ParamsError: a word is no check's name: a typing error, or a check that is no more.
    """
    checks = list(checks)
    names: set[str] = set()
    for word in words:
        found = {str(check) for check in checks if word in (check.name, str(check))}
        if not found:
            known = ", ".join(dict.fromkeys(check.name for check in checks))
            raise ParamsError(f"no check named {word!r} to expect a failure of; there are: {known}")
        names |= found
    return names


def outcomes(checks: Iterable[Check], expected: set[str]) -> Iterator[Outcome]:
    """Runs the checks one by one."""
    for check in checks:
        fault, example = None, ""
        try:
            check()
        except Exception as error:  # a backend's code may raise anything: it is the finding
            fault = f"{type(error).__name__}: {error}"
            if isinstance(error, AssertionError):
                fault = str(error)
            example = "\n".join(getattr(error, "__notes__", ()))
        yield Outcome(check, fault, example, str(check) in expected)
