"""Exact contact on a coarse grid by collocation of order 2 or 3, with modes of a softplus homotopy.

Contacts switch within steps; the residual `switch_error` bounds the effect (models.collocation).
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
        """Open a session; its first solve builds the models."""
        # Imports Pyomo and Ipopt: 1 s that planning a campaign saves.
        from formulations.contact_modes.collocation import CollocationSession

        return CollocationSession(self, scene, options, clock)


METHOD = Collocation()
