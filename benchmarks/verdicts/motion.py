"""The motion that inputs give in a scene, by an integration that shares no code with the judge: no kernel, no FMU, no `models.dynamics`.

    truth = Motion(load_scene("three_cart"))
    path = truth.run(t, u)                        # inputs held over each step; path.q, path.v at t, path.lam_mean, path.depth ..

The equations are lambdified from the energies in the scene file, M dv/dt + .. = Q + J' lam + S' f, and integrated by SciPy's DOP853 at rtol 1e-11, from one
event to the next: an input jumps, a contact closes or opens, a slip begins, stops or turns. Between events everything is smooth. A friction that sticks
gives whatever keeps the slip's rate at 0, one that slips gives mu N against the slip. Undamped contacts only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sympy as sp
from scipy.integrate import DOP853
from scipy.optimize import brentq

from models.scene import Scene

RTOL, ATOL = 1e-11, 1e-13
# A friction sticks, slips one way (+1) or the other (-1); FREE: nothing presses it.
STICK, FREE = 0, None
# Events within one step of a plan; more is a motion that cannot be followed.
MOST_EVENTS = 2000


@dataclass(frozen=True, kw_only=True)
class Path:
    """A motion at the nodes t (n,), with the forces of the steps between them (n - 1, nc) and (n - 1, nf) [N].

    lam_start, lam_end: the contact forces at the ends of each step; lam_mean, friction_mean: impulse over step; friction_start, friction_end: just
    after its start, just before its end. depth (nc,): the deepest penetration [m]. ended: False where the motion ran away, and the rest is NaN.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam_start: np.ndarray
    lam_end: np.ndarray
    lam_mean: np.ndarray
    friction_start: np.ndarray
    friction_end: np.ndarray
    friction_mean: np.ndarray
    depth: np.ndarray
    ended: bool


class RanAwayError(Exception):
    """The motion cannot be followed: it grows without bound, or its events pile up."""


class Motion:
    """The equations of one scene; see the module docstring."""

    def __init__(self, scene: Scene, stiffer: float = 1.0) -> None:
        """stiffer: a factor on the stiffness of every contact. Raises ValueError for a scene with damped contacts or without mass."""
        if scene.damped:
            raise ValueError(f"{scene.name}: its contacts are damped, which this integration does not know.")
        self.scene, self.nq, self.nc, self.nf = scene, scene.nq, scene.nc, scene.nf
        q = [item.symbol for item in scene.coordinates]
        v = [item.velocity for item in scene.coordinates]
        u = [item.symbol for item in scene.inputs]
        lam = list(sp.symbols(f"_lam0:{self.nc}")) if self.nc else []
        f = list(sp.symbols(f"_f0:{self.nf}")) if self.nf else []
        values = scene.parameter_values
        self.k = [float(sp.sympify(item.stiffness).subs(values)) * stiffer for item in scene.contacts]

        # Lagrange: d/dt dT/dv - dT/dq + dV/dq = Q + J' lam + S' f, and d/dt dT/dv = M dv/dt + (d2T/dv dq) v.
        T, V = sp.sympify(scene.kinetic_energy).subs(values), sp.sympify(scene.potential_energy).subs(values)
        momentum = sp.Matrix([T.diff(speed) for speed in v])
        M = momentum.jacobian(v)
        rest = sp.Matrix(
            [
                sp.sympify(force).subs(values) + (T - V).diff(place) - _rate(momentum[i], q, v)
                for i, (force, place) in enumerate(zip(scene.forces, q, strict=True))
            ]
        )
        phi = sp.Matrix(self.nc, 1, [sp.sympify(item.penetration).subs(values) for item in scene.contacts])
        slip = sp.Matrix(self.nf, 1, [sp.sympify(item.slip).subs(values) for item in scene.frictions])
        slip_by_v = slip.jacobian(v) if self.nf else sp.zeros(0, self.nq)
        force = rest
        if self.nc:
            force = force - phi.jacobian(q).T * sp.Matrix(lam)
        if self.nf:
            force = force + slip_by_v.T * sp.Matrix(f)
        pressed_by = {item.name: symbol for item, symbol in zip(scene.contacts, lam, strict=True)}
        limit = [
            sp.sympify(item.coefficient).subs(values)
            * (pressed_by[item.contact] if item.contact is not None else sp.sympify(item.normal_force).subs(values))
            for item in scene.frictions
        ]
        self._phi = sp.lambdify([q], list(phi), modules="math", cse=True)
        self._slip = sp.lambdify([q, v], list(slip), modules="math", cse=True)
        self._limit = sp.lambdify([q, lam], limit, modules="math", cse=True)
        self._mass = None
        if M.free_symbols & set(q):
            self._mass = sp.lambdify([q], M.tolist(), modules="math", cse=True)
            self._force = sp.lambdify([q, v, u, lam, f], list(force), modules="math", cse=True)
        else:
            if M.rank() < self.nq:
                raise ValueError(f"{scene.name}: a coordinate has no mass, which this integration does not know.")
            self._force = sp.lambdify([q, v, u, lam, f], list(M.LUsolve(force)), modules="math", cse=True)
        # The rate of a slip: S dv/dt + (dS/dt) v.
        drift = sp.Matrix([_rate(item, q, v) for item in slip]) if self.nf else sp.zeros(0, 1)
        self._slip_by_v = sp.lambdify([q], slip_by_v.tolist(), modules="math", cse=True)
        self._slip_drift = sp.lambdify([q, v], list(drift), modules="math", cse=True)

    def _acceleration(self, q: list[float], v: list[float], u: list[float], lam: list[float], f: list[float]) -> list[float]:
        right = self._force(q, v, u, lam, f)
        return right if self._mass is None else np.linalg.solve(np.array(self._mass(q)), np.array(right)).tolist()

    def rates(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(2 nq,) rate of a state by the contact law as it stands, kink and all: what a simulator of a fixed step evaluates. Without friction."""
        values = state.tolist()
        q, v = values[: self.nq], values[self.nq :]
        lam = [k * max(depth, 0.0) for k, depth in zip(self.k, self._phi(q), strict=True)]
        return np.array([*v, *self._acceleration(q, v, np.asarray(u).tolist(), lam, [])])

    def forces(self, q: np.ndarray) -> np.ndarray:
        """(n, nc) contact forces at positions (n, nq)."""
        found = [[k * max(depth, 0.0) for k, depth in zip(self.k, self._phi(row), strict=True)] for row in np.asarray(q).tolist()]
        return np.array(found).reshape(len(q), self.nc)

    def _contact_forces(self, q: list[float], closed: list[bool]) -> list[float]:
        return [k * depth if shut else 0.0 for k, depth, shut in zip(self.k, self._phi(q), closed, strict=True)]

    def _friction_forces(self, q: list[float], v: list[float], u: list[float], lam: list[float], modes: list) -> list[float]:
        """Those that slip by the law, those that stick so that no slip has a rate."""
        if not self.nf:
            return []
        limit = self._limit(q, lam)
        f = [-mode * most if mode else 0.0 for mode, most in zip(modes, limit, strict=True)]
        stuck = [j for j, mode in enumerate(modes) if mode is STICK]
        if not stuck:
            return f

        def rates(forces: list[float]) -> np.ndarray:
            a = np.array(self._acceleration(q, v, u, lam, forces))
            return (np.array(self._slip_by_v(q)) @ a + np.array(self._slip_drift(q, v)))[stuck]

        here = rates(f)
        effect = np.empty((len(stuck), len(stuck)))
        for column, j in enumerate(stuck):
            effect[:, column] = rates([value + (1.0 if i == j else 0.0) for i, value in enumerate(f)]) - here
        for j, value in zip(stuck, np.linalg.solve(effect, -here), strict=True):
            f[j] = float(value)
        return f

    def _settled(self, q: list[float], v: list[float], u: list[float], lam: list[float], modes: list, asked: list[int]) -> list:
        """The modes of the frictions `asked`, whose slip is 0: stick if the force for it is there, else slip to where the rest drives."""
        modes = list(modes)
        for j in asked:
            if self._limit(q, lam)[j] <= 0.0:
                modes[j] = FREE
                continue
            modes[j] = STICK
            force = self._friction_forces(q, v, u, lam, modes)[j]
            if abs(force) > self._limit(q, lam)[j]:
                modes[j] = -1 if force > 0.0 else 1
        return modes

    def run(
        self, t: np.ndarray, u: np.ndarray, *, nodes: np.ndarray | None = None, linear_to: np.ndarray | None = None, rtol: float = RTOL,
        start: np.ndarray | None = None,
    ) -> Path:  # fmt: skip
        """The motion from the task's start (or `start`, (2 nq,)) under u (n - 1, nu), held over the steps of t (n,).

        linear_to: (nu,) inputs at the last node; then they change linearly from node to node. nodes: where the path is wanted, t unless given, of the
        same span.
        """
        t = np.asarray(t, dtype=float)
        nodes = t if nodes is None else np.asarray(nodes, dtype=float)
        corners = np.unique(np.concatenate([t, nodes]))
        corners = corners[np.concatenate([[True], np.diff(corners) > 1e-12])]
        ends = None if linear_to is None else np.vstack([u[1:], linear_to])
        state = np.concatenate([self.scene.task.start if start is None else start, np.zeros(self.nc + self.nf)]).astype(float)
        nq, (q, v) = self.nq, (state[: self.nq].tolist(), state[self.nq : 2 * self.nq].tolist())
        closed = [depth > 0.0 for depth in self._phi(q)]
        modes = [FREE] * self.nf
        self._deepest = np.array(self._phi(q)) if self.nc else np.zeros(0)
        states = np.full((len(nodes), len(state)), np.nan)
        ends_of = np.full((2, len(nodes), self.nf), np.nan)  # just after, just before a node
        states[0], at, ended = state, 0, True
        for low, high in zip(corners[:-1], corners[1:], strict=True):
            step = min(int(np.searchsorted(t, low + 1e-12, side="right")) - 1, len(u) - 1)
            slope = np.zeros(self.scene.nu) if ends is None else (ends[step] - u[step]) / (t[step + 1] - t[step])
            first = u[step] + slope * (low - t[step])
            try:
                q, v = state[:nq].tolist(), state[nq : 2 * nq].tolist()
                modes = self._modes(q, v, first.tolist(), closed, modes)
                if abs(low - nodes[at]) < 1e-12:
                    ends_of[0, at] = self._friction_forces(q, v, first.tolist(), self._contact_forces(q, closed), modes)
                state, closed, modes = self._advance(low, high, state, first, slope, closed, modes, rtol)
            except (RanAwayError, OverflowError, np.linalg.LinAlgError, ValueError):
                ended = False
                break
            if at + 1 < len(nodes) and abs(high - nodes[at + 1]) < 1e-12:
                at += 1
                states[at] = state
                q, v = state[:nq].tolist(), state[nq : 2 * nq].tolist()
                last = (first + slope * (high - low)).tolist()
                ends_of[1, at] = self._friction_forces(q, v, last, self._contact_forces(q, closed), modes)
        spans = np.diff(nodes)[:, None]
        impulses = np.diff(states[:, 2 * nq :], axis=0) / spans
        force = self.forces(states[:, :nq])
        return Path(
            t=nodes, q=states[:, :nq], v=states[:, nq : 2 * nq], depth=self._deepest, ended=ended,
            lam_start=force[:-1], lam_end=force[1:], lam_mean=impulses[:, : self.nc],
            friction_start=ends_of[0, :-1], friction_end=ends_of[1, 1:], friction_mean=impulses[:, self.nc :],
        )  # fmt: skip

    def _modes(self, q: list[float], v: list[float], u: list[float], closed: list[bool], modes: list) -> list:
        """After a jump of the inputs, and at the start: what slips goes on, what is at rest is asked again."""
        lam = self._contact_forces(q, closed)
        slips = self._slip(q, v)
        known = [
            mode if mode is STICK else (int(np.sign(s)) if abs(s) > 1e-10 else STICK) for mode, s in zip(modes, slips, strict=True)
        ]
        limits = self._limit(q, lam)
        known = [FREE if most <= 0.0 else mode for mode, most in zip(known, limits, strict=True)]
        return self._settled(q, v, u, lam, known, [j for j, mode in enumerate(known) if mode is STICK])

    def _advance(self, low, high, state, first, slope, closed, modes, rtol):  # noqa: ANN001 - as in run
        """From low to high, event by event: (state, closed, modes) at high."""
        nq, origin, steady = self.nq, low, not slope.any()
        constant = first.tolist()

        def inputs(time: float) -> list[float]:
            return constant if steady else (first + slope * (time - origin)).tolist()

        def rates(time: float, y: np.ndarray) -> list[float]:
            values = y.tolist()
            q, v, u = values[:nq], values[nq : 2 * nq], inputs(time)
            lam = self._contact_forces(q, closed)
            f = self._friction_forces(q, v, u, lam, modes)
            return [*v, *self._acceleration(q, v, u, lam, f), *lam, *f]

        def watched(time: float, y: np.ndarray) -> list[float]:
            """What must not fall below 0 in this phase."""
            values = y.tolist()
            q, v = values[:nq], values[nq : 2 * nq]
            depths = self._phi(q)
            found = [depth if shut else -depth for depth, shut in zip(depths, closed, strict=True)]
            if self.nf:
                u, lam = inputs(time), self._contact_forces(q, closed)
                f, most, slips = self._friction_forces(q, v, u, lam, modes), self._limit(q, lam), self._slip(q, v)
                found += [
                    1.0 if mode is FREE else (most[j] - abs(f[j]) if mode is STICK else mode * slips[j]) for j, mode in enumerate(modes)
                ]
            return found

        longest = min(self.scene.task.step, high - low) / (2.0 if self.nc + self.nf else 1.0)
        guess = longest
        for _ in range(MOST_EVENTS):
            solver = DOP853(rates, low, state, high, rtol=rtol, atol=ATOL, max_step=longest, first_step=min(guess, high - low))
            before, event = watched(low, state), None
            while solver.status == "running" and event is None:
                solver.step()
                if solver.status == "failed" or not np.isfinite(solver.y).all() or np.abs(solver.y).max() > 1e8:
                    raise RanAwayError
                guess = max(solver.h_abs, 1e-9)
                after = watched(solver.t, solver.y)
                if self.nc:
                    self._deepest = np.maximum(self._deepest, self._phi(solver.y[:nq].tolist()))
                event = self._first_event(watched, solver, before, after)
                before = after
            if event is None:
                return solver.y, closed, modes
            low, which, state = event
            closed, modes = self._after(which, state, inputs(low), closed, modes)
            if high - low < 1e-13:
                return state, closed, modes
        raise RanAwayError

    def _first_event(self, watched, solver, before, after):  # noqa: ANN001 - as in _advance
        """(time, which, state) of the earliest that fell below 0 in the last step of the solver, or None."""
        fallen = [i for i, value in enumerate(after) if value < 0.0]
        if not fallen:
            return None
        dense, times = solver.dense_output(), {}
        for i in fallen:
            if before[i] <= 0.0:
                # It began at 0 and went the wrong way: at once, unless that is rounding.
                if after[i] > -1e-13:
                    continue
                times[i] = solver.t_old
            else:
                times[i] = brentq(lambda time, i=i: watched(time, dense(time))[i], solver.t_old, solver.t, xtol=1e-15, rtol=1e-15)
        if not times:
            return None
        which = min(times, key=lambda i: times[i])
        return times[which], which, dense(times[which])

    def _after(self, which, state, u, closed, modes):  # noqa: ANN001 - as in _advance
        """(closed, modes) behind an event."""
        q, v = state[: self.nq].tolist(), state[self.nq : 2 * self.nq].tolist()
        closed = list(closed)
        if which < self.nc:
            closed[which] = not closed[which]
            lam = self._contact_forces(q, closed)
            slips, fresh = self._slip(q, v), list(modes)
            for j, friction in enumerate(self.scene.frictions):
                if friction.contact == self.scene.contacts[which].name:
                    fresh[j] = (int(np.sign(slips[j])) or 1) if closed[which] else FREE
            return closed, fresh if self.nf else modes
        j, lam = which - self.nc, self._contact_forces(q, closed)
        if modes[j] is STICK:
            force = self._friction_forces(q, v, u, lam, modes)[j]
            return closed, [(-1 if force > 0.0 else 1) if i == j else mode for i, mode in enumerate(modes)]
        return closed, self._settled(q, v, u, lam, modes, [j])


def _rate(expression: sp.Expr, q: list[sp.Symbol], v: list[sp.Symbol]) -> sp.Expr:
    """(d/dq) v of an expression: its rate but for accelerations."""
    return sum((expression.diff(place) * speed for place, speed in zip(q, v, strict=True)), sp.S.Zero)
