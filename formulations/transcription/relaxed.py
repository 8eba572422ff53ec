"""Relaxed complementarity lam (lam - k phi) <= eps opened on a scene. Plans for a smaller eps are among those for a larger one: where a start led to
none, it is not tried again below."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

from formulations.solution import Outcome
from formulations.transcription.contact_laws import ContactLaw
from formulations.transcription.session import cold_barrier
from formulations.transcription.tightened import TightenedSession, Work
from models.codegen.kernel import load_kernel
from models.trajectory import Trajectory

# Stages of the bank that ended well took up to 3.9e6 from a cold start (two_finger_lift: 575 iterations, of 6814 unknowns), and up to 2.6e6 from a
# plan (two_discs_wall: 333, of 7688).
_COLD, _WARM = Work(5e6, 1000), Work(3e6, 400)
# A last iterate that misses its own time step [m/s] or its products [N^2] by more is no plan: the next stage starts better from the one before.
_BROKEN = 1e-2


class RelaxedSession(TightenedSession):
    contact = ContactLaw.COMPLEMENTARITY

    def work(self, warm_start: Trajectory | None) -> Work | None:
        return _COLD if warm_start is None else _WARM

    def is_vain(self, failed: Outcome, start: Trajectory | None) -> Outcome | None:
        """Plans of a smaller eps are among those of a larger one."""
        return Outcome.INFEASIBLE if failed is Outcome.INFEASIBLE else Outcome.STALLED

    def is_plan(self, residuals: Mapping[str, float], eps: float | None) -> bool:
        products = 0.0 if self._scene.damped else max(residuals.get(name, 0.0) for name in ("complementarity", "friction_law"))
        return residuals["dynamics_defect"] <= _BROKEN and products <= 2.0 * cast(float, eps) + _BROKEN

    def sharpest(self, eps: float | None) -> float:
        """b = k ln2 / sqrt(eps): softplus with this worst-case violation, lam (lam - k phi) = eps at phi = 0."""
        softest = min(load_kernel(self._scene).stiffness(), default=math.inf)
        return float(softest) * math.log(2.0) / math.sqrt(cast(float, eps))

    def cold_options(self) -> dict[str, Any]:
        return cold_barrier(self)

    def common_options(self) -> dict[str, Any]:
        # Relaxed bounds (Ipopt's default) would let a force be -1e-8 N and the product exceed eps.
        return {**super().common_options(), "bound_relax_factor": 0.0}

    def takes_duals(self, eps: float | None) -> bool:
        return cast(float, eps) <= self.number("duals_from")

    def promises(self, eps: float | None) -> dict[str, float]:
        tolerance = self.number("plan_tolerance")
        # each friction has two products, and friction_law is their sum
        products = {"complementarity": cast(float, eps) + tolerance, "friction_law": 2.0 * cast(float, eps) + tolerance}
        if self._scene.damped:  # the bound holds for spring, switch and force each, not for the force against the true law
            return {**super().promises(eps), "friction_cone": tolerance}
        return {**super().promises(eps), **products, "force_sign": tolerance, "friction_cone": tolerance}
