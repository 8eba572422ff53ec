"""Pipelines that begin alike, of methods that count how often they ran and can kill their campaign.

COUNTS names a folder; each run of a method leaves a file in it. KILL names a method that ends the
process its cell was started by, once or as often as KILLS says. ONLY names the pipelines, if not all.
"""

from __future__ import annotations

import os
import signal
import time
import uuid
from dataclasses import replace
from pathlib import Path

from campaign_fakes import TOOLS, FakeMethod

from formulations.method import Kind, Leg, Pipeline
from formulations.solution import Outcome
from models.scene import Scene
from validate.isolation.environment import PARENT_VARIABLE


def _counted(name: str, outcome: Outcome = Outcome.SOLVED):
    def act() -> Outcome:
        folder = Path(os.environ["COUNTS"])
        (folder / f"{name}-{uuid.uuid4().hex}").touch()
        if os.environ.get("KILL") == name and len(list(folder.glob(f"{name}-*"))) <= int(os.environ.get("KILLS", "1")):
            os.kill(int(os.environ[PARENT_VARIABLE]), signal.SIGKILL)
            time.sleep(1000)  # we die with it
        return outcome

    return act


METHODS = {
    method.name: method
    for method in (
        FakeMethod("relaxing", _counted("relaxing"), kind=Kind.INDIRECT, needs_eps=True),
        FakeMethod("tuning", _counted("tuning"), kind=Kind.INDIRECT, needs_eps=True),
        FakeMethod("one", _counted("one")),
        FakeMethod("two", _counted("two")),
        FakeMethod("late", _counted("late", Outcome.TIME_LIMIT), kind=Kind.INDIRECT, needs_eps=True),
        FakeMethod("picky", _counted("picky"), refuses="it wants friction."),
    )
}
_BEGIN, _LATE = Leg(method="relaxing", schedule=(1e-1, 1e-2, 1e-3)), Leg(method="late", schedule=(1e-1,))
PIPELINES = (
    Pipeline(name="begin+one", title="begins alike", legs=(_BEGIN, Leg(method="one"))),
    Pipeline(name="begin+two", title="begins alike", legs=(_BEGIN, Leg(method="two"))),
    Pipeline(name="begin+tune+one", title="begins alike, longer", legs=(_BEGIN, Leg(method="tuning", schedule=(1e-1,)), Leg(method="one"))),
    Pipeline(name="begin+tune+two", title="begins alike, longer", legs=(_BEGIN, Leg(method="tuning", schedule=(1e-1,)), Leg(method="two"))),
    Pipeline(name="shorter", title="stops where others are in the midst of a leg", legs=(replace(_BEGIN, schedule=(1e-1, 1e-2)),)),
    Pipeline(name="begin", title="is the beginning of others", legs=(_BEGIN,)),
    Pipeline(name="begin+picky", title="refused", legs=(_BEGIN, Leg(method="picky"))),
    Pipeline(name="late+one", title="out of time at first", legs=(_LATE, Leg(method="one"))),
    Pipeline(name="late+two", title="out of time at first", legs=(_LATE, Leg(method="two"))),
)


def _pipelines(scene: Scene) -> tuple[Pipeline, ...]:
    only = os.environ.get("ONLY")
    return tuple(pipeline for pipeline in PIPELINES if only is None or pipeline.name in only.split())


SHARING = replace(TOOLS, load_method=METHODS.__getitem__, pipelines_for=_pipelines)
