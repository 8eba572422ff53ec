"""From a scene to the cheapest contact windows that can be found: where the modes come from, and what is tried when they have no plan.

Starts, the same on every machine: rollouts of seeded random inputs, a softplus shooting solution, a plan in the mirror of the scene.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from formulations.contact_modes.goal import approach, land, land_by_softplus, miss_of
from formulations.contact_modes.method import MpccOptions
from formulations.contact_modes.nonlinear import PATIENCE, NlpAnswer, NonlinearModes, Structures, schedule
from formulations.contact_modes.quadratic import ModesAnswer, ModesProblem
from formulations.contact_modes.search import SearchResult, follow_pulls, search_windows
from formulations.grids import coarse_scene, input_bounds, on_grid, plan_of
from formulations.solution import Outcome
from formulations.transcription.feasibility import nearest
from formulations.transcription.workbench import SolveBudget
from models.codegen.kernel import Kernel
from models.contact_law import ContactLaw
from models.scene import Scene
from models.scene.goal import goal_state, miss
from models.schemes import Scheme
from models.trajectory import Trajectory

_PIECES = 10  # of constant input over the horizon
_DESCENTS = 40  # L-BFGS iterations at each eps; the paper's plain gradient descent takes 15, 14 and 11
_COST_WEIGHT = 5e-6  # of the cost in the paper's loss
_DIVERGED = 1e30  # loss of a rollout that is not finite
_SAMPLES = 8  # positions at which a mirror is tried
_SHARE, _UNBOUNDED = 0.3, 1.0  # part of the bounds that is used [1], and what stands for a missing bound [N, N m]


def random_plan(scene: Scene, kernel: Kernel, seed: tuple[int, ...]) -> Trajectory | None:
    """Piecewise constant random inputs through softplus contact at eps = 1e-3; None where the rollout diverges."""
    random, task = np.random.default_rng(seed), scene.task
    lower, upper = input_range(scene)
    pieces = 0.5 * (lower + upper) + _SHARE * 0.5 * (upper - lower) * random.uniform(-1.0, 1.0, (_PIECES, scene.nu))
    u = pieces[np.arange(task.steps) * _PIECES // task.steps]
    rollout = kernel.rollout(np.array(task.start), u, task.step, ContactLaw.SOFTPLUS, 1e-3)
    if rollout.diverged:
        return None
    return plan_of(scene, rollout, u)


def input_range(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the inputs, (nu,) each [N, N m], with a number where one is missing."""
    far = _UNBOUNDED / _SHARE
    lower = np.array([-far if np.isinf(item.lower) else item.lower for item in scene.inputs])
    upper = np.array([far if np.isinf(item.upper) else item.upper for item in scene.inputs])
    return lower, upper


def descended_plan(scene: Scene, kernel: Kernel) -> Trajectory | None:
    """Shooting on softplus contact at eps = 1e-3, 1e-5, 1e-7, each from the inputs before, with the loss of the paper's gradient descent
    (mean square miss of the goal + 5e-6 cost) and L-BFGS in its place; None where a rollout diverges."""
    from scipy.optimize import minimize

    task, goal = scene.task, goal_state(scene.task)
    shape = (task.steps, scene.nu)
    bounds = [(item.lower, item.upper) for item in scene.inputs] * task.steps

    def loss(flat: np.ndarray, eps: float) -> tuple[float, np.ndarray]:
        u = flat.reshape(shape)
        rollout = kernel.rollout(np.array(task.start), u, task.step, ContactLaw.SOFTPLUS, eps)
        if rollout.diverged:
            return _DIVERGED, np.zeros_like(flat)
        missed = miss(np.concatenate([rollout.q[-1], rollout.v[-1]]), goal)
        q_bar, v_bar = np.zeros_like(rollout.q), np.zeros_like(rollout.v)
        q_bar[-1], v_bar[-1] = np.split(2.0 * missed / len(goal), 2)
        u_bar, _ = kernel.adjoint(rollout, u, q_bar, v_bar, cost_bar=_COST_WEIGHT)
        return float(np.mean(missed**2)) + _COST_WEIGHT * kernel.cost(rollout.q, rollout.v, u), u_bar.ravel()

    flat = np.clip(np.zeros(shape), *input_bounds(scene)).ravel()
    for eps in (1e-3, 1e-5, 1e-7):
        flat = minimize(loss, flat, args=(eps,), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": _DESCENTS}).x
    u = flat.reshape(shape)
    rollout = kernel.rollout(np.array(task.start), u, task.step, ContactLaw.SOFTPLUS, 1e-7)
    if rollout.diverged:
        return None
    return plan_of(scene, rollout, u)


def mirrored(scene: Scene, kernel: Kernel, plan: Trajectory) -> Trajectory | None:
    """The plan run backwards and seen in a mirror: q'(t) = c - q(T - t) with the coordinates in reverse order, and c such that the start
    becomes the goal. Three carts pushed from left to right are then again pushed from left to right, first contact last. Without damping
    that is a plan too, with it a start. None where the contacts of the scene are not the same ones in the mirror."""
    start, goal = np.array(scene.task.start), goal_state(scene.task)
    centre = start[: scene.nq] + goal[: scene.nq][::-1]
    if not np.all(np.isfinite(centre)) or not scene.nc:
        return None
    random = np.random.default_rng(0)
    q = start[: scene.nq] + random.normal(size=(_SAMPLES, scene.nq))
    here, there = kernel.penetration(q), kernel.penetration(centre - q[:, ::-1])
    same = np.isclose(here[:, :, None], there[:, None, :], rtol=1e-9, atol=1e-9).all(axis=0)  # [i, j]: contact j mirrored is contact i
    if not (np.all(same.sum(axis=0) == 1) and np.all(same.sum(axis=1) == 1)):
        return None
    lam = np.zeros_like(plan.lam)
    lam[:, : scene.nc] = plan.lam[::-1, : scene.nc][:, same.argmax(axis=1)]
    return Trajectory(
        t=plan.t,
        q=centre - plan.q[::-1, ::-1],
        v=plan.v[::-1, ::-1].copy(),
        u=-plan.u[::-1, ::-1],
        lam=lam,
        scheme=Scheme.SEMI_IMPLICIT_EULER,
    )


_ARRIVED = 1e-6  # from the goal: what remains is taken out by the exact problem
STRIDES = 125  # the first stride is this part of the steps: 4 steps of 500
_STAGES = 3  # of the homotopy whose modes are tried, the sharpest first
_RANDOM = 6  # random inputs that are steered to the goal if the first guess leads nowhere
_NONLINEAR = 20  # a nonlinear scene tries this part of the windows that a linear one may
_NEAREST = 3  # of the rollouts that came nearest an approach is tried from so many

Answer = ModesAnswer | NlpAnswer


@dataclass(frozen=True, kw_only=True)
class Search:
    """answer: the best modes' optimum (None: no modes had a plan); outcome and message: how it ended; tried: modes solved by the search."""

    answer: Answer | None
    outcome: Outcome
    message: str
    tried: int = 0


class Finder:
    """Everything of one scene that is kept from one solve to the next."""

    def __init__(self, scene: Scene, kernel: Kernel, options: MpccOptions, structures: Structures) -> None:
        self._scene, self._kernel, self._options, self._structures = scene, kernel, options, structures
        self._is_linear = structures.is_linear
        self._random_is_vain = False  # all random inputs were steered once, and none of them gave a plan
        self._on_coarse: Finder | None = None
        self._most_work = 0.0  # of the search under way, once it has a plan

    def find(self, account: SolveBudget, modes_of: Trajectory | None = None, start: Trajectory | None = None) -> Search:
        """The best plan. modes_of: a plan whose modes are tried first; start: where the homotopy begins (None: the paper's first guess)."""
        begin = perf_counter()
        problem = self._modes_problem(account)
        account.build += perf_counter() - begin
        self._most_work = account.most_work
        account.most_work = min(self._most_work, account.work + 1e6 * self._options.first_work)
        self._ending = (Outcome.FAILED, "no source of contact modes gave a plan.")
        self._near: list[tuple[float, np.ndarray]] = []  # (miss, modes) of rollouts that do not quite reach the goal
        answer, stride, is_refined = None, max(1, self._scene.task.steps // STRIDES), False
        for guess, fineness in self._guesses(account, modes_of, start):
            answer = self._approached(account, problem, stride) if guess is None else self._exact(account, problem, guess)
            if answer is not None or account.is_over:
                stride, is_refined = fineness or stride, fineness > 0
                break
        is_given_up, account.most_work = account.is_over, self._most_work
        if answer is None:
            outcome, message = self._ending
            if account.is_late:
                outcome, message = Outcome.TIME_LIMIT, "no contact modes with a plan were found in the time given."
            elif account.is_over:
                outcome, message = Outcome.ITERATION_LIMIT, "no feasible contact mode sequence within the work limit."
            elif is_given_up:
                millions = self._options.first_work
                message = f"no feasible contact mode sequence within the work limit until there is one (first_work, {millions:g} million)."
                outcome = Outcome.ITERATION_LIMIT
            return Search(answer=None, outcome=outcome, message=message)
        return self.searched(account, problem, answer, stride, far=not is_refined)

    def _modes_problem(self, account: SolveBudget) -> ModesProblem | NonlinearModes:
        ball = self._options.goal_tolerance if self._scene.task.has_goal else 0.0
        return self._structures.modes(ball, account, self._ipopt_options(self._options.tolerance))

    # -- where modes come from --------------------------------------------------------------------------------------------------

    def _guesses(
        self, account: SolveBudget, modes_of: Trajectory | None, start: Trajectory | None
    ) -> Iterator[tuple[Trajectory | None, int]]:
        """Plans whose modes are worth a try, with the stride (in steps) of a search around them, 0 for the usual one; None: no more from
        this source, so that what came nearest is worth an approach."""
        if modes_of is not None:
            yield modes_of, 0
        coarse = self._coarse(account, start)
        if coarse is not None:
            yield coarse
        if account.is_over:
            return
        first = coarse[0] if coarse is not None else start if start is not None else modes_of
        had_plan = False
        for plan in self._stages(account, first, PATIENCE):
            had_plan = True
            yield plan, 0
        if not had_plan and not account.is_over and self._is_out_of_reach(account):
            return
        yield None, 0
        for plan in self._steered(account, first):
            yield plan, 0
        yield None, 0
        self._random_is_vain = True
        if had_plan:
            for plan in self._stages(account, first, self._options.max_iterations):
                yield plan, 0
            yield None, 0

    def _stages(self, account: SolveBudget, begin_at: Trajectory | None, patience: int) -> list[Trajectory]:
        """The plans of the sharpest stages of the homotopy, the sharpest first."""
        begin, own = perf_counter(), self._options
        sharpnesses = schedule(own.first_sharpness, own.last_sharpness, own.sharpness_growth)
        homotopy = self._structures.homotopy(own.goal_tolerance, sharpnesses)
        account.build += perf_counter() - begin
        stages: list[Trajectory] = []
        ending = homotopy.run(account, self._ipopt_options(own.homotopy_tolerance), begin_at, stages.append, patience)
        self._ending = self._words(*ending)
        return stages[: -_STAGES - 1 : -1]

    def _steered(self, account: SolveBudget, first: Trajectory | None) -> Iterator[Trajectory]:
        """Random inputs, and those of a plan, steered to the goal through softplus contact that grows sharper."""
        task, ball, seed = self._scene.task, self._options.goal_tolerance, self._options.seed
        for index in range(-1, 0 if self._random_is_vain else _RANDOM):  # whatever the start, these are the same
            if account.is_over:
                return
            plan = first if index < 0 else random_plan(self._scene, self._kernel, (seed, index))
            if plan is None:
                continue
            bounds = input_bounds(self._scene)
            sharpness = self._options.first_sharpness
            rollout, u = land_by_softplus(self._kernel, np.array(task.start), goal_state(task), plan.u, task.step, bounds, ball, sharpness)
            if not rollout.diverged:
                yield plan_of(self._scene, rollout, u)

    def _is_out_of_reach(self, account: SolveBudget) -> bool:
        """Not even softplus contact had a plan: how near do the inputs come to the goal at all?"""
        if not self._scene.task.has_goal or self._options.goal_tolerance > 0.0:
            return False
        found = nearest(self._scene, account, account.iterations + self._options.max_iterations)
        if found.is_out_of_reach:
            words = f"no plan reaches the goal within the input bounds: the nearest found misses {found.words}."
            self._ending = (Outcome.INFEASIBLE, words)
        return found.is_out_of_reach

    def _coarse(self, account: SolveBudget, start: Trajectory | None) -> tuple[Trajectory, int] | None:
        """The best plan of a coarser grid, on this one."""
        coarse = coarse_scene(self._scene, self._options.coarse_steps)
        if coarse is None:
            return None
        task = coarse.task
        begin_at = None if start is None else on_grid(start, coarse)
        begun, allowed = account.work, account.most_work
        account.most_work = self._most_work  # what it searches once it has a plan is no search for a first one
        if self._on_coarse is None:
            self._on_coarse = Finder(coarse, self._kernel, self._options, self._structures.coarser(coarse))
        found = self._on_coarse.find(account, start=begin_at)
        account.most_work = min(self._most_work, allowed + account.work - begun)
        if found.answer is None:
            return None
        rollout = self._kernel.rollout(np.array(task.start), found.answer.u, task.step)
        if rollout.diverged:
            return None
        plan = plan_of(coarse, rollout, found.answer.u)
        return on_grid(plan, self._scene), max(1, self._scene.task.steps // task.steps // 2)

    def _words(self, outcome: Outcome, message: str) -> tuple[Outcome, str]:
        task = self._scene.task
        if outcome is Outcome.INFEASIBLE:
            return outcome, (
                f"no plan of {task.steps} steps of {task.step:g} s was found that reaches the goal within the input bounds, not even with "
                "forces at a distance."
            )
        if outcome is Outcome.SOLVED:
            return Outcome.STALLED, "softplus plans were found, but the contact modes read off them have no exact plan."
        return outcome, f"softplus homotopy: {message}"

    # -- what is done with them --------------------------------------------------------------------------------------------------

    def _exact(self, account: SolveBudget, problem: ModesProblem | NonlinearModes, plan: Trajectory) -> Answer | None:
        """The optimum for the modes of a plan; where they have none, for the modes of its inputs in true contact, steered to the goal.

        The latter modes have a plan, namely that rollout, whenever it arrives.
        """
        begin = perf_counter()
        answer = None
        for closed in self._modes(plan):
            if isinstance(problem, NonlinearModes):
                problem.guess = plan
            answer = problem.solve(closed)
            if answer is not None or account.is_over:
                break
        if self._is_linear:  # the account knows the time of Ipopt's runs
            account.linear_algebra += perf_counter() - begin
        return answer

    def _modes(self, plan: Trajectory) -> Iterator[np.ndarray]:
        yield self._kernel.penetration(plan.q[:-1]) > 0.0
        task, ball = self._scene.task, self._options.goal_tolerance
        bounds = input_bounds(self._scene)
        goal = goal_state(task)
        rollout, _ = land(self._kernel, np.array(task.start), goal, plan.u, task.step, bounds, ball)
        if rollout.diverged:
            return
        missed = float(np.linalg.norm(miss_of(rollout, goal, ball)))
        if missed <= _ARRIVED:
            yield rollout.lam > 0.0
        self._near.append((missed, rollout.lam > 0.0))

    def _approached(self, account: SolveBudget, problem: ModesProblem | NonlinearModes, stride: int) -> Answer | None:
        """From the modes of the rollouts that came nearest to the goal, nearest first."""
        begin = perf_counter()
        near, self._near = sorted(self._near, key=lambda pair: pair[0]), []
        answer = None
        if isinstance(problem, ModesProblem):
            for _, closed in near[:_NEAREST]:
                answer = approach(problem, closed, stride, lambda: account.is_over)
                if answer is not None or account.is_over:
                    break
            account.linear_algebra += perf_counter() - begin
        return answer

    def searched(self, account: SolveBudget, problem: Any, answer: Answer, stride: int, *, far: bool) -> Search:
        """The cheapest plan around. far: whether to look further than a step (a coarser grid has seen to that already)."""
        how = "the rest is a convex quadratic program, solved exactly" if self._is_linear else "the rest was solved by Ipopt"
        if not self._scene.nc:
            return Search(answer=answer, outcome=Outcome.SOLVED, message=f"There are no contacts; {how}.")
        begin, most = perf_counter(), problem.solves + self._most_windows()
        share = self._options.search_share
        end, done = begin + share * account.remaining, account.work + share * (account.most_work - account.work)

        def is_over() -> bool:
            return problem.solves >= most or account.work >= done or perf_counter() >= end

        def improve(closed: np.ndarray, near: Answer, below: float) -> Answer | None:
            return problem.solve(closed, near=near, below=below)

        found = SearchResult(best=answer, tried=0, complete=False)
        if self._options.search:
            found = search_windows(answer, improve, stride=stride, is_over=is_over, far=far)
        is_late = perf_counter() >= end
        if not found.complete:  # the plan is to be stationary all the same
            last = problem.solves + self._most_windows()
            pulled = follow_pulls(found.best, improve, is_over=lambda: problem.solves >= last or account.is_over)
            found = SearchResult(best=pulled.best, tried=found.tried + pulled.tried, complete=False)
        if self._is_linear:
            account.linear_algebra += perf_counter() - begin
        message = f"With the contact windows fixed {how}; {found.tried} neighbouring windows were tried, none is cheaper than this plan."
        if isinstance(problem, NonlinearModes):
            known = f"{problem.unsolved} of {problem.solves} solves found no plan in a few iterations, which proves nothing"
            message = f"With the contact windows fixed {how}; of {found.tried} neighbouring windows none was found to be cheaper ({known})."
        if not self._options.search:
            message = f"Contact modes were read off a softplus plan; {how}."
        elif not found.complete:
            why = "its part of the time was over before all were" if is_late else "as many as it may try"
            message = f"With the contact windows fixed {how}; {found.tried} neighbouring windows were tried, {why}: others may be cheaper."
        return Search(
            answer=found.best, outcome=Outcome.TIME_LIMIT if account.is_late else Outcome.SOLVED, message=message, tried=found.tried
        )

    def _most_windows(self) -> int:
        """Modes that a search may ask for; a nonlinear scene's cost a run of Ipopt each."""
        return self._options.search_windows // (1 if self._is_linear else _NONLINEAR)

    def _ipopt_options(self, tolerance: float) -> dict[str, Any]:
        return {"tol": tolerance, "max_iter": self._options.max_iterations}
