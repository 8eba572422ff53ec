"""A plan tried in one world: the everyday replay there, and whether it arrives - near enough to the goal, no contact deeper than its model reaches.

    with Arena.of(scene, plan, limits) as arena:
        arena.trial(world).ratio         # the largest of what is asked, as a share of its limit: up to 1 it arrives
        arena.checked(world).ratio       # the same by the reference

The FMU is loaded once, and reset before each world. Its step is the coarsest whose motion in the scene's own world ends where the reference's does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from fmpy.fmi1 import FMICallException

from models.codegen.kernel import load_kernel
from models.errors import TrajectoryError
from models.fmu import build_fmu
from models.scene import Scene
from models.scene.goal import distance, goal_state
from models.trajectory import Trajectory
from validate.fmi.description import Package, read_package, unpacked
from validate.fmi.instance import Instance, References, load_instance
from validate.judge.replay.everyday import Stepping, base_step, record_start, step_through
from validate.judge.replay.reference import ExchangeModel, integrate
from validate.judge.replay.result import ReplayOutcome, Run
from validate.judge.replay.run import EVENT_BUDGET
from validate.judge.replay.subject import find_variables
from validate.judge.replay.tracking import design_feedback
from validate.judge.replay.wiring import Feedback, Variables
from validate.judge.robustness.worlds import World, WorldInputs, nominal_world
from validate.judge.score import Score
from validate.judge.score.evidence import Evidence

# Internal steps a plan step, the coarsest first; the one whose end is as near to the reference's as this share of the limits is taken, else the last.
FINENESS = (2, 5, 10, 20, 50, 100, 200)
_CLOSE = 1e-3
# Relative tolerance of the reference: limits are told with three digits.
_RTOL = 1e-9
_POSITION, _VELOCITY = "replay_terminal_position_error", "replay_terminal_velocity_error"
_COST, _SPEED, _DEPTH = "replay_cost", "replay_velocity_bound_violation", "max_penetration"


@dataclass(frozen=True, kw_only=True, eq=False)
class Asked:
    """What arriving means.

    limits: of the metrics that are asked, by name [their units]: how far from the goal (2*nq,) (NaN: free) positions and velocities may end, what the motion
    may cost, how far velocities may leave lower, upper (nq,); depths (nc,): how deep each contact may be [m].
    """

    limits: Mapping[str, float]
    goal: np.ndarray
    depths: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(cls, scene: Scene, limits: Mapping[str, float]) -> Asked:
        """By the limits that the judge held this plan to, by metric. Raises TrajectoryError where none is on an end or a cost."""
        asked = {name: limits[name] for name in (_POSITION, _VELOCITY, _COST, _SPEED) if name in limits}
        if not asked.keys() - {_SPEED}:
            raise TrajectoryError(
                f"scene {scene.name}: it asks for no end that a plan must reach and limits no cost, so there is nothing to arrive at; robustness is measured on scenes that limit {_POSITION}, {_VELOCITY} or {_COST}."
            )
        own = scene.limit(_DEPTH)
        depths = np.array([math.inf if depth is None else depth for depth in scene.depths])
        if own is not None:
            depths = np.full(scene.nc, math.inf if own.value is None else own.value)
        lower, upper = (np.array([getattr(item, f"velocity_{side}") for item in scene.coordinates]) for side in ("lower", "upper"))
        return cls(limits=asked, goal=goal_state(scene.task), depths=depths, lower=lower, upper=upper)

    def shares(self, states: np.ndarray, gaps: np.ndarray, cost: float) -> dict[str, float]:
        """What is asked as shares of its limits.

        Parameters
        ----------
        states : (rows, 2*nq) of the motion, the last row its end [m or rad, then per second]
        gaps : (rows, nc) over the motion [m]
        cost : the task's

        Raises
        ------
        ValueError : if the shapes do not fit.
        """
        half, end = len(self.goal) // 2, states[-1]
        values = {
            _POSITION: lambda: distance(end[:half], self.goal[:half]),
            _VELOCITY: lambda: distance(end[half:], self.goal[half:]),
            _COST: lambda: cost,
            # The velocity of the end belongs to the goal.
            _SPEED: lambda: float(np.maximum(self.lower - states[:-1, half:], states[:-1, half:] - self.upper).max(initial=-math.inf)),
        }
        # A limit on a cost may be negative, or 0.
        shares = {name: 1.0 + (values[name]() - limit) / (abs(limit) or 1.0) for name, limit in self.limits.items()}
        if len(self.depths):
            shares[_DEPTH] = float(np.max(-gaps.min(axis=0, initial=math.inf) / self.depths))
        return shares


def asked_limits(score: Score) -> dict[str, float]:
    """What the judge held each metric to, by name."""
    return {metric.name: metric.limit for metric in score.metrics if metric.limit is not None}


@dataclass(frozen=True, kw_only=True, eq=False)
class WorldTrial:
    """One world: states (nodes, 2*nq) [m or rad, then per second] and gaps (nodes, nc) [m] at the plan's nodes, fewer where the motion ended early.

    cost: the task's, of this motion and its commands, NaN where it ended early; shares: what is asked as shares of its limits; empty where the motion did not come to its end.
    """

    states: np.ndarray
    gaps: np.ndarray
    cost: float
    shares: dict[str, float]
    outcome: ReplayOutcome

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray, float]:
        """What the shares are of: (rows, 2*nq) [m or rad, then per second], (rows, nc) [m], the cost. Raises nothing."""
        return self.states, self.gaps, self.cost

    @property
    def ratio(self) -> float:
        """The largest share; infinite where the motion did not come to its end."""
        return max(self.shares.values()) if self.shares else math.inf

    @property
    def arrives(self) -> bool:
        """Whether all that is asked stays within its limits."""
        return self.ratio <= 1.0

    @property
    def fails_by(self) -> str:
        """The metric with the largest share, or how the motion ended."""
        return max(self.shares, key=lambda name: self.shares[name]) if self.shares else self.outcome.name.lower()

    @property
    def modes(self) -> tuple[tuple[int, ...], ...]:
        """Which contacts are closed at the nodes, one after the other, without how long."""
        closed = [tuple(np.flatnonzero(row < 0.0).tolist()) for row in self.gaps]
        return tuple(now for before, now in zip([None, *closed], closed, strict=False) if now != before)


class Arena:
    """The FMU of a scene, in which a plan is tried in one world after the other.

    feedback: around the motion of the inputs alone in the scene's own world, or where that does not arrive around the plan; None where the plan has no
    states; followed: whether the plan holds only with it.
    """

    def __init__(self, scene: Scene, package: Package, plan: Trajectory, asked: Asked, followed: bool) -> None:
        """Raises FmuError, TrackingError; TrajectoryError if the plan does not fit the scene."""
        self.scene, self.plan, self.asked, self.followed, self._package = scene, plan, asked, followed, package
        self.nominal: World = nominal_world(scene, plan)
        every = find_variables(package, scene.continuous())
        # Only what is asked is read.
        self._variables: Variables = replace(every, lam=(), friction=(), energies={}, powers={})
        # An FMU of ours has every parameter of its scene, in the scene's order.
        self._parameters = [reference for reference, _ in every.parameters]
        self.feedback: Feedback | None = design_feedback(load_kernel(scene), scene, plan) if plan.has_states and scene.nu else None
        self._cost = Evidence(scene, plan, None).cost_of
        self._instance: Instance | None = None
        self.fineness = self._fine_enough()
        # It follows the motion that arrives: what the plan's own states differ from it by is the plan's grid, which is no disturbance and may be dear to undo.
        if self.feedback is not None and not followed and (own := self.trial(self.nominal)).arrives:
            self.feedback = replace(self.feedback, reference=own.states)

    @classmethod
    @contextmanager
    def of(cls, scene: Scene, plan: Trajectory, limits: Mapping[str, float], *, followed: bool = False) -> Iterator[Arena]:
        """An arena that is closed at the end. limits: what the judge held the plan to, by metric. Raises FmuError, MachineError, TrajectoryError."""
        with unpacked(read_package(build_fmu(scene, results=False))) as package:
            arena = cls(scene, package, plan, Asked.of(scene, limits), followed)
            try:
                yield arena
            finally:
                arena._close()

    def trial(self, world: World, *, feedback: bool = False) -> WorldTrial:
        """The everyday replay in a world. Raises FmuError."""
        return self._stepped(world, self.fineness, self.feedback if feedback else None)

    def checked(self, world: World, *, feedback: bool = False) -> WorldTrial:
        """The same by the reference: CVODE from event to event. Raises FmuError, MachineError."""
        inputs = WorldInputs(self.plan, world, self.feedback if feedback else None)
        model = ExchangeModel(self._package, replace(self._variables, parameters=tuple(self._settings(world))))
        try:
            run = integrate(model, world.start, inputs, _RTOL, EVENT_BUDGET, parts=1)
        finally:
            model.close()
        return self._trial(run, inputs)

    def _stepped(self, world: World, fineness: int, feedback: Feedback | None) -> WorldTrial:
        inputs, run, variables = WorldInputs(self.plan, world, feedback), Run(), self._variables
        given, start = References(variables.u), float(inputs.times[0])
        own_step, own_step_of = (
            base_step(self.plan.t) / fineness,
            References([variables.internal_step] if variables.internal_step is not None else []),
        )
        settings = [
            *self._settings(world),
            *zip(variables.start, world.start.tolist(), strict=True),
            *((item, own_step) for item in own_step_of.array),
        ]
        try:
            fmu = self._fresh()
            fmu.choose(variables.choices)
            fmu.initialise(start, settings, given, inputs.begin(0, None))
            stepping = Stepping(
                fmu=fmu, given=given, outputs=References(variables.outputs), inputs=inputs, parts=1, slopes=inputs.linear,
                states=len(variables.q) + len(variables.v), rolls_back=False, own_step_of=own_step_of, own_step=own_step,
            )  # fmt: skip
            if record_start(stepping, run):
                step_through(stepping, run)
        except FMICallException as error:
            run.end_refused(error, start)
            self._close()
        return self._trial(run, inputs)

    def _settings(self, world: World) -> list[tuple[int, float]]:
        return list(zip(self._parameters, world.parameters.tolist(), strict=True))

    def _fresh(self) -> Instance:
        """The instance as it was when it was made."""
        if self._instance is None:
            self._instance = load_instance(self._package, "CS")
        else:
            self._instance.fmu.terminate()
            self._instance.fmu.reset()
        return self._instance

    def _close(self) -> None:
        if self._instance is not None:
            self._instance.unload()
            self._instance = None

    def _trial(self, run: Run, inputs: WorldInputs) -> WorldTrial:
        values = np.array(run.outputs).reshape(len(run.t), len(self._variables.outputs))[run.knots]
        rows = inputs.rows[inputs.rows < len(values)]
        states, gaps = np.split(values[rows], [2 * self.scene.nq], axis=1)
        if run.outcome is not ReplayOutcome.OK:
            return WorldTrial(states=states, gaps=gaps, cost=math.nan, shares={}, outcome=run.outcome)
        q, v = np.hsplit(states, 2)
        cost = self._cost(self.plan.t, q, v, inputs.commands) if _COST in self.asked.limits else 0.0
        return WorldTrial(states=states, gaps=gaps, cost=cost, shares=self.asked.shares(states, gaps, cost), outcome=run.outcome)

    def _fine_enough(self) -> int:
        exact, feedback = self.checked(self.nominal, feedback=self.followed), self.feedback if self.followed else None
        for fineness in FINENESS[:-1]:
            found = self._stepped(self.nominal, fineness, feedback)
            if found.shares and all(abs(found.shares[name] - share) <= _CLOSE for name, share in exact.shares.items()):
                return fineness
        return FINENESS[-1]
