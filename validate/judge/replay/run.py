"""Replay a plan: reference at two tolerances, everyday replay at two steps, their differences."""

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

# Looser relative tolerance of the reference, 1.4e-9 m from the truth on three_cart.
LOOSE = 1e-11
# Tighter tolerance, 1e-11 m from the truth at 1.1 times the time.
TIGHT = 1e-13
# Internal steps per plan step of the everyday replay that confirms a reference.
FINENESS = (100, 200)
# Least number of rows of judged Co-Simulation, which has no rows within steps; as on three_cart.
LOOKS = 500
# Fineness with --own-step; the last, one call per plan step, is judged.
OWN_STEP = tuple(FINENESS_OF_A_CALL * parts for parts in LADDER[FINEST - 1 :: -1])
# Refinement of communication steps that do not explain the difference from the reference.
_SHORTER = 8
# Largest number of calls per plan; a small FMU takes 1 to 5 us per call.
_MOST_CALLS = 200_000
# Relative difference of equal steps; times are printed with some ten digits.
_SAME_STEP = 1e-6
# Largest number of repetitions of a replay that overlooks a contact.
_CLOSER_LOOKS = 6
# True to track the plan too, or a function from the open replay to the plan to track.
Track = bool | Callable[[Replay], Trajectory | None]
# Returns True if a replay is accurate enough for a verdict.
Decides = Callable[[Trajectory, Replay], bool]
# Largest number of contact events, beyond which a contact chatters; plans of scenes have 2 to 40.
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
    """Apply the plan's inputs, from the task's start, to the scene's FMU.

    - fineness: internal steps per plan step of the everyday replay; None: as its error needs.
    - limits: run the FMU in a child process; None: in this process, for our own FMU in a child.
    - track: replay with feedback too, or a function from the open replay to the plan to track.

    Raises ArchiveError, FmuError, TrajectoryError for a plan that does not fit, TrackingError if
    track is True and tracking fails. A failed simulation is `Replay.outcome`.
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
            """Return replay and inputs (steps, nu) [N or N m]. Raises FmuError, MachineError."""
            replayed, applied = _seeing_all(scene, kernel, job, feedback)
            return with_lag_error(scene, job, feedback, replayed), applied

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
    """Return the replay and its inputs, repeated with smaller steps while it overlooks contacts.

    There is no error estimate if that does not end.
    """
    inner = base_step(job.plan.t) / max(job.fineness, default=1)
    for _ in range(_CLOSER_LOOKS):
        simulated = _explained(scene, job, feedback)
        replayed, applied = _assemble(scene, job, simulated), _applied(simulated, job.plan)
        longest = overlooked(kernel, replayed)
        if longest is None and inner < job.max_step and not is_explained(replayed.error):
            # The everyday replay may have found a contact that the reference overlooked.
            longest = inner
        if longest is None:
            return replayed, applied
        finer = with_max_step(job, min(longest, job.max_step / 2.0))
        if finer is None:
            break
        job = finer
    return without_estimate(
        replayed, "The replay steps over a contact that is shorter than any of its steps."
    ), applied


def _applied(simulated: Simulated, plan: Trajectory) -> np.ndarray:
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
    """Replay a plan on an external FMU, always in a child process.

    - track: feedback by the FMU's own directional derivatives.
    - decides: whether a replay is accurate enough; without Model Exchange steps are refined until
      then, or up to a number of calls.
    - own_step: judge Co-Simulation with one doStep per plan step (not for linear inputs); four such
      runs give the error.

    Raises TrackingError if track is True and tracking fails, FmuError for own_step without
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
        """Return the replay and its inputs (steps, nu) [unit of each column].

        Raises FmuError, MachineError.
        """
        current = looked_at if feedback is None else job  # feedback acts at the plan's rows

        def made(simulated: Simulated) -> Replay:
            assembled = _assemble(foreign.model, current, in_plan_units(foreign, simulated))
            assembled = _pushing(foreign.model, assembled)
            if current is job:
                return assembled
            return replace(assembled, knots=np.flatnonzero(np.isin(assembled.t, trajectory.t)))

        def is_enough(simulated: Simulated) -> bool:
            candidate = made(simulated)
            whole = candidate if feedback is None else replace(opened[0], tracked=candidate)
            return candidate.error.estimate is not None and decides(trajectory, whole)

        in_units = None if feedback is None else feedback.in_units(*foreign.units)
        if package.exchange is not None and not own_step:
            simulated = _explained(foreign.model, current, in_units)
        else:
            current, simulated = _accepted(current, job, in_units)
            if not own_step:
                simulated = _refined(current, simulated, in_units, is_enough)
        applied = (_applied(simulated, current.plan) - foreign.input_offset) / foreign.input_scale
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


def _pushing(model: ForeignModel, replayed: Replay) -> Replay:
    """Return the replay with pushing contact forces, if the map has their sign wrong."""
    h = np.diff(replayed.t)[:, None]
    impulses = (h * (replayed.lam[:-1] + replayed.lam[1:]) / 2.0).sum(axis=0)
    pulls = impulses < 0.0
    if not pulls.any():
        return replayed
    names = ", ".join(
        contact.name for contact, pull in zip(model.contacts, pulls, strict=True) if pull
    )
    note = f"By the FMU contact {names} pulls, so its force is taken with the other sign; say so in the map (scale = -1)."
    lam = np.where(pulls, -1.0, 1.0) * replayed.lam
    return replace(replayed, lam=lam, message=f"{replayed.message} {note}".lstrip())


def _explained(subject: Subject, job: Job, feedback: Feedback | None) -> Simulated:
    """Return the simulations, with shorter steps if those of the job do not explain the difference.

    They are unchanged if the largest number of calls does not suffice.
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
    """Return the simulations at the steps that the FMU accepts, and their job.

    own_rows: the job with the plan's rows only, for an FMU that requires multiples of one step.
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
    """Return the simulations without refused steps, None if the judged one is refused."""
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
    """Return finenesses that divide plan steps into whole steps of the FMU, one call first."""
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
    """Return the simulations with shorter and shorter steps, until they are enough.

    A refused step ends the refinement.
    """
    unit = job.fineness[0]
    # Linear inputs take one call per stair.
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
    """Return the plan with the same inputs and rows at most `longest` [s] apart."""
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
    """Return the job of `replay_foreign`.

    Raises TrajectoryError for another shape, FmuError for own_step without Co-Simulation.
    """
    trajectory.check_fits(foreign.model)  # type: ignore[arg-type] - it has the attributes of a scene
    job = Job(
        package=package, variables=foreign.variables,
        plan=trajectory.with_inputs_in(*foreign.units[1]), start=foreign.start, limits=limits,
        tolerances=(LOOSE, TIGHT), fineness=FINENESS, event_budget=EVENT_BUDGET,
    )  # fmt: skip
    if package.exchange is None or own_step:
        job = replace(job, fineness=OWN_STEP[::-1])
    if own_step and trajectory.hold is not Hold.LINEAR:  # linear inputs need many calls
        if package.cosimulation is None:
            raise FmuError(
                f"FMU {package.path}: it offers no Co-Simulation, so it has no step of its own; leave out --own-step."
            )
        variables = replace(foreign.variables, internal_step=None)
        return replace(job, variables=variables, tolerances=(), fineness=OWN_STEP)
    return with_steps_of(foreign.model, job)


def in_plan_units(foreign: Foreign, simulated: Simulated) -> Simulated:
    """Return the runs in the plan's units. Raises ValueError for runs of another FMU."""
    first = len(foreign.variables.q) + len(foreign.variables.v)
    contacts = len(foreign.variables.lam)
    impulse_scale = foreign.scale[first : first + contacts]

    def converted(run: Run) -> Run:
        impulses = [
            np.concatenate([impulse_scale * row[:contacts], row[contacts:]])
            for row in run.accumulated
        ]
        outputs = [foreign.scale * row + foreign.offset for row in run.outputs]
        return replace(run, outputs=outputs, accumulated=impulses)

    return replace(
        simulated,
        reference=tuple(map(converted, simulated.reference)),
        everyday=tuple(map(converted, simulated.everyday)),
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
    # The FMU of a scene has indicators in this order; others have no names.
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
            source = "its author states." if error.stated is not None else "cannot be told."
            notes.append(
                f"Results at ever shorter communication steps do not come together; how wrong they are {source}"
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
