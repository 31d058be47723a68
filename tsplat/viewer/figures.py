"""Words for the figures of a picture that is shown: the status line's and the panel's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from tsplat.core.camera import Camera
from tsplat.core.params import CONTRACT, settings_text
from tsplat.core.stages import IDENTICAL, STAGES
from tsplat.core.types import Scene
from tsplat.plan import Plan, Rendered
from tsplat.presenters.base import Terminal
from tsplat.viewer.look import Look
from tsplat.viewer.pace import Link

LINKED = 2000
"""Bytes of a frame from which it says something about the link's rate."""


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture on the screen, and what it took."""

    scene: Scene
    plan: Plan
    look: Look
    rendered: Rendered
    presenter: str
    size: tuple[int, int]  # px that were rendered
    full: tuple[int, int]  # px when it rests
    camera: Camera
    frames: float | None  # a second
    encode: float  # s
    sent: int  # bytes
    link: Link | None
    latency: float | None  # s from input to the terminal's answer


def status(shown: Shown, panel: bool = False) -> list[str]:
    """Parts of the status line, the most important first; of keys those that an open panel has."""
    rendered, plan = shown.rendered, shown.plan
    parts = [shown.scene.name]
    if (settings := settings_text(plan.asked)) != "contract":
        parts.append(settings)
    if edits := shown.look.edits.text():
        parts.append(edits)
    every = f" of {len(shown.scene):,}" if rendered.visible < len(shown.scene) else ""
    parts += [
        f"{rendered.visible:,}{every}",
        f"{shown.frames:.0f} fps" if shown.frames else "",
        f"{rendered.seconds['total'] * 1e3:.1f} ms {_backends(plan)}",
        f"{shown.presenter} {_size(shown)}",
        "arrows set  Tab closes" if panel else "? keys  Tab settings",
        f"{shown.encode * 1e3:.1f} ms {shown.sent / 1e3:.0f} kB",
        _link(shown.link) if shown.link else "",
    ]
    return parts + [f"without {item.what}" for item in rendered.left_out]


def figures(
    shown: Shown | None, terminal: Terminal, why: str, verified: str
) -> list[tuple[str, str]]:
    """Name and words of each, for the panel."""
    return list(_figures(shown, terminal, why, verified))


def _figures(
    shown: Shown | None, terminal: Terminal, why: str, verified: str
) -> Iterator[tuple[str, str]]:
    if shown is not None:
        rendered, scene, seconds = shown.rendered, shown.scene, shown.rendered.seconds
        yield "resolution", _size(shown)
        if shown.frames:
            yield "frames", f"{shown.frames:.0f} a second"
        if shown.latency is not None:
            yield "input to picture", f"{shown.latency * 1e3:.0f} ms"
        yield "render", f"{seconds['total'] * 1e3:.2f} ms"
        for stage in (*STAGES, "upscale"):
            if stage in seconds:
                yield f"  {stage}", f"{seconds[stage] * 1e3:.2f} ms"
        yield "encode", f"{shown.encode * 1e3:.2f} ms"
        yield "frame", f"{shown.sent / 1e3:.1f} kB"
        if shown.link:
            yield "link", _link(shown.link)
        yield "splats", f"{rendered.visible:,} of {len(scene):,}"
        yield "pairs with tiles", f"{rendered.intersections:,}"
        if rendered.overflowed:
            yield "overflowed", f"{rendered.overflowed:,}"
        for reason, count in scene.dropped.items():
            yield "not loaded", f"{count:,}: {reason}"
        yield "backend", _backends(shown.plan)
        if shown.plan.asked != CONTRACT:
            yield "settings", settings_text(shown.plan.asked)
    if verified:
        yield "verified", verified
    yield "terminal", terminal.name or "unknown"
    if terminal.multiplexer:
        yield "inside", terminal.multiplexer
    yield "chosen for", why
    if terminal.sixel_cut and shown is not None and shown.presenter == "sixel":
        yield "smaller", terminal.sixel_cut
    yield (
        "cells",
        f"{terminal.columns}x{terminal.rows} of {terminal.cell_width:.4g}x"
        + (f"{terminal.cell_height:.4g} px"),
    )
    yield "colours", {1 << 24: "24 bits", 2: "none"}.get(terminal.colors, str(terminal.colors))
    if shown is not None:
        centre, ahead = shown.camera.centre, shown.camera.rotation[2]
        yield "eye", " ".join(f"{n:.3g}" for n in centre)
        yield "looks along", " ".join(f"{n:.2f}" for n in ahead)
        for item in (*shown.plan.left_out, *shown.rendered.left_out):
            effect = "" if item.effect == IDENTICAL else f", {item.effect}"
            yield "without", f"{item.what}: {item.why}{effect}"


def _backends(plan: Plan) -> str:
    return f"{plan.names} x{plan.threads}"


def _size(shown: Shown) -> str:
    width, height = shown.size
    full = "" if shown.size == shown.full else f"/{shown.full[0]}x{shown.full[1]}"
    return f"{width}x{height}{full}"


def _link(link: Link) -> str:
    """The rate only of frames that take the link some time, not of what goes through memory."""
    told = f" {bits(link.rate)}" if link.rate * link.seconds > LINKED else ""
    return f"{link.seconds * 1e3:.0f} ms{told}"


def bits(rate: float) -> str:
    """Bytes/s as bits/s, as links are sold."""
    for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if rate * 8 >= size:
            return f"{rate * 8 / size:.3g} {unit}bit/s"
    return f"{rate * 8:.0f} bit/s"
