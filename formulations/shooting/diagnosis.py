"""How fast a small disturbance of the state grows along a plan, and with it every gradient that is carried back over the horizon.

    growth = measure_growth(load_steps(scene), x, u, law, eps)
    growth.factor, growth.rate                      # |d x_T/d x_0| and its exponent [1/s]
    growth.sentence()                               # "" while it is harmless

The derivative of a loss with respect to x_t is (d x_T/d x_t)' times that with respect to x_T, so that the spectral norm of d x_T/d x_t is
the factor by which shooting's gradients may grow on their way back from the end to t. It is the product of the exact Jacobians of the
time steps from t on, kept with its exponent apart, so that no horizon is too long.

Why a descent ends where it ends, in numbers and then in words.

The rows of S = d x_T / d u, one adjoint each, tell what the inputs can still do: a coordinate whose row is zero stays where it
is, whatever its error. With a dead ReLU that is every body that only contact moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from formulations.shooting.objective import Objective
from models.codegen.kernel import Steps
from models.contact_law import ContactLaw
from models.scene import Scene

# A factor below this costs two digits at most: no shooting method fails of it.
HARMLESS = 100.0
_LARGEST_EXPONENT = 690.0  # exp of it is still a float


@dataclass(frozen=True, kw_only=True, eq=False)
class Growth:
    """exponents (steps+1,): natural logarithm of the spectral norm of d x_T/d x_t, 0 at the end; step [s]."""

    exponents: np.ndarray
    step: float

    @property
    def factor(self) -> float:
        """|d x_T/d x_0|, at most e^690."""
        return math.exp(min(float(self.exponents[0]), _LARGEST_EXPONENT))

    @property
    def rate(self) -> float:
        """Slope of the exponents over the time to go, by least squares [1/s]: the growth is about e^(rate T)."""
        to_go = self.step * np.arange(len(self.exponents))[::-1]
        centred = to_go - to_go.mean()
        return float(centred @ self.exponents / (centred @ centred))

    @property
    def horizon(self) -> float:
        return self.step * (len(self.exponents) - 1)

    def figures(self) -> dict[str, float]:
        """For a solution's residuals: gradient_growth and growth_rate [1/s]."""
        return {"gradient_growth": self.factor, "growth_rate": self.rate}

    def sentence(self) -> str:
        """What the growth means for shooting, or "" while it is harmless."""
        if self.exponents[0] < math.log(HARMLESS):
            return ""
        return (
            f"The gradient grows by {_power(float(self.exponents[0]))} over the {self.horizon:g} s (about e^({self.rate:.3g} T), T in s): what "
            "happens early is known to so many digits fewer at the end; multiple shooting does not carry it over more than one step."
        )


def told(message: str, growth: Growth) -> str:
    """A message of a method that did not solve its scene, with what the growth has to do with it."""
    return f"{message} {growth.sentence()}".strip()


def _power(exponent: float) -> str:
    tens = exponent / math.log(10.0)
    return f"{math.exp(exponent):.2g}" if tens < 3.0 else f"1e{tens:.0f}"


def measure_growth(
    steps: Steps, x: np.ndarray, u: np.ndarray, law: ContactLaw = ContactLaw.RELU, eps: float | None = None
) -> Growth | None:
    """Along nodes x (steps+1, 2*nq) and inputs u (steps, nu); None where a step is not finite."""
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
        if size == 0.0:  # what happens before is forgotten
            products[: t + 1], scales[: t + 1] = 0.0, scales[t + 1]
            break
        products[t], scales[t] = product / size, scales[t + 1] + math.log(size)
    norms = np.linalg.norm(products, 2, axis=(1, 2))
    with np.errstate(divide="ignore"):
        return Growth(exponents=np.maximum(np.log(norms), -_LARGEST_EXPONENT) + scales, step=step)


# A coordinate counts as missed beyond this share of its nominal size, and as out of reach if one iteration closes less than
# this share of its error through its own row of S (a million iterations would not get there).
_MISSED = 1e-4
_OUT_OF_REACH = 1e-6

# Enough for one digit of the largest curvature; the difference is small against the inputs and large against rounding.
_POWER_ITERATIONS = 20
_DIFFERENCE = 1e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensitivity:
    """Of the last state: to_inputs (2*nq, steps*nu), to_start (2*nq, 2*nq)."""

    to_inputs: np.ndarray
    to_start: np.ndarray

    @property
    def growth(self) -> float:
        """Largest factor by which a disturbance of the start grows over the horizon."""
        return float(np.linalg.norm(self.to_start, 2))


def sensitivity(objective: Objective, u: np.ndarray) -> Sensitivity:
    """Derivatives of the last state at inputs u (steps, nu), by one adjoint sweep for each of its components."""
    kernel, task = objective.kernel, objective.kernel.scene.task
    plan = kernel.rollout(np.array(task.start), u, task.step, objective.law, objective.eps)
    rows = [kernel.adjoint(plan, u, end_bar=component) for component in np.eye(2 * kernel.scene.nq)]
    return Sensitivity(to_inputs=np.array([u_bar.ravel() for u_bar, _ in rows]), to_start=np.array([start_bar for _, start_bar in rows]))


def out_of_reach(objective: Objective, rows: Sensitivity, learning_rate: float) -> list[str]:
    """Names of the coordinates that miss the goal and that no gradient moves, each with its error, for a sentence."""
    scene, missed = objective.kernel.scene, np.abs(objective.error)
    found = []
    for index, coordinate in enumerate(scene.coordinates):
        closes = learning_rate * objective.weights.terminal / len(missed) * 2.0 * float(rows.to_inputs[index] @ rows.to_inputs[index])
        if missed[index] > _MISSED * coordinate.nominal and closes < _OUT_OF_REACH:
            slope = float(np.linalg.norm(rows.to_inputs[index]))
            found.append(
                f"{coordinate.name} (it misses its goal by {missed[index]:.3g} {coordinate.unit}; |d {coordinate.name}/d u| = {slope:.2g})"
            )
    return found


def dead_contact_message(objective: Objective, rows: Sensitivity, learning_rate: float) -> str:
    """A sentence if a coordinate misses the goal and nothing moves it, else ""."""
    found = out_of_reach(objective, rows, learning_rate)
    if not found:
        return ""
    names = " and ".join(found)
    assert objective.plan is not None
    scene, relu, step = objective.kernel.scene, objective.law is ContactLaw.RELU, objective.kernel.scene.task.step
    consequence = f"so the loss has no gradient towards moving {names}"
    if not scene.nc:
        return f"no input reaches it, {consequence}."
    phi = objective.kernel.penetration(objective.plan.q.detach().numpy()[:-1])
    if relu:
        never = [index for index in range(scene.nc) if phi[:, index].max() <= 0.0]
        if len(never) == scene.nc:
            what = f"no contact is made anywhere on the trajectory ({_gaps(scene, phi, never, step)})"
        elif never:
            what = f"contact {' and '.join(scene.contacts[index].name for index in never)} is never made ({_gaps(scene, phi, never, step)})"
        else:
            what = "every contact is made, but none carries an input's effect to the end"
        return f"{what}, {consequence}; start from a softplus stage."
    force = objective.plan.lam.max().item()
    everywhere = list(range(scene.nc))
    return f"the relaxed contact is too faint (largest force {force:.2g} N; {_gaps(scene, phi, everywhere, step)}), {consequence}; start from a larger eps."


def _gaps(scene: Scene, phi: np.ndarray, contacts: list[int], step: float) -> str:
    closest = [(scene.contacts[index].name, int(phi[:, index].argmax()), -float(phi[:, index].max())) for index in contacts]
    return "smallest gap " + ", ".join(f"{name} {gap:.3g} m at t = {node * step:.3g} s" for name, node, gap in closest)


def stable_rate(objective: Objective, u: np.ndarray) -> float:
    """Largest learning rate at which a gradient step near u (steps, nu) does not overshoot: 2 / largest curvature of the loss.

    The curvature comes from a power iteration on differences of gradients, so that all of the loss counts: the way to the goal,
    contacts, and the running cost.
    """
    objective.value(u)
    direction = objective.gradient().copy()
    curvature = 0.0
    for _ in range(_POWER_ITERATIONS):
        norm = float(np.linalg.norm(direction))
        if not (np.isfinite(norm) and norm > 0.0):
            break
        direction *= _DIFFERENCE * max(1.0, float(np.linalg.norm(u))) / norm
        length = float(np.linalg.norm(direction))
        gradients = []
        for sign in (1.0, -1.0):
            if not np.isfinite(objective.value(u + sign * direction)):
                return np.nan
            gradients.append(objective.gradient().copy())
        direction = gradients[0] - gradients[1]
        curvature = float(np.linalg.norm(direction)) / (2.0 * length)
    return 2.0 / curvature if curvature > 0.0 else np.inf


def divergence_message(objective: Objective, learning_rate: float, iteration: int, best: np.ndarray | None) -> str:
    """What went wrong at this iteration, and the growth and the rate measured at the best inputs seen (None if there are none)."""
    where = (
        f"after {iteration} {'iteration' if iteration == 1 else 'iterations'} at learning rate {learning_rate:g}"
        if iteration
        else "at the first guess"
    )
    if objective.finite:
        what = f"{where} the loss climbs instead of descending"
    else:
        steps = objective.finite_steps
        what = f"{where} the rollout is no longer finite beyond step {steps} (t = {steps * objective.kernel.scene.task.step:.3g} s)"
    if best is None:
        return f"{what}; start, parameters and inputs must allow a simulation to the end of the horizon."
    rate, growth = stable_rate(objective, best), sensitivity(objective, best).growth
    advice = f"; a learning rate below {_rounded_down(rate)} would not overshoot there" if np.isfinite(rate) else ""
    return f"{what}; at the best plan a disturbance of the start grows by a factor of {growth:.3g} over the horizon{advice}."


def _rounded_down(value: float) -> str:
    """One digit, so that the text promises no more than an estimate can."""
    scale = 10.0 ** math.floor(math.log10(value))
    return f"{math.floor(value / scale) * scale:g}"
