"""The strict three carts (T = 500) and small MacMPEC problems: ours beside CasADi + Ipopt, pympcc, mpecss and nosnoc, all in one run.

    pip install -e '.[bench]' && python benchmarks/bench_mpec_peers.py [--seeds 20] [--package-seeds 20] [--limit 60] [--no-macmpec] [--out FILE.json]

Every solve is a process of its own (one thread, a limit of CPU seconds): what is told is the CPU time of the whole process, imports, model and
derivatives included. All start from the same seeded rollouts; one function in NumPy (mpec_peers/judge.py) recomputes cost and residual of
every point that a peer believes on its way (its own time left out), so that peers can be compared at equal residual: the CPU seconds until the
residual is at most 1e-6, and 1e-10. Residual: largest violation of any equation, in SI units, of min(lam, lam - k phi) too. A peer that tells
nothing on its way (ours, mpecss, nosnoc) is charged its whole time. docs/mpec_peers.md holds a measured table.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PEERS = ("mpcc", "mpec_ipopt", "casadi_scholtes", "nosnoc", "pympcc", "mpecss")
GENERAL, PACKAGES = PEERS[1:], PEERS[3:]
# Small problems whose conditions have one bound on each side, so that every peer can be given them.
MACMPEC = (
    "bard1", "bilin", "dempe", "desilva", "df1", "gauvin", "jr1", "kth3", "outrata31", "ralph1", "scholtes1", "scholtes3", "scholtes4", "scholtes5",
    "stackelberg1",
)  # fmt: skip
# Residuals at which the carts are compared; on MacMPEC the one of a point, and the distance from the published optimum (relative) that counts as
# reaching it: a relaxation at eps = 1e-8 can have 1e-4 where both sides of a pair are small.
_EQUAL, _LOOSE, _REACHED = (1e-6, 1e-10), 1e-3, 1e-4


def run_one(peer: str, problem: str, seed: int, limit: float) -> dict[str, Any]:
    """The child's answer with its CPU seconds."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        environment = {**os.environ, **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")}
        environment["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), environment.get("PYTHONPATH", "")])
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        child = subprocess.Popen(
            [sys.executable, str(HERE / "mpec_peers" / "run_one.py"), peer, problem, str(seed), str(result)],
            env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(limit) + 1, int(limit) + 2)),
        )  # fmt: skip
        child.wait()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        stopped = (
            f"no point within {limit:g} CPU s" if child.returncode == -signal.SIGXCPU else f"no point, ended with code {child.returncode}"
        )
        told: dict[str, Any] = {"reason": stopped}
        if result.exists():
            told = json.loads(result.read_text(encoding="utf-8"))
        return {"peer": peer, "problem": problem, "seed": seed, **told, "cpu_s": cpu - told.get("judging_s", 0.0)}


def reached(row: dict[str, Any], residual: float) -> float:
    """CPU seconds until the first point with this residual; infinite where there was none."""
    on_the_way = [point["cpu_s"] for point in row.get("path", ()) if point["residual"] <= residual]
    if on_the_way:
        return on_the_way[0]
    return row["cpu_s"] if row.get("residual", math.inf) <= residual else math.inf


def carts_table(rows: list[dict[str, Any]]) -> list[str]:
    """A row a peer: cost and last residual of the runs that have a point; CPU seconds until a residual, medians of all runs (never: more than
    half did not reach it), and how many did."""
    lines = [
        "| peer | runs | cost: best | median | worst | last residual: median | miss: median | CPU s: median (range) | CPU s to 1e-6 | reached "
        "| CPU s to 1e-10 | reached | remark |",
        "|---|" + "---:|" * 11 + "---|",
    ]
    for peer in dict.fromkeys(row["peer"] for row in rows):
        mine = [row for row in rows if row["peer"] == peer]
        points = [row for row in mine if "residual" in row]
        reasons = [row["reason"] for row in mine if "reason" in row]
        remark = "; ".join(f"{reasons.count(reason)}: {reason}" for reason in sorted(set(reasons)))
        cost, residual, miss = ([row[key] for row in points] for key in ("cost", "residual", "miss"))
        figures = ("", "", "", "", "")
        if points:
            figures = (f"{min(cost):.4f}", f"{statistics.median(cost):.4f}", f"{max(cost):.4f}",
                       f"{statistics.median(residual):.1e}", f"{statistics.median(miss):.1e}")  # fmt: skip
        cpu = [row["cpu_s"] for row in mine]
        equal = []
        for limit in _EQUAL:
            seconds = [reached(row, limit) for row in mine]
            middle = statistics.median(seconds)
            equal += [f"{middle:.1f}" if math.isfinite(middle) else "never", f"{sum(map(math.isfinite, seconds))}/{len(mine)}"]
        cells = (peer, str(len(mine)), *figures, f"{statistics.median(cpu):.1f} ({min(cpu):.1f}-{max(cpu):.1f})", *equal, remark)
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def macmpec_table(rows: list[dict[str, Any]]) -> list[str]:
    """A row a problem: cost, residual, CPU seconds of each peer; and how many reached the published optimum."""
    peers = list(dict.fromkeys(row["peer"] for row in rows))
    lines = [
        "| problem | published | " + " | ".join(f"{peer}: cost, residual, CPU s" for peer in peers) + " |",
        "|---|" + "---:|" * (len(peers) + 1),
    ]
    for name in dict.fromkeys(row["problem"] for row in rows):
        mine = {row["peer"]: row for row in rows if row["problem"] == name}
        optimum = next((row["optimum"] for row in mine.values() if "optimum" in row), float("nan"))
        cells = [
            f"{row['cost']:.6g}, {row['residual']:.0e}, {row['cpu_s']:.1f}" if "cost" in row else row["reason"][:60]
            for row in mine.values()
        ]  # fmt: skip
        lines.append(f"| {name} | {optimum:.6g} | " + " | ".join(cells) + " |")
    lines.append("")
    for peer in peers:
        mine = [row for row in rows if row["peer"] == peer]
        count = sum(
            "cost" in row and row["residual"] <= _LOOSE and abs(row["cost"] - row["optimum"]) <= _REACHED * max(1.0, abs(row["optimum"]))
            for row in mine
        )
        exact = sum(row.get("residual", math.inf) <= _EQUAL[1] for row in mine)
        cpu = statistics.median(row["cpu_s"] for row in mine)
        lines.append(
            f"- {peer}: published optimum reached by {count} of {len(mine)}; residual <= 1e-10 in {exact}; CPU s, median {cpu:.1f}"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="random starts a peer (default 20)")
    parser.add_argument("--package-seeds", type=int, default=20, help=f"random starts for {', '.join(PACKAGES)} (default 20)")
    parser.add_argument("--limit", type=float, default=60.0, help="CPU seconds of one solve (default 60)")
    parser.add_argument("--no-macmpec", action="store_true", help="the carts alone")
    parser.add_argument("--out", type=Path, help="write every run as JSON, after each run; runs that are in it already are kept")
    asked = parser.parse_args()

    kept = json.loads(asked.out.read_text(encoding="utf-8")) if asked.out and asked.out.exists() else {"three_cart": [], "macmpec": []}
    rows, problems = kept["three_cart"], kept["macmpec"]

    def run(done: list[dict[str, Any]], peer: str, problem: str, seed: int) -> None:
        if any((row["peer"], row["problem"], row["seed"]) == (peer, problem, seed) for row in done):
            return
        done.append(run_one(peer, problem, seed, asked.limit))
        print(json.dumps({key: value for key, value in done[-1].items() if key != "path"}), file=sys.stderr, flush=True)
        if asked.out:
            asked.out.write_text(json.dumps(kept, indent=1), encoding="utf-8")

    for seed in (-1, *range(asked.seeds)):
        for peer in PEERS:
            if peer not in PACKAGES or seed < asked.package_seeds:
                run(rows, peer, "three_cart", seed)
    for name in () if asked.no_macmpec else MACMPEC:
        for peer in GENERAL:
            run(problems, peer, name, 0)
    print("From the paper's first guess (start held, no force):\n" + "\n".join(carts_table([row for row in rows if row["seed"] < 0])))
    print("\nFrom random starts:\n" + "\n".join(carts_table([row for row in rows if row["seed"] >= 0])))
    if problems:
        print("\n" + "\n".join(macmpec_table(problems)))


if __name__ == "__main__":
    main()
