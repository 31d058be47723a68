"""Where the real files are that some tests read; they are no part of this repository."""

from __future__ import annotations

import json

import pytest

from tests.conftest import DATA

HAVE = (DATA / "MANIFEST.json").is_file()
needs_data = pytest.mark.skipif(not HAVE, reason=f"no real files: $TSPLAT_DATA or {DATA} is absent")


def manifest() -> dict[str, dict]:
    """Path -> what independent parsers found there; empty where the files are absent."""
    if not HAVE:
        return {}
    files = json.loads((DATA / "MANIFEST.json").read_text())["files"]
    return {entry["path"]: entry for entry in files}
