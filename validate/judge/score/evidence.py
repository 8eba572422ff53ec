"""Data of the metrics: the plan, its replay, and the plan's inputs on its grid with true contact.

A KernelError of the compiled functions counts as Unmeasured in the score.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cached_property

import numpy as np
import sympy as sp
from numpy.polynomial.legendre import leggauss

from models import collocation
from models.codegen.kernel import Kernel, load_kernel
from models.dynamics import derive
from models.scene import Scene
from models.scene.contacts import DampingLaw
from models.scene.default_limits import replay_limits
from models.scene.goal import goal_state
from models.scene.impulses import common_impulse, force_window, impulse_yardstick
from models.scene.typical_force import typical_force
from models.schemes import Scheme
from models.trajectory import Trajectory
from validate.judge.printed import columns_rounding
from validate.judge.replay.result import Difference, Replay, ReplayOutcome
from validate.judge.replay.subject import Subject
from validate.judge.replay.wiring import HeldInputs
from validate.judge.score.forces import by_convention, cubic, least_slip, within_steps
from validate.judge.score.verdict import LeavesBounds, Unmeasured

# Gauss-Legendre points and weights on (0, 1), exact for squares of cubics.
_POINTS, _WEIGHTS = (
    part / 2.0 + shift for part, shift in zip(leggauss(4), (0.5, 0.0), strict=True)
)

_HALVINGS = 7
# A halving with a relative change below this is idle; after two the rest is not the grid's error.
_IDLE = 0.01


class Evidence:
    """Arrays by the symbols of the equations, each computed once."""

    def __init__(self, scene: Subject, trajectory: Trajectory, replay: Replay | None) -> None:
        self.scene, self.trajectory, self.replayed = scene, trajectory, replay
        # Motions by parts of a step; collocation takes 7 s, and several metrics need the same motion.
        self._own_motions: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    @property
    def equations(self) -> Scene:
        """Return the scene; raise Unmeasured for an external FMU."""
        if not isinstance(self.scene, Scene):
            raise Unmeasured(
                "it needs the equations, which only a scene has; an FMU keeps its own to itself."
            )
        return self.scene

    @cached_property
    def kernel(self) -> Kernel:
        """Return the compiled functions. Raises Unmeasured for an external FMU."""
        return load_kernel(self.equations)

    @property
    def lacking(self) -> Mapping[str, str]:
        """Return the groups that an external FMU lacks, with reasons; empty for a scene."""
        return {} if isinstance(self.scene, Scene) else self.scene.lacks

    def need(self, *parts: str) -> None:
        """Raise Unmeasured if an external FMU lacks one of these groups."""
        for part in parts:
            if part in self.lacking:
                raise Unmeasured(f"{self.lacking[part]}.")

    @property
    def q(self) -> np.ndarray:
        """Return the plan's positions (nodes, nq) [m or rad]. Raises Unmeasured if missing."""
        self.need("q")
        return self._stated("q", "positions", self.trajectory.q)

    def _stated(self, group: str, words: str, values: np.ndarray) -> np.ndarray:
        if group in self.trajectory.missing:
            raise Unmeasured(f"the plan does not say its {words}.")
        return values

    @cached_property
    def goal(self) -> np.ndarray:
        """Return the goal (2*nq,) [m or rad, m/s or rad/s], NaN if free. Raises nothing."""
        return goal_state(self.scene.task)  # type: ignore[arg-type] - a foreign task has the same goal

    @cached_property
    def h(self) -> np.ndarray:
        """Return the plan's steps (steps,) [s], the nominal one if all equal it. Raises nothing."""
        h = np.diff(self.trajectory.t)
        step = self.scene.task.step
        return np.full_like(h, step) if np.allclose(h, step, rtol=1e-9, atol=0.0) else h

    def cost_of(self, t: np.ndarray, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> float:
        """Return the task's cost of a motion: running cost per step of the task, and final cost.

        Between rows positions are cubics, without inertia lines. t: (n,) [s]; q, v: (n, nq) [m or
        rad, m/s or rad/s]; u: (steps, nu) [N or N m]. Raises Unmeasured for an external FMU.
        """
        h, nodes, held = np.diff(t)[:, None], self.trajectory.t, self.held_inputs
        step = np.clip(np.searchsorted(nodes, t[:-1], side="right") - 1, 0, len(u) - 1)
        first = u[step] + held.slopes[step] * (t[:-1] - nodes[step])[:, None]
        begins, ends = h * v[:-1], h * v[1:]
        if self.equations.relaxation_index is not None:
            begins = ends = np.diff(q, axis=0)
        cost = self._final_cost(q[-1], v[-1])
        for s, weight in zip(_POINTS, _WEIGHTS, strict=True):
            place, speed = cubic(q, begins, ends, s)
            speed = np.divide(speed, h, out=v[:-1].copy(), where=h > 0.0)
            rate = self._running_cost(place, speed, first + s * h * held.slopes[step])
            cost += weight * float(h[:, 0] @ rate) / self.scene.task.step
        return cost

    @property
    def cost_of_rows(self) -> float:
        """Return the task's cost as methods compute it, by the states at the starts of steps.

        Linear inputs count at the middle of their step. Raises Unmeasured.
        """
        q, v, h = self.q, self.v, self.h
        u = self.trajectory.u + self.held_inputs.slopes * h[:, None] / 2.0
        rate = self._running_cost(q[:-1], v[:-1], u)
        return float(h / self.scene.task.step @ rate) + self._final_cost(q[-1], v[-1])

    def _running_cost(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the running cost (n,) per step of the task; q, v: (n, nq), u: (n, nu)."""
        return np.broadcast_to(self._running(q.T, v.T, u.T), (len(q),))

    @cached_property
    def _running(self) -> Callable[..., np.ndarray]:
        d = derive(self.equations)
        cost = d.running_cost.subs(self.equations.parameter_values)
        return sp.lambdify([list(d.q), list(d.v), list(d.u)], cost, modules=[np])

    def _final_cost(self, q: np.ndarray, v: np.ndarray) -> float:
        return self.kernel.cost(q[None], v[None], np.zeros((0, self.scene.nu)))

    @cached_property
    def push(self) -> np.ndarray:
        """Return the argument (steps, nc) [N] of the true force max(0, .): k phi, with damping.

        Raises Unmeasured for an external FMU, or without velocities that damping needs.
        """
        q = self.trajectory.q[:-1]
        return (
            self.kernel.contact_push(q, self.v[:-1])
            if self.equations.damped
            else self.k * self.kernel.penetration(q)
        )

    @cached_property
    def k(self) -> np.ndarray:
        """Return the stiffnesses (nc,) [N/m]. Raises Unmeasured for an external FMU."""
        return self.kernel.stiffness()

    @cached_property
    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest derivatives of contact forces, (nc,) [N/m] by depth, [N s/m] by rate.

        Raises Unmeasured without equations or a finished replay.
        """
        scene, k = self.equations, self.k
        if not scene.damped:
            return k, np.zeros_like(k)
        d, depth = derive(scene), np.maximum(-self.replay_gap, 0.0)
        c = d.function(d.damping)().ravel()
        laws = [contact.damping_law for contact in scene.contacts]
        linear = np.array([law is DampingLaw.KELVIN_VOIGT for law in laws])
        pressed, none = depth > 0.0, np.zeros_like(depth)
        share = np.divide(self.replay.lam, k * depth, out=none, where=pressed).max(axis=0)
        by_depth = np.where(linear, k, k * np.maximum(share, 1.0))  # Hunt-Crossley: 1 + d phi'
        return by_depth, np.where(linear, c, c * k * depth.max(axis=0))

    @cached_property
    def length(self) -> np.ndarray:
        """Return the nominal penetrations L (nc,) [m]. Raises Unmeasured for an external FMU."""
        return np.array([contact.nominal for contact in self.equations.contacts])

    @property
    def lam(self) -> np.ndarray:
        """Return the plan's contact forces (steps, nc) [N], zero if missing. Raises nothing."""
        return self.trajectory.lam[:, : self.scene.nc]

    @cached_property
    def typical_force(self) -> float:
        """Return the scale of contact forces [N], of an FMU the map's. Raises Unmeasured."""
        if isinstance(self.scene, Scene):
            return typical_force(self.scene, self.kernel)
        stated = [item.nominal_force for item in self.scene.contacts]
        known = [force for force in stated if force is not None]
        if not known:
            raise Unmeasured("the map states no nominal_force of a contact.")
        return max(known)

    @cached_property
    def within_steps(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return q, v (steps, nq) [m or rad, per s] at parts of steps. Raises Unmeasured."""
        return within_steps(self.q, self.trajectory.v, np.diff(self.trajectory.t))

    @cached_property
    def law_within(self) -> np.ndarray:
        """Return the true contact forces (parts, steps, nc) [N] in steps. Raises Unmeasured."""
        damped, pairs = self.equations.damped, zip(*self.within_steps, strict=True)
        forces = [self.kernel.contact_force(q, v=v if damped else None) for q, v in pairs]
        return np.array(forces)

    @cached_property
    def laws(self) -> dict[str, np.ndarray]:
        """Return the true contact forces (steps, nc) [N] by convention. Raises Unmeasured."""
        return by_convention(self.law_within, self._replayed_means)

    @property
    def _replayed_means(self) -> np.ndarray | None:
        if self.replayed is None or not self.replayed.ok or self.replayed.contact_impulse is None:
            return None
        impulses = np.diff(self.replayed.contact_impulse[self.replayed.knots], axis=0)
        return impulses / np.diff(self.trajectory.t)[:, None]

    @cached_property
    def convention(self) -> str:
        """Return the convention nearest to the plan's contact forces, "" without forces."""
        if "lam" in self.trajectory.missing or not self.scene.nc:
            return ""
        off = {name: self.h @ np.abs(self.lam - law) for name, law in self.laws.items()}
        return min(off, key=lambda name: float(off[name].sum()))

    @cached_property
    def rounding_of_law(self) -> np.ndarray:
        """Return the change (steps, nc) [N] of forces by rounding of q. Raises Unmeasured."""
        moved = np.zeros((len(self.q), self.scene.nc))
        for unit, rounding in zip(np.eye(self.scene.nq), self.rounding["q"].T, strict=True):
            if rounding.any():
                along = np.broadcast_to(unit, self.q.shape)
                rates = collocation.penetration_rates(self.kernel, self.q, along)
                moved += np.abs(rates) * rounding[:, None]
        return self.k * np.maximum(moved[:-1], moved[1:])

    @cached_property
    def impulse_yardstick(self) -> float:
        """Return the scale of impulse differences [N s].

        The impulse common to plan and replay, at least a typical force for a fiftieth of the plan;
        without a typical force the larger impulse.
        """
        try:
            force = self.typical_force
        except Unmeasured:
            lam = np.maximum(self.replay.lam[:, : self.scene.nc], 0.0)
            replayed = ((lam[:-1] + lam[1:]) / 2.0 * self.duration[:, None]).sum()
            return max(float((self.h @ np.abs(self.lam)).sum()), float(replayed))
        common = 0.0
        with suppress(Unmeasured):
            common = common_impulse(self.lam, self.force_window[1], self.h)
        return impulse_yardstick(common, force, self.trajectory.duration)

    @cached_property
    def rounding(self) -> dict[str, np.ndarray]:
        """Return the rounding of the plan's numbers [SI]. Raises nothing.

        "q", "v" (nodes, nq), "u" (steps, nu), "lam" (steps, nl).
        """
        plan, items = self.trajectory, self.scene.coordinates
        nominals = np.array([item.nominal for item in items])
        ranges = np.array([item.upper - item.lower for item in self.scene.inputs])
        try:
            force = self.typical_force
        except Unmeasured:
            force = 0.0
        return {
            "q": columns_rounding(plan.q, nominals),
            "v": columns_rounding(plan.v, nominals),
            "u": columns_rounding(plan.u, np.where(np.isfinite(ranges), ranges, 0.0)),
            "lam": columns_rounding(plan.lam, force),
        }

    @cached_property
    def printing_acceleration(self) -> float:
        """Return the change of accelerations by random rounding of the plan."""
        plan, size, random = self.trajectory, self.rounding, np.random.default_rng(0)
        if not any(part.any() for part in size.values()):
            return 0.0

        def acceleration(scale: float) -> np.ndarray:
            """Return accelerations (steps, nq) [m/s^2 or rad/s^2] with this share of rounding."""
            groups = {"q": plan.q[:-1], "v": plan.v[:-1], "u": plan.u, "lam": plan.lam}
            off = {
                group: scale * size[group][: plan.steps] * random.choice((-1.0, 1.0), values.shape)
                for group, values in groups.items()
            }
            q, v, u, lam = (values + off[group] for group, values in groups.items())
            damped, nc = self.equations.damped, self.scene.nc
            force = self.kernel.contact_force(q, v=v if damped else None)
            lam[:, :nc] = force + off["lam"][:, :nc]
            return self._of_steps(self.kernel.acceleration(q, v, u, lam))

        still = acceleration(0.0)
        return float(max(np.abs(acceleration(1.0) - still).max() for _ in range(3)))

    @cached_property
    def held_inputs(self) -> HeldInputs:
        """Return the plan's inputs as functions of time."""
        return HeldInputs(self.trajectory)

    @property
    def task_start(self) -> np.ndarray:
        """Return the task's start (2*nq,) [m or rad, m/s or rad/s], of an FMU its own state.

        Raises Unmeasured without a finished replay of an FMU.
        """
        if isinstance(self.scene, Scene):
            return np.array(self.scene.task.start, dtype=float)
        return np.append(self.replay.q[0], self.replay.v[0])

    @property
    def has_inertia(self) -> bool:
        """Return whether velocities are states: false for scenes with a relaxation time."""
        return not isinstance(self.scene, Scene) or self.scene.relaxation_index is None

    @property
    def friction(self) -> np.ndarray:
        """Return the plan's friction forces (steps, nf) [N], zero if missing. Raises nothing."""
        return self.trajectory.lam[:, self.scene.nc :]

    @cached_property
    def friction_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Return least and largest mu N, (steps, nf) [N], by the plan's own contact forces.

        At the start of each step, without a scheme at both ends. Raises Unmeasured.
        """
        kernel, (first, *_, last) = self.kernel, self.pressing
        begins = np.maximum(kernel.friction_limit(self.q[:-1], first), 0.0)
        if self.trajectory.scheme is not None:
            return begins, begins
        ends = np.maximum(kernel.friction_limit(self.q[1:], last), 0.0)
        return np.minimum(begins, ends), np.maximum(begins, ends)

    @cached_property
    def pressing(self) -> np.ndarray:
        """Return the pressing forces (parts, steps, nl) [N]: the plan's, or the law's.

        Raises Unmeasured.
        """
        parts = len(self.within_steps[0])
        forces = np.repeat(self.trajectory.lam[None], parts, axis=0)
        if "lam" in self.trajectory.missing:
            forces[:, :, : self.scene.nc] = self.law_within
        return forces

    @cached_property
    def friction_excess(self) -> np.ndarray:
        """Return the excess (steps, nf) [N] of friction over mu N. Raises Unmeasured."""
        kernel, nc, q, rounding = self.kernel, self.scene.nc, self.q[:-1], self.rounding["lam"]
        pairs = zip(self.within_steps[0], self.pressing, strict=True)
        limits = np.array([np.maximum(kernel.friction_limit(*pair), 0.0) for pair in pairs])
        moved = self.trajectory.lam.copy()
        moved[:, :nc] = self.pressing[0][:, :nc] + rounding[:, :nc]
        if nc:
            moved[:, :nc] += self.rounding_of_law
        rounded = kernel.friction_limit(q, moved) - kernel.friction_limit(q, self.pressing[0])
        allowed = rounding[:, nc:] + np.abs(rounded)
        known = {"start": limits[0]}
        if self.trajectory.scheme is None:
            known = by_convention(limits, None)
            if self.convention in known:
                known = {self.convention: known[self.convention]}
        over = [np.maximum(np.abs(self.friction) - f - allowed, 0.0) for f in known.values()]
        return min(over, key=lambda excess: float(self.h @ excess.sum(axis=1)))

    @property
    def typical_friction(self) -> np.ndarray:
        """Return mu N (nf,) [N] of a typical force at the task's start. Raises Unmeasured."""
        lam = np.full((1, self.scene.nl), self.typical_force if self.scene.nc else 0.0)
        return np.maximum(
            self.kernel.friction_limit(self.task_start[None, : self.scene.nq], lam)[0], 0.0
        )

    @cached_property
    def slip(self) -> np.ndarray:
        """Return the slip speeds (steps, nf) [m/s] of friction: end of step, geometry of its start.

        Without a scheme the least of that and those at both ends. Raises Unmeasured.
        """
        stepped = self.kernel.slip(self.trajectory.q[:-1], self.v[1:])
        if self.trajectory.scheme is not None:
            return stepped
        at_nodes = self.kernel.slip(self.q, self.v)
        return least_slip(np.stack([at_nodes[:-1], at_nodes[1:], stepped]))

    @property
    def v(self) -> np.ndarray:
        """Return the plan's velocities (nodes, nq) [m/s or rad/s]. Raises Unmeasured if missing."""
        return self._stated("v", "velocities", self.trajectory.v)

    def _of_steps(self, acceleration: np.ndarray) -> np.ndarray:
        """Return accelerations (steps, nq) of the plan's steps, at once without inertia."""
        scene = self.equations
        if scene.relaxation_index is None:
            return acceleration
        return acceleration * (scene.parameters[scene.relaxation_index].value / self.h)[:, None]

    @cached_property
    def acceleration(self) -> np.ndarray:
        """Return accelerations (steps, nq) [m/s^2 or rad/s^2] by the plan. Raises Unmeasured."""
        plan = self.trajectory
        return self._of_steps(self.kernel.acceleration(plan.q[:-1], self.v[:-1], plan.u, plan.lam))

    @property
    def collocation_defect(self) -> np.ndarray:
        """Return the largest residuals of a collocation (2*nq,) [m or rad, per s].

        Infinite if a step has no solution. Raises Unmeasured without equations.
        """
        return collocation.defect(self.kernel, self.trajectory)

    @property
    def true_motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Return q, v (nodes, nq) [m or rad, per s] of the plan's scheme with true contact.

        Raises Unmeasured, LeavesBounds.
        """
        return self.own_motion(1)

    def own_motion(self, parts: int) -> tuple[np.ndarray, np.ndarray]:
        """Return `true_motion`, q, v (nodes, nq) [m or rad, per s], with each step in equal parts.

        Raises Unmeasured, LeavesBounds.
        """
        if parts in self._own_motions:
            return self._own_motions[parts]
        plan, u = self.trajectory, np.repeat(self.trajectory.u, parts, axis=0)
        steps = np.repeat(self.h / parts, parts)
        if plan.scheme not in (None, Scheme.SEMI_IMPLICIT_EULER):
            q, v, reached = collocation.rollout(self.kernel, plan.scheme, plan.start, u, steps)
        else:  # one rollout for all steps of equal length in a row
            q, v = (np.full((len(steps) + 1, self.scene.nq), np.nan) for _ in range(2))
            (q[0], v[0]), reached = (plan.q[0], plan.v[0]), 0
            starts = np.flatnonzero(np.diff(steps, prepend=np.nan) != 0.0)
            for first, last in zip(starts, [*starts[1:], len(steps)], strict=True):
                start = np.concatenate([q[first], v[first]])
                rollout = self.kernel.rollout(start, u[first:last], float(steps[first]))
                q[first : last + 1], v[first : last + 1] = rollout.q, rollout.v
                reached = first + rollout.finite_steps
                if rollout.diverged:
                    break
        if reached < len(steps):
            raise LeavesBounds(
                f"with the true contact law the plan's own time step diverges at step {reached // parts} of {plan.steps}."
            )
        # Copies: a view would keep all parts.
        return self._own_motions.setdefault(parts, (q[::parts].copy(), v[::parts].copy()))

    @cached_property
    def grid_errors(self) -> list[float]:
        """Return the discretisation errors [m or rad] of the plan's grid and its halvings.

        The inputs are held. The list ends at a quarter of the limit on replay_error, after two idle
        halvings, or seven. Raises Unmeasured.
        """
        near, errors, idle = float(replay_limits(self.scene).min()) / 4.0, [], 0
        before = None
        for halvings in range(_HALVINGS + 1):
            q = self.own_motion(2**halvings)[0]
            errors.append(float(np.abs(q - self.replay_q).max()))
            if before is not None:
                is_idle = np.abs(q - before).max() < _IDLE * (errors[-1] - near)
                idle = idle + 1 if is_idle else 0
            if errors[-1] <= near or idle == 2:
                break
            before = q
        return errors

    @property
    def opened(self) -> Replay:
        """Return the open replay, even if it failed."""
        if self.replayed is None:
            raise Unmeasured("the plan was not replayed.")
        return self.replayed

    @cached_property
    def tracked(self) -> Evidence:
        """Return the plan with its tracked replay."""
        return Evidence(self.scene, self.trajectory, self.opened.tracked)

    @property
    def replay(self) -> Replay:
        """Return the replay; raise Unmeasured if it failed."""
        replay = self.opened
        if replay.outcome is ReplayOutcome.DIVERGED:
            raise LeavesBounds(
                f"driven by the plan's inputs the motion leaves every bound after {replay.t[-1]:.3g} s."
            )
        if not replay.ok:
            raise Unmeasured(
                f"the replay did not get to the end: {replay.outcome.value} {replay.message}".rstrip()
            )
        return replay

    @property
    def touches_nothing(self) -> bool:
        """Return whether the finished replay has gaps, and none closes."""
        if self.replayed is None or not self.replayed.ok or not self.replayed.gap.size:
            return False
        return bool((self.replayed.gap > 0.0).all())

    @property
    def error(self) -> Difference:
        """Return the replay's error estimate, infinite if there is none."""
        estimate = self.replay.error.estimate
        return (
            Difference(position=np.inf, state=np.inf, gap=np.inf) if estimate is None else estimate
        )

    @property
    def replay_q(self) -> np.ndarray:
        """Return the replay's positions at nodes (nodes, nq) [m or rad]. Raises Unmeasured."""
        self.need("q")
        return self.replay.q[self.replay.knots]

    @property
    def replay_v(self) -> np.ndarray:
        """Return the replay's velocities (n, nq) [m/s or rad/s]. Raises Unmeasured."""
        self.need("v")
        return self.replay.v

    @property
    def replay_gap(self) -> np.ndarray:
        """Return the replay's gaps (n, nc) [m], negative in contact. Raises Unmeasured."""
        self.need("gap")
        return self.replay.gap

    @cached_property
    def force_window(self) -> tuple[np.ndarray, np.ndarray]:
        """Return least and largest contact forces of the replay near each step, (steps, nc) [N].

        Means are included, because a bounce between rows shows in none. Raises Unmeasured.
        """
        self.need("lam")
        lam, steps = self.replay.lam, self.trajectory.steps
        return force_window(lam, self.step_of, steps, self._replayed_means)

    @cached_property
    def step_of(self) -> np.ndarray:
        """Return the plan's step (n-1,) [-] of each piece of the replay. Raises Unmeasured."""
        pieces = np.arange(len(self.replay.t) - 1)
        return np.searchsorted(self.replay.knots, pieces, side="right") - 1

    @cached_property
    def duration(self) -> np.ndarray:
        """Return the durations (n-1,) [s] of the replay's pieces. Raises Unmeasured."""
        return np.diff(self.replay.t)
