"""The feedback law of a tracked replay, and how much of the inputs it took."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class Feedback:
    """u_t = sat(u_plan_t + K_t (x_plan_t - x(t))) at each node.

    gains K (steps, nu, nx); reference x_plan (nodes, nx) positions, then velocities; u (steps, nu) of the plan; lower, upper (nu,) bounds, may be
    infinite; scale (nu,): what an input's effort is a share of (half the width of its bounds, or the plan's own largest value).
    """

    gains: np.ndarray
    reference: np.ndarray
    u: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray

    def wanted(self, step: int, state: np.ndarray) -> np.ndarray:
        """(nu,) the input asked for at the start of a step, before saturation, at state (nx,)."""
        return self.u[step] + self.gains[step] @ (self.reference[step] - state)

    def at(self, step: int, state: np.ndarray) -> np.ndarray:
        """(nu,) the input applied from the start of a step on."""
        return np.minimum(np.maximum(self.wanted(step, state), self.lower), self.upper)  # np.clip takes five times as long

    def in_units(self, output: tuple[np.ndarray, np.ndarray], inputs: tuple[np.ndarray, np.ndarray]) -> Feedback:
        """The same law in an FMU's units. output: scale, offset (nx,) with plan's value = scale * FMU's + offset; inputs: scale, offset (nu,) with
        FMU's value = scale * plan's + offset."""
        (a, b), (c, d) = output, inputs
        bounds = np.sort([c * self.lower + d, c * self.upper + d], axis=0)
        return replace(
            self, gains=c[None, :, None] * self.gains * a, reference=(self.reference - b) / a, u=c * self.u + d,
            lower=bounds[0], upper=bounds[1], scale=np.abs(c) * self.scale,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Effort:
    """What the feedback added to the plan's inputs.

    rms, peak: root mean square over time and largest value, of each input in its unit; rms_share, peak_share: the largest over the inputs as a share of
    the input's scale (half the width of its bounds); plan_share: root mean square of all that was added over that of the plan's own inputs, each input in
    its scale (None: the plan's inputs are all 0, but something was added); saturated: share of the steps in which some input stood at a bound that the plan did not ask for.
    """

    rms: tuple[float, ...]
    peak: tuple[float, ...]
    rms_share: float
    peak_share: float
    plan_share: float | None
    saturated: float


def measure_effort(plan_u: np.ndarray, applied: np.ndarray, t: np.ndarray, feedback: Feedback) -> Effort:
    """Of inputs applied (steps, nu) against the plan's, both at the starts of the steps and in the plan's units; t (nodes,) [s].

    Raises nothing; of a replay that ended early the steps that it made.
    """
    steps = len(applied)
    added, h = np.abs(applied - plan_u[:steps]), np.diff(t)[:steps]
    if not steps:
        zero = (0.0,) * plan_u.shape[1]
        return Effort(rms=zero, peak=zero, rms_share=0.0, peak_share=0.0, plan_share=0.0, saturated=0.0)
    rms, peak = np.sqrt((h[:, None] * added**2).sum(axis=0) / h.sum()), added.max(axis=0)
    own = np.sqrt((h[:, None] * plan_u[:steps] ** 2).sum(axis=0) / h.sum())
    share = float(np.linalg.norm(rms / feedback.scale)), float(np.linalg.norm(own / feedback.scale))
    at_bound = ((applied <= feedback.lower) | (applied >= feedback.upper)) & (added > 0.0)
    return Effort(
        rms=tuple(rms.tolist()),
        peak=tuple(peak.tolist()),
        rms_share=float((rms / feedback.scale).max()),
        peak_share=float((peak / feedback.scale).max()),
        plan_share=share[0] / share[1] if share[1] > 0.0 else None if share[0] > 0.0 else 0.0,
        saturated=float(at_bound.any(axis=1).mean()),
    )
