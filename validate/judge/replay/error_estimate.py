"""How wrong a replay may be: `estimate`, from simulations of the same plan that differ in one thing.

`difference` compares two runs at the plan's nodes: the reference at two tolerances, the everyday
replay at two steps, the one with the other. `local_errors` adds up what halving each step changes,
where the FMU restores its state.

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
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from models.codegen.kernel import Kernel
from models.collocation import lowest_between, penetration_rates
from models.scene import Scene
from validate.fmi.description import Package
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
    dips = (first > 0.0) & (last > 0.0) & (begins < 0.0) & (ends > 0.0) & (lowest < 0.0) & (h > 0.0)
    if not dips.any():
        return None
    bend = (ends - begins)[dips] / np.broadcast_to(h, dips.shape)[dips]
    return float(np.min(2.0 * np.sqrt(-2.0 * lowest[dips] / bend))) / _WITHIN


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
    # Two runs tell the error of the step; a third, for its order, would take as long as both.
    two = replace(job, fineness=tuple(sorted(job.fineness)[:2]))
    return _finer(two, base_step(job.plan.t) / (_LAGS_IN_A_STEP * scene.lag) / min(job.fineness))


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


# Below this position difference [m or rad] a ratio is one of roundings.
_ROUNDING = 1e-11
# Two runs that differ by less than this share of the motion are the same run: ten thousand steps
# round as much.
_SAME = 1e-10


def heeds_step(coarse: Recorded | None, fine: Recorded | None) -> bool:
    """Whether half the communication step changes anything.

    If not, the FMU has a step of its own, and what is wrong with that one does not show.
    """
    if coarse is None or fine is None:
        return True
    one, other = np.hstack([coarse.q, coarse.v]), np.hstack([fine.q, fine.v])
    return bool((np.abs(one - other) > _SAME * np.abs(other).max(initial=0.0)).any())


def local_errors(
    fine: Recorded | None,
    coarse_steps: Recorded | None,
    times: np.ndarray,
    carried: bool,
    heeds: bool,
) -> Difference | None:
    """What halving each step changed in that step, summed over the steps.

    Parameters
    ----------
    fine : the run that is kept, at the plan's nodes.
    coarse_steps : where each coarse step ended, q, v (steps, nq) and gap (steps, nc), from the fine
        run's node before it.
    times : (nodes,) [s].
    carried : an error of velocity goes on as one of position until the end, dq/dt = v. That
        overstates (bouncing_mass: 12 times the error of the
        coarser run, three_cart 4 times), the sum alone understates (0.4 to 0.6 times): forces turn an error of velocity round.
    heeds : whether the FMU is known to obey its step.

    Returns
    -------
    None without a rollback, or if half the step changes nothing and it is not known that the FMU
        heeds its step.

    Raises
    ------
    ValueError : if the two runs have other shapes.
    """
    if fine is None or coarse_steps is None:
        return None
    q, v, gap = (
        np.abs(getattr(fine, name)[1:] - getattr(coarse_steps, name)) for name in ("q", "v", "gap")
    )
    motion = np.abs(np.hstack([fine.q, fine.v]))
    if not heeds and not (np.hstack([q, v]) > _SAME * motion.max(initial=0.0)).any():
        return None
    position, velocity = q.sum(axis=0), v.sum(axis=0)
    moved = gap.sum(axis=0)
    if carried and q.shape == v.shape:
        drift = (times[-1] - times[1:]) @ v
        position = position + drift
        moved = moved + 2.0 * drift.max(initial=0.0)  # two bodies may come towards each other
    return Difference(
        position=float(position.max(initial=0.0)),
        state=float(np.hypot(np.linalg.norm(position), np.linalg.norm(velocity))),
        gap=float(moved.max(initial=0.0)),
    )


def larger(one: Difference | None, other: Difference | None) -> Difference | None:
    """Entry by entry, or the one there is."""
    return by_entry(max, one, other) or one or other


def _larger_where_stated(measured: float, stated: float) -> float:
    """What the runs say where nothing is stated."""
    return max(measured, stated) if math.isfinite(stated) else measured


def step_ratio(before: Difference | None, after: Difference | None) -> float | None:
    """Position difference of one step halving over that of the next.

    None where there is none to speak of.
    """
    if before is None or after is None or after.position < _ROUNDING:
        return None
    return before.position / after.position


# Halving the step divides an error of first order by 2, of the eighth by 256; an event within a
# step makes that vary.
_CONVERGES = 1.5, 300.0


def tells_its_error(
    first: Recorded | None, coarse: Recorded | None, fine: Recorded | None, *, heeds: bool
) -> bool:
    """Whether halving the step tells how wrong the finer run is: only if each halving changes less than the last, by as much as methods do.

    Else the FMU has a step of its own: two runs make the same steps, but for rounding, or such as
    fit into theirs. heeds : whether it is known to obey its step; then no change is no error.
    """
    before, after = difference(first, coarse), difference(coarse, fine)
    ratio = step_ratio(before, after)
    if heeds or before is None or after is None:
        return (heeds or heeds_step(coarse, fine)) and (ratio is None or ratio >= _CONVERGES[0])
    sizes = [item.position or item.gap or item.state for item in (before, after)]
    return (
        heeds_step(first, coarse)
        and _CONVERGES[0] * sizes[1] <= sizes[0] <= _CONVERGES[1] * sizes[1]
    )


def estimate(
    *,
    tolerance: Difference | None,
    step: Difference | None,
    everyday: Difference | None,
    has_reference: bool,
    ratio: float | None = None,
    rollback: Difference | None = None,
    stated: Difference | None = None,
) -> ReplayError:
    """The error of the judged trajectory by the rule that `ReplayError` states."""
    source = " and ".join(
        name for name, found in (("second run", step), ("rollback", rollback)) if found is not None
    )
    if has_reference:
        # Where the looser reference did not get to the end, the everyday replay - another method -
        # is as far away as the judged run may be wrong.
        judged = (
            tolerance
            if tolerance is not None or step is None
            else larger(everyday, step)
            if everyday is not None
            else None
        )
        explains = (
            step if step is None or stated is None else by_entry(_larger_where_stated, step, stated)
        )
        judged, stated = by_entry(_judged, tolerance, explains, everyday) or judged, None
    else:
        # All further halvings together change 1 + 1/ratio + 1/ratio^2 + ... times as much as the
        # next: as much as the last one where the ratio is 2.
        rest = max(1.0, 1.0 / (ratio - 1.0)) if ratio is not None and ratio > 1.0 else 1.0
        judged = larger(by_entry(lambda last: rest * last, step), rollback)
    if stated is not None:
        judged, source = (
            by_entry(_larger_where_stated, judged, stated) or stated,
            f"{source}, stated" if source else "stated",
        )
    return ReplayError(
        estimate=judged, tolerance=tolerance, step=step, everyday=everyday, step_ratio=ratio,
        rollback=rollback, step_source=source or "none", stated=stated,
    )  # fmt: skip


def _judged(tolerance: float, step: float, everyday: float) -> float:
    """The tolerance difference, unless the everyday replay differs from the reference by more than its own step explains."""
    return tolerance if everyday <= _EXPLAINED * (step + tolerance) else max(tolerance, everyday)


def error_of(
    subject: Subject, variables: Variables, simulated: Simulated
) -> tuple[ReplayError, bool]:
    """The error of the run that is judged, and whether that of the everyday replay's step is known: not where half the step changes nothing."""
    reference, everyday = simulated.reference, simulated.everyday
    # A run that ended the process has no other beside it: what is compared must be there twice.
    nodes = [
        recorded(subject, variables, run, run.knots) if run.outcome is ReplayOutcome.OK else None
        for run in (*reference, *everyday)
    ]
    loose, tight = nodes[:2] if len(reference) == 2 else (None, None)
    first, coarse, fine = ([None, None, None, *nodes[len(reference) :]])[-3:]
    is_known = tells_its_error(first, coarse, fine, heeds=variables.internal_step is not None)
    counts = is_known or bool(reference)
    error = estimate(
        tolerance=difference(loose, tight),
        step=difference(coarse, fine) if counts else None,
        everyday=difference(fine, tight),
        has_reference=bool(reference),
        ratio=step_ratio(difference(first, coarse), difference(coarse, fine)),
        rollback=_local_errors(subject, variables, everyday[-1], fine, carried=coarse is None)
        if everyday and counts
        else None,
        stated=subject.accuracy if isinstance(subject, ForeignModel) else None,
    )
    return error, is_known


def _local_errors(
    subject: Subject, variables: Variables, run: Run, fine: Recorded | None, carried: bool
) -> Difference | None:
    if fine is None or len(run.local) != len(run.t) - 1:
        return None
    coarse = [after - change for after, change in zip(run.outputs[1:], run.local, strict=True)]
    ends = recorded(subject, variables, Run(t=run.t[1:], outputs=coarse))
    return local_errors(
        fine,
        ends,
        np.array(run.t),
        carried,
        heeds=variables.internal_step is not None or not carried,
    )
