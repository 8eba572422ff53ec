"""The replay's own error, from runs made by hand whose differences are known."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from wording import unsaid

from validate.judge.replay import Difference, Replay, ReplayError, ReplayOutcome
from validate.judge.replay import error_estimate as module
from validate.judge.replay.error_estimate import (
    all_the_same,
    converged,
    difference,
    estimate,
    larger,
    largest_difference,
    overlooked,
    with_max_step,
    with_steps_of,
)
from validate.judge.replay.job import Job, Simulated
from validate.judge.replay.result import Run
from validate.judge.replay.subject import (
    ForeignContact,
    ForeignCoordinate,
    ForeignModel,
    ForeignTask,
)
from validate.judge.replay.wiring import ENERGIES, Variables

SIGNS = pytest.mark.parametrize("sign", [1.0, -1.0])


def still(nodes: int = 4, contacts: int = 3) -> Any:
    return SimpleNamespace(
        q=np.full((nodes, 2), 2.0), v=np.zeros((nodes, 2)), gap=np.ones((nodes, contacts))
    )


@SIGNS
def test_a_difference_is_the_largest_of_one_coordinate_one_node_and_one_gap(sign: float):
    """At node 1 the state is 0.3 and 0.4 off, at node 2 one coordinate 0.35; the gap elsewhere."""
    one, other = still(), still()
    other.q[1, 1] += sign * 0.3
    other.v[1, 0] -= sign * 0.4
    other.q[2, 0] += sign * 0.35
    other.gap[3, 2] -= sign * 0.07
    expected = Difference(
        position=pytest.approx(0.35), state=pytest.approx(0.5), gap=pytest.approx(0.07)
    )
    assert difference(one, other) == expected
    assert difference(other, one) == expected
    assert difference(one, one) == Difference(position=0.0, state=0.0, gap=0.0)
    assert difference(None, other) is difference(one, None) is None
    assert difference(still(contacts=0), still(contacts=0)) == Difference(
        position=0.0, state=0.0, gap=0.0
    )


@SIGNS
def test_runs_are_the_same_if_they_differ_by_no_more_than_rounding(sign: float):
    one, other = still(), still()
    assert all_the_same([one, other, one])
    other.v[2, 1] = sign * 1e-10  # of a motion of 2
    assert all_the_same([one, one, other])
    other.v[2, 1] = sign * 3e-10
    assert not all_the_same([one, one, other])


def at(*places: float) -> list[Any]:
    """Runs that differ in where they end."""
    runs = [still() for _ in places]
    for run, place in zip(runs, places, strict=True):
        run.q[3, 1] += place
    return runs


def test_the_largest_difference_is_of_any_two_runs():
    """Opposite errors do not hide each other: the second and the third run differ most."""
    found = largest_difference(at(0.0, 0.3, -0.2, 0.1))
    assert found == Difference(
        position=pytest.approx(0.5), state=pytest.approx(0.5), gap=pytest.approx(0.0)
    )
    assert largest_difference(at(0.0)) is None


@pytest.mark.parametrize(
    ("places", "heeds", "comes_together"),
    [
        ((1.0, 0.5, 0.33, 0.2), False, True),  # of first order, steps divided by 1, 2, 3, 5
        ((0.0, 1.0, 0.5, 0.33, 0.2), False, True),  # the first of five is too coarse to count
        ((0.4, 0.1, 0.9, 0.2), False, False),  # to and fro
        ((0.0, 0.1, 0.25, 0.45), False, False),  # ever farther
        ((1.0, 1.0, 0.93, 1.0), False, False),  # whole inner steps and a remainder
        ((1.0, 0.5, 0.33), False, False),  # three tell nothing
        ((0.0, 0.0, 0.0, 0.0), False, False),  # a step of its own
        ((0.0, 0.0, 0.0, 0.0), True, True),  # the step that it is known to take: no error
    ],
)
def test_results_come_together_where_three_finer_differ_by_less(
    places: tuple[float, ...], heeds: bool, comes_together: bool
):
    assert converged(at(*places), heeds=heeds) is comes_together


def test_the_larger_of_two_is_taken_entry_by_entry():
    one, other = (
        Difference(position=1.0, state=5.0, gap=2.0),
        Difference(position=3.0, state=4.0, gap=6.0),
    )
    assert larger(one, other) == larger(other, one) == Difference(position=3.0, state=5.0, gap=6.0)
    assert larger(one, None) is larger(None, one) is one
    assert larger(None, None) is None


def of(position: float) -> Difference:
    return Difference(position=position, state=10 * position, gap=2 * position)


def test_the_estimate_is_the_tolerance_difference_where_the_everyday_replay_agrees():
    error = estimate(tolerance=of(1e-9), step=of(1e-6), everyday=of(1.2e-6), has_reference=True)
    assert error.estimate == of(1e-9)
    assert (error.tolerance, error.step, error.everyday) == (of(1e-9), of(1e-6), of(1.2e-6))


def test_an_everyday_replay_that_disagrees_beyond_its_own_error_becomes_the_estimate():
    """Both tolerances may share a mistake (an event that neither saw).

    An independent method shows it. Three times its own error still explains it.
    """
    assert estimate(
        tolerance=of(1e-3), step=of(1e-2), everyday=of(3.29e-2), has_reference=True
    ).estimate == of(1e-3)
    assert estimate(
        tolerance=of(1e-3), step=of(1e-2), everyday=of(3.31e-2), has_reference=True
    ).estimate == of(3.31e-2)
    # Entry by entry: only the state is off by more than is explained.
    mixed = Difference(position=2e-2, state=0.5, gap=4e-2)
    found = estimate(tolerance=of(1e-3), step=of(1e-2), everyday=mixed, has_reference=True).estimate
    assert found == Difference(position=1e-3, state=0.5, gap=2e-3)


def test_the_estimate_where_a_run_did_not_get_to_the_end():
    assert estimate(
        tolerance=of(1e-9), step=None, everyday=None, has_reference=True
    ).estimate == of(1e-9)
    assert estimate(
        tolerance=None, step=of(1e-6), everyday=None, has_reference=False
    ).estimate == of(1e-6)
    assert (
        estimate(tolerance=None, step=of(1e-6), everyday=None, has_reference=True).estimate is None
    )
    assert estimate(
        tolerance=None, step=of(1e-6), everyday=of(1e-5), has_reference=True
    ).estimate == of(1e-5), "the looser reference is missing"
    assert estimate(
        tolerance=None, step=of(1e-4), everyday=of(1e-5), has_reference=True
    ).estimate == of(1e-4)
    assert estimate(tolerance=None, step=None, everyday=None, has_reference=True).estimate is None


def test_without_a_reference_the_declared_tolerance_is_the_least_error():
    alone = {"tolerance": None, "everyday": None, "has_reference": False}
    assert estimate(**alone, step=of(1e-6), declared=of(2e-6)).estimate == of(2e-6)
    assert estimate(**alone, step=of(3e-6), declared=of(2e-6)).estimate == of(3e-6)
    assert estimate(**alone, step=None, declared=of(2e-6)).estimate is None, (
        "a tolerance says nothing of steps that do not come together"
    )
    stated = of(1e-9)
    found = estimate(**alone, step=of(1e-6), declared=of(2e-6), stated=stated)
    assert found.estimate == of(1e-6), "who states the accuracy knows more than the tolerance"


def test_a_stated_accuracy_counts_where_it_is_stated_and_larger():
    endless = math.inf
    stated = Difference(position=1e-3, state=1e-8, gap=endless)
    found = estimate(
        tolerance=None, step=of(1e-5), everyday=None, stated=stated, has_reference=False
    )
    assert found.estimate == Difference(position=1e-3, state=1e-4, gap=2e-5)
    alone = estimate(tolerance=None, step=None, everyday=None, stated=stated, has_reference=False)
    assert alone.estimate == stated
    assert not unsaid(alone.would_decide, "state [accuracy] gap")
    judged = estimate(
        tolerance=of(1e-9), step=None, everyday=None, stated=stated, has_reference=True
    )
    assert judged.estimate == of(1e-9), "with a reference it is measured"
    apart = {"tolerance": of(1e-9), "step": of(1e-5), "everyday": of(1e-3), "has_reference": True}
    assert estimate(
        **apart, stated=Difference(position=4e-4, state=1.0, gap=endless)
    ).estimate == Difference(position=1e-9, state=1e-8, gap=2e-3), (
        "an accuracy stated of Co-Simulation explains how far it is from Model Exchange"
    )


# Contacts that were stepped over


def stepped_over(
    gap: Any, rate: Any, t: Any = (0.0, 0.5, 1.5), lag: float | None = None
) -> float | None:
    """What a replay of two contacts makes of its gaps; rates are those of gaps.

    lag: of a scene without inertia.
    """
    kernel = SimpleNamespace(
        scene=SimpleNamespace(lag=lag), penetration=lambda q: np.full((1, 2), -1.0)
    )
    rows = len(t)
    replayed: Any = SimpleNamespace(
        t=np.array(t),
        gap=np.array(gap),
        q=np.zeros((rows, 1)),
        v=np.zeros((rows, 1)),
        method="reference",
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "penetration_rates", lambda kernel, q, v: -np.array(rate))
        return overlooked(kernel, replayed)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("gap", "rate", "inert", "lagging"),
    [
        (
            (0.01, 0.26),
            (-1.0, 0.5),
            True,
            None,
        ),  # opens at 0.5 m/s throughout: the rate from before does not go on
        (
            (0.1, 0.1),
            (5.0, 0.88),
            False,
            2.0 * math.sqrt(0.02 / 3.52) / 8,
        ),  # a parabola, 0.01 m deep, whatever the rate was before
    ],
)
def test_without_inertia_a_gap_has_the_rate_that_it_leaves_a_row_with(
    gap: Any, rate: Any, inert: bool, lagging: float | None
):
    gaps, rates = (np.tile([[value] for value in pair], 2) for pair in (gap, rate))
    assert (stepped_over(gaps, rates, (0.0, 0.5)) is not None) is inert
    assert stepped_over(gaps, rates, (0.0, 0.5), lag=1e-5) == (
        None if lagging is None else pytest.approx(lagging)
    )


def parabola(
    lowest: float, bend: float, place: float, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    return lowest + bend / 2 * (t - place) ** 2, bend * (t - place)


def test_a_contact_between_two_rows_asks_for_an_eighth_of_what_it_lasts():
    """g = g0 + b/2 (t - t0)^2 is below zero for 2 sqrt(-2 g0 / b); of two the shorter counts."""
    t = np.array([0.0, 0.5, 1.5])
    left, right = parabola(-0.01, 8.0, 0.2, t), parabola(-0.02, 2.0, 0.9, t)
    gap, rate = np.column_stack([left[0], right[0]]), np.column_stack([left[1], right[1]])
    assert stepped_over(gap, rate) == pytest.approx(2 * math.sqrt(0.02 / 8.0) / 8)
    assert stepped_over(gap[:, 1:], rate[:, 1:]) == pytest.approx(2 * math.sqrt(0.04 / 2.0) / 8)
    assert stepped_over(gap[:1], rate[:1], t[:1]) is None


@pytest.mark.parametrize(
    ("gap", "rate", "until", "is_one"),
    [
        ((0.99, 0.99), (-4.0, 4.0), 1.0, True), ((-1e-9, 0.99), (-4.0, 4.0), 1.0, False),
        ((0.99, -1e-9), (-4.0, 4.0), 1.0, False),
        ((0.99, 0.99), (1e-9, 4.0), 1.0, False), ((0.99, 0.99), (-4.0, -1e-9), 1.0, False),
        ((1.01, 1.01), (-4.0, 4.0), 1.0, False),
        ((0.99, 0.99), (-4.0, 4.0), 0.0, False),
    ],
    ids=["it is", "touches at the first row", "touches at the last row", "leaves", "comes",
         "does not reach", "no time"],
)  # fmt: skip
def test_what_is_a_contact_between_two_rows(
    gap: tuple[float, ...], rate: tuple[float, ...], until: float, is_one: bool
):
    assert (
        stepped_over(*([[value] for value in pair] for pair in (gap, rate)), (0.0, until))
        is not None
    ) is is_one


# A job made finer


def job_of(t: Any, **more: Any) -> Job:
    """A job whose plan has such nodes."""
    given: dict[str, Any] = {
        "package": "package", "variables": "variables", "plan": SimpleNamespace(t=np.array(t)),
        "start": "start", "limits": "limits",
    }  # fmt: skip
    return Job(
        **(
            given
            | {"tolerances": (1e-11, 1e-13), "fineness": (50, 100, 200), "event_budget": 7}
            | more
        )
    )


def task_of(step: float) -> Any:
    return SimpleNamespace(task=SimpleNamespace(step=step))


def test_nothing_is_seen_less_often_than_on_the_tasks_own_grid():
    """Steps of 0.3 and 0.1 s: the longest is three of the task's 0.1 s, or two of 0.2.

    The shortest, but at least a tenth of the mean, counts for the rest.
    """
    job = job_of([0.0, 0.3, 0.4])
    found = with_steps_of(task_of(0.1), job)
    assert (found.parts, found.fineness) == (job.parts * 3, (50, 100, 200))
    found = with_steps_of(task_of(0.04), job)
    assert (found.parts, found.fineness, found.event_budget) == (job.parts * 8, (150, 300, 600), 7)
    assert vars(with_steps_of(task_of(0.5), job)) == vars(job)
    assert with_steps_of(task_of(1e-6), job).parts == 3000
    even = job_of([0.0, 0.1])
    assert vars(with_steps_of(task_of(0.1 * (1 - 5e-7)), even)) == vars(even), (
        "rounding makes no step longer"
    )


def test_a_longest_step_holds_in_every_simulation():
    job = job_of([0.0, 0.5, 1.0])
    found = with_max_step(job, 0.004)
    assert (found.max_step, found.fineness) == (0.004, (150, 300, 600)), (
        "half a second in 50 parts is 2.5 times too much"
    )
    assert with_max_step(job, 0.02).fineness == job.fineness  # type: ignore[union-attr]
    assert with_max_step(replace(job, fineness=()), 0.2).fineness == ()  # type: ignore[union-attr]
    assert with_max_step(job, 1.01e-6) is not None
    assert with_max_step(job, 0.99e-6) is None, "more than a million steps"


def test_without_inertia_the_everyday_replay_is_fine_enough_for_its_lag():
    """Steps of 0.5 s with a lag of 1 ms: 250 parts of twice the lag, which are five times 50."""

    def found(lag: float | None, **more: Any) -> tuple[int, ...]:
        return module.fine_enough(
            SimpleNamespace(lag=lag), job_of([0.0, 0.5, 1.0], **more)
        ).fineness  # type: ignore[arg-type]

    assert found(0.001) == (250, 500, 1000)
    assert found(0.0009) == (300, 600, 1200)
    assert found(0.1) == (50, 100, 200)
    assert found(0.001, fineness=(200, 100)) == (600, 300)
    assert found(None) == (50, 100, 200)
    assert found(0.001, fineness=()) == ()


# The lag of scenes without inertia


def lagged(outcome: ReplayOutcome, method: str, known: Difference | None) -> tuple[Any, list[Any]]:
    """A replay with the error of its lag, and what was simulated for it: the run at twice the lag is off by 0.25 in its one position."""
    asked: list[Any] = []

    def simulate(job: Job, feedback: Any) -> Any:
        asked.append(
            (
                job.package,
                job.variables,
                job.start,
                job.tolerances,
                job.fineness,
                job.limits,
                feedback,
            )
        )
        run = Run(
            t=[0.0, 1.0],
            outputs=[np.array([1.0, 0.0, 5.0]), np.array([2.25, 0.0, 5.0])],
            knots=[0, 1],
            outcome=outcome,
            message="cut",
        )
        none: tuple[Run, ...] = ()
        return Simulated(
            reference=(Run(), run) if method == "reference" else none,
            everyday=(Run(), run) if method == "everyday" else none,
            refusal=None, seconds_reference=0.0, seconds_everyday=0.0,
        )  # fmt: skip

    twice = Variables(
        q=(1,), v=(2,), u=(), lam=(), gap=(3,), energies={}, powers={}, zero=frozenset(ENERGIES),
        parameters=(),
        start=(), internal_step=None,
    )  # fmt: skip
    replayed = Replay(
        scene="s", outcome=ReplayOutcome.OK, message="so far.", method=method,
        t=np.array([0.0, 0.5, 1.0]), q=np.array([[1.0], [9.0], [2.0]]),
        v=np.zeros((3, 1)), lam=np.zeros((3, 1)), gap=np.full((3, 1), 5.0),
        friction=np.zeros((3, 0)), knots=np.array([0, 2]),
        kinetic_energy=np.zeros(3), potential_energy=np.zeros(3), contact_energy=np.zeros(3),
        input_work=None, dissipated_work=None, contact_impulse=None,
        events=(), event_budget=7, error=ReplayError(estimate=known), seconds_reference=0.0,
        seconds_everyday=0.0, fmu="",
    )  # fmt: skip
    model = ForeignModel(
        name="s", coordinates=(ForeignCoordinate(name="x", velocity_name="v"),), inputs=(),
        contacts=(ForeignContact(name="c", force_name="l", gap_name="g"),),
        task=ForeignTask(goal=(None, None), step=0.1),
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Job, "run", simulate)
        patch.setattr(
            module,
            "twice_the_lag",
            lambda package, scene: twice if (package, scene) == ("package", model) else None,
        )
        found = module.with_lag_error(model, job_of([0.0, 1.0]), "feedback", replayed)  # type: ignore[arg-type]
    assert asked[0][:3] == ("package", twice, "start")
    assert asked[0][5:] == ("limits", "feedback")
    return found, asked[0][3:5]


@pytest.mark.parametrize(
    ("method", "asked"), [("reference", ((1e-11,), ())), ("everyday", ((), (200,)))]
)
def test_the_error_of_the_lag_is_added_to_the_replays_own(method: str, asked: Any):
    found, simulated = lagged(
        ReplayOutcome.OK, method, Difference(position=0.5, state=1.0, gap=2.0)
    )
    assert tuple(simulated) == asked
    assert found.error.lag == Difference(position=0.25, state=0.25, gap=0.0)
    assert found.error.estimate == Difference(position=0.75, state=1.25, gap=2.0)
    assert lagged(ReplayOutcome.OK, method, None)[0].error.estimate is None
    lost, _ = lagged(ReplayOutcome.DIVERGED, method, Difference(position=0.5, state=1.0, gap=2.0))
    assert (lost.error.estimate, lost.error.lag) == (None, None)
    assert not unsaid(lost.message, "so far. … relaxation time … with twice that time, cut")


def test_what_has_no_lag_is_as_it_is():
    given: Any = SimpleNamespace(ok=False)
    scene: Any = SimpleNamespace(lag=None)
    for given.ok in (False, True):
        assert module.with_lag_error(scene, job_of([0.0, 1.0]), None, given) is given
    assert module.twice_the_lag(None, SimpleNamespace(lag=None)) is None  # type: ignore[arg-type]


def test_twice_the_lag_is_another_parameter_of_the_fmu(monkeypatch: pytest.MonkeyPatch):
    """None where the FMU does not know it: then nothing differs."""
    scene: Any = SimpleNamespace(lag=0.25, continuous=lambda lag: SimpleNamespace(lag=lag))
    for knows in (True, False):
        monkeypatch.setattr(
            module,
            "find_variables",
            lambda package, scene, knows=knows: (package, scene.lag if knows else 0),
        )
        assert module.twice_the_lag("package", scene) == (("package", 0.5) if knows else None)  # type: ignore[arg-type,comparison-overlap]
