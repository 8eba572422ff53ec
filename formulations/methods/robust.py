"""Inputs that reach the goal in several worlds at once: what is otherwise there, the plan given misses least on the way down by L-BFGS.

The loss is that of formulations.shooting.worlds. The exact plan before it in the pipeline says what
cost is compared with; what comes out is a motion of the true contact law that meets the goal
itself.
"""

from __future__ import annotations

from formulations.method import Clock, Kind, Method, Session
from formulations.shooting.options import RobustOptions
from models.scene import Scene


class Robust(Method[RobustOptions]):
    """L-BFGS on the true contact law of several worlds."""

    name = "robust"
    title = "L-BFGS on ReLU contact, for several worlds at once"
    kind = Kind.DIRECT
    needs_eps = False
    options = RobustOptions

    def accepts(self, scene: Scene) -> str | None:
        """Refuse scenes without inputs, scenes that need feedback whatever their plan, and those that limit no end."""
        if scene.unstable:
            return f"scene {scene.name} needs feedback whatever its plan ({scene.unstable.rstrip('.')}), so no inputs alone are robust."
        if not any(
            scene.limit(f"replay_terminal_{name}_error") for name in ("position", "velocity")
        ):
            return f"scene {scene.name} limits no end, so in another world its plan costs more or less, which no inputs mend."
        return super().accepts(scene)

    def session(self, scene: Scene, options: RobustOptions, clock: Clock) -> Session:
        """Open a session, which imports PyTorch."""
        from formulations.shooting.worlds import WorldsSession

        return WorldsSession(self, scene, options, clock)


METHOD = Robust()
