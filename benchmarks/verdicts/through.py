"""Bodies through each other: exact motions that the model does not mean, of inputs within their bounds."""

from __future__ import annotations

from functools import cache

import numpy as np

from benchmarks.verdicts.exact import based
from benchmarks.verdicts.plans import NoPlanError, Plan, exact, miss, motion_of, scene_of


@cache
def through() -> Plan:
    """Three carts: the outer ones squeeze the middle one until two carts are inside each other, and all of them end at the goal.

    The squeeze is 10 N for a second; the inputs after it are steered home by Gauss and Newton's steps on a semi-implicit Euler of all their changes at once.
    """
    scene, (t, u, _) = scene_of("three_cart"), based("three_cart")
    u, h, pieces = u.copy(), scene.task.step, 20
    squeezed, start, goal = round(1.2 / h), np.array(scene.task.start), np.array(scene.task.goal, dtype=float)
    u[:squeezed] = (10.0, -10.0)
    u[squeezed:] = u[squeezed:][:, :] * 0.0
    wide = (len(u) - squeezed) // pieces

    def ends(knobs: np.ndarray) -> np.ndarray:
        """knobs (k, 2 pieces) -> states (k, 6)."""
        x = np.tile(start, (len(knobs), 1))
        q, v = x[:, :3], x[:, 3:]
        for step in range(len(u)):
            force = np.zeros_like(q)
            held = np.tile(u[step], (len(knobs), 1))
            if step >= squeezed:
                piece = min((step - squeezed) // wide, pieces - 1)
                held = held + knobs[:, 2 * piece : 2 * piece + 2]
            force[:, 0] += held[:, 0]
            force[:, 2] += held[:, 1]
            push = 30.0 * np.maximum(0.5 - np.diff(q, axis=1), 0.0)
            force[:, :2] -= push
            force[:, 1:] += push
            v = v + h * (force - 2.0 * v)
            q = q + h * v
        return np.hstack([q, v])

    knobs = np.zeros(2 * pieces)
    knobs[0::2] = 0.5
    for _ in range(60):
        rows = ends(np.vstack([knobs, knobs + 1e-6 * np.eye(len(knobs))]))
        error, jacobian = rows[0] - goal, (rows[1:] - rows[0]).T / 1e-6
        if np.abs(error).max() < 1e-4:
            break
        change = -np.linalg.lstsq(jacobian, error, rcond=1e-6)[0]
        knobs = np.clip(knobs + change * min(1.0, 2.0 / np.abs(change).max()), -9.9, 9.9)
    for piece in range(pieces):
        low = squeezed + piece * wide
        u[low : (low + wide if piece < pieces - 1 else len(u))] += knobs[2 * piece : 2 * piece + 2]
    path = motion_of("three_cart").run(t, u)
    off = miss(scene, np.concatenate([path.q[-1], path.v[-1]]))
    if path.depth.max() < 0.51 or max(off) > 0.05:
        raise NoPlanError(f"the carts are {path.depth.max():.3g} m inside each other and end {off[0]:.3g} m from the goal")
    return exact(path, t, u)


def rammed(reference: str) -> Plan:
    """All inputs at their bounds, against each other. Raises NoPlanError where the model allows it."""
    scene = scene_of(reference)
    signs = np.array([1.0] + [-1.0] * (scene.nu - 1))
    t, u = based(reference)[0], np.tile(signs * np.array([item.upper for item in scene.inputs]), (scene.task.steps, 1))
    path = motion_of(reference).run(t, u)
    depth = path.depth
    if not (depth > np.array(scene.depths)).any():
        raise NoPlanError(f"at full force the bodies are {depth.max():.3g} m deep, which the model allows")
    return exact(path, t, u)
