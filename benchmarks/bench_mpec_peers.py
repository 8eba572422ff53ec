"""The strict three carts (T = 500) and small MacMPEC problems: ours beside CasADi + Ipopt, pympcc and nosnoc, all in one run.

    pip install -e '.[bench]' && python benchmarks/bench_mpec_peers.py [--seeds 20] [--limit 120] [--no-macmpec] [--out FILE.json]

Every solve is a process of its own (one thread, a limit of CPU seconds): what is told is the CPU time of the whole process, imports, model and
derivatives included. All start from the same seeded rollouts; one function in NumPy (mpec_peers/judge.py) recomputes cost and residual of
every plan. A solve succeeded if the residual is at most 1e-6 (largest violation of any equation, in SI units, of min(lam, lam - k phi) too).
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PEERS = ("mpcc", "mpec_ipopt", "casadi_scholtes", "pympcc")
GENERAL = ("mpec_ipopt", "casadi_scholtes", "pympcc")
# Small problems whose conditions have one bound on each side, so that every peer can be given them.
MACMPEC = (
    "bard1", "bilin", "dempe", "desilva", "df1", "gauvin", "jr1", "kth3", "outrata31", "ralph1", "scholtes1", "scholtes3", "scholtes4", "scholtes5",
    "stackelberg1",
)  # fmt: skip
# Residual of a success on the carts, on MacMPEC, and the distance from the published optimum (relative) that counts as reaching it. The
# loose one is what a relaxation at eps = 1e-8 can have where both sides of a pair are about 1e-4.
_SUCCESS, _LOOSE, _REACHED = 1e-6, 1e-3, 1e-4


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
        told = json.loads(result.read_text(encoding="utf-8")) if result.exists() else {"reason": f"no answer within {limit:g} CPU s"}
        return {"peer": peer, "problem": problem, "seed": seed, "cpu_s": cpu, **told}


def carts_table(rows: list[dict[str, Any]]) -> list[str]:
    """One line a peer: medians of those that answered; the success share of all."""
    lines = [
        f"{'peer':16} {'cost: best':>11} {'median':>9} {'CPU s':>7} {'residual':>9} {'physics':>9} {'miss':>9} {'<=1e-6':>7} {'<=1e-3':>7}  remark"
    ]
    for peer in dict.fromkeys(row["peer"] for row in rows):
        mine = [row for row in rows if row["peer"] == peer]
        answered = [row for row in mine if "residual" in row]
        reasons = sorted({row["reason"] for row in mine if "reason" in row})
        remark = f"{len(mine) - len(answered)} without answer: {'; '.join(reasons)}" if reasons else ""
        cpu = statistics.median(row["cpu_s"] for row in mine)
        if not answered:
            lines.append(f"{peer:16} {'':11} {'':9} {cpu:7.2f} {'':9} {'':9} {'':9} {'0':>7} {'0':>7}  {remark}")
            continue
        middle = {key: statistics.median(row[key] for row in answered) for key in ("cost", "residual", "physics", "miss")}
        shares = [sum(row["residual"] <= limit for row in answered) for limit in (_SUCCESS, _LOOSE)]
        lines.append(
            f"{peer:16} {min(row['cost'] for row in answered):11.4f} {middle['cost']:9.3f} {cpu:7.2f} {middle['residual']:9.1e} "
            f"{middle['physics']:9.1e} {middle['miss']:9.1e} {f'{shares[0]}/{len(mine)}':>7} {f'{shares[1]}/{len(mine)}':>7}  {remark}"
        )
    return lines


def macmpec_table(rows: list[dict[str, Any]]) -> list[str]:
    lines = [f"{'problem':14} {'published':>11}  " + "".join(f"{peer + ': cost, residual, CPU s':>42}" for peer in GENERAL)]
    for name in dict.fromkeys(row["problem"] for row in rows):
        mine = {row["peer"]: row for row in rows if row["problem"] == name}
        optimum = next((row["optimum"] for row in mine.values() if "optimum" in row), float("nan"))
        cells = [
            f"{row['cost']:.6g}, {row['residual']:.0e}, {row['cpu_s']:.1f}" if "cost" in row else row["reason"][:40]
            for row in mine.values()
        ]
        lines.append(f"{name:14} {optimum:11.6g}  " + "".join(f"{cell:>42}" for cell in cells))
    for peer in GENERAL:
        mine = [row for row in rows if row["peer"] == peer]
        reached = sum(
            "cost" in row and row["residual"] <= _LOOSE and abs(row["cost"] - row["optimum"]) <= _REACHED * max(1.0, abs(row["optimum"]))
            for row in mine
        )
        lines.append(f"{peer}: published optimum reached by {reached} of {len(mine)}, {sum(row['cpu_s'] for row in mine):.1f} CPU s")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="random starts a peer (default 20)")
    parser.add_argument("--limit", type=float, default=120.0, help="CPU seconds of one solve (default 120)")
    parser.add_argument("--no-macmpec", action="store_true", help="the carts alone")
    parser.add_argument("--out", type=Path, help="write every run as JSON")
    asked = parser.parse_args()
    sys.path.insert(0, str(HERE / "mpec_peers"))
    import solvers

    rows, problems = [], []
    for seed in (-1, *range(asked.seeds)):
        for peer in PEERS:
            rows.append(run_one(peer, "three_cart", seed, asked.limit))
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    nosnoc = {"peer": "nosnoc", "problem": "three_cart", "cpu_s": 0.0, "reason": solvers.nosnoc_reason()}
    rows += [{**nosnoc, "seed": -1}, {**nosnoc, "seed": 0}]
    for name in () if asked.no_macmpec else MACMPEC:
        for peer in GENERAL:
            problems.append(run_one(peer, name, 0, asked.limit))
            print(json.dumps(problems[-1]), file=sys.stderr, flush=True)
    print("From the paper's first guess (start held, no force):\n" + "\n".join(carts_table([row for row in rows if row["seed"] < 0])))
    print(f"\nFrom {asked.seeds} random starts, medians:\n" + "\n".join(carts_table([row for row in rows if row["seed"] >= 0])))
    if problems:
        print("\n" + "\n".join(macmpec_table(problems)))
    if asked.out:
        asked.out.write_text(json.dumps({"three_cart": rows, "macmpec": problems}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
