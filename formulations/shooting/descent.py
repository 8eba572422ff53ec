"""Gradient descent on an Objective, projected on the bounds of the inputs.

    result = descend(objective, u0, Settings(learning_rate=500.0, iterations=15), time_limit=60.0)

The step is `u <- clip(u - learning_rate * gradient, lower, upper)`. The paper's descent ignores the bounds and its plans stay
inside them: there the projection changes nothing, not even a bit. The step is that of `torch.optim.SGD` to rounding (tested).

The loop is compiled (loss.c): so many iterations in one call as take a twentieth of a second, so that a time limit and an interrupt are obeyed in between.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from formulations.shooting.compiled import CompiledLoss, DescentRun, Ending
from formulations.shooting.diagnosis import dead_contact_message, divergence_message, sensitivity
from formulations.shooting.ending import input_bounds
from formulations.shooting.errors import ShootingError
from formulations.shooting.objective import Objective
from formulations.shooting.stopping import Losses
from formulations.solution import Outcome

# Wall seconds that the compiled loop runs without looking up.
_SLICE = 0.05
_COLUMNS = ("loss", "terminal_error", "cost", "gradient_norm")


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
    if objective.smoothed:
        raise ShootingError("gradient descent takes a loss without noise; L-BFGS (randomised_smoothing) takes its mean over random inputs.")
    lower, upper = input_bounds(objective.work.kernel.scene)
    by_rule, rate = settings.iterations is None, settings.learning_rate
    run = DescentRun(
        CompiledLoss(objective),
        np.clip(u0, lower, upper),
        rate=rate,
        limit=settings.max_iterations if settings.iterations is None else settings.iterations,
        tolerance=settings.tolerance if by_rule else None,
        lower=lower,
        upper=upper,
    )
    ending = _run(run, objective, perf_counter() + time_limit)
    iteration = run.evaluations if ending is Ending.NOT_FINITE else run.evaluations - 1
    history = {name: column.tolist() for name, column in zip(_COLUMNS, run.columns, strict=True)}
    losses = Losses(values=run.columns[0])

    def ended(outcome: Outcome, message: str, plan: np.ndarray | None, norm: float) -> Descent:
        return Descent(outcome=outcome, message=message, u=plan, iterations=iteration, gradient_norm=norm, history=history)

    if ending is Ending.NOT_FINITE:
        objective.value(run.u)
        message = divergence_message(objective, rate, iteration, run.best if iteration else None)
        return ended(Outcome.DIVERGED if iteration else Outcome.EVALUATION_ERROR, message, None, 0.0)
    if ending is Ending.RUNAWAY:
        objective.value(run.u)
        return ended(Outcome.DIVERGED, divergence_message(objective, rate, iteration, run.best), None, history["gradient_norm"][-1])
    if ending is Ending.SETTLED:
        outcome, message = Outcome.SOLVED, ""
    elif ending is Ending.AT_LIMIT:
        outcome, message = Outcome.ITERATION_LIMIT, _limit_message(settings, losses)
    else:
        outcome, message = Outcome.TIME_LIMIT, f"stopped after {iteration} iterations at the time limit of {time_limit:g} s"

    plan = (run.best if by_rule else run.u).copy()
    objective.value(plan)
    gradient = objective.gradient().copy()
    if outcome is Outcome.SOLVED:
        step = np.clip(plan - rate * gradient, lower, upper) - plan
        outcome, message = _settled(losses, settings.tolerance, -float((gradient * step).sum()))
    dead = dead_contact_message(objective, sensitivity(objective), rate)
    if dead:
        outcome = Outcome.STALLED if outcome is Outcome.SOLVED else outcome
        message = f"{message}; {dead}"
    at_bound = int(((plan <= lower) | (plan >= upper)).sum())
    if at_bound:
        message = f"{message}; {at_bound} of {plan.size} inputs are held at their bound"
    return ended(outcome, _sentence(message), plan, _norm(gradient))


def _run(run: DescentRun, objective: Objective, deadline: float) -> Ending:
    """Until it ends, or UNDER_WAY at the deadline."""
    most = 1
    while True:
        before, started = run.evaluations, perf_counter()
        ending = run.advance(most)
        now = perf_counter()
        objective.evaluate_seconds += now - started
        if ending is not Ending.UNDER_WAY or now >= deadline:
            return ending
        share = min(_SLICE, deadline - now) / max(now - started, 1e-9)
        most = max(1, min(int((run.evaluations - before) * share), 10 * most))


def _norm(array: np.ndarray) -> float:
    flat = array.ravel()
    with np.errstate(over="ignore"):  # an overflow is an answer: the descent diverged
        return float(np.sqrt(flat @ flat))


def _limit_message(settings: Settings, losses: Losses) -> str:
    if settings.iterations is not None:
        rose = "; the loss is higher than at the start" if losses.last > losses.first else ""
        return f"stopped after the {settings.iterations} iterations asked for{rose}"
    return (
        f"stopped at max_iterations = {settings.max_iterations}; over the last quarter of them the loss still fell by "
        f"{100.0 * losses.decrease():.2g} % (tolerance {100.0 * settings.tolerance:.2g} %)"
    )


def _settled(losses: Losses, tolerance: float, promise: float) -> tuple[Outcome, str]:
    """SOLVED if the gradient agrees that there is nothing left to gain, else STALLED.

    promise: the decrease that one more step would bring if the loss were linear. Where the loss has settled although every step
    promises more than the tolerance, the steps are too long for its curvature or its kinks, and it is no minimum.
    """
    if losses.exhausted:
        return Outcome.SOLVED, f"the loss is down to {losses.best:.2g}, from {losses.first:.2g}"
    facts = f"the loss fell by {100.0 * losses.decrease():.2g} % over the last {losses.window} iterations"
    share = promise / losses.best
    if share <= tolerance:
        return Outcome.SOLVED, f"{facts}, and one more step promises {100.0 * share:.2g} %"
    return Outcome.STALLED, f"{facts}, although each step promises {100.0 * share:.2g} %: it jumps to and fro; use a smaller learning rate"


def _sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."
