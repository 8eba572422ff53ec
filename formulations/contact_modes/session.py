"""`mpcc` opened on a scene: several starts, contact windows found from each, the cheapest plan kept, landed on the goal and checked.

    softplus homotopy -> which contact is closed when -> exact optimum for these modes -> cheaper windows -> rollout of the inputs

Starts are numbered, so that some of them can be run here and the others elsewhere:

| number | start |
|---|---|
| 0 | the plan given, or the paper's first guess |
| 1 | the modes of a softplus chain, eps = 1e-3, 1e-5, 1e-7 |
| 2 | the modes of a softplus shooting solution, same eps |
| 3, 4 | both in the mirror of the scene, if it has one |
| others | seeded random inputs, in turn as start of a homotopy and, steered to the goal, as source of modes |

The homotopy forgets where it began, modes do not: hence both.

Throws: where the end is free and has a cost, a plan that touches nothing may be a local optimum from which no slope leads to a contact.

A disc at rest, and another whose place at the end is paid for: nothing done costs 0.61, a throw off the wall 0.39, and all that lies between is dearer.

    constant inputs on a lattice -> those that press something and end at less final cost -> the cheapest, solved with their contact modes

Windows are then searched around the best of these plans as around any other.

The plan is the rollout of its own inputs through the true contact law: complementarity is zero by construction, and what the solvers leave of
the terminal error (1e-9) is taken out by Newton steps.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from time import perf_counter, process_time
from typing import Any

import numpy as np

from formulations.contact_modes.finder import STRIDES, Answer, Finder, Search, descended_plan, input_range, mirrored, random_plan
from formulations.contact_modes.goal import land
from formulations.contact_modes.method import MpccOptions
from formulations.contact_modes.nonlinear import PATIENCE, NonlinearModes, Structures
from formulations.contact_modes.search import windows_of
from formulations.grids import check_warm_start, input_bounds, plan_of
from formulations.method import Method, Session
from formulations.mpec.certificate.certificate import Certificate
from formulations.solution import Attempt, Outcome, Solution
from formulations.transcription.account import SolveBudget
from formulations.transcription.residuals import PlanResiduals
from models.codegen.kernel import Kernel, Rollout, load_kernel
from models.scene import Scene
from models.scene.goal import distance, goal_state
from models.trajectory import Trajectory

_SAMPLES = 2048  # constant inputs tried: of two discs and a wall about 35 of them bring the disc nearer to its goal, in 0.1 CPU s
_SIZES = 4  # powers of two by which they are made smaller, in turn: what is cheap is rarely near its bounds
_SOLVED = 6  # of the cheapest throws are solved with their contact modes, in 0.3 CPU s each
_PRESSED = 1e-6  # [N] a contact that is pressed with less is left open: Ipopt keeps forces to 1e-8


class Throws:
    """The throws of one scene. finder: searches windows around the best of them."""

    def __init__(self, scene: Scene, kernel: Kernel, finder: Finder, options: MpccOptions, structures: Structures) -> None:
        self._scene, self._kernel, self._finder, self._options, self._structures = scene, kernel, finder, options, structures

    def instead_of(self, before: Search, account: SolveBudget, seed: tuple[int, ...]) -> Search:
        """A cheaper plan that throws, or the one before: it stays where there is a goal, where the end costs nothing, and where its inputs press
        a contact that is not pressed without them."""
        task = self._scene.task
        if task.has_goal or task.final_cost == 0 or not self._scene.nc or account.is_late:
            return before
        work = 1e6 * self._options.throw_work
        bounds = input_bounds(self._scene)
        none = np.clip(np.zeros((task.steps, self._scene.nu)), *bounds)
        idle = self._pressed(none)
        planned = none if before.answer is None else before.answer.u
        if work == 0.0 or (self._pressed(planned) & ~idle).any():
            return before
        account.most_work = account.work + work  # on top of what the starts were given: they may have spent it
        problem, best = self._best(account, planned, idle, seed)
        if best is None or (before.answer is not None and best.cost >= before.answer.cost):
            return before
        found = self._finder.searched(account, problem, best, max(1, task.steps // STRIDES), far=True)
        first = "no plan was found" if before.answer is None else f"the best plan brought no contact about (cost {before.answer.cost:.6g})"
        return replace(found, message=f"At first {first}; this one was found from throws by constant inputs. {found.message}")

    def _best(self, account: SolveBudget, planned: np.ndarray, idle: np.ndarray, seed: tuple[int, ...]) -> tuple[object, Answer | None]:
        """The problem with modes fixed, and the cheapest of its answers to the modes of throws."""
        begin = perf_counter()
        below = final_cost(self._kernel, self._kernel.rollout(np.array(self._scene.task.start), planned, self._scene.task.step))
        plans = thrown_plans(self._scene, self._kernel, seed, idle, below)[:_SOLVED]
        most = min(self._options.max_iterations, PATIENCE)
        problem = self._structures.modes(0.0, account, {"tol": self._options.tolerance, "max_iter": most})
        account.build += perf_counter() - begin
        answers: list[Answer] = []
        for plan in plans:
            if isinstance(problem, NonlinearModes):
                problem.guess = plan
            answer = None if account.is_over else problem.solve(plan.lam > 0.0)
            if answer is not None:
                answers.append(answer)
        return problem, min(answers, key=lambda answer: answer.cost, default=None)

    def _pressed(self, u: np.ndarray) -> np.ndarray:
        """(nc,) whether these inputs press a contact at any time."""
        rollout = self._kernel.rollout(np.array(self._scene.task.start), u, self._scene.task.step)
        return np.any(rollout.lam[:, : self._scene.nc] > _PRESSED, axis=0, keepdims=False)


def thrown_plans(scene: Scene, kernel: Kernel, seed: tuple[int, ...], idle: np.ndarray, below: float) -> list[Trajectory]:
    """Motions under constant inputs that press a contact other than those of `idle` (nc,) and end at a final cost below `below`, the cheapest first.

    The inputs are a seeded lattice (Kronecker's: steps of 1/g, 1/g^2, .. with g^(nu+1) = g + 1) over their bounds, a half, a quarter and an eighth
    of them.
    """
    task, (lower, upper) = scene.task, input_range(scene)
    roots = np.roots([1.0, *[0.0] * (scene.nu - 1), -1.0, -1.0])
    ratio = float(roots[np.isreal(roots)].real.max())
    count = np.arange(_SAMPLES)[:, None]
    places = (np.random.default_rng(seed).uniform(size=scene.nu) + count * ratio ** -np.arange(1.0, scene.nu + 1)) % 1.0
    found: list[tuple[float, Trajectory]] = []
    for force in np.clip(0.5 ** (count % _SIZES) * (lower + places * (upper - lower)), lower, upper):
        u = np.tile(force, (task.steps, 1))
        rollout = kernel.rollout(np.array(task.start), u, task.step)
        pressed = (rollout.lam[:, : scene.nc] > 0.0).any(axis=0)
        if rollout.diverged or not (pressed & ~idle).any() or not final_cost(kernel, rollout) < below:
            continue
        plan = plan_of(scene, rollout, u)
        found.append((kernel.cost(rollout.q, rollout.v, u), plan))
    return [plan for _, plan in sorted(found, key=lambda pair: pair[0])]


def final_cost(kernel: Kernel, rollout: Rollout) -> float:
    """The cost of the last state alone."""
    return kernel.cost(rollout.q[-1:], rollout.v[-1:], np.zeros((0, kernel.scene.nu)))


_CHAIN = tuple(float(-np.log(eps)) for eps in (1e-3, 1e-5, 1e-7))  # b L = |ln eps|


@dataclass(frozen=True, kw_only=True)
class _Start:
    words: str
    plan: Trajectory | None
    for_modes: bool  # whether the plan's own modes are tried first


class MultiStart:
    """The starts of one scene."""

    def __init__(
        self,
        scene: Scene,
        kernel: Kernel,
        finder: Finder,
        options: MpccOptions,
        structures: Structures | None = None,
    ) -> None:
        self._scene, self._kernel, self._finder, self._options = scene, kernel, finder, options
        self._structures = structures or Structures(scene, kernel)
        self._throws = Throws(scene, kernel, finder, options, self._structures)

    def run(self, account: SolveBudget, numbers: range, warm_start: Trajectory | None) -> tuple[Search, tuple[Attempt, ...]]:
        """The best of the starts of these numbers, and what became of each. Starts for which there is no time are not among them.

        A start may do half of the work that is left, the last one all of it: better some starts that come to their end than none.
        """
        best: Search | None = None
        attempts: list[Attempt] = []
        most = account.most_work
        for place, number in enumerate(numbers):
            account.most_work = account.work + (most - account.work) / min(2, len(numbers) - place)
            if best is not None and account.is_over:
                break
            began = process_time()
            start = self._start(account, number, warm_start)
            found = self._finder.find(account, start.plan if start.for_modes else None, start.plan)
            attempts.append(self._attempt(number, start, found, process_time() - began))
            if best is None or _cost(found) < _cost(best):
                best = found
        if best is None:
            raise ValueError("a range of starts is never empty: the options see to that.")
        began = process_time()
        thrown = self._throws.instead_of(best, account, (self._options.seed, numbers[0]))
        if thrown is not best:
            place = min(range(len(attempts)), key=lambda place: (attempts[place].cost is None, attempts[place].cost or 0.0))
            start = _Start(words=f"{attempts[place].start}, then throws", plan=None, for_modes=False)
            attempts[place] = self._attempt(attempts[place].number, start, thrown, attempts[place].seconds + process_time() - began)
        return thrown, tuple(attempts)

    def _start(self, account: SolveBudget, number: int, warm_start: Trajectory | None) -> _Start:
        if number == 0:
            words = "the paper's first guess" if warm_start is None else "the plan given"
            return _Start(words=words, plan=warm_start, for_modes=warm_start is not None)
        plan, words = self._special(account, number)
        if plan is not None:
            return _Start(words=words, plan=plan, for_modes=True)
        plan = random_plan(self._scene, self._kernel, (self._options.seed, number))
        for_modes = number % 2 == 0 and plan is not None
        return _Start(words="random inputs, steered to the goal" if for_modes else "random inputs", plan=plan, for_modes=for_modes)

    def _special(self, account: SolveBudget, number: int) -> tuple[Trajectory | None, str]:
        source = {1: self._chain, 2: self._descended, 3: self._chain, 4: self._descended}.get(number)
        if source is None:
            return None, ""
        plan, words = source(account)
        if number <= 2 or plan is None:
            return plan, words
        return mirrored(self._scene, self._kernel, plan), f"{words}, mirrored"

    def _chain(self, account: SolveBudget) -> tuple[Trajectory | None, str]:
        stages: list[Trajectory] = []
        begin = perf_counter()
        homotopy = self._structures.homotopy(self._options.goal_tolerance, _CHAIN)
        account.build += perf_counter() - begin
        ipopt = {"tol": self._options.homotopy_tolerance, "max_iter": self._options.max_iterations}
        homotopy.run(account, ipopt, None, stages.append)
        return (stages[-1] if stages else None), "softplus chain"

    def _descended(self, _account: SolveBudget) -> tuple[Trajectory | None, str]:
        return descended_plan(self._scene, self._kernel), "softplus gradient descent"

    def _attempt(self, number: int, start: _Start, found: Search, seconds: float) -> Attempt:
        if found.answer is None:
            return Attempt(number=number, start=start.words, outcome=found.outcome, seconds=seconds)
        return Attempt(
            number=number,
            start=start.words,
            outcome=found.outcome,
            cost=float(found.answer.cost),
            windows=named_windows(self._scene, found.answer.closed),
            seconds=seconds,
        )


def named_windows(scene: Scene, closed: np.ndarray) -> tuple[tuple[str, int, int], ...]:
    """(contact, first step, last step) of each time a contact is closed; closed (steps, nc)."""
    names = [contact.name for contact in scene.contacts]
    return tuple((name, first, stop - 1) for name, row in zip(names, windows_of(closed), strict=True) for first, stop in row)


def _cost(search: Search) -> float:
    return float("inf") if search.answer is None else search.answer.cost


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
        self._method.check_stage(eps, time_limit)
        if warm_start is not None:
            check_warm_start(self._scene, warm_start)
        account, self._opening = SolveBudget(time_limit, self._opening), (0.0, 0.0)
        account.most_work = 1e6 * self._options.work
        first = self._options.first_start
        search, attempts = self._starts.run(account, range(first, first + self._options.starts), warm_start)
        return self._solution(account, search, attempts)

    def _solution(self, account: SolveBudget, search: Search, attempts: tuple[Attempt, ...]) -> Solution:
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
        bounds = input_bounds(self._scene)
        rollout, u = land(self._kernel, np.array(task.start), goal_state(task), u, task.step, bounds, self._options.goal_tolerance)
        return plan_of(self._scene, rollout, u)

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


def _columns(account: SolveBudget) -> dict[str, tuple[Any, ...]]:
    return {name: tuple(values) for name, values in account.history.items()}
