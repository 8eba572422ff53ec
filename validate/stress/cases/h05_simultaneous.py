"""Simultaneous impacts: two carts squeeze a third from both sides at once. Symmetric in, symmetric out, in whatever order the contacts are listed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.catalog import load_scene
from models.scenes.cart_chain import cart_chain
from models.trajectory import Trajectory
from validate.stress.case import Found, StressCase, at_most, finding
from validate.stress.motion import at_nodes, replayed, rolled

NODES, SQUEEZE = 200, 6.0


def _asymmetry(q: np.ndarray, v: np.ndarray) -> float:
    """Largest distance of positions (n, nq), mirrored about the middle, and velocities (n, nq) from their mirror images."""
    middle = (q[0, 0] + q[0, -1]) / 2.0
    return max(float(np.abs(q + q[:, ::-1] - 2.0 * middle).max()), float(np.abs(v + v[:, ::-1]).max()))


def measure() -> Found:
    """Measure what `CASE.expected` says."""
    scene = load_scene("three_cart")
    listed = {"as listed": scene, "reversed": replace(scene, contacts=scene.contacts[::-1])}
    u = np.tile([SQUEEZE, -SQUEEZE], (NODES, 1))
    plans: dict[str, Trajectory] = {name: rolled(item, u=u) for name, item in listed.items()}
    replays = {name: replayed(item, plans[name]) for name, item in listed.items()}
    chain = cart_chain(7)
    many = rolled(chain, u=u)
    plan_error = max(_asymmetry(plan.q, plan.v) for plan in (*plans.values(), many))
    replay_error = max(_asymmetry(told.q[told.knots], told.v[told.knots]) if told.ok else np.inf for told in replays.values())
    one, other = plans.values()
    order = float(max(np.abs(one.q - other.q).max(), np.abs(one.lam - other.lam[:, ::-1]).max()))
    first, second = (at_nodes(told) for told in replays.values())
    replay_order = float(np.abs(first - second).max()) if len(first) == len(second) else np.inf
    squeezed = float(one.lam.max())
    return finding(
        f"Both contacts close at once and reach {squeezed:.2f} N; plan and replay stay symmetric to {max(plan_error, replay_error):.0e}.",
        at_most("asymmetry of the plan's step", plan_error, 1e-12, reason="rounding of 200 steps of numbers near 3"),
        at_most("asymmetry of the replay", replay_error, 1e-9, reason="ten times what the replay says of its own error"),
        at_most(
            "plan: difference when contacts are listed the other way round",
            order,
            1e-12,
            reason="the sum of forces has no order but in rounding",
        ),
        at_most("replay: the same difference", replay_order, 1e-9, reason="ten times what the replay says of its own error"),
    )


CASE = StressCase(
    title="Simultaneous impacts, symmetric squeeze",
    expected="Symmetric in, symmetric out, whatever order contacts are listed in.",
    scenes=("three_cart", "cart_chain"),
)
