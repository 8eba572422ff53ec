"""Start and end of a shooting stage: warm start, residuals, and the growth of gradients.

    growth = measure_growth(load_steps(scene), x, u, law, eps)
    growth.factor, growth.rate  # |d x_T/d x_0| and its exponent [1/s]
    growth.sentence()  # "" if harmless

A gradient at x_t is (d x_T/d x_t)' times that at x_T: the spectral norm is its largest growth on
the way back. It is a product of the exact Jacobians of the steps, with a separate exponent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from formulations.grids import bound_excess, check_warm_start
from formulations.method import Clock
from formulations.solution import Outcome, Seconds
from models.codegen.steps import Steps
from models.contact_law import ContactLaw
from models.scene import Scene
from models.scene.goal import goal_state, miss
from models.trajectory import Trajectory

# A smaller factor costs at most two digits.
HARMLESS = 100.0
_LARGEST_EXPONENT = 690.0  # exp of it is still finite


@dataclass(frozen=True, kw_only=True, eq=False)
class GradientGrowth:
    """exponents (steps+1,): natural logarithm of |d x_T/d x_t|, 0 at the end; step [s]."""

    exponents: np.ndarray
    step: float

    @property
    def factor(self) -> float:
        """Return |d x_T/d x_0|, at most e^690."""
        return math.exp(min(float(self.exponents[0]), _LARGEST_EXPONENT))

    @property
    def rate(self) -> float:
        """Return the least-squares slope of the exponents over the time to go [1/s]."""
        to_go = self.step * np.arange(len(self.exponents))[::-1]
        centred = to_go - to_go.mean()
        return float(centred @ self.exponents / (centred @ centred))

    def residuals(self) -> dict[str, float]:
        """Return the residuals gradient_growth [-] and growth_rate [1/s]."""
        return {"gradient_growth": self.factor, "growth_rate": self.rate}

    def sentence(self) -> str:
        """Return a sentence on the growth, or "" if it is harmless."""
        if self.exponents[0] < math.log(HARMLESS):
            return ""
        horizon = self.step * (len(self.exponents) - 1)
        return (
            f"The gradient grows by {_power(float(self.exponents[0]))} over the {horizon:g} s (about e^({self.rate:.3g} T), T in s): what "
            "happens early is known to so many digits fewer at the end; multiple shooting does not carry it over more than one step."
        )


def with_growth(message: str, growth: GradientGrowth) -> str:
    """Append the growth to the message of an unsolved scene."""
    return f"{message} {growth.sentence()}".strip()


def _power(exponent: float) -> str:
    tens = exponent / math.log(10.0)
    return f"{math.exp(exponent):.2g}" if tens < 3.0 else f"1e{tens:.0f}"


def measure_growth(
    steps: Steps,
    x: np.ndarray,
    u: np.ndarray,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
) -> GradientGrowth | None:
    """Return the growth along nodes x (steps+1, 2*nq) [SI] and inputs u (steps, nu) [N, N m].

    None if a step is not finite. Raises KernelError for an array of another shape.
    """
    step = steps.scene.task.step
    linear = steps.linearise(x[:-1], u, step, law, eps)
    if linear is None or not np.isfinite(linear.A).all():
        return None
    n, nx = len(u), x.shape[1]
    products, scales = np.empty((n + 1, nx, nx)), np.zeros(n + 1)
    products[n] = np.eye(nx)
    for t in range(n - 1, -1, -1):
        product = products[t + 1] @ linear.A[t]
        size = float(np.abs(product).max())
        if size == 0.0:  # independent of earlier states
            products[: t + 1], scales[: t + 1] = 0.0, scales[t + 1]
            break
        products[t], scales[t] = product / size, scales[t + 1] + math.log(size)
    norms = np.linalg.norm(products, 2, axis=(1, 2))
    with np.errstate(divide="ignore"):
        return GradientGrowth(
            exponents=np.maximum(np.log(norms), -_LARGEST_EXPONENT) + scales, step=step
        )


# A smaller excess of a velocity bound [m/s, rad/s] is rounding.
_TOLERANCE = 1e-6


def given_inputs(scene: Scene, warm_start: Trajectory | None) -> np.ndarray:
    """Return the inputs (steps, nu) [N, N m] of the warm start, or zeros.

    Raises TrajectoryError for a plan of another scene or grid.
    """
    task = scene.task
    check_warm_start(scene, warm_start)
    return np.zeros((task.steps, scene.nu)) if warm_start is None else np.array(warm_start.u)


def plan_residuals(scene: Scene, plan: Trajectory) -> dict[str, float]:
    """Return terminal errors and excesses of bounds by name."""
    error = miss(plan.end, goal_state(scene.task))
    return {
        "terminal_error": float(np.linalg.norm(error)),
        "terminal_position_error": float(np.linalg.norm(error[: scene.nq])),
        "terminal_velocity_error": float(np.linalg.norm(error[scene.nq :])),
        **bound_excess(scene, plan),
    }


def arrived(
    scene: Scene,
    outcome: Outcome,
    message: str,
    residuals: Mapping[str, float],
    advice: str = "a larger terminal_weight",
) -> tuple[Outcome, str]:
    """Turn SOLVED into STALLED for a plan that misses the goal or exceeds a velocity bound.

    advice: remedy for a missed goal
    """
    for name in ("terminal_position_error", "terminal_velocity_error"):
        limit = scene.limit(name)
        if (
            outcome is Outcome.SOLVED
            and limit is not None
            and limit.value is not None
            and residuals[name] > limit.value
        ):
            missed = f"{name} is {residuals[name]:.3g}, the scene allows {limit.value:g}; {advice} brings it nearer"
            outcome, message = (
                Outcome.STALLED,
                f"{message} It converged away from the goal: {missed}.".strip(),
            )
    excess = residuals.get("velocity_bound_excess", 0.0)
    if outcome is Outcome.SOLVED and excess > _TOLERANCE:
        outcome, message = (
            Outcome.STALLED,
            f"{message} A velocity exceeds its bound by {excess:.3g}: this method does not know such bounds.".strip(),
        )
    goal = (
        f" The goal is missed by {residuals['terminal_error']:.3g} in the plan's own contact model."
        if scene.task.has_goal
        else ""
    )
    return outcome, f"{message}{goal}".strip()


def stage_seconds(stage: Clock, opening: Clock, evaluate: float, solving: float) -> Seconds:
    """Return the seconds of a stage, including the opening of its session if it is the first.

    solving: wall seconds of the solve, of which `evaluate` in the scene's code
    """
    stage.stop()
    (wall, cpu), (build, build_cpu) = stage.pay(), opening.pay()
    return Seconds(
        build=build,
        evaluate=evaluate,
        linear_algebra=max(0.0, solving - evaluate),
        wall=build + wall,
        cpu=build_cpu + cpu,
    )
