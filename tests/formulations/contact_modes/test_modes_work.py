"""How much is searched is said in work, not in seconds: the same plan whatever else the machine does."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.contact_modes.finder import FinderResult
from formulations.contact_modes.nonlinear import SceneModels
from formulations.contact_modes.session import MultiStart
from formulations.methods.mpcc import MpccOptions
from formulations.pipelines import load_method
from formulations.solution import Outcome
from formulations.transcription.compiled import CompiledModel
from formulations.transcription.method import SolveBudget
from models.catalog import load_scene
from models.codegen.kernel import load_kernel

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
        answer = SimpleNamespace(cost=10.0 - len(self.allowed), closed=load_kernel(SCENE).penetration(np.zeros((3, SCENE.nq))) > 0.0)
        return FinderResult(answer=cast(Any, answer), outcome=Outcome.SOLVED, message="")


@pytest.mark.parametrize(
    ("spends", "allowed"),
    [
        ([50.0, 25.0, 12.0, 6.5, 6.5], [50.0, 25.0, 12.5, 6.5, 6.5]),
        ([0.0, 10.0, 50.0, 20.0, 20.0], [50.0, 50.0, 45.0, 20.0, 20.0]),  # what one leaves, or takes beyond, is felt by those after it
        ([100.0], [50.0]),  # nothing is left: the others are not tried
    ],
)
def test_half_of_the_work_that_is_left_for_each_start(spends: list[float], allowed: list[float]) -> None:
    finder, budget = _Finder(spends), SolveBudget(60.0)
    budget.most_work = 100.0
    kernel = load_kernel(SCENE)
    starts = MultiStart(SCENE, kernel, cast(Any, finder), MpccOptions(), SceneModels(SCENE, kernel))
    best, attempts = starts.run(budget, range(5, 10), None)
    assert finder.allowed == allowed
    assert [attempt.number for attempt in attempts] == list(range(5, 5 + len(allowed)))
    assert best.answer.cost == 10.0 - len(allowed)


@pytest.mark.slow
def test_the_clock_decides_nothing() -> None:
    """A search cut by its work finds the same in any time; with more work it looks further."""
    found = []
    for work, time_limit in ((1.5, 600.0), (1.5, 60000.0), (0.01, 600.0)):
        with load_method("mpcc").open(SCENE, {"work": work}) as session:
            found.append(session.solve(eps=None, warm_start=None, time_limit=time_limit))
    assert found[0].outcome is Outcome.SOLVED
    assert (found[0].cost, found[0].iterations, found[0].message) == (found[1].cost, found[1].iterations, found[1].message)
    assert "as many as it may try" in found[0].message
    assert found[2].outcome is Outcome.ITERATION_LIMIT
    assert found[2].trajectory is None
    assert "within the work limit" in found[2].message


@pytest.mark.slow
def test_a_first_plan_has_less_work_than_the_search_around_it() -> None:
    """What is given up says why; what has a plan by then is searched with all of the work."""
    found = []
    for first_work in (0.01, 1.0, 1.5):
        with load_method("mpcc").open(SCENE, {"work": 1.5, "first_work": first_work}) as session:
            found.append(session.solve(eps=None, warm_start=None, time_limit=600.0))
    given_up, bounded, free = found
    assert (given_up.outcome, given_up.trajectory) == (Outcome.ITERATION_LIMIT, None)
    assert "the work limit of a first one" in given_up.message
    assert given_up.iterations < bounded.iterations
    assert (bounded.cost, bounded.iterations, bounded.message) == (free.cost, free.iterations, free.message)
