"""Value references, inputs and feedback for a simulation of a plan.

- `Variables`: value references only, so that they travel to a child process.
- `HeldInputs`: inputs between nodes, constant or linear, plus a constant correction by `Feedback`.
- `WorldInputs`: inputs in a perturbed world, with delay, gain and noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from models.plan_table import Table
from models.results.run import Effort
from models.trajectory import Hold, Trajectory, input_share

# Outputs used in addition to positions and velocities; missing ones are computed or omitted.
ENERGIES = ("kinetic_energy", "potential_energy", "contact_energy")
POWERS = ("input_power", "dissipated_power")
INTERNAL_STEP = "internal_step"


@dataclass(frozen=True, kw_only=True)
class Variables:
    """Value references; lam, gap and friction are empty if the FMU lacks one of them.

    - zero: energies and powers that the scene does not have.
    - parameters: (reference, value) set before the start.
    - start: references in the order of the start vector.
    - internal_step: of Co-Simulation.
    - choices: (reference, integer) set before the start.
    """

    q: tuple[int, ...]
    v: tuple[int, ...]
    u: tuple[int, ...]
    lam: tuple[int, ...]
    gap: tuple[int, ...]
    energies: Mapping[str, int] = field(default_factory=dict)
    powers: Mapping[str, int] = field(default_factory=dict)
    zero: frozenset[str] = frozenset()
    parameters: tuple[tuple[int, float], ...]
    start: tuple[int, ...]
    internal_step: int | None
    choices: tuple[tuple[int, int], ...] = ()
    friction: tuple[int, ...] = ()

    @property
    def outputs(self) -> tuple[int, ...]:
        """Return the references read at each point: q, v, lam, gap, friction, energies."""
        return self.q + self.v + self.lam + self.gap + self.friction + tuple(self.energies.values())

    @property
    def rates(self) -> tuple[int, ...]:
        """Return the references integrated beside the states: contact forces, powers."""
        return self.lam + tuple(self.powers.values())


@dataclass(frozen=True, kw_only=True, eq=False)
class Feedback:
    """u_t = sat(u_plan_t + K_t (x_plan_t - x(t))) at each node.

    - gains: K (steps, nu, nx).
    - reference: x_plan (nodes, nx), positions, then velocities.
    - u (steps, nu); lower, upper (nu,), may be infinite.
    - scale (nu,): unit of effort (half the width of the bounds, or the plan's largest value).
    """

    gains: np.ndarray
    reference: np.ndarray
    u: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray

    def at(self, step: int, state: np.ndarray) -> np.ndarray:
        """Return the saturated input (nu,) [unit of each] at a step's start; state: (nx,).

        Raises IndexError for a step beyond the plan.
        """
        unbounded = self.u[step] + self.gains[step] @ (self.reference[step] - state)
        return np.minimum(
            np.maximum(unbounded, self.lower), self.upper
        )  # np.clip takes five times as long

    def in_units(
        self, output: tuple[np.ndarray, np.ndarray], inputs: tuple[np.ndarray, np.ndarray]
    ) -> Feedback:
        """Return the law in an FMU's units.

        output: scale, offset (nx,), plan [unit of the column] = scale * FMU + offset; inputs:
        scale, offset (nu,), FMU = scale * plan + offset. Raises ValueError if the shapes do not
        fit.
        """
        (a, b), (c, d) = output, inputs
        bounds = np.sort([c * self.lower + d, c * self.upper + d], axis=0)
        return replace(
            self, gains=c[None, :, None] * self.gains * a, reference=(self.reference - b) / a,
            u=c * self.u + d,
            lower=bounds[0], upper=bounds[1], scale=np.abs(c) * self.scale,
        )  # fmt: skip


def measure_effort(plan: Trajectory, applied: np.ndarray, feedback: Feedback) -> Effort:
    """Return the effort of inputs applied (steps, nu) [plan's units]; fewer steps are allowed.

    Raises nothing.
    """
    steps = len(applied)
    corrections, h = applied - plan.u[:steps], np.diff(plan.t)[:steps]
    added = np.abs(corrections)
    if not steps:
        zero = (0.0,) * plan.u.shape[1]
        return Effort(
            rms=zero, peak=zero, rms_share=0.0, peak_share=0.0, plan_share=0.0, saturated=0.0
        )
    rms, peak = np.sqrt((h[:, None] * added**2).sum(axis=0) / h.sum()), added.max(axis=0)
    held = HeldInputs(plan)
    plan_inputs = held.values[:steps] + held.slopes[:steps] * h[:, None] / 2.0
    at_bound = ((applied <= feedback.lower) | (applied >= feedback.upper)) & (added > 0.0)
    return Effort(
        rms=tuple(rms.tolist()),
        peak=tuple(peak.tolist()),
        rms_share=float((rms / feedback.scale).max()),
        peak_share=float((peak / feedback.scale).max()),
        plan_share=input_share(plan.t[: steps + 1], corrections, plan_inputs, feedback.scale),
        saturated=float(at_bound.any(axis=1).mean()),
    )


class HeldInputs:
    """Inputs u(t) of a plan; values, slopes (steps, nu): at each step's start and per second.

    - grid: the plan's times [s].
    - breaks (steps,): the integrator must restart where u or its slope jumps; with feedback at
      every step, with `values` set by `begin`.
    - stops (steps,): the next node at which an integration must stop.
    """

    def __init__(self, trajectory: Trajectory, feedback: Feedback | None = None) -> None:
        self.times = self.grid = trajectory.t
        self.feedback = feedback
        self.values = trajectory.u if feedback is None else trajectory.u.copy()
        self.slopes = np.zeros_like(trajectory.u)
        if trajectory.hold is Hold.LINEAR:
            h = np.diff(trajectory.t)
            self.slopes[:-1] = np.diff(trajectory.u, axis=0) / h[:-1, None]
            if trajectory.u_end is not None:
                self.slopes[-1] = (trajectory.u_end - trajectory.u[-1]) / h[-1]
        self.linear = bool(self.slopes.any())
        jumps = self.slopes[1:] != self.slopes[:-1]
        if trajectory.hold is Hold.ZERO_ORDER:
            jumps = trajectory.u[1:] != trajectory.u[:-1]
        self.breaks = (
            np.concatenate([[True], jumps.any(axis=1)])
            if feedback is None
            else np.full(trajectory.steps, True)
        )
        steps = np.arange(trajectory.steps)
        # The next break after each step, or the end of the plan.
        following = np.minimum.accumulate(np.where(self.breaks, steps, trajectory.steps)[::-1])[
            ::-1
        ]
        self.stops: list[int] = [*following[1:].tolist(), trajectory.steps]

    def begin(self, step: int, state: np.ndarray | None) -> np.ndarray:
        """Return the input (nu,) [unit of each] at a step's start.

        state: (nx,) for the feedback; None: the plan's start. Raises IndexError beyond the plan.
        """
        if self.feedback is not None:
            u = self.feedback.at(step, self.feedback.reference[0] if state is None else state)
            # The held correction must respect the bounds at the end of the step too.
            if self.linear:
                change = self.slopes[step] * (self.times[step + 1] - self.times[step])
                u = np.clip(
                    u,
                    self.feedback.lower - np.minimum(change, 0.0),
                    self.feedback.upper - np.maximum(change, 0.0),
                )
            self.values[step] = u
        return self.values[step]


# Relative distance of equal breaks, in steps.
_SAME = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A perturbed world: parameters (np,) and start (2*nq,) [units of the scene], delay [s].

    - gain (nu,) [-]; noise (steps, nu) [unit of each input].
    - whole: inputs change at nodes only and are means over steps, for FMUs with fixed steps.
    - longest: largest part of a plan step [s], because Co-Simulation has rows only at the ends of
      steps.
    """

    parameters: np.ndarray
    start: np.ndarray
    gain: np.ndarray
    noise: np.ndarray
    delay: float = 0.0
    whole: bool = False
    longest: float = math.inf


def with_times_between(t: np.ndarray, longest: float) -> np.ndarray:
    """Return times (n,) [s] with evenly added ones, at most `longest` [s] apart. Raises nothing."""
    counts = np.maximum(np.ceil(np.diff(t) / longest - 1e-6), 1.0).astype(int)
    step = np.repeat(np.arange(len(counts)), counts)
    part = (np.arange(len(step)) - (np.cumsum(counts) - counts)[step]) / counts[step]
    return np.append(t[step] + part * np.diff(t)[step], t[-1])


class WorldInputs(HeldInputs):
    """Inputs of a plan in a world: delayed, scaled, with noise.

    A command of a node arrives `delay` later; before the first arrival the start's is in force.
    rows (nodes,): nodes among the times; grid: nodes and parts between. With feedback a world is
    never `whole`.
    """

    def __init__(self, plan: Trajectory, world: World, feedback: Feedback | None = None) -> None:
        """Raises ValueError if the shapes do not fit."""
        super().__init__(plan, feedback)
        self._commands, self._world = HeldInputs(plan, feedback), world
        arrivals, shortest = plan.t[:-1] + world.delay, _SAME * float(np.diff(plan.t).min())
        self.grid = with_times_between(plan.t, world.longest)
        between = arrivals[
            (arrivals < plan.t[-1] - shortest) & (_to_nearest(arrivals, self.grid) > shortest)
        ]
        self.times = np.union1d(self.grid, between)
        self.rows = np.searchsorted(self.times, plan.t)
        begins = self.times[:-1]
        # For each step: the plan's step, the step of the command in force, and its age [s].
        self._lies_in = np.searchsorted(plan.t, begins + shortest, side="right") - 1
        self._command = np.maximum(
            np.searchsorted(arrivals, begins + shortest, side="right") - 1, 0
        )
        self._since = np.maximum(begins - arrivals[self._command], 0.0)
        arrived = begins + shortest >= arrivals[self._command]
        self.slopes = (
            np.where(arrived[:, None], self._commands.slopes[self._command], 0.0) * world.gain
        )
        self.linear = bool(self.slopes.any())
        self._added = (
            self._since[:, None] * self._commands.slopes[self._command] * world.gain
            + world.noise[self._lies_in]
        )
        self.values = self._commands.values[self._command] * world.gain + self._added
        if world.whole:
            lengths, h = np.diff(self.times)[:, None], np.diff(plan.t)[:, None]
            middles = self.values + self.slopes * lengths / 2.0
            means, slopes = (
                np.add.reduceat(part * lengths, self.rows[:-1]) / h
                for part in (middles, self.slopes)
            )
            self.times, self.rows = self.grid, np.searchsorted(self.grid, plan.t)
            begins, step = self.grid[:-1], np.repeat(np.arange(plan.steps), np.diff(self.rows))
            self.slopes, self.values = (
                slopes[step],
                means[step] + slopes[step] * ((begins - plan.t[step])[:, None] - h[step] / 2.0),
            )
        self.breaks, self.stops = np.full(len(begins), True), list(range(1, len(self.times)))

    @property
    def commands(self) -> np.ndarray:
        """Return the commands (steps, nu) [unit of each input] of the nodes. Raises nothing."""
        return self._commands.values

    def begin(self, step: int, state: np.ndarray | None) -> np.ndarray:
        """Return the input (nu,) [unit of each] at a step and state (2*nq,). Raises nothing."""
        if self.feedback is not None:
            node = int(self._lies_in[step])
            if self.rows[node] == step:
                self._commands.begin(node, self._world.start if state is None else state)
            self.values[step] = (
                self._commands.values[self._command[step]] * self._world.gain + self._added[step]
            )
        return self.values[step]


def _to_nearest(points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    after = np.clip(np.searchsorted(nodes, points), 1, len(nodes) - 1)
    return np.minimum(np.abs(points - nodes[after]), np.abs(points - nodes[after - 1]))


def columns_or_zeros(
    table: Table, columns: Sequence[str], shape: tuple[int, int], may_be_shorter: bool
) -> np.ndarray:
    """Return columns (rows, n) [unit of each], or zeros without columns. Raises TrajectoryError."""
    if not columns:
        return np.zeros(shape)
    return np.column_stack([table.column(column, may_be_shorter) for column in columns])
