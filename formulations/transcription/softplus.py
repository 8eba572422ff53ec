"""Softplus contact opened on a scene: cold, its goal may be let go first (`opening`); warm, a stage gets a bounded amount of work, and what it leaves is
handed on only if it is a plan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

from formulations.ipopt.linear_solver import band_options
from formulations.solution import Outcome
from formulations.transcription.contact import ContactLaw
from formulations.transcription.feasibility import Patience
from formulations.transcription.session import TightenedSession, Watch, Work
from formulations.transcription.workbench import Account, Workbench
from models.contact_law import ContactLaw as ForceLaw
from models.contact_law import sharpness
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.methods.softplus_dc import SoftplusDCOptions

# Of a stage that starts from a plan, in nonzeros, which is what an iteration's time grows with: friction and many contacts have three times as many a
# unknown. Those of the bank that ended well took up to 6.3e6 (transport: 951 iterations, of 6608), and where they were larger up to 136 iterations.
_WORK = Work(6.5e6, 130)
# A last iterate that misses its own time step [m/s], contact or friction law [N] by more is no plan: the next stage starts better from the one before.
_BROKEN = 1e-2


class SoftplusSession(TightenedSession):
    contact = ContactLaw.SOFTPLUS
    _options: SoftplusDCOptions

    def is_plan(self, residuals: Mapping[str, float], eps: float | None) -> bool:
        return max(residuals.get(name, 0.0) for name in ("dynamics_defect", "contact_law", "regularised_friction")) <= _BROKEN

    def work(self, warm_start: Trajectory | None) -> Work | None:
        return None if warm_start is None else _WORK

    def size(self, bench: Workbench, account: Account) -> int:
        return bench.problem(account).nonzeros

    def is_vain(self, failed: Outcome, start: Trajectory | None) -> Outcome | None:
        """A cold start at a smaller eps is another one: contact acts from less far away."""
        return None if start is None else Outcome.STALLED

    def common_options(self) -> dict[str, Any]:
        return {**super().common_options(), **band_options()}

    def sharpest(self, eps: float | None) -> float:
        return sharpness(cast(float, eps), self._scene.length)

    def takes_duals(self, eps: float | None) -> bool:
        return cast(float, eps) <= self._options.duals_from

    def watch(self, warm_start: Trajectory | None) -> Patience:
        is_cold = warm_start is None and self._scene.nc > 0 and self._scene.task.has_goal
        return Watch() if is_cold else Patience()

    def certificate(self, plan: Trajectory, eps: float | None) -> dict[str, float]:
        return self._residuals.of(plan, ForceLaw.SOFTPLUS, eps)

    def promises(self, eps: float | None) -> dict[str, float]:
        return {**super().promises(eps), **dict.fromkeys(("contact_law", "regularised_friction"), self._options.plan_tolerance)}
