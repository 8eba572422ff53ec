"""Exact contact on every scene, from a cold start: several ways are gone, and the cheapest plan is kept.

    contacts that are open or closed:  mpcc, which searches their modes; it has a plan -> done
    else three ways:                   relaxed_lcp walked down from eps = 0.9, and from 1e-2 -> strict_lcp
                                       softplus_dc walked down from eps = 1e-3               -> strict_lcp

A walk chooses its own eps (`transcription.homotopy`). No way is the best one: exact cost by the first, the second and the third, transport 0.704, 0.916 and
0.701, two_finger_lift 59.410, 59.399 and 77.2, hopper_planar none, none and 749.2. Where the loosest relaxation has no plan a tighter one is not tried, and a
walk that did not come to its end is not followed by strict_lcp while another way has a plan: that is where 77.2 comes from, and from a cold start 18214 for
hopper_planar, in 1600 iterations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from time import monotonic

from formulations.method import Clock, Kind, Method, Options, Session, option, without_inputs
from formulations.pipelines import RELAXED_EPS, RELAXED_FROM, SOFTPLUS_EPS, load_method
from formulations.solution import Attempt, Outcome, Seconds, Solution
from models.scene import Scene
from models.trajectory import Trajectory

# (method, first eps, last eps)
_WAYS = (
    ("relaxed_lcp", RELAXED_FROM, RELAXED_EPS[-1]),
    ("relaxed_lcp", RELAXED_EPS[0], RELAXED_EPS[-1]),
    ("softplus_dc", SOFTPLUS_EPS[0], SOFTPLUS_EPS[-1]),
)
# Part of a cost by which two are the same.
_SAME = 1e-9


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
        return replace(
            best,
            method=self._method.name,
            message=f"The best of {len(found)} ways, by {words}: {best.message}" if len(found) > 1 else best.message,
            iterations=sum(each.iterations for _, each in found),
            seconds=spent,
            options=asdict(self._options),
            starts=attempts if len(found) > 1 else best.starts,
        )

    def _found(self, start: Trajectory | None, ends: float) -> Iterator[tuple[str, Solution]]:
        """What each way found, in words and as a solution of all its stages."""
        scene, has_plan = self._scene, False
        if load_method("mpcc").accepts(scene) is None:
            found = self._stage("mpcc", None, start, ends)
            yield "mpcc", found
            has_plan = found.outcome is Outcome.SOLVED
            if has_plan and not self._options.all_ways:
                return
        without: set[str] = set()  # methods with a walk that did not come to its end
        for method, first, last in _WAYS:
            if method in without or monotonic() >= ends:
                continue
            words = f"{method} from eps = {first:g}, then strict_lcp"
            walked = self._stage(method, last, start, ends, first_eps=first)
            if walked.trajectory is None or (has_plan and walked.outcome is not Outcome.SOLVED):
                without.add(method)
                yield words, replace(walked, trajectory=None, cost=None)
                continue
            exact = self._stage("strict_lcp", None, walked.trajectory, ends)
            yield words, _after(walked, exact)
            has_plan = has_plan or exact.outcome is Outcome.SOLVED
        if not has_plan and monotonic() < ends:
            yield "strict_lcp", self._stage("strict_lcp", None, start, ends)

    def _stage(self, name: str, eps: float | None, start: Trajectory | None, ends: float, **options: object) -> Solution:
        with load_method(name).open(self._scene, options) as session:
            return session.solve(eps=eps, warm_start=start, time_limit=max(1e-3, ends - monotonic()))


def _after(walked: Solution, exact: Solution) -> Solution:
    """The exact solution with the iterations and seconds of the walk before it."""
    seconds = {name: value + getattr(exact.seconds, name) for name, value in asdict(walked.seconds).items()}
    return replace(exact, iterations=walked.iterations + exact.iterations, seconds=Seconds(**seconds))


def _best(found: list[Solution]) -> Solution:
    """The cheapest that is solved, the first of those that differ by rounding; where none is, the cheapest plan, else the last word."""
    solved = [each for each in found if each.outcome is Outcome.SOLVED]
    priced = [(each.cost, each) for each in solved or found if each.cost is not None]
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
