"""Proofs: a lower bound on the cost of every plan of the exact contact problem.

Linear scenes with few contact decisions are answered for good.

    proof = prove(load_scene("wall_pendulum"), incumbent=plan, time_limit=60.0)
    proof.bound, proof.gap, proof.status          # no plan at all costs less than the bound

1. `bounds`: how deep and how far apart each contact can be at each step, in plans no dearer than
    the one known: convex programs, or physics
   (`energy_bound`). A contact that can only be open, or only be closed, is decided.
2. `build_miqp`: one binary variable a remaining pair, big-M from these bounds, as a plain Pyomo
    model.
3. `prove`: SCIP through Pyomo; its plan is rolled out through the true contact law and counts only
    as what that rollout costs.

Two solvers do the work: SCIP for the mixed-integer program (`pip install pyscipopt`), Clarabel for
the convex ones. Nothing is assumed beyond the scene itself: no symmetry, no limit on the number of
contact intervals, no least time between two of them.
"""

from formulations.proof.bounds import PairBounds, pair_bounds, relaxed_bound
from formulations.proof.prove import (
    Proof,
    ProofStatus,
    build_miqp,
    missing_solver,
    prove,
    why_no_proof,
)

__all__ = [
    "PairBounds",
    "Proof",
    "ProofStatus",
    "build_miqp",
    "missing_solver",
    "pair_bounds",
    "prove",
    "relaxed_bound",
    "why_no_proof",
]
