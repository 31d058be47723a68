"""What the comments of a PLY file say of its scene: antialiasing, and which way is up.

Writers: Brush (``SplatRenderMode: mip``, ``Vertical axis: y``, newer ones a direction), Postshot
(``antialiased 1``), Nerfstudio (``Vertical Axis: z``).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from tsplat.core.types import Up

NUMBER = r"([-+]?[0-9]*\.?[0-9]+(?:e[-+]?[0-9]+)?)"
AXIS = re.compile(r"vertical axis: (?!\+?y)([-+]?)([xyz])")
DIRECTION = re.compile(rf"vertical axis:[\s\[(]*{NUMBER}[\s,]+{NUMBER}[\s,]+{NUMBER}[\s\])]*")


def says_antialias(comments: Iterable[str]) -> bool | None:
    """Whether the scene was trained with antialiasing; None if that is not said.

    The last word counts: a tool that writes a file again may put its own below.
    """
    said = None
    for comment in comments:
        words = comment.lower().split()
        if len(words) == 2 and words[0] == "splatrendermode:":
            said = words[1] == "mip"
        elif len(words) == 2 and words[0] == "antialiased":
            said = words[1] not in ("0", "false")
    return said


def says_up(comments: Iterable[str]) -> Up | None:
    """Which way is up; None if that is not said.

    ``y`` says nothing: Brush writes it into every file, and means COLMAP's, which points down.
    ``z`` is Nerfstudio's, whose scenes have z up.
    """
    said = None
    for comment in comments:
        text = " ".join(comment.lower().split())
        if found := AXIS.fullmatch(text):
            x, y, z = (float(f"{found[1]}1") if name == found[2] else 0.0 for name in "xyz")
            said = Up((x, y, z), f"the file says: Vertical axis: {found[1]}{found[2]}")
        elif found := DIRECTION.fullmatch(text):
            x, y, z = map(float, found.groups())
            if 0 < math.hypot(x, y, z) < 1e30:
                said = Up((x, y, z), f"the file says: Vertical axis: {x:g} {y:g} {z:g}")
    return said
