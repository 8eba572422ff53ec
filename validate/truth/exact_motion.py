"""Exact motion of a scene under piecewise constant inputs, without compiled code.

    states = true_motion(Equations(scene), [Piece(end=1.0, u=u)], times)

DOP853 restarts at every change of an input, a contact, its damping or a friction. Radau IIA is used
without inertia, and if DOP853 exceeds its budget. Friction modes are searched exhaustively, unlike
in the FMU.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import sympy as sp

from models.dynamics import Dynamics, derive
from models.errors import SceneError
from models.scene import Scene
from models.scene.contacts import DampingLaw

# Largest number of evaluations per method, about ten seconds; the bank's scenes take 300 to 44,000.
BUDGET = 200_000
# Relative penetration at the boundary, where the direction of motion decides the mode.
_BOUNDARY = 1e-10
# Largest number of contact changes within a piece.
_MOST_SWITCHES = 10_000


class MotionError(SceneError):
    """The motion cannot be integrated, or not within the budget."""


# scipy's method and relative tolerance; the absolute one is that times each nominal.
EXPLICIT = ("DOP853", 1e-12)
IMPLICIT = ("Radau", 1e-9)  # smaller tolerances do not improve order 5


@dataclass(frozen=True)
class Piece:
    """Constant inputs u (nu,) until `end` [s]."""

    end: float
    u: np.ndarray


@dataclass(frozen=True)
class Modes:
    """closed, pushes (nc,) bool: a damped contact may be closed, but released.

    slips (nf,): direction -1 or 1, or 0 while sticking.
    """

    closed: np.ndarray
    pushes: np.ndarray
    slips: np.ndarray


class Equations:
    """The scene's equations as numpy functions; x is positions, then velocities."""

    def __init__(self, scene: Scene) -> None:
        d = derive(scene)
        self.scene, self.n = scene, scene.nq
        share = pressing_shares(d)
        slip_rate = (
            d.slip.jacobian(d.q) * sp.Matrix(d.v) if scene.nf else d.slip
        )  # at zero acceleration
        parts = {
            "mass": d.mass_matrix, "jacobian": d.gap_jacobian, "direction": d.slip_jacobian,
            "phi": d.penetration, "push": d.push, "slip": d.slip, "slip_rate": slip_rate,
            "share": share,
        }  # fmt: skip
        # One cached function for all: a call costs more than its computation.
        self._all, self._last = (
            _quick(d, [entry for matrix in parts.values() for entry in matrix], d.q, d.v),
            (b"", {}),
        )
        ends = np.cumsum([0, *(len(matrix) for matrix in parts.values())]).tolist()
        shapes = [
            matrix.shape if name in ("mass", "jacobian", "direction") else (-1,)
            for name, matrix in parts.items()
        ]
        self._places = list(zip(parts, ends, ends[1:], shapes, strict=False))
        self._tau, self._limit = (
            _quick(d, list(d.tau), d.q, d.v, d.u),
            _quick(d, list(d.friction_limit), d.q, d.lam),
        )
        self.stiffness = d.function(d.stiffness)().ravel()
        slopes = [
            share.jacobian(group) if scene.damped else sp.zeros(0, self.n) for group in (d.q, d.v)
        ]
        self._share_slopes = [d.function(slope, d.q, d.v) for slope in slopes]
        self._slip_band = _BOUNDARY * np.array([friction.nominal for friction in scene.frictions])
        self._band = _BOUNDARY * np.array([contact.nominal for contact in scene.contacts])

    def at(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Return the functions of the state x (2*nq,) [m, rad, m/s, rad/s], by name.

        - mass, jacobian, direction: M, J and S.
        - phi (nc,) [m].
        - push (nc,): of closed contacts [N].
        - slip (nf,) [m/s]; slip_rate (nf,) [m/s^2].
        - share: push of each closed damped contact over a typical push [-].

        Raises nothing.
        """
        key = x.tobytes()
        if key != self._last[0]:
            values = self._all(x[: self.n], x[self.n :])
            self._last = (
                key,
                {
                    name: values[first:last].reshape(shape)
                    for name, first, last, shape in self._places
                },
            )
        return self._last[1]

    def modes(self, x: np.ndarray, u: np.ndarray) -> Modes:
        """Return the modes of contacts (nc,) and frictions (nf,), tried for consistency.

        x: (2*nq,) [m, rad, m/s, rad/s]; u: (nu,) [N, N m]. Raises LinAlgError for a singular mass
        matrix.
        """
        closed = self.closed(x, u)
        pushes = self.pushes(x, u, closed)
        slip = self.at(x)["slip"]
        limit = self.limit(x, pushes)
        decided = np.abs(slip) > self._slip_band
        ways = [
            [0, 1, -1] if pressed else [1, -1] for pressed in limit > 0
        ]  # without pressure nothing sticks
        choices = [
            [1 if value >= 0 else -1] if known else way
            for value, known, way in zip(slip, decided, ways, strict=True)
        ]
        for slips in product(*choices):
            modes = Modes(closed, pushes, np.array(slips, dtype=int))
            acceleration, force = self.motion(x, u, modes)
            change = self.at(x)["slip_rate"] + self.at(x)["direction"] @ acceleration
            holds = np.abs(force) <= limit * (
                1 + _BOUNDARY / 2
            )  # below the end of sticking, so that leaving is final
            if np.all(decided | np.where(modes.slips == 0, holds, modes.slips * change >= 0)):
                return modes
        return Modes(closed, pushes, np.where(decided, np.where(slip >= 0, 1, -1), 0))

    def closed(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return which contacts (nc,) are closed.

        On the boundary the direction of motion decides, at rest that of the acceleration. x:
        (2*nq,) [m, rad, m/s, rad/s]; u: (nu,) [N, N m]. Raises LinAlgError for a singular mass
        matrix.
        """
        phi = self.at(x)["phi"]
        jacobian, at_boundary = self.at(x)["jacobian"], np.abs(phi) <= self._band
        rate = -jacobian @ x[self.n :]
        if np.any(at_boundary & (rate == 0)):
            inside = phi > self._band
            free = Modes(inside, inside, np.ones(len(self._slip_band), dtype=int))
            rate = np.where(rate == 0, -jacobian @ self.motion(x, u, free)[0], rate)
        return (phi > self._band) | (at_boundary & (rate > 0))

    def pushes(self, x: np.ndarray, u: np.ndarray, closed: np.ndarray) -> np.ndarray:
        """Return closed contacts (nc,) with a pushing force, or a growing one at zero.

        x: (2*nq,) [m, rad, m/s, rad/s]; u: (nu,) [N, N m]; closed: (nc,). Raises LinAlgError for a
        singular mass matrix.
        """
        result = closed.copy()
        for row, contact in enumerate(self.scene.damped):
            share = self.at(x)["share"][row]
            if closed[contact] and share <= _BOUNDARY:
                free = Modes(closed, closed, np.ones(len(self._slip_band), dtype=int))
                by_q, by_v = (slope(x[: self.n], x[self.n :])[row] for slope in self._share_slopes)
                result[contact] = (
                    share >= -_BOUNDARY
                    and by_q @ x[self.n :] + by_v @ self.motion(x, u, free)[0] > 0
                )
        return result

    def limit(self, x: np.ndarray, pushes: np.ndarray) -> np.ndarray:
        """Return the friction limits mu N (nf,) [N] at x (2*nq,); pushes: (nc,).

        Raises ValueError for another length.
        """
        return self._limit(x[: self.n], self.contact_force(x, pushes))

    def contact_force(self, x: np.ndarray, pushes: np.ndarray) -> np.ndarray:
        """Return lam (nc,) [N] at x (2*nq,): k phi with damping if pushing (nc,), else 0.

        Raises ValueError for another length.
        """
        push, damped = self.stiffness * self.at(x)["phi"], list(self.scene.damped)
        push[damped] = self.at(x)["push"][damped]
        return np.where(pushes, push, 0.0)

    def motion(self, x: np.ndarray, u: np.ndarray, modes: Modes) -> tuple[np.ndarray, np.ndarray]:
        """Return accelerations (nq,) [m/s^2, rad/s^2] and friction forces (nf,) [N].

        M a - S' f = forces, and S a = -dS/dt v while sticking. x: (2*nq,) [m, rad, m/s, rad/s]; u:
        (nu,) [N, N m]. Raises LinAlgError for a singular mass matrix.
        """
        now, n = self.at(x), self.n
        lam = self.contact_force(x, modes.pushes)
        friction = -modes.slips * self._limit(x[:n], lam)
        force = self._tau(x[:n], x[n:], u) + now["jacobian"].T @ lam + now["direction"].T @ friction
        sticks = modes.slips == 0
        if not sticks.any():
            return np.linalg.solve(now["mass"], force), friction
        S = now["direction"][sticks]
        system = np.zeros((n + len(S), n + len(S)))
        system[:n, :n], system[:n, n:], system[n:, :n] = now["mass"], -S.T, S
        right = np.concatenate([force, -now["slip_rate"][sticks]])
        # Redundant frictions share their force: the system is singular, but consistent.
        solution = np.linalg.lstsq(system, right)[0]
        friction[sticks] = solution[n:]
        return solution[:n], friction

    def rate(self, x: np.ndarray, u: np.ndarray, modes: Modes) -> np.ndarray:
        """Return dx/dt (2*nq,) [m/s, rad/s, m/s^2, rad/s^2] at x (2*nq,), u (nu,) in these modes.

        Raises LinAlgError for a singular mass matrix.
        """
        return np.concatenate([x[self.n :], self.motion(x, u, modes)[0]])

    def reserve(self, x: np.ndarray, u: np.ndarray, modes: Modes, index: int) -> float:
        """Return the reserve of a friction's mode: slip [m/s], or force [N] if sticking.

        x: (2*nq,) [m, rad, m/s, rad/s]; u: (nu,) [N, N m]; index: of the friction. Raises
        LinAlgError for a singular mass matrix.
        """
        if modes.slips[index]:
            return float(modes.slips[index] * self.at(x)["slip"][index])
        return float(
            self.limit(x, modes.pushes)[index] * (1 + _BOUNDARY)
            - abs(self.motion(x, u, modes)[1][index])
        )


def _quick(
    d: Dynamics, entries: Sequence[sp.Expr], *groups: Sequence[sp.Symbol]
) -> Callable[..., np.ndarray]:
    """Return a function by Python floats, three times as fast as numpy; NaN where undefined."""
    expressions = [sp.sympify(entry).subs(d.scene.parameter_values) for entry in entries]
    compiled = sp.lambdify([list(group) for group in groups], expressions, modules="math", cse=True)

    def call(*values: np.ndarray) -> np.ndarray:
        try:
            return np.array(compiled(*(value.tolist() for value in values)), dtype=float)
        except (ArithmeticError, ValueError):
            return np.full(len(expressions), np.nan)

    return call


def pressing_shares(d: Dynamics) -> sp.Matrix:
    """Return the push of each damped contact over k times its nominal penetration.

    Hunt-Crossley: over its spring's push.
    """
    shares = []
    for index in d.scene.damped:
        contact, rate = d.scene.contacts[index], -(d.gap_jacobian[index, :] * sp.Matrix(d.v))[0]
        is_linear = contact.damping_law is DampingLaw.KELVIN_VOIGT
        shares.append(
            d.push[index] / (d.stiffness[index] * contact.nominal)
            if is_linear
            else 1 + contact.damping * rate
        )
    return sp.Matrix(len(shares), 1, shares)


def true_motion(equations: Equations, pieces: Sequence[Piece], times: np.ndarray) -> np.ndarray:
    """Return the states (n, 2*nq) [m, rad, m/s, rad/s] of the true motion at times (n,) [s].

    Raises MotionError if neither method succeeds within the budget.
    """
    # Without inertia velocities settle within the lag, which explicit steps would have to resolve.
    if equations.scene.lag is None:
        with contextlib.suppress(MotionError):
            return _motion_by(EXPLICIT, equations, pieces, times)
    return _motion_by(IMPLICIT, equations, pieces, times)


def _motion_by(
    integrator: tuple[str, float],
    equations: Equations,
    pieces: Sequence[Piece],
    times: np.ndarray,
) -> np.ndarray:
    scene, evaluations_left = equations.scene, BUDGET
    method, tolerance = integrator
    x, t = np.array(scene.task.start, dtype=float), 0.0
    nominal = np.tile([coordinate.nominal for coordinate in scene.coordinates], 2)
    result = np.full((len(times), x.size), np.nan)
    result[times <= t] = x

    from scipy.integrate import (
        solve_ivp,
    )  # 0.3 CPU s to import, which a replay does not need

    def rate(at: float, y: np.ndarray, u: np.ndarray, modes: Modes) -> np.ndarray:
        """Return the derivative (2*nq,) [m/s, rad/s, m/s^2, rad/s^2]. Raises MotionError."""
        nonlocal evaluations_left
        evaluations_left -= 1
        if evaluations_left < 0:
            raise MotionError(
                f"scene {scene.name}: its motion takes more than {BUDGET} evaluations of its equations, of which {method} came to t = {at:.6g} s."
            )
        return equations.rate(y, u, modes)

    for piece in pieces:
        for _ in range(_MOST_SWITCHES):
            if t >= piece.end:
                break
            modes = equations.modes(x, piece.u)
            solution = solve_ivp(
                lambda at, y, u=piece.u, modes=modes: rate(at, y, u, modes),
                (t, piece.end),
                x,
                method=method,
                rtol=tolerance,
                atol=tolerance * nominal,
                max_step=scene.task.step,
                dense_output=True,
                events=_leaving(equations, modes, piece.u),
            )
            if not solution.success or not np.isfinite(solution.y[:, -1]).all():
                raise MotionError(
                    f"scene {scene.name}: its motion cannot be followed beyond t = {solution.t[-1]:.6g} s ({solution.message})."
                )
            inside = (times > t) & (times <= solution.t[-1])
            if inside.any():
                result[inside] = solution.sol(times[inside]).T
            x, t = solution.y[:, -1], float(solution.t[-1])
    return result


def _leaving(
    equations: Equations, modes: Modes, u: np.ndarray
) -> list[Callable[[float, np.ndarray], float]]:
    """Return event functions that fall through zero where a contact or friction changes mode."""

    def contact(name: str, index: int, *, positive: bool) -> Callable[[float, np.ndarray], float]:
        return lambda _, y: float(
            equations.at(y)[name][index] if positive else -equations.at(y)[name][index]
        )

    def friction(index: int) -> Callable[[float, np.ndarray], float]:
        return lambda _, y: equations.reserve(y, u, modes, index)

    events = [contact("phi", index, positive=mode) for index, mode in enumerate(modes.closed)]
    damped = enumerate(equations.scene.damped)
    events += [
        contact("share", row, positive=modes.pushes[index])
        for row, index in damped
        if modes.closed[index]
    ]
    events += [friction(index) for index in range(len(modes.slips))]
    for event in events:
        event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined] - scipy's interface
    return events
