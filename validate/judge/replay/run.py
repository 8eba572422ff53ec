"""replay(): the reference at two tolerances, the everyday replay at two steps, and what their differences say."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.codegen.kernel import Kernel, load_kernel
from models.scene import Scene
from models.trajectory import Hold, Trajectory
from validate.fmi.description import FmuError, Package, experiment, read_package, unpacked
from validate.fmi.ladder import FINEST, LADDER
from validate.judge.replay.error_estimate import (
    error_of,
    is_explained,
    overlooked,
    with_lag_error,
    with_max_step,
    with_steps_of,
    without_estimate,
)
from validate.judge.replay.everyday import FINENESS_OF_A_CALL, base_step
from validate.judge.replay.job import Job, Simulated
from validate.judge.replay.result import Event, Growth, Replay, ReplayError, ReplayOutcome, Run
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
# Internal steps a plan step of the everyday replay beside the reference, which it only confirms.
FINENESS = (100, 200)
# Co-Simulation tells its motion at the ends of its steps alone. Where it is judged, it is looked at
# so often in a plan at least: three_cart has as many steps.
LOOKS = 500
# Calls of doStep a step of the plan; the last is what is judged.
OWN_STEP = tuple(FINENESS_OF_A_CALL * parts for parts in LADDER[FINEST - 1 :: -1])
# By how much communication steps are made shorter where they do not explain how far Co-Simulation
# is from the reference; and how many calls a plan may take. A small FMU takes 1 to 5 us a call.
_SHORTER = 8
_MOST_CALLS = 200_000
# Steps that differ by less than this share are equal: times are printed with some ten digits.
_SAME_STEP = 1e-6
# How often a replay that steps over a contact is made again, each time with steps that would have
# seen it.
_CLOSER_LOOKS = 6
# Whether to replay once more with feedback around the plan, or a function that gives the plan that
# feedback is to follow, if any, by the replay of the inputs alone.
Track = bool | Callable[[Replay], Trajectory | None]
# Whether a replay is sure enough for a verdict.
Decides = Callable[[Trajectory, Replay], bool]
# Contact events before a replay is stopped as chattering; the plans of the scenes have 2 to 40.
EVENT_BUDGET = 10_000


def replay(
    scene: Scene,
    fmu: Path,
    trajectory: Trajectory,
    *,
    tolerances: tuple[float, float] = (LOOSE, TIGHT),
    fineness: tuple[int, ...] | None = None,
    event_budget: int = EVENT_BUDGET,
    limits: Limits | None = None,
    track: Track = False,
) -> Replay:
    """Apply the plan's inputs, from the task's start, to the FMU of the scene.

    fineness: internal steps a plan step of the everyday replay; None: as many as its error needs.
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
        if fineness is None:
            fineness = FINENESS if package.exchange is not None else OWN_STEP[::-1]
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
    inner = base_step(job.plan.t) / max(job.fineness, default=1)
    for _ in range(_CLOSER_LOOKS):
        simulated = _explained(scene, job, feedback)
        found, applied = _assemble(scene, job, simulated), _applied(simulated, job.plan)
        longest = overlooked(kernel, found)
        if longest is None and inner < job.max_step and not is_explained(found.error):
            # The everyday replay may have met what the longer steps of the reference passed by.
            longest = inner
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
    decides: Decides = lambda plan, found: True,
) -> Replay:
    """The same for an FMU without a scene, always in a child process.

    track: with feedback too, by the FMU's own directional derivatives.

    decides: whether a replay, with or without `tracked`, is sure enough; without Model Exchange
    steps are made shorter until it is, or until the number of calls is spent.

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

        def made(simulated: Simulated) -> Replay:
            found = _assemble(foreign.model, asked, in_plan_units(foreign, simulated))
            found = _pushing(foreign.model, found)
            if asked is job:
                return found
            return replace(found, knots=np.flatnonzero(np.isin(found.t, trajectory.t)))

        def is_enough(simulated: Simulated) -> bool:
            found = made(simulated)
            whole = found if feedback is None else replace(opened[0], tracked=found)
            return found.error.estimate is not None and decides(trajectory, whole)

        in_units = None if feedback is None else feedback.in_units(*foreign.units)
        if package.exchange is not None and not own_step:
            simulated = _explained(foreign.model, asked, in_units)
        else:
            asked, simulated = _accepted(asked, job, in_units)
            if not own_step:
                simulated = _refined(asked, simulated, in_units, is_enough)
        applied = (_applied(simulated, asked.plan) - foreign.input_offset) / foreign.input_scale
        if feedback is None:
            opened.append(made(simulated))
        return made(simulated), applied

    opened: list[Replay] = []
    return _with_tracked(
        run(None)[0],
        track,
        lambda followed: design_foreign(foreign, package, followed, limits),
        run,
        trajectory,
    )


def _pushing(model: ForeignModel, found: Replay) -> Replay:
    """The replay with contact forces that push, where those of the FMU pull: the map has their sign wrong."""
    h = np.diff(found.t)[:, None]
    impulses = (h * (found.lam[:-1] + found.lam[1:]) / 2.0).sum(axis=0)
    pulls = impulses < 0.0
    if not pulls.any():
        return found
    names = ", ".join(
        contact.name for contact, pull in zip(model.contacts, pulls, strict=True) if pull
    )
    note = f"By the FMU contact {names} pulls, so its force is taken with the other sign; say so in the map (scale = -1)."
    lam = np.where(pulls, -1.0, 1.0) * found.lam
    return replace(found, lam=lam, message=f"{found.message} {note}".lstrip())


def _explained(subject: Subject, job: Job, feedback: Feedback | None) -> Simulated:
    """The simulations, with shorter steps of Co-Simulation where those of the job do not explain how far it is from the reference.

    As they are where no number of calls that we pay for does.
    """
    first = simulated = job.run(feedback)
    while simulated.everyday and {
        run.outcome for run in (*simulated.reference, *simulated.everyday)
    } == {ReplayOutcome.OK}:
        error, _ = error_of(subject, job.variables, simulated, job.package)
        if is_explained(error):
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


def _accepted(job: Job, own_rows: Job, feedback: Feedback | None) -> tuple[Job, Simulated]:
    """The simulations by Co-Simulation at those steps that the FMU takes, and their job.

    own_rows: the job with no rows but the plan's, for an FMU that takes nothing but multiples of
    one step.
    """
    coarsest_first = job.fineness[0] < job.fineness[-1]
    simulated = replace(job.run(feedback), coarsest_first=coarsest_first)
    accepted = _without_refused(simulated)
    if accepted is not None:
        return job, accepted
    multiples = replace(own_rows, fineness=_multiples(own_rows))
    again = _without_refused(multiples.run(feedback))
    if again is None:
        return job, simulated
    refused = f"Other communication steps are refused: {simulated.judged.message}"
    return multiples, replace(again, note=f"{again.note} {refused}".lstrip())


def _without_refused(simulated: Simulated) -> Simulated | None:
    """Return the simulations without refused steps; None if all were refused, or the one that is judged by --own-step."""
    refused, accepted = (
        tuple(
            run for run in simulated.everyday if (run.outcome is ReplayOutcome.FMU_FAILED) is failed
        )
        for failed in (True, False)
    )
    if not refused:
        return simulated
    if not accepted or not (simulated.coarsest_first or simulated.judged is accepted[-1]):
        return None
    note = f"{simulated.note} Other communication steps are refused: {refused[0].message}".lstrip()
    return replace(simulated, everyday=accepted, note=note)


def _multiples(job: Job) -> tuple[int, ...]:
    """Fineness by which each step of the plan is made of whole steps of the FMU, one call first."""
    declared, step = (
        experiment(job.package.description, "stepSize"),
        float(np.diff(job.plan.t).min()),
    )
    whole = round(step / declared) if declared is not None else 1
    if declared is None or not math.isclose(step, whole * declared, rel_tol=_SAME_STEP):
        whole = 1
    return tuple(FINENESS_OF_A_CALL * part for part in range(1, whole + 1) if whole % part == 0)


def _refined(
    job: Job,
    simulated: Simulated,
    feedback: Feedback | None,
    is_enough: Callable[[Simulated], bool],
) -> Simulated:
    """The simulations with ever shorter steps of Co-Simulation, until they are enough.

    A step that the FMU refuses is one step too many of ours, and leaves what came before.
    """
    unit = job.fineness[0]
    # Inputs that are lines take a call for each of their stairs.
    of_a_call = 1 if job.plan.hold is Hold.LINEAR else FINENESS_OF_A_CALL
    for parts in LADDER[len(job.fineness) :]:
        fineness = parts * unit
        too_many = job.plan.steps * fineness > _MOST_CALLS * of_a_call
        if too_many or simulated.judged.outcome is not ReplayOutcome.OK or is_enough(simulated):
            break
        finer = replace(job, fineness=(fineness,)).run(feedback)
        if finer.judged.outcome is not ReplayOutcome.OK:
            break
        simulated = replace(
            simulated,
            everyday=(*simulated.everyday, *finer.everyday),
            seconds_everyday=simulated.seconds_everyday + finer.seconds_everyday,
        )
    return simulated


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
    if package.exchange is None or own_step:
        job = replace(job, fineness=OWN_STEP[::-1])
    if own_step and trajectory.hold is not Hold.LINEAR:  # lines are stairs of many calls
        if package.cosimulation is None:
            raise FmuError(
                f"FMU {package.path}: it offers no Co-Simulation, so it has no step of its own; leave out --own-step."
            )
        variables = replace(foreign.variables, internal_step=None)
        return replace(job, variables=variables, tolerances=(), fineness=OWN_STEP)
    return with_steps_of(foreign.model, job)


def in_plan_units(foreign: Foreign, simulated: Simulated) -> Simulated:
    """The runs, in which what the FMU gave is made what the plan means.

    Raises ValueError for runs of another FMU.
    """
    first = len(foreign.variables.q) + len(foreign.variables.v)
    contacts = len(foreign.variables.lam)
    impulse_scale = foreign.scale[first : first + contacts]

    def told(run: Run) -> Run:
        impulses = [
            np.concatenate([impulse_scale * row[:contacts], row[contacts:]])
            for row in run.accumulated
        ]
        outputs = [foreign.scale * row + foreign.offset for row in run.outputs]
        return replace(run, outputs=outputs, accumulated=impulses)

    return replace(
        simulated,
        reference=tuple(map(told, simulated.reference)),
        everyday=tuple(map(told, simulated.everyday)),
    )


def _assemble(subject: Subject, job: Job, simulated: Simulated) -> Replay:
    variables, judged = job.variables, simulated.judged
    error, is_known = error_of(subject, variables, simulated, job.package)
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
            told = "its author states." if error.stated is not None else "cannot be told."
            notes.append(
                f"Results at ever shorter communication steps do not come together; how wrong they are {told}"
            )
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
