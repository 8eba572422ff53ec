"""Mode sequences: their moves, and a search that ends where no neighbour is cheaper.

How much is searched is said in work, not in seconds: the same plan whatever else the machine does.
"""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pyomo.environ as pyo
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formulations.contact_modes.finder import FinderResult
from formulations.contact_modes.nonlinear import SceneModels
from formulations.contact_modes.search import (
    add,
    closed_steps,
    drop,
    fewer,
    flip_wrong_signs,
    merge,
    mode_sequence,
    onwards,
    rearrangements,
    repetitions,
    search_sequences,
    shift,
    shifts,
    split,
)
from formulations.contact_modes.session import MultiStart
from formulations.methods.mpcc import MpccOptions
from formulations.pipelines import solve_scene
from formulations.solution import Outcome
from formulations.transcription.compiled import CompiledModel
from formulations.transcription.method import SolveBudget
from models.catalog import load_scene
from models.codegen.kernel import load_kernel

STEPS = 40
modes = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=STEPS, max_size=STEPS).map(
    lambda rows: np.array(rows)
)


@pytest.mark.slow
@given(closed=modes)
@settings(deadline=None, max_examples=50)
def test_intervals_and_closed_steps_say_the_same(closed: np.ndarray) -> None:
    assert np.array_equal(closed_steps(mode_sequence(closed), STEPS), closed)


@pytest.mark.slow
@given(closed=modes, stride=st.integers(1, 5), seed=st.integers(0, 99))
@settings(deadline=None, max_examples=50)
def test_every_move_leads_to_another_sequence(closed: np.ndarray, stride: int, seed: int) -> None:
    sequence, phi = mode_sequence(closed), np.random.default_rng(seed).normal(size=(STEPS, 2))
    for move in (*shifts(sequence, stride), *rearrangements(sequence, phi), *fewer(sequence)):
        moved = move.apply(sequence, STEPS)
        if moved is not None:
            assert moved != sequence
            assert mode_sequence(closed_steps(moved, STEPS)) == moved, (
                "no interval is empty, none adjoin"
            )


def test_moves_do_what_they_say() -> None:
    sequence = (((5, 10), (20, 30)), ())
    assert shift(contact=0, index=0, first=-2).apply(sequence, STEPS) == (((3, 10), (20, 30)), ())
    assert shift(contact=0, index=1, stop=3).apply(sequence, STEPS) == (((5, 10), (20, 33)), ())
    assert shift(contact=0, index=0, first=4, stop=4).apply(sequence, STEPS) == (
        ((9, 14), (20, 30)),
        (),
    )
    assert merge(contact=0, index=0).apply(sequence, STEPS) == (((5, 30),), ())
    assert split(contact=0, index=1, first=24, stop=26).apply(sequence, STEPS) == (
        ((5, 10), (20, 24), (26, 30)),
        (),
    )
    assert drop(contact=0, index=0).apply(sequence, STEPS) == (((20, 30),), ())
    assert add(contact=1, first=0, stop=1).apply(sequence, STEPS) == (
        ((5, 10), (20, 30)),
        ((0, 1),),
    )


@pytest.mark.parametrize("move", [
    shift(contact=0, index=0, stop=-5),  # empty
    shift(contact=0, index=0, stop=10),  # adjoins the next
    shift(contact=0, index=0, first=-6),  # before the beginning
    shift(contact=0, index=1, stop=11),  # after the end
    shift(contact=0, index=0, first=12, stop=12),  # overlaps
    shift(contact=0, index=2, first=1),
    merge(contact=0, index=1),
    split(contact=0, index=0, first=5, stop=6),  # at the edge
    drop(contact=1, index=0),
    add(contact=0, first=8, stop=12),
])  # fmt: skip
def test_impossible_moves_give_nothing(move) -> None:
    assert move.apply((((5, 10), (20, 30)), ()), STEPS) is None


@dataclass(frozen=True)
class Plan:
    closed: np.ndarray
    cost: float
    phi: np.ndarray
    biactive_multiplier: np.ndarray


class Landscape:
    """A cost of modes by hand: how many steps differ from a target.

    Modes that close contact 1 at step 0 have no plan.
    """

    def __init__(self, target: np.ndarray) -> None:
        self.target, self.asked = target, 0

    def plan(self, closed: np.ndarray) -> Plan:
        return Plan(
            closed,
            float((closed != self.target).sum()),
            np.where(self.target, 1.0, -1.0) - 0.01 * closed,
            np.zeros(closed.shape),
        )

    def improve(self, closed: np.ndarray, _near: Plan, below: float) -> Plan | None:
        self.asked += 1
        plan = self.plan(closed)
        return plan if plan.cost < below else None


@pytest.mark.parametrize(("start", "target"), [
    ((((3, 8),), ((30, 35),)), (((11, 20),), ((22, 36),))),  # shifts
    ((((10, 20),), ()), (((10, 14), (16, 20)), ((5, 8),))),  # a split and a new interval
    ((((10, 14), (16, 20)), ((5, 6),)), (((10, 20),), ())),  # a merge and a drop
])  # fmt: skip
def test_the_search_reaches_the_target(start, target) -> None:
    landscape = Landscape(closed_steps(target, STEPS))
    found = search_sequences(
        landscape.plan(closed_steps(start, STEPS)),
        landscape.improve,
        stride=4,
        is_over=lambda: False,
    )
    assert found.complete
    assert mode_sequence(found.best.closed) == target
    assert found.tried == landscape.asked
    around = (*shifts(target, 1), *rearrangements(target, found.best.phi))
    moved = [neighbour for move in around if (neighbour := move.apply(target, STEPS)) is not None]
    assert all(landscape.plan(closed_steps(neighbour, STEPS)).cost > 0 for neighbour in moved)


class WithMultipliers(Landscape):
    """The same with multipliers: every wrong mode says so."""

    def plan(self, closed: np.ndarray) -> Plan:
        plan = super().plan(closed)
        return Plan(plan.closed, plan.cost, plan.phi, np.where(closed != self.target, -1.0, 0.0))


def test_multipliers_lead_to_the_target_at_once() -> None:
    target = closed_steps((((11, 20), (25, 27)), ((22, 36),)), STEPS)
    landscape = WithMultipliers(target)
    found = search_sequences(
        landscape.plan(closed_steps((((3, 8),), ((30, 35),)), STEPS)),
        landscape.improve,
        stride=4,
        is_over=lambda: landscape.asked >= 1,
    )
    assert found.tried == 1
    assert np.array_equal(found.best.closed, target)


def test_intervals_are_repeated_where_the_contact_is_open() -> None:
    sequence = (((50, 60),), ())
    moves = list(repetitions(sequence, 100))
    found = [move.apply(sequence, 100) for move in moves]
    assert all(moved is not None and sum(len(row) for row in moved) == 2 for moved in found)
    assert {move.contact for move in moves} == {0, 1}
    assert add(contact=0, first=70, stop=80).apply(sequence, 100) in found
    assert add(contact=0, first=20, stop=30).apply(sequence, 100) in found


def test_the_search_repeats_an_interval() -> None:
    """No small move helps on the way: one interval more is worth something only where it is."""
    target = closed_steps((((30, 36), (60, 66)), ()), 150)

    class Far(Landscape):
        def plan(self, closed: np.ndarray) -> Plan:
            second = bool(closed[60:66, 0].all())
            return Plan(
                closed,
                10.0 - 5.0 * second + float((closed != target).sum()) * (0.01 if second else 1.0),
                np.zeros(closed.shape),
                np.zeros(closed.shape),
            )  # fmt: skip

    landscape = Far(target)
    found = search_sequences(
        landscape.plan(closed_steps((((30, 36),), ()), 150)),
        landscape.improve,
        stride=4,
        is_over=lambda: False,
    )
    assert mode_sequence(found.best.closed) == (((30, 36), (60, 66)), ())


def test_a_search_out_of_time_says_so() -> None:
    landscape = Landscape(closed_steps((((11, 20),), ()), STEPS))
    found = search_sequences(
        landscape.plan(closed_steps((((3, 8),), ()), STEPS)),
        landscape.improve,
        stride=4,
        is_over=lambda: landscape.asked >= 2,
    )
    assert not found.complete
    assert found.tried >= 2


def test_ends_move_on_as_they_went() -> None:
    before, after = (((5, 10), (20, 30)), ((3, 6),)), (((6, 12), (19, 30)), ((3, 6),))
    assert onwards(before, after, 1, STEPS) == (((7, 14), (18, 30)), ((3, 6),))
    assert onwards(before, after, 3, STEPS) is None, "the intervals would overlap"
    assert onwards(before, (((6, 12),), ((3, 6),)), 1, STEPS) is None, "an interval less"


def test_wrong_signs_are_followed_in_growing_strides() -> None:
    """A biactive_multiplier only speaks of the next step.

    100 steps away takes far fewer than 100 plans.
    """
    target = closed_steps((((111, 120),),), 150)

    class Slope(Landscape):
        def plan(self, closed: np.ndarray) -> Plan:
            ((first, stop),) = mode_sequence(closed)[0]
            multiplier = np.zeros(closed.shape)
            multiplier[first if first < 111 else first - 1, 0] = -1.0 * (first != 111)
            multiplier[stop if stop < 120 else stop - 1, 0] = -1.0 * (stop != 120)
            return Plan(
                closed, abs(first - 111.0) + abs(stop - 120.0), np.zeros(closed.shape), multiplier
            )

    landscape = Slope(target)
    found = flip_wrong_signs(
        landscape.plan(closed_steps((((11, 20),),), 150)), landscape.improve, is_over=lambda: False
    )
    assert found.complete
    assert found.best.cost == 0.0
    assert landscape.asked <= 40


def test_the_search_takes_a_detour_to_fewer_intervals() -> None:
    """Two intervals are where no move helps; one alone is dearer there, but cheaper elsewhere."""
    target = closed_steps((((60, 66),), ()), 150)

    class Family(Landscape):
        def plan(self, closed: np.ndarray) -> Plan:
            row = mode_sequence(closed)[0]
            two = ((30, 36), (90, 96))
            cost = 1e3
            if len(row) == 1:
                cost = 1.0 + abs(row[0][0] - 60) + abs(row[0][1] - 66)
            elif len(row) == 2:
                cost = 5.0 + sum(
                    abs(a - b)
                    for mine, its in zip(row, two, strict=True)
                    for a, b in zip(mine, its, strict=True)
                )
            return Plan(
                closed,
                cost + 50.0 * len(mode_sequence(closed)[1]),
                np.zeros(closed.shape),
                np.zeros(closed.shape),
            )

    landscape = Family(target)
    found = search_sequences(
        landscape.plan(closed_steps((((32, 38), (90, 97)), ()), 150)),
        landscape.improve,
        stride=2,
        is_over=lambda: False,
    )
    assert found.complete
    assert mode_sequence(found.best.closed) == (((60, 66),), ())
    near = search_sequences(
        landscape.plan(closed_steps((((32, 38), (90, 97)), ()), 150)),
        landscape.improve,
        stride=2,
        is_over=lambda: False,
        far=False,
    )
    assert near.best.cost == 5.0


def pushes(closed: np.ndarray) -> Plan:
    """One push costs 10 at (30, 36).

    Two cost 10.4 beside a second contact at (60, 66), and 6 where that has moved on to (80, 86).
    """
    left, right = mode_sequence(closed)
    cost = 1e3
    if len(right) == 1 and len(left) in (1, 2):
        place = 60 if len(left) == 1 else 80
        base = 10.0 if len(left) == 1 else 6.0
        cost = (
            base
            + 0.22 * abs(right[0][0] - place) / 2
            + 0.22 * abs(right[0][1] - place - 6) / 2
            + 5.0 * (left[0] != (30, 36))
        )
        cost += (
            0.001 * abs(left[-1][0] - 45) + 0.001 * abs(left[-1][1] - 51) if len(left) == 2 else 0.0
        )
    return Plan(closed, cost, np.zeros(closed.shape), np.zeros(closed.shape))


def test_the_search_takes_a_detour_to_more_intervals() -> None:
    """A repetition is dearer until the other contact has moved.

    What it leads to is cheaper than where the search stood.
    """
    asked: list[float] = []

    def improve(closed: np.ndarray, _near: Plan, below: float) -> Plan | None:
        plan = pushes(closed)
        asked.append(plan.cost)
        return plan if plan.cost < below else None

    one = pushes(closed_steps((((30, 36),), ((60, 66),)), 150))
    assert one.cost == 10.0
    assert (
        min(
            pushes(closed_steps(moved, 150)).cost
            for move in repetitions(mode_sequence(one.closed), 150)
            if (moved := move.apply(mode_sequence(one.closed), 150))
        )
        > 10.0
    )
    found = search_sequences(one, improve, stride=2, is_over=lambda: False)
    assert found.complete
    assert mode_sequence(found.best.closed) == (((30, 36), (45, 51)), ((80, 86),))
    assert found.tried == len(asked)


def test_detours_keep_to_what_may_be_tried() -> None:
    asked: list[float] = []

    def improve(closed: np.ndarray, _near: Plan, below: float) -> Plan | None:
        asked.append(below)
        plan = pushes(closed)
        return plan if plan.cost < below else None

    one = pushes(closed_steps((((30, 36),), ((60, 66),)), 150))
    found = search_sequences(one, improve, stride=2, is_over=lambda: len(asked) >= 30)
    assert not found.complete
    assert len(asked) == 30


SCENE = load_scene("cart_pole_walls")


def _rosenbrock() -> pyo.ConcreteModel:
    model: Any = pyo.ConcreteModel()
    model.x, model.y = pyo.Var(initialize=-1.2), pyo.Var(initialize=1.0)
    model.cost = pyo.Objective(expr=100 * (model.y - model.x**2) ** 2 + (1 - model.x) ** 2)
    return model


def test_ipopt_stops_at_the_work_that_is_left() -> None:
    """Three nonzeros: the lower triangle of the Hessian."""
    free, bound = SolveBudget(60.0), SolveBudget(60.0)
    CompiledModel(_rosenbrock()).run(free, {"max_iter": 100})
    assert free.iterations > 10
    assert free.work == 3 * free.iterations
    bound.most_work = 3 * 7 + 1
    compiled = CompiledModel(_rosenbrock())
    assert not bound.is_over
    result = compiled.run(bound, {"max_iter": 100})
    assert bound.iterations == result.iterations == 8
    assert bound.iterations_left(compiled.problem(bound)) == 0
    assert not bound.is_late
    assert compiled.run(bound, {"max_iter": 100}).iterations == 0


class _Finder:
    """Spends what it is told, start by start, and notes how much it was allowed."""

    def __init__(self, spends: list[float]) -> None:
        self._spends, self.allowed = spends, []

    def find(self, budget: SolveBudget, _modes_of: Any, _start: Any) -> FinderResult:
        self.allowed.append(budget.most_work - budget.work)
        budget.work += self._spends[len(self.allowed) - 1]
        answer = SimpleNamespace(
            cost=10.0 - len(self.allowed),
            closed=load_kernel(SCENE).penetration(np.zeros((3, SCENE.nq))) > 0.0,
        )
        return FinderResult(answer=cast(Any, answer), outcome=Outcome.SOLVED, message="")


@pytest.mark.parametrize(("spends", "allowed"), [
    ([50.0, 25.0, 12.0, 6.5, 6.5], [50.0, 25.0, 12.5, 6.5, 6.5]),
    ([0.0, 10.0, 50.0, 20.0, 20.0],
     [50.0, 50.0, 45.0, 20.0, 20.0]),  # what one leaves, or takes beyond, is felt by those after it
    ([100.0], [50.0]),  # nothing is left: the others are not tried
])  # fmt: skip
def test_half_of_the_work_that_is_left_for_each_start(
    spends: list[float], allowed: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MultiStart, "_start", lambda *_: ("", None, False))
    finder, budget = _Finder(spends), SolveBudget(60.0)
    budget.most_work = 100.0
    kernel = load_kernel(SCENE)
    models = SceneModels(SCENE, kernel)
    starts = MultiStart(models, cast(Any, finder), MpccOptions(starts=5))
    best, attempts = starts.run(budget, None)
    assert finder.allowed == allowed
    assert len(attempts) == len(allowed)
    assert best.answer.cost == 10.0 - len(allowed)


@pytest.mark.slow
def test_the_clock_decides_nothing() -> None:
    """A search cut by its work finds the same in any time; with more work it looks further."""
    found = []
    for work, time_limit in ((1.5, 600.0), (1.5, 60000.0), (0.01, 600.0)):
        found.append(solve_scene(SCENE, "mpcc", options={"work": work}, time_limit=time_limit))
    assert found[0].outcome is Outcome.SOLVED
    assert (found[0].cost, found[0].iterations, found[0].message) == (
        found[1].cost,
        found[1].iterations,
        found[1].message,
    )
    assert "as many as it may try" in found[0].message
    assert found[2].outcome is Outcome.ITERATION_LIMIT
    assert found[2].trajectory is None
    assert "within the work limit" in found[2].message


@pytest.mark.slow
def test_a_first_plan_has_less_work_than_the_search_around_it() -> None:
    """What is given up says why; what has a plan by then is searched with all of the work."""
    found = []
    for first_work in (0.01, 1.0, 1.5):
        found.append(solve_scene(SCENE, "mpcc", options={"work": 1.5, "first_work": first_work}))
    given_up, bounded, free = found
    assert (given_up.outcome, given_up.trajectory) == (Outcome.ITERATION_LIMIT, None)
    assert "the work limit of a first one" in given_up.message
    assert given_up.iterations < bounded.iterations
    assert (bounded.cost, bounded.iterations, bounded.message) == (
        free.cost,
        free.iterations,
        free.message,
    )
