"""Exact contact on a coarse grid: collocation of order 2 or 3 instead of semi-implicit Euler, contact modes by a softplus homotopy.

    softplus homotopy -> which contact is closed at which stage -> lam = k phi or lam = 0 there,
    solved

Modes are read off the last stages of the homotopy, the sharpest first; where none has a plan, from
a relaxed complementarity that starts at the sharpest (`contact_modes.collocation`).

Contacts open and close within steps, not at nodes. What that costs is bounded: residual
`switch_error` (models.collocation).
"""

from __future__ import annotations

from formulations.contact_modes.method import CollocationOptions
from formulations.method import Clock, Kind, Method, Session
from formulations.transcription.method import why_not_collocated
from models.scene import Scene


class Collocation(Method[CollocationOptions]):
    """Exact contact at the stages of steps of order 2 or 3."""

    name = "collocation"
    title = "Exact contact by collocation of higher order"
    kind = Kind.DIRECT
    needs_eps = False
    options = CollocationOptions

    def accepts(self, scene: Scene) -> str | None:
        """Refuse scenes without inputs, with friction or with damped contacts."""
        return super().accepts(scene) or why_not_collocated(scene)

    def session(self, scene: Scene, options: CollocationOptions, clock: Clock) -> Session:
        """Open a session, whose models are built at its first solve."""
        from formulations.contact_modes.collocation import (
            CollocationSession,
        )  # imports Pyomo and Ipopt: 1 s that planning a campaign does without

        return CollocationSession(self, scene, options, clock)


METHOD = Collocation()
