"""Packages for complementarity on the strict three carts, through the programs that a checkout has in benchmarks/mpec_peers.

Each solve is a process of its own, ours too: what counts is the CPU time of the whole process, less that in which the judge looked at points.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from validate.bench.case import CHECKOUT, Size, Work, scratch

# Seconds of the clock after which a package is stopped; its last point then stands.
_LIMIT = 120.0


def mpcc(size: Size, folder: Path) -> Work:
    return lambda: _run("mpcc", folder)


def casadi_scholtes(size: Size, folder: Path) -> Work:
    return lambda: _run("casadi_scholtes", folder)


def nosnoc(size: Size, folder: Path) -> Work:
    return lambda: _run("nosnoc", folder)


def pympcc(size: Size, folder: Path) -> Work:
    return lambda: _run("pympcc", folder)


def mpecss(size: Size, folder: Path) -> Work:
    return lambda: _run("mpecss", folder)


def _run(peer: str, folder: Path) -> Mapping[str, Any]:
    from validate.bench.measure import cpu_seconds

    program = CHECKOUT / "benchmarks" / "mpec_peers" / "run_one.py"
    result = scratch(folder) / "result.json"
    path = os.pathsep.join([str(CHECKOUT), os.environ.get("PYTHONPATH", "")])
    began, over = cpu_seconds(), False
    try:
        subprocess.run(
            [sys.executable, str(program), peer, "three_cart", "0", str(result)],
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            timeout=_LIMIT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        over = True
    told: dict[str, Any] = json.loads(result.read_text(encoding="utf-8")) if result.exists() else {"reason": "no answer"}
    words = [told["reason"]] if "reason" in told else []
    if "residual" in told:
        words.append(f"cost {told['cost']:.6g}, residual {told['residual']:.1e}")
    if over:
        words.append(f"stopped after {_LIMIT:g} s")
    return {"cpu_s": cpu_seconds() - began - told.get("judging_s", 0.0), "outcome": "; ".join(words)}
