"""A replay is put together from its runs: numbers in the plan's units, errors, feedback, and what ended a run."""

import math
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from wording import unsaid

from models.catalog import load_scene
from models.trajectory import Hold, Trajectory
from tests.validate.judge.replay.test_replay_job import JOB, NO_FMU, PLAN, START, VARIABLES
from validate.judge.replay import Difference, ReplayError, ReplayOutcome
from validate.judge.replay import run as run_module
from validate.judge.replay.job import Job, Simulated
from validate.judge.replay.result import Event, Run
from validate.judge.replay.subject import (
    Foreign,
    ForeignContact,
    ForeignCoordinate,
    ForeignInput,
    ForeignModel,
    ForeignTask,
    recorded,
)
from validate.judge.replay.wiring import Feedback
from validate.processes.isolated import Limits

MODEL = ForeignModel(
    name="cart", coordinates=(ForeignCoordinate(name="x", velocity_name="v"),),
    inputs=(ForeignInput(name="F"),),
    contacts=(ForeignContact(name="stop", force_name="lam", gap_name="gap"),),
    task=ForeignTask(goal=(None, 2.0), step=0.1, horizon=3.0),
    notes=("a note of the map.",),
)  # fmt: skip


LAW = Feedback(
    gains=np.zeros((2, 1, 2)), reference=np.zeros((3, 2)), u=np.array([[1.0], [2.0]]),
    lower=np.array([-9.0]), upper=np.array([9.0]),
    scale=np.array([9.0]),
)  # fmt: skip


def refuses(*given: Any) -> Any:
    raise run_module.TrackingError("it overflows")


def foreign() -> Foreign:
    return Foreign(
        model=MODEL, variables=VARIABLES, scale=np.array([2.0, 3.0, 4.0, 5.0]),
        offset=np.array([0.1, 0.2, 0.3, 0.4]),
        input_scale=np.array([10.0]), input_offset=np.array([1.0]), start=START,
    )  # fmt: skip


def test_numbers_of_an_fmu_become_those_of_the_plan():
    """Values by scale and offset, impulses by the scale of their forces.

    Energies stay.
    """
    run = Run(
        outputs=[np.array([1.0, 1.0, 1.0, 1.0])],
        accumulated=[np.array([7.0, 8.0, 9.0])],
    )
    given = Simulated(
        reference=(run,),
        everyday=(replace(run),),
        refusal=None,
        seconds_reference=0.0,
        seconds_everyday=0.0,
    )
    found = run_module.in_plan_units(foreign(), given)
    assert run.outputs[0].tolist() == [1.0, 1.0, 1.0, 1.0], "what was given is as it was"
    for one in (*found.reference, *found.everyday):
        assert one.outputs[0] == pytest.approx([2.1, 3.2, 4.3, 5.4])
        assert one.accumulated[0].tolist() == [28.0, 8.0, 9.0]


def test_what_a_run_recorded_is_taken_apart_by_name():
    run = Run(t=[0.0, 0.5],
              outputs=[np.array([1.0, 2.0, 3.0, 4.0]), np.array([5.0, 6.0, 7.0, 8.0])],
              accumulated=[np.array([0.0, 0.0, 0.0]), np.array([9.0, 10.0, 11.0])])  # fmt: skip
    out = recorded(MODEL, VARIABLES, run)
    assert [array.ravel().tolist() for array in (out.q, out.v, out.lam, out.gap)] == [
        [1.0, 5.0],
        [2.0, 6.0],
        [3.0, 7.0],
        [4.0, 8.0],
    ]
    assert (out.friction.shape, out.kinetic_energy.tolist()) == ((2, 0), [0.0, 0.0])
    sums = [
        sums.ravel().tolist() for sums in (out.contact_impulse, out.input_work, out.dissipated_work)
    ]
    assert sums == [[0.0, 9.0], [0.0, 10.0], [0.0, 11.0]]
    last = recorded(MODEL, VARIABLES, run, [1])
    assert (last.q.tolist(), last.input_work.tolist()) == ([[5.0]], [10.0])  # type: ignore[union-attr]
    known = recorded(MODEL,
                     replace(VARIABLES, zero=frozenset({"input_power"}),
                             powers={"dissipated_power": 7}),
                             Run(t=[0.0], outputs=run.outputs[:1],
                                 accumulated=[np.array([1.0, 2.0])]))  # fmt: skip
    assert (known.input_work.tolist(), known.dissipated_work.tolist()) == ([0.0], [2.0])  # type: ignore[union-attr]
    bare = recorded(
        MODEL, replace(VARIABLES, lam=(), gap=(), v=()), Run(t=[0.0], outputs=[np.array([1.0])])
    )
    assert (bare.v.tolist(), bare.lam.tolist(), bare.gap.tolist(), bare.contact_impulse,
            bare.input_work) == (
        [[0.0]], [[0.0]], [[0.0]], None, None,
    )  # fmt: skip
    run = Run(t=[0.0], outputs=[np.array([1.0, 2.0, 4.0])], accumulated=[np.array([5.0])])
    partly = recorded(MODEL, replace(VARIABLES, lam=(), powers={"input_power": 6}), run)
    assert (partly.gap.tolist(), partly.input_work.tolist()) == ([[4.0]], [5.0])
    assert partly.contact_impulse is partly.dissipated_work is None


def simulated(reference: list[float], everyday: list[float], **more: Any) -> Simulated:
    """Runs of three nodes which end at such positions, but for a row between the first two.

    A run that is not a number was cut off.
    """

    def run(end: float) -> Run:
        rows = [
            [0.0, 0.0, 0.0, 1.0],
            [5.0, 0.0, 0.0, 1.0],
            [0.5, 0.0, 0.0, 1.0],
            [end, 0.0, 0.0, 1.0],
        ]
        if math.isnan(end):
            return Run(
                t=[0.0],
                outputs=[np.array(rows[0])],
                knots=[0],
                outcome=ReplayOutcome.DIVERGED,
                message="cut off.",
            )
        return Run(
            t=[0.0, 0.2, 0.5, 1.0],
            outputs=[np.array(row) for row in rows],
            knots=[0, 2, 3],
            events=[(0.2, 0, True)],
        )

    given = {"refusal": None, "seconds_reference": 1.5, "seconds_everyday": 2.5, "note": ""} | more
    return Simulated(
        reference=tuple(map(run, reference)), everyday=tuple(map(run, everyday)), **given
    )


def assembled(found: Simulated, **more: Any) -> Any:
    return run_module._assemble(
        MODEL, replace(JOB, variables=replace(VARIABLES, **more), event_budget=77), found
    )


def at(position: float) -> Difference:
    return Difference(position=pytest.approx(position), state=pytest.approx(position), gap=0.0)


def test_a_replay_is_the_tighter_reference_and_is_compared_with_all_others():
    found = assembled(simulated([1.25, 1.0], [3.0, 2.0, 1.5]))
    assert (found.scene, found.outcome, found.method, found.event_budget, found.fmu) == (
        "cart",
        ReplayOutcome.OK,
        "reference",
        77,
        "sha",
    )
    assert (found.t.tolist(), found.q[-1].tolist(), found.knots.tolist()) == (
        [0.0, 0.2, 0.5, 1.0],
        [1.0],
        [0, 2, 3],
    )
    error = found.error
    assert (error.tolerance, error.step, error.everyday) == (at(0.25), at(0.5), at(0.5))
    assert (found.seconds_reference, found.seconds_everyday, found.message) == (
        1.5,
        2.5,
        "a note of the map.",
    )
    assert found.events == (Event(time=0.2, contact="indicator_0", closes=True),)


def test_without_a_reference_the_finest_everyday_run_is_judged():
    found = assembled(simulated([], [3.0, 2.0, 1.5, 1.25], note="and a note"))
    assert (found.method, found.q[-1].tolist(), found.error.tolerance, found.error.estimate) == (
        "everyday",
        [1.25],
        None,
        at(1.75),
    )
    assert not unsaid(
        found.message, "No reference replay: … no Model Exchange. a note of the map. and a note"
    )
    same = assembled(simulated([], [1.5, 1.5, 1.5, 1.5]))
    assert (same.error.estimate, not unsaid(same.message, "cannot be told")) == (None, True)
    heeds = assembled(simulated([], [1.5, 1.5, 1.5, 1.5]), internal_step=9)
    assert heeds.error.step == at(0.0), "an FMU with a step to set heeds it"


def test_runs_that_were_cut_off_are_compared_with_nothing():
    nan = math.nan
    assert assembled(simulated([nan, 1.0], [2.0, 1.5])).error.tolerance is None
    alone = assembled(simulated([1.0], [3.0, 2.0, 1.5]))
    assert (alone.error.tolerance, alone.error.everyday) == (None, None), (
        "one reference alone is not compared"
    )
    lost = assembled(simulated([1.25, 1.0], [nan, nan, nan]))
    assert (lost.error.step, lost.error.everyday, lost.error.estimate) == (None, None, at(0.25))
    assert lost.message.startswith("No everyday replay: cut off.")
    ended_early = assembled(simulated([1.25, nan], []))
    assert (ended_early.outcome, ended_early.message.split(". ")[0]) == (
        ReplayOutcome.DIVERGED,
        "cut off",
    )
    refused = assembled(simulated([1.25, 1.0], [], refusal="it wants equal steps."))
    assert not unsaid(refused.message, "No everyday replay: … equal steps. a note")


def test_what_the_notes_say_of_cosimulation():
    stated = replace(MODEL, accuracy=Difference(position=1.0, state=1.0, gap=1.0))
    quarter, half = (Difference(position=size, state=size, gap=size) for size in (0.25, 0.5))
    error, runs = (
        ReplayError(estimate=quarter, tolerance=quarter, everyday=half),
        simulated([1.25, 1.0], [1.5]),
    )

    def notes(
        model: ForeignModel, runs: Simulated, error: ReplayError, is_known: bool = True
    ) -> str:
        return " ".join(run_module._notes(model, runs, error, is_known))

    assert "The stated accuracy is of Co-Simulation" in notes(stated, runs, error)
    assert "Co-Simulation" not in notes(MODEL, runs, error)
    assert "Co-Simulation" not in notes(stated, runs, ReplayError(estimate=None))
    apart = replace(error, estimate=half)
    assert not unsaid(
        notes(MODEL, runs, apart), "Co-Simulation is 0.5 from Model Exchange … [accuracy] position"
    )
    alone = simulated([], [1.5, 1.5])
    assert not unsaid(
        notes(stated, alone, ReplayError(estimate=None, stated=stated.accuracy), False),
        "do not come together; … its author states.",
    )
    assert not unsaid(
        notes(MODEL, alone, ReplayError(estimate=None), False),
        "do not come together; … cannot be told.",
    )


def test_feedback_on_somebodys_fmu_is_in_its_units_and_told_in_the_plans(
    monkeypatch: pytest.MonkeyPatch,
):
    """F of the FMU is 10 times the plan's, and 1 more; it applies 31 and 41, which are 3 and 4."""
    jobs: list[Any] = []

    def simulate(job: Job, feedback: Feedback | None = None) -> Simulated:
        jobs.append((job.plan.u.tolist(), job.start, job.limits, feedback))
        found = simulated([1.25, 1.0], [1.5])
        for run in found.reference:
            run.applied = [np.array([31.0]), np.array([41.0])]
        return found

    designed: list[Any] = []
    monkeypatch.setattr(Job, "run", simulate)
    monkeypatch.setattr(
        run_module, "design_foreign", lambda *given: designed.append(given) or (LAW, "growth")
    )
    plan = replace(PLAN, hold=Hold.ZERO_ORDER, u_end=None)
    limits = Limits(seconds=9.0)
    opened = run_module.replay_foreign(foreign(), NO_FMU, plan, limits=limits)
    assert (opened.tracked, opened.growth, jobs) == (
        None,
        None,
        [([[11.0], [21.0]], START, limits, None)],
    )
    assert opened.q[-1].tolist() == [2.0 * 1.0 + 0.1]
    for track in (True, lambda replay: plan):
        found = run_module.replay_foreign(foreign(), NO_FMU, plan, limits=limits, track=track)  # type: ignore[arg-type]
        assert (found.growth, found.tracked.feedback, found.tracked.applied.tolist()) == (
            "growth",
            LAW,
            [[3.0], [4.0]],
        )
        assert found.tracked.effort.peak == (2.0,)
    assert jobs[-1][3].lower.tolist() == [-89.0]
    (wired, _, given, _) = designed[0]
    assert (wired.model, wired.variables, given, wired.start) == (MODEL, VARIABLES, plan, START)
    assert [[part.tolist() for part in pair] for pair in wired.units] == [
        [[2.0, 3.0], [0.1, 0.2]],
        [[10.0], [1.0]],
    ]
    assert (
        run_module.replay_foreign(
            foreign(), NO_FMU, plan, limits=limits, track=lambda replay: None
        ).tracked
        is None
    )

    monkeypatch.setattr(run_module, "design_foreign", refuses)
    refused = run_module.replay_foreign(
        foreign(), NO_FMU, plan, limits=limits, track=lambda replay: plan
    )
    assert refused.message.endswith("No tracked replay: it overflows")
    with pytest.raises(run_module.TrackingError):
        run_module.replay_foreign(foreign(), NO_FMU, plan, limits=limits, track=True)


@pytest.mark.parametrize(
    ("status", "outcome"), [(4, ReplayOutcome.FATAL), (3, ReplayOutcome.FMU_FAILED)]
)
def test_a_run_that_was_refused_says_when(status: int, outcome: ReplayOutcome):
    class RefusedError(Exception):
        pass

    error: Any = RefusedError("fmi2DoStep returned an error.")
    error.status = status
    for times, when in (([], "0.5"), ([0.5, 0.75], "0.75")):
        run = Run(t=list(times))
        run.end_refused(error, 0.5)
        assert (run.outcome, run.message) == (
            outcome,
            f"fmi2DoStep returned an error (after t = {when} s).",
        )


# How often, how exactly, and whether with feedback


@pytest.mark.parametrize("looks", [0, 1, 5, 9])
@pytest.mark.parametrize("too_many", [False, True])
def test_a_replay_that_steps_over_a_contact_is_made_again_with_steps_that_see_it(
    looks, too_many, monkeypatch
):
    """Each time with at most what would have seen it, and at most half of what it had.

    Six times, or until that takes too many steps.
    """
    asked: list[float] = []
    seen = iter([0.1] * looks + [None] * 20)

    def simulate(job: Job, feedback: Feedback | None) -> Simulated:
        asked.append(job.max_step)
        runs = simulated([1.25, 1.0], [1.5])
        runs.judged.applied = [np.array([float(len(asked))])]
        return runs

    monkeypatch.setattr(Job, "run", simulate)
    monkeypatch.setattr(run_module, "overlooked", lambda kernel, found: next(seen))
    monkeypatch.setattr(
        run_module,
        "with_max_step",
        lambda job, longest: None if too_many else replace(job, max_step=longest),
    )
    found, applied = run_module._seeing_all(MODEL, None, replace(JOB, max_step=0.15), None)  # type: ignore[arg-type]
    runs = 1 if too_many else min(looks + 1, 6)
    assert asked == [0.15, 0.075, 0.0375, 0.01875, 0.009375, 0.0046875][:runs]
    assert applied.tolist() == [[runs]], "of the last"
    lost = looks >= 6 or (looks > 0 and too_many)
    assert (
        found.error.estimate is None,
        not unsaid(found.message, "shorter than any of its steps"),
    ) == (lost, lost)


def test_a_scene_is_replayed_with_feedback_where_its_replay_asks_for_it(
    monkeypatch: pytest.MonkeyPatch,
):
    scene = load_scene("wall_pendulum")
    states = np.zeros((3, 1))
    plan = Trajectory(
        t=scene.task.step * np.arange(3),
        q=states,
        v=states,
        u=np.array([[1.0], [2.0]]),
        lam=np.zeros((2, 1)),
    )
    jobs: list[Any] = []

    def seeing(scene: Any, kernel: Any, job: Job, feedback: Feedback | None) -> Any:
        jobs.append((job, feedback))
        return assembled(simulated([1.25, 1.0], [1.5])), np.array([[3.0], [4.0]])

    monkeypatch.setattr(run_module, "read_package", lambda path: NO_FMU)
    monkeypatch.setattr(run_module, "unpacked", nullcontext)
    monkeypatch.setattr(run_module, "find_variables", lambda package, scene: VARIABLES)
    monkeypatch.setattr(run_module, "_seeing_all", seeing)
    monkeypatch.setattr(run_module, "measure_growth", lambda kernel, scene, plan: "growth")
    monkeypatch.setattr(run_module, "design_feedback", lambda kernel, scene, plan: LAW)
    opened = run_module.replay(scene, Path("a.fmu"), plan)
    assert (opened.growth, opened.tracked) == ("growth", None)
    job, feedback = jobs[0]
    assert (job.package, job.variables, job.plan, job.start.tolist()) == (
        NO_FMU,
        VARIABLES,
        plan,
        [0.0, 0.8],
    )
    assert (job.tolerances, job.fineness, job.event_budget, job.parts, job.max_step) == (
        (1e-11, 1e-13), (100, 200), 10_000, 3, math.inf,
    )  # fmt: skip
    assert (job.limits, feedback) == (None, None)
    for track in (True, lambda replay: plan if replay.growth == "growth" else None):
        found = run_module.replay(
            scene, Path("a.fmu"), plan, track=track, limits=Limits(seconds=3.0)
        )
        assert (found.tracked.applied.tolist(), found.tracked.feedback) == ([[3.0], [4.0]], LAW)
        assert [(job.limits, feedback) for job, feedback in jobs[-2:]] == [
            (Limits(seconds=3.0), None),
            (Limits(seconds=3.0), LAW),
        ]
        assert found.tracked.effort.peak == (2.0,)
    blind = run_module.replay(
        scene,
        Path("a.fmu"),
        replace(plan, missing=frozenset({"q", "v"})),
        track=lambda replay: None,
    )
    assert blind.growth is None

    monkeypatch.setattr(run_module, "design_feedback", refuses)
    refused = run_module.replay(scene, Path("a.fmu"), plan, track=lambda replay: plan)
    assert (refused.tracked, refused.message.endswith("No tracked replay: it overflows")) == (
        None,
        True,
    )
    with pytest.raises(run_module.TrackingError):
        run_module.replay(scene, Path("a.fmu"), plan, track=True)
