"""The relaxation against motions worked out step by step: where inputs and contacts are settled nothing is relaxed, elsewhere the triangle is all that is."""

import math
from dataclasses import replace

import numpy as np
import pytest

from formulations.contact_modes.linear import LinearScene
from formulations.proof import relaxed_bound
from formulations.proof.bounds import Relaxation, _lowered

# Clarabel's answers are lowered by a millionth of their size, at least by a millionth.
CLOSE = {"rel": 3e-6, "abs": 3e-6}


def linear(steps: int = 5, seed: int = 0) -> LinearScene:
    """Two states, two inputs, two contacts and one bound of a velocity, no two numbers alike; the cost has products, slopes and a constant."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(3, 4))
    return LinearScene(
        A=np.eye(2) + 0.3 * random.normal(size=(2, 2)), B=random.normal(size=(2, 2)), c=random.normal(size=2),
        E=np.hstack([0.2 * random.normal(size=(2, 2)), np.zeros((2, 1))]), P=random.normal(size=(3, 2)), p=np.array([0.3, -0.4, -50.0]),
        k=np.array([0.7, 1.3, 1.0]), H=root.T @ root, g=random.normal(size=4), constant=2.5, lower=np.full(2, -np.inf), upper=np.full(2, np.inf),
        start=np.array([0.6, -0.9]), goal=np.full(2, np.nan), step=0.1, steps=steps, contacts=2,
    )  # fmt: skip


def moved(lin: LinearScene, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """States (steps + 1, n), penetrations (steps, contacts) and cost of these inputs, with the contact law as it is."""
    z, phi, cost = [lin.start], [], 0.0
    for now in u:
        depth = lin.P @ z[-1] + lin.p
        x = np.concatenate([z[-1], now])
        cost += 0.5 * x @ lin.H @ x + lin.g @ x + lin.constant
        phi.append(depth[: lin.contacts])
        z.append(lin.A @ z[-1] + lin.B @ now + lin.c + lin.E @ (lin.k * np.maximum(depth, 0.0)))
    return np.array(z), np.array(phi), float(cost)


def settled(lin: LinearScene, u: np.ndarray) -> LinearScene:
    """The same, with inputs that can only be these: the same at each step."""
    return replace(lin, lower=u, upper=u)


def around(phi: np.ndarray, by: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Bounds that hold the penetrations and leave no contact undecided."""
    return np.where(phi > 0.0, np.maximum(phi - by, 0.0), phi - by), np.where(phi > 0.0, phi + by, np.minimum(phi + by, 0.0))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_where_all_is_settled_the_answers_are_those_of_the_motion(seed: int):
    u = np.array([0.4, -0.7])
    lin = settled(linear(seed=seed), u)
    _, phi, cost = moved(lin, np.tile(u, (5, 1)))
    assert (phi[:-1] > 0.0).any(), "or no force would act"
    lower, upper = around(phi)
    relaxation = Relaxation(lin)
    found = relaxation.least_cost(lower, upper)
    assert (found.status, found.bound) == ("solved", pytest.approx(cost, **CLOSE))
    assert found.bound < cost
    for t in range(1, 5):
        for contact in range(2):
            for sign in (1.0, -1.0):
                for ceiling in (np.inf, cost + 1.0):
                    answer = relaxation.least_penetration(t, contact, sign, lower, upper, ceiling)
                    assert (answer.status, answer.bound) == ("solved", pytest.approx(sign * phi[t, contact], rel=3e-5, abs=3e-5))
                    assert answer.bound <= sign * phi[t, contact] + 1e-9
    assert relaxed_bound(lin, lower, upper) == found.bound
    assert relaxed_bound(lin, lower, upper, cost - 3.0) == cost - 3.0
    assert relaxation.least_penetration(1, 0, 1.0, lower, upper, cost - 1.0).status == "infeasible"


@pytest.mark.parametrize("component", [0, 1])
def test_what_is_given_of_the_end_must_be_met(component: int):
    u = np.array([0.4, -0.7])
    lin = settled(linear(), u)
    z, phi, cost = moved(lin, np.tile(u, (5, 1)))
    goal = np.full(2, np.nan)
    goal[component] = z[-1, component]
    assert Relaxation(replace(lin, goal=goal)).least_cost(*around(phi)).bound == pytest.approx(cost, **CLOSE)
    goal[component] += 0.01
    found = Relaxation(replace(lin, goal=goal)).least_cost(*around(phi))
    assert (found.status, found.bound) == ("infeasible", math.inf)


def test_a_velocity_keeps_its_bound_at_every_step_but_the_start():
    u = np.array([0.4, -0.7])
    lin = settled(linear(), u)
    z, phi, _ = moved(lin, np.tile(u, (5, 1)))
    most = float((z[1:-1] @ lin.P[2]).max())
    for room, status in ((0.01, "solved"), (-0.01, "infeasible")):
        p = np.array([*lin.p[:2], -(most + room)])
        assert Relaxation(replace(lin, p=p)).least_cost(*around(phi)).status == status


# One mass with an input, nothing else: q[t+1] = q[t] + v[t], v[t+1] = v[t] + u[t] - lam[t]; phi = q, k = 2, from q = 1/2: lam[0] = 1.
ONE = LinearScene(
    A=np.array([[1.0, 1.0], [0.0, 1.0]]), B=np.array([[0.0], [1.0]]), c=np.zeros(2), E=np.array([[0.0], [-1.0]]), P=np.array([[1.0, 0.0]]),
    p=np.zeros(1), k=np.array([2.0]), H=np.diag([0.0, 0.0, 2.0]), g=np.array([0.0, 0.0, 3.0]), constant=0.25, lower=np.array([-10.0]),
    upper=np.array([10.0]), start=np.array([0.5, 0.25]), goal=np.full(2, np.nan), step=1.0, steps=4, contacts=1,
)  # fmt: skip


def extremes(lin: LinearScene, t: int, lower: np.ndarray, upper: np.ndarray, ceiling: float = np.inf) -> tuple[float, float]:
    relaxation = Relaxation(lin)
    least, most = (relaxation.least_penetration(t, 0, sign, lower, upper, ceiling) for sign in (1.0, -1.0))
    assert {least.status, most.status} == {"solved"}
    return least.bound, -most.bound


@pytest.mark.parametrize(("low", "high"), [(-1.0, 3.0), (-0.25, 1.0), (0.5, 1.0), (0.75, 0.75)])
def test_a_force_lies_in_the_triangle_over_the_bounds(low: float, high: float):
    """phi[1] = 3/4 whatever is done; phi[2] = 3/4 + (1/4 + u - 1), and phi[3] = phi[2] + v[2] - lam[1] + u, with u = 0: lam[1] is all that is open."""
    lower, upper = np.full((4, 1), -np.inf), np.full((4, 1), np.inf)
    lower[1], upper[1] = low, high
    lin = settled(ONE, np.zeros(1))
    hull = 2.0 * high * (0.75 - min(low, 0.0)) / (high - min(low, 0.0))
    least, most = extremes(lin, 3, lower, upper)
    start = 0.75 - 0.75 - 0.75  # phi[3] without lam[1]
    assert least == pytest.approx(start - hull, abs=1e-5)
    assert most == pytest.approx(start - 1.5, abs=1e-5)


def test_an_open_contact_has_no_force():
    lin = replace(settled(ONE, np.zeros(1)), p=np.array([-2.0]))  # phi[0] = -1.5: lam[0] = 0, phi[1] = -1.25, phi[2] = -1
    lower, upper = np.full((4, 1), -5.0), np.full((4, 1), 0.0)
    assert extremes(lin, 3, lower, upper) == pytest.approx((-0.75, -0.75), abs=1e-5)
    upper[1] = 1.0  # lam[1] <= 2 * 1 * (-1.25 + 5) / 6
    assert extremes(lin, 3, lower, upper) == pytest.approx((-0.75 - 1.25, -0.75), abs=1e-5)


def test_without_bounds_a_force_may_be_anything_above_the_law():
    lin = settled(ONE, np.zeros(1))
    lower, upper = np.full((4, 1), -np.inf), np.full((4, 1), np.inf)
    answer = Relaxation(lin).least_penetration(3, 0, -1.0, lower, upper, np.inf)
    assert -answer.bound == pytest.approx(-0.75 - 1.5, abs=1e-5)
    free = Relaxation(lin).least_penetration(3, 0, 1.0, lower, upper, np.inf)
    assert (free.status, free.bound) == ("unfinished", -np.inf)
    for side in (lower, upper):  # one bound alone makes no triangle
        side[1] = 0.75
        assert Relaxation(lin).least_penetration(3, 0, 1.0, lower, upper, np.inf).bound == -np.inf
        side[1] = -np.inf if side is lower else np.inf


def test_bounds_of_penetrations_bound_them():
    """With the input free, phi[2] is what its own bounds say; the one that is not asked for leaves it open."""
    lower, upper = np.full((4, 1), -3.0), np.full((4, 1), 2.0)
    lower[2], upper[2] = -0.5, 0.375
    assert extremes(ONE, 2, lower, upper) == pytest.approx((-0.5, 0.375), abs=1e-5)


def test_inputs_keep_their_bounds_on_either_side():
    """phi[2] = u[0], for the force of the start takes 1 of the speed of 1/4 that 3/4 has: 3/4 + 1/4 - 1 + u."""
    lower, upper = np.full((4, 1), -50.0), np.full((4, 1), 50.0)
    assert extremes(replace(ONE, lower=np.array([-0.125]), upper=np.array([0.25])), 2, lower, upper) == pytest.approx(
        (-0.125, 0.25), abs=1e-4
    )


def test_the_ceiling_leaves_what_it_pays_for():
    """Four steps cost the sum of u^2 + 3 u + 1/4: at least -8, where each u = -3/2. With room for one more, u[0] = -3/2 -+ 1."""
    lower, upper = np.full((4, 1), -50.0), np.full((4, 1), 50.0)
    assert Relaxation(ONE).least_cost(lower, upper).bound == pytest.approx(-8.0, **CLOSE)
    assert extremes(ONE, 2, lower, upper, ceiling=-7.0) == pytest.approx((-2.5, -0.5), abs=1e-4)
    assert extremes(ONE, 2, lower, upper, ceiling=-4.0) == pytest.approx((-3.5, 0.5), abs=1e-4)


@pytest.mark.parametrize(
    ("bound", "lowered"), [(2000.0, 1999.998), (-2000.0, -2000.002), (0.5, 0.499999), (-0.5, -0.500001), (-np.inf, -np.inf)]
)
def test_a_bound_is_lowered_by_its_size_before_it_is_believed(bound: float, lowered: float):
    assert _lowered(bound) == pytest.approx(lowered, rel=1e-12)
