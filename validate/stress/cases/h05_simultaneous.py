"""Simultaneous impacts: two carts squeeze a third.

The motion must be symmetric, in any order of contacts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.scenes.cart_chain import cart_chain
from validate.stress.case import Found, StressCase, at_most, finding
from validate.stress.motion import at_nodes, of_truth, rolled
from validate.truth.problems import asymmetry, squeeze


def measure() -> Found:
    """Measure the case."""
    problem = squeeze()
    scene, u = problem.scene, problem.plan.u
    listed = (scene, replace(scene, contacts=scene.contacts[::-1]))
    plans, replays = zip(*(of_truth(replace(problem, scene=item)) for item in listed), strict=True)
    chain = cart_chain(7)
    many = rolled(chain, u=u, step=problem.step)
    plan_error = max(asymmetry(plan.q, plan.v) for plan in (*plans, many))
    replay_error = max(
        asymmetry(told.q[told.knots], told.v[told.knots]) if told.ok else np.inf for told in replays
    )
    one, other = plans
    order = float(max(np.abs(one.q - other.q).max(), np.abs(one.lam - other.lam[:, ::-1]).max()))
    first, second = (at_nodes(told) for told in replays)
    replay_order = float(np.abs(first - second).max()) if len(first) == len(second) else np.inf
    squeezed = float(one.lam.max())
    return finding(
        f"Both contacts close at once and reach {squeezed:.2f} N; plan and replay stay symmetric to {max(plan_error, replay_error):.0e}.",
        at_most(
            "asymmetry of the plan's step",
            plan_error,
            1e-12,
            reason="rounding of 200 steps of numbers near 3",
        ),
        at_most(
            "asymmetry of the replay",
            replay_error,
            1e-9,
            reason="ten times what the replay says of its own error",
        ),
        at_most(
            "plan: difference when contacts are listed the other way round",
            order,
            1e-12,
            reason="the sum of forces has no order but in rounding",
        ),
        at_most(
            "replay: the same difference",
            replay_order,
            1e-9,
            reason="ten times what the replay says of its own error",
        ),
    )


CASE = StressCase(
    title="Simultaneous impacts, symmetric squeeze",
    expected="Symmetric in, symmetric out, whatever order contacts are listed in.",
    scenes=("three_cart", "cart_chain"),
)
