"""The paper's Fig. 2, the worst complementarity violation D, and Table I beside ours.

    D = max over phi of lam * (lam - k * phi)            [N^2]
    paper_row("three_cart", "softplus_dc+strict", 0)  # {"cost": 197.86, "stability": 0.0, ..}

Softplus: lam of the compiled law, maximised numerically, beside the closed form (k ln2 / ln eps)^2
at phi = 0. Relaxed LCP: the maximum over lam >= 0, lam - k*phi >= 0, lam*(lam - k*phi) <= eps,
which is eps. Rows of a warm starter (`reports.paper`) belong to both pipelines that begin with it;
ours have none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from formulations.pipelines import PAPER, PIPELINES, stage_plan
from models.codegen.kernel import Kernel, load_kernel
from models.contact_law import ContactLaw, sharpness, worst_case_violation
from models.dynamics import derive
from models.results.run import ViolationPoint
from models.scene import Scene
from reports.paper import SCENE, TABLE_1, PaperRow


def table_rows(pipeline: str) -> tuple[PaperRow, ...]:
    """Return the paper's rows of a pipeline, one per stage, empty for other pipelines."""
    known = next(
        (known for known in PIPELINES if known.name == pipeline and known.source.startswith(PAPER)),
        None,
    )
    if known is None:
        return ()
    by_chain = {(row.methods, row.eps): row for row in TABLE_1}
    rows, chain = [], ()
    for leg, eps, _ in stage_plan(known):
        chain = chain if chain[-1:] == (leg.method,) else (*chain, leg.method)
        rows.append(by_chain[chain, eps])
    return tuple(rows)


def paper_row(scene: str, pipeline: str, stage: int) -> Mapping[str, float]:
    """Return the paper's numbers of a stage (from 0) by column name, empty if none."""
    rows = table_rows(pipeline) if scene == SCENE else ()
    return rows[stage].numbers if stage < len(rows) else {}


SOFTPLUS_EPS = tuple(10.0**-power for power in range(1, 13))
RELAXED_EPS = tuple(10.0**-power for power in range(1, 9))
# Required agreement of Fig. 2; the search is far more accurate.
TOLERANCE = 1e-6
# Searched widths 1/b of the softplus transition around phi = 0; beyond 40 the violation is below
# 1e-14 of its maximum.
_WIDTHS = 40.0
# An even number, so that phi = 0 is no grid point.
_GRID = 2000

_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


def measure(scene: Scene) -> tuple[ViolationPoint, ...]:
    """Return the points of Fig. 2 for a scene's first contact, if any. Raises MachineError."""
    if scene.nc == 0:
        return ()
    kernel = load_kernel(scene)
    stiffness = float(kernel.stiffness()[0])
    path = _through_contact(scene, kernel)
    softplus = tuple(
        ViolationPoint(
            law="softplus",
            eps=eps,
            measured=softplus_violation(kernel, path, eps),
            closed_form=worst_case_violation(stiffness, eps, scene.length),
        )
        for eps in SOFTPLUS_EPS
    )
    relaxed = tuple(
        ViolationPoint(
            law="relaxed_lcp", eps=eps, measured=relaxed_violation(stiffness, eps), closed_form=eps
        )
        for eps in RELAXED_EPS
    )
    return softplus + relaxed


def softplus_violation(
    kernel: Kernel, path: Callable[[np.ndarray], np.ndarray], eps: float
) -> float:
    """Return the largest lam*(lam - k*phi) [N^2] of the compiled softplus law.

    path: from penetrations of the first contact (n,) [m] to positions (n, nq) [m, rad]. Raises
    RelaxationError unless 0 < eps < 1.
    """
    stiffness = kernel.stiffness()

    def _violation(depth: np.ndarray) -> np.ndarray:
        q = path(depth)
        lam = kernel.contact_force(q, ContactLaw.SOFTPLUS, eps)[:, 0]
        return lam * (lam - stiffness[0] * kernel.penetration(q)[:, 0])

    width = _WIDTHS / sharpness(eps, kernel.scene.length)
    grid = np.linspace(-width, width, _GRID)
    best = int(np.argmax(_violation(grid)))
    return _golden_section(
        lambda depth: float(_violation(np.array([depth]))[0]),
        grid[max(best - 1, 0)],
        grid[min(best + 1, _GRID - 1)],
    )


def _through_contact(scene: Scene, kernel: Kernel) -> Callable[[np.ndarray], np.ndarray]:
    """Return positions (n, nq) with given first penetration, to first order."""
    start = np.array([scene.task.start[: scene.nq]], dtype=float)
    jacobian = derive(scene).function(derive(scene).gap_jacobian, derive(scene).q)
    direction = -jacobian(start[0])[0]
    direction = direction / (direction @ direction)
    touching = start - kernel.penetration(start)[0, 0] * direction
    return lambda depth: touching + np.asarray(depth, dtype=float)[:, None] * direction


def _golden_section(function: Callable[[float], float], left: float, right: float) -> float:
    """Return the largest value of a function with one peak; 60 cuts reach rounding."""
    inner, outer = right - _GOLDEN * (right - left), left + _GOLDEN * (right - left)
    at_inner, at_outer = function(inner), function(outer)
    largest = max(at_inner, at_outer)
    for _ in range(60):
        if at_inner < at_outer:
            left, inner, at_inner = inner, outer, at_outer
            outer = left + _GOLDEN * (right - left)
            at_outer = function(outer)
        else:
            right, outer, at_outer = outer, inner, at_inner
            inner = right - _GOLDEN * (right - left)
            at_inner = function(inner)
        largest = max(largest, at_inner, at_outer)
    return largest


def relaxed_violation(stiffness: float, eps: float) -> float:
    """Return the largest lam*(lam - k*phi) [N^2] of the relaxed LCP, by search and bisection."""
    phi = np.linspace(-100.0, 100.0, 401) * math.sqrt(eps) / stiffness
    # The product grows with lam: bracket the largest feasible force, then bisect.
    low = np.maximum(0.0, stiffness * phi)
    high = low + math.sqrt(eps) + 1.0
    while (feasible := high * (high - stiffness * phi) <= eps).any():
        high = np.where(feasible, low + 2.0 * (high - low), high)
    for _ in range(100):
        middle = (low + high) / 2.0
        feasible = middle * (middle - stiffness * phi) <= eps
        low, high = np.where(feasible, middle, low), np.where(feasible, high, middle)
    return float((low * (low - stiffness * phi)).max())
