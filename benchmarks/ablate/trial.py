"""One case by one pipeline, with a rule switched off or none; runs in a child process."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from time import process_time
from typing import Any

from benchmarks.ablate.rules import RULES, observed, switched_off
from benchmarks.strangers.draw import stranger
from benchmarks.suite.plans import task
from formulations.pipelines import find_pipeline, load_method, solve_stages
from models.catalog import load_scene
from models.scene import Scene
from validate.judge import judge

CARTS = "carts"
STRANGER = "stranger"


def scene_of(case: str) -> Scene:
    """Return the scene of a case: a scene's name, `carts 3` or `stranger 1 7`."""
    kind, *numbers = case.split()
    if kind == CARTS:
        return task(int(numbers[0]))
    if kind == STRANGER:
        return stranger(*map(int, numbers)).scene
    return load_scene(case)


def attempt(request: Mapping[str, Any], arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return outcome, cost, verdict, CPU seconds and the rules that may have acted."""
    scene, pipeline = scene_of(request["case"]), find_pipeline(request["pipeline"])
    for leg in pipeline.legs:
        refusal = load_method(leg.method).accepts(scene)
        if refusal is not None:
            return {"refused": refusal}
    rule = next((item for item in RULES if item.name == request["rule"]), None)
    of_pipeline = tuple(item for item in RULES if pipeline.name in item.pipelines)
    with ExitStack() as stack:
        acting: set[str] = set()
        if rule is None:
            acting = stack.enter_context(observed(of_pipeline))
        else:
            stack.enter_context(switched_off(rule))
        begin = process_time()
        last = list(solve_stages(scene, pipeline, time_limit=request["time_limit"]))[-1]
        seconds = process_time() - begin
    verdict = "no plan" if last.trajectory is None else judge(scene, last.trajectory).verdict.value
    return {
        "outcome": last.outcome.name.lower(),
        "cost": last.cost,
        "verdict": verdict,
        "cpu": seconds,
        "acting": sorted(acting),
    }
