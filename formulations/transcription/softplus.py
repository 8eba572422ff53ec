"""Softplus contact opened on a scene: cold, its goal may be let go first (`opening`); warm, a stage gets a bounded amount of work, and what it leaves is
handed on only if it is a plan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from formulations.solution import Outcome, Solution
from formulations.transcription.contact_laws import ContactLaw
from formulations.transcription.opening import Watch
from formulations.transcription.reach import Patience
from formulations.transcription.session import TranscriptionSession
from formulations.transcription.size import size_on_paper
from models.contact_law import ContactLaw as ForceLaw
from models.contact_law import sharpness
from models.trajectory import Trajectory

# MUMPS permutes the KKT matrix before it orders it, unless told otherwise; where softplus' tiny slopes stand on the diagonal that destroys the band
# of time steps: 10 carts at T = 500 take 0.04 instead of 1.1 CPU s an iteration, and 7 instead of 31 of them; three carts take the same.
_KEEP_THE_BAND = {"mumps_permuting_scaling": 0}


# A stage that starts from a plan gets so many iterations, times unknowns: those of the bank that ended well took up to 1.5e6 (transport: 951, of 1604
# unknowns), and never fewer than the second number, however large the model.
_WORK, _FEWEST = 1.6e6, 200
# A last iterate that misses its own time step [m/s], contact or friction law [N] by more is no plan: the next stage starts better from the one before.
_BROKEN = 1e-2


class SoftplusSession(TranscriptionSession):
    contact = ContactLaw.SOFTPLUS
    _failed: tuple[float, Trajectory] | None = None  # the eps of the last stage that gave no plan, and what it had started from

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        if self._failed is not None and warm_start is self._failed[1] and cast(float, eps) < self._failed[0]:
            self._method.check_eps(eps)
            message = f"Not tried: from this start there was no plan at eps = {self._failed[0]:g} either, where contact is softer."
            return Solution(method=self._method.name, outcome=Outcome.STALLED, message=message, options=dict(self._options))
        found = super().solve(eps=eps, warm_start=warm_start, time_limit=time_limit)
        if found.trajectory is None and warm_start is not None:
            self._failed = (cast(float, eps), warm_start)
        return found

    def is_plan(self, residuals: Mapping[str, float]) -> bool:
        return max(residuals.get(name, 0.0) for name in ("dynamics_defect", "contact_law", "regularised_friction")) <= _BROKEN

    def ipopt_options(self, warm_start: Trajectory | None) -> dict[str, Any]:
        options = super().ipopt_options(warm_start)
        if warm_start is None:
            return options
        most = max(_FEWEST, int(_WORK / size_on_paper(self._scene, self.contact).unknowns))
        return {**options, "max_iter": min(options["max_iter"], most)}

    def common_options(self) -> dict[str, Any]:
        return {**super().common_options(), **_KEEP_THE_BAND}

    def sharpest(self, eps: float | None) -> float:
        return sharpness(cast(float, eps), self._scene.length)

    def takes_duals(self, eps: float | None) -> bool:
        return cast(float, eps) <= self.number("duals_from")

    def watch(self, warm_start: Trajectory | None) -> Patience:
        is_cold = warm_start is None and self._scene.nc > 0 and self._scene.task.has_goal
        return Watch() if is_cold else Patience()

    def certificate(self, plan: Trajectory, eps: float | None) -> dict[str, float]:
        return self._residuals.of(plan, ForceLaw.SOFTPLUS, eps)

    def promises(self, eps: float | None) -> dict[str, float]:
        return {**super().promises(eps), **dict.fromkeys(("contact_law", "regularised_friction"), self.number("plan_tolerance"))}
