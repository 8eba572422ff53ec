"""The exact contact problem by its contact modes: softplus homotopy, modes read off, what is left solved exactly, mode sequences searched.

Where the end is free and has a cost, a plan that touches nothing is a local optimum from which no
slope leads to a contact (two_discs_wall: nothing done costs 0.61, a throw off the wall 0.39). There
throws by constant inputs are tried, and the cheapest are solved with their contact modes.
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
        """Refuse scenes without inputs, with friction, with damped contacts, or with functions that Pyomo does not have."""
        return why_not(scene)

    def session(self, scene: Scene, options: MpccOptions, clock: Clock) -> Session:
        """Open a session on the scene."""
        from formulations.contact_modes.session import (
            MpccSession,
        )  # imports Pyomo and Ipopt: 1 s that planning a campaign does without

        return MpccSession(self, scene, options, clock)


METHOD = Mpcc()
