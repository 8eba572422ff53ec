"""Gradient descent and its stopping rule once more, in numpy on the kernel's adjoint: no PyTorch, nothing shared with the loop it is held against."""

import numpy as np

from formulations.shooting.options import DescentOptions
from models.codegen.kernel import Kernel
from models.contact_law import ContactLaw

SHORTEST_WINDOW = 50
WINDOW_SHARE = 4
NOTHING_LEFT = 1e-20
RUNAWAY = 2.0


def progress(losses: list[float], tolerance: float) -> str:
    """After so many losses: descending, settled or runaway.

    See formulations/shooting/descent.py.
    """
    best, window = min(losses), max(SHORTEST_WINDOW, len(losses) // WINDOW_SHARE)
    if best <= NOTHING_LEFT * losses[0]:
        return "settled"
    if len(losses) <= window:
        return "descending"
    if min(losses[-(window // 2) :]) > RUNAWAY * best:
        return "runaway"
    earlier = min(losses[: len(losses) - window])
    return "settled" if earlier <= 0.0 or (earlier - best) / earlier <= tolerance else "descending"


def descend_in_python(
    kernel: Kernel,
    law: ContactLaw,
    eps: float | None,
    goal: np.ndarray,
    weights: tuple[float, float],
    u0: np.ndarray,
    settings: DescentOptions,
) -> tuple[str, np.ndarray, np.ndarray, np.ndarray]:
    """How it ended; the last inputs and the best ones (steps, nu).

    Rows of loss, terminal error, cost and gradient norm (n, 4).
    """
    scene, (terminal, running) = kernel.scene, weights
    lower, upper = (
        np.array([getattr(item, side) for item in scene.inputs]) for side in ("lower", "upper")
    )
    u = np.clip(u0, lower, upper)
    best, losses, rows = u.copy(), [], []
    limit = settings.max_iterations if settings.iterations is None else settings.iterations
    while True:
        plan = kernel.rollout(np.array(scene.task.start), u, scene.task.step, law, eps)
        if plan.diverged:
            return "not finite", u, best, np.array(rows)
        error = np.where(np.isnan(goal), 0.0, np.concatenate([plan.q[-1], plan.v[-1]]) - goal)
        q_bar, v_bar = np.zeros_like(plan.q), np.zeros_like(plan.v)
        q_bar[-1], v_bar[-1] = np.split(2.0 * terminal * error / len(error), 2)
        gradient, _ = kernel.adjoint(plan, u, q_bar, v_bar, cost_bar=running)
        cost = kernel.cost(plan.q, plan.v, u)
        losses.append(terminal * float(error @ error) / len(error) + running * cost)
        norm = float(np.linalg.norm(gradient))
        if not (np.isfinite(norm) and np.isfinite(losses[-1])):
            return "not finite", u, best, np.array(rows)
        rows.append((losses[-1], float(np.linalg.norm(error)), cost, norm))
        if losses[-1] == min(losses):
            best = u.copy()
        told = progress(losses, settings.tolerance)
        if settings.iterations is None and told != "descending":
            return told, u, best, np.array(rows)
        if len(rows) - 1 == limit:
            return "at limit", u, best, np.array(rows)
        u = np.minimum(np.maximum(u - settings.learning_rate * gradient, lower), upper)
