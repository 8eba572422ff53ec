"""Relaxed complementarity lam (lam - k phi) <= eps opened on a scene. Plans for a smaller eps are among those for a larger one: where a start led to
none, it is not tried again below. On a long horizon the first stage is solved on coarser grids before, each half as fine.

A start without a plan that leads nowhere soon begins again softer, at ten times the eps, and comes back from that plan: hundreds of iterations from a
cold start are a walk in which the last digit decides where it ends. Iterations and cost at eps = 1e-2, directly and by 1e-1: push_box 764 and 381, both
4803; transport 1002 at 1.75 and 1289 at 0.91; two_finger_lift 1000 without an end and 219 at 59.0; hopper_planar 1312 without a plan and 1460 with one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from time import perf_counter
from typing import TYPE_CHECKING, Any, cast

from formulations.grids import coarse_scene, on_grid
from formulations.solution import Outcome
from formulations.transcription.contact import ContactLaw
from formulations.transcription.session import Ending, TightenedSession, Work, cold_barrier
from formulations.transcription.workbench import Account, Workbench, load_first_guess, load_plan
from models.codegen.kernel import load_kernel
from models.stability import step_stability
from models.trajectory import Trajectory

if TYPE_CHECKING:
    from formulations.methods.relaxed_lcp import RelaxedLCPOptions

# Stages of the bank that ended well took up to 3.9e6 from a cold start (two_finger_lift: 575 iterations, of 6814 unknowns), and up to 2.6e6 from a
# plan (two_discs_wall: 333, of 7688).
_COLD, _WARM = Work(5e6, 1000), Work(3e6, 400)
# Iterations after which a start without a plan begins softer: the bank's quick ones are done in 18 to 102, the others need 222 to more than 1312.
_SOON = 150
_SOFTER = "It began softer, at eps = {:g}: from a cold start there was no plan soon."
# A last iterate that misses its own time step [m/s] or its products [N^2] by more is no plan: the next stage starts better from the one before.
_BROKEN = 1e-2
# More steps than the first are solved on every second step before, and so on down to the second: from their softplus plan three carts in 5000 steps
# take 1386 iterations, in 312 steps 96, and then, from grid to grid, 34, 32 and 96.
_LONG, _SHORT = 2000, 500


class RelaxedSession(TightenedSession):
    contact = ContactLaw.COMPLEMENTARITY
    _options: RelaxedLCPOptions
    _long, _is_try = _LONG, False

    def run(self, bench: Workbench, account: Account, eps: float | None, warm_start: Trajectory | None) -> Ending:
        if self._scene.task.steps <= self._long or self._last is not None:  # a later stage starts from a plan of this grid
            return self._run_cold(bench, account, cast(float, eps)) if warm_start is None else super().run(bench, account, eps, warm_start)
        own = Account(account.remaining)
        coarse = self._from_coarser_grid(own, eps, warm_start)
        if coarse is not None:
            load_plan(bench.model, coarse)
        ending = super().run(bench, account, eps, warm_start if coarse is None else coarse)
        account.include(own)
        return ending

    def _run_cold(self, bench: Workbench, account: Account, eps: float) -> Ending:
        """From the first guess, which the model holds; softer first where that leads nowhere soon."""
        levels = [eps]
        while self._scene.nl and 10.0 * levels[-1] < 1.0:
            levels.append(10.0 * levels[-1])
        accounts: list[Account] = []
        ending, ended = self._first_to_end(bench, account, levels, accounts)
        if ended > 0:
            if ending.outcome is not Outcome.INFEASIBLE and not account.is_over:
                ending = self._back_from(bench, account, levels[: ended + 1], accounts)
            ending = replace(ending, message=f"{ending.message} {_SOFTER.format(levels[ended])}".lstrip())
        for own in reversed(accounts):
            account.include(own)
        self._spent = 0
        return ending

    def _first_to_end(self, bench: Workbench, account: Account, levels: list[float], accounts: list[Account]) -> tuple[Ending, int]:
        """Cold starts, each softer than the one before, until one ends soon; the softest may take its time."""
        for index, level in enumerate(levels):
            load_first_guess(bench.model)
            self._is_try = index < len(levels) - 1
            ending = self._apart(bench, account, level, None, accounts)
            self._is_try = False
            if ending.outcome is not Outcome.ITERATION_LIMIT or account.is_over or self._spent >= self._options.max_iterations:
                break
        return ending, index

    def _back_from(self, bench: Workbench, account: Account, levels: list[float], accounts: list[Account]) -> Ending:
        """From the plan that the softest level left in the model to the first; where it is none, the first from a cold start.

        From a plan that was not solved, by half the steps: hopper_planar at 1e-2 from the last iterate at 1e-1 is lost, and by 3e-2 it is not.
        """
        halfway = [] if self._last is not None else [math.sqrt(low * high) for low, high in pairwise(levels)]
        plan = self._left(bench, levels[-1])
        if plan is None:
            load_first_guess(bench.model)
            return self._apart(bench, account, levels[0], None, accounts)
        for level in sorted({*levels[:-1], *halfway}, reverse=True):
            self._last = None
            load_plan(bench.model, plan)
            ending = self._apart(bench, account, level, plan, accounts)
            plan = self._left(bench, level) or plan
        return ending

    def _from_coarser_grid(self, account: Account, eps: float | None, warm_start: Trajectory | None) -> Trajectory | None:
        """A plan of every second step, on this grid, or None if there is none."""
        coarse = coarse_scene(self._scene, math.ceil(self._scene.task.steps / 2))
        if coarse is None or not step_stability(coarse).is_stable:
            return None
        begin = perf_counter()
        session = RelaxedSession(self._method, coarse, self._options, (0.0, 0.0))
        session._long = _SHORT
        bench, start = session.bench(eps), None if warm_start is None else on_grid(warm_start, coarse)
        if start is None:
            load_first_guess(bench.model)
        else:
            load_plan(bench.model, start)
        account.build += perf_counter() - begin
        session.run(bench, account, eps, start)
        return None if session._last is None else on_grid(session._last.plan, self._scene)

    def work(self, warm_start: Trajectory | None) -> Work | None:
        cold = Work(0.0, _SOON) if self._is_try else _COLD
        return cold if warm_start is None else _WARM

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
        return cold_barrier(self._options)

    def common_options(self) -> dict[str, Any]:
        options = super().common_options()
        # Relaxed bounds (Ipopt's default) would let a force be -1e-8 N and the product exceed eps.
        return {**options, "bound_relax_factor": 0.0}

    def takes_duals(self, eps: float | None) -> bool:
        return cast(float, eps) <= self._options.duals_from

    def promises(self, eps: float | None) -> dict[str, float]:
        tolerance = self._options.plan_tolerance
        # each friction has two products, and friction_law is their sum
        products = {"complementarity": cast(float, eps) + tolerance, "friction_law": 2.0 * cast(float, eps) + tolerance}
        if self._scene.damped:  # the bound holds for spring, switch and force each, not for the force against the true law
            return {**super().promises(eps), "friction_cone": tolerance}
        return {**super().promises(eps), **products, "force_sign": tolerance, "friction_cone": tolerance}
