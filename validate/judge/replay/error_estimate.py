"""How wrong a replay may be: `estimate`, from simulations of the same plan that differ in one thing.

`difference` compares two runs at the plan's nodes: the reference at two tolerances, the everyday
replay at two steps, the one with the other. Without a reference `converged` believes the steps of
the everyday replay only where its finest results come together.

`overlooked` finds contacts that the integrator stepped over: a gap that closes and opens again
within a step leaves no change of sign. Between two recorded points without an event the gap is
taken as the cubic with the gaps and their rates at both ends; a minimum below zero is such a
contact, and the replay is made again with steps small enough to see it.

`with_lag_error` is for scenes without inertia (models.scene.quasi_static), which move with a short
relaxation time tau: the error is of first order in tau, so that a run at 2 tau is as far from the
judged one as that is from the first-order model, D v = F.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from models.codegen.kernel import Kernel
from models.collocation import lowest_between, penetration_rates
from models.scene import Scene
from validate.fmi.description import Package, experiment
from validate.fmi.ladder import FINEST
from validate.judge.replay.everyday import base_step
from validate.judge.replay.job import Job, Simulated
from validate.judge.replay.result import (
    Difference,
    Recorded,
    Replay,
    ReplayError,
    ReplayOutcome,
    Run,
)
from validate.judge.replay.subject import ForeignModel, Subject, find_variables, recorded
from validate.judge.replay.wiring import Feedback, Variables

# Steps within the contact that was overlooked; and steps in all that are taken for it.
_WITHIN = 8
_MOST = 1_000_000
_MOST_PARTS = 3000


def overlooked(kernel: Kernel, replayed: Replay) -> float | None:
    """None, or the step [s] with which a contact that the replay stepped over is seen."""
    if len(replayed.t) < 2:
        return None
    h = np.diff(replayed.t)[:, None]
    rate = -penetration_rates(kernel, replayed.q, replayed.v)
    (first, last), begins, ends = (replayed.gap[:-1], replayed.gap[1:]), rate[:-1], rate[1:]
    # Without inertia velocities jump where inputs do: at the start of a piece those of the one
    # before still stand.
    if kernel.scene.lag is not None:
        begins = 2.0 * np.divide(last - first, h, out=np.zeros_like(first), where=h > 0.0) - ends
    rows = np.repeat(np.arange(len(h) + 1), 2)[1:-1]  # both of each piece
    lowest = lowest_between(
        replayed.t[rows],
        replayed.gap[rows],
        np.stack([begins, ends], axis=1).reshape(len(rows), -1),
    )[0][::2]
    turns = (first > 0.0) & (last > 0.0) & (begins < 0.0) & (ends > 0.0) & (h > 0.0)
    dips = turns & (lowest < 0.0)
    if not dips.any():
        # Co-Simulation shows nothing but the plan's nodes, between which it may have been in touch.
        if kernel.scene.lag is not None or replayed.method != "reference":
            return None
        return _passed_through(kernel, replayed, turns)
    bend = (ends - begins)[dips] / np.broadcast_to(h, dips.shape)[dips]
    return float(np.min(2.0 * np.sqrt(-2.0 * lowest[dips] / bend))) / _WITHIN


def _passed_through(kernel: Kernel, replayed: Replay, turns: np.ndarray) -> float | None:
    """As `overlooked`, of a gap that turns round at once, as that of a thin plate does.

    Its tangents at both rows meet in contact, and so do the positions there on their cubic.

    Parameters
    ----------
    turns : (pieces, nc) whether a gap is open at both rows, falls first and rises then [-].
    """
    t, q, v, gap = replayed.t, replayed.q, replayed.v, replayed.gap
    rate, found = -penetration_rates(kernel, q, v), []
    for piece, contact in np.argwhere(turns):
        h, (begins, ends) = t[piece + 1] - t[piece], rate[piece : piece + 2, contact]
        first, last = gap[piece : piece + 2, contact]
        s = (last - first - ends * h) / (begins - ends) / h
        if not 0.0 < s < 1.0 or first + begins * s * h >= 0.0:
            continue
        moved, leaves, comes = q[piece + 1] - q[piece], h * v[piece], h * v[piece + 1]
        place = q[piece] + s * leaves + s**2 * (3.0 * moved - 2.0 * leaves - comes)
        place += s**3 * (leaves + comes - 2.0 * moved)
        depth = float(kernel.penetration(place[None])[0, contact])
        if depth > 0.0:
            found.append(depth * (1.0 / ends - 1.0 / begins) / _WITHIN)
    return min(found, default=None)


def with_steps_of(subject: Subject, job: Job) -> Job:
    """The job for a plan, however long its steps are: nothing is seen less often than on the task's own grid."""
    times, step = job.plan.t, float(subject.task.step)  # type: ignore[union-attr] - every subject that is replayed has one
    longest = math.ceil(float(np.diff(times).max()) / step - 1e-6)
    parts = min(job.parts * max(1, longest), _MOST_PARTS)
    job = _finer(replace(job, parts=parts), base_step(times) / step - 1e-6)
    return fine_enough(subject, job) if isinstance(subject, Scene) else job


def with_max_step(job: Job, longest: float) -> Job | None:
    """The job with integrator steps of at most `longest` [s], in the everyday replay too.

    None where that takes more than a million steps.
    """
    if np.ptp(job.plan.t) / longest > _MOST:
        return None
    return _finer(
        replace(job, max_step=longest),
        base_step(job.plan.t) / min(job.fineness, default=1) / longest,
    )


def _finer(job: Job, factor: float) -> Job:
    """With so many times the internal steps, or more."""
    return replace(
        job, fineness=tuple(max(1, math.ceil(factor)) * fineness for fineness in job.fineness)
    )


# Relaxation times in the longest internal step of the everyday replay. Runge-Kutta 4 is stable
# below 2.78, and keeps q + tau v whatever its step: at 2 the plans of push_box are within 1e-9 m of
# the reference.
_LAGS_IN_A_STEP = 2.0


def fine_enough(scene: Scene, job: Job) -> Job:
    """The job with a coarsest everyday run that is stable at this relaxation time.

    As it is for a scene with inertia.
    """
    if scene.lag is None or not job.fineness:
        return job
    return _finer(job, base_step(job.plan.t) / (_LAGS_IN_A_STEP * scene.lag) / min(job.fineness))


def twice_the_lag(package: Package, scene: Scene) -> Variables | None:
    """The FMU's variables with twice the relaxation time.

    None for a scene with inertia, or an FMU that does not know the time.
    """
    if scene.lag is None:
        return None
    twice = find_variables(package, scene.continuous(2.0 * scene.lag))
    return None if twice == find_variables(package, scene) else twice


def with_lag_error(scene: Scene, job: Job, feedback: Feedback | None, replayed: Replay) -> Replay:
    """The replay with the lag's error in its own.

    As it is where there is none to be told (`twice_the_lag`).
    """
    twice = twice_the_lag(job.package, scene) if replayed.ok else None
    if twice is None:
        return replayed
    is_reference = replayed.method == "reference"
    tolerances, fineness = (job.tolerances[:1], ()) if is_reference else ((), job.fineness[-1:])
    run = (
        replace(job, variables=twice, tolerances=tolerances, fineness=fineness).run(feedback).judged
    )
    if run.outcome is not ReplayOutcome.OK:
        note = f"What the relaxation time does is not known: with twice as much, {run.message or run.outcome.value}"
        return without_estimate(replayed, note)
    lagging = replace(
        replayed,
        **vars(recorded(scene, twice, run)),
        t=np.array(run.t),
        knots=np.array(run.knots, dtype=np.int64),
        events=(),
    )
    lag = difference(lagging.rows(lagging.knots), replayed.rows(replayed.knots))
    error = replace(
        replayed.error, lag=lag, estimate=by_entry(operator.add, replayed.error.estimate, lag)
    )
    return replace(replayed, error=error, lagging=lagging)


def without_estimate(replayed: Replay, note: str) -> Replay:
    """The replay, of whose error nothing is known, and the note that says why."""
    return replace(
        replayed,
        error=replace(replayed.error, estimate=None),
        message=f"{replayed.message} {note}".lstrip(),
    )


def by_entry(function: Callable[..., float], *of: Difference | None) -> Difference | None:
    """A function of each entry of some differences; None if one of them is not known."""
    known = [item for item in of if item is not None]
    if len(known) < len(of):
        return None
    return Difference(
        **{
            name: function(*(getattr(item, name) for item in known))
            for name in ("position", "state", "gap")
        }
    )


# The everyday replay is explained by its own step error if it is within this factor of its step
# halving: to first order the finer run is as far from the truth as the two runs are from each
# other, and an event within a step makes that vary.
_EXPLAINED = 3.0


def difference(one: Recorded | None, other: Recorded | None) -> Difference | None:
    """Largest difference of two simulations over the nodes, or None if one of the two did not get to the end."""
    if one is None or other is None:
        return None
    state = np.hypot(
        np.linalg.norm(one.q - other.q, axis=1), np.linalg.norm(one.v - other.v, axis=1)
    )
    position, gap = (
        float(np.abs(part).max(initial=0.0)) for part in (one.q - other.q, one.gap - other.gap)
    )
    return Difference(position=position, state=float(state.max()), gap=gap)


# Two runs that differ by less than this share of the motion are the same run: ten thousand steps
# round as much.
_SAME = 1e-10


def largest_difference(runs: Sequence[Recorded]) -> Difference | None:
    """Largest difference of any two of some simulations; None of fewer than two."""
    found = [difference(one, other) for one, other in combinations(runs, 2)]
    return by_entry(lambda *values: max(values), *found) if found else None


def all_the_same(runs: Sequence[Recorded]) -> bool:
    """Whether the step changes nothing but rounding: then it is not the one that the FMU takes."""
    first, *others = (np.hstack([run.q, run.v]) for run in runs)
    size = _SAME * np.abs(first).max(initial=0.0)
    return all((np.abs(first - other) <= size).all() for other in others)


def converged(runs: Sequence[Recorded], *, heeds: bool) -> bool:
    """Whether the results at ever finer steps come together.

    Parameters
    ----------
    runs
        Results at the finest steps, the coarsest of them first.
    heeds
        Whether the FMU is known to obey the step; then results that are equal are right.

    Returns
    -------
    bool
        Whether the three finer of four differ by less than the three coarser. No of fewer than
        four.
    """
    if len(runs) < FINEST:
        return False
    last = runs[-FINEST:]
    if all_the_same(last):
        return heeds
    finer, coarser = (largest_difference(part) for part in (last[1:], last[:-1]))
    if finer is None or coarser is None:
        return False
    name = next(of for of in ("position", "gap", "state") if getattr(coarser, of) > 0.0)
    return getattr(finer, name) < getattr(coarser, name)


def larger(one: Difference | None, other: Difference | None) -> Difference | None:
    """Entry by entry, or the one there is."""
    return by_entry(max, one, other) or one or other


def estimate(
    *,
    tolerance: Difference | None,
    step: Difference | None,
    everyday: Difference | None,
    has_reference: bool,
    stated: Difference | None = None,
    declared: Difference | None = None,
) -> ReplayError:
    """The error of the judged trajectory by the rule that `ReplayError` states."""
    judged = step
    if has_reference:
        # Where the looser reference did not get to the end, the everyday replay - another method -
        # is as far away as the judged run may be wrong.
        judged = tolerance
        if tolerance is None and step is not None:
            judged = larger(everyday, step) if everyday is not None else None
        explains = larger_where_stated(step, stated) if step is not None else None
        judged = by_entry(_judged, tolerance, explains, everyday) or judged
    elif stated is not None:
        judged = larger_where_stated(step, stated) or stated
    elif declared is not None:
        judged = by_entry(max, step, declared)
    return ReplayError(
        estimate=judged, tolerance=tolerance, step=step, everyday=everyday, stated=stated
    )


def larger_where_stated(
    measured: Difference | None, stated: Difference | None
) -> Difference | None:
    """The larger of the two, and what the runs say where nothing is stated; None if not measured."""
    if stated is None or measured is None:
        return measured
    return by_entry(
        lambda run, known: max(run, known) if math.isfinite(known) else run, measured, stated
    )


def _judged(tolerance: float, step: float, everyday: float) -> float:
    """The tolerance difference, unless the everyday replay differs from the reference by more than its own step explains."""
    return tolerance if everyday <= _EXPLAINED * (step + tolerance) else max(tolerance, everyday)


def is_explained(error: ReplayError) -> bool:
    """Whether steps and tolerances explain how far the everyday replay is from the reference, if both got to the end."""
    return error.tolerance is None or error.estimate == error.tolerance


def error_of(
    subject: Subject, variables: Variables, simulated: Simulated, package: Package
) -> tuple[ReplayError, bool]:
    """The error of the run that is judged, and whether that of the everyday replay's step is known."""
    # A run that ended the process has no other beside it: what is compared must be there twice.
    loose, tight, everyday = None, None, list[Recorded]()
    if len(simulated.reference) == 2:
        loose, tight = (_recorded(subject, variables, run) for run in simulated.reference)
    for run in simulated.everyday:
        found = _recorded(subject, variables, run)
        # From a step that is too long to get to the end nothing follows of shorter ones.
        everyday = [] if found is None else [*everyday, found]
    stated = subject.accuracy if isinstance(subject, ForeignModel) else None
    if simulated.reference:
        step = largest_difference(everyday[-2:])
        error = estimate(
            tolerance=difference(loose, tight),
            step=step,
            everyday=difference(everyday[-1] if everyday else None, tight),
            has_reference=True,
            stated=stated,
        )
        return error, step is not None
    known = converged(
        everyday if simulated.coarsest_first else everyday[::-1],
        heeds=variables.internal_step is not None,
    )
    error = estimate(
        tolerance=None,
        step=largest_difference(everyday[-FINEST:]) if known else None,
        everyday=None,
        has_reference=False,
        stated=stated,
        declared=_declared(package, everyday[-1]) if known else None,
    )
    return error, known


def _recorded(subject: Subject, variables: Variables, run: Run) -> Recorded | None:
    """The run at the plan's nodes, if it got to the end."""
    if run.outcome is not ReplayOutcome.OK:
        return None
    return recorded(subject, variables, run, run.knots)


def _declared(package: Package, motion: Recorded) -> Difference | None:
    """The tolerance that an FMU declares for its own solver, of the sizes of the motion."""
    tolerance = experiment(package.description, "tolerance")
    if tolerance is None:
        return None
    state = np.hypot(np.linalg.norm(motion.q, axis=1), np.linalg.norm(motion.v, axis=1))
    return Difference(
        position=tolerance * float(np.abs(motion.q).max(initial=0.0)),
        state=tolerance * float(state.max(initial=0.0)),
        gap=tolerance * float(np.abs(motion.gap).max(initial=0.0)),
    )
