"""Exact methods beside those of campaign_fakes.py, and a judge of theirs that never comes to an end, or crashes."""

import ctypes
import time
from collections.abc import Callable
from dataclasses import replace

import campaign_fakes

from formulations.method import Leg, Pipeline
from formulations.mpec import Certificate, Stationarity
from formulations.solution import FrontPoint, Outcome, Solution
from models.catalog import load_scene
from models.scene import Scene

CERTIFICATE = Certificate(
    primal=0.0, primal_relative=0.0, complementarity=0.0, product=0.0, forced=0.0, dual=0.0,
    given_dual=0.0, pairs=3, biactive=0,
    stationarity=Stationarity.STRONG, descent=0.0, worst="", objective=1.0,
)  # fmt: skip


def _exact(
    name: str, act: Callable[[], Solution | None] = lambda: None
) -> campaign_fakes.FakeMethod:
    method = campaign_fakes.FakeMethod(name, act)
    method.exact = True
    return method


def _front() -> Solution:
    """No plan within the smallest tolerance, one within the next."""
    none = Solution(method="front", outcome=Outcome.INFEASIBLE)
    session = campaign_fakes.METHODS["good"].open(load_scene("three_cart"), {})
    found = session.solve(eps=None, warm_start=None, time_limit=1.0)
    return replace(
        none,
        front=(FrontPoint(tolerance=0.0, solution=none), FrontPoint(tolerance=0.1, solution=found)),
    )


METHODS = {
    "soft": campaign_fakes.METHODS["soft"],
    **{name: _exact(name) for name in ("quick", "endless", "crashing")},
}
METHODS["front"] = _exact("front", _front)


def _certify(scene: Scene, solution: Solution) -> Solution:
    if solution.method == "endless":
        while True:
            time.sleep(1)
    if solution.method == "crashing":
        ctypes.string_at(0)
    points = tuple(
        replace(point, solution=replace(point.solution, certificate=CERTIFICATE))
        for point in solution.front
    )
    return replace(solution, certificate=CERTIFICATE, front=points)


def pipeline(last: str) -> Pipeline:
    """An indirect stage, an exact one whose certificate comes, and this one."""
    return Pipeline(
        name=f"soft+quick+{last}",
        title="fake",
        legs=(Leg(method="soft", schedule=(1e-1,)), Leg(method="quick"), Leg(method=last)),
    )


PLUGIN = replace(
    campaign_fakes.PLUGIN,
    load_method=METHODS.__getitem__,
    pipelines_for=lambda scene: (),
    certify=_certify,
)
