"""Pipelines that begin alike, of methods that count how often they ran and can kill their campaign.

And of engines that lose their workers.

COUNTS names a folder; each run of a method leaves a file in it. KILL names a method whose first
runs, as many as KILLS says or one, end the process its cell was started by: for campaigns that run
one cell at a time, or two may be the first. ONLY names the pipelines in order, if not all; those of
ASKED only run if named there.
"""

import os
import signal
import time
import uuid
from dataclasses import replace
from pathlib import Path

import psutil
from campaign_fakes import PLUGIN, FakeMethod, FakeOptions

from formulations.method import Clock, Kind, Leg, Pipeline, Session
from formulations.solution import Outcome, Solution
from models.scene import Scene
from models.trajectory import Trajectory


def _begun_by() -> int:
    """The number of the process, a campaign or a Dask worker, above the supervisor of this child and what that was forked from."""
    above = (
        parent
        for parent in psutil.Process().parents()
        if not any("validate.processes.supervisor" in word for word in parent.cmdline())
    )
    return next(above).pid


def _counted(name: str, outcome: Outcome = Outcome.SOLVED):
    def act() -> Outcome:
        folder = Path(os.environ["COUNTS"])
        (folder / f"{name}-{uuid.uuid4().hex}").touch()
        if os.environ.get("KILL") == name and len(list(folder.glob(f"{name}-*"))) <= int(
            os.environ.get("KILLS", "1")
        ):
            os.kill(_begun_by(), signal.SIGKILL)
            time.sleep(1000)  # we die with it
        return outcome

    return act


def _used_up() -> Outcome:
    """Three quarters of the cell's time limit, which is what it has for solving."""
    _counted("slow")()
    time.sleep(0.75 * float(os.environ["LIMIT"]) + 0.2)
    return Outcome.TIME_LIMIT


def _falls() -> None:
    """Its cell ends here and leaves no record."""
    os.kill(os.getpid(), signal.SIGKILL)


class _ColdSession(Session):
    """Leaves whatever it is given for the first guess."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def start_used(self, warm_start: Trajectory | None) -> Trajectory | None:
        return None

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        return self._session.solve(eps=eps, warm_start=None, time_limit=time_limit)


class _Cold(FakeMethod):
    def session(self, scene: Scene, options: FakeOptions, clock: Clock) -> Session:
        return _ColdSession(super().session(scene, options, clock))


METHODS = {
    method.name: method
    for method in (
        FakeMethod("relaxing", _counted("relaxing"), kind=Kind.INDIRECT, needs_eps=True),
        FakeMethod("tuning", _counted("tuning"), kind=Kind.INDIRECT, needs_eps=True),
        FakeMethod("one", _counted("one")),
        FakeMethod("two", _counted("two")),
        FakeMethod("late", _counted("late", Outcome.TIME_LIMIT), kind=Kind.INDIRECT,
                   needs_eps=True),
        _Cold("cold", _counted("cold")), FakeMethod("slow", _used_up, kind=Kind.INDIRECT),
        FakeMethod("falls", _falls),
        FakeMethod("picky", _counted("picky"), refuses="it wants friction."),
    )
}  # fmt: skip
_BEGIN = Leg(method="relaxing", schedule=(1e-1, 1e-2, 1e-3))
_LATE = Leg(method="late", schedule=(1e-1,))
PIPELINES = (
    Pipeline(name="begin+one", title="begins alike", legs=(_BEGIN, Leg(method="one"))),
    Pipeline(name="begin+two", title="begins alike", legs=(_BEGIN, Leg(method="two"))),
    Pipeline(
        name="begin+tune+one",
        title="begins alike, longer",
        legs=(_BEGIN, Leg(method="tuning", schedule=(1e-1,)), Leg(method="one")),
    ),
    Pipeline(
        name="begin+tune+two",
        title="begins alike, longer",
        legs=(_BEGIN, Leg(method="tuning", schedule=(1e-1,)), Leg(method="two")),
    ),
    Pipeline(
        name="shorter",
        title="stops where others are in the midst of a leg",
        legs=(replace(_BEGIN, schedule=(1e-1, 1e-2)),),
    ),
    Pipeline(name="begin", title="is the beginning of others", legs=(_BEGIN,)),
    Pipeline(name="begin+picky", title="refused", legs=(_BEGIN, Leg(method="picky"))),
    Pipeline(name="late+one", title="out of time at first", legs=(_LATE, Leg(method="one"))),
    Pipeline(name="late+two", title="out of time at first", legs=(_LATE, Leg(method="two"))),
    Pipeline(name="cold", title="is the midst of others", legs=(Leg(method="cold"),)),
    Pipeline(
        name="begin+cold+two",
        title="starts anew in its midst",
        legs=(_BEGIN, Leg(method="cold"), Leg(method="two")),
    ),
)
ASKED = (
    Pipeline(
        name="soft+falls",
        title="its cell is lost in the end",
        legs=(Leg(method="relaxing", schedule=(1e-3,)), Leg(method="falls")),
    ),
    Pipeline(
        name="soft+one",
        title="begins like a cell that is lost",
        legs=(Leg(method="relaxing", schedule=(1e-3,)), Leg(method="one")),
    ),
    Pipeline(
        name="slow+one",
        title="has no time for the end",
        legs=(Leg(method="slow"), Leg(method="one")),
    ),
    Pipeline(
        name="slow+two",
        title="has no time for the end",
        legs=(Leg(method="slow"), Leg(method="two")),
    ),
)


def _pipelines(scene: Scene) -> tuple[Pipeline, ...]:
    only = os.environ.get("ONLY")
    every = {pipeline.name: pipeline for pipeline in (*PIPELINES, *ASKED)}
    return PIPELINES if only is None else tuple(every[name] for name in only.split())


LOSING = replace(
    PLUGIN,
    load_method={name: FakeMethod(name, _counted(name)) for name in ("fatal", "calm")}.__getitem__,
    pipelines_for=lambda scene: tuple(Pipeline(name=name, title=f"only {name}",
                                               legs=(Leg(method=name),)) for name in ("fatal",
                                               "calm")),
)  # fmt: skip
SHARING = replace(PLUGIN, load_method=METHODS.__getitem__, pipelines_for=_pipelines)
