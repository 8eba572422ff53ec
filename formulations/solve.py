"""Solve a scene in this process, by a pipeline or by one method: what a campaign does in child processes, without judging.

stages = solve_stages(load_scene("three_cart"), find_pipeline("softplus_dc+strict"), time_limit=60.0)
stages[-1].trajectory
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from itertools import groupby
from time import monotonic
from types import MappingProxyType
from typing import TYPE_CHECKING

from formulations.method import Leg, OptionError, Pipeline
from formulations.pipelines import PIPELINES, load_method, method_names, stage_plan
from models.errors import UnknownNameError

if TYPE_CHECKING:
    from formulations.solution import Solution
    from models.scene import Scene
    from models.trajectory import Trajectory


def solve_scene(
    scene: Scene,
    name: str,
    *,
    eps: float | None = None,
    options: Mapping[str, object] = MappingProxyType({}),
    warm_start: Trajectory | None = None,
    time_limit: float = 600.0,
) -> Solution:
    """The Solution of the last stage that ran. name: a pipeline, or a method if eps or options are given or no pipeline has that name.

    time_limit: of all stages [s]. Raises UnknownNameError, OptionError.
    """
    solutions = list(solve_stages(scene, _pipeline(name, eps, options), warm_start=warm_start, time_limit=time_limit))
    return solutions[-1]


def solve_stages(
    scene: Scene, pipeline: Pipeline, *, warm_start: Trajectory | None = None, time_limit: float = 600.0
) -> Iterator[Solution]:
    """The Solutions of the stages of a pipeline in order, each from the plan of the one before it.

    The session of a method serves all stages that have its options. time_limit: of all stages together [s]; stages that it leaves no time do not run,
    but for the first. Raises OptionError.
    """
    ends = monotonic() + time_limit
    plan, is_first = warm_start, True
    for (method, options), stages in groupby(_read(pipeline), key=lambda stage: stage[:2]):
        with load_method(method).open(scene, options) as session:
            for _, _, eps in stages:
                left = ends - monotonic()
                if not is_first and left <= 0.0:
                    return
                solution = session.solve(eps=eps, warm_start=plan, time_limit=left if left > 0.0 else time_limit)
                plan, is_first = solution.trajectory or plan, False
                yield solution


def _read(pipeline: Pipeline):
    for leg, eps, options in stage_plan(pipeline):
        yield leg.method, load_method(leg.method).read_options(options), eps


def _pipeline(name: str, eps: float | None, options: Mapping[str, object]) -> Pipeline:
    known = {pipeline.name: pipeline for pipeline in PIPELINES}
    if name in known and eps is None and not options:
        return known[name]
    if name in known and name not in method_names():
        raise OptionError(
            f"pipeline {name}: its stages have their own eps and options; leave them out, or name a method: {', '.join(method_names())}."
        )
    if name not in method_names():
        close = difflib.get_close_matches(name, (*known, *method_names()), n=1)
        hint = (
            f"did you mean {close[0]}?"
            if close
            else f"there are the pipelines {', '.join(known)} and the methods {', '.join(method_names())}."
        )
        raise UnknownNameError(f"there is no pipeline or method {name!r}; {hint}")
    method = load_method(name)
    method.check_eps(eps)
    return Pipeline(name=name, title=method.title, legs=(Leg(method=name, schedule=(eps,), options=options),))
