"""What the metrics are computed from: the plan, its replay, and the plan's inputs under the true contact law on the plan's own grid.

Where the compiled functions refuse a state, their KernelError goes on to the score, which takes it
for an Unmeasured.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from models import collocation
from models.codegen.kernel import Kernel, load_kernel
from models.dynamics import derive
from models.scene import Scene
from models.scene.contacts import DampingLaw
from models.scene.goal import goal_state
from models.schemes import Scheme
from models.trajectory import Trajectory
from validate.judge.replay.result import Difference, Replay, ReplayOutcome
from validate.judge.replay.subject import Subject
from validate.judge.replay.wiring import HeldInputs
from validate.judge.score.equations import half_unit
from validate.judge.score.own_steps import Departures, OwnSteps, Stepper, force_window, least_slip
from validate.judge.score.verdict import LeavesBounds, Unmeasured

# What counts as a contact force at least, of the inputs' range: a plan that only grazes is not held
# to a millionth of a newton.
_OF_RANGE = 0.1
# Small steps of a step of the task at first, how often they are halved, and what that changes of a
# cost where they are enough.
_PARTS = 50
_DOUBLINGS = 8
_SETTLED = 1e-4


class Evidence:
    """Arrays by the symbols of the equations; each computed once."""

    def __init__(self, scene: Subject, trajectory: Trajectory, replay: Replay | None) -> None:
        self.scene, self.trajectory, self._replay = scene, trajectory, replay
        self._own_steps: dict[
            bytes, OwnSteps
        ] = {}  # by velocities: three metrics ask for the same ones
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

    def need(self, *parts: str) -> None:
        """Raise Unmeasured if the plan does not say, or somebody's FMU does not offer, one of these: q, v, lam, gap."""
        lacks = {} if isinstance(self.scene, Scene) else self.scene.lacks
        for part in parts:
            if part in lacks:
                raise Unmeasured(f"{lacks[part]}.")

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
        """The task's cost of a motion: its running cost at the starts of the task's own steps, whatever grid the plan has, and the final cost.

        Where inputs change within a step of the task, each counts for its part of the step. Between
        the rows positions are cubics.

        Parameters
        ----------
        t : (n,) times of the rows [s].
        q, v : (n, nq) positions [m or rad], velocities [m/s or rad/s].
        u : (steps, nu) inputs of the plan [N or N m].

        Raises
        ------
        Unmeasured : for somebody's FMU.
        """
        step = self.scene.task.step
        if len(t) == len(u) + 1 and (self.h == step).all():
            return self.kernel.cost(q, v, u)
        count = max(1, round(self.trajectory.duration / step))
        held, nodes, starts = self.held_inputs, self.trajectory.t, t[0] + step * np.arange(count)
        within = nodes[1:-1][
            np.abs((nodes[1:-1] - t[0]) / step - np.round((nodes[1:-1] - t[0]) / step)) > 1e-9
        ]
        times = np.sort(np.concatenate([starts, within[within < starts[-1] + step]]))
        rows, steps = (
            np.searchsorted(of, times + 1e-9 * step, side="right") - 1 for of in (starts, nodes)
        )
        steps = np.clip(steps, 0, len(u) - 1)
        inputs = u[steps] + held.slopes[steps] * np.maximum(times - nodes[steps], 0.0)[:, None]
        moved_q, moved_v = _at_times(starts, *_without_repeats(t, q, v))

        def cost(state: int, inputs: np.ndarray) -> float:
            return self.kernel.cost(
                np.vstack([moved_q[state : state + len(inputs)], q[-1:]]),
                np.vstack([moved_v[state : state + len(inputs)], v[-1:]]),
                inputs,
            )

        parts = np.diff(np.append(times, starts[-1] + step)) / step
        if len(times) == count:
            return cost(0, inputs)
        final = cost(0, inputs[:0])
        return final + sum(
            part * (cost(row, one[None]) - final)
            for row, one, part in zip(rows, inputs, parts, strict=True)
        )

    @property
    def cost_between_rows(self) -> float:
        """By how much a cost of the plan may be that of the cubics between its rows: of the true motion from each row on it is another; 0 on the task's grid.

        Infinite where that is not known. Raises Unmeasured without positions, velocities or
        equations.
        """
        if (self.h == self.scene.task.step).all():
            return 0.0
        found, change, parts = np.nan, np.nan, _PARTS
        while parts <= _PARTS * 2**_DOUBLINGS and not change <= _SETTLED * abs(found):
            before, found = found, self.cost_of(*self._own_rows(parts), self.trajectory.u)
            change, parts = abs(found - before), 2 * parts
        cubics = self.cost_of(self.trajectory.t, self.q, self.v, self.trajectory.u)
        return float(np.nan_to_num(abs(found - cubics) + 2.0 * change, nan=np.inf))

    def _own_rows(self, parts: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of the plan, and between them the true motion from each on, in so many parts a step of the task: t (n,) [s], q, v (n, nq)."""
        plan, held, step, rows = self.trajectory, self.held_inputs, self.scene.task.step, []
        for row, length in enumerate(self.h):
            count = parts * max(1, round(length / step))
            late = length / count * np.arange(count)
            u = held.values[row] + held.slopes[row] * (late + length / count / 2.0)[:, None]
            run = self.kernel.rollout(
                np.concatenate([self.q[row], self.v[row]]), u, float(length) / count
            )
            rows.append((plan.t[row] + late, run.q[:-1], run.v[:-1]))
        t, q, v = (
            np.concatenate(part)
            for part in zip(*rows, (plan.t[-1:], self.q[-1:], self.v[-1:]), strict=True)
        )
        return t, q, v

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
            self.q, v=self.own_velocities if self.equations.damped else None
        )

    @cached_property
    def stepper(self) -> Stepper:
        """The true motion over the plan's steps. Raises Unmeasured for somebody's FMU."""
        return Stepper(self.kernel, self.held_inputs)

    @cached_property
    def departures(self) -> Departures:
        """The velocities that lead from each of the plan's positions to the next."""
        return self.stepper.departures(
            self.q, self.start_velocity, np.array([item.nominal for item in self.scene.coordinates])
        )

    @cached_property
    def own_velocities(self) -> np.ndarray:
        """Velocities of the plan, (nodes, nq) [m/s or rad/s].

        Where it says none, those that its positions take. Raises Unmeasured without positions.
        """
        if "v" not in self.trajectory.missing:
            return self.trajectory.v
        return np.vstack([self.departures.v, self.departures.last])

    def own_steps(self, v: np.ndarray) -> OwnSteps:
        """The true motion over each step from the plan's positions and given velocities.

        Parameters
        ----------
        v : (steps, nq) velocities at the starts of the steps [m/s or rad/s].

        Raises
        ------
        Unmeasured : where it cannot be found.
        """
        own = self._own_steps.get(v.tobytes())
        if own is None:
            mass, start, end = self.masses[1:], self.q[:-1], self.q[1:]
            typical = np.concatenate(
                [
                    sizes(mass, np.diff(v, axis=0, append=v[-1:])),
                    sizes(mass, (end - start) / self.h[:, None] - v),
                ]
            )
            nominal = float(
                sizes(mass, np.array([item.nominal for item in self.scene.coordinates])).max()
            )
            scale = max(float(typical.max()), 1e-6 * nominal)
            own = self._own_steps[v.tobytes()] = self.stepper.run(
                np.hstack([start, v]),
                lambda dv: sizes(mass, dv),
                scale,
                lambda: self.reference_force,
            )
        return own

    @cached_property
    def reference_force(self) -> float:
        """The force that unexplained ones are measured by, in the norm of M^-1 [kg^0.5 m/s^2].

        The largest contact force of the replay, or a tenth of the inputs' range where that is more;
        without contact their range, and without inputs the largest force of the motion, or what
        moves it by its nominal within the plan. Raises Unmeasured without positions or equations.
        """
        scene, kernel = self.equations, self.kernel
        q = self.opened_q
        v, u, none = np.zeros_like(q), np.zeros((len(q), scene.nu)), np.zeros((len(q), scene.nl))
        mass, largest = self.masses_at(q), 0.0
        still = kernel.acceleration(q, v, u, none)
        for contact in range(scene.nc):
            push = none.copy()
            push[:, contact] = self.opened_lam[:, contact]
            largest = max(
                largest, float(sizes(mass, kernel.acceleration(q, v, u, push) - still).max())
            )
        share = _OF_RANGE if largest > 0.0 else 1.0
        ranges = [item.upper - item.lower for item in scene.inputs]
        for place, width in enumerate(ranges):
            pull = u.copy()
            pull[:, place] = share * (
                width if np.isfinite(width) else 2.0 * np.abs(self.trajectory.u[:, place]).max()
            )
            largest = max(
                largest, float(sizes(mass, kernel.acceleration(q, v, pull, none) - still).max())
            )
        if largest > 0.0:
            return largest
        nominal = (
            np.array([item.nominal for item in scene.coordinates]) / self.trajectory.duration**2
        )
        return max(float(sizes(mass, still).max()), float(sizes(mass, nominal).max()))

    @cached_property
    def masses(self) -> np.ndarray:
        """Mass matrices along the plan, (nodes, nq, nq) [kg or kg m^2].

        Raises Unmeasured without positions or equations.
        """
        return self.masses_at(self.q)

    def masses_at(self, q: np.ndarray) -> np.ndarray:
        """Mass matrices (n, nq, nq) [kg or kg m^2] at positions q (n, nq).

        Raises Unmeasured for somebody's FMU.
        """
        d = derive(self.equations)
        mass = d.function(d.mass_matrix, d.q)
        if d.structure.constant_mass and len(q):
            return np.repeat(mass(q[0])[None], len(q), axis=0)
        return np.array([np.array(mass(row), dtype=float).reshape(len(row), len(row)) for row in q])

    @cached_property
    def printing(self) -> dict[str, float]:
        """Half a unit of the last printed digit of the plan's t, q, v, u and lam.

        In the unit of the group.
        """
        plan, items = self.trajectory, self.scene.coordinates
        nominal = min((item.nominal for item in items), default=1.0)
        ranges = [item.upper - item.lower for item in self.scene.inputs]
        largest = [
            width if np.isfinite(width) else float(np.abs(plan.u[:, index]).max())
            for index, width in enumerate(ranges)
        ]
        uniform = plan.has_uniform_grid() or bool(
            np.allclose(np.diff(plan.t), self.scene.task.step, rtol=1e-9, atol=0.0)
        )
        return {
            # Of a grid that is no grid to all its digits; a tenth of a step may be lost so.
            "t": 0.0 if uniform else half_unit(plan.t, 200.0 * float(np.diff(plan.t).min())),
            "q": half_unit(plan.q, nominal),
            "v": half_unit(plan.v, nominal),
            "u": half_unit(plan.u, min(largest, default=0.0)),
            "lam": half_unit(plan.lam, float(np.abs(plan.lam).max(initial=0.0))),
        }

    @cached_property
    def printing_acceleration(self) -> float:
        """By how much printing may change an acceleration of the plan [m/s^2, rad/s^2]: tried by rounding states, inputs and true forces anew."""
        plan, size = self.trajectory, self.printing
        if not any(size[group] for group in ("q", "v", "u", "lam")):
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
                return values + scale * size[group] * random.choice((-1.0, 1.0), size=values.shape)

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
    def start_velocity(self) -> np.ndarray:
        """Velocities of the task's start, (nq,) [m/s or rad/s].

        Raises TypeError where the task gives none.
        """
        return np.array(self.scene.task.start[self.scene.nq :], dtype=float)

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
        forces, kernel = self.trajectory.lam, self.kernel
        first = np.maximum(kernel.friction_limit(self.q[:-1], forces), 0.0)
        if self.trajectory.scheme is not None:
            return first, first
        last = np.maximum(kernel.friction_limit(self.q[1:], forces), 0.0)
        return np.minimum(first, last), np.maximum(first, last)

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

    @property
    def opened_q(self) -> np.ndarray:
        """Positions of the replay of the inputs alone, as far as it got, (n, nq) [m or rad].

        Without one the plan's.
        """
        return (
            self.trajectory.q if self._replay is None or not len(self._replay.t) else self._replay.q
        )

    @property
    def opened_lam(self) -> np.ndarray:
        """Contact forces that belong to `opened_q`, (n, nc) [N].

        Raises Unmeasured without a replay and without positions of the plan.
        """
        return self.law if self._replay is None or not len(self._replay.t) else self._replay.lam

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


def _without_repeats(
    t: np.ndarray, q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows whose times increase."""
    rows = np.flatnonzero(np.diff(t, prepend=-np.inf) > 0.0)
    return t[rows], q[rows], v[rows]


def _at_times(
    times: np.ndarray, t: np.ndarray, q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """q, v at `times`: rows where there are such, as there are in the replay of a plan on the task's own grid; else of the cubics between rows."""
    near = np.minimum(np.searchsorted(t, times * (1.0 - 1e-12)), len(t) - 1)
    if np.allclose(t[near], times, rtol=1e-12, atol=0.0):
        return q[near], v[near]
    from scipy.interpolate import CubicHermiteSpline  # 0.3 CPU s to import

    motion = CubicHermiteSpline(t, q, v)
    return motion(times), motion(times, 1)


def sizes(mass: np.ndarray, dv: np.ndarray) -> np.ndarray:
    """Size of changes of velocity in the norm of the mass matrix: sqrt(dv' M dv).

    Parameters
    ----------
    mass : (n, nq, nq) [kg or kg m^2].
    dv : (n, nq) or (nq,) changes [m/s or rad/s].

    Returns
    -------
    (n,) [kg^0.5 m/s]

    Raises
    ------
    ValueError : if the shapes do not fit.
    """
    dv = np.broadcast_to(dv, mass.shape[:2])
    return np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", dv, mass, dv), 0.0))
