"""Gradient descent: on a loss of the inputs, by the gradients of PyTorch, projected on their bounds.

    found = descend(Objective(load_kernel(scene), law=ContactLaw.RELU), u0, DescentOptions(learning_rate=500.0, iterations=15), time_limit=60.0)

The step is `u <- clip(u - learning_rate * gradient, lower, upper)`. The paper's descent ignores the
bounds and its plans stay inside them: there the projection changes nothing, not even a bit.
`projected_descent` is the loop alone, for many plans at once, on any device:

    u = torch.randn(64, 500, 2, device="cuda", requires_grad=True)
    for _, loss in zip(range(100), projected_descent(lambda u: loss_of(rollout(kernel, u), u), u, 500.0, lower, upper)): ...

When to stop is judged by the losses alone, whatever their scale and whatever the learning rate,
over the last quarter of the iterations (at least 50). That span grows with the iterations because a
learning rate ten times smaller needs ten times the iterations for the same way: one of fixed length
would call a slow descent finished.

    settled      the best loss fell by less than `tolerance` (relative) over the span, or is down to
                 rounding
    runaway      the loss stayed above twice its best over half the span: it climbs instead of
                 descending

Why a descent ends where it ends, in numbers and then in words.

The rows of S = d x_T / d u, one adjoint each, tell what the inputs can still do: a coordinate whose
row is zero stays where it is, whatever its error. With a dead ReLU that is every body that only
contact moves.
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

# A coordinate counts as missed beyond this share of its nominal size, and as out of reach if one
# iteration closes less than this share of its error through its own row of S (a million iterations
# would not get there).
_MISSED = 1e-4
_OUT_OF_REACH = 1e-6

# Enough for one digit of the largest curvature; the difference is small against the inputs and
# large against rounding.
_POWER_ITERATIONS = 20
_DIFFERENCE = 1e-5


def sensitivity(objective: Objective, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate the last state at inputs u (steps, nu) [N, N m], by one adjoint sweep for each of its components.

    Returns its derivatives by the inputs (2*nq, steps*nu) and by the start (2*nq, 2*nq); the 2-norm
    of these is the largest factor by which a disturbance of the start grows over the horizon.

    Raises KernelError where the mass matrix is not positive definite along the rollout.
    """
    kernel, task = objective.kernel, objective.kernel.scene.task
    plan = kernel.rollout(np.array(task.start), u, task.step, objective.law, objective.eps)
    rows = [kernel.adjoint(plan, u, end_bar=component) for component in np.eye(2 * kernel.scene.nq)]
    return np.array([u_bar.ravel() for u_bar, _ in rows]), np.array(
        [start_bar for _, start_bar in rows]
    )


def out_of_reach(objective: Objective, to_inputs: np.ndarray, learning_rate: float) -> list[str]:
    """Name the coordinates that miss the goal and that no gradient moves, each with its error. to_inputs: as of `sensitivity`."""
    scene, missed = objective.kernel.scene, np.abs(objective.error)
    found = []
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
            found.append(
                f"{coordinate.name} (it misses its goal by {missed[index]:.3g} {coordinate.unit}; |d {coordinate.name}/d u| = {slope:.2g})"
            )
    return found


def dead_contact_message(objective: Objective, u: np.ndarray, learning_rate: float) -> str:
    """Say which coordinate misses the goal although nothing moves it at inputs u (steps, nu) [N, N m], those evaluated last; "" where there is none. Raises KernelError where the mass matrix is not positive definite along the rollout."""
    found = out_of_reach(objective, sensitivity(objective, u)[0], learning_rate)
    if not found:
        return ""
    names = " and ".join(found)
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
    """Give the largest learning rate at which a gradient step near u (steps, nu) [N, N m] does not overshoot: 2 / largest curvature of the loss.

    The curvature comes from a power iteration on differences of gradients, so that all of the loss
    counts: the way to the goal, contacts, and the running cost.

    Raises KernelError where the mass matrix is not positive definite along the rollout.
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
    """Say what went wrong at this iteration, with growth and rate at the best inputs seen (steps, nu) [N, N m], if there are any. Raises KernelError where the mass matrix is not positive definite along the rollout."""
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
    """One digit, so that the text promises no more than an estimate can."""
    scale = 10.0 ** math.floor(math.log10(value))
    return f"{math.floor(value / scale) * scale:g}"


_SHORTEST_SPAN = 50
_SPAN_SHARE = 4
# A loss this far below the first one has lost all digits that the goal was given in.
_NOTHING_LEFT = 1e-20
_RUNAWAY = 2.0


class Progress(Enum):
    """How the losses go."""

    DESCENDING = "descending"
    SETTLED = "settled"
    RUNAWAY = "runaway"


class Losses:
    """The loss before each iteration and at the end (`values`), and what they say of the descent."""

    def __init__(self) -> None:
        self.values: list[float] = []
        self._best: list[float] = []  # the least of the first so many

    def add(self, loss: float, tolerance: float) -> Progress:
        """Take the next loss and say how the descent goes."""
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
        """Over how many iterations the decrease is judged."""
        return max(_SHORTEST_SPAN, len(self.values) // _SPAN_SHARE)

    @property
    def best(self) -> float:
        """The least loss so far."""
        return self._best[-1]

    @property
    def exhausted(self) -> bool:
        """Whether the best loss is down to rounding."""
        return self.best <= _NOTHING_LEFT * self.values[0]

    def decrease(self) -> float:
        """Give the relative decrease of the best loss over the span."""
        earlier = self._best[max(0, len(self._best) - 1 - self.span)]
        return (earlier - self.best) / earlier if earlier > 0.0 else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Descent:
    """How a descent ended.

    u (steps, nu): its plan, None if there is none: the last one if a number of iterations was asked
        for, else the best one.
    gradient_norm: of the loss at u. history: columns of equal length, one row before each step and
        one at the end.
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
    """Yield the loss, and again after each step, without end; u.grad is its gradient there.

    Parameters
    ----------
    loss_of : u (.., steps, nu) [N, N m] -> (..) [-]
    u : (.., steps, nu) [N, N m]; requires a gradient, and moves in place when the next loss is
        asked for; each of its leading rows descends by itself
    lower, upper : (nu,) [N, N m]

    Yields
    ------
    (..) [-]
    """
    # The step is written out, as torch.optim.SGD takes it: the first optimiser of a process imports
    # torch's compiler, 1.1 CPU s, and an interrupt in that import leaves PyTorch without any
    # optimiser until the process ends.
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
    """Descend until nothing is gained, or a limit is reached.

    Parameters
    ----------
    u0 : (steps, nu) [N, N m], first guess
    time_limit : wall seconds [s]

    Raises
    ------
    ShootingError
        For a loss of one's own that has no gradient with respect to the inputs.
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

    def told(outcome: Outcome, message: str, plan: np.ndarray | None, norm: float) -> Descent:
        """Say how it ended, with plan (steps, nu) [N, N m]."""
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
            return told(
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
        return told(
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
    return told(outcome, ended(message), plan, _norm(slope))


def _norm(array: np.ndarray) -> float:
    flat = array.ravel()
    with np.errstate(over="ignore"):  # an overflow is an answer: the descent diverged
        return float(np.sqrt(flat @ flat))


def _limit_message(options: DescentOptions, losses: Losses) -> str:
    if options.iterations is not None:
        rose = (
            "; the loss is higher than at the start" if losses.values[-1] > losses.values[0] else ""
        )
        return f"stopped after the {options.iterations} iterations asked for{rose}"
    return (
        f"stopped at max_iterations = {options.max_iterations}; over the last quarter of them the loss still fell by "
        f"{100.0 * losses.decrease():.2g} % (tolerance {100.0 * options.tolerance:.2g} %)"
    )


def _settled(losses: Losses, tolerance: float, promise: float) -> tuple[Outcome, str]:
    """SOLVED if the gradient agrees that there is nothing left to gain, else STALLED.

    promise: the decrease that one more step would bring if the loss were linear. Where the loss has
        settled although every step
    promises more than the tolerance, the steps are too long for its curvature or its kinks, and it
        is no minimum.
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
