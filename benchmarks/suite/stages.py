"""Our stages of the suite: function(size, folder) prepares, and returns the work that is measured."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import Size, Work, cpu_seconds, scratch
from benchmarks.suite.carts import SOFTPLUS_EPS, push, pushed_plan, scene_of
from models.codegen.kernel import load_kernel
from models.fmu import build_fmu
from models.scene import Scene
from validate.fmi.description import read_package, unpacked
from validate.judge.replay.everyday import simulate
from validate.judge.replay.run import replay
from validate.judge.replay.subject import find_variables
from validate.judge.replay.wiring import HeldInputs

_OTHER = Size(2, 5)


def scene_compile(size: Size, folder: Path) -> Work:
    """Equations of motion, C code, and the compiler's run."""
    return _afresh(lambda scene: load_kernel(scene).path, size, folder)


def fmu_build(size: Size, folder: Path) -> Work:
    """A whole FMU 2.0: code, description, binary, archive."""
    return _afresh(build_fmu, size, folder)


def _afresh(build: Callable[[Scene], Path], size: Size, folder: Path) -> Work:
    """Another scene first, so that libraries and the compiler itself are in memory."""
    os.environ["TOUCHSTONE_CACHE"] = str(scratch(folder))
    build(scene_of(_OTHER))

    def work() -> Mapping[str, Any]:
        os.environ["TOUCHSTONE_CACHE"] = str(scratch(folder))
        return {"value": float(build(scene_of(size)).stat().st_size)}

    return work


_TINY = Size(3, 5)
# Longer than any measurement may take [s].
_NO_LIMIT = 1e5


def pyomo_build(size: Size, folder: Path) -> Work:
    """Scene -> Pyomo model."""
    scene = _warm(size)
    return lambda: {"value": float(_built(scene).nvariables())}


def translate(size: Size, folder: Path) -> Work:
    """Pyomo model -> Ipopt's functions, their structure and code."""
    from formulations.ipopt import compile_model

    model = _built(_warm(size))
    return lambda: {"value": float(compile_model(model).n)}


def evaluate(size: Size, folder: Path) -> Work:
    """Objective, constraints, gradient, Jacobian and Hessian at one point: what an iteration of Ipopt asks for."""
    from formulations.ipopt import compile_model

    problem = compile_model(_built(_warm(size)))
    x = problem.start()[0]
    lagrange = np.ones(problem.m)

    def work() -> Mapping[str, Any]:
        value = problem.objective(x)
        problem.constraints(x)
        problem.gradient(x)
        problem.jacobian(x)
        problem.hessian(x, lagrange, 1.0)
        return {"value": float(value)}

    return work


def linear_algebra(size: Size, folder: Path) -> Work:
    """An iteration of Ipopt less the functions it asks for, at the first eps from a cold start.

    Its CPU share is that of its wall time.
    """
    return _iteration(size, {})


def with_mumps(size: Size, folder: Path) -> Work:
    """`linear_algebra` with the linear solver that came with Ipopt."""
    return _iteration(size, {"linear_solver": "mumps"})


def _iteration(size: Size, options: Mapping[str, Any]) -> Work:
    from formulations.ipopt import compile_model, solve

    problem = compile_model(_built(_warm(size)))

    def work() -> Mapping[str, Any]:
        result = solve(problem, options=options)
        seconds = result.seconds
        share = seconds.linear_algebra / seconds.wall if seconds.wall > 0 else 1.0
        iterations = max(1, result.iterations)
        return {
            "cpu_s": seconds.cpu * share / iterations,
            "iterations": iterations,
            "outcome": result.outcome.name.lower(),
        }

    return work


def softplus_chain(size: Size, folder: Path) -> Work:
    """Scene -> the plans at three eps."""
    scene = _warm(size)
    return lambda: _chain(scene, SOFTPLUS_EPS)


def cold_step(size: Size, folder: Path) -> Work:
    """Scene -> the plan at the last eps, from a cold start."""
    scene = _warm(size)
    return lambda: _chain(scene, SOFTPLUS_EPS[-1:])


def eps_step(size: Size, folder: Path) -> Work:
    """The plan at the last eps from that at the one before, in a session that is open."""
    from formulations.pipelines import load_method

    session = load_method("softplus_dc").open(_warm(size), {})
    plan = None
    for eps in SOFTPLUS_EPS[:-1]:
        plan = session.solve(eps=eps, warm_start=plan, time_limit=_NO_LIMIT).trajectory

    def work() -> Mapping[str, Any]:
        solution = session.solve(eps=SOFTPLUS_EPS[-1], warm_start=plan, time_limit=_NO_LIMIT)
        return {
            "outcome": solution.outcome.name.lower(),
            "iterations": solution.iterations,
            "value": solution.cost,
        }

    return work


def _warm(size: Size) -> Any:
    """The scene, with everything imported and compiled that it needs, and a small plan made."""
    scene = scene_of(size)
    load_kernel(scene)
    _built(scene_of(_TINY))
    _chain(scene_of(_TINY), SOFTPLUS_EPS[:1])
    return scene


def _built(scene: Any) -> Any:
    from formulations import ContactFormulation, build_model

    return build_model(scene, ContactFormulation.SOFTPLUS, eps=SOFTPLUS_EPS[0])


def _chain(scene: Any, schedule: tuple[float, ...]) -> Mapping[str, Any]:
    from formulations.pipelines import load_method

    plan, solution, iterations = None, None, 0
    with load_method("softplus_dc").open(scene, {}) as session:
        for eps in schedule:
            solution = session.solve(eps=eps, warm_start=plan, time_limit=_NO_LIMIT)
            plan = solution.trajectory
            iterations += solution.iterations
    return (
        {}
        if solution is None
        else {
            "outcome": solution.outcome.name.lower(),
            "iterations": iterations,
            "value": solution.cost,
        }
    )


# Iterations of one call; the rate is so small that none of them leaves the plan it starts from.
_ITERATIONS = 100
_RATE = 1e-9


def gd_iteration(size: Size, folder: Path) -> Work:
    """Loss, gradient, history, stopping rule, step and projection on the bounds, as the methods of single shooting run it."""
    from formulations.shooting.descent import descend
    from formulations.shooting.objective import Objective
    from formulations.shooting.options import DescentOptions
    from models.contact_law import ContactLaw

    objective = Objective(load_kernel(scene_of(size)), law=ContactLaw.RELU)
    u, options = push(size.steps), DescentOptions(learning_rate=_RATE, iterations=_ITERATIONS)
    descend(objective, u, DescentOptions(learning_rate=_RATE, iterations=2), 1e5)

    def work() -> Mapping[str, Any]:
        began = cpu_seconds()
        descent = descend(objective, u, options, 1e5)
        return {
            "cpu_s": (cpu_seconds() - began) / _ITERATIONS,
            "iterations": _ITERATIONS,
            "value": descent.history["gradient_norm"][0],
        }

    return work


# Internal steps a plan step.
FINENESS = 50


def cs_replay(size: Size, folder: Path) -> Work:
    """An unpacked FMU stepped through the plan; value: position of the first body at the end."""
    scene, plan = scene_of(size), pushed_plan(size)
    opened = unpacked(read_package(build_fmu(scene)))
    package = opened.__enter__()  # kept open as long as the work is
    variables, inputs = find_variables(package, scene), HeldInputs(plan)
    simulate(package, variables, plan.start, HeldInputs(pushed_plan(_TINY)), FINENESS)

    def work(_kept: object = opened) -> Mapping[str, Any]:
        run = simulate(package, variables, plan.start, inputs, FINENESS)
        return {
            "outcome": run.outcome.name.lower(),
            "value": float(np.asarray(run.outputs)[run.knots[-1], 0]),
        }

    return work


def whole_replay(size: Size, folder: Path) -> Work:
    """As `validate all` judges a plan: the reference at two tolerances, Co-Simulation at two steps."""
    scene, plan = scene_of(size), pushed_plan(size)
    fmu = build_fmu(scene)
    replay(scene_of(_TINY), build_fmu(scene_of(_TINY)), pushed_plan(_TINY))

    def work() -> Mapping[str, Any]:
        result = replay(scene, fmu, plan)
        return {"outcome": result.outcome.name.lower(), "value": float(result.q[-1, 0])}

    return work
