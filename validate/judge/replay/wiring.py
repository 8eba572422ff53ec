"""What a simulation of a plan needs of it: value references, inputs as functions of time, a feedback law.

`Variables` holds value references only, so that it travels to a child process. `HeldInputs` are the
plan's inputs between its nodes: constant over a step, or a line to the next node's value; with
`Feedback` a constant is added over each step. `measure_effort` says how much that was.
`WorldInputs` are what becomes of them in a perturbed world: later, by another gain, with noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from models.plan_table import Table
from models.trajectory import Hold, Trajectory, input_share

# The outputs a replay can use beside positions and velocities; what an FMU lacks is computed from
# the scene or left out.
ENERGIES = ("kinetic_energy", "potential_energy", "contact_energy")
POWERS = ("input_power", "dissipated_power")
INTERNAL_STEP = "internal_step"


@dataclass(frozen=True, kw_only=True)
class Variables:
    """Value references. lam, gap and friction are empty where the FMU lacks one of them.

    V may be empty for an FMU without a scene.

    energies, powers: those the FMU has, by name; zero: names of energies and powers that the scene
        does not have at all;
    parameters: (reference, value) set before the start; start: references of what is set to the
        plan's start, in the order of the start
    vector; internal_step: of the Co-Simulation; choices: (reference, value) of whole numbers set
        before the start.
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
        """Of all that is read at a point of the replay: q, v, lam, gap, friction, energies."""
        return self.q + self.v + self.lam + self.gap + self.friction + tuple(self.energies.values())

    @property
    def rates(self) -> tuple[int, ...]:
        """Of what is integrated beside the states: contact forces, powers."""
        return self.lam + tuple(self.powers.values())


@dataclass(frozen=True, kw_only=True, eq=False)
class Feedback:
    """u_t = sat(u_plan_t + K_t (x_plan_t - x(t))) at each node.

    gains K (steps, nu, nx); reference x_plan (nodes, nx) positions, then velocities; u (steps, nu)
    of the plan; lower, upper (nu,) bounds, may be infinite; scale (nu,): what an input's effort is
    a share of (half the width of its bounds, or the plan's own largest value).
    """

    gains: np.ndarray
    reference: np.ndarray
    u: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray

    def at(self, step: int, state: np.ndarray) -> np.ndarray:
        """The input applied from the start of a step on: what is asked for, saturated.

        Parameters
        ----------
        step : its number.
        state : (nx,) there [unit of each state].

        Returns
        -------
        (nu,) [unit of each input].

        Raises
        ------
        IndexError : for a step that the plan does not have.
        """
        wanted = self.u[step] + self.gains[step] @ (self.reference[step] - state)
        return np.minimum(
            np.maximum(wanted, self.lower), self.upper
        )  # np.clip takes five times as long

    def in_units(
        self, output: tuple[np.ndarray, np.ndarray], inputs: tuple[np.ndarray, np.ndarray]
    ) -> Feedback:
        """The same law in an FMU's units.

        Parameters
        ----------
        output : scale, offset (nx,), plan's value [unit of the column] = scale * FMU's + offset.
        inputs : scale, offset (nu,), FMU's value = scale * plan's [unit of the column] + offset.

        Raises
        ------
        ValueError : if the shapes do not fit.
        """
        (a, b), (c, d) = output, inputs
        bounds = np.sort([c * self.lower + d, c * self.upper + d], axis=0)
        return replace(
            self, gains=c[None, :, None] * self.gains * a, reference=(self.reference - b) / a,
            u=c * self.u + d,
            lower=bounds[0], upper=bounds[1], scale=np.abs(c) * self.scale,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Effort:
    """What the feedback added to the plan's inputs.

    rms, peak: root mean square over time and largest value, of each input in its unit; rms_share,
        peak_share: the largest over the inputs as a share of
    the input's scale (half the width of its bounds); plan_share: root mean square of all that was
        added over that of the plan's own inputs, each input in
    its scale and averaged over windows (models.trajectory.input_share); saturated:
    share of the steps in which some input stood at a bound that the plan did not ask for.
    """

    rms: tuple[float, ...]
    peak: tuple[float, ...]
    rms_share: float
    peak_share: float
    plan_share: float | None
    saturated: float


def measure_effort(plan: Trajectory, applied: np.ndarray, feedback: Feedback) -> Effort:
    """Of inputs applied (steps, nu) at the starts of the steps against the plan's, in the plan's units.

    Raises nothing; of a replay that ended early the steps that it made.
    """
    steps = len(applied)
    given, h = applied - plan.u[:steps], np.diff(plan.t)[:steps]
    added = np.abs(given)
    if not steps:
        zero = (0.0,) * plan.u.shape[1]
        return Effort(
            rms=zero, peak=zero, rms_share=0.0, peak_share=0.0, plan_share=0.0, saturated=0.0
        )
    rms, peak = np.sqrt((h[:, None] * added**2).sum(axis=0) / h.sum()), added.max(axis=0)
    held = HeldInputs(plan)
    own = held.values[:steps] + held.slopes[:steps] * h[:, None] / 2.0
    at_bound = ((applied <= feedback.lower) | (applied >= feedback.upper)) & (added > 0.0)
    return Effort(
        rms=tuple(rms.tolist()),
        peak=tuple(peak.tolist()),
        rms_share=float((rms / feedback.scale).max()),
        peak_share=float((peak / feedback.scale).max()),
        plan_share=input_share(plan.t[: steps + 1], given, own, feedback.scale),
        saturated=float(at_bound.any(axis=1).mean()),
    )


class HeldInputs:
    """u(t) of a plan. values, slopes (steps, nu): at the start of each step, and per second within it; grid: the plan's own times [s].

    breaks (steps,): whether u or its slope jumps where step i begins, so that an integrator must
    start afresh there. With feedback every step begins with a jump, and `values` are those of the
    run in progress: `begin` sets them. stops (steps,): the first node after the start of each step
    beyond which no integration may go.
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
        # The first break at or after each step, and the end of the plan.
        following = np.minimum.accumulate(np.where(self.breaks, steps, trajectory.steps)[::-1])[
            ::-1
        ]
        self.stops: list[int] = [*following[1:].tolist(), trajectory.steps]

    def begin(self, step: int, state: np.ndarray | None) -> np.ndarray:
        """The input at the start of a step.

        Parameters
        ----------
        step : its number.
        state : (nx,) there [unit of each state], for the feedback; None: the plan's own start.

        Returns
        -------
        (nu,) [unit of each input].

        Raises
        ------
        IndexError : for a step that the plan does not have.
        """
        if self.feedback is not None:
            u = self.feedback.at(step, self.feedback.reference[0] if state is None else state)
            # the correction is held: it may not lead out of the bounds at the end of the step
            # either
            if self.linear:
                change = self.slopes[step] * (self.times[step + 1] - self.times[step])
                u = np.clip(
                    u,
                    self.feedback.lower - np.minimum(change, 0.0),
                    self.feedback.upper - np.maximum(change, 0.0),
                )
            self.values[step] = u
        return self.values[step]


# Breaks of the inputs that are nearer to one another than this share of a step are one.
_SAME = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A perturbed world: parameters (np,) and start (2*nq,) [units of the scene], gain (nu,) [-], noise (steps, nu) [unit of each input], delay [s].

    whole: inputs change at the plan's nodes alone, as some FMUs take no other steps: over each step
        they are the mean of what they would be.
    longest: steps of the plan are made in equal parts that are no longer [s], as Co-Simulation
        shows its motion at their ends alone.
    """

    parameters: np.ndarray
    start: np.ndarray
    gain: np.ndarray
    noise: np.ndarray
    delay: float = 0.0
    whole: bool = False
    longest: float = math.inf


def with_times_between(t: np.ndarray, longest: float) -> np.ndarray:
    """Times (n,) [s], and between them as many more, evenly, as leave no two further apart than `longest` [s]. Raises nothing."""
    counts = np.maximum(np.ceil(np.diff(t) / longest - 1e-6), 1.0).astype(int)
    step = np.repeat(np.arange(len(counts)), counts)
    part = (np.arange(len(step)) - (np.cumsum(counts) - counts)[step]) / counts[step]
    return np.append(t[step] + part * np.diff(t)[step], t[-1])


class WorldInputs(HeldInputs):
    """What a plan's inputs become in a world: later, by another gain, with noise.

    With feedback, its commands do.

    A command given at a node arrives `delay` later; until the first arrives it is that of the
        start. rows (nodes,): where the plan's nodes are among the times;
    grid: these nodes and the ends of the parts between them. With feedback a world is never
        `whole`. What worlds there are, validate.judge.robustness.worlds says.
    """

    def __init__(self, plan: Trajectory, world: World, feedback: Feedback | None = None) -> None:
        """Raises ValueError if the shapes of plan, world and feedback do not fit."""
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
        # Of each step of these times: the plan's step in which it lies, that whose command is in
        # force, and since when it is [s].
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
        """(steps, nu) what is commanded at the plan's nodes [unit of each input]: what an actuator makes of it, and when, is the world's. Raises nothing."""
        return self._commands.values

    def begin(self, step: int, state: np.ndarray | None) -> np.ndarray:
        """The input at the start of a step of these times: at a node a command is given, from its arrival on it is in force (`HeldInputs.begin`): (nu,) [unit of each], state (2*nq,). Raises nothing."""
        if self.feedback is not None:
            node = int(self._lies_in[step])
            if self.rows[node] == step:
                self._commands.begin(node, self._world.start if state is None else state)
            self.values[step] = (
                self._commands.values[self._command[step]] * self._world.gain + self._added[step]
            )
        return self.values[step]


def _to_nearest(points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(n,) distance of each point from the nearest node [s]."""
    after = np.clip(np.searchsorted(nodes, points), 1, len(nodes) - 1)
    return np.minimum(np.abs(points - nodes[after]), np.abs(points - nodes[after - 1]))


def columns_or_zeros(
    table: Table, columns: Sequence[str], shape: tuple[int, int], may_be_shorter: bool
) -> np.ndarray:
    """Return columns of a plan (rows, n) [unit of each column], zeros (rows, n) if there are none.

    Raises TrajectoryError.
    """
    if not columns:
        return np.zeros(shape)
    return np.column_stack([table.column(column, may_be_shorter) for column in columns])
