"""`mpcc` opened on a scene: homotopy, modes read off, the exact problem with these modes, search over windows, and a landing on the goal.

    softplus homotopy -> which contact is closed when -> exact optimum for these modes -> cheaper windows -> rollout of the inputs

The plan is the rollout of its own inputs through the true contact law: complementarity is zero by construction, and what the solvers leave of
the terminal error (1e-9) is taken out by Newton steps. Where the end is free and the plan touches nothing, `throws` looks for one that does.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any

import numpy as np

from formulations.contact_modes.finder import Finder, Search
from formulations.contact_modes.goal import land
from formulations.contact_modes.multistart import MultiStart
from formulations.contact_modes.nonlinear import Structures
from formulations.method import Method, OptionError, Session
from formulations.solution import Attempt, Outcome, Solution
from formulations.transcription.residuals import PlanResiduals
from formulations.transcription.workbench import Account
from models.codegen.kernel import load_kernel
from models.errors import TrajectoryError
from models.scene import Scene
from models.scene.goal import distance, goal_state
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid

if TYPE_CHECKING:
    from formulations.methods.mpcc import MpccOptions
    from formulations.mpec.certificate.certificate import Certificate


class MpccSession(Session):
    """See the module docstring."""

    def __init__(
        self,
        method: Method,
        scene: Scene,
        options: MpccOptions,
        opening: tuple[float, float],
        structures: Structures | None = None,
    ) -> None:
        self._method, self._scene, self._options = method, scene, options
        self._kernel, self._residuals = load_kernel(scene), PlanResiduals(scene)
        self._structures = structures or Structures(scene, self._kernel)
        self._finder = Finder(scene, self._kernel, self._options, self._structures)
        self._starts = MultiStart(scene, self._kernel, self._finder, self._options, self._structures)
        self._opening = (perf_counter() - opening[0], process_time() - opening[1])

    def within(self, goal_tolerance: float, *, from_a_plan: bool = True) -> MpccSession:
        """A session for another radius of the goal, which uses the models of this one; what starts without a plan may do `first_work` more."""
        more = 0.0 if from_a_plan else self._options.first_work
        options = replace(self._options, goal_tolerance=goal_tolerance, work=self._options.work + more)
        return MpccSession(self._method, self._scene, options, (perf_counter(), process_time()), self._structures)

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        self._method.check_eps(eps)
        if not time_limit > 0.0:
            raise OptionError(f"method {self._method.name}: the time limit is {time_limit!r}, but must be a positive number of seconds.")
        if warm_start is not None:
            self._check_grid(warm_start)
        account, self._opening = Account(time_limit, self._opening), (0.0, 0.0)
        account.most_work = 1e6 * self._options.work
        first = self._options.first_start
        search, attempts = self._starts.run(account, range(first, first + self._options.starts), warm_start)
        return self._solution(account, search, attempts)

    def _check_grid(self, plan: Trajectory) -> None:
        plan.check_fits(self._scene)
        task = self._scene.task
        if plan.steps != task.steps or not np.allclose(
            plan.t - plan.t[0], uniform_grid(task.step, task.steps), rtol=1e-9, atol=1e-9 * task.step
        ):
            raise TrajectoryError(
                f"warm start: it has {plan.steps} steps over {plan.t[-1] - plan.t[0]:g} s, but scene {self._scene.name} has {task.steps} steps of "
                f"{task.step:g} s; resample it to that grid."
            )

    def _solution(self, account: Account, search: Search, attempts: tuple[Attempt, ...]) -> Solution:
        several = attempts if len(attempts) > 1 else ()
        empty = Solution(
            method=self._method.name, outcome=search.outcome, message=search.message, options=asdict(self._options), starts=several
        )
        answer = search.answer
        if answer is None:
            return replace(empty, iterations=account.iterations, seconds=account.seconds(), history=_columns(account))
        plan = self.landed(answer.u)
        residuals = self.certificate(plan)
        stationarity = answer.stationarity()
        if several:
            optima = [attempt.cost for attempt in several if attempt.cost is not None]
            spread = f"costs from {min(optima):.6g} to {max(optima):.6g}"
            search = replace(search, message=f"{len(optima)} of {self._options.starts} starts were solved, {spread}. {search.message}")
            residuals |= {"starts_solved": float(len(optima)), "dearest_start": max(optima)}
        outcome, message = search.outcome, f"{search.message} {stationarity.sentence}"
        missed = {name: limit for name, limit in self._promises().items() if not residuals.get(name, 0.0) <= limit}
        if missed and outcome is Outcome.SOLVED:
            worst = ", ".join(f"{name} is {residuals[name]:.3g} (limit {limit:g})" for name, limit in missed.items())
            outcome, message = Outcome.STALLED, f"{message} Checked on the plan itself, {worst}."
        certificate = None
        if outcome is Outcome.SOLVED and stationarity.letter != "S":
            certificate = self._structures.judge().certify(plan, goal_tolerance=self._options.goal_tolerance)
            outcome, message = _judged(certificate, message)
        residuals |= {
            "dual_infeasibility": answer.dual_infeasibility,
            "biactive_pairs": float(stationarity.biactive),
            "least_biactive_multiplier": stationarity.least,
            "windows_tried": float(search.tried),
        }
        return replace(
            empty,
            outcome=outcome,
            message=message,
            trajectory=plan,
            cost=self._residuals.cost(plan),
            iterations=account.iterations,
            seconds=account.seconds(),
            residuals=residuals,
            history=_columns(account),
            certificate=certificate,
        )

    def landed(self, u: np.ndarray) -> Trajectory:
        """The plan of these inputs, corrected to end on the goal: their rollout through the true contact law."""
        task = self._scene.task
        bounds = tuple(np.array([getattr(item, side) for item in self._scene.inputs]) for side in ("lower", "upper"))
        rollout, u = land(
            self._kernel, np.array(task.start), goal_state(task), u, task.step, (bounds[0], bounds[1]), self._options.goal_tolerance
        )
        return Trajectory(
            t=uniform_grid(task.step, task.steps), q=rollout.q, v=rollout.v, u=u, lam=rollout.lam, scheme=Scheme.SEMI_IMPLICIT_EULER
        )

    def certificate(self, plan: Trajectory) -> dict[str, float]:
        """Residuals of the plan by name; complementarity with the penetration of the same compiled code that the forces come from."""
        found = self._residuals.of(plan)
        if self._scene.nc:
            products = np.abs(plan.lam * (plan.lam - self._kernel.stiffness() * self._kernel.penetration(plan.q[:-1])))
            found |= {"physics": float(products.sum()), "complementarity": float(products.max())}
        task = self._scene.task
        replay = self._kernel.rollout(np.array(task.start), plan.u, task.step)
        end = np.concatenate([replay.q[-1], replay.v[-1]])
        return {**found, "discrete_terminal_error": distance(end, goal_state(task))}

    def _promises(self) -> dict[str, float]:
        plan, miss = self._options.plan_tolerance, self._options.terminal_tolerance + self._options.goal_tolerance
        return {
            **dict.fromkeys(("dynamics_defect", "start_error", "input_bound_excess", "velocity_bound_excess", "force_sign"), plan),
            **dict.fromkeys(("terminal_error", "discrete_terminal_error"), miss),
            "physics": self._options.physics_tolerance,
        }


def _judged(found: Certificate, message: str) -> tuple[Outcome, str]:
    """Touching pairs pull, and no other mode of theirs was found to be cheaper: whether the plan can be left downhill after all.

    Where conditions depend on each other the multipliers are not the only ones, and others may have the right signs.
    """
    if found.b_stationary:
        return Outcome.SOLVED, f"{message} These multipliers are not the only ones: no direction leads downhill (B-stationary)."
    known = (
        "it is not B-stationary, so that cheaper plans lie next to it"
        if found.b_stationary is False
        else "whether it is B-stationary is not known"
    )
    return Outcome.STALLED, f"{message} The plan holds, but {known}: {found.sentence}."


def _columns(account: Account) -> dict[str, tuple[Any, ...]]:
    return {name: tuple(values) for name, values in account.history.items()}
