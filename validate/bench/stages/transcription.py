"""Collocation with softplus contact: the Pyomo model, its translation, one evaluation of its functions, one factorisation, the whole chain."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from validate.bench.carts import SOFTPLUS_EPS, scene_of
from validate.bench.case import Size, Work

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
    """An iteration of Ipopt less the functions it asks for, at the first eps from a cold start; its CPU share is that of its wall time."""
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
        return {"cpu_s": seconds.cpu * share / iterations, "iterations": iterations, "outcome": result.outcome.name.lower()}

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
    from formulations.catalog import load_method

    session = load_method("softplus_dc").open(_warm(size), {})
    plan = None
    for eps in SOFTPLUS_EPS[:-1]:
        plan = session.solve(eps=eps, warm_start=plan, time_limit=_NO_LIMIT).trajectory

    def work() -> Mapping[str, Any]:
        solution = session.solve(eps=SOFTPLUS_EPS[-1], warm_start=plan, time_limit=_NO_LIMIT)
        return {"outcome": solution.outcome.name.lower(), "iterations": solution.iterations, "value": solution.cost}

    return work


def _warm(size: Size) -> Any:
    """The scene, with everything imported and compiled that it needs, and a small plan made."""
    from models.codegen.kernel import load_kernel

    scene = scene_of(size)
    load_kernel(scene)
    _built(scene_of(_TINY))
    _chain(scene_of(_TINY), SOFTPLUS_EPS[:1])
    return scene


def _built(scene: Any) -> Any:
    from formulations import ContactLaw, build_model

    return build_model(scene, ContactLaw.SOFTPLUS, eps=SOFTPLUS_EPS[0])


def _chain(scene: Any, schedule: tuple[float, ...]) -> Mapping[str, Any]:
    from formulations.catalog import load_method

    plan, solution, iterations = None, None, 0
    with load_method("softplus_dc").open(scene, {}) as session:
        for eps in schedule:
            solution = session.solve(eps=eps, warm_start=plan, time_limit=_NO_LIMIT)
            plan = solution.trajectory
            iterations += solution.iterations
    return {} if solution is None else {"outcome": solution.outcome.name.lower(), "iterations": iterations, "value": solution.cost}
