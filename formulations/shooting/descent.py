"""Gradient descent on a loss of the inputs, projected on their bounds, and diagnoses of its end.

    result = descend(objective, u0, DescentOptions(learning_rate=500.0, iterations=15),
    time_limit=60.0)

A step is `u <- clip(u - learning_rate * gradient, lower, upper)`; the paper's plans stay inside the
bounds. The stopping rule uses the losses of the last quarter of the iterations (at least 50), so
that a slow learning rate is not mistaken for convergence:

    settled   the best loss fell by less than `tolerance` (relative), or is down to rounding
    runaway   the loss stayed above twice its best over half the span
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from time import perf_counter

import numpy as np
import torch
from torch import Tensor

from formulations.grids import input_bounds
from formulations.shooting.objective import Objective
from formulations.shooting.options import DescentOptions
from formulations.shooting.rollout import ShootingError
from formulations.solution import Outcome, ended
from models.contact_law import ContactLaw
from models.scene import Scene

# A coordinate misses its goal beyond this share of its nominal size.
_MISSED = 1e-4
# It is out of reach if one iteration closes less than this share of its error through its own row
# of S = d x_T / d u.
_OUT_OF_REACH = 1e-6

# Enough for one digit of the largest curvature.
_POWER_ITERATIONS = 20
# Small against the inputs, large against rounding.
_DIFFERENCE = 1e-5


def sensitivity(objective: Objective, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of the last state by the inputs and by the start.

    One adjoint sweep per component gives (2*nq, steps*nu) and (2*nq, 2*nq) [-] at inputs u (steps,
    nu) [N, N m]. The 2-norm of the second is the largest growth of a disturbance of the start.
    Raises KernelError if the mass matrix is not positive definite along the rollout.
    """
    kernel, task = objective.kernel, objective.kernel.scene.task
    plan = kernel.rollout(np.array(task.start), u, task.step, objective.law, objective.eps)
    rows = [kernel.adjoint(plan, u, end_bar=component) for component in np.eye(2 * kernel.scene.nq)]
    return np.array([u_bar.ravel() for u_bar, _ in rows]), np.array(
        [start_bar for _, start_bar in rows]
    )


def out_of_reach(objective: Objective, to_inputs: np.ndarray, learning_rate: float) -> list[str]:
    """Name the coordinates that miss the goal and that no gradient moves, each with its error.

    Their rows of S are zero, as for bodies moved only by contact with a dead ReLU. to_inputs is S
    (`sensitivity`).
    """
    scene, missed = objective.kernel.scene, np.abs(objective.error)
    names = []
    for index, coordinate in enumerate(scene.coordinates):
        closes = (
            learning_rate
            * objective.weights.terminal
            / len(missed)
            * 2.0
            * float(to_inputs[index] @ to_inputs[index])
        )
        if missed[index] > _MISSED * coordinate.nominal and closes < _OUT_OF_REACH:
            slope = float(np.linalg.norm(to_inputs[index]))
            names.append(
                f"{coordinate.name} (it misses its goal by {missed[index]:.3g} {coordinate.unit}; |d {coordinate.name}/d u| = {slope:.2g})"
            )
    return names


def dead_contact_message(objective: Objective, u: np.ndarray, learning_rate: float) -> str:
    """Return a sentence on coordinates that miss the goal but are not moved at inputs u, or "".

    u (steps, nu) [N, N m] are the last evaluated inputs. Raises KernelError if the mass matrix is
    not positive definite along the rollout.
    """
    coordinates = out_of_reach(objective, sensitivity(objective, u)[0], learning_rate)
    if not coordinates:
        return ""
    names = " and ".join(coordinates)
    assert objective.plan is not None
    scene, relu, step = (
        objective.kernel.scene,
        objective.law is ContactLaw.RELU,
        objective.kernel.scene.task.step,
    )
    consequence = f"so the loss has no gradient towards moving {names}"
    if not scene.nc:
        return f"no input reaches it, {consequence}."
    phi = objective.kernel.penetration(objective.plan.q.detach().numpy()[:-1])
    if relu:
        never = [index for index in range(scene.nc) if phi[:, index].max() <= 0.0]
        if len(never) == scene.nc:
            what = (
                f"no contact is made anywhere on the trajectory ({_gaps(scene, phi, never, step)})"
            )
        elif never:
            what = f"contact {' and '.join(scene.contacts[index].name for index in never)} is never made ({_gaps(scene, phi, never, step)})"
        else:
            what = "every contact is made, but none carries an input's effect to the end"
        return f"{what}, {consequence}; start from a softplus stage."
    force = objective.plan.lam.max().item()
    everywhere = list(range(scene.nc))
    return f"the relaxed contact is too faint (largest force {force:.2g} N; {_gaps(scene, phi, everywhere, step)}), {consequence}; start from a larger eps."


def _gaps(scene: Scene, phi: np.ndarray, contacts: list[int], step: float) -> str:
    closest = [
        (scene.contacts[index].name, int(phi[:, index].argmax()), -float(phi[:, index].max()))
        for index in contacts
    ]
    return "smallest gap " + ", ".join(
        f"{name} {gap:.3g} m at t = {node * step:.3g} s" for name, node, gap in closest
    )


def stable_rate(objective: Objective, u: np.ndarray) -> float:
    """Return the largest rate without overshoot near u (steps, nu) [N, N m]: 2 / curvature.

    The curvature of the whole loss comes from a power iteration on differences of gradients. Raises
    KernelError if the mass matrix is not positive definite along the rollout.
    """
    objective.value(u)
    direction = objective.gradient().copy()
    curvature = 0.0
    for _ in range(_POWER_ITERATIONS):
        norm = float(np.linalg.norm(direction))
        if not (np.isfinite(norm) and norm > 0.0):
            break
        direction *= _DIFFERENCE * max(1.0, float(np.linalg.norm(u))) / norm
        length = float(np.linalg.norm(direction))
        gradients = []
        for sign in (1.0, -1.0):
            if not np.isfinite(objective.value(u + sign * direction)):
                return np.nan
            gradients.append(objective.gradient().copy())
        direction = gradients[0] - gradients[1]
        curvature = float(np.linalg.norm(direction)) / (2.0 * length)
    return 2.0 / curvature if curvature > 0.0 else np.inf


def divergence_message(
    objective: Objective, learning_rate: float, iteration: int, best: np.ndarray | None
) -> str:
    """Explain a divergence, with growth and rate at the best inputs (steps, nu) [N, N m].

    Raises KernelError if the mass matrix is not positive definite along the rollout.
    """
    where = (
        f"after {iteration} {'iteration' if iteration == 1 else 'iterations'} at learning rate {learning_rate:g}"
        if iteration
        else "at the first guess"
    )
    if objective.finite:
        what = f"{where} the loss climbs instead of descending"
    else:
        steps = objective.finite_steps
        what = f"{where} the rollout is no longer finite beyond step {steps} (t = {steps * objective.kernel.scene.task.step:.3g} s)"
    if best is None:
        return f"{what}; start, parameters and inputs must allow a simulation to the end of the horizon."
    rate, growth = (
        stable_rate(objective, best),
        float(np.linalg.norm(sensitivity(objective, best)[1], 2)),
    )
    advice = (
        f"; a learning rate below {_rounded_down(rate)} would not overshoot there"
        if np.isfinite(rate)
        else ""
    )
    return f"{what}; at the best plan a disturbance of the start grows by a factor of {growth:.3g} over the horizon{advice}."


def _rounded_down(value: float) -> str:
    scale = 10.0 ** math.floor(math.log10(value))
    return f"{math.floor(value / scale) * scale:g}"


# Fewest iterations of the stopping rule's span.
_SHORTEST_SPAN = 50
# The span is this fraction of the iterations.
_SPAN_SHARE = 4
# Relative to the first loss: below it all digits of the goal are used up.
_NOTHING_LEFT = 1e-20
# Loss relative to the best one that counts as runaway.
_RUNAWAY = 2.0


class Progress(Enum):
    """Trend of the losses."""

    DESCENDING = "descending"
    SETTLED = "settled"
    RUNAWAY = "runaway"


class Losses:
    """The loss before each iteration and at the end (`values`), and its trend."""

    def __init__(self) -> None:
        self.values: list[float] = []
        self._best: list[float] = []  # running minimum

    def add(self, loss: float, tolerance: float) -> Progress:
        """Append a loss and return the trend."""
        self.values.append(loss)
        self._best.append(min(loss, self._best[-1]) if self._best else loss)
        if self.exhausted:
            return Progress.SETTLED
        if len(self.values) <= self.span:
            return Progress.DESCENDING
        if (
            loss > _RUNAWAY * self.best
            and min(self.values[-(self.span // 2) :]) > _RUNAWAY * self.best
        ):
            return Progress.RUNAWAY
        return Progress.SETTLED if self.decrease() <= tolerance else Progress.DESCENDING

    @property
    def span(self) -> int:
        """Return the number of iterations of the stopping rule."""
        return max(_SHORTEST_SPAN, len(self.values) // _SPAN_SHARE)

    @property
    def best(self) -> float:
        """Return the smallest loss."""
        return self._best[-1]

    @property
    def exhausted(self) -> bool:
        """Return whether the best loss is down to rounding."""
        return self.best <= _NOTHING_LEFT * self.values[0]

    def decrease(self) -> float:
        """Return the relative decrease of the best loss over the span."""
        earlier = self._best[max(0, len(self._best) - 1 - self.span)]
        return (earlier - self.best) / earlier if earlier > 0.0 else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Descent:
    """The result of a descent.

    - u: (steps, nu), the last plan for a given number of iterations, else the best one; may be None
    - gradient_norm: of the loss at u
    - history: columns of equal length, one row before each step and one at the end
    """

    outcome: Outcome
    message: str
    u: np.ndarray | None
    iterations: int
    gradient_norm: float
    history: dict[str, list[float]]


def projected_descent(
    loss_of: Callable[[Tensor], Tensor], u: Tensor, rate: float, lower: Tensor, upper: Tensor
) -> Iterator[Tensor]:
    """Yield the loss (..) [-] before each step, without end; u.grad is its gradient.

    u (.., steps, nu) [N, N m] requires a gradient and changes in place; leading rows are
    independent. lower, upper are (nu,) [N, N m].
    """
    # The first torch.optim optimiser of a process imports torch's compiler (1.1 CPU s), and an
    # interrupt of that import breaks all optimisers; hence no torch.optim.SGD.
    while True:
        u.grad = None
        loss = loss_of(u)
        (loss if loss.dim() == 0 else loss.sum()).backward()
        yield loss.detach()
        if u.grad is not None:
            u.data.add_(u.grad, alpha=-rate).clamp_(lower, upper)


def descend(
    objective: Objective, u0: np.ndarray, options: DescentOptions, time_limit: float
) -> Descent:
    """Descend from u0 (steps, nu) [N, N m] until nothing is gained, or a limit is reached.

    time_limit is in wall seconds [s]. Raises ShootingError for a custom loss without a gradient
    with respect to the inputs.
    """
    began = perf_counter()
    scene = objective.kernel.scene
    lower, upper = input_bounds(scene)
    rate, by_rule = options.learning_rate, options.iterations is None
    limit = options.max_iterations if options.iterations is None else options.iterations
    u = torch.tensor(np.clip(u0, lower, upper), dtype=torch.float64, requires_grad=True)
    losses, best = Losses(), u.detach().clone()
    history: dict[str, list[float]] = {
        "loss": losses.values,
        "terminal_error": [],
        "cost": [],
        "gradient_norm": [],
    }

    def result(outcome: Outcome, message: str, plan: np.ndarray | None, norm: float) -> Descent:
        """Return the result with plan (steps, nu) [N, N m]. Raises nothing."""
        return Descent(
            outcome=outcome,
            message=message,
            u=plan,
            iterations=iteration,
            gradient_norm=norm,
            history=history,
        )

    progress, iteration = Progress.DESCENDING, 0
    for iteration, loss in enumerate(
        projected_descent(
            objective, u, rate, *(torch.from_numpy(bound) for bound in (lower, upper))
        )
    ):
        value, gradient = loss.item(), u.grad
        if gradient is None:
            raise ShootingError(
                f"scene {scene.name}: the loss has no gradient with respect to the inputs."
            )
        norm = _norm(gradient.numpy())
        if not (np.isfinite(value) and np.isfinite(norm)):
            message = divergence_message(
                objective, rate, iteration, best.numpy() if iteration else None
            )
            return result(
                Outcome.DIVERGED if iteration else Outcome.EVALUATION_ERROR, message, None, 0.0
            )
        progress = losses.add(value, options.tolerance)
        history["terminal_error"].append(objective.terminal_error)
        history["cost"].append(objective.cost)
        history["gradient_norm"].append(norm)
        if losses.best == value:
            best.copy_(u.detach())
        if (
            (by_rule and progress is not Progress.DESCENDING)
            or iteration == limit
            or perf_counter() - began >= time_limit
        ):
            break
    objective.seconds += perf_counter() - began

    if by_rule and progress is Progress.RUNAWAY:
        return result(
            Outcome.DIVERGED,
            divergence_message(objective, rate, iteration, best.numpy()),
            None,
            history["gradient_norm"][-1],
        )
    if by_rule and progress is Progress.SETTLED:
        outcome, message = Outcome.SOLVED, ""
    elif iteration == limit:
        outcome, message = Outcome.ITERATION_LIMIT, _limit_message(options, losses)
    else:
        outcome, message = (
            Outcome.TIME_LIMIT,
            f"stopped after {iteration} iterations at the time limit of {time_limit:g} s",
        )

    plan = (best if by_rule else u.detach()).numpy().copy()
    objective.value(plan)
    slope = objective.gradient()
    if outcome is Outcome.SOLVED:
        step = np.clip(plan - rate * slope, lower, upper) - plan
        outcome, message = _settled(losses, options.tolerance, -float((slope * step).sum()))
    dead = dead_contact_message(objective, plan, rate)
    if dead:
        outcome = Outcome.STALLED if outcome is Outcome.SOLVED else outcome
        message = f"{message}; {dead}"
    at_bound = int(((plan <= lower) | (plan >= upper)).sum())
    if at_bound:
        message = f"{message}; {at_bound} of {plan.size} inputs are held at their bound"
    return result(outcome, ended(message), plan, _norm(slope))


def _norm(array: np.ndarray) -> float:
    flat = array.ravel()
    with np.errstate(over="ignore"):  # an overflow means divergence
        return float(np.sqrt(flat @ flat))


def _limit_message(options: DescentOptions, losses: Losses) -> str:
    if options.iterations is not None:
        rose = (
            "; the loss is higher than at the start" if losses.values[-1] > losses.values[0] else ""
        )
        return f"stopped after the {options.iterations} requested iterations{rose}"
    return (
        f"stopped at max_iterations = {options.max_iterations}; over the last quarter of them the loss still fell by "
        f"{100.0 * losses.decrease():.2g} % (tolerance {100.0 * options.tolerance:.2g} %)"
    )


def _settled(losses: Losses, tolerance: float, promise: float) -> tuple[Outcome, str]:
    """Return SOLVED if the gradient promises no gain either, else STALLED.

    promise: decrease of one more step for a linear loss. If it exceeds the tolerance although the
        loss
    settled, the steps are too long for its curvature or kinks.
    """
    if losses.exhausted:
        return Outcome.SOLVED, f"the loss is down to {losses.best:.2g}, from {losses.values[0]:.2g}"
    facts = (
        f"the loss fell by {100.0 * losses.decrease():.2g} % over the last {losses.span} iterations"
    )
    share = promise / losses.best
    if share <= tolerance:
        return Outcome.SOLVED, f"{facts}, and one more step promises {100.0 * share:.2g} %"
    return (
        Outcome.STALLED,
        f"{facts}, although each step promises {100.0 * share:.2g} %: it jumps to and fro; use a smaller learning rate",
    )
