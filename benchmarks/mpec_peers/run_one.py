"""One peer, one problem, one start, in a process of its own: python run_one.py PEER PROBLEM SEED RESULT.json"""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

PROBLEMS = Path(__file__).parents[2] / "tests" / "formulations" / "mpec" / "macmpec"


def on_three_cart(peer: str, seed: int) -> dict[str, Any]:
    from judge import STEP, STEPS, judged, random_start

    start = random_start(seed)
    if peer in ("casadi_scholtes", "pympcc"):
        import solvers
        from program import plan_of, three_cart

        return judged(plan_of(solvers.finite(getattr(solvers, peer)(three_cart(start)))))
    from models.trajectory import Trajectory, uniform_grid

    plan = Trajectory(t=uniform_grid(STEP, STEPS), **start)
    if peer == "mpcc":
        from formulations.catalog import load_method
        from models.catalog import load_scene

        with load_method("mpcc").open(load_scene("three_cart")) as session:
            found = session.solve(eps=None, warm_start=plan, time_limit=600.0).trajectory
    else:
        from formulations import ContactLaw, build_model, load_plan, read_plan
        from formulations.mpec import load, solve_mpec

        model = build_model("three_cart", ContactLaw.COMPLEMENTARITY)
        load_plan(model, plan)
        load(solve_mpec(model))
        found = read_plan(model)
    if found is None:
        raise ArithmeticError("no plan")
    return judged({name: np.asarray(getattr(found, name)) for name in ("q", "v", "u", "lam")})


def on_macmpec(peer: str, name: str) -> dict[str, Any]:
    import pyomo.environ as pyo

    from formulations.mpec import certify, load, solve_mpec

    builder, optimum = macmpec()[name]
    model = builder()
    if peer == "mpec_ipopt":
        load(solve_mpec(model))
    else:
        import solvers
        from program import of_pyomo

        program, variables = of_pyomo(model)
        for variable, number in zip(variables, solvers.finite(getattr(solvers, peer)(program)), strict=True):
            variable.set_value(float(number), skip_validation=True)
    certificate = certify(model)
    cost = pyo.value(next(model.component_data_objects(pyo.Objective, active=True)))
    return {
        "cost": cost, "optimum": optimum, "residual": max(certificate.primal, certificate.complementarity),
        "b_stationary": certificate.b_stationary, "letter": certificate.stationarity.letter,
    }  # fmt: skip


def macmpec() -> dict[str, tuple[Any, float]]:
    """name -> (builder, published optimum) of every problem written for the tests."""
    found = {}
    for path in sorted(PROBLEMS.glob("*.py")):
        spec = importlib.util.spec_from_file_location(f"macmpec_{path.stem}", path)
        if spec is None or spec.loader is None:
            raise ImportError(str(path))
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        found.update({builder.__name__: (builder, optimum) for builder, optimum, _ in module.PROBLEMS})
    return found


def main(peer: str, problem: str, seed: str, result: str) -> None:
    try:
        told = on_three_cart(peer, int(seed)) if problem == "three_cart" else on_macmpec(peer, problem)
    except ImportError as error:
        told = {"reason": f"not installed: {error}"}
    except Exception as error:  # noqa: BLE001 - whatever a peer raises stands in its row
        told = {"reason": f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"}
    Path(result).write_text(json.dumps(told), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
