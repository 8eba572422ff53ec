"""Exact contact by modes: softplus homotopy, exact solution of the modes, search of mode sequences.

If the end is free and has a cost, throws by constant inputs are tried too.
"""

from __future__ import annotations

from formulations.contact_modes.method import MpccOptions, why_not
from formulations.method import Clock, Kind, Method, Session
from models.scene import Scene


class Mpcc(Method[MpccOptions]):
    """Exact contact by a search over its mode sequences."""

    name = "mpcc"
    title = "Exact contact by its modes"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = MpccOptions

    def accepts(self, scene: Scene) -> str | None:
        """Refuse scenes without inputs, with friction, damping, or functions unknown to Pyomo."""
        return why_not(scene)

    def session(self, scene: Scene, options: MpccOptions, clock: Clock) -> Session:
        """Open a session."""
        # Imports Pyomo and Ipopt: 1 s that planning a campaign saves.
        from formulations.contact_modes.session import MpccSession

        return MpccSession(self, scene, options, clock)


METHOD = Mpcc()
