"""Gradient descent: `torch.optim.SGD` on a loss of the inputs, projected on their bounds.

    found = descend(Objective(load_kernel(scene), law=ContactLaw.RELU), u0, DescentOptions(learning_rate=500.0, iterations=15), time_limit=60.0)

The step is `u <- clip(u - learning_rate * gradient, lower, upper)`. The paper's descent ignores the bounds and its plans stay inside them: there the
projection changes nothing, not even a bit. `projected_descent` is the loop alone, for many plans at once, on any device:

    u = torch.randn(64, 500, 2, device="cuda", requires_grad=True)
    for _, loss in zip(range(100), projected_descent(lambda u: loss_of(rollout(kernel, u), u), u, 500.0, lower, upper)): ...

When to stop is judged by the losses alone, whatever their scale and whatever the learning rate, over the last quarter of the iterations (at least 50).
That span grows with the iterations because a learning rate ten times smaller needs ten times the iterations for the same way: one of fixed length would
call a slow descent finished.

    settled      the best loss fell by less than `tolerance` (relative) over the span, or is down to rounding
    runaway      the loss stayed above twice its best over half the span: it climbs instead of descending
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from time import perf_counter

import numpy as np
import torch
from torch import Tensor

from formulations.grids import input_bounds
from formulations.shooting.diagnosis import dead_contact_message, divergence_message, sensitivity
from formulations.shooting.objective import Objective
from formulations.shooting.options import DescentOptions
from formulations.shooting.rollout import ShootingError
from formulations.solution import Outcome

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
        if loss > _RUNAWAY * self.best and min(self.values[-(self.span // 2) :]) > _RUNAWAY * self.best:
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

    u (steps, nu): its plan, None if there is none: the last one if a number of iterations was asked for, else the best one.
    gradient_norm: of the loss at u. history: columns of equal length, one row before each step and one at the end.
    """

    outcome: Outcome
    message: str
    u: np.ndarray | None
    iterations: int
    gradient_norm: float
    history: dict[str, list[float]]


def projected_descent(loss_of: Callable[[Tensor], Tensor], u: Tensor, rate: float, lower: Tensor, upper: Tensor) -> Iterator[Tensor]:
    """Yield the loss, and again after each step, without end; u.grad is its gradient there.

    Parameters
    ----------
    loss_of : u (.., steps, nu) [N, N m] -> (..) [-]
    u : (.., steps, nu) [N, N m]; requires a gradient, and moves in place when the next loss is asked for; each of its leading rows descends by itself
    lower, upper : (nu,) [N, N m]

    Yields
    ------
    (..) [-]
    """
    optimiser = torch.optim.SGD([u], lr=rate)
    while True:
        optimiser.zero_grad()
        loss = loss_of(u)
        (loss if loss.dim() == 0 else loss.sum()).backward()
        yield loss.detach()
        optimiser.step()
        u.data.clamp_(lower, upper)


def descend(objective: Objective, u0: np.ndarray, options: DescentOptions, time_limit: float) -> Descent:
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
    history: dict[str, list[float]] = {"loss": losses.values, "terminal_error": [], "cost": [], "gradient_norm": []}

    def ended(outcome: Outcome, message: str, plan: np.ndarray | None, norm: float) -> Descent:
        """Say how it ended, with plan (steps, nu) [N, N m]."""
        return Descent(outcome=outcome, message=message, u=plan, iterations=iteration, gradient_norm=norm, history=history)

    progress, iteration = Progress.DESCENDING, 0
    for iteration, loss in enumerate(projected_descent(objective, u, rate, *(torch.from_numpy(bound) for bound in (lower, upper)))):
        value, gradient = loss.item(), u.grad
        if gradient is None:
            raise ShootingError(f"scene {scene.name}: the loss has no gradient with respect to the inputs.")
        norm = _norm(gradient.numpy())
        if not (np.isfinite(value) and np.isfinite(norm)):
            message = divergence_message(objective, rate, iteration, best.numpy() if iteration else None)
            return ended(Outcome.DIVERGED if iteration else Outcome.EVALUATION_ERROR, message, None, 0.0)
        progress = losses.add(value, options.tolerance)
        history["terminal_error"].append(objective.terminal_error)
        history["cost"].append(objective.cost)
        history["gradient_norm"].append(norm)
        if losses.best == value:
            best.copy_(u.detach())
        if (by_rule and progress is not Progress.DESCENDING) or iteration == limit or perf_counter() - began >= time_limit:
            break
    objective.seconds += perf_counter() - began

    if by_rule and progress is Progress.RUNAWAY:
        return ended(Outcome.DIVERGED, divergence_message(objective, rate, iteration, best.numpy()), None, history["gradient_norm"][-1])
    if by_rule and progress is Progress.SETTLED:
        outcome, message = Outcome.SOLVED, ""
    elif iteration == limit:
        outcome, message = Outcome.ITERATION_LIMIT, _limit_message(options, losses)
    else:
        outcome, message = Outcome.TIME_LIMIT, f"stopped after {iteration} iterations at the time limit of {time_limit:g} s"

    plan = (best if by_rule else u.detach()).numpy().copy()
    objective.value(plan)
    slope = objective.gradient()
    if outcome is Outcome.SOLVED:
        step = np.clip(plan - rate * slope, lower, upper) - plan
        outcome, message = _settled(losses, options.tolerance, -float((slope * step).sum()))
    dead = dead_contact_message(objective, sensitivity(objective, plan), rate)
    if dead:
        outcome = Outcome.STALLED if outcome is Outcome.SOLVED else outcome
        message = f"{message}; {dead}"
    at_bound = int(((plan <= lower) | (plan >= upper)).sum())
    if at_bound:
        message = f"{message}; {at_bound} of {plan.size} inputs are held at their bound"
    return ended(outcome, _sentence(message), plan, _norm(slope))


def _norm(array: np.ndarray) -> float:
    flat = array.ravel()
    with np.errstate(over="ignore"):  # an overflow is an answer: the descent diverged
        return float(np.sqrt(flat @ flat))


def _limit_message(options: DescentOptions, losses: Losses) -> str:
    if options.iterations is not None:
        rose = "; the loss is higher than at the start" if losses.values[-1] > losses.values[0] else ""
        return f"stopped after the {options.iterations} iterations asked for{rose}"
    return (
        f"stopped at max_iterations = {options.max_iterations}; over the last quarter of them the loss still fell by "
        f"{100.0 * losses.decrease():.2g} % (tolerance {100.0 * options.tolerance:.2g} %)"
    )


def _settled(losses: Losses, tolerance: float, promise: float) -> tuple[Outcome, str]:
    """SOLVED if the gradient agrees that there is nothing left to gain, else STALLED.

    promise: the decrease that one more step would bring if the loss were linear. Where the loss has settled although every step
    promises more than the tolerance, the steps are too long for its curvature or its kinks, and it is no minimum.
    """
    if losses.exhausted:
        return Outcome.SOLVED, f"the loss is down to {losses.best:.2g}, from {losses.values[0]:.2g}"
    facts = f"the loss fell by {100.0 * losses.decrease():.2g} % over the last {losses.span} iterations"
    share = promise / losses.best
    if share <= tolerance:
        return Outcome.SOLVED, f"{facts}, and one more step promises {100.0 * share:.2g} %"
    return Outcome.STALLED, f"{facts}, although each step promises {100.0 * share:.2g} %: it jumps to and fro; use a smaller learning rate"


def _sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."
