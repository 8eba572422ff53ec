"""Multiple shooting by sequential linear-quadratic programming with feedback rollouts.

Unknowns are the inputs u and the states x at every node; gap[t] = f(x[t], u[t]) - x[t+1]. The
subproblem (riccati.c, linear in the number of stages) gives inputs and feedback, with which the
scene's time step rolls out; an unstable scene stays near the plan. A step must lower the exact
penalty cost + goal term + nu sum |gap|, nu above the multipliers of the gaps.

The recursion is iLQR with gaps (Mastalli et al., Crocoddyl, ICRA 2020); input bounds are met stage
by stage by a small QP (Tassa, Mansard and Todorov, ICRA 2014).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from time import perf_counter

import numpy as np
import sympy as sp

from formulations.grids import input_bounds
from formulations.method import Options, option
from formulations.solution import Outcome
from formulations.transcription.residuals import rows_of
from models.codegen.compiler import cached_library, load_library
from models.codegen.steps import Linearised, Steps
from models.contact_law import ContactLaw
from models.dynamics import derive
from models.scene import Scene
from models.scene.goal import goal_state, miss

_SOURCE = Path(__file__).with_name("riccati.c")
_SIGNATURES = {
    "riccati_work": ("n", "nn"),
    "riccati_backward": ("n", "nnn" + "p" * 8 + "d" + "p" * 9),
    "riccati_forward": ("", "nnn" + "p" * 7),
}


@dataclass(frozen=True, kw_only=True)
class MultipleShootingOptions(Options):
    """Options of multiple shooting."""

    goal_weight: float = option(
        1e4,
        "first weight of half the squared miss of the goal, beside the cost; multipliers take over what it leaves",
        lower=1e-6,
        upper=1e9,
    )
    goal_tolerance: float = option(
        1e-6, "solved only if the plan ends this near to its goal, in (q, v)", lower=1e-12
    )
    gap_tolerance: float = option(
        1e-9,
        "solved only if every step ends this near to the next node; below it the plan is one simulation",
        lower=1e-14,
        upper=1e-3,
    )
    tolerance: float = option(
        1e-6,
        "relative decrease of cost and goal term still promised by the subproblem that counts as none",
        lower=1e-12,
        upper=1.0,
    )
    max_iterations: int = option(300, "most linear-quadratic subproblems", lower=1, upper=10**9)
    guess: str = option(
        "line",
        "the nodes without a warm start: on the line from start to goal, or all at the start",
        choices=("line", "start"),
    )


class GoalTerm:
    """The goal as an augmented Lagrangian, y'm + weight/2 |m|^2 with m = x_T - goal, 0 where free.

    y (2*nq,) are the multipliers, initially zero; they are updated when the iterations settle.
    """

    def __init__(self, scene: Scene, weight: float) -> None:
        self._goal = goal_state(scene.task)
        self._given = ~np.isnan(self._goal)
        self.multipliers = np.zeros(len(self._goal))
        self.weight = weight

    def miss(self, end: np.ndarray) -> np.ndarray:
        """Return end - goal (2*nq,) [SI] of an end (2*nq,) [m, rad, m/s, rad/s].

        Raises ValueError for another length.
        """
        return miss(end, self._goal)

    def value(self, end: np.ndarray) -> float:
        """Return the term at an end (2*nq,) [m, rad, m/s, rad/s].

        Raises ValueError for another length.
        """
        m = self.miss(end)
        return float(self.multipliers @ m + 0.5 * self.weight * m @ m)

    def slope(self, end: np.ndarray) -> np.ndarray:
        """Return the gradient (2*nq,) [1/m, 1/rad, s/m, s/rad] at an end (2*nq,) [SI].

        Raises ValueError for another length.
        """
        return np.where(self._given, self.multipliers + self.weight * self.miss(end), 0.0)

    def hessian(self) -> np.ndarray:
        """Return the Hessian (2*nq, 2*nq) [-]. Raises nothing."""
        return np.diag(np.where(self._given, self.weight, 0.0))

    def update(self, end: np.ndarray) -> None:
        """Update y <- y + weight (x_T - goal) at an end (2*nq,) [m, rad, m/s, rad/s].

        Raises ValueError for another length.
        """
        self.multipliers += np.where(self._given, self.weight * self.miss(end), 0.0)


class Costs:
    """Running and final cost of a scene, with slopes and positive semidefinite Hessians."""

    def __init__(self, scene: Scene) -> None:
        d = derive(scene)
        state, inputs = [*d.q, *d.v], list(d.u)
        values = scene.parameter_values
        running, final = (
            sp.sympify(d.running_cost).xreplace(values),
            sp.sympify(d.final_cost).xreplace(values),
        )
        self._running = _Derivatives(running, [*state, *inputs])
        self._final = _Derivatives(final, state)

    def value(self, x: np.ndarray, u: np.ndarray) -> float:
        """Return the cost of nodes x (steps+1, nx) [SI] and inputs u (steps, nu) [N, N m].

        Raises ValueError if their lengths do not fit.
        """
        return float(
            self._running.value(np.hstack([x[:-1], u])).sum() + self._final.value(x[-1:])[0]
        )

    def running(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return slope (steps, nx+nu) and Hessian (steps, nx+nu, nx+nu) [-] of the running cost.

        Raises ValueError if their lengths differ.
        """
        point = np.hstack([x, u])
        return self._running.slope(point), self._running.hessian(point)

    def final(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return slope (nx,) and Hessian (nx, nx) [-] of the final cost at x (nx,) [SI].

        Raises nothing.
        """
        point = x[None, :]
        return self._final.slope(point)[0], self._final.hessian(point)[0]


class _Derivatives:
    def __init__(self, expression: sp.Expr, symbols: Sequence[sp.Symbol]) -> None:
        n = len(symbols)
        slope = [sp.diff(expression, symbol) for symbol in symbols]
        hessian = [sp.diff(entry, symbol) for entry in slope for symbol in symbols]
        self._n = n
        self._value, self.slope, self._hessian = (
            rows_of(entries, symbols) for entries in ([expression], slope, hessian)
        )
        self._quadratic = not any(entry.free_symbols for entry in hessian)

    def value(self, point: np.ndarray) -> np.ndarray:
        """Return values (n,) [-] at points (n, symbols) [SI]. Raises nothing."""
        return self._value(point)[:, 0]

    def hessian(self, point: np.ndarray) -> np.ndarray:
        """Return semidefinite Hessians (n, symbols, symbols) [-] at points (n, symbols) [SI].

        Raises LinAlgError if the eigenvalues do not converge, as for NaN.
        """
        rows = self._hessian(point[:1] if self._quadratic else point).reshape(-1, self._n, self._n)
        value, vectors = np.linalg.eigh(rows)
        convex = (
            (vectors * np.maximum(value, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
            if (value < 0.0).any()
            else rows
        )
        return np.broadcast_to(convex, (len(point), self._n, self._n))


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    return load_library(
        cached_library({_SOURCE.name: _SOURCE.read_text(encoding="utf-8")}), _SIGNATURES
    )


class Stages:
    """The data of the subproblem, and its solution (riccati.c).

    - A (steps, nx, nx), B (steps, nx, nu), gap (steps, nx): the linearised steps
    - lx (steps, nx), lu (steps, nu): gradients of the cost of the stages
    - lxx (steps, nx, nx), lux (steps, nu, nx), luu (steps, nu, nu): second derivatives of that cost
    - px (nx,), pxx (nx, nx): the cost of the end
    - k (steps, nu), K (steps, nu, nx): du = k + K dx
    - Vx (steps+1, nx): slope of the value, the multiplier of each gap
    """

    def __init__(self, steps: int, nx: int, nu: int) -> None:
        self.steps, self.nx, self.nu = steps, nx, nu
        self.A, self.B, self.gap = (
            np.zeros((steps, nx, nx)),
            np.zeros((steps, nx, nu)),
            np.zeros((steps, nx)),
        )
        self.lx, self.lu = np.zeros((steps, nx)), np.zeros((steps, nu))
        self.lxx, self.lux, self.luu = (
            np.zeros((steps, nx, nx)),
            np.zeros((steps, nu, nx)),
            np.zeros((steps, nu, nu)),
        )
        self.px, self.pxx = np.zeros(nx), np.zeros((nx, nx))
        self.k, self.K, self.Vx = (
            np.zeros((steps, nu)),
            np.zeros((steps, nu, nx)),
            np.zeros((steps + 1, nx)),
        )
        self._library = _library()
        self._room = np.zeros(self._library.riccati_work(nx, nu))
        self._held = np.zeros(nu, dtype=np.intc)

    def backward(self, u: np.ndarray, lower: np.ndarray, upper: np.ndarray, shift: float) -> bool:
        """Set k, K, Vx for inputs u (steps, nu) [N, N m] within bounds (nu,) [N, N m].

        shift is added to the inputs' Hessian. Return False if a Hessian is not positive definite; a
        larger shift may help. Raises nothing: sizes are not checked.
        """
        self.Vx[-1] = self.px
        hessian = self.pxx.copy()
        linear = (self.A, self.B, self.gap, self.lx, self.lu, self.lxx, self.lux, self.luu)
        inputs = [np.ascontiguousarray(array, dtype=np.float64) for array in (u, lower, upper)]
        rest = (*inputs, self.Vx, hessian, self.k, self.K, self._room, self._held)
        failed = self._library.riccati_backward(
            self.steps,
            self.nx,
            self.nu,
            *(a.ctypes.data for a in linear),
            shift,
            *(a.ctypes.data for a in rest),
        )
        return failed == 0

    def forward(self, gap: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return dx (steps+1, nx) [SI], du (steps, nu) [N, N m] of the stages under k and K.

        With a gap (steps, nx) [SI] only K applies. Raises nothing: sizes are not checked.
        """
        dx, du = np.zeros((self.steps + 1, self.nx)), np.zeros((self.steps, self.nu))
        arrays = (self.A, self.B, self.gap, self.k, self.K, dx, du)
        if gap is not None:
            arrays = (
                self.A,
                self.B,
                np.ascontiguousarray(gap),
                np.zeros_like(self.k),
                self.K,
                dx,
                du,
            )
        self._library.riccati_forward(
            self.steps, self.nx, self.nu, *(array.ctypes.data for array in arrays)
        )
        return dx, du


# Sufficient share of the decrease promised by the linearised penalty function.
_SUFFICIENT = 1e-4
# Shortest step length; below it the subproblem is damped instead.
_SHORTEST = 2.0**-12
# nu relative to the largest multiplier of a gap.
_NU = 1.5
# First shift of the inputs' Hessian, relative to its size.
_FIRST_SHIFT = 1e-6
# Largest shift, relative to the Hessian's size.
_LARGEST_SHIFT = 1e12
# Factor between two shifts.
_SHIFT_GROWTH = 10.0
# Ratio of goal errors between updates; a larger one multiplies the weight by ten.
_SLOW = 0.25
# Largest weight.
_HEAVIEST = 1e12
# Consecutive steps of too little gain that end the iterations: a kink.
_CRAWL = 10
# Gain relative to the precision that is too little.
_CRAWLS = 1e-2
# Precision before the first update of the multipliers; each update reduces it by ten.
_FIRST_PRECISION = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class SolverResult:
    """The result: last nodes x (steps+1, 2*nq) and inputs u (steps, nu).

    gap: largest entry
    slope: promised decrease of the penalty function
    history: columns of equal length, one row per iteration
    """

    outcome: Outcome
    message: str
    x: np.ndarray
    u: np.ndarray
    gap: float
    slope: float
    iterations: int
    history: dict[str, list[float]]


# Nodes, inputs and their linearised steps after a step of this length.
_Taken = tuple[np.ndarray, np.ndarray, Linearised, float]


@dataclass(eq=False)
class Solver:
    """The iterations on one scene; evaluate_seconds is the wall time in its compiled steps."""

    steps: Steps
    costs: Costs
    law: ContactLaw
    eps: float | None
    options: MultipleShootingOptions
    evaluate_seconds: float = 0.0
    _history: dict[str, list[float]] = field(
        default_factory=lambda: {
            "penalty": [],
            "cost": [],
            "terminal_error": [],
            "gap": [],
            "length": [],
        }
    )

    def solve(self, x: np.ndarray, u: np.ndarray, deadline: float) -> SolverResult:
        """Iterate until nodes and inputs settle, or a limit is reached.

        Parameters
        ----------
        x : (steps+1, 2*nq) [m, rad, m/s, rad/s], first nodes, x[0] the start
        u : (steps, nu) [N, N m], first inputs, within their bounds
        deadline : of perf_counter [s]

        Raises
        ------
        MachineError
            without a C compiler
        """
        scene, options = self.steps.scene, self.options
        goal = GoalTerm(scene, options.goal_weight)
        self._lower, self._upper = input_bounds(scene)
        self._stages = Stages(len(u), 2 * scene.nq, scene.nu)
        shift, slope, last_miss, iteration, crawling, nu, settled = (
            0.0,
            -np.inf,
            np.inf,
            0,
            0,
            0.0,
            False,
        )
        precision = (
            max(options.tolerance, _FIRST_PRECISION) if scene.task.has_goal else options.tolerance
        )
        lin = self._linearise(x, u)

        def ended(outcome: Outcome, message: str) -> SolverResult:
            gap = np.inf if lin is None else float(np.abs(lin.next - x[1:]).max())
            return SolverResult(
                outcome=outcome,
                message=message,
                x=x,
                u=u,
                gap=gap,
                slope=slope,
                iterations=iteration,
                history=self._history,
            )

        if lin is None:
            return ended(
                Outcome.EVALUATION_ERROR,
                "a time step from the first guess is not finite; start, parameters and inputs must allow one",
            )
        while True:
            if iteration >= options.max_iterations:
                return ended(
                    Outcome.ITERATION_LIMIT, f"stopped at max_iterations = {options.max_iterations}"
                )
            if perf_counter() >= deadline:
                return ended(
                    Outcome.TIME_LIMIT, f"stopped after {iteration} iterations at its time limit"
                )
            self._fill(x, u, lin, goal)
            size = float(np.abs(self._stages.luu).max(initial=0.0)) or 1.0
            taken = None
            while taken is None and shift <= _LARGEST_SHIFT:
                if self._stages.backward(u, self._lower, self._upper, shift * size):
                    slope, nu = self._slope()
                    settled = -slope <= precision * max(
                        abs(self._penalty(x, u, goal, nu, self._stages.gap)), 1e-12
                    )
                    if settled or crawling >= _CRAWL:
                        break
                    taken = self._search(x, u, goal, nu, slope)
                if taken is None:
                    shift = max(_FIRST_SHIFT, shift * _SHIFT_GROWTH)
            iteration += 1
            gap = float(np.abs(self._stages.gap).max())
            if taken is not None:
                before = self._penalty(x, u, goal, nu, self._stages.gap)
                x, u, lin, length = taken
                won = before - self._penalty(x, u, goal, nu, lin.next - x[1:])
                crawling = crawling + 1 if won <= _CRAWLS * precision * abs(before) else 0
                shift = (
                    shift / _SHIFT_GROWTH
                    if length == 1.0 and shift > _FIRST_SHIFT
                    else 0.0
                    if length == 1.0
                    else shift
                )
                self._note(x, u, goal, lin, length)
                continue
            miss = float(np.linalg.norm(goal.miss(x[-1])))
            if shift > _LARGEST_SHIFT:
                return ended(
                    Outcome.STALLED,
                    "no step along the subproblem's direction lowers the penalty function, however short or damped",
                )
            if (
                miss <= options.goal_tolerance
                and gap <= options.gap_tolerance
                and precision <= options.tolerance
            ):
                if settled:
                    return ended(Outcome.SOLVED, "")
                return ended(
                    Outcome.STALLED,
                    f"the last {_CRAWL} steps gained next to nothing, although the subproblem promises {-slope:.2g}",
                )
            if goal.weight > _HEAVIEST:
                return ended(
                    Outcome.STALLED,
                    f"the goal is still missed by {miss:.3g} although its weight has grown to {goal.weight:.1g}",
                )
            goal.update(x[-1])
            if miss > max(options.goal_tolerance, _SLOW * last_miss):
                goal.weight *= 10.0
            precision = max(options.tolerance, 0.1 * precision)
            last_miss, shift, crawling = miss, 0.0, 0

    def _linearise(self, x: np.ndarray, u: np.ndarray) -> Linearised | None:
        started = perf_counter()
        linear = self.steps.linearise(x[:-1], u, self.steps.scene.task.step, self.law, self.eps)
        self.evaluate_seconds += perf_counter() - started
        return linear

    def _fill(self, x: np.ndarray, u: np.ndarray, lin: Linearised, goal: GoalTerm) -> None:
        stages, nx = self._stages, x.shape[1]
        stages.A[:], stages.B[:] = lin.A, lin.B
        np.subtract(lin.next, x[1:], out=stages.gap)
        slope, hessian = self.costs.running(x[:-1], u)
        stages.lx[:], stages.lu[:] = slope[:, :nx], slope[:, nx:]
        stages.lxx[:], stages.lux[:], stages.luu[:] = (
            hessian[:, :nx, :nx],
            hessian[:, nx:, :nx],
            hessian[:, nx:, nx:],
        )
        slope_end, hessian_end = self.costs.final(x[-1])
        stages.px[:], stages.pxx[:] = slope_end + goal.slope(x[-1]), hessian_end + goal.hessian()

    def _slope(self) -> tuple[float, float]:
        stages = self._stages
        dx, du = stages.forward()
        nu = _NU * float(np.abs(stages.Vx).max())
        along = float((stages.lx * dx[:-1]).sum() + (stages.lu * du).sum() + stages.px @ dx[-1])
        return along - nu * float(np.abs(stages.gap).sum()), nu

    def _penalty(
        self, x: np.ndarray, u: np.ndarray, goal: GoalTerm, nu: float, gap: np.ndarray
    ) -> float:
        return self.costs.value(x, u) + goal.value(x[-1]) + nu * float(np.abs(gap).sum())

    def _search(
        self, x: np.ndarray, u: np.ndarray, goal: GoalTerm, nu: float, slope: float
    ) -> _Taken | None:
        """Return the longest step that lowers the penalty function enough, or None.

        With gaps the nodes follow the subproblem's step, so that errors grow over one time step
        only. Without gaps, or if that fails, the plan is rolled out under feedback.
        """
        before = self._penalty(x, u, goal, nu, self._stages.gap)
        dx, du = self._stages.forward()
        open_gaps = float(np.abs(self._stages.gap).max()) > self.options.gap_tolerance
        for rolled in (False, True) if open_gaps else (True,):
            length = 1.0
            while length >= _SHORTEST:
                limit = before + _SUFFICIENT * length * slope
                trial = (
                    self._rolled(x, u, length)
                    if rolled
                    else self._moved(x, u, length * dx, length * du)
                )
                gap = None if trial is None else self._gap(*trial)
                if trial is not None and gap is not None:
                    lin = self._lower_at(trial, gap, goal, nu, limit)
                    # One more linear step closes the gaps that nonlinearity left open.
                    if lin is None and not rolled:
                        ddx, ddu = self._stages.forward(gap - (1.0 - length) * self._stages.gap)
                        trial = self._moved(*trial, ddx, ddu)
                        gap = self._gap(*trial)
                        if gap is not None:
                            lin = self._lower_at(trial, gap, goal, nu, limit)
                    if lin is not None:
                        return *trial, lin, length
                length *= 0.5
        return None

    def _gap(self, x: np.ndarray, u: np.ndarray) -> np.ndarray | None:
        started = perf_counter()
        ends = self.steps.ends(x[:-1], u, self.steps.scene.task.step, self.law, self.eps)
        self.evaluate_seconds += perf_counter() - started
        return None if ends is None else ends - x[1:]

    def _lower_at(
        self,
        trial: tuple[np.ndarray, np.ndarray],
        gap: np.ndarray,
        goal: GoalTerm,
        nu: float,
        limit: float,
    ) -> Linearised | None:
        lower = self._penalty(*trial, goal, nu, gap) <= limit
        return self._linearise(*trial) if lower else None

    def _moved(
        self, x: np.ndarray, u: np.ndarray, dx: np.ndarray, du: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        return x + dx, np.clip(u + du, self._lower, self._upper)

    def _rolled(
        self, x: np.ndarray, u: np.ndarray, length: float
    ) -> tuple[np.ndarray, np.ndarray] | None:
        stages = self._stages
        started = perf_counter()
        run = self.steps.follow(
            x[0],
            x[:-1],
            u + length * stages.k,
            stages.K,
            self.steps.scene.task.step,
            self.law,
            self.eps,
            (length - 1.0) * stages.gap,
        )
        self.evaluate_seconds += perf_counter() - started
        return None if run.diverged else (run.x, run.u)

    def _note(
        self, x: np.ndarray, u: np.ndarray, goal: GoalTerm, lin: Linearised, length: float
    ) -> None:
        cost = self.costs.value(x, u)
        row = (
            cost + goal.value(x[-1]),
            cost,
            float(np.linalg.norm(goal.miss(x[-1]))),
            float(np.abs(lin.next - x[1:]).max()),
            length,
        )
        for column, value in zip(self._history.values(), row, strict=True):
            column.append(value)
