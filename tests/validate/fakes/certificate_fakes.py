"""Exact methods beside those of campaign_fakes.py, and a judge of theirs that never comes to an end, or crashes."""

import ctypes
import time
from dataclasses import replace

import campaign_fakes

from formulations.certificate.certificate import Certificate
from formulations.certificate.stationarity import Stationarity
from formulations.method import Leg, Pipeline
from formulations.solution import Solution
from models.scene import Scene

CERTIFICATE = Certificate(
    primal=0.0, primal_relative=0.0, complementarity=0.0, forced=0.0, dual=0.0,
    given_dual=0.0, pairs=3, biactive=0,
    stationarity=Stationarity.STRONG, obstacle="", descent=0.0, worst="", objective=1.0,
)  # fmt: skip


def _exact(name: str) -> campaign_fakes.FakeMethod:
    method = campaign_fakes.FakeMethod(name, lambda: None)
    method.exact = True
    return method


METHODS = {
    "soft": campaign_fakes.METHODS["soft"],
    **{name: _exact(name) for name in ("quick", "endless", "crashing")},
}


def _certify(scene: Scene, solution: Solution) -> Solution:
    if solution.method == "endless":
        while True:
            time.sleep(1)
    if solution.method == "crashing":
        ctypes.string_at(0)
    return replace(solution, certificate=CERTIFICATE)


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
