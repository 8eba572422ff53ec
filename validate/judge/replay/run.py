"""replay(): the reference at two tolerances, the everyday replay at two steps, and what their differences say."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.codegen.kernel import Kernel, load_kernel
from models.scene import Scene
from models.trajectory import Hold, Trajectory
from validate.fmi.description import FmuError, Package, read_package, unpacked
from validate.judge.replay.error_estimate import (
    error_of,
    overlooked,
    with_lag_error,
    with_max_step,
    with_steps_of,
    without_estimate,
)
from validate.judge.replay.everyday import FINENESS_OF_A_CALL
from validate.judge.replay.job import Job, Simulated
from validate.judge.replay.result import Event, Growth, Replay, ReplayError, ReplayOutcome
from validate.judge.replay.subject import Foreign, ForeignModel, Subject, find_variables, recorded
from validate.judge.replay.tracking import (
    TrackingError,
    design_feedback,
    design_foreign,
    measure_growth,
)
from validate.judge.replay.wiring import Feedback, HeldInputs, measure_effort, with_times_between
from validate.processes.isolated import Limits

# Relative tolerances of the reference. On three_cart the looser is 1.4e-9 m from the truth, the
# tighter 1e-11 m, at 1.1 times the time.
LOOSE = 1e-11
TIGHT = 1e-13
# Internal steps a plan step of the everyday replay: the ratio of the differences tells whether it
# converges, the last two how far it is.
FINENESS = (50, 100, 200)
# Co-Simulation tells its motion at the ends of its steps alone. Where it is judged, it is looked at
# so often in a plan at least: three_cart has as many steps.
LOOKS = 500
# Four calls of doStep a step of the plan, and then one, which is judged: of a method of first order
# the difference is three quarters of its error.
OWN_STEP = (4 * FINENESS_OF_A_CALL, FINENESS_OF_A_CALL)
# By how much communication steps are made shorter where halving them tells nothing, up to so many
# calls in a plan. A small FMU takes 1 to 5 us a call.
_SHORTER = 8
_MOST_CALLS = 200_000
# How often a replay that steps over a contact is made again, each time with steps that would have
# seen it.
_CLOSER_LOOKS = 6
# Whether to replay once more with feedback around the plan, or a function that gives the plan that
# feedback is to follow, if any, by the replay of the inputs alone.
Track = bool | Callable[[Replay], Trajectory | None]
# Contact events before a replay is stopped as chattering; the plans of the scenes have 2 to 40.
EVENT_BUDGET = 10_000


def replay(
    scene: Scene,
    fmu: Path,
    trajectory: Trajectory,
    *,
    tolerances: tuple[float, float] = (LOOSE, TIGHT),
    fineness: tuple[int, ...] = FINENESS,
    event_budget: int = EVENT_BUDGET,
    limits: Limits | None = None,
    track: Track = False,
) -> Replay:
    """Apply the plan's inputs, from the task's start, to the FMU of the scene.

    limits: run the FMU in a child process of its own; None runs it here, which is for our own FMU
        in a process that is a child already.
    track: whether to replay once more with feedback around the plan, or a function that gives the
        plan that feedback is to follow, if any, by the replay of the inputs alone.
    Raises ArchiveError, FmuError or TrajectoryError if FMU, map and plan do not fit the scene,
        TrackingError if track is True and cannot be;
    how the simulation went is `Replay.outcome`.
    """
    trajectory.check_fits(scene)
    scene = scene.continuous()
    with (
        nullcontext(read_package(fmu))
        if limits is not None
        else unpacked(read_package(fmu)) as package
    ):
        job = Job(
            package=package, variables=find_variables(package, scene), plan=trajectory,
            start=np.array(scene.task.start, dtype=float), limits=limits,
            tolerances=tolerances, fineness=fineness, event_budget=event_budget, ours=True,
        )  # fmt: skip
        job = with_steps_of(scene, job)
        kernel = load_kernel(scene)
        growth = measure_growth(kernel, scene, trajectory) if trajectory.has_states else None

        def run(feedback: Feedback | None) -> tuple[Replay, np.ndarray]:
            """The replay, and the inputs (steps, nu) [N or N m] that it applied.

            Raises FmuError, MachineError.
            """
            found, applied = _seeing_all(scene, kernel, job, feedback)
            return with_lag_error(scene, job, feedback, found), applied

        opened = replace(run(None)[0], growth=growth)
        return _with_tracked(
            opened,
            track,
            lambda followed: (design_feedback(kernel, scene, followed), growth),
            run,
            trajectory,
        )


def _with_tracked(
    opened: Replay,
    track: Track,
    design: Callable[[Trajectory], tuple[Feedback, Growth | None]],
    run: Callable[[Feedback], tuple[Replay, np.ndarray]],
    plan: Trajectory,
) -> Replay:
    """The replay of the inputs alone, and where `track` asks for it with one with feedback beside it, which `design` makes and `run` replays."""
    followed = track(opened) if callable(track) else plan if track else None
    if followed is None:
        return opened
    try:
        feedback, growth = design(followed)
    except TrackingError as error:
        if track is True:
            raise
        return replace(opened, message=f"{opened.message} No tracked replay: {error}".lstrip())
    tracked, applied = run(feedback)
    effort = measure_effort(plan, applied, feedback)
    return replace(
        opened,
        growth=growth,
        tracked=replace(tracked, feedback=feedback, applied=applied, effort=effort),
    )


def _seeing_all(
    scene: Scene, kernel: Kernel, job: Job, feedback: Feedback | None
) -> tuple[Replay, np.ndarray]:
    """The replay and what it applied, made again with smaller steps while it steps over contacts.

    Without an error estimate where that does not end.
    """
    for _ in range(_CLOSER_LOOKS):
        simulated = _convergent(scene, job, feedback)
        found, applied = _assemble(scene, job, simulated), _applied(simulated, job.plan)
        longest = overlooked(kernel, found)
        if longest is None:
            return found, applied
        finer = with_max_step(job, min(longest, job.max_step / 2.0))
        if finer is None:
            break
        job = finer
    return without_estimate(
        found, "The replay steps over a contact that is shorter than any of its steps."
    ), applied


def _applied(simulated: Simulated, plan: Trajectory) -> np.ndarray:
    """(steps made, nu) inputs of the run that is judged, as the FMU got them."""
    return np.array(simulated.judged.applied).reshape(
        len(simulated.judged.applied), plan.u.shape[1]
    )


def replay_foreign(
    foreign: Foreign,
    package: Package,
    trajectory: Trajectory,
    *,
    limits: Limits,
    track: Track = False,
    own_step: bool = False,
) -> Replay:
    """The same for an FMU without a scene, always in a child process.

    track: with feedback too, by the FMU's own directional derivatives.

    own_step: judged is Co-Simulation with one doStep a step of the plan, whatever else the FMU
        offers; its error is what four change.
    A plan whose inputs are lines is replayed as without.
    Raises TrackingError if track is True and cannot be, FmuError for own_step without
        Co-Simulation.
    """
    job = foreign_job(foreign, package, trajectory, limits, own_step)
    plan = (
        trajectory
        if own_step or package.exchange is not None
        else with_rows(trajectory, trajectory.duration / LOOKS)
    )
    looked_at = job if plan is trajectory else foreign_job(foreign, package, plan, limits, own_step)

    def run(feedback: Feedback | None) -> tuple[Replay, np.ndarray]:
        """The replay, and the inputs (steps, nu) [unit of each column] that it applied.

        Raises FmuError, MachineError.
        """
        asked = looked_at if feedback is None else job  # feedback acts at the plan's own rows
        simulated = _convergent(
            foreign.model, asked, None if feedback is None else feedback.in_units(*foreign.units)
        )
        applied = (_applied(simulated, asked.plan) - foreign.input_offset) / foreign.input_scale
        found = _assemble(foreign.model, asked, in_plan_units(foreign, simulated))
        if asked is not job:
            found = replace(found, knots=np.flatnonzero(np.isin(found.t, trajectory.t)))
        return found, applied

    return _with_tracked(
        run(None)[0],
        track,
        lambda followed: design_foreign(foreign, package, followed, limits),
        run,
        trajectory,
    )


def _convergent(subject: Subject, job: Job, feedback: Feedback | None) -> Simulated:
    """The simulations, with shorter steps of Co-Simulation where halving those of the job does not tell its error, or why it is so far from the reference.

    As they are where no number of calls that we pay for does.
    """
    first = simulated = job.run(feedback)
    while (
        job.tolerances
        and simulated.everyday
        and {run.outcome for run in (*simulated.reference, *simulated.everyday)}
        == {ReplayOutcome.OK}
    ):
        error, is_known = error_of(subject, job.variables, simulated)
        if error.estimate == error.tolerance if simulated.reference else is_known:
            return simulated
        job = replace(job, fineness=tuple(_SHORTER * fineness for fineness in job.fineness))
        if job.plan.steps * job.fineness[-1] > _MOST_CALLS * FINENESS_OF_A_CALL:
            break
        simulated = replace(
            replace(job, tolerances=()).run(feedback),
            reference=first.reference,
            seconds_reference=first.seconds_reference,
        )
    return first


def with_rows(plan: Trajectory, longest: float) -> Trajectory:
    """The plan with the same inputs and more rows, none longer than `longest` [s].

    Itself where there is none.
    """
    t = with_times_between(plan.t, longest)
    if len(t) == len(plan.t):
        return plan
    step = np.searchsorted(plan.t, t[:-1], side="right") - 1
    held = HeldInputs(plan)
    u = held.values[step] + held.slopes[step] * (t[:-1] - plan.t[step])[:, None]
    q, v = (
        np.array([np.interp(t, plan.t, column) for column in group.T])
        .reshape(group.shape[1], len(t))
        .T
        for group in (plan.q, plan.v)
    )
    return replace(plan, t=t, q=q, v=v, u=u, lam=plan.lam[step])


def foreign_job(
    foreign: Foreign, package: Package, trajectory: Trajectory, limits: Limits, own_step: bool
) -> Job:
    """The simulations of `replay_foreign`.

    Raises TrajectoryError for a plan of another shape, FmuError for own_step without Co-Simulation.
    """
    trajectory.check_fits(foreign.model)  # type: ignore[arg-type] - it answers what a scene answers
    job = Job(
        package=package, variables=foreign.variables,
        plan=trajectory.with_inputs_in(*foreign.units[1]), start=foreign.start, limits=limits,
        tolerances=(LOOSE, TIGHT), fineness=FINENESS, event_budget=EVENT_BUDGET,
    )  # fmt: skip
    if own_step and trajectory.hold is not Hold.LINEAR:  # lines are stairs of many calls
        if package.cosimulation is None:
            raise FmuError(
                f"FMU {package.path}: it offers no Co-Simulation, so it has no step of its own; leave out --own-step."
            )
        variables = replace(foreign.variables, internal_step=None)
        return replace(job, variables=variables, tolerances=(), fineness=OWN_STEP, rolls_back=False)
    return with_steps_of(foreign.model, job)


def in_plan_units(foreign: Foreign, simulated: Simulated) -> Simulated:
    """The runs, in which what the FMU gave is made what the plan means.

    Raises ValueError for runs of another FMU.
    """
    first = len(foreign.variables.q) + len(foreign.variables.v)
    impulse_scale = foreign.scale[first : first + len(foreign.variables.lam)]
    for run in (*simulated.reference, *simulated.everyday):
        run.outputs = [foreign.scale * row + foreign.offset for row in run.outputs]
        run.local = [foreign.scale * row for row in run.local]
        run.accumulated = [
            np.concatenate([impulse_scale * row[: len(impulse_scale)], row[len(impulse_scale) :]])
            for row in run.accumulated
        ]
    return simulated


def _assemble(subject: Subject, job: Job, simulated: Simulated) -> Replay:
    variables, judged = job.variables, simulated.judged
    error, is_known = error_of(subject, variables, simulated)
    names = [contact.name for contact in subject.contacts] + list(subject.force_names[subject.nc :])
    names += (
        [subject.contacts[index].pressing_name for index in subject.damped]
        if isinstance(subject, Scene)
        else []
    )
    # Indicators are the contacts' gaps, the frictions' reserves and what damped contacts press
    # with, in their order, where the scene made the FMU; elsewhere they have no names.
    named = isinstance(subject, Scene) and all(index < len(names) for _, index, _ in judged.events)
    return Replay(
        **vars(recorded(subject, variables, judged)),
        scene=subject.name,
        outcome=judged.outcome,
        message=" ".join(_notes(subject, simulated, error, is_known, own_step=not job.tolerances)),
        method="reference" if simulated.reference else "everyday",
        t=np.array(judged.t, dtype=float),
        knots=np.array(judged.knots, dtype=np.int64),
        events=tuple(
            Event(time=time, contact=names[index] if named else f"indicator_{index}", closes=closes)
            for time, index, closes in judged.events
        ),
        event_budget=job.event_budget,
        error=error,
        seconds_reference=simulated.seconds_reference,
        seconds_everyday=simulated.seconds_everyday,
        fmu=job.package.digest,
    )


def _notes(
    subject: Subject,
    simulated: Simulated,
    error: ReplayError,
    is_known: bool,
    own_step: bool = False,
) -> list[str]:
    """What else is to be said of a replay.

    is_known: whether the error of the everyday replay's step is.
    """
    reference, everyday, refusal, judged = (
        simulated.reference,
        simulated.everyday,
        simulated.refusal,
        simulated.judged,
    )
    if refusal is None and reference:
        refusal = next(
            (run.message for run in everyday if run.outcome is not ReplayOutcome.OK), None
        )
    notes = [judged.message] if judged.message else []
    if refusal is not None:
        notes.append(f"No everyday replay: {refusal.rstrip('.')}.")
    if not reference:
        no_exchange = "No reference replay: the FMU offers no Model Exchange."
        notes.append(
            "Judged is Co-Simulation with one doStep a step of the plan."
            if own_step
            else no_exchange
        )
        if not is_known:
            halved = "Half the communication step changes nothing"
            if error.step_ratio is not None:
                halved = f"Halving the communication step again changes {1.0 / error.step_ratio:.2g} times as much"
            told = "its author states." if error.stated is not None else "cannot be told."
            notes.append(f"{halved}: the FMU has a step of its own, and how wrong that is {told}")
    if isinstance(subject, ForeignModel):
        if error.tolerance is not None:
            if error.estimate != error.tolerance and error.everyday is not None:
                notes.append(
                    f"Co-Simulation is {error.everyday.position:.2g} from Model Exchange in some position, more than halving its step explains, so the motion may be as "
                    "wrong. If Co-Simulation is no better than that, say so in the map ([accuracy] position = .., velocity = .., gap = ..)."
                )
            elif subject.accuracy is not None:
                notes.append(
                    "The stated accuracy is of Co-Simulation; judged is Model Exchange, and it tells its own error."
                )
        notes += subject.notes
    if simulated.note:
        notes.append(simulated.note)
    return notes
