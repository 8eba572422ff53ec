"""Try a plan in perturbed worlds: an everyday replay each, and whether the plan arrives.

    with SceneArena.of(scene, plan, limits) as arena:
        arena.trial(world).ratio         # largest metric as a share of its limit; arrives up to 1
        arena.checked(world).ratio       # the same by the reference

The step is the coarsest whose motion ends near the reference's, in the model's own world and, of a
scene, in two perturbed ones; otherwise the reference is used. A scene's FMU stays loaded. An
external FMU runs in a child process (`FmuArena`), whose crash is a failed world. Co-Simulation is
checked by Model Exchange or half the smallest step, Model Exchange by a second tolerance.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np

from models.codegen.kernel import Kernel, load_kernel
from models.collocation import lowest_between, penetration_rates
from models.errors import TrajectoryError
from models.fmu import build_fmu
from models.scene import Scene
from models.scene.default_limits import replay_limits
from models.scene.goal import distance, goal_state
from models.trajectory import Trajectory
from validate.fmi.description import FmuError, Package, read_package, unpacked
from validate.fmi.instance import Instance, load_instance
from validate.judge.judgement import WiredFmu
from validate.judge.replay.everyday import simulate
from validate.judge.replay.job import Job
from validate.judge.replay.reference import ExchangeModel, integrate
from validate.judge.replay.result import ReplayOutcome, Run
from validate.judge.replay.run import (
    EVENT_BUDGET,
    LOOKS,
    OWN_STEP,
    foreign_job,
    in_plan_units,
    with_rows,
)
from validate.judge.replay.run import FINENESS as JUDGED
from validate.judge.replay.subject import Subject, find_variables, recorded
from validate.judge.replay.tracking import TrackingError, design_feedback, design_foreign
from validate.judge.replay.wiring import Feedback, HeldInputs, Variables, World, WorldInputs
from validate.judge.robustness.worlds import moved, nominal_world, perturbations
from validate.judge.score import Score
from validate.judge.score.evidence import Evidence
from validate.processes.isolated import IsolatedCalls

# Internal steps per plan step: the coarsest that ends near the reference is used, else the last.
FINENESS = (2, 5, 10, 20, 50, 100, 200)
# Fineness that selects the reference.
REFERENCE = -1
# Relative tolerance of the reference; limits have three digits.
RTOL = 1e-9
# Parts of a repeated piece between two rows, increased until its depth is known.
_PARTS = (32, 128, 512, 2048, 8192, 32768)
# Largest share of a depth between rows for which the cubic is used, right to 1e-4.
_CUBIC = 0.01
# Tolerance of gaps over that of shares.
_ROUGHLY = 10.0
# Depths below this share of the limit are not resolved.
_SHALLOW = 1e-3

_POSITION = "replay_terminal_position_error"
_VELOCITY = "replay_terminal_velocity_error"
_COST = "replay_cost"
_SPEED = "replay_velocity_bound_violation"
_DEPTH = "max_penetration"
_MOTION = "replay_error"


@dataclass(frozen=True, kw_only=True, eq=False)
class Asked:
    """Conditions of arrival, for q [m or rad] and velocities.

    - limits: by metric [their units].
    - goal (2*nq,), NaN if free.
    - depths (nc,): largest penetrations [m].
    - lower, upper (nq,): bounds of velocities.
    - near (nq,): largest distance from the planned positions (nodes, nq), None if not a condition.
    """

    limits: Mapping[str, float]
    goal: np.ndarray
    depths: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    near: np.ndarray | None = None
    planned: np.ndarray | None = None

    @classmethod
    def of(
        cls, scene: Subject, limits: Mapping[str, float], plan: Trajectory | None = None
    ) -> Asked:
        """Return the conditions of the judge's limits, by metric.

        On an FMU without a goal the plan's own motion is the goal. Raises TrajectoryError if
        neither end, cost nor motion is limited.
        """
        known_limits = {
            name: limits[name] for name in (_POSITION, _VELOCITY, _COST, _SPEED) if name in limits
        }
        near = None
        if not known_limits.keys() - {_SPEED}:
            if isinstance(scene, Scene):
                raise TrajectoryError(
                    f"scene {scene.name}: it asks for no end that a plan must reach and limits no cost, so there is nothing to arrive at; robustness is measured on scenes that limit {_POSITION}, {_VELOCITY} or {_COST}."
                )
            if _MOTION not in limits or plan is None:
                raise TrajectoryError(
                    f"FMU {scene.name}: there is nothing to arrive at, as its map gives no [goal], and {_MOTION} is not asked (the plan says no positions, or the map waives it); give it one of the two."
                )
            near = replay_limits(scene)
        depth_limit = scene.limit(_DEPTH)
        depths = np.array([math.inf if depth is None else depth for depth in scene.depths])
        if depth_limit is not None:
            depths = np.full(scene.nc, math.inf if depth_limit.value is None else depth_limit.value)
        lower, upper = (
            np.array([getattr(item, f"velocity_{side}") for item in scene.coordinates])
            for side in ("lower", "upper")
        )
        planned = None if near is None or plan is None else plan.q
        goal = goal_state(scene.task)  # type: ignore[arg-type] - a foreign task has the same goal
        return cls(
            limits=known_limits,
            goal=goal,
            depths=depths,
            lower=lower,
            upper=upper,
            near=near,
            planned=planned,
        )

    def shares(self, states: np.ndarray, gaps: np.ndarray, cost: float) -> dict[str, float]:
        """Return each condition as a share of its limit.

        states: (rows, 2*nq), the last row the end [m or rad, then per second]; gaps: (rows, nc)
        [m]. Raises ValueError if the shapes do not fit.
        """
        half, end = len(self.goal) // 2, states[-1]
        values = {
            _POSITION: lambda: distance(end[:half], self.goal[:half]),
            _VELOCITY: lambda: distance(end[half:], self.goal[half:]),
            _COST: lambda: cost,
            # The velocity of the end belongs to the goal.
            _SPEED: lambda: float(
                np.maximum(self.lower - states[:-1, half:], states[:-1, half:] - self.upper).max(
                    initial=-math.inf
                )
            ),
        }
        # A limit on the cost may be 0 or negative.
        shares = {
            name: 1.0 + (values[name]() - limit) / (abs(limit) or 1.0)
            for name, limit in self.limits.items()
        }
        if self.near is not None:
            away = np.abs(states[:, :half] - self.planned).max(axis=0)
            shares[_MOTION] = float(
                np.max(1.0 + (away - self.near) / np.where(self.near > 0.0, self.near, 1.0))
            )
        if len(self.depths):
            shares[_DEPTH] = self.depth_share(gaps.min(axis=0, initial=math.inf))
        return shares

    def depth_share(self, lowest: np.ndarray) -> float:
        """Return the deepest contact as a share of its depth [-]; lowest: least gaps (nc,) [m].

        Raises ValueError without contacts.
        """
        return float(np.max(-lowest / self.depths))


def asked_limits(score: Score) -> dict[str, float]:
    """Return the judge's limits by metric."""
    return {metric.name: metric.limit for metric in score.metrics if metric.limit is not None}


@dataclass(frozen=True, kw_only=True, eq=False)
class WorldTrial:
    """The motion in one world: states (nodes, 2*nq) [SI] and gaps (nodes, nc) [m] at plan nodes.

    shares: conditions as shares of their limits, empty if the motion ended early.
    """

    states: np.ndarray
    gaps: np.ndarray
    shares: dict[str, float]
    outcome: ReplayOutcome

    @property
    def ratio(self) -> float:
        """Return the largest share, infinite if the motion ended early."""
        return max(self.shares.values()) if self.shares else math.inf

    @property
    def arrives(self) -> bool:
        """Return whether all conditions are met."""
        return self.ratio <= 1.0

    @property
    def fails_by(self) -> str:
        """Return the metric with the largest share, or how the motion ended."""
        return (
            max(self.shares, key=lambda name: self.shares[name])
            if self.shares
            else self.outcome.name.lower()
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Ran:
    """A run: states (nodes, 2*nq) and gaps (nodes, nc) at the plan's nodes, commands (steps, nu).

    lowest: returns the least gaps (nc,) [m], exact for contacts deeper than its argument (nc,).
    """

    outcome: ReplayOutcome
    states: np.ndarray
    gaps: np.ndarray
    lowest: Callable[[np.ndarray], np.ndarray]
    commands: np.ndarray


class Arena(ABC):
    """Tries a plan in one world after the other; subclasses define `_run`.

    - feedback: around the open motion in the model's own world, or around the plan if that motion
      does not arrive; None if impossible.
    - followed: the plan holds only with feedback.
    - nominal: the model's own world.
    - fineness: internal steps per plan step.
    """

    by = "by the reference"
    # Tolerance of a fineness in the model's own world, as a share of the limits.
    near = 1e-3
    levels: Sequence[int] = FINENESS
    # CPU time in other processes [s].
    seconds = 0.0
    trials = 0

    def __init__(
        self,
        scene: Subject,
        plan: Trajectory,
        asked: Asked,
        followed: bool,
        feedback: Feedback | None,
    ) -> None:
        """Raises FmuError."""
        self.scene, self.plan, self.asked, self.followed, self.feedback = (
            scene,
            plan,
            asked,
            followed,
            feedback,
        )
        self.nominal: World = nominal_world(scene, plan)
        self.probes: Sequence[World] = (self.nominal,)
        self._cost = Evidence(scene, plan, None).cost_of

    def settle(self) -> Self:
        """Choose the fineness and the feedback's reference. Raises FmuError."""
        self.fineness = self._fine_enough()
        # The plan's states differ from the arriving motion by the grid's error, which feedback must
        # not
        # correct.
        if (
            self.feedback is not None
            and not self.followed
            and (open_trial := self._tried(self.nominal, self.fineness, False)).arrives
        ):
            self.feedback = replace(self.feedback, reference=open_trial.states)
        return self

    @abstractmethod
    def _run(self, world: World, fineness: int, feedback: Feedback | None) -> _Ran:
        """Run the plan in a world."""

    @abstractmethod
    def close(self) -> None:
        """Free the FMU."""

    def trial(self, world: World, *, feedback: bool = False) -> WorldTrial:
        """Run the everyday replay in a world. Raises FmuError."""
        self.trials += 1
        return self._tried(world, self.fineness, feedback)

    def checked(self, world: World, *, feedback: bool = False) -> WorldTrial:
        """Run the reference in a world, or finer steps. Raises FmuError, MachineError."""
        return self._tried(world, REFERENCE, feedback)

    def _tried(self, world: World, fineness: int, feedback: bool) -> WorldTrial:
        ran = self._run(world, fineness, self.feedback if feedback else None)
        shares = self._shares(ran) if ran.outcome is ReplayOutcome.OK else {}
        return WorldTrial(states=ran.states, gaps=ran.gaps, shares=shares, outcome=ran.outcome)

    def _shares(self, ran: _Ran) -> dict[str, float]:
        q, v = np.hsplit(ran.states, 2)
        cost = self._cost(self.plan.t, q, v, ran.commands) if _COST in self.asked.limits else 0.0
        shares = self.asked.shares(ran.states, ran.gaps, cost)
        if shares.pop(_DEPTH, None) is not None:
            # A depth matters only if it exceeds another failing share.
            others = max(shares.values(), default=0.0)
            lowest = ran.lowest(self.asked.depths * (others if others > 1.0 else _SHALLOW))
            shares[_DEPTH] = self.asked.depth_share(lowest)
        return shares

    def _fine_enough(self) -> int:
        exact = [self.checked(world, feedback=self.followed) for world in self.probes]
        for fineness in self.levels[:-1]:
            tried = (self._tried(world, fineness, self.followed) for world in self.probes)
            if all(self._is_near(*pair) for pair in zip(tried, exact, strict=True)):
                return fineness
        return self.levels[-1]

    def _is_near(self, trial: WorldTrial, exact: WorldTrial) -> bool:
        """Return whether shares (or the failing one) and, roughly, gaps agree.

        A depth alone may agree by chance, as if the first of many bounces is deepest.
        """
        if trial.outcome is not exact.outcome or not exact.shares:
            return trial.outcome is exact.outcome
        names = exact.shares if exact.arrives else [exact.fails_by]
        shares = all(
            abs(trial.shares[name] - exact.shares[name])
            <= self.near * max(1.0, abs(exact.shares[name]))
            for name in names
        )
        return shares and bool(
            (np.abs(trial.gaps - exact.gaps) <= _ROUGHLY * self.near * self.asked.depths).all()
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Motion:
    """A scene's motion in a world: t (rows,) [s] and values (rows, 2*nq + nc) of the FMU.

    variables and kernel have the world's parameters.
    """

    t: np.ndarray
    values: np.ndarray
    inputs: HeldInputs
    variables: Variables
    kernel: Kernel


class SceneArena(Arena):
    """A scene's own FMU in this process, loaded once and reset before each world."""

    levels = (*FINENESS, REFERENCE)

    def __init__(
        self, scene: Scene, package: Package, plan: Trajectory, asked: Asked, followed: bool
    ) -> None:
        """Raises FmuError, TrackingError; TrajectoryError if the plan does not fit the scene."""
        self._kernel = load_kernel(scene)
        feedback = (
            design_feedback(self._kernel, scene, plan) if plan.has_states and scene.nu else None
        )
        super().__init__(scene, plan, asked, followed, feedback)
        causes = perturbations(scene, plan)
        self.probes = [
            self.nominal,
            *(moved(self.nominal, causes, np.full(len(causes), size)) for size in (-1.0, 1.0)),
        ]
        self._package, every = package, find_variables(package, scene.continuous())
        # Only outputs of conditions are read.
        self._variables = replace(every, lam=(), friction=(), energies={}, powers={})
        self._instance: Instance | None = None

    @classmethod
    @contextmanager
    def of(
        cls, scene: Scene, plan: Trajectory, limits: Mapping[str, float], *, followed: bool = False
    ) -> Iterator[Arena]:
        """Return a context with the arena; limits: the judge's, by metric.

        Raises FmuError, MachineError, TrajectoryError.
        """
        asked = Asked.of(scene, limits)
        with (
            unpacked(read_package(build_fmu(scene))) as package,
            closing(cls(scene, package, plan, asked, followed)) as arena,
        ):
            yield arena.settle()

    def _run(self, world: World, fineness: int, feedback: Feedback | None) -> _Ran:
        inputs = WorldInputs(self.plan, world, feedback)
        # Our FMU has every parameter of its scene, in the scene's order.
        parameters = [
            (reference, value)
            for (reference, _), value in zip(
                self._variables.parameters, world.parameters.tolist(), strict=True
            )
        ]
        variables = replace(self._variables, parameters=tuple(parameters))
        if fineness == REFERENCE:
            with closing(ExchangeModel(self._package, variables)) as model:
                run = integrate(model, world.start, inputs, RTOL, EVENT_BUDGET, parts=1)
        else:
            run = self._simulate(variables, world.start, inputs, fineness)
        values, kernel = (
            np.array(run.outputs).reshape(len(run.t), len(variables.outputs)),
            self._kernel.with_parameters(world.parameters),
        )
        motion = _Motion(
            t=np.array(run.t), values=values, inputs=inputs, variables=variables, kernel=kernel
        )
        nodes = values[run.knots]
        states, gaps = np.split(
            nodes[inputs.rows[inputs.rows < len(nodes)]], [2 * self.scene.nq], axis=1
        )
        return _Ran(
            outcome=run.outcome,
            states=states,
            gaps=gaps,
            lowest=partial(self._lowest, motion),
            commands=inputs.commands,
        )

    def _lowest(self, motion: _Motion, reach: np.ndarray) -> np.ndarray:
        """Return the least gaps (nc,) [m] of a motion, between rows too.

        Pieces that may be lowest, and as deep as `reach` (nc,) [m], are repeated with smaller
        steps.
        """
        lowest, pieces, possible = self._told(motion)
        possible[possible > -reach] = math.inf
        for contact in range(len(lowest) if len(pieces) else 0):
            while possible[place := int(possible[:, contact].argmin()), contact] < lowest[contact]:
                lowest, possible[place] = (
                    np.minimum(lowest, self._within(motion, int(pieces[place]))),
                    math.inf,
                )
        return lowest

    def _within(self, motion: _Motion, piece: int) -> np.ndarray:
        """Return the least gaps (nc,) [m] between two rows, by smaller and smaller steps."""
        lowest = motion.values[piece, 2 * self.scene.nq :]
        for parts in _PARTS:
            lowest, _, possible = self._told(self._again(motion, piece, parts))
            if np.isinf(possible).all():
                break
        return lowest

    def _told(self, motion: _Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the least gaps (nc,) [m] known from a motion's rows, and the uncertain pieces.

        Pieces (n,) between two rows, and how low each may be (n, nc) [m], infinite if known.
        """
        nq, gap = self.scene.nq, motion.values[:, 2 * self.scene.nq :]
        by_contact = np.ascontiguousarray(gap.T)  # five times as fast with many rows
        lowest, moves = (
            by_contact.min(axis=1, initial=math.inf),
            np.abs(np.diff(by_contact)).max(axis=1, initial=0.0),
        )
        # A contact within a piece is no farther away than twice the largest change of its gap;
        # twice that
        # shows the acceleration too.
        close = by_contact < (np.minimum(lowest, 0.0) + 4.0 * moves)[:, None]
        pieces = np.flatnonzero((close[:, :-1] | close[:, 1:]).any(axis=0))
        if not len(pieces):
            return lowest, pieces, np.empty((0, len(lowest)))
        rows, h = (
            np.concatenate([pieces, pieces + 1]),
            (motion.t[pieces + 1] - motion.t[pieces])[:, None],
        )
        rate, gap = (
            -penetration_rates(
                motion.kernel, motion.values[rows, :nq], motion.values[rows, nq : 2 * nq]
            ),
            gap[rows],
        )
        (first, last), (begins, comes) = np.split(gap, 2), rate.reshape(2, len(pieces), -1)
        ends, floor = np.minimum(first, last), np.maximum(-lowest, _SHALLOW * self.asked.depths)
        # If the cubic stays above its ends, and its mean rate matches the gap's change, the rows
        # suffice.
        beyond = ends - np.minimum(first + h * begins / 3.0, last - h * comes / 3.0)
        known = (
            np.maximum(beyond, np.abs(last - first - h * (begins + comes) / 2.0)) <= _CUBIC * floor
        )
        deep = np.flatnonzero((known & (ends - beyond < np.minimum(lowest, 0.0))).any(axis=1))
        if len(deep):
            pairs = np.column_stack([deep, deep + len(pieces)]).ravel()
            between = lowest_between(motion.t[rows[pairs]], gap[pairs], rate[pairs])[0][::2]
            lowest = np.minimum(lowest, between.min(axis=0, initial=math.inf, where=known[deep]))
        # Elsewhere the gap is above its tangents, except for pressing accelerations, at most twice
        # the
        # largest without contact.
        pressed = (
            2.0
            * np.maximum(((begins - comes) / np.maximum(h, 1e-3 * h.max())).max(axis=0), 0.0)
            * h
        )
        begins, comes = begins - pressed, comes + pressed
        late = np.clip(
            np.divide(
                h * comes - (last - first),
                comes - begins,
                out=np.zeros_like(h * comes),
                where=comes > begins,
            ),
            0.0,
            h,
        )
        return lowest, pieces, np.where(known, math.inf, np.minimum(ends, first + begins * late))

    def _again(self, motion: _Motion, piece: int, parts: int) -> _Motion:
        (begin, end), inputs, nx = motion.t[piece : piece + 2], motion.inputs, 2 * self.scene.nq
        t, step = (
            np.linspace(begin, end, parts + 1),
            int(np.searchsorted(inputs.times, (begin + end) / 2.0)) - 1,
        )
        u = (
            inputs.values[step]
            + inputs.slopes[step] * ((t[:-1] + t[1:]) / 2.0 - inputs.times[step])[:, None]
        )
        still = np.zeros((len(t), self.scene.nq))
        held = HeldInputs(
            Trajectory(t=t, q=still, v=still, u=u, lam=np.zeros((parts, self.scene.nl)))
        )
        run = self._simulate(motion.variables, motion.values[piece, :nx], held, 2)
        return replace(
            motion,
            t=np.array(run.t),
            values=np.array(run.outputs).reshape(len(run.t), motion.values.shape[1]),
        )

    def _simulate(
        self, variables: Variables, start: np.ndarray, inputs: HeldInputs, fineness: int
    ) -> Run:
        """Run the everyday replay from (2*nq,) on the kept instance; drop a failed instance."""
        run = simulate(self._package, variables, start, inputs, fineness, fmu=self._fresh())
        if run.outcome in (ReplayOutcome.FMU_FAILED, ReplayOutcome.FATAL):
            self.close()
        return run

    def _fresh(self) -> Instance:
        if self._instance is None:
            self._instance = load_instance(self._package, "CS")
        else:
            self._instance.fmu.terminate()
            self._instance.fmu.reset()
        return self._instance

    def close(self) -> None:
        """Unload the FMU."""
        if self._instance is not None:
            self._instance.unload()
            self._instance = None


# Fineness that selects Model Exchange at a loose tolerance.
_LOOSELY = 0
# Relative tolerance of that run.
_LOOSE = 1e-7
# Tolerance for half the smallest step: no first-order step comes within 1e-3 of the limits.
_NEAR = 1e-2


class FmuArena(Arena):
    """An external FMU in a child process."""

    def __init__(self, wired: WiredFmu, asked: Asked, followed: bool) -> None:
        """Raises FmuError, TrajectoryError."""
        foreign, package, plan = wired.foreign, wired.package, wired.plan
        self._foreign, self._child = foreign, IsolatedCalls(wired.limits, f"FMU {package.path}")
        steps, exchange = package.cosimulation, package.exchange is not None and not wired.own_step
        # Many FMUs require even steps, and --own-step allows no other.
        uneven = (
            steps is not None
            and not wired.own_step
            and steps.canHandleVariableCommunicationStepSize
        )
        whole = not uneven and not exchange
        super().__init__(foreign.model, plan, asked, followed, None if whole else _feedback(wired))
        self.nominal = replace(self.nominal, whole=whole)
        # Rows as in a replay; none are added with --own-step.
        self._longest = math.inf if wired.own_step else plan.duration / LOOKS
        plans = with_rows(plan, self._longest), plan
        looked_at, job = (
            foreign_job(foreign, package, one, wired.limits, wired.own_step) for one in plans
        )
        parts = max(job.parts, math.ceil(float(np.diff(plan.t).max()) / self._longest))
        self._job = replace(job, child=self._child, parts=parts)
        factor = max(looked_at.fineness) // max(JUDGED if package.exchange else OWN_STEP)
        steady = OWN_STEP[::-1] if foreign.variables.internal_step is None else FINENESS
        self.levels = (
            OWN_STEP[-1:]
            if wired.own_step
            else tuple(factor * fineness for fineness in steady)
            if whole or uneven
            else ()
        )
        finest = OWN_STEP[0] if wired.own_step else 2 * max(self.levels, default=0)
        self.levels += (_LOOSELY,) if exchange else ()
        self._exact = {
            "tolerances": (RTOL,) if exchange else (),
            "fineness": () if exchange else (finest,),
        }
        if not exchange:
            self.by, self.near = (
                f"with {'a fifth of the' if wired.own_step else 'half the smallest'} step",
                _NEAR,
            )

    @classmethod
    @contextmanager
    def of(
        cls, wired: WiredFmu, limits: Mapping[str, float], *, followed: bool = False
    ) -> Iterator[Arena]:
        """Return a context with the arena; limits: the judge's, by metric.

        Raises FmuError, MachineError, TrajectoryError.
        """
        with closing(
            cls(wired, Asked.of(wired.foreign.model, limits, wired.plan), followed)
        ) as arena:
            yield arena.settle()

    def _run(self, world: World, fineness: int, feedback: Feedback | None) -> _Ran:
        level = (
            {"tolerances": (_LOOSE,), "fineness": ()}
            if fineness == _LOOSELY
            else {"tolerances": (), "fineness": (fineness,)}
        )
        level = self._exact if fineness == REFERENCE else level
        world = (
            world if level["tolerances"] else replace(world, longest=self._longest)
        )  # Model Exchange always has rows within steps
        foreign, inputs, nx = (
            self._foreign,
            WorldInputs(self.plan, world, feedback),
            2 * self.scene.nq,
        )
        try:
            job = replace(self._moved(world), **level)
            simulated = in_plan_units(
                foreign, job.run(None if feedback is None else feedback.in_units(*foreign.units))
            )
        except FmuError:  # a failure in this world is not the user's mistake
            nothing = np.empty((0, nx + self.scene.nc))
            return self._told(
                ReplayOutcome.FMU_FAILED, nothing[:, :nx], nothing[:, nx:], nothing[:, nx:], inputs
            )
        self.seconds += simulated.seconds_reference + simulated.seconds_everyday
        run = simulated.judged
        motion = recorded(foreign.model, foreign.variables, run)
        rows = np.array(run.knots, dtype=int)[inputs.rows[inputs.rows < len(run.knots)]]
        return self._told(
            run.outcome, np.hstack([motion.q, motion.v])[rows], motion.gap[rows], motion.gap, inputs
        )

    @staticmethod
    def _told(
        outcome: ReplayOutcome,
        states: np.ndarray,
        gaps: np.ndarray,
        every: np.ndarray,
        inputs: WorldInputs,
    ) -> _Ran:
        """Return a run; every: gaps (points, nc) [m] of all points."""
        lowest = every.min(axis=0, initial=math.inf)
        return _Ran(
            outcome=outcome,
            states=states,
            gaps=gaps,
            lowest=lambda _: lowest,
            commands=inputs.commands,
        )

    def _moved(self, world: World) -> Job:
        foreign, nominal = self._foreign, self.nominal
        (scale, offset), (times, plus) = foreign.units
        parameters, start = (
            dict(foreign.variables.parameters),
            dict(zip(foreign.variables.start, foreign.start.tolist(), strict=True)),
        )
        for place in np.flatnonzero(world.parameters != nominal.parameters):
            parameters[foreign.parameters[place]] = float(world.parameters[place])
        states = (world.start[: len(scale)] - offset) / scale
        for place in np.flatnonzero(world.start != nominal.start):
            start[(foreign.variables.q + foreign.variables.v)[place]] = float(states[place])
        noise = times * world.noise + plus * (1.0 - world.gain)
        return replace(
            self._job, start=np.array(list(start.values())),
            world=replace(world, start=states, noise=noise),
            variables=replace(self._job.variables, parameters=tuple(parameters.items()),
                              start=tuple(start)),
        )  # fmt: skip

    def close(self) -> None:
        """End the child process."""
        self._child.close()


def _feedback(wired: WiredFmu) -> Feedback | None:
    """Return the judge's feedback, None if the FMU has no derivatives."""
    try:
        return design_foreign(wired.foreign, wired.package, wired.plan, wired.limits)[0]
    except TrackingError:
        return None
