"""Who is timed: backends, the C kernel once for each instruction set, and the yardstick.

A name is a backend's, as ``numba``; the C kernel's may say an instruction set, as ``cffi/avx2``,
and has the best if it does not. With ``/staged`` behind it the four stages run one by one, where
otherwise a frame is made in one go.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import tsplat
from tsplat.core.camera import Camera
from tsplat.core.params import RenderParams
from tsplat.core.types import Scene
from tsplat.core.workspace import Workspace
from tsplat.plan import Plan, Rendered
from tsplat.plugins import plugins

STAGED = "staged"


@dataclass(frozen=True)
class Contestant:
    """A plan for one scene, and the C kernel's instruction set to run it on."""

    name: str
    plan: Plan
    isa: str | None = None

    def run(self, scene: Scene, camera: Camera, workspace: Workspace) -> Rendered:
        """One frame, which lives in ``workspace``."""
        if self.isa is not None:
            from tsplat.backends.cffi.isa import use_isa

            use_isa(self.isa)
        workspace.forget()  # or the second frame of a camera would be the first one
        return self.plan.run(scene, camera, workspace)

    def staged(self) -> Contestant:
        """The same stages one by one."""
        return replace(self, plan=replace(self.plan, fused=None))


def instruction_sets() -> list[str]:
    """Those the C kernel offers here, best first; ``generic`` where there is no kernel."""
    if plugins().backends["cffi"].unavailable() is not None:
        return ["generic"]
    from tsplat.backends.cffi.isa import offered

    return offered()


def default() -> list[str]:
    """The C kernel on each instruction set, and numba; what is not available is left out."""
    names = ["numba"]
    if plugins().backends["cffi"].unavailable() is None:
        names = [f"cffi/{name}" for name in instruction_sets()] + names
    return names


def enter(name: str, scene: Scene, params: RenderParams | None = None) -> Contestant:
    """The contestant of that name, for ``scene``."""
    backend, *rest = name.split("/")
    sets = [part for part in rest if part != STAGED]
    if backend == "cffi" and not sets:
        sets = instruction_sets()
    plan = tsplat.make_plan(scene, backend=backend, params=params)
    found = Contestant(name, plan, sets[0] if sets else None)
    return found.staged() if STAGED in rest else found
