"""Fig. 2 of the paper: the worst-case violation D of complementarity of a relaxation at eps.

    D = max over phi of lam * (lam - k * phi)            [N^2]

For softplus contact lam is what the *compiled* contact law says, and the maximum is searched for,
on a grid and then by golden section; beside it stands the closed form (k ln2 / ln eps)^2, reached
at phi = 0. For the relaxed LCP lam is free within lam >= 0, lam - k*phi >= 0, lam*(lam - k*phi) <=
eps, and the worst is searched for over that set; it is eps.

The paper's Table I beside ours: which of its rows belongs to which stage of which pipeline.

    # {"cost": 197.86, "stability": 0.0, "physics": 2445.98, "time": 11.64}
    paper_row("three_cart", "softplus_dc+strict", 0)

The numbers stand once, in `reports.paper`. The rows of a warm starter stand once in the paper and
belong to both pipelines that begin with it. A pipeline of ours has no row there, even where it
chains the same methods.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from formulations.pipelines import PAPER, PIPELINES, stage_plan
from models.codegen.kernel import Kernel, load_kernel
from models.contact_law import ContactLaw, sharpness, worst_case_violation
from models.dynamics import derive
from models.scene import Scene
from reports.paper import SCENE, TABLE_1, PaperRow
from reports.records.record import ViolationPoint


def table_rows(pipeline: str) -> tuple[PaperRow, ...]:
    """The paper's rows of a pipeline, one a stage; empty for a pipeline the paper does not have."""
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
    """The paper's numbers for stage `stage` (from 0) of a pipeline by column name.

    Empty where the paper has none.
    """
    rows = table_rows(pipeline) if scene == SCENE else ()
    return rows[stage].numbers if stage < len(rows) else {}


SOFTPLUS_EPS = tuple(10.0**-power for power in range(1, 13))
RELAXED_EPS = tuple(10.0**-power for power in range(1, 9))
# Agreement that Fig. 2 must show; the search itself ends far below it.
TOLERANCE = 1e-6
# Widths of the softplus transition, 1/b, that are searched on either side of phi = 0: beyond 40 its
# violation is below 1e-14 of the peak. an even number: phi = 0 is found, not given
_WIDTHS = 40.0
_GRID = 2000
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


def measure(scene: Scene) -> tuple[ViolationPoint, ...]:
    """The points of Fig. 2 for the first contact of a scene; none for a scene without contacts.

    Raises MachineError.
    """
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
    """The largest lam*(lam - k*phi) [N^2] of the compiled softplus law at the first contact along a path through it.

    Parameters
    ----------
    kernel
        Of a scene with contacts.
    path
        From penetrations of the first contact (n,) [m] to positions (n, nq) [m, rad].
    eps
        Of the relaxation.

    Raises
    ------
    RelaxationError
        Unless 0 < eps < 1.
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
    """Positions q (n, nq) along the gradient of the first penetration whose penetration is, to first order, the given depth."""
    start = np.array([scene.task.start[: scene.nq]], dtype=float)
    jacobian = derive(scene).function(derive(scene).gap_jacobian, derive(scene).q)
    direction = -jacobian(start[0])[0]
    direction = direction / (direction @ direction)
    touching = start - kernel.penetration(start)[0, 0] * direction
    return lambda depth: touching + np.asarray(depth, dtype=float)[:, None] * direction


def _golden_section(function: Callable[[float], float], left: float, right: float) -> float:
    """The largest value of a function with one peak between left and right.

    60 cuts shrink the bracket to rounding.
    """
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
    """The largest lam*(lam - k*phi) [N^2] over the feasible set of the relaxed LCP, by search over phi and bisection in lam."""
    phi = np.linspace(-100.0, 100.0, 401) * math.sqrt(eps) / stiffness
    # The product grows with lam from the smallest feasible force on; the largest feasible one is
    # bracketed, and the bracket cut in half.
    low = np.maximum(0.0, stiffness * phi)
    high = low + math.sqrt(eps) + 1.0
    while (feasible := high * (high - stiffness * phi) <= eps).any():
        high = np.where(feasible, low + 2.0 * (high - low), high)
    for _ in range(100):
        middle = (low + high) / 2.0
        feasible = middle * (middle - stiffness * phi) <= eps
        low, high = np.where(feasible, middle, low), np.where(feasible, high, middle)
    return float((low * (low - stiffness * phi)).max())
