"""Error estimate of a replay, from simulations of the same plan that differ in one setting.

- `difference` compares two runs at the plan's nodes. Without a reference, `converged` accepts the
  everyday replay only if its results at the finest steps converge.
- `overlooked` detects contacts inside one integrator step. The gap between two rows is a cubic
  through both gaps and rates; a minimum below zero repeats the replay with smaller steps.
- `with_lag_error` is for scenes without inertia, which move with a relaxation time tau. The error
  is of first order in tau, so a run at 2 tau differs from the judged run by that error.
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

# Integrator steps within an overlooked contact.
_WITHIN = 8
# Largest number of integrator steps of a repeated replay.
_MOST = 1_000_000
# Largest number of recorded points per plan step.
_MOST_PARTS = 3000


def overlooked(kernel: Kernel, replayed: Replay) -> float | None:
    """Return the step [s] that resolves an overlooked contact, or None if there is none."""
    if len(replayed.t) < 2:
        return None
    h = np.diff(replayed.t)[:, None]
    rate = -penetration_rates(kernel, replayed.q, replayed.v)
    (first, last), begins, ends = (replayed.gap[:-1], replayed.gap[1:]), rate[:-1], rate[1:]
    # Velocities of scenes without inertia jump with the inputs: rows still hold the previous
    # piece's.
    if kernel.scene.lag is not None:
        begins = 2.0 * np.divide(last - first, h, out=np.zeros_like(first), where=h > 0.0) - ends
    rows = np.repeat(np.arange(len(h) + 1), 2)[1:-1]  # both rows of each piece
    lowest = lowest_between(
        replayed.t[rows],
        replayed.gap[rows],
        np.stack([begins, ends], axis=1).reshape(len(rows), -1),
    )[0][::2]
    turns = (first > 0.0) & (last > 0.0) & (begins < 0.0) & (ends > 0.0) & (h > 0.0)
    dips = turns & (lowest < 0.0)
    if not dips.any():
        # Co-Simulation has rows only at the plan's nodes, between which contact is unknown.
        if kernel.scene.lag is not None or replayed.method != "reference":
            return None
        return _passed_through(kernel, replayed, turns)
    bend = (ends - begins)[dips] / np.broadcast_to(h, dips.shape)[dips]
    return float(np.min(2.0 * np.sqrt(-2.0 * lowest[dips] / bend))) / _WITHIN


def _passed_through(kernel: Kernel, replayed: Replay, turns: np.ndarray) -> float | None:
    """Return `overlooked` for a gap with a kink, as of a thin plate.

    The tangents at both rows intersect in contact, and the cubic positions are in contact there.
    turns: (pieces, nc) gaps that fall from open, then rise.
    """
    t, q, v, gap = replayed.t, replayed.q, replayed.v, replayed.gap
    rate, steps = -penetration_rates(kernel, q, v), []
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
            steps.append(depth * (1.0 / ends - 1.0 / begins) / _WITHIN)
    return min(steps, default=None)


def with_steps_of(subject: Subject, job: Job) -> Job:
    """Return the job with steps no longer than those of the task, however long the plan's are."""
    times, step = job.plan.t, float(subject.task.step)  # type: ignore[union-attr] - every subject that is replayed has one
    longest = math.ceil(float(np.diff(times).max()) / step - 1e-6)
    parts = min(job.parts * max(1, longest), _MOST_PARTS)
    job = _finer(replace(job, parts=parts), base_step(times) / step - 1e-6)
    return fine_enough(subject, job) if isinstance(subject, Scene) else job


def with_max_step(job: Job, longest: float) -> Job | None:
    """Return the job with steps of at most `longest` [s], None beyond a million steps."""
    if np.ptp(job.plan.t) / longest > _MOST:
        return None
    return _finer(
        replace(job, max_step=longest),
        base_step(job.plan.t) / min(job.fineness, default=1) / longest,
    )


def _finer(job: Job, factor: float) -> Job:
    return replace(
        job, fineness=tuple(max(1, math.ceil(factor)) * fineness for fineness in job.fineness)
    )


# Longest internal step in relaxation times. Runge-Kutta 4 is stable below 2.78 and keeps q + tau v
# exact; at 2 the plans of push_box are within 1e-9 m of the reference.
_LAGS_IN_A_STEP = 2.0


def fine_enough(scene: Scene, job: Job) -> Job:
    """Return the job with a coarsest everyday run that is stable at the scene's relaxation time."""
    if scene.lag is None or not job.fineness:
        return job
    return _finer(job, base_step(job.plan.t) / (_LAGS_IN_A_STEP * scene.lag) / min(job.fineness))


def twice_the_lag(package: Package, scene: Scene) -> Variables | None:
    """Return the FMU's variables with twice the relaxation time, None if there is no such time."""
    if scene.lag is None:
        return None
    twice = find_variables(package, scene.continuous(2.0 * scene.lag))
    return None if twice == find_variables(package, scene) else twice


def with_lag_error(scene: Scene, job: Job, feedback: Feedback | None, replayed: Replay) -> Replay:
    """Return the replay with the error of the relaxation time added, if there is one."""
    twice = twice_the_lag(job.package, scene) if replayed.ok else None
    if twice is None:
        return replayed
    is_reference = replayed.method == "reference"
    tolerances, fineness = (job.tolerances[:1], ()) if is_reference else ((), job.fineness[-1:])
    run = (
        replace(job, variables=twice, tolerances=tolerances, fineness=fineness).run(feedback).judged
    )
    if run.outcome is not ReplayOutcome.OK:
        note = f"The effect of the relaxation time is unknown: with twice that time, {run.message or run.outcome.value}"
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
    """Return the replay without an error estimate, and a note with the reason."""
    return replace(
        replayed,
        error=replace(replayed.error, estimate=None),
        message=f"{replayed.message} {note}".lstrip(),
    )


def by_entry(function: Callable[..., float], *of: Difference | None) -> Difference | None:
    """Apply a function to each entry of some differences; None if one is unknown."""
    known = [item for item in of if item is not None]
    if len(known) < len(of):
        return None
    return Difference(
        **{
            name: function(*(getattr(item, name) for item in known))
            for name in ("position", "state", "gap")
        }
    )


# An everyday replay within this factor of its step-halving difference is explained by its step: to
# first order both are equal, and an event within a step makes them vary.
_EXPLAINED = 3.0


def difference(one: Recorded | None, other: Recorded | None) -> Difference | None:
    """Return the largest difference of two simulations over the nodes, None if one is None."""
    if one is None or other is None:
        return None
    state = np.hypot(
        np.linalg.norm(one.q - other.q, axis=1), np.linalg.norm(one.v - other.v, axis=1)
    )
    position, gap = (
        float(np.abs(part).max(initial=0.0)) for part in (one.q - other.q, one.gap - other.gap)
    )
    return Difference(position=position, state=float(state.max()), gap=gap)


# Relative difference of equal runs: rounding of ten thousand steps.
_SAME = 1e-10


def largest_difference(runs: Sequence[Recorded]) -> Difference | None:
    """Return the largest difference of any two simulations, None for fewer than two."""
    differences = [difference(one, other) for one, other in combinations(runs, 2)]
    return by_entry(lambda *values: max(values), *differences) if differences else None


def all_the_same(runs: Sequence[Recorded]) -> bool:
    """Return whether results agree to rounding: the FMU then ignores the step."""
    first, *others = (np.hstack([run.q, run.v]) for run in runs)
    size = _SAME * np.abs(first).max(initial=0.0)
    return all((np.abs(first - other) <= size).all() for other in others)


def converged(runs: Sequence[Recorded], *, heeds: bool) -> bool:
    """Return whether the three finer of the last four results differ less than the three coarser.

    runs: the coarsest first. heeds: the FMU obeys the step, so that equal results are right.
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
    """Return the larger difference by entry, or the one that is not None."""
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
    """Return the error of the judged run by the rule of `ReplayError`."""
    judged = step
    if has_reference:
        # If the looser reference failed, the everyday replay, another method, bounds the error.
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
    """Return the larger by entry, ignoring missing statements; None if not measured."""
    if stated is None or measured is None:
        return measured
    return by_entry(
        lambda run, known: max(run, known) if math.isfinite(known) else run, measured, stated
    )


def _judged(tolerance: float, step: float, everyday: float) -> float:
    """Return the tolerance difference, or `everyday` if step and tolerance do not explain it."""
    return tolerance if everyday <= _EXPLAINED * (step + tolerance) else max(tolerance, everyday)


def is_explained(error: ReplayError) -> bool:
    """Return whether steps and tolerances explain the everyday replay's difference."""
    return error.tolerance is None or error.estimate == error.tolerance


def error_of(
    subject: Subject, variables: Variables, simulated: Simulated, package: Package
) -> tuple[ReplayError, bool]:
    """Return the error of the judged run, and whether the everyday step error is known."""
    # A comparison needs two finished runs; a crash leaves one.
    loose, tight, everyday = None, None, list[Recorded]()
    if len(simulated.reference) == 2:
        loose, tight = (_recorded(subject, variables, run) for run in simulated.reference)
    for run in simulated.everyday:
        motion = _recorded(subject, variables, run)
        # A failed run at a long step invalidates no shorter step.
        everyday = [] if motion is None else [*everyday, motion]
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
    if run.outcome is not ReplayOutcome.OK:
        return None
    return recorded(subject, variables, run, run.knots)


def _declared(package: Package, motion: Recorded) -> Difference | None:
    tolerance = experiment(package.description, "tolerance")
    if tolerance is None:
        return None
    state = np.hypot(np.linalg.norm(motion.q, axis=1), np.linalg.norm(motion.v, axis=1))
    return Difference(
        position=tolerance * float(np.abs(motion.q).max(initial=0.0)),
        state=tolerance * float(state.max(initial=0.0)),
        gap=tolerance * float(np.abs(motion.gap).max(initial=0.0)),
    )
