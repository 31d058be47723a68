"""JSON of unknown origin: each value knows its place, so that each fault is one line.

Numbers are checked as they are asked for; nothing in a file is trusted to be what it should.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from tsplat.core.errors import printable
from tsplat.core.types import F64
from tsplat.io.base import one_line, refuse

JSON_MAX = 1 << 21
"""Bytes. SOG's meta.json has 16 kB and a glTF scene 200 a node; Python's objects take 25 times as
much in the worst case."""


ITEMS_MAX = 1 << 14
"""Of a list that is gone through one by one, each as a Field: 300 bytes and some microseconds."""


@dataclass(frozen=True, slots=True)
class Field:
    """A value and where in which file it stands."""

    path: Path
    place: str  # "meta.json: means.mins"
    value: Any

    def wrong(self, expected: str) -> NoReturn:
        """Raises the SceneError that it is something else."""
        refuse(self.path, f"{self.place}: expected {expected}, got {_shown(self.value)}")

    def maybe(self, key: str) -> Field | None:
        """The value of ``key``; None if it is not there or null."""
        if not isinstance(self.value, dict):
            self.wrong("an object")
        found = self.value.get(key)
        return None if found is None else Field(self.path, self._below(key), found)

    def get(self, key: str) -> Field:
        """The value of ``key``."""
        found = self.maybe(key)
        if found is None:
            refuse(self.path, f"{self._below(key)} is missing; the file is not whole, or damaged")
        return found

    def _below(self, key: str) -> str:
        shown = printable(key, 60)
        root = not self.place or self.place.endswith(": ")
        return f"{self.place}{shown}" if root else f"{self.place}.{shown}"

    def items(self, length: int | None = None) -> list[Field]:
        """The items of a list, ``length`` of them if that is given."""
        if not isinstance(self.value, list):
            self.wrong("a list")
        if length is not None and len(self.value) != length:
            refuse(self.path, f"{self.place}: expected {length} items, got {len(self.value)}")
        if len(self.value) > ITEMS_MAX:
            refuse(
                self.path,
                f"{self.place}: expected at most {ITEMS_MAX} items, not {len(self.value)}",
            )
        return [Field(self.path, f"{self.place}[{i}]", item) for i, item in enumerate(self.value)]

    def at(self, index: Field) -> Field:
        """The item that ``index`` counts."""
        if not isinstance(self.value, list):
            self.wrong("a list")
        i = index.integer(0)
        if i >= len(self.value):
            index.wrong(f"less than {len(self.value)}, as many as {self.place} has")
        return Field(self.path, f"{self.place}[{i}]", self.value[i])

    def integer(self, low: int, high: int = 2**53) -> int:
        """A whole number from ``low`` to ``high``."""
        value = self.value
        if isinstance(value, float) and value.is_integer() and abs(value) <= 2**53:
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            span = f"{low} or more" if high >= 2**53 else f"{low} to {high}"
            self.wrong(f"a whole number, {span}" if low != high else f"{low}")
        return value

    def numbers(self, length: int, most: int | None = None) -> F64:
        """[length] finite numbers, or from ``length`` to ``most`` of them."""
        values = self.value
        if not isinstance(values, list) or not length <= len(values) <= (most or length):
            self.wrong(f"a list of {length if most is None else f'{length} to {most}'} numbers")
        for value in values:
            if not isinstance(value, int | float) or isinstance(value, bool):
                self.wrong("numbers")
        try:
            found = np.array(values, np.float64)
        except OverflowError:
            self.wrong("numbers that fit into float64")
        if not np.isfinite(found).all():
            self.wrong("finite numbers")
        return found

    def number(self) -> float:
        """A finite number."""
        return float(Field(self.path, self.place, [self.value]).numbers(1)[0])

    def text(self) -> str:
        """A string."""
        if not isinstance(self.value, str):
            self.wrong("a string")
        return self.value

    def inside(self) -> Path:
        """The existing file that the string names: in the folder of the file itself, or below."""
        from urllib.parse import unquote

        name = unquote(self.text())
        parts = name.split("/")
        bad = (
            not name
            or ".." in parts
            or not all(parts)
            or not name.isprintable()
            or any(c in name for c in "\\:")
        )
        if bad:
            self.wrong("the name of a file beside this one")
        folder = self.path.parent
        file = folder / name
        try:
            below = file.resolve().is_relative_to(folder.resolve())
            there = below and file.is_file()
        except (OSError, RuntimeError):  # a name that is too long, a circle of links
            below, there = True, False
        if not below:
            self.wrong("a file in the same folder, not a link out of it")
        if not there:
            refuse(
                self.path,
                f"{self.place} names {printable(name, 80)}, which is not in the folder; "
                "copy all files of the scene",
            )
        return file


def _shown(value: Any) -> str:
    if isinstance(value, dict | list):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    try:
        return printable(repr(value), 40)
    except ValueError:  # an int of very many digits
        return "a number of very many digits"


def parse(path: Path, place: str, content: bytes) -> Field:
    """The object that ``content`` is.

    Raises:
        SceneError: it is not JSON, is nested too deeply, or has more than JSON_MAX bytes.
    """
    what = f"{place}: " if place else ""
    if len(content) > JSON_MAX:
        refuse(path, f"{what}{len(content)} bytes of JSON, expected at most {JSON_MAX}")
    try:
        value = json.loads(content.decode("utf-8-sig"))
    except RecursionError:
        refuse(path, f"{what}JSON that is nested too deeply; the file is damaged")
    except ValueError as error:  # JSONDecodeError and UnicodeDecodeError are ValueErrors
        text = one_line(error)
        refuse(path, f"{what}JSON that cannot be read: {text}; the file is damaged")
    root = Field(path, what, value)
    if not isinstance(value, dict):
        refuse(path, f"{what}expected a JSON object, got {_shown(value)}")
    return root
