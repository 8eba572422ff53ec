"""The judge of all peers: NumPy and the paper's equations, nothing of any solver.

The three carts: unit masses, damping 2 on each, stiffness 30, length 0.5, h = 0.01, 500 steps, from
rest at (2, 3, 4) to rest at (2.5, 3.5, 4.5).
"""

from __future__ import annotations

import numpy as np

STEPS = 500
STEP = 0.01
DAMPING = 2.0
STIFFNESS = 30.0
LENGTH = 0.5
INPUT_LIMIT = 10.0
START = np.array([2.0, 3.0, 4.0, 0.0, 0.0, 0.0])
GOAL = np.array([2.5, 3.5, 4.5, 0.0, 0.0, 0.0])
# random starts: so many pieces of constant input [N]
_PIECES = 10
_PUSH = 3.0


def rollout(u: np.ndarray) -> dict[str, np.ndarray]:
    """The plan that inputs u (500, 2) make through the true contact law."""
    q, v, lam = np.empty((STEPS + 1, 3)), np.empty((STEPS + 1, 3)), np.empty((STEPS, 2))
    q[0], v[0] = START[:3], START[3:]
    for t in range(STEPS):
        lam[t] = STIFFNESS * np.maximum(LENGTH - np.diff(q[t]), 0.0)
        v[t + 1] = v[t] + STEP * acceleration(v[t], u[t], lam[t])
        q[t + 1] = q[t] + STEP * v[t + 1]
    return {"q": q, "v": v, "u": u, "lam": lam}


def acceleration(v: np.ndarray, u: np.ndarray, lam: np.ndarray) -> np.ndarray:
    return np.array([u[0] - lam[0], lam[0] - lam[1], u[1] + lam[1]]) - DAMPING * v


def random_start(seed: int) -> dict[str, np.ndarray]:
    """Piecewise constant random inputs and what they lead to.

    For a negative seed the paper's first guess: the start held, no force.
    """
    if seed < 0:
        zero = np.zeros((STEPS, 2))
        return {
            "q": np.tile(START[:3], (STEPS + 1, 1)),
            "v": np.zeros((STEPS + 1, 3)),
            "u": zero,
            "lam": zero,
        }
    pieces = np.random.default_rng(seed).uniform(-_PUSH, _PUSH, (_PIECES, 2))
    return rollout(pieces[np.arange(STEPS) * _PIECES // STEPS])


def judged(plan: dict[str, np.ndarray]) -> dict[str, float]:
    """Recompute the figures of a plan.

    cost; residual: the largest violation of time step, start, goal, bounds, signs, and min(lam, lam - k
    phi); physics: the paper's (10);

    miss: how far from the goal the inputs alone lead, through the true law.
    """
    q, v, u, lam = plan["q"], plan["v"], plan["u"], plan["lam"]
    slack = lam - STIFFNESS * (LENGTH - np.diff(q[:-1], axis=1))
    step_v = np.array([acceleration(v[t], u[t], lam[t]) for t in range(STEPS)])
    parts = [
        q[1:] - q[:-1] - STEP * v[1:], v[1:] - v[:-1] - STEP * step_v,
        np.concatenate([q[0], v[0]]) - START, np.concatenate([q[-1], v[-1]]) - GOAL,
        np.maximum(np.abs(u) - INPUT_LIMIT, 0.0), np.minimum(lam, slack),
    ]  # fmt: skip
    end = rollout(u)
    return {
        "cost": float(np.sum(u**2)),
        "residual": max(float(np.max(np.abs(part))) for part in parts),
        "complementarity": float(np.max(np.abs(np.minimum(lam, slack)))),
        "physics": float(np.sum(np.abs(lam * slack))),
        "miss": float(np.linalg.norm(np.concatenate([end["q"][-1], end["v"][-1]]) - GOAL)),
    }
