"""The scene and the plan that a look asks for, made when they are first needed and then kept."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tsplat.core.camera import Camera
from tsplat.core.errors import TsplatError, printable
from tsplat.core.types import Scene
from tsplat.core.workspace import Workspace
from tsplat.edits import Edits, edited
from tsplat.plan import Plan, Rendered, make_plan
from tsplat.viewer.look import Look


@dataclass(frozen=True, eq=False)
class Prepared:
    """What draws a look's pictures."""

    scene: Scene
    plan: Plan
    look: Look  # that it was made for
    trouble: str = ""  # why it is another one than was asked for


class Engine:
    """Prepares; in the thread that renders. A look that cannot be had is told and passed over."""

    def __init__(self, scene: Scene, plan: Plan, look: Look) -> None:
        """``plan`` is that of ``scene`` with the edits of ``look``."""
        self._scene = scene
        self._edited: tuple[Edits, Scene] = look.edits, edited(scene, look.edits)
        self._last = Prepared(self._edited[1], plan, look)
        self._refused: tuple[object, str] = None, ""  # of a look that could not be had, and why
        self._drawn: Prepared | None = None  # what has drawn a picture
        self.workspace = Workspace(plan.threads)

    @property
    def scene(self) -> Scene:
        """As it is drawn now."""
        return self._last.scene

    @property
    def name(self) -> str:
        """The scene's."""
        return self._scene.name

    @property
    def backends(self) -> str:
        """Those that draw it now."""
        return "+".join(dict.fromkeys(self._last.plan.backends.values()))

    @property
    def prepared_last(self) -> Prepared:
        """What drew the last picture."""
        return self._last

    def run(self, look: Look, camera: Camera) -> tuple[Prepared, Rendered]:
        """The picture of ``look``, or of the last look that could be drawn, and what drew it.

        Raises:
            Exception: a backend's, if there is no other look to fall back on.
        """
        prepared = self.prepared(look)
        try:
            rendered = prepared.plan.run(prepared.scene, camera, self.workspace)
        except Exception as error:  # a backend is a plugin, and may raise any
            last = self._drawn
            if last is None or last.plan is prepared.plan:
                raise
            names = "+".join(dict.fromkeys(prepared.plan.backends.values()))
            why = f"{names} failed: {printable(error) or type(error).__name__}"
            self._last, self._refused = last, (_key(look), why)
            self.workspace = Workspace(last.plan.threads)  # whatever is in the other one
            return self.run(look, camera)
        self._drawn = self._last
        return prepared, rendered

    def prepared(self, look: Look) -> Prepared:
        """What draws ``look``; the last one that could be had, with the reason, if it cannot."""
        last = self._last
        if _key(look) == _key(last.look):
            return last
        if _key(look) == self._refused[0]:
            return replace(last, trouble=self._refused[1])
        try:
            if look.edits != self._edited[0]:
                self._edited = look.edits, edited(self._scene, look.edits)
            scene = self._edited[1]
            plan = make_plan(scene, backend=look.backend, threads=look.threads, params=look.params)
        except (TsplatError, MemoryError) as error:
            self._refused = _key(look), printable(error) or "out of memory"
            return replace(last, trouble=self._refused[1])
        if plan.threads != self.workspace.threads:
            self.workspace = Workspace(plan.threads)
        self._last = Prepared(scene, plan, look)
        return self._last


def _key(look: Look) -> tuple[object, ...]:
    """What of a look a plan depends on."""
    return look.params, look.edits, look.backend, look.threads
