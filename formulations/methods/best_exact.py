"""Exact contact on every scene, from a cold start: several ways are gone, and the cheapest plan is kept.

    contacts that are open or closed:  mpcc, which searches their modes; it has a plan -> done
    else four ways:                    relaxed_lcp walked down from eps = 0.9, and from 1e-2 -> strict_lcp
                                       softplus_dc walked down from eps = 1e-3               -> strict_lcp
                                       softplus_multiple_shooting, eps = 1e-3 .. 1e-48       -> strict_lcp

A walk chooses its own eps (`transcription.homotopy`). No way is the best one: exact cost by the first to the fourth, transport 0.704, 0.916, 0.701 and 1.84,
two_finger_lift 59.410, 59.399, 77.2 and 59.410, hopper_planar none, none, 737.8 and 748.8, a drawer pushed shut over a rough rail 25.9, 26.5, none and 9.5.
Where the loosest relaxation has no plan a tighter one is not tried, and a walk that did not come to its end is not followed by strict_lcp while another
way has a plan: that is where 77.2 comes from, and from a cold start 18214 for hopper_planar, in 1600 iterations. Multiple shooting may stop at its limit:
its plan is nearly that of its inputs, and strict_lcp ends near it.

An exact plan solves the equations of its grid, and a robot does not move on a grid. So each is followed on finer steps by linear feedback around it
(`departure`): how far the motion leaves the plan and misses the goal, and what the feedback takes of the plan's own inputs, in parts of what the scene
allows. A plan with more than 1 is taken only where there is no other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from time import monotonic

import numpy as np

from formulations.grids import input_bounds
from formulations.method import Clock, Kind, Method, Options, Session, option, without_inputs
from formulations.pipelines import MULTIPLE_SHOOTING_COUNT, MULTIPLE_SHOOTING_EPS, RELAXED_EPS, RELAXED_FROM, SOFTPLUS_EPS, load_method
from formulations.solution import Attempt, Outcome, Seconds, Solution
from formulations.transcription.method import ended
from models.codegen.steps import load_steps
from models.scene import Scene
from models.scene.goal import goal_state, miss
from models.trajectory import Trajectory

# (method, its options, eps that are asked for)
_WAYS: tuple[tuple[str, Mapping[str, float], tuple[float, ...]], ...] = (
    ("relaxed_lcp", {"first_eps": RELAXED_FROM}, RELAXED_EPS[-1:]),
    ("relaxed_lcp", {"first_eps": RELAXED_EPS[0]}, RELAXED_EPS[-1:]),
    ("softplus_dc", {"first_eps": SOFTPLUS_EPS[0]}, SOFTPLUS_EPS[-1:]),
    ("softplus_multiple_shooting", {"max_iterations": MULTIPLE_SHOOTING_COUNT}, MULTIPLE_SHOOTING_EPS),
)
# Part of a cost by which two are the same.
_SAME = 1e-9
# Steps in one of the plan's on which it is followed: on ten feedback seems to take a tenth less (hopper_planar: 0.80 instead of 0.87 of the plan's
# inputs). What it may take where the scene sets no limit; what is said of a motion that leaves every bound.
_FINER, _SHARE, _LOST = 50, 0.5, 1e6
_LIMITS = ("replay_error", "replay_terminal_position_error", "replay_terminal_velocity_error", "feedback_share")
_DEPARTURE = "departure"
_DEPARTS = (
    "On steps a fiftieth as long the motion departs from it, with feedback, by {:.3g} times what the scene allows: its grid is too coarse."
)


@dataclass(frozen=True, kw_only=True)
class BestExactOptions(Options):
    """Options of `best_exact`."""

    all_ways: bool = option(False, "go the other ways too where mpcc has a plan")


class BestExactSession(Session):
    """Opens the sessions of the other methods, one after the other."""

    def __init__(self, method: BestExact, scene: Scene, options: BestExactOptions) -> None:
        self._method, self._scene, self._options = method, scene, options

    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        """Find the cheapest plan of all ways; the walks start from the plan given too. Raises TrajectoryError for a plan of another grid."""
        self._method.check_stage(eps, time_limit)
        ends = monotonic() + time_limit
        found = list(self._found(warm_start, ends))
        best = _best([solution for _, solution in found])
        spent = Seconds(**{name: sum(getattr(each.seconds, name) for _, each in found) for name in asdict(Seconds())})
        attempts = tuple(
            Attempt(number=number, start=words, outcome=each.outcome, cost=each.cost, seconds=each.seconds.cpu)
            for number, (words, each) in enumerate(found)
        )
        words = next(words for words, each in found if each is best)
        message = f"The best of {len(found)} ways, by {words}: {best.message}" if len(found) > 1 else best.message
        return replace(
            best,
            method=self._method.name,
            message=message if _is_followed(best) else f"{ended(message)} {_DEPARTS.format(best.residuals[_DEPARTURE])}",
            iterations=sum(each.iterations for _, each in found),
            seconds=spent,
            options=asdict(self._options),
            starts=attempts if len(found) > 1 else best.starts,
        )

    def _found(self, start: Trajectory | None, ends: float) -> Iterator[tuple[str, Solution]]:
        """What each way found, in words and as a solution of all its stages."""
        scene = self._scene
        solved: list[Solution] = []
        if load_method("mpcc").accepts(scene) is None:
            found = self._stage("mpcc", None, start, ends)
            yield "mpcc", found
            solved += [found] if found.outcome is Outcome.SOLVED else []
            if solved and not self._options.all_ways:
                return
        without: set[str] = set()  # methods with a walk that did not come to its end
        for method, options, schedule in _WAYS:
            if method in without or monotonic() >= ends:
                continue
            words = f"{method} from eps = {options.get('first_eps', schedule[0]):g}, then strict_lcp"
            walked = self._walked(method, schedule, start, ends, options)
            if walked.trajectory is None or ("first_eps" in options and solved and walked.outcome is not Outcome.SOLVED):
                without.add(method)
                yield words, replace(walked, trajectory=None, cost=None)
                continue
            exact = _after(walked, self._stage("strict_lcp", None, walked.trajectory, ends))
            if exact.outcome is Outcome.SOLVED and exact.trajectory is not None:
                exact = replace(exact, residuals={**exact.residuals, _DEPARTURE: departure(scene, exact.trajectory)})
                solved.append(exact)
            yield words, exact
        if not solved and monotonic() < ends:
            yield "strict_lcp", self._stage("strict_lcp", None, start, ends)

    def _walked(
        self, method: str, schedule: tuple[float, ...], start: Trajectory | None, ends: float, options: Mapping[str, object]
    ) -> Solution:
        """The last stage before one that stalls, with the iterations and seconds of those up to it."""
        with load_method(method).open(self._scene, options) as session:
            walked = session.solve(eps=schedule[0], warm_start=start, time_limit=max(1e-3, ends - monotonic()))
            for eps in schedule[1:]:
                found = session.solve(eps=eps, warm_start=walked.trajectory, time_limit=max(1e-3, ends - monotonic()))
                if found.trajectory is None or found.outcome not in (Outcome.SOLVED, Outcome.ITERATION_LIMIT):
                    break
                walked = _after(walked, found)
        return walked

    def _stage(self, name: str, eps: float | None, start: Trajectory | None, ends: float, **options: object) -> Solution:
        with load_method(name).open(self._scene, options) as session:
            return session.solve(eps=eps, warm_start=start, time_limit=max(1e-3, ends - monotonic()))


def _is_followed(found: Solution) -> bool:
    return found.residuals.get(_DEPARTURE, 0.0) <= 1.0


@np.errstate(over="ignore", invalid="ignore")
def departure(scene: Scene, plan: Trajectory) -> float:
    """How far the true motion departs from a plan on finer steps with linear feedback around it: the largest part of what the scene allows.

    Feedback is the time-varying LQR with an error of the nominal size worth all of an input, held over a step of the plan and kept within the bounds.

    Returns
    -------
    float
        Of distance from the plan's positions, of distance from the goal's positions and velocities at the end, each over the scene's limit, and of the
        feedback's root mean square over that of the inputs, each in half their range, over its limit [-].

    Raises
    ------
    KernelError
        For a plan of another scene.
    """
    steps, h, x_plan = load_steps(scene), scene.task.step / _FINER, np.hstack([plan.q, plan.v])
    lower, upper = input_bounds(scene)
    size, half = np.tile([item.nominal for item in scene.coordinates], 2), (upper - lower) / 2.0
    half = np.where(np.isfinite(half), half, np.abs(plan.u).max(axis=0, initial=1e-9))
    after, by_x, by_u = x_plan[:-1], np.eye(len(size))[None], np.zeros((1, len(size), scene.nu))
    for _ in range(_FINER):
        part = steps.linearise(after, plan.u, h)
        if part is None:
            return _LOST
        after, by_x, by_u = part.next, part.A @ by_x, part.A @ by_u + part.B
    by_x, by_u = by_x * size / size[:, None], by_u * half / size[:, None]
    goal = goal_state(scene.task)
    value, gains = np.diag(np.where(np.isnan(goal), 1.0, float(plan.steps))), np.empty((plan.steps, scene.nu, len(size)))
    for t in reversed(range(plan.steps)):
        if not np.isfinite(value).all():
            return _LOST
        gains[t] = np.linalg.solve(np.eye(scene.nu) + by_u[t].T @ value @ by_u[t], by_u[t].T @ value @ by_x[t])
        value = np.eye(len(size)) + by_x[t].T @ value @ (by_x[t] - by_u[t] @ gains[t])
    x, u, off = x_plan[0], np.empty_like(plan.u), 0.0
    for t in range(plan.steps):
        u[t] = np.clip(plan.u[t] - half * (gains[t] @ ((x - x_plan[t]) / size)), lower, upper)
        motion = steps.rollout(x, np.repeat(u[t : t + 1], _FINER, axis=0), h)
        if motion.diverged:
            return _LOST
        x, off = np.concatenate([motion.q[-1], motion.v[-1]]), max(off, float(np.abs(motion.q[-1] - plan.q[t + 1]).max()))
    position, velocity = (float(np.linalg.norm(part)) for part in np.split(miss(x, goal), 2))
    share = float(np.linalg.norm((u - plan.u) / half) / max(np.linalg.norm(plan.u / half), 1e-300))
    allowed = {name: None if (limit := scene.limit(name)) is None else limit.value for name in _LIMITS}
    allowed["feedback_share"] = allowed["feedback_share"] or _SHARE
    return min(max(value / limit for value, limit in zip((off, position, velocity, share), allowed.values(), strict=True) if limit), _LOST)


def _after(walked: Solution, exact: Solution) -> Solution:
    """The exact solution with the iterations and seconds of the walk before it."""
    seconds = {name: value + getattr(exact.seconds, name) for name, value in asdict(walked.seconds).items()}
    return replace(exact, iterations=walked.iterations + exact.iterations, seconds=Seconds(**seconds))


def _best(found: list[Solution]) -> Solution:
    """The cheapest that is solved and followed, the first of those that differ by rounding; else that is solved; else any plan, or the last word."""
    solved = [each for each in found if each.outcome is Outcome.SOLVED]
    priced = [(each.cost, each) for each in [*filter(_is_followed, solved)] or solved or found if each.cost is not None]
    if not priced:
        return found[-1]
    least = min(cost for cost, _ in priced)
    return next(each for cost, each in priced if cost <= least + _SAME * abs(least))


class BestExact(Method[BestExactOptions]):
    """Exact contact by several ways."""

    name = "best_exact"
    title = "Exact contact, the cheapest plan of several ways"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = BestExactOptions

    def accepts(self, scene: Scene) -> str | None:
        """Refuse scenes without inputs."""
        return without_inputs(scene, "plan")

    def session(self, scene: Scene, options: BestExactOptions, clock: Clock) -> Session:
        """Open a session, which opens those of the ways as it goes them."""
        clock.stop()
        return BestExactSession(self, scene, options)


METHOD = BestExact()
