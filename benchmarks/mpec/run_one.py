"""One peer, one problem, one start, in a process of its own: python -m benchmarks.mpec.run_one PEER PROBLEM SEED RESULT.json"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.mpec.macmpec import PROBLEMS

# Peers that are given a CasADi program.
PEERS = ("casadi_scholtes", "pympcc", "mpecss", "nosnoc")


class Notes:
    """What the judge says of every point that a peer believes on its way, with the CPU time it had by then (the judge's own left out); on disk at
    once, so that a run stopped at its limit leaves its last point.
    """

    def __init__(self, judge: Callable[[np.ndarray], dict[str, Any]], result: Path) -> None:
        self._judge, self._result, self._judging = judge, result, 0.0
        self._path: list[dict[str, float]] = []

    def __call__(self, point: np.ndarray) -> None:
        before = time.process_time()
        if np.all(np.isfinite(point)):
            told = self._judge(point)
            self._path.append(
                {
                    "cpu_s": before - self._judging,
                    "residual": told["residual"],
                    "cost": told["cost"],
                }
            )
            note = {**told, "path": self._path, "reason": "stopped at the limit, its last point"}
            self._result.write_text(json.dumps(note), encoding="utf-8")
        self._judging += time.process_time() - before

    def last(self, point: np.ndarray) -> dict[str, Any]:
        if not np.all(np.isfinite(point)):
            raise ArithmeticError("the point holds numbers that are not finite")
        return {**self._judge(point), "path": self._path, "judging_s": self._judging}


def by_peer(peer: str, program: Any, notes: Notes) -> dict[str, Any]:
    from benchmarks.mpec import solvers

    return notes.last(getattr(solvers, peer)(program, notes))


def on_three_cart(peer: str, seed: int, result: Path) -> dict[str, Any]:
    from benchmarks.mpec.judge import STEP, STEPS, judged, random_start

    start = random_start(seed)
    if peer in PEERS:
        from benchmarks.mpec.program import plan_of, three_cart

        return by_peer(peer, three_cart(start), Notes(lambda x: judged(plan_of(x)), result))
    from models.schemes import Scheme
    from models.trajectory import Trajectory, uniform_grid

    plan = Trajectory(
        t=uniform_grid(STEP, STEPS),
        q=start["q"],
        v=start["v"],
        u=start["u"],
        lam=start["lam"],
        scheme=Scheme.SEMI_IMPLICIT_EULER,
    )
    if peer == "mpcc":
        from formulations.pipelines import load_method
        from models.catalog import load_scene

        with load_method("mpcc").open(load_scene("three_cart")) as session:
            found = session.solve(eps=None, warm_start=plan, time_limit=600.0).trajectory
    else:
        from formulations import ContactFormulation, build_model, load_plan, read_plan
        from formulations.mpec import load, solve_mpec

        model = build_model("three_cart", ContactFormulation.COMPLEMENTARITY)
        load_plan(model, plan)
        load(solve_mpec(model))
        found = read_plan(model)
    if found is None:
        raise ArithmeticError("no plan")
    return judged({name: np.asarray(getattr(found, name)) for name in ("q", "v", "u", "lam")})


def on_macmpec(peer: str, name: str, result: Path) -> dict[str, Any]:
    from formulations.mpec import load, solve_mpec

    builder, optimum = PROBLEMS[name]
    model = builder()
    if peer not in PEERS:
        load(solve_mpec(model))
        return {**certified(model), "optimum": optimum}
    from benchmarks.mpec.program import of_pyomo

    program, variables = of_pyomo(model)

    def judge(x: np.ndarray) -> dict[str, Any]:
        for variable, number in zip(variables, x.tolist(), strict=True):
            variable.set_value(number, skip_validation=True)
        return {**certified(model), "optimum": optimum}

    return by_peer(peer, program, Notes(judge, result))


def certified(model: Any) -> dict[str, Any]:
    """Residuals recomputed from the model's values."""
    import pyomo.environ as pyo

    from formulations.mpec import certify

    certificate = certify(model)
    cost = pyo.value(next(model.component_data_objects(pyo.Objective, active=True)))
    return {
        "cost": cost, "residual": max(certificate.primal, certificate.complementarity),
        "b_stationary": certificate.b_stationary,
        "letter": certificate.stationarity.letter,
    }  # fmt: skip


def main(peer: str, problem: str, seed: str, result: str) -> None:
    try:
        told = (
            on_three_cart(peer, int(seed), Path(result))
            if problem == "three_cart"
            else on_macmpec(peer, problem, Path(result))
        )
    except ImportError as error:
        told = {"reason": f"not installed: {error}"}
    except Exception as error:  # noqa: BLE001 - whatever a peer raises stands in its row
        told = {"reason": f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"}
    Path(result).write_text(json.dumps(told), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
