"""Direct transcription with softplus contact: smooth forces at a distance, sharpness |ln eps|.

A stage from a plan has a work limit, and its result is used only if it is a plan. A cold start with
diverging multipliers starts again with a released goal (`transcription.solving`).
"""

from __future__ import annotations

from dataclasses import dataclass

from formulations.method import Clock, Kind, Method, Session
from formulations.solution import Solution
from formulations.transcription.method import (
    StageRules,
    TranscriptionOptions,
    Work,
    duals_option,
    first_eps_option,
)
from models.contact_law import sharpness
from models.scene import Scene
from models.trajectory import Trajectory

# Limit of a stage from a plan, in nonzeros, to which an iteration's time is proportional.
# Successful stages of the bank took up to 6.3e6 (transport), larger models up to 136 iterations.
_WORK = Work(6.5e6, 130)
# An iterate with a larger error of the time step [m/s], contact or friction law [N] is no plan.
_BROKEN = 1e-2


@dataclass(frozen=True, kw_only=True)
class SoftplusDCOptions(TranscriptionOptions):
    """Options of `softplus_dc`."""

    duals_from: float = duals_option()
    first_eps: float = first_eps_option(0.5)


class SoftplusDCSession(Session):
    """The session of `softplus_dc`; each eps only changes the sharpness."""

    def __init__(
        self, method: SoftplusDC, scene: Scene, options: SoftplusDCOptions, clock: Clock
    ) -> None:
        # Imports Pyomo and Ipopt: 0.9 s that planning a campaign saves.
        from formulations.transcription import homotopy

        self._scene, self._options = scene, options
        self._band = homotopy.band_options()
        self._homotopy = homotopy.Homotopy(
            method, scene, homotopy.ContactFormulation.SOFTPLUS, options, clock, self._rules
        )

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Solve at this eps. Raises TrajectoryError for a plan of another grid."""
        first = self._options.first_eps
        return self._homotopy.solve(
            eps, warm_start, time_limit, first, lambda stage, eps: stage.reach(eps, warm_start)
        )

    def _rules(self, eps: float) -> StageRules:
        scene, options = self._scene, self._options
        return StageRules(
            ipopt={**options.ipopt(), **self._band},
            cold={},
            cold_work=None,
            warm_work=_WORK,
            takes_duals=eps <= options.duals_from,
            sharpest=sharpness(eps, scene.length),
            plan_limits=dict.fromkeys(
                ("dynamics_defect", "contact_law", "regularised_friction"), _BROKEN
            ),
            promises={
                **options.promises(),
                **dict.fromkeys(("contact_law", "regularised_friction"), options.plan_tolerance),
            },
        )


class SoftplusDC(Method[SoftplusDCOptions]):
    """Collocation with softplus contact."""

    name = "softplus_dc"
    title = "Collocation with softplus contact"
    kind = Kind.INDIRECT
    needs_eps = True
    options = SoftplusDCOptions

    def session(self, scene: Scene, options: SoftplusDCOptions, clock: Clock) -> Session:
        """Open a session, which imports Pyomo and Ipopt."""
        return SoftplusDCSession(self, scene, options, clock)


METHOD = SoftplusDC()
