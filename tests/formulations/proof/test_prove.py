"""What a proof concludes from what SCIP and the bounds say: both answer here what a test says, with a clock that moves as a test says."""

import inspect
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import chain, repeat
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.contact_modes.linear import linear_scene
from formulations.contact_modes.quadratic import ModesProblem
from formulations.proof import (
    PairBounds,
    Proof,
    ProofStatus,
    build_miqp,
    missing_solver,
    prove,
    why_no_proof,
)
from formulations.proof.prove import GAP, is_exact, scip
from formulations.solution import Bound, Outcome
from formulations.transcription.contact import ModelError
from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from tests.formulations.proof.test_bounds import SCENE
from tests.formulations.proof.test_proof import ASKED, LITTLE, SHORT
from tests.formulations.transcription.rollouts import rolled_out

MODULE = sys.modules[prove.__module__]
# Thrown, it does not reach the wall for 6 steps of 10 ms: every pair is open, and one more is
# closed at the end.
COASTING = rolled_out(SHORT, np.zeros((9, 1)))
LIMIT = 40.0


def bounds(low: float = -1.0, high: float = 1.0, scene: Any = SHORT) -> PairBounds:
    return PairBounds(
        lower=np.full((scene.task.steps, scene.nc), low),
        upper=np.full((scene.task.steps, scene.nc), high),
        ceiling=np.inf,
    )


def result(
    bound: float, name: str = "maxTimeLimit", nodes: int = 5, closed: np.ndarray | None = None
) -> Callable[[Any], Any]:
    """What SCIP answers of a model; closed: of the plan that it found, if it did."""

    def answer(model: Any) -> Any:
        def load_vars() -> None:
            assert closed is not None
            for place, data in enumerate(model.variable_closed.values()):
                data.set_value(float(closed.ravel()[place]), skip_validation=True)

        return SimpleNamespace(
            solver_version=(9, 2, 1), extra_info={"NNodes": nodes}, objective_bound=bound,
            termination_condition=SimpleNamespace(name=name),
            incumbent_objective=None if closed is None else 1.0,
            solution_loader=SimpleNamespace(load_vars=load_vars),
        )  # fmt: skip

    return answer


@pytest.fixture
def proved(monkeypatch: pytest.MonkeyPatch):
    """proved(answers of SCIP, bounds, ..): the proof; asked: seconds that SCIP was given.

    ceilings: under which bounds were asked for.
    """

    def run(
        *answers: Callable[[Any], Any],
        pairs: PairBounds | None = None,
        limit: float = LIMIT,
        scene: Any = SHORT,
        incumbent: Any = None,
        passed: float = 0.0,
    ) -> Any:
        said, asked, ceilings = list(answers), [], []
        clock = chain([100.0], repeat(100.0 + passed))

        def solve(model: Any, seconds: float) -> Any:
            asked.append(seconds)
            return said.pop(0)(model)

        def bounded(
            scene: Any, linear: Any, ceiling: float, is_over: Callable[[], bool]
        ) -> PairBounds:
            ceilings.append(ceiling)
            assert is_over() is (limit <= passed)
            return replace(pairs or bounds(scene=scene), ceiling=ceiling)

        monkeypatch.setattr(MODULE, "scip", solve)
        monkeypatch.setattr(MODULE, "pair_bounds", bounded)
        monkeypatch.setattr(MODULE, "perf_counter", lambda: next(clock))
        monkeypatch.setattr(MODULE, "process_time", lambda: 50.0)
        found = prove(scene, incumbent=incumbent, time_limit=limit)
        assert (len(asked), found.seconds, found.cpu) == (len(answers), passed, 0.0), (
            "SCIP was meant to be asked that often"
        )
        return SimpleNamespace(proof=found, asked=asked, ceilings=ceilings)

    return run


@pytest.fixture(scope="module")
def known() -> float:
    """The cost of the optimum of the modes of coasting."""
    answer = ModesProblem(linear_scene(SHORT)).solve(
        load_kernel(SHORT).penetration(COASTING.q[:-1]) > 0.0
    )
    return answer.cost


@pytest.mark.parametrize(
    ("part", "status"),
    [(0.5, ProofStatus.OPTIMAL), (2.0, ProofStatus.BOUND), (-9.0, ProofStatus.OPTIMAL)],
)
def test_a_bound_within_the_gap_proves_the_plan_that_is_known(
    proved, known: float, part: float, status: ProofStatus
):
    found = proved(result(known - part * GAP * max(known, 1.0)), incumbent=COASTING)
    assert found.proof.status is status
    assert found.proof.cost == pytest.approx(known, rel=1e-9)
    assert found.proof.bound == pytest.approx(
        min(known - part * GAP * max(known, 1.0), found.proof.cost), rel=1e-12
    )
    assert found.proof.bound <= found.proof.cost
    assert (found.asked, found.proof.nodes, found.proof.trouble) == ([LIMIT], 5, "")
    assert found.ceilings == [pytest.approx(found.proof.cost * (1.0 + 1e-5), rel=1e-12)]
    assert found.proof.solver.startswith("SCIP 9.2.1, Clarabel ")


@pytest.mark.parametrize("said", ["infeasible", "provenInfeasible"])
def test_no_plan_where_one_is_known_proves_nothing(proved, said: str):
    found = proved(result(0.0, said), incumbent=COASTING).proof
    assert (found.status, found.bound) == (ProofStatus.BOUND, -np.inf)
    assert "rounding" in found.sentence
    assert "bound " not in found.sentence.partition("nodes")[2]
    empty = proved(pairs=replace(bounds(), is_empty=True), incumbent=COASTING).proof
    assert (empty.status, "rounding" in empty.sentence) == (ProofStatus.BOUND, True)


def test_no_plan_where_none_is_known_is_a_proof(proved):
    for found in (
        proved(result(0.0, "infeasible")),
        proved(pairs=replace(bounds(), is_empty=True)),
    ):
        assert (found.proof.status, found.proof.bound, found.proof.plan, found.proof.cost) == (
            ProofStatus.INFEASIBLE,
            np.inf,
            None,
            None,
        )
        assert (found.proof.outcome, found.proof.known_bound, found.ceilings) == (
            Outcome.INFEASIBLE,
            None,
            [np.inf],
        )


def test_what_goes_wrong_in_scip_is_said_and_proves_nothing(proved):
    def broken(_: Any) -> Any:
        raise Exception("it lost its way")

    found = proved(broken, incumbent=COASTING).proof
    assert (found.status, found.bound, found.nodes) == (ProofStatus.BOUND, -np.inf, 0)
    assert "it lost its way" in found.sentence
    assert found.solver.startswith("Clarabel")


def test_without_a_plan_a_tenth_of_the_time_looks_for_one(proved, known: float):
    """Its plan tightens the bounds, and the better of both bounds counts.

    Its nodes are those of both.
    """
    modes = load_kernel(SHORT).penetration(COASTING.q[:-1]) > 0.0
    for first, second in ((0.25, 0.5), (0.5, 0.25)):
        found = proved(
            result(first * known, closed=modes, nodes=3), result(second * known, nodes=4)
        )
        assert found.proof.cost == pytest.approx(known, rel=1e-9)
        assert (found.proof.status, found.proof.bound) == (
            ProofStatus.BOUND,
            pytest.approx(0.5 * known),
        )
        assert (found.asked, found.proof.nodes) == ([pytest.approx(0.1 * LIMIT), LIMIT], 7)
        assert found.ceilings == [np.inf, pytest.approx(found.proof.cost * (1.0 + 1e-5), rel=1e-12)]


def test_a_first_plan_that_is_proved_is_asked_no_more_of(proved, known: float):
    modes = load_kernel(SHORT).penetration(COASTING.q[:-1]) > 0.0
    found = proved(result(known, closed=modes))
    assert (found.proof.status, found.ceilings) == (ProofStatus.OPTIMAL, [np.inf])


def test_without_any_plan_the_rest_of_the_time_goes_on(proved):
    found = proved(result(-np.inf), result(-2.0))
    assert (found.proof.status, found.proof.bound, found.proof.plan) == (
        ProofStatus.BOUND,
        -2.0,
        None,
    )
    assert (found.asked, found.ceilings) == ([pytest.approx(0.1 * LIMIT), LIMIT], [np.inf])
    nothing = proved(result(-np.inf), result(-np.inf)).proof
    assert (nothing.status, nothing.outcome, nothing.gap, nothing.known_bound) == (
        ProofStatus.NOTHING,
        Outcome.TIME_LIMIT,
        None,
        None,
    )


@pytest.mark.parametrize("incumbent", [None, COASTING])
def test_neither_time_that_is_over_nor_endless_bounds_ask_scip(proved, incumbent: Any):
    for found in (
        proved(limit=0.0, incumbent=incumbent),
        proved(pairs=bounds(high=np.inf), incumbent=incumbent),
    ):
        assert (found.asked, found.proof.bound) == ([], -np.inf)


def test_half_a_second_is_time_and_ten_minutes_are_what_is_given_unasked(proved):
    assert proved(result(-1.0), result(-2.0), limit=0.5).asked == [pytest.approx(0.05), 0.5]
    assert inspect.signature(prove).parameters["time_limit"].default == 600.0


def test_time_that_has_passed_is_not_left(proved):
    assert proved(result(-1.0), incumbent=COASTING, passed=15.0).asked == [LIMIT - 15.0]
    assert proved(incumbent=COASTING, passed=LIMIT).asked == []


@pytest.mark.parametrize(("part", "status"), [(0.5, ProofStatus.OPTIMAL), (2.0, ProofStatus.BOUND)])
def test_a_cost_below_nought_has_its_ceiling_above_and_its_gap_below(
    proved, known: float, part: float, status: ProofStatus
):
    scene = SHORT.with_task(running_cost=SHORT.task.running_cost - 100)
    cost = known - 900.0
    found = proved(result(cost - part * GAP * abs(cost)), scene=scene, incumbent=COASTING)
    assert found.proof.cost == pytest.approx(cost, rel=1e-9)
    assert found.proof.status is status
    assert found.ceilings == [pytest.approx(cost + 1e-5 * abs(cost), rel=1e-9)]


@pytest.mark.parametrize(("part", "status"), [(0.9, ProofStatus.OPTIMAL), (1.5, ProofStatus.BOUND)])
def test_a_cost_below_one_has_the_gap_of_one(
    proved, known: float, part: float, status: ProofStatus
):
    """Nine steps are paid for; the cost is shifted to 0.4."""
    scene = SHORT.with_task(running_cost=SHORT.task.running_cost - (known - 0.4) / 9)
    found = proved(result(0.4 - part * GAP), scene=scene, incumbent=COASTING)
    assert found.proof.cost == pytest.approx(0.4, abs=1e-9)
    assert found.proof.status is status


EXACT_NAMES = (
    "dynamics_defect",
    "start_error",
    "input_bound_excess",
    "velocity_bound_excess",
    "force_sign",
    "complementarity",
)


@pytest.mark.parametrize("name", EXACT_NAMES)
@pytest.mark.parametrize(
    ("value", "counts"), [(0.0, True), (1e-8, True), (1.01e-8, False), (np.nan, False)]
)
def test_a_plan_counts_up_to_a_residual_of_1e_minus_8(
    name: str, value: float, counts: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(
        MODULE,
        "PlanResiduals",
        lambda scene: SimpleNamespace(of=lambda plan: {name: value, "cost": 9.0}),
    )
    assert is_exact(SHORT, COASTING) is counts


@pytest.mark.parametrize(("miss", "counts"), [(0.99e-8, True), (1.01e-8, False)])
def test_a_plan_counts_if_it_ends_where_it_must(
    miss: float, counts: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(MODULE, "PlanResiduals", lambda scene: SimpleNamespace(of=lambda plan: {}))
    goal = (float(COASTING.q[-1, 0]) + miss, None)
    assert is_exact(ASKED.with_task(goal=goal), COASTING) is counts


def test_a_worse_plan_is_not_taken(proved, known: float):
    """SCIP offers the modes of a wall that pushes from the start, which no cheap plan has."""
    modes = np.ones((9, 1), dtype=bool)
    found = proved(result(0.5 * known, closed=modes), incumbent=COASTING).proof
    assert found.cost == pytest.approx(known, rel=1e-9)


def test_where_one_choice_of_modes_is_left_its_optimum_is_the_answer(proved):
    free = SHORT.with_task(start=(-0.05, 0.1))
    open_ = ModesProblem(linear_scene(free)).solve(np.zeros((9, 1), dtype=bool))
    found = proved(pairs=bounds(high=-0.01, scene=free), scene=free)
    assert (found.proof.status, found.asked) == (ProofStatus.OPTIMAL, [])
    assert (found.proof.cost, found.proof.bound) == (
        pytest.approx(open_.cost, rel=1e-9),
        pytest.approx(open_.cost, rel=1e-9),
    )
    assert (found.proof.pairs, found.proof.binaries) == (8, 0)
    for low in (0.01, 0.0):  # it starts away from the wall, and cannot be open
        impossible = proved(pairs=bounds(low=low, scene=free), scene=free).proof
        assert (impossible.status, impossible.bound) == (ProofStatus.INFEASIBLE, np.inf)


def test_decisions_are_those_after_the_start(proved):
    pairs = bounds()
    pairs.upper[2:4] = -0.5
    found = proved(result(0.0), pairs=pairs, incumbent=COASTING).proof
    assert (found.pairs, found.binaries) == (8, 6)


def proof(**changes: Any) -> Proof:
    said = {
        "status": ProofStatus.BOUND, "plan": COASTING, "cost": 8.0, "bound": 6.0, "seconds": 1.0,
        "cpu": 2.0, "nodes": 3, "binaries": 4, "pairs": 5,
        "solver": "SCIP", "trouble": " It stumbled.",
    }  # fmt: skip
    return Proof(**(said | changes))


@pytest.mark.parametrize(
    ("cost", "bound", "gap"),
    [
        (8.0, 6.0, 0.25),
        (-8.0, -10.0, 0.25),
        (0.0, -1e-12, 1.0),
        (8.0, 9.0, 0.0),
        (None, 6.0, None),
        (8.0, -np.inf, np.inf),
    ],
)
def test_the_gap_is_relative_to_the_cost(cost: float | None, bound: float, gap: float | None):
    assert proof(cost=cost, bound=bound).gap == (None if gap is None else pytest.approx(gap))


def test_a_bound_says_each_of_its_numbers():
    assert proof().known_bound == Bound(
        value=6.0, gap=0.25, proved=False, decisions=5, open_decisions=4, nodes=3
    )
    assert proof(status=ProofStatus.OPTIMAL).known_bound == replace(
        proof().known_bound, proved=True
    )
    assert proof(bound=np.inf).known_bound is proof(bound=-np.inf).known_bound is None
    words = proof().sentence
    for part in (
        ProofStatus.BOUND.value,
        "It stumbled.",
        "5 contact decisions",
        "4 of them",
        "3 nodes",
        "bound 6.",
    ):
        assert part in words
    outcomes = {status: proof(status=status).outcome for status in ProofStatus}
    assert outcomes == {
        ProofStatus.OPTIMAL: Outcome.SOLVED, ProofStatus.BOUND: Outcome.TIME_LIMIT,
        ProofStatus.INFEASIBLE: Outcome.INFEASIBLE,
        ProofStatus.NOTHING: Outcome.TIME_LIMIT,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("given", "asked"), [(12.5, 12.5), (1e-3, 1e-3), (0.0, 1e-3), (-1.0, 1e-3)]
)
def test_scip_is_silent_and_has_the_time_that_is_left(
    monkeypatch: pytest.MonkeyPatch, given: float, asked: float
):
    calls = []
    solver = SimpleNamespace(solve=lambda model, **options: calls.append((model, options)))
    monkeypatch.setattr(
        MODULE, "SolverFactory", lambda name: solver if name == "scip_direct" else None
    )
    scip("model", given)
    ((model, options),) = calls
    assert model == "model"
    assert options["solver_options"] == {
        "display/verblevel": 0,
        "limits/time": asked,
        "limits/gap": pytest.approx(1e-7),
    }
    assert (options["load_solutions"], options["raise_exception_on_nonoptimal_result"]) == (
        False,
        False,
    )


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("transport", "has friction"),
        ("damped_collision", "has damped contacts"),
        ("wall_pendulum", None),
    ],
)
def test_why_there_is_no_proof(name: str, why: str | None):
    found = why_no_proof(load_scene(name))
    assert found is None if why is None else why in str(found) and name in str(found)
    assert "a proof needs a linear scene" in str(why_no_proof(load_scene("two_discs")))


@pytest.mark.parametrize(("low", "high"), [(-0.75, 0.5), (0.25, 0.5), (-0.75, -0.25)])
@pytest.mark.parametrize("scene", [SHORT, LITTLE], ids=["one contact", "two contacts"])
def test_the_pairs_of_the_program_are_those_of_the_contact_law(scene: Any, low: float, high: float):
    """At a motion with a contact that closes: its own mode fits with nothing to spare, the other does not, and each side has its bound."""
    push = np.full((scene.task.steps, scene.nu), 1.0 if scene is SHORT else 12.0)
    plan = rolled_out(scene, push)
    phi, k = load_kernel(scene).penetration(plan.q[:-1]), 100.0 if scene is SHORT else 30.0
    assert (phi[1:] > 0.0).any()
    assert (phi[1:] < 0.0).any()
    pairs = replace(bounds(low, high, scene), ceiling=1234.5)
    deepest, farthest = max(high, 0.0), -min(low, 0.0)
    model: Any = build_miqp(scene, pairs)
    assert model.variable_cost.ub == 1234.5
    assert model.variable_cost.lb is None
    for place, t in enumerate(model.set_steps):
        for column, name in enumerate(model.set_coordinates):
            model.variable_q[t, name].set_value(plan.q[place, column], skip_validation=True)
        for contact, name in enumerate(model.set_contacts):
            model.variable_lam[t, name].set_value(plan.lam[place, contact], skip_validation=True)
            assert model.variable_lam[t, name].ub == pytest.approx(deepest * k)
    rows = list(model.constraint_pair.values())
    assert len(rows) == 3 * phi.size
    for closed in (0, 1):
        for data in model.variable_closed.values():
            data.set_value(closed, skip_validation=True)
        for place, depth in enumerate(phi.ravel()):
            pushes, stays, opens = rows[3 * place : 3 * place + 3]
            gap = max(-k * depth, 0.0)
            assert (pushes.slack(), stays.slack()) == pytest.approx(
                (deepest * k * closed - k * max(depth, 0.0), gap), abs=1e-9
            )
            assert opens.slack() == pytest.approx(farthest * k * (1 - closed) - gap, abs=1e-9)


def test_what_is_decided_is_fixed_and_an_endless_ceiling_is_none():
    pairs = bounds()
    pairs.lower[1:5, 0], pairs.upper[1:5, 0] = (0.25, 0.0, 0.0, -0.5), (0.5, 0.5, 0.0, 0.0)
    model: Any = build_miqp(SHORT, pairs)
    assert [(data.fixed, data.value) for data in model.variable_closed.values()][:6] == [
        (False, None), (True, 1), (True, 1), (True, 0), (True, 0), (False, None),
    ]  # fmt: skip
    assert model.variable_cost.ub is None
    assert [
        bool(item.active)
        for item in (model.objective_cost, model.objective_bound, model.complementarity_contact)
    ] == [
        False,
        True,
        False,
    ]
    for data in (
        *model.variable_q.values(),
        *model.variable_v.values(),
        *model.variable_u.values(),
    ):
        data.set_value(0.5)
    paid = pyo.value(model.expression_cost)
    model.variable_cost.set_value(paid + 0.25)
    assert (model.constraint_cost.slack(), pyo.value(model.objective_bound)) == (
        pytest.approx(0.25),
        pytest.approx(paid + 0.25),
    )


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_without_bounds_there_is_no_program(side: str):
    pairs = bounds()
    getattr(pairs, side)[3, 0] = -np.inf if side == "lower" else np.inf
    with pytest.raises(ModelError, match="no finite bound"):
        build_miqp(SHORT, pairs)


def test_a_scene_without_contacts_has_no_pairs():
    scene = load_scene(str(Path(__file__).parents[2] / "scenes" / "oscillator.py")).with_task(
        steps=5
    )
    model: Any = build_miqp(
        scene, PairBounds(lower=np.zeros((5, 0)), upper=np.zeros((5, 0)), ceiling=1.0)
    )
    assert not hasattr(model, "variable_closed")


def test_a_scene_without_parameters_has_its_pairs_too():
    steps = SCENE.task.steps
    model: Any = build_miqp(
        SCENE,
        PairBounds(lower=np.full((steps, 1), -1.0), upper=np.full((steps, 1), 2.0), ceiling=1.0),
    )
    assert model.variable_lam[1, "pair"].ub == 1.5, "k = 3/4"


def test_what_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch):
    assert missing_solver() is None
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "pip install pyscipopt" in str(missing_solver())
