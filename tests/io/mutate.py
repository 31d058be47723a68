"""Damage to files: what transfers, disks and malice do to them."""

from __future__ import annotations

import copy

from hypothesis import strategies as st

EXTREMES = [
    bytes(n) for n in (1, 4, 8)
] + [
    b"\xff", b"\xff\xff\xff\xff", b"\xff" * 8, b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80",
    b"\x01\x00\x00\x00", b"\x00\x00\xc0\x7f", b"\x00\x00\x80\x7f", b"\xff\xff\x7f\x7f",
]  # fmt: skip
NUMBERS = [
    None, True, "", "x", "../x", [], {}, [[]], -1, 0, 1, 2, 3, 255, 256, 2**31, 2**63, 2**70, 1e300,
    -1e300, 0.5, float("nan"), float("inf"),
]  # fmt: skip


@st.composite
def damaged(draw, content: bytes, head: int = 256) -> bytes:
    """``content`` with one to four of: a bit, a number, a piece moved, the end cut off.

    Half of all places are within the first ``head`` bytes, where files say what they are.
    """
    made = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        if not made:
            break
        last = len(made) - 1
        place = draw(st.integers(0, last) | st.integers(0, min(head, last)))
        kind = draw(st.sampled_from(["flip", "number", "splice", "cut", "grow"]))
        if kind == "flip":
            made[place] ^= 1 << draw(st.integers(0, 7))
        elif kind == "number":
            number = draw(st.sampled_from(EXTREMES))
            made[place : place + len(number)] = number
        elif kind == "splice":
            start = draw(st.integers(0, last))
            made[place : place + 64] = made[start : start + 64]
        elif kind == "cut":
            del made[place:]
        else:
            made += made[place : place + 99]
    return bytes(made)


@st.composite
def altered(draw, value):
    """JSON data with one to three values replaced or taken away, at any depth."""
    made = copy.deepcopy(value)
    for _ in range(draw(st.integers(1, 3))):
        at = made
        while True:
            keys = list(at) if isinstance(at, dict) else list(range(len(at)))
            if not keys:
                break
            key = draw(st.sampled_from(keys))
            deeper = isinstance(at[key], dict | list) and len(at[key])
            if deeper and draw(st.integers(0, 3)):
                at = at[key]
                continue
            if draw(st.booleans()) and isinstance(at, dict):
                del at[key]
            else:
                at[key] = copy.deepcopy(draw(st.sampled_from(NUMBERS)))  # it may be altered, too
            break
    return made
