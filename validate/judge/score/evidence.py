"""What the metrics are computed from: the plan, its replay, and the plan's inputs under the true contact law on the plan's own grid.

Where the compiled functions refuse a state, their KernelError goes on to the score, which takes it
for an Unmeasured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np
import sympy as sp
from numpy.polynomial.legendre import leggauss

from models import collocation
from models.codegen.kernel import Kernel, load_kernel
from models.dynamics import derive
from models.scene import Scene
from models.scene.contacts import DampingLaw
from models.scene.default_limits import impulse_yardstick
from models.scene.goal import goal_state
from models.scene.typical_force import typical_force
from models.schemes import Scheme
from models.trajectory import Trajectory
from validate.judge.printed import columns_rounding
from validate.judge.replay.result import Difference, Replay, ReplayOutcome
from validate.judge.replay.subject import Subject
from validate.judge.replay.wiring import HeldInputs
from validate.judge.score.forces import (
    by_convention,
    force_window,
    least_slip,
    within_steps,
)
from validate.judge.score.verdict import LeavesBounds, Unmeasured

# Gauss-Legendre points and weights on (0, 1): exact for squares of cubics and of lines.
_POINTS, _WEIGHTS = (
    part / 2.0 + shift for part, shift in zip(leggauss(4), (0.5, 0.0), strict=True)
)


class Evidence:
    """Arrays by the symbols of the equations; each computed once."""

    def __init__(self, scene: Subject, trajectory: Trajectory, replay: Replay | None) -> None:
        self.scene, self.trajectory, self._replay = scene, trajectory, replay
        # By parts: a metric and the sentence ask for the same ones, 7 s each by collocation.
        self._own_motions: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    @property
    def equations(self) -> Scene:
        """The scene, where there is one."""
        if not isinstance(self.scene, Scene):
            raise Unmeasured(
                "it needs the equations, which only a scene has; an FMU keeps its own to itself."
            )
        return self.scene

    @cached_property
    def kernel(self) -> Kernel:
        """The scene's compiled functions. Raises Unmeasured for somebody's FMU."""
        return load_kernel(self.equations)

    @property
    def lacking(self) -> Mapping[str, str]:
        """What an external FMU does not offer of q, v, lam, gap, and why; empty for a scene."""
        return {} if isinstance(self.scene, Scene) else self.scene.lacks

    def need(self, *parts: str) -> None:
        """Raise Unmeasured if an external FMU does not offer one of these: q, v, lam, gap."""
        for part in parts:
            if part in self.lacking:
                raise Unmeasured(f"{self.lacking[part]}.")

    @property
    def q(self) -> np.ndarray:
        """Positions of the plan, (nodes, nq) [m or rad].

        Raises Unmeasured if it does not say them.
        """
        self.need("q")
        self._must_say("q", "positions", [item.name for item in self.scene.coordinates])
        return self.trajectory.q

    def _must_say(self, group: str, words: str, columns: Sequence[str]) -> None:
        """Raise Unmeasured if the plan does not say these columns."""
        if group in self.trajectory.missing:
            raise Unmeasured(f"the plan does not say its {words} ({', '.join(columns)}).")

    @cached_property
    def goal(self) -> np.ndarray:
        """The goal, (2*nq,) positions [m or rad], then velocities [m/s or rad/s].

        NaN where the end is free.
        """
        return goal_state(self.scene.task)  # type: ignore[arg-type] - a foreign task has a goal of the same form

    @cached_property
    def h(self) -> np.ndarray:
        """Steps of the plan, (steps,) [s].

        The nominal step where all steps equal it, so that t = n*h has left no rounding in it.
        """
        h = np.diff(self.trajectory.t)
        step = self.scene.task.step
        return np.full_like(h, step) if np.allclose(h, step, rtol=1e-9, atol=0.0) else h

    def cost_of(self, t: np.ndarray, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> float:
        """The task's cost of a motion: the integral of its running cost for each step of the task, and the final cost.

        Between the rows positions are cubics, without inertia chords.

        Parameters
        ----------
        t : (n,) times of the rows [s].
        q, v : (n, nq) positions [m or rad], velocities [m/s or rad/s].
        u : (steps, nu) inputs at the starts of the plan's steps [N or N m].

        Raises
        ------
        Unmeasured : for an external FMU.
        """
        h, nodes, held = np.diff(t)[:, None], self.trajectory.t, self.held_inputs
        step = np.clip(np.searchsorted(nodes, t[:-1], side="right") - 1, 0, len(u) - 1)
        first = u[step] + held.slopes[step] * (t[:-1] - nodes[step])[:, None]
        moved, begins, ends = np.diff(q, axis=0), h * v[:-1], h * v[1:]
        if self.equations.relaxation_index is not None:
            begins = ends = moved
        cost = self._final_cost(q[-1], v[-1])
        for s, weight in zip(_POINTS, _WEIGHTS, strict=True):
            place = q[:-1] + s * begins
            place += s**2 * (3.0 * moved - 2.0 * begins - ends)
            place += s**3 * (begins + ends - 2.0 * moved)
            speed = begins + 2.0 * s * (3.0 * moved - 2.0 * begins - ends)
            speed += 3.0 * s**2 * (begins + ends - 2.0 * moved)
            speed = np.divide(speed, h, out=v[:-1].copy(), where=h > 0.0)
            rate = self._running_cost(place, speed, first + s * h * held.slopes[step])
            cost += weight * float(h[:, 0] @ rate) / self.scene.task.step
        return cost

    @property
    def cost_of_rows(self) -> float:
        """The task's cost as the plan's own method counts it: by the states at the starts of the steps, inputs that are lines at their middle.

        Raises Unmeasured without positions, velocities or equations.
        """
        q, v, h = self.q, self.v, self.h
        u = self.trajectory.u + self.held_inputs.slopes * h[:, None] / 2.0
        rate = self._running_cost(q[:-1], v[:-1], u)
        return float(h / self.scene.task.step @ rate) + self._final_cost(q[-1], v[-1])

    def _running_cost(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(n,) of states (n, nq) and inputs (n, nu), for a step of the task."""
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
        """What the true force is the positive part of at the start of each step, (steps, nc) [N]: k phi, and with damping more or less.

        Raises Unmeasured for somebody's FMU, or where a damped contact needs velocities that the
        plan does not say.
        """
        q = self.trajectory.q[:-1]
        return (
            self.kernel.contact_push(q, self.v[:-1])
            if self.equations.damped
            else self.k * self.kernel.penetration(q)
        )

    @cached_property
    def k(self) -> np.ndarray:
        """Stiffness of the contacts, (nc,) [N/m]. Raises Unmeasured for somebody's FMU."""
        return self.kernel.stiffness()

    @cached_property
    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """Largest derivatives of the replay's contact forces, (nc,) each: by penetration [N/m] and by its rate [N s/m].

        Raises Unmeasured for somebody's FMU, or without a whole replay.
        """
        scene, k = self.equations, self.k
        if not scene.damped:
            return k, np.zeros_like(k)
        d, depth = derive(scene), np.maximum(-self.replay_gap, 0.0)
        c = d.function(d.damping)().ravel()
        is_linear = np.array(
            [contact.damping_law is DampingLaw.KELVIN_VOIGT for contact in scene.contacts]
        )
        share = np.divide(
            self.replay.lam, k * depth, out=np.zeros_like(depth), where=depth > 0.0
        ).max(axis=0)  # Hunt-Crossley: 1 + d phi'
        return np.where(is_linear, k, k * np.maximum(share, 1.0)), np.where(
            is_linear, c, c * k * depth.max(axis=0)
        )

    @cached_property
    def length(self) -> np.ndarray:
        """L, the scene's nominal penetration of each contact, (nc,) [m].

        Raises Unmeasured for somebody's FMU.
        """
        return np.array([contact.nominal for contact in self.equations.contacts])

    @property
    def lam(self) -> np.ndarray:
        """Contact forces of the plan, (steps, nc) [N]; zeros where it does not say them.

        Raises nothing.
        """
        return self.trajectory.lam[:, : self.scene.nc]

    @property
    def planned_impulse(self) -> float:
        """Sum over steps and contacts of h |lam| [N s]."""
        return float((self.h[:, None] * np.abs(self.lam)).sum())

    @cached_property
    def law(self) -> np.ndarray:
        """Contact forces of the true law at the plan's nodes, (nodes, nc) [N].

        Raises Unmeasured without positions or equations.
        """
        return self.kernel.contact_force(
            self.q, v=self.trajectory.v if self.equations.damped else None
        )

    @cached_property
    def typical_force(self) -> float:
        """Yardstick of contact forces [N] (`models.scene.typical_force`); of an FMU the map's.

        Raises Unmeasured if the map states none.
        """
        if isinstance(self.scene, Scene):
            return typical_force(self.scene, self.kernel)
        stated = [item.nominal_force for item in self.scene.contacts]
        known = [force for force in stated if force is not None]
        if not known:
            raise Unmeasured("the map states no nominal_force of a contact.")
        return max(known)

    @cached_property
    def within_steps(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Positions and velocities of the plan at parts of its steps, (steps, nq) each.

        Raises Unmeasured without positions.
        """
        return within_steps(self.q, self.trajectory.v, np.diff(self.trajectory.t))

    @cached_property
    def law_within(self) -> np.ndarray:
        """Contact forces of the true law at parts of the plan's steps, (parts, steps, nc) [N].

        Raises Unmeasured without positions or equations.
        """
        damped = self.equations.damped
        return np.array(
            [
                self.kernel.contact_force(q, v=v if damped else None)
                for q, v in zip(*self.within_steps, strict=True)
            ]
        )

    @cached_property
    def laws(self) -> dict[str, np.ndarray]:
        """Contact forces (steps, nc) [N] of the true law by each convention.

        Raises Unmeasured without positions or equations.
        """
        return by_convention(self.law_within, self._replayed_means)

    @property
    def _replayed_means(self) -> np.ndarray | None:
        """Mean contact forces of the replay over the plan's steps, (steps, nc) [N]; None if unknown."""
        if self._replay is None or not self._replay.ok or self._replay.contact_impulse is None:
            return None
        impulses = np.diff(self._replay.contact_impulse[self._replay.knots], axis=0)
        return impulses / np.diff(self.trajectory.t)[:, None]

    @cached_property
    def convention(self) -> str:
        """Convention by which the plan's contact forces are nearest to the law; empty if they are not stated."""
        if "lam" in self.trajectory.missing or not self.scene.nc:
            return ""
        off = {name: self.h @ np.abs(self.lam - law) for name, law in self.laws.items()}
        return min(off, key=lambda name: float(off[name].sum()))

    @cached_property
    def rounding_of_law(self) -> np.ndarray:
        """Change of the contact forces by the rounding of the plan's positions, (steps, nc) [N].

        Raises Unmeasured without positions or equations.
        """
        d, rounding = derive(self.equations), self.rounding["q"]
        if not rounding.any():
            return np.zeros_like(self.lam)
        jacobian = d.function(d.gap_jacobian, d.q)
        moved = np.array(
            [
                np.abs(jacobian(q).reshape(self.scene.nc, -1)) @ r
                for q, r in zip(self.q, rounding, strict=True)
            ]
        )
        return self.k * np.maximum(moved[:-1], moved[1:])

    @cached_property
    def impulse_yardstick(self) -> float:
        """Contact impulse by which differences are measured [N s].

        The impulse that plan and replay have in common, at least a typical force for a fiftieth of
        the plan. Of an FMU whose map states no typical force the larger of the two impulses.
        """
        try:
            force = self.typical_force
        except Unmeasured:
            lam = np.maximum(self.replay.lam[:, : self.scene.nc], 0.0)
            replayed = ((lam[:-1] + lam[1:]) / 2.0 * self.duration[:, None]).sum()
            return max(self.planned_impulse, float(replayed))
        try:
            common = float(self.h @ np.minimum(np.abs(self.lam), self.force_window[1]).sum(axis=1))
        except Unmeasured:
            common = 0.0
        return impulse_yardstick(common, force, self.trajectory.duration)

    @cached_property
    def rounding(self) -> dict[str, np.ndarray]:
        """By how much each number of the plan may be rounded (`validate.judge.printed`).

        "q", "v" (nodes, nq), "u" (steps, nu), "lam" (steps, nl), each in its unit [SI]. Raises
        nothing.
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
        """By how much printing may change an acceleration of the plan [m/s^2, rad/s^2]: tried by rounding states, inputs and true forces anew."""
        plan, size = self.trajectory, self.rounding
        if not any(part.any() for part in size.values()):
            return 0.0
        random = np.random.default_rng(0)

        def acceleration(scale: float) -> np.ndarray:
            """(steps, nq) [m/s^2 or rad/s^2] with all numbers moved by `scale` of their printing.

            Raises KernelError.
            """

            def moved(group: str, values: np.ndarray) -> np.ndarray:
                """All values (steps, n) [unit of the group], each moved up or down.

                Raises KeyError for no group.
                """
                signs = random.choice((-1.0, 1.0), size=values.shape)
                return values + scale * size[group][: len(values)] * signs

            q, v, u = moved("q", plan.q[:-1]), moved("v", plan.v[:-1]), moved("u", plan.u)
            lam = plan.lam.copy()
            lam[:, : self.scene.nc] = self.kernel.contact_force(
                q, v=v if self.equations.damped else None
            )
            return self._of_steps(self.kernel.acceleration(q, v, u, moved("lam", lam)))

        still = acceleration(0.0)
        return float(max(np.abs(acceleration(1.0) - still).max() for _ in range(3)))

    @cached_property
    def held_inputs(self) -> HeldInputs:
        """The plan's inputs as functions of time."""
        return HeldInputs(self.trajectory)

    @property
    def task_start(self) -> np.ndarray:
        """Where the task starts, (2*nq,) [m or rad], then [m/s or rad/s]: of an FMU its own state at the start.

        Raises Unmeasured without a whole replay of an FMU.
        """
        if isinstance(self.scene, Scene):
            return np.array(self.scene.task.start, dtype=float)
        return np.concatenate([self.replay.q[0], self.replay.v[0]])

    @property
    def has_inertia(self) -> bool:
        """Whether velocities are states: of every external FMU, and of scenes without a relaxation time."""
        return not isinstance(self.scene, Scene) or self.scene.relaxation_index is None

    @property
    def friction(self) -> np.ndarray:
        """Friction forces of the plan, (steps, nf) [N]; zeros where it does not say them.

        Raises nothing.
        """
        return self.trajectory.lam[:, self.scene.nc :]

    @cached_property
    def friction_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest mu N, (steps, nf) each [N], with the plan's own contact forces where they press; what pulls does not press.

        At the start of the step; of a plan that declares no scheme at both its ends. Raises
        Unmeasured without positions or equations.
        """
        kernel, (first, *_, last) = self.kernel, self.pressing
        begins = np.maximum(kernel.friction_limit(self.q[:-1], first), 0.0)
        if self.trajectory.scheme is not None:
            return begins, begins
        ends = np.maximum(kernel.friction_limit(self.q[1:], last), 0.0)
        return np.minimum(begins, ends), np.maximum(begins, ends)

    @cached_property
    def pressing(self) -> np.ndarray:
        """Contact forces that press on frictions at parts of the plan's steps, (parts, steps, nl) [N].

        They are the plan's, or the law's if it states none. Raises Unmeasured as `law_within`.
        """
        parts = len(self.within_steps[0])
        forces = np.repeat(self.trajectory.lam[None], parts, axis=0)
        if "lam" in self.trajectory.missing:
            forces[:, :, : self.scene.nc] = self.law_within
        return forces

    @cached_property
    def friction_excess(self) -> np.ndarray:
        """By how much each friction force exceeds mu N of its own convention and all rounding, (steps, nf) [N].

        Raises Unmeasured without positions or equations.
        """
        limits = np.array(
            [
                np.maximum(self.kernel.friction_limit(q, lam), 0.0)
                for q, lam in zip(self.within_steps[0], self.pressing, strict=True)
            ]
        )
        more = self.rounding["lam"][:, : self.scene.nc] + (
            self.rounding_of_law if self.scene.nc else 0.0
        )
        moved = self.trajectory.lam.copy()
        moved[:, : self.scene.nc] = self.pressing[0][:, : self.scene.nc] + more
        rounded = self.kernel.friction_limit(self.q[:-1], moved) - self.kernel.friction_limit(
            self.q[:-1], self.pressing[0]
        )
        allowed = self.rounding["lam"][:, self.scene.nc :] + np.abs(rounded)
        if self.trajectory.scheme is not None:
            known = [limits[0]]
        else:
            found = by_convention(limits, None)
            known = [found[self.convention]] if self.convention in found else [*found.values()]
        over = [np.maximum(np.abs(self.friction) - limit - allowed, 0.0) for limit in known]
        return min(over, key=lambda excess: float(self.h @ excess.sum(axis=1)))

    @property
    def typical_friction(self) -> np.ndarray:
        """Mu N of a typical force at the task's start, (nf,) [N].

        Raises Unmeasured if the map states no nominal_force.
        """
        lam = np.full((1, self.scene.nl), self.typical_force if self.scene.nc else 0.0)
        return np.maximum(
            self.kernel.friction_limit(self.task_start[None, : self.scene.nq], lam)[0], 0.0
        )

    @cached_property
    def slip(self) -> np.ndarray:
        """Slip speeds to which a step's friction force belongs, (steps, nf) [m/s]: at its end, with the geometry of its start.

        Of a plan that declares no scheme the least of that and those at both ends. Raises
        Unmeasured without velocities or equations.
        """
        stepped = self.kernel.slip(self.trajectory.q[:-1], self.v[1:])
        if self.trajectory.scheme is not None:
            return stepped
        at_nodes = self.kernel.slip(self.q, self.v)
        return least_slip(np.stack([at_nodes[:-1], at_nodes[1:], stepped]))

    @property
    def v(self) -> np.ndarray:
        """Velocities of the plan, (nodes, nq) [m/s or rad/s].

        Raises Unmeasured if it does not say them.
        """
        self._must_say("v", "velocities", [item.velocity_name for item in self.scene.coordinates])
        return self.trajectory.v

    def _of_steps(self, acceleration: np.ndarray) -> np.ndarray:
        """(steps, nq) of the plan's own steps, from those of the task's: without inertia a step takes up all of a force, however short it is."""
        scene = self.equations
        if scene.relaxation_index is None:
            return acceleration
        return acceleration * (scene.parameters[scene.relaxation_index].value / self.h)[:, None]

    @cached_property
    def acceleration(self) -> np.ndarray:
        """Acceleration by the plan's states, inputs and own forces, (steps, nq) [m/s^2 or rad/s^2].

        Raises Unmeasured without velocities or equations.
        """
        plan = self.trajectory
        return self._of_steps(self.kernel.acceleration(plan.q[:-1], self.v[:-1], plan.u, plan.lam))

    @property
    def collocation_defect(self) -> np.ndarray:
        """Largest misses of a collocation plan in its own step, (2*nq,) [m or rad], then [m/s or rad/s]; infinite where a step has no solution.

        Raises Unmeasured without equations.
        """
        return collocation.defect(self.kernel, self.trajectory)

    @property
    def true_motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m or rad] and velocities [m/s or rad/s], (nodes, nq) each, of the plan's inputs through its own time step with the true contact law.

        Raises Unmeasured without positions or equations, LeavesBounds where that diverges.
        """
        return self.own_motion(1)

    def own_motion(self, parts: int) -> tuple[np.ndarray, np.ndarray]:
        """`true_motion` with each step of the plan in so many parts: q, v (nodes, nq) [m or rad], [m/s or rad/s]. Raises Unmeasured, LeavesBounds."""
        if parts in self._own_motions:
            return self._own_motions[parts]
        plan, u, steps = (
            self.trajectory,
            np.repeat(self.trajectory.u, parts, axis=0),
            np.repeat(self.h / parts, parts),
        )
        if plan.scheme not in (None, Scheme.SEMI_IMPLICIT_EULER):
            q, v, reached = collocation.rollout(self.kernel, plan.scheme, plan.start, u, steps)
        elif (steps == steps[0]).all():
            rollout = self.kernel.rollout(plan.start, u, float(steps[0]))
            q, v, reached = rollout.q, rollout.v, rollout.finite_steps
        else:
            q, v = (
                np.full((len(steps) + 1, self.scene.nq), np.nan),
                np.full((len(steps) + 1, self.scene.nq), np.nan),
            )
            q[0], v[0], reached = plan.q[0], plan.v[0], 0
            for step, h in enumerate(steps):
                rollout = self.kernel.rollout(
                    np.concatenate([q[step], v[step]]), u[step : step + 1], float(h)
                )
                if rollout.diverged:
                    break
                q[step + 1], v[step + 1], reached = rollout.q[1], rollout.v[1], step + 1
        if reached < len(steps):
            raise LeavesBounds(
                f"with the true contact law the plan's own time step diverges at step {reached // parts} of {plan.steps}."
            )
        return self._own_motions.setdefault(
            parts, (q[::parts].copy(), v[::parts].copy())
        )  # a view would keep all parts

    @property
    def true_end(self) -> np.ndarray:
        """Where `true_motion` ends, (2*nq,) [m or rad], then [m/s or rad/s]. Raises Unmeasured."""
        q, v = self.true_motion
        return np.concatenate([q[-1], v[-1]])

    @property
    def opened(self) -> Replay:
        """The replay in the open loop, however it ended."""
        if self._replay is None:
            raise Unmeasured("the plan was not replayed.")
        return self._replay

    @cached_property
    def tracked(self) -> Evidence:
        """The same plan beside its tracked replay."""
        return Evidence(self.scene, self.trajectory, self.opened.tracked)

    @property
    def replay(self) -> Replay:
        """The replay, if it got to the end."""
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
        """Whether the replay got to the end, shows its gaps, and none of them closes."""
        replay = self._replay
        return (
            replay is not None
            and replay.ok
            and replay.gap.size > 0
            and bool((replay.gap > 0.0).all())
        )

    @property
    def error(self) -> Difference:
        """The replay's own error estimate; infinite where it has none."""
        estimate = self.replay.error.estimate
        return (
            Difference(position=np.inf, state=np.inf, gap=np.inf) if estimate is None else estimate
        )

    @property
    def replay_q(self) -> np.ndarray:
        """Positions of the replay at the plan's nodes, (nodes, nq) [m or rad].

        Raises Unmeasured without a whole replay.
        """
        self.need("q")
        return self.replay.q[self.replay.knots]

    @property
    def end(self) -> np.ndarray:
        """Where the plan ends, (2*nq,) [m or rad], then [m/s or rad/s].

        The velocities only if a velocity of the goal is given. Raises Unmeasured.
        """
        wants_v = np.isfinite(self.goal[self.scene.nq :]).any()
        return np.concatenate([self.q[-1], self.v[-1] if wants_v else np.zeros(self.scene.nq)])

    @property
    def replay_v(self) -> np.ndarray:
        """Velocities of the replay at all its rows, (n, nq) [m/s or rad/s].

        Raises Unmeasured without a whole replay.
        """
        self.need("v")
        return self.replay.v

    @property
    def replay_end(self) -> np.ndarray:
        """Where the replay ends, (2*nq,) [m or rad], then [m/s or rad/s].

        Raises Unmeasured if what the goal asks is not known.
        """
        self.need("q")
        if np.isfinite(self.goal[self.scene.nq :]).any():
            self.need("v")
        return self.replay.end

    @property
    def replay_gap(self) -> np.ndarray:
        """Gaps of the replay, (n, nc) [m], negative in contact.

        Raises Unmeasured without a whole replay.
        """
        self.need("gap")
        return self.replay.gap

    @cached_property
    def force_window(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest of the replay's contact forces within a step of each of the plan's, (steps, nc) each [N].

        Their means over steps are among them: of a bounce between two rows no row tells. Raises
        Unmeasured without a whole replay.
        """
        self.need("lam")
        impulse, knots = self.replay.contact_impulse, self.replay.knots
        mean = (
            None
            if impulse is None
            else np.diff(impulse[knots], axis=0) / np.diff(self.trajectory.t)[:, None]
        )
        return force_window(self.replay.lam, self.step_of, self.trajectory.steps, mean)

    @cached_property
    def step_of(self) -> np.ndarray:
        """The plan's step in which each piece of the replay's grid lies, (n-1,) [-].

        Raises Unmeasured without a whole replay.
        """
        pieces = np.arange(len(self.replay.t) - 1)
        return np.searchsorted(self.replay.knots, pieces, side="right") - 1

    @cached_property
    def duration(self) -> np.ndarray:
        """Duration of each piece of the replay's grid, (n-1,) [s].

        Raises Unmeasured without a whole replay.
        """
        return np.diff(self.replay.t)
