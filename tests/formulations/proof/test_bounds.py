"""How deep contacts can be: the bound from physics by hand, and how the sources come together, with relaxations that answer what a test says. The relaxation against motions worked out step by step: where inputs and contacts are settled nothing is relaxed, elsewhere the triangle is all that is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp

from formulations.contact_modes.linear import LinearScene, linear_scene
from formulations.proof import bounds as module
from formulations.proof import relaxed_bound
from formulations.proof.bounds import (
    EnergyBound,
    PairBounds,
    Relaxation,
    _lowered,
    energy_bound,
    pair_bounds,
    physical_bounds,
)
from models.scene import Contact, Coordinate, Input, Scene, Task

# Clarabel's answers are lowered by a millionth of their size, at least by a millionth.
CLOSE = {"rel": 3e-6, "abs": 3e-6}


def linear(steps: int = 5, seed: int = 0) -> LinearScene:
    """Two states, two inputs, two contacts and one bound of a velocity, no two numbers alike.

    The cost has products, slopes and a constant.
    """
    random = np.random.default_rng(seed)
    root = random.normal(size=(3, 4))
    return LinearScene(
        A=np.eye(2) + 0.3 * random.normal(size=(2, 2)), B=random.normal(size=(2, 2)),
        c=random.normal(size=2),
        E=np.hstack([0.2 * random.normal(size=(2, 2)), np.zeros((2, 1))]),
        P=random.normal(size=(3, 2)), p=np.array([0.3, -0.4, -50.0]),
        k=np.array([0.7, 1.3, 1.0]), H=root.T @ root, g=random.normal(size=4), constant=2.5,
        lower=np.full(2, -np.inf), upper=np.full(2, np.inf),
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
    return np.where(phi > 0.0, np.maximum(phi - by, 0.0), phi - by), np.where(
        phi > 0.0, phi + by, np.minimum(phi + by, 0.0)
    )


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_where_all_is_settled_the_answers_are_those_of_the_motion(seed: int):
    u = np.array([0.4, -0.7])
    lin = settled(linear(seed=seed), u)
    _, phi, cost = moved(lin, np.tile(u, (5, 1)))
    assert (phi[:-1] > 0.0).any(), "or no force would act"
    lower, upper = around(phi)
    relaxation = Relaxation(lin)
    found = relaxation.least_cost(lower, upper)
    assert found == pytest.approx(cost, **CLOSE)
    assert found < cost
    for t in range(1, 5):
        for contact in range(2):
            for sign in (1.0, -1.0):
                for ceiling in (np.inf, cost + 1.0):
                    answer = relaxation.least_penetration(t, contact, sign, lower, upper, ceiling)
                    assert answer == pytest.approx(sign * phi[t, contact], rel=3e-5, abs=3e-5)
                    assert answer <= sign * phi[t, contact] + 1e-9
    assert relaxed_bound(lin, lower, upper) == found
    assert relaxed_bound(lin, lower, upper, cost - 3.0) == cost - 3.0
    assert relaxation.least_penetration(1, 0, 1.0, lower, upper, cost - 1.0) == math.inf


@pytest.mark.parametrize("component", [0, 1])
def test_what_is_given_of_the_end_must_be_met(component: int):
    u = np.array([0.4, -0.7])
    lin = settled(linear(), u)
    z, phi, cost = moved(lin, np.tile(u, (5, 1)))
    goal = np.full(2, np.nan)
    goal[component] = z[-1, component]
    assert Relaxation(replace(lin, goal=goal)).least_cost(*around(phi)) == pytest.approx(
        cost, **CLOSE
    )
    goal[component] += 0.01
    assert Relaxation(replace(lin, goal=goal)).least_cost(*around(phi)) == math.inf


def test_a_velocity_keeps_its_bound_at_every_step_but_the_start():
    u = np.array([0.4, -0.7])
    lin = settled(linear(), u)
    z, phi, _ = moved(lin, np.tile(u, (5, 1)))
    most = float((z[1:-1] @ lin.P[2]).max())
    for room, exists in ((0.01, True), (-0.01, False)):
        p = np.array([*lin.p[:2], -(most + room)])
        found = Relaxation(replace(lin, p=p)).least_cost(*around(phi))
        assert (math.isfinite(found), found == math.inf) == (exists, not exists)


# One mass with an input, nothing else: q[t+1] = q[t] + v[t], v[t+1] = v[t] + u[t] - lam[t]; phi =
# q, k = 2, from q = 1/2: lam[0] = 1.
ONE = LinearScene(
    A=np.array([[1.0, 1.0], [0.0, 1.0]]), B=np.array([[0.0], [1.0]]), c=np.zeros(2),
    E=np.array([[0.0], [-1.0]]), P=np.array([[1.0, 0.0]]),
    p=np.zeros(1), k=np.array([2.0]), H=np.diag([0.0, 0.0, 2.0]), g=np.array([0.0, 0.0, 3.0]),
    constant=0.25, lower=np.array([-10.0]),
    upper=np.array([10.0]), start=np.array([0.5, 0.25]), goal=np.full(2, np.nan), step=1.0, steps=4,
    contacts=1,
)  # fmt: skip


def extremes(
    lin: LinearScene, t: int, lower: np.ndarray, upper: np.ndarray, ceiling: float = np.inf
) -> tuple[float, float]:
    relaxation = Relaxation(lin)
    least, most = (
        relaxation.least_penetration(t, 0, sign, lower, upper, ceiling) for sign in (1.0, -1.0)
    )
    assert math.isfinite(least)
    assert math.isfinite(most)
    return least, -most


@pytest.mark.parametrize(("low", "high"), [(-1.0, 3.0), (-0.25, 1.0), (0.5, 1.0), (0.75, 0.75)])
def test_a_force_lies_in_the_triangle_over_the_bounds(low: float, high: float):
    """phi[1] = 3/4 whatever is done.

    phi[2] = 3/4 + (1/4 + u - 1), and phi[3] = phi[2] + v[2] - lam[1] + u, with u = 0: lam[1] is all
    that is open.
    """
    lower, upper = np.full((4, 1), -np.inf), np.full((4, 1), np.inf)
    lower[1], upper[1] = low, high
    lin = settled(ONE, np.zeros(1))
    hull = 2.0 * high * (0.75 - min(low, 0.0)) / (high - min(low, 0.0))
    least, most = extremes(lin, 3, lower, upper)
    start = 0.75 - 0.75 - 0.75  # phi[3] without lam[1]
    assert least == pytest.approx(start - hull, abs=1e-5)
    assert most == pytest.approx(start - 1.5, abs=1e-5)


def test_an_open_contact_has_no_force():
    lin = replace(
        settled(ONE, np.zeros(1)), p=np.array([-2.0])
    )  # phi[0] = -1.5: lam[0] = 0, phi[1] = -1.25, phi[2] = -1
    lower, upper = np.full((4, 1), -5.0), np.full((4, 1), 0.0)
    assert extremes(lin, 3, lower, upper) == pytest.approx((-0.75, -0.75), abs=1e-5)
    upper[1] = 1.0  # lam[1] <= 2 * 1 * (-1.25 + 5) / 6
    assert extremes(lin, 3, lower, upper) == pytest.approx((-0.75 - 1.25, -0.75), abs=1e-5)


def test_without_bounds_a_force_may_be_anything_above_the_law():
    lin = settled(ONE, np.zeros(1))
    lower, upper = np.full((4, 1), -np.inf), np.full((4, 1), np.inf)
    answer = Relaxation(lin).least_penetration(3, 0, -1.0, lower, upper, np.inf)
    assert -answer == pytest.approx(-0.75 - 1.5, abs=1e-5)
    assert Relaxation(lin).least_penetration(3, 0, 1.0, lower, upper, np.inf) == -np.inf
    for side in (lower, upper):  # one bound alone makes no triangle
        side[1] = 0.75
        assert Relaxation(lin).least_penetration(3, 0, 1.0, lower, upper, np.inf) == -np.inf
        side[1] = -np.inf if side is lower else np.inf


def test_bounds_of_penetrations_bound_them():
    """With the input free, phi[2] is what its own bounds say.

    The one that is not asked for leaves it open.
    """
    lower, upper = np.full((4, 1), -3.0), np.full((4, 1), 2.0)
    lower[2], upper[2] = -0.5, 0.375
    assert extremes(ONE, 2, lower, upper) == pytest.approx((-0.5, 0.375), abs=1e-5)


def test_inputs_keep_their_bounds_on_either_side():
    """phi[2] = u[0], for the force of the start takes 1 of the speed of 1/4 that 3/4 has: 3/4 + 1/4 - 1 + u."""
    lower, upper = np.full((4, 1), -50.0), np.full((4, 1), 50.0)
    assert extremes(
        replace(ONE, lower=np.array([-0.125]), upper=np.array([0.25])), 2, lower, upper
    ) == pytest.approx((-0.125, 0.25), abs=1e-4)


def test_the_ceiling_leaves_what_it_pays_for():
    """Four steps cost the sum of u^2 + 3 u + 1/4: at least -8, where each u = -3/2.

    With room for one more, u[0] = -3/2 -+ 1.
    """
    lower, upper = np.full((4, 1), -50.0), np.full((4, 1), 50.0)
    assert Relaxation(ONE).least_cost(lower, upper) == pytest.approx(-8.0, **CLOSE)
    assert extremes(ONE, 2, lower, upper, ceiling=-7.0) == pytest.approx((-2.5, -0.5), abs=1e-4)
    assert extremes(ONE, 2, lower, upper, ceiling=-4.0) == pytest.approx((-3.5, 0.5), abs=1e-4)


@pytest.mark.parametrize(
    ("bound", "lowered"),
    [
        (2000.0, 1999.998),
        (-2000.0, -2000.002),
        (0.5, 0.499999),
        (-0.5, -0.500001),
        (-np.inf, -np.inf),
    ],
)
def test_a_bound_is_lowered_by_its_size_before_it_is_believed(bound: float, lowered: float):
    assert _lowered(bound) == pytest.approx(lowered, rel=1e-12)


x, y, v, w, f, g = sp.symbols("x y v w f g", real=True)
COST = 3 * f**2 + f * g + 4 * g**2
# M = diag(2, 5), C = diag(1/2, 3/2), B = [[1, 0], [2, 3]], phi = 2 x - y/2 - 1, k = 3/4: D = C -
# h/2 (C M^-1 C + J' k J), R = [[3, 1/2], [1/2, 4]].
SCENE = Scene(
    name="two_masses", title="Two masses, two forces, one contact between them",
    source="made for this test",
    coordinates=(Coordinate(symbol=x, velocity=v, unit="m"),
                 Coordinate(symbol=y, velocity=w, unit="m")),
    inputs=(Input(symbol=f, unit="N"), Input(symbol=g, unit="N")), parameters=(),
    kinetic_energy=v**2 + 5 * w**2 / 2, potential_energy=sp.Integer(0),
    forces=(f - v / 2, 2 * f + 3 * g - 3 * w / 2),
    contacts=(
        Contact(name="pair", bodies=("left", "right"), penetration=2 * x - y / 2 - 1,
                stiffness=sp.Rational(3, 4), depth=1, depth_reason="a test", nominal=0.1),
    ),
    task=Task(start=(1.0, -1.0, 0.5, -0.25), goal=(None, None, None, None), running_cost=COST,
              step=0.1, steps=5),
)  # fmt: skip
_M = np.diag([2.0, 5.0])
_J = np.array([2.0, -0.5])
_K = 0.75
_H = 0.1
_D = np.diag([0.5, 1.5]) - _H / 2 * (np.diag([0.125, 0.45]) + _K * np.outer(_J, _J))
_B = np.array([[1.0, 0.0], [2.0, 3.0]])
_R = np.array([[3.0, 0.5], [0.5, 4.0]])


def test_the_energy_of_two_masses_by_hand():
    """The gain is the most that any direction of the inputs brings: here by trying them all."""
    directions = np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0.0, np.pi, 20_001)])
    pushes = directions @ _B.T
    gain = max(
        0.25
        * np.einsum("ni,ij,nj->n", pushes, np.linalg.inv(_D), pushes)
        / np.einsum("ni,ij,nj->n", directions, _R, directions)
    )
    # 1/2 M v^2 = 1/4 + 5/32; phi = 2 + 1/2 - 1 = 3/2: 1/2 k phi^2 = 27/32
    energy = 0.25 + 0.15625 + 0.84375 + _H * gain * 7.0
    found = energy_bound(SCENE, 7.0)
    assert found.penetration == pytest.approx([np.sqrt(2 * energy / _K)], rel=1e-7)
    assert found.approach == pytest.approx(
        [np.sqrt(2 * energy * (4.0 / 2.0 + 0.25 / 5.0))], rel=1e-7
    )


def test_an_open_contact_holds_no_energy():
    """At the start, phi = -1: what is left is the motion's 1/4 + 5/32, where nothing may be spent."""
    found = energy_bound(SCENE.with_task(start=(-0.25, -1.0, 0.5, -0.25)), 0.0)
    assert found.penetration == pytest.approx([np.sqrt(2 * (0.25 + 0.15625) / _K)], rel=1e-12)


NOT_OF_THE_FORM: dict[str, Callable[[], Scene]] = {
    "not linear": lambda: replace(SCENE, forces=(f - v**3, g)),
    "a mass that is not diagonal": lambda: replace(SCENE,
        kinetic_energy=v**2 + 5 * w**2 / 2 + v * w),
    "a spring": lambda: replace(SCENE, potential_energy=x**2),
    "no input": lambda: replace(SCENE.with_task(running_cost=sp.Integer(0)), inputs=(),
                                forces=(-v / 2, -w)),
    "drag between the two": lambda: replace(SCENE, forces=(f - v / 2 + w / 8, g - 3 * w / 2)),
    "a force that is always there": lambda: replace(SCENE, forces=(f - v / 2 + 1, g - 3 * w / 2)),
    "a cost of the state": lambda: SCENE.with_task(running_cost=COST + x**2),
    "a cost of the end": lambda: SCENE.with_task(final_cost=x**2),
    "a linear cost": lambda: SCENE.with_task(running_cost=COST + f),
    "a cost that is always there": lambda: SCENE.with_task(running_cost=COST - 1),
    "an input that costs nothing": lambda: SCENE.with_task(running_cost=f**2),
    "an input that pays": lambda: SCENE.with_task(running_cost=f**2 - g**2),
    "no drag": lambda: replace(SCENE, forces=(f, g)),
    "a step that makes energy": lambda: SCENE.with_task(step=0.5),
}  # fmt: skip


@pytest.mark.parametrize("name", NOT_OF_THE_FORM)
def test_no_energy_is_bounded_of_a_scene_of_another_form(name: str):
    assert energy_bound(NOT_OF_THE_FORM[name](), 1.0) is None


def test_a_step_that_is_just_too_long():
    """Of one mass M = 1, C = 1, no contact: D = 1 - h/2, which is 0 at h = 2."""
    free = replace(
        SCENE, coordinates=SCENE.coordinates[:1], inputs=SCENE.inputs[:1], forces=(f - v,),
        kinetic_energy=v**2 / 2, contacts=(),
        task=Task(start=(0.0, 0.0), goal=(None, None), running_cost=f**2, step=2.0, steps=3),
    )  # fmt: skip
    assert energy_bound(free, 1.0) is None
    assert energy_bound(free.with_task(step=1.0), 1.0) is not None


@pytest.fixture
def physics(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Of any scene contacts go in by 3/10 at most, and move by 1/4 in a step.

    The ceilings that were asked for.
    """
    asked: list[float] = []

    def found(_: Scene, ceiling: float) -> EnergyBound:
        asked.append(ceiling)
        return EnergyBound(penetration=np.array([0.3]), approach=np.array([0.5]))

    monkeypatch.setattr(module, "energy_bound", found)
    return asked


HALF = replace(ONE, step=0.5, start=np.array([-0.5, 0.0]), steps=4)


def test_a_gap_changes_by_its_approach_in_each_step_and_is_no_deeper_than_physics(
    physics: list[float],
):
    found = physical_bounds(SimpleNamespace(nq=1), HALF, 7.0)
    assert physics == [7.0]
    assert found.lower[:, 0] == pytest.approx([-0.5, -0.75, -1.0, -1.25])
    assert found.upper[:, 0] == pytest.approx([-0.5, -0.25, 0.0, 0.25])
    later = physical_bounds(SimpleNamespace(nq=1), replace(HALF, steps=6), 7.0)
    assert later.upper[:, 0] == pytest.approx([-0.5, -0.25, 0.0, 0.25, 0.3, 0.3])
    assert (later.ceiling, later.is_empty) == (7.0, False)


def test_where_the_end_is_given_gaps_are_bounded_from_there_too(physics: list[float]):
    aimed = replace(
        HALF, goal=np.array([-0.75, np.nan])
    )  # 4 steps of 1/4 are left at the start, one before the last
    found = physical_bounds(SimpleNamespace(nq=1), aimed, 7.0)
    assert found.lower[:, 0] == pytest.approx([-0.5, -0.75, -1.0, -1.0])
    assert found.upper[:, 0] == pytest.approx([-0.5, -0.25, -0.25, -0.5])
    half = physical_bounds(
        SimpleNamespace(nq=2), replace(HALF, goal=np.array([-0.75, np.nan])), 7.0
    )
    assert half.upper[:, 0] == pytest.approx([-0.5, -0.25, 0.0, 0.25]), (
        "a part of the place says nothing of a gap"
    )


def test_of_all_plans_physics_says_nothing(physics: list[float]):
    found = physical_bounds(SimpleNamespace(nq=1), HALF, np.inf)
    assert physics == []
    assert found.lower[:, 0].tolist() == [-0.5, -np.inf, -np.inf, -np.inf]
    assert found.upper[:, 0].tolist() == [-0.5, np.inf, np.inf, np.inf]
    assert not found.is_finite


def pairs(lower: list[float], upper: list[float]) -> PairBounds:
    return PairBounds(lower=np.array(lower)[:, None], upper=np.array(upper)[:, None], ceiling=7.0)


def test_a_contact_that_can_only_be_open_or_only_closed_is_decided():
    found = pairs([-1.0, -1.0, 0.0, 0.25, -1.0, 0.0], [-0.5, 0.0, 1.0, 1.0, 0.5, 0.0])
    assert found.decided[:, 0].tolist() == [True, True, True, True, False, True]


@pytest.mark.parametrize(
    ("low", "high", "finite"), [(-1.0, 1.0, True), (-np.inf, 1.0, False), (-1.0, np.inf, False)]
)
def test_a_pair_needs_both_bounds(low: float, high: float, finite: bool):
    assert pairs([0.0, low], [0.0, high]).is_finite is finite


class Answers:
    """A relaxation whose answers of sign * phi[t, contact] come from a function.

    What was asked is kept.
    """

    def __init__(self, say: Callable[..., float]) -> None:
        self.asked: list[tuple[int, int, float, float]] = []
        self.seen: list[tuple[np.ndarray, np.ndarray]] = []
        self._say = say

    def __call__(self, linear: object) -> Answers:
        return self

    def least_penetration(
        self,
        t: int,
        contact: int,
        sign: float,
        lower: np.ndarray,
        upper: np.ndarray,
        ceiling: float,
    ) -> float:
        self.asked.append((t, contact, sign, ceiling))
        self.seen.append((lower.copy(), upper.copy()))
        return self._say(len(self.asked), t, contact, sign, ceiling)


def swept(
    monkeypatch: pytest.MonkeyPatch, first: PairBounds, say: Callable[..., float], **options
) -> tuple[Answers, PairBounds]:
    answers = Answers(say)
    monkeypatch.setattr(module, "Relaxation", answers)
    linear = linear_scene(SCENE)
    monkeypatch.setattr(
        module,
        "physical_bounds",
        lambda *asked: replace(first, ceiling=asked[2] if asked[:2] == (SCENE, linear) else -1.0),
    )
    return answers, pair_bounds(SCENE, linear, 7.0, **options)


def two(lower: float, upper: float) -> PairBounds:
    """Two contacts, three steps, the first of which is the start."""
    low, high = np.full((3, 2), lower), np.full((3, 2), upper)
    low[0] = high[0] = 0.125
    return PairBounds(lower=low, upper=high, ceiling=7.0)


def test_every_pair_is_asked_for_in_the_order_of_time_with_what_is_known_by_then(
    monkeypatch: pytest.MonkeyPatch,
):
    answers, found = swept(
        monkeypatch,
        two(-1.0, 2.0),
        lambda n, t, contact, sign, ceiling: -0.5 / t if sign > 0 else -1.0 / t,
    )
    order = [(t, contact, sign, 7.0) for t in (1, 2) for contact in (0, 1) for sign in (1.0, -1.0)]
    assert answers.asked[:8] == order
    assert found.lower.tolist() == [[0.125, 0.125], [-0.5, -0.5], [-0.25, -0.25]]
    assert found.upper.tolist() == [[0.125, 0.125], [1.0, 1.0], [0.5, 0.5]]
    lower, upper = answers.seen[
        5
    ]  # the largest phi[2, 0] is asked for: its least is known, and all of step 1
    assert lower.tolist() == [[0.125, 0.125], [-0.5, -0.5], [-0.25, -1.0]]
    assert upper.tolist() == [[0.125, 0.125], [1.0, 1.0], [2.0, 2.0]]
    assert (found.ceiling, found.is_empty) == (7.0, False)


def test_a_bound_that_is_no_better_is_not_taken(monkeypatch: pytest.MonkeyPatch):
    _, found = swept(monkeypatch, two(-1.0, 2.0), lambda n, t, contact, sign, ceiling: -3.0)
    assert (found.lower[1, 0], found.upper[1, 0]) == (-1.0, 2.0)


def test_rounds_go_on_while_they_decide_more_and_three_times_at_most(
    monkeypatch: pytest.MonkeyPatch,
):
    """The first sweep, then a round for each that left less than nine tenths of the widths.

    The upper sides move once.
    """

    def shrinking(factor: float) -> int:
        answers, _ = swept(
            monkeypatch,
            two(-1.0, 1.0),
            lambda n, t, contact, sign, _: -(factor ** ((n - 1) // 8)) if sign > 0 else -0.125,
        )
        return len(answers.asked) // 8

    assert [shrinking(factor) for factor in (1.0, 0.95, 0.85, 0.5)] == [2, 2, 4, 4]


def test_where_all_is_decided_nothing_more_is_asked(monkeypatch: pytest.MonkeyPatch):
    answers, found = swept(
        monkeypatch, two(-1.0, 2.0), lambda n, t, contact, sign, ceiling: 0.5 if sign > 0 else -0.75
    )
    assert found.decided.all()
    assert len(answers.asked) == 8


def test_what_is_known_to_be_impossible_is_said_at_once(monkeypatch: pytest.MonkeyPatch):
    def say(n: int, *rest: object) -> float:
        return -0.5 if n < 3 else np.inf

    answers, found = swept(monkeypatch, two(-1.0, 2.0), say)
    assert (found.is_empty, found.ceiling, len(answers.asked)) == (True, 7.0, 3)
    assert (found.lower[1].tolist(), found.upper[1].tolist()) == ([-0.5, -1.0], [0.5, 2.0])


def test_a_program_that_the_ceiling_makes_too_hard_is_asked_without_it(
    monkeypatch: pytest.MonkeyPatch,
):
    def say(n: int, t: int, contact: int, sign: float, ceiling: float) -> float:
        return -np.inf if np.isfinite(ceiling) else -4.0

    answers, found = swept(monkeypatch, two(-np.inf, 2.0), say)
    assert answers.asked[:4] == [
        (1, 0, 1.0, 7.0),
        (1, 0, 1.0, np.inf),
        (1, 0, -1.0, 7.0),
        (1, 1, 1.0, 7.0),
    ], "of the upper side a bound is known"
    assert (found.lower[1, 0], found.upper[1, 0]) == (-4.0, 2.0)


def test_where_no_program_ends_nothing_is_bounded(monkeypatch: pytest.MonkeyPatch):
    answers, found = swept(monkeypatch, two(-np.inf, np.inf), lambda *rest: -np.inf)
    assert not found.is_finite
    assert len(answers.asked) == 16, "each with the ceiling and without; no other round"


def test_time_that_is_over_leaves_what_is_known(monkeypatch: pytest.MonkeyPatch):
    clock = iter([False, False, False, True, True, True])
    answers, found = swept(
        monkeypatch, two(-1.0, 2.0), lambda *rest: -0.5, is_over=lambda: next(clock)
    )
    assert len(answers.asked) == 3
    assert (found.lower[1].tolist(), found.upper[1].tolist(), found.ceiling) == (
        [-0.5, -0.5],
        [0.5, 2.0],
        7.0,
    )
    assert not found.is_empty
