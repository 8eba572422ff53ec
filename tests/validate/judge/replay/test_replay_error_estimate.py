"""The replay's own error, from runs made by hand whose differences are known."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from models.catalog import load_scene
from models.trajectory import Trajectory
from validate.judge.replay import Difference
from validate.judge.replay.error_estimate import (
    difference,
    estimate,
    heeds_step,
    larger,
    local_errors,
    step_ratio,
    with_max_step,
    with_steps_of,
)
from validate.judge.replay.job import Job

SIGNS = pytest.mark.parametrize("sign", [1.0, -1.0])


@dataclass
class Run:
    q: np.ndarray
    v: np.ndarray
    gap: np.ndarray


def still(nodes: int = 4, contacts: int = 3) -> Run:
    return Run(q=np.full((nodes, 2), 2.0), v=np.zeros((nodes, 2)), gap=np.ones((nodes, contacts)))


@SIGNS
def test_a_difference_is_the_largest_of_one_coordinate_one_node_and_one_gap(sign: float):
    """At node 1 the state is 0.3 and 0.4 off, at node 2 one coordinate 0.35; the gap elsewhere."""
    one, other = still(), still()
    other.q[1, 1] += sign * 0.3
    other.v[1, 0] -= sign * 0.4
    other.q[2, 0] += sign * 0.35
    other.gap[3, 2] -= sign * 0.07
    expected = Difference(position=pytest.approx(0.35), state=pytest.approx(0.5), gap=pytest.approx(0.07))
    assert difference(one, other) == expected
    assert difference(other, one) == expected
    assert difference(one, one) == Difference(position=0.0, state=0.0, gap=0.0)
    assert difference(None, other) is difference(one, None) is None
    assert difference(still(contacts=0), still(contacts=0)) == Difference(position=0.0, state=0.0, gap=0.0)


@SIGNS
def test_a_run_heeds_its_step_if_half_the_step_changes_more_than_rounding(sign: float):
    coarse, fine = still(), still()
    assert not heeds_step(coarse, fine)
    coarse.v[2, 1] = sign * 1e-13  # of a motion of 2
    assert not heeds_step(coarse, fine)
    coarse.v[2, 1] = sign * 3e-13
    assert heeds_step(coarse, fine)
    assert heeds_step(None, fine)
    assert heeds_step(coarse, None)


TIMES = np.array([1.0, 1.5, 2.5, 3.0])


@SIGNS
def test_local_errors_are_summed_over_the_steps(sign: float):
    fine, ends = still(), still(nodes=3)
    ends.q[0, 0] += sign * 0.1
    ends.q[2, 0] -= sign * 0.2
    ends.v[1, 1] += sign * 0.04
    ends.gap[0, 1] -= sign * 0.01
    ends.gap[1, 1] += sign * 0.02
    alone = local_errors(fine, ends, TIMES, carried=False, heeds=True)
    assert alone == Difference(position=pytest.approx(0.3), state=pytest.approx(math.hypot(0.3, 0.04)), gap=pytest.approx(0.03))
    # The second step ends at 2.5 s, half a second before the end: 0.02 of the other coordinate; two bodies may both come nearer by that.
    carried = local_errors(fine, ends, TIMES, carried=True, heeds=True)
    assert carried == Difference(
        position=pytest.approx(0.3), state=pytest.approx(math.hypot(0.3, 0.02, 0.04)), gap=pytest.approx(0.03 + 2 * 0.02)
    )
    ends.v[0, 0] += sign * 0.4  # an error of the first step goes on for 1.5 s
    assert local_errors(fine, ends, TIMES, carried=True, heeds=True).position == pytest.approx(0.3 + 0.6)  # type: ignore[union-attr]


def test_local_errors_of_a_run_that_heeds_no_step_are_not_known():
    fine, ends = still(), still(nodes=3)
    assert local_errors(fine, ends, TIMES, carried=True, heeds=False) is None
    assert local_errors(fine, ends, TIMES, carried=True, heeds=True) == Difference(position=0.0, state=0.0, gap=0.0)
    ends.q[1, 0] += 1e-12
    assert local_errors(fine, ends, TIMES, carried=False, heeds=False).position == pytest.approx(1e-12, rel=1e-3)  # type: ignore[union-attr]
    assert local_errors(None, ends, TIMES, carried=True, heeds=True) is None
    assert local_errors(fine, None, TIMES, carried=True, heeds=True) is None


def test_the_larger_of_two_is_taken_entry_by_entry():
    one, other = Difference(position=1.0, state=5.0, gap=2.0), Difference(position=3.0, state=4.0, gap=6.0)
    assert larger(one, other) == larger(other, one) == Difference(position=3.0, state=5.0, gap=6.0)
    assert larger(one, None) is larger(None, one) is one
    assert larger(None, None) is None


def of(position: float) -> Difference:
    return Difference(position=position, state=10 * position, gap=2 * position)


def test_the_ratio_of_two_halvings_is_not_one_of_roundings():
    assert step_ratio(of(8e-3), of(2e-3)) == pytest.approx(4.0)
    assert step_ratio(of(8e-3), of(0.9e-11)) is None
    assert step_ratio(of(8e-3), of(1.1e-11)) is not None
    assert step_ratio(None, of(1.0)) is step_ratio(of(1.0), None) is None


def test_the_estimate_is_the_tolerance_difference_where_the_everyday_replay_agrees():
    error = estimate(tolerance=of(1e-9), step=of(1e-6), everyday=of(1.2e-6), has_reference=True)
    assert error.estimate == of(1e-9)
    assert (error.tolerance, error.step, error.everyday, error.step_source) == (of(1e-9), of(1e-6), of(1.2e-6), "second run")


def test_an_everyday_replay_that_disagrees_beyond_its_own_error_becomes_the_estimate():
    """Both tolerances may share a mistake (an event that neither saw); an independent method shows it. Three times its own error still explains it."""
    assert estimate(tolerance=of(1e-3), step=of(1e-2), everyday=of(3.29e-2), has_reference=True).estimate == of(1e-3)
    assert estimate(tolerance=of(1e-3), step=of(1e-2), everyday=of(3.31e-2), has_reference=True).estimate == of(3.31e-2)
    # Entry by entry: only the state is off by more than is explained.
    mixed = Difference(position=2e-2, state=0.5, gap=4e-2)
    found = estimate(tolerance=of(1e-3), step=of(1e-2), everyday=mixed, has_reference=True).estimate
    assert found == Difference(position=1e-3, state=0.5, gap=2e-3)


def test_the_estimate_where_a_run_did_not_get_to_the_end():
    assert estimate(tolerance=of(1e-9), step=None, everyday=None, has_reference=True).estimate == of(1e-9)
    assert estimate(tolerance=None, step=of(1e-6), everyday=None, has_reference=False).estimate == of(1e-6)
    assert estimate(tolerance=None, step=of(1e-6), everyday=None, has_reference=True).estimate is None
    assert estimate(tolerance=None, step=of(1e-6), everyday=of(1e-5), has_reference=True).estimate == of(1e-5), (
        "the looser reference is missing"
    )
    assert estimate(tolerance=None, step=of(1e-4), everyday=of(1e-5), has_reference=True).estimate == of(1e-4)
    assert estimate(tolerance=None, step=None, everyday=None, has_reference=True).estimate is None


def test_without_a_reference_the_larger_of_second_run_and_rollback_counts():
    found = estimate(tolerance=None, step=of(1e-6), everyday=None, rollback=of(2e-6), ratio=2.5, has_reference=False)
    assert (found.estimate, found.step_source, found.step_ratio) == (of(2e-6), "second run and rollback", 2.5)
    found = estimate(tolerance=None, step=None, everyday=None, rollback=of(2e-6), has_reference=False)
    assert (found.estimate, found.step_source) == (of(2e-6), "rollback")
    assert estimate(tolerance=None, step=None, everyday=None, has_reference=False).step_source == "none"


def test_a_stated_accuracy_counts_where_it_is_stated_and_larger():
    endless = math.inf
    stated = Difference(position=1e-3, state=1e-8, gap=endless)
    found = estimate(tolerance=None, step=of(1e-5), everyday=None, stated=stated, has_reference=False)
    assert found.estimate == Difference(position=1e-3, state=1e-4, gap=2e-5)
    assert found.step_source == "second run, stated"
    alone = estimate(tolerance=None, step=None, everyday=None, stated=stated, has_reference=False)
    assert (alone.estimate, alone.step_source) == (stated, "stated")
    assert "state [accuracy] gap in the map too" in alone.would_decide
    judged = estimate(tolerance=of(1e-9), step=None, everyday=None, stated=stated, has_reference=True)
    assert judged.estimate == of(1e-9), "with a reference it is measured"


def test_a_coarse_plan_is_simulated_as_finely_as_one_on_the_tasks_own_grid():
    """Steps of 0.05 s where the task has 0.01 s: five times the points and internal steps; at most 0.1 ms asks for ten times the latter."""
    scene, t = load_scene("three_cart"), 0.05 * np.arange(5)
    plan = Trajectory(t=t, q=np.zeros((5, 3)), v=np.zeros((5, 3)), u=np.zeros((4, 2)), lam=np.zeros((4, 2)))
    nothing: Any = None
    job = Job(
        package=nothing, variables=nothing, plan=plan, start=plan.start, limits=None, tolerances=(1e-9,), fineness=(50, 100), event_budget=1
    )
    found, own = with_steps_of(scene, job), with_steps_of(scene, replace(job, plan=replace(plan, t=t / 5.0)))
    assert (found.fineness, found.parts) == ((250, 500), 5 * job.parts)
    assert (own.fineness, own.parts) == (job.fineness, job.parts)
    finer = with_max_step(job, 1e-4)
    assert finer is not None
    assert (finer.max_step, finer.fineness) == (1e-4, (500, 1000))
    assert with_max_step(job, 1e-8) is None, "more than a million steps"
