"""One solve of one peer, a process of its own: what counts is the CPU time of all of it, less that in which the judge looked at points."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.measure import Size, Work, cpu_seconds, run_child
from validate.store.disk import temporary_folder

# CPU seconds after which a peer of the suite is stopped; its last point then stands.
_LIMIT = 120.0


def run_one(peer: str, problem: str, seed: int, limit: float) -> dict[str, Any]:
    """The child's answer with its CPU seconds, of which it may take `limit`."""
    with temporary_folder("touchstone-mpec-") as folder:
        result, before = folder / "result.json", cpu_seconds()
        arguments = (peer, problem, str(seed), str(result))
        code = run_child("benchmarks.mpec.run_one", *arguments, cpu_limit=limit).returncode
        told: dict[str, Any] = {"reason": f"no point, ended with code {code}"}
        if code == -signal.SIGXCPU:
            told = {"reason": f"no point within {limit:g} CPU s"}
        if result.exists():
            told = json.loads(result.read_text(encoding="utf-8"))
        return {
            "peer": peer,
            "problem": problem,
            "seed": seed,
            **told,
            "cpu_s": cpu_seconds() - before - told.get("judging_s", 0.0),
        }


def reached(row: Mapping[str, Any], residual: float) -> float:
    """CPU seconds until the first point with this residual; infinite where there was none."""
    on_the_way = [point["cpu_s"] for point in row.get("path", ()) if point["residual"] <= residual]
    if on_the_way:
        return on_the_way[0]
    return row["cpu_s"] if row.get("residual", math.inf) <= residual else math.inf


def _stage(peer: str) -> Callable[[Size, Path], Work]:
    """A way through the stage `strict_contact` of the suite."""

    def work() -> Mapping[str, Any]:
        told = run_one(peer, "three_cart", 0, _LIMIT)
        words = [told["reason"]] if "reason" in told else []
        if "residual" in told:
            words.append(f"cost {told['cost']:.6g}, residual {told['residual']:.1e}")
        return {"cpu_s": told["cpu_s"], "outcome": "; ".join(words)}

    return lambda size, folder: work


mpcc, casadi_scholtes, nosnoc, pympcc, mpecss = map(
    _stage, ("mpcc", "casadi_scholtes", "nosnoc", "pympcc", "mpecss")
)
