"""L-BFGS on an Objective within the input bounds (SciPy's L-BFGS-B), with multipliers for the goal.

    result = minimise(objective, u0, QuasiNewtonOptions(), time_limit=60.0)

The loss weighs the goal against the cost, so its minimum misses the goal a little. Each further
round aims at goal - s, with s <- s + (x_T - goal): the method of multipliers, because
w |m + s|^2 = w |m|^2 + 2 w s'm + constant. (`torch.optim.LBFGS` has no bounds.)
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
from scipy.optimize import Bounds, minimize

from formulations.grids import input_bounds
from formulations.shooting.descent import Descent, dead_contact_message, stable_rate
from formulations.shooting.objective import Objective
from formulations.shooting.options import QuasiNewtonOptions
from formulations.solution import Outcome, ended

# Iterations over which the decrease is measured.
_JUDGED_OVER = 20
# A round with an error above this share of the smallest one increases the goal's weight.
_SHRINKS = 0.25
# Factor of the weight.
_HEAVIER = 5.0
# Three consecutive rounds with an error above this share of the smallest one end the rounds.
_STALLS = 0.9
# Relative to the first gradient: a smaller one counts as zero if no step lowers the loss.
_FLAT = 1e-5


class _Run:
    """One minimisation for a fixed aim, scaled by its first value."""

    def __init__(
        self,
        objective: Objective,
        goal: np.ndarray,
        options: QuasiNewtonOptions,
        deadline: float,
        history: dict[str, list[float]],
    ) -> None:
        self._objective, self._goal, self._options, self._deadline, self._history = (
            objective,
            goal,
            options,
            deadline,
            history,
        )
        self._shape = (objective.kernel.scene.task.steps, objective.kernel.scene.nu)
        # Point, loss, gradient, error, cost.
        self._last: tuple[np.ndarray, float, np.ndarray, float, float] | None = None
        self._scale = 1.0
        self.losses: list[float] = []
        self.ending = ""
        self._norm = 0.0  # of the last projected gradient

    def start(self, u: np.ndarray) -> float:
        """Return the loss at u (steps, nu) [N, N m], and use it as scale.

        Raises ShootingError for a custom loss that cannot be differentiated.
        """
        value = self._objective.value(u)
        self._scale = value if np.isfinite(value) and value > 0.0 else 1.0
        if np.isfinite(value):
            self._norm = float(
                np.linalg.norm(projected(self._objective, u, self._objective.gradient()))
            )
        return value

    def minimised(self, u: np.ndarray) -> np.ndarray:
        """Return the inputs (steps, nu) [N, N m] at the end of L-BFGS from u.

        `ending` names the reason. Raises as `function`.
        """
        lower, upper = (
            np.broadcast_to(bound, u.shape).ravel()
            for bound in input_bounds(self._objective.kernel.scene)
        )
        options = self._options
        result = minimize(
            self.function,
            u.ravel(),
            jac=True,
            method="L-BFGS-B",
            bounds=Bounds(lower, upper),
            callback=self.monitor,
            options={
                "maxcor": options.memory,
                "maxiter": options.max_iterations,
                "maxfun": 10**9,
                "ftol": 0.0,
                "gtol": 0.0,
                "maxls": 40,
            },
        )
        # "flat": the projected gradient vanished; "search": no step lowers the loss.
        if not self.ending:
            norms = self._history["gradient_norm"]
            self.ending = "flat" if self._norm <= _FLAT * (norms[0] if norms else 0.0) else "search"
        return np.clip(result.x.reshape(u.shape), lower.reshape(u.shape), upper.reshape(u.shape))

    def function(self, point: np.ndarray) -> tuple[float, np.ndarray]:
        """Return scaled loss and gradient (steps*nu,) [1/N, 1/N/m] at (steps*nu,) [N, N m].

        Raises ShootingError for a custom loss that cannot be differentiated.
        """
        value = self._objective.value(point.reshape(self._shape))
        if not np.isfinite(value):  # the line search then shortens the step
            return 1e300, np.zeros(point.size)
        gradient = self._objective.gradient().ravel()
        missed = float(np.linalg.norm(self._objective.missed(self._goal)))
        self._last = (point.copy(), value, gradient.copy(), missed, self._objective.cost)
        return value / self._scale, gradient / self._scale

    def monitor(self, point: np.ndarray) -> None:
        """Record an iterate (steps*nu,) [N, N m]; raises StopIteration to end the run."""
        objective, options = self._objective, self._options
        if self._last is None or not np.array_equal(self._last[0], point):
            self.function(point)
        if self._last is None:
            return
        _, value, slope, missed, cost = self._last
        gradient = projected(objective, point.reshape(self._shape), slope.reshape(self._shape))
        self._norm = float(np.linalg.norm(gradient))
        row = (value, missed, cost, self._norm)
        for column, entry in zip(self._history.values(), row, strict=True):
            column.append(entry)
        self.losses.append(value)
        if len(self._history["loss"]) >= options.max_iterations:
            self.ending = "limit"
        elif perf_counter() >= self._deadline:
            self.ending = "time"
        elif len(self.losses) > _JUDGED_OVER and (
            earlier := self.losses[-1 - _JUDGED_OVER]
        ) - value <= options.tolerance * abs(earlier):
            self.ending = "settled"
        if self.ending:
            raise StopIteration


def projected(objective: Objective, u: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Project a gradient (steps, nu) [1/N, 1/N/m] at u (steps, nu) [N, N m] on the bounds.

    Raises ValueError for an array of another shape.
    """
    lower, upper = input_bounds(objective.kernel.scene)
    beyond = ((u <= lower) & (gradient > 0.0)) | ((u >= upper) & (gradient < 0.0))
    return np.where(beyond, 0.0, gradient)


def minimise(
    objective: Objective, u0: np.ndarray, options: QuasiNewtonOptions, time_limit: float
) -> Descent:
    """Minimise from u0 (steps, nu) [N, N m] within the bounds; time_limit in wall seconds.

    The gradient_norm of the result ignores entries that point beyond a bound. Raises ShootingError
    for a custom loss that cannot be differentiated.
    """
    deadline = perf_counter() + time_limit
    goal, weights = objective.goal, objective.weights
    history: dict[str, list[float]] = {
        "loss": [],
        "terminal_error": [],
        "cost": [],
        "gradient_norm": [],
    }
    u = np.clip(u0, *input_bounds(objective.kernel.scene))
    try:
        run, u, missed, rounds = _rounds(objective, u, options, deadline, history)
    finally:
        objective.aim(goal, weights)
    if run is None:
        steps = objective.finite_steps
        message = f"at the first guess the rollout is no longer finite beyond step {steps} (t = {steps * objective.kernel.scene.task.step:.3g} s)."
        return Descent(
            outcome=Outcome.EVALUATION_ERROR,
            message=message,
            u=None,
            iterations=0,
            gradient_norm=0.0,
            history=history,
        )
    iterations = len(history["loss"])
    objective.value(u)
    gradient = float(np.linalg.norm(projected(objective, u, objective.gradient())))
    endings = {
        "limit": (Outcome.ITERATION_LIMIT, f"stopped at max_iterations = {options.max_iterations}"),
        "time": (
            Outcome.TIME_LIMIT,
            f"stopped after {iterations} iterations at the time limit of {time_limit:g} s",
        ),
        "settled": (
            Outcome.SOLVED,
            f"the loss fell by less than {100.0 * options.tolerance:.2g} % over the last {_JUDGED_OVER} iterations",
        ),
        "flat": (Outcome.SOLVED, f"the gradient has fallen to less than {_FLAT:g} of what it was"),
        "search": (
            Outcome.STALLED,
            "no step along the search direction lowers the loss: a kink of the contact forces, or rounding",
        ),
    }
    outcome, message = endings[run.ending]
    if rounds:
        message += f"; the goal was displaced {rounds} times"
    dead = ""
    if missed > options.goal_tolerance:
        rate = min(stable_rate(objective, u), 1e12)
        objective.value(u)
        dead = dead_contact_message(objective, u, rate)
    if dead:
        outcome, message = (
            (Outcome.STALLED if outcome is Outcome.SOLVED else outcome),
            f"{message}; {dead}",
        )
    return Descent(
        outcome=outcome,
        message=ended(message),
        u=u,
        iterations=iterations,
        gradient_norm=gradient,
        history=history,
    )


def _rounds(
    objective: Objective,
    u: np.ndarray,
    options: QuasiNewtonOptions,
    deadline: float,
    history: dict[str, list[float]],
) -> tuple[_Run | None, np.ndarray, float, int]:
    """Minimise repeatedly with a shifted goal.

    Return last run, best inputs, error, number of shifts.
    """
    goal, best, least, displaced, weight, slow = (
        objective.goal,
        u,
        np.inf,
        0,
        objective.weights.terminal,
        0,
    )
    shift, most = np.zeros(len(goal)), options.goal_rounds if objective.aims else 0
    while True:
        objective.aim(goal - shift, replace(objective.weights, terminal=weight))
        run = _Run(objective, goal, options, deadline, history)
        if not np.isfinite(run.start(u)):
            return None, u, np.inf, 0
        u = run.minimised(u)
        objective.value(u)
        error = objective.missed(goal)
        missed = float(np.linalg.norm(error))
        slow = slow + 1 if missed > _STALLS * least else 0
        shift += error
        if missed > _SHRINKS * least:  # a larger weight, with the same multipliers
            weight, shift = weight * _HEAVIER, shift / _HEAVIER
        if missed < least:
            best, least = u, missed
        if (
            run.ending in ("limit", "time")
            or missed <= options.goal_tolerance
            or displaced >= most
            or slow > 2
        ):
            return run, best, least, displaced
        displaced += 1
