"""The replay of a plan: one Co-Simulation, and the whole replay with its error estimate."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from validate.bench.carts import pushed_plan, scene_of
from validate.bench.case import Size, Work
from validate.replay import replay
from validate.replay.everyday import simulate
from validate.replay.inputs import HeldInputs
from validate.replay.package import find_variables, read_package, unpacked

# Internal steps a plan step.
FINENESS = 50
_TINY = Size(3, 5)


def cs_replay(size: Size, folder: Path) -> Work:
    """An unpacked FMU stepped through the plan; value: position of the first body at the end."""
    return _stepped(size, FINENESS)


def cs_calls(size: Size, folder: Path) -> Work:
    """The same with one internal step a plan step: what the calls cost, and no more than the least integration."""
    return _stepped(size, 1)


def _stepped(size: Size, fineness: int) -> Work:
    from models.fmu import build_fmu

    scene, plan = scene_of(size), pushed_plan(size)
    opened = unpacked(read_package(build_fmu(scene)))
    package = opened.__enter__()  # kept open as long as the work is
    variables, inputs = find_variables(package, scene), HeldInputs(plan)
    simulate(package, variables, plan.start, HeldInputs(pushed_plan(_TINY)), fineness)

    def work(_kept: object = opened) -> Mapping[str, Any]:
        run = simulate(package, variables, plan.start, inputs, fineness)
        return {"outcome": run.outcome.name.lower(), "value": float(np.asarray(run.outputs)[run.knots[-1], 0])}

    return work


def whole_replay(size: Size, folder: Path) -> Work:
    """As `validate all` judges a plan: the reference at two tolerances, Co-Simulation at three steps."""
    from models.fmu import build_fmu

    scene, plan = scene_of(size), pushed_plan(size)
    fmu = build_fmu(scene)
    replay(scene_of(_TINY), build_fmu(scene_of(_TINY)), pushed_plan(_TINY))

    def work() -> Mapping[str, Any]:
        result = replay(scene, fmu, plan)
        return {"outcome": result.outcome.name.lower(), "value": float(result.q[-1, 0])}

    return work
