"""The loop of gradient descent and its stopping rule, written out in Python: what the compiled ones (loss.c) must do, bit for bit."""

from __future__ import annotations

from enum import Enum

import numpy as np

from formulations.shooting.descent import Settings
from formulations.shooting.ending import input_bounds
from formulations.shooting.objective import Objective

SHORTEST_WINDOW, WINDOW_SHARE, NOTHING_LEFT, RUNAWAY = 50, 4, 1e-20, 2.0


class Progress(Enum):
    DESCENDING = 0
    SETTLED = 1
    RUNAWAY = 2


class StoppingRule:
    """Fed with one loss an iteration; see formulations/shooting/stopping.py."""

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance
        self.losses: list[float] = []
        self.best: list[float] = []  # best loss up to each iteration

    def add(self, loss: float) -> Progress:
        """Take the next loss and say how the descent goes."""
        self.losses.append(loss)
        self.best.append(min(loss, self.best[-1]) if self.best else loss)
        window = max(SHORTEST_WINDOW, len(self.losses) // WINDOW_SHARE)
        if self.best[-1] <= NOTHING_LEFT * self.losses[0]:
            return Progress.SETTLED
        if len(self.losses) <= window:
            return Progress.DESCENDING
        if min(self.losses[-(window // 2) :]) > RUNAWAY * self.best[-1]:
            return Progress.RUNAWAY
        earlier = self.best[len(self.best) - 1 - window]
        decrease = (earlier - self.best[-1]) / earlier if earlier > 0.0 else 0.0
        return Progress.SETTLED if decrease <= self.tolerance else Progress.DESCENDING


def descend_in_python(objective: Objective, u0: np.ndarray, settings: Settings) -> tuple[str, np.ndarray, np.ndarray, np.ndarray]:
    """How it ended; the last inputs and the best ones (steps, nu); rows of loss, terminal error, cost and gradient norm (n, 4)."""
    lower, upper = input_bounds(objective.work.kernel.scene)
    u = np.clip(u0, lower, upper)
    best = u.copy()
    rule, rows = StoppingRule(settings.tolerance), []
    limit = settings.max_iterations if settings.iterations is None else settings.iterations
    while True:
        loss = objective.value(u)
        gradient = objective.gradient() if np.isfinite(loss) else np.full(u.shape, np.nan)
        norm = float(np.linalg.norm(gradient))
        if not (np.isfinite(norm) and np.isfinite(loss)):
            return "not finite", u, best, np.array(rows)
        progress = rule.add(loss)
        rows.append((loss, objective.terminal_error, objective.cost, norm))
        if rule.best[-1] == loss:
            best = u.copy()
        if settings.iterations is None and progress is not Progress.DESCENDING:
            return progress.name.lower(), u, best, np.array(rows)
        if len(rows) - 1 == limit:
            return "at limit", u, best, np.array(rows)
        u = np.minimum(np.maximum(u - settings.learning_rate * gradient, lower), upper)
