"""Gradient descent on an Objective by PyTorch, projected on the bounds of the inputs.

    result = descend(objective, u0, Settings(learning_rate=500.0, iterations=15), time_limit=60.0)

The step is `u <- clip(u - learning_rate * gradient, lower, upper)`. The paper's descent ignores the bounds and its plans stay
inside them: there the projection changes nothing, not even a bit. The step itself is that of `torch.optim.SGD`, bit for bit
(tested); its optimizer object is not used, because its first step loads PyTorch's compiler, a second of CPU time.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np
import torch

from formulations.shooting.diagnosis import dead_contact_message, divergence_message, sensitivity
from formulations.shooting.objective import Objective
from formulations.shooting.stopping import Progress, StoppingRule
from formulations.solution import Outcome


@dataclass(frozen=True, kw_only=True)
class Settings:
    """iterations: exactly that many, or None for the stopping rule with its `tolerance` and at most `max_iterations`."""

    learning_rate: float
    iterations: int | None = None
    max_iterations: int = 20000
    tolerance: float = 1e-4


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


def descend(objective: Objective, u0: np.ndarray, settings: Settings, time_limit: float) -> Descent:
    """Descend from u0 (steps, nu). time_limit: wall seconds."""
    deadline = perf_counter() + time_limit
    lower, upper = _bounds(objective)
    bounded = bool(np.isfinite(lower).any() or np.isfinite(upper).any())
    u = torch.tensor(np.clip(u0, lower, upper), dtype=torch.float64, requires_grad=True)
    inputs = u.detach()  # the same memory, outside the graph
    values = inputs.numpy()
    best = values.copy()
    limit = settings.max_iterations if settings.iterations is None else settings.iterations
    rule = StoppingRule(settings.tolerance)
    history: dict[str, list[float]] = {"loss": [], "terminal_error": [], "cost": [], "gradient_norm": []}

    def ended(outcome: Outcome, message: str, plan: np.ndarray | None, norm: float) -> Descent:
        return Descent(outcome=outcome, message=message, u=plan, iterations=iteration, gradient_norm=norm, history=history)

    iteration = 0
    while True:
        u.grad = None
        loss = objective(u)
        loss.backward()
        gradient = u.grad if u.grad is not None else torch.zeros_like(inputs)
        norm = _norm(gradient.numpy())
        if not (np.isfinite(norm) and np.isfinite(loss.item())):
            message = divergence_message(objective, settings.learning_rate, iteration, best if iteration else None)
            return ended(Outcome.DIVERGED if iteration else Outcome.EVALUATION_ERROR, message, None, 0.0)
        progress = rule.add(loss.item())
        for name, value in zip(history, (rule.losses[-1], objective.terminal_error, objective.cost, norm), strict=True):
            history[name].append(value)
        if rule.is_best:
            np.copyto(best, values)
        if settings.iterations is None and progress is Progress.RUNAWAY:
            return ended(Outcome.DIVERGED, divergence_message(objective, settings.learning_rate, iteration, best), None, norm)
        if settings.iterations is None and progress is Progress.SETTLED:
            outcome, message = Outcome.SOLVED, ""
            break
        if iteration == limit:
            outcome, message = Outcome.ITERATION_LIMIT, _limit_message(settings, rule)
            break
        if perf_counter() >= deadline:
            outcome, message = Outcome.TIME_LIMIT, f"stopped after {iteration} iterations at the time limit of {time_limit:g} s"
            break
        inputs.add_(gradient, alpha=-settings.learning_rate)
        if bounded:
            np.minimum(np.maximum(values, lower, out=values), upper, out=values)
        iteration += 1

    plan = (best if settings.iterations is None else values).copy()
    objective.value(plan)
    gradient = objective.gradient().copy()
    if outcome is Outcome.SOLVED:
        step = np.clip(plan - settings.learning_rate * gradient, lower, upper) - plan
        outcome, message = _settled(rule, -float((gradient * step).sum()))
    dead = dead_contact_message(objective, sensitivity(objective), settings.learning_rate)
    if dead:
        outcome = Outcome.STALLED if outcome is Outcome.SOLVED else outcome
        message = f"{message}; {dead}"
    at_bound = int(((plan <= lower) | (plan >= upper)).sum())
    if at_bound:
        message = f"{message}; {at_bound} of {plan.size} inputs are held at their bound"
    return ended(outcome, _sentence(message), plan, _norm(gradient))


def _bounds(objective: Objective) -> tuple[np.ndarray, np.ndarray]:
    inputs = objective.work.kernel.scene.inputs
    return np.array([item.lower for item in inputs]), np.array([item.upper for item in inputs])


def _norm(array: np.ndarray) -> float:
    flat = array.ravel()
    with np.errstate(over="ignore"):  # an overflow is an answer: the descent diverged
        return float(np.sqrt(flat @ flat))


def _limit_message(settings: Settings, rule: StoppingRule) -> str:
    if settings.iterations is not None:
        rose = "; the loss is higher than at the start" if rule.losses[-1] > rule.losses[0] else ""
        return f"stopped after the {settings.iterations} iterations asked for{rose}"
    return (
        f"stopped at max_iterations = {settings.max_iterations}; over the last quarter of them the loss still fell by "
        f"{100.0 * rule.decrease():.2g} % (tolerance {100.0 * settings.tolerance:.2g} %)"
    )


def _settled(rule: StoppingRule, promise: float) -> tuple[Outcome, str]:
    """SOLVED if the gradient agrees that there is nothing left to gain, else STALLED.

    promise: the decrease that one more step would bring if the loss were linear. Where the loss has settled although every step
    promises more than the tolerance, the steps are too long for its curvature or its kinks, and it is no minimum.
    """
    if rule.exhausted:
        return Outcome.SOLVED, f"the loss is down to {rule.best:.2g}, from {rule.losses[0]:.2g}"
    facts = f"the loss fell by {100.0 * rule.decrease():.2g} % over the last {rule.window} iterations"
    share = promise / rule.best
    if share <= rule.tolerance:
        return Outcome.SOLVED, f"{facts}, and one more step promises {100.0 * share:.2g} %"
    return Outcome.STALLED, f"{facts}, although each step promises {100.0 * share:.2g} %: it jumps to and fro; use a smaller learning rate"


def _sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."
