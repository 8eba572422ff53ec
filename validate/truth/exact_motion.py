"""The exact continuous motion of a scene under piecewise constant inputs, without any C.

    states = true_motion(Equations(scene), [Piece(end=1.0, u=u)], times)

scipy's DOP853 integrates the scene's equations as numpy functions, and restarts at every change of
an input, a contact, its damping or a friction. Radau IIA integrates motions without inertia, and
those that take DOP853 more than a budget of evaluations. Modes of friction are found by trying
every combination for one without a contradiction; the FMU finds them another way.
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

# Evaluations of the equations before a method is given up, about ten seconds of them; the scenes of
# the bank take 300 to 44,000.
BUDGET = 200_000
# A penetration below this share of the contact's nominal is on the boundary: there the direction of
# motion decides the mode.
_BOUNDARY = 1e-10
# Contact changes within one piece before the motion is given up.
_MOST_SWITCHES = 10_000


class MotionError(SceneError):
    """The motion cannot be followed, or not within the budget."""


# scipy's method and its relative tolerance; the absolute one is that times the nominal of each state.
EXPLICIT = ("DOP853", 1e-12)
IMPLICIT = ("Radau", 1e-9)  # a smaller tolerance does not make order 5 more accurate


@dataclass(frozen=True)
class Piece:
    """Constant inputs u (nu,) until `end` [s]."""

    end: float
    u: np.ndarray


@dataclass(frozen=True)
class Modes:
    """closed, pushes (nc,) bool: a damped contact may be closed and released.

    Slips (nf,): -1 or 1, the way it slips, or 0 where it sticks.
    """

    closed: np.ndarray
    pushes: np.ndarray
    slips: np.ndarray


class Equations:
    """The scene's equations as numpy functions of flat vectors; x is positions, then velocities."""

    def __init__(self, scene: Scene) -> None:
        d = derive(scene)
        self.scene, self.n = scene, scene.nq
        share = pressing_shares(d)
        slip_rate = (
            d.slip.jacobian(d.q) * sp.Matrix(d.v) if scene.nf else d.slip
        )  # at no acceleration
        parts = {
            "mass": d.mass_matrix, "jacobian": d.gap_jacobian, "direction": d.slip_jacobian,
            "phi": d.penetration, "push": d.push, "slip": d.slip, "slip_rate": slip_rate,
            "share": share,
        }  # fmt: skip
        # One function for all of them, kept at the last state: a call costs more than what it
        # computes.
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
        """What depends on the state x (2*nq,) [m, rad, m/s, rad/s] alone, by name.

        mass, jacobian, direction: the matrices M, J and S; phi (nc,) penetrations [m]; push (nc,)
            forces of closed contacts [N]; slip (nf,) [m/s]; slip_rate
        (nf,) [m/s^2]; share: what each damped contact would push with if it is closed, as a share
            of a typical push [-]. Raises nothing.
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
        """The modes of all contacts and frictions: on its boundary a contact is closed if it is closing; a friction slips one way or sticks.

        Parameters
        ----------
        x
            State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
        u
            Inputs (nu,) [N, N m].

        Returns
        -------
        Modes
            Of contacts (nc,) and frictions (nf,).

        Raises
        ------
        LinAlgError
            Where the mass matrix is singular.
        """
        closed = self.closed(x, u)
        pushes = self.pushes(x, u, closed)
        slip = self.at(x)["slip"]
        limit = self.limit(x, pushes)
        decided = np.abs(slip) > self._slip_band
        ways = [
            [0, 1, -1] if pressed else [1, -1] for pressed in limit > 0
        ]  # what nothing presses does not stick
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
            )  # less than what ends sticking: whoever has just left does not stick
            if np.all(decided | np.where(modes.slips == 0, holds, modes.slips * change >= 0)):
                return modes
        return Modes(closed, pushes, np.where(decided, np.where(slip >= 0, 1, -1), 0))

    def closed(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Which contacts are closed: by penetration.

        On its boundary by the direction of motion, or of the acceleration of a body at rest there.

        Parameters
        ----------
        x
            State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
        u
            Inputs (nu,) [N, N m].

        Returns
        -------
        np.ndarray
            (nc,) bool.

        Raises
        ------
        LinAlgError
            Where the mass matrix is singular.
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
        """Closed contacts whose force would not pull; where it is nothing, those whose force grows.

        Parameters
        ----------
        x
            State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
        u
            Inputs (nu,) [N, N m].
        closed
            Which contacts are closed (nc,).

        Returns
        -------
        np.ndarray
            (nc,) bool.

        Raises
        ------
        LinAlgError
            Where the mass matrix is singular.
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
        """The largest friction forces, mu N.

        Parameters
        ----------
        x
            State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
        pushes
            Which contacts push (nc,).

        Returns
        -------
        np.ndarray
            Limits (nf,) [N].

        Raises
        ------
        ValueError
            For a state of another length.
        """
        return self._limit(x[: self.n], self.contact_force(x, pushes))

    def contact_force(self, x: np.ndarray, pushes: np.ndarray) -> np.ndarray:
        """Contact forces: k phi, with damping more or less, in contacts that push and nothing in others.

        Parameters
        ----------
        x
            State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
        pushes
            Which contacts push (nc,).

        Returns
        -------
        np.ndarray
            lam (nc,) [N].

        Raises
        ------
        ValueError
            For a state of another length.
        """
        push, damped = self.stiffness * self.at(x)["phi"], list(self.scene.damped)
        push[damped] = self.at(x)["push"][damped]
        return np.where(pushes, push, 0.0)

    def motion(self, x: np.ndarray, u: np.ndarray, modes: Modes) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations and friction forces: M a - S' f = forces, and S a = -dS/dt v where it sticks.

        Parameters
        ----------
        x
            State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
        u
            Inputs (nu,) [N, N m].
        modes
            Which contacts are closed and push, and which way frictions slip.

        Returns
        -------
        a
            Accelerations (nq,) [m/s^2, rad/s^2].
        f
            Friction forces (nf,) [N].

        Raises
        ------
        LinAlgError
            Where the mass matrix is singular.
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
        # Frictions that hold one motion share their force: the system is singular, but consistent.
        solution = np.linalg.lstsq(system, right)[0]
        friction[sticks] = solution[n:]
        return solution[:n], friction

    def rate(self, x: np.ndarray, u: np.ndarray, modes: Modes) -> np.ndarray:
        """The derivative dx/dt of the state in the given modes.

        Parameters
        ----------
        x
            State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
        u
            Inputs (nu,) [N, N m].
        modes
            Which contacts are closed and push, and which way frictions slip.

        Returns
        -------
        np.ndarray
            Velocities, then accelerations (2*nq,) [m/s, rad/s, m/s^2, rad/s^2].
        """
        return np.concatenate([x[self.n :], self.motion(x, u, modes)[0]])

    def reserve(self, x: np.ndarray, u: np.ndarray, modes: Modes, index: int) -> float:
        """What is left until a friction leaves its mode.

        Parameters
        ----------
        x
            State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
        u
            Inputs (nu,) [N, N m].
        modes
            Which contacts are closed and push, and which way frictions slip.
        index
            Its place among the frictions.

        Returns
        -------
        float
            Slip [m/s] where it slips, force [N] where it sticks.

        Raises
        ------
        LinAlgError
            Where the mass matrix is singular.
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
    """A function of vectors for inner loops: of Python's floats, which are three times as fast as numpy's; what has no value is NaN in all entries."""
    expressions = [sp.sympify(entry).subs(d.scene.parameter_values) for entry in entries]
    compiled = sp.lambdify([list(group) for group in groups], expressions, modules="math", cse=True)

    def call(*values: np.ndarray) -> np.ndarray:
        try:
            return np.array(compiled(*(value.tolist() for value in values)), dtype=float)
        except (ArithmeticError, ValueError):
            return np.full(len(expressions), np.nan)

    return call


def pressing_shares(d: Dynamics) -> sp.Matrix:
    """Of each damped contact what its push is a share of k times the nominal penetration.

    Hunt-Crossley: of its spring's push.
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
    """Return the states of the true motion from the task's start.

    Parameters
    ----------
    pieces
        Inputs that are constant piece by piece.
    times
        When (n,) [s].

    Returns
    -------
    np.ndarray
        (n, 2*nq), positions [m, rad], then velocities [m/s, rad/s].

    Raises
    ------
    MotionError
        If neither method can follow it within the budget.
    """
    # Without inertia velocities settle within the lag, which explicit steps would have to follow
    # all the way.
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
    scene, left = equations.scene, BUDGET
    method, tolerance = integrator
    x, t = np.array(scene.task.start, dtype=float), 0.0
    nominal = np.tile([coordinate.nominal for coordinate in scene.coordinates], 2)
    result = np.full((len(times), x.size), np.nan)
    result[times <= t] = x

    from scipy.integrate import (
        solve_ivp,
    )  # 0.3 CPU s to import, which a replay of a plan would pay for nothing

    def rate(at: float, y: np.ndarray, u: np.ndarray, modes: Modes) -> np.ndarray:
        """The derivative (2*nq,) [m/s, rad/s, m/s^2, rad/s^2].

        Raises MotionError beyond the budget.
        """
        nonlocal left
        left -= 1
        if left < 0:
            raise MotionError(
                f"scene {scene.name}: its motion takes more than {BUDGET} evaluations of its equations, of which {method} came to t = {at:.6g} s."
            )
        return equations.rate(y, u, modes)

    for piece in pieces:
        for _ in range(_MOST_SWITCHES):
            if t >= piece.end:
                break
            modes = equations.modes(x, piece.u)
            found = solve_ivp(
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
            if not found.success or not np.isfinite(found.y[:, -1]).all():
                raise MotionError(
                    f"scene {scene.name}: its motion cannot be followed beyond t = {found.t[-1]:.6g} s ({found.message})."
                )
            inside = (times > t) & (times <= found.t[-1])
            if inside.any():
                result[inside] = found.sol(times[inside]).T
            x, t = found.y[:, -1], float(found.t[-1])
    return result


def _leaving(
    equations: Equations, modes: Modes, u: np.ndarray
) -> list[Callable[[float, np.ndarray], float]]:
    """Event functions that fall through zero where a contact or a friction leaves its mode."""

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
        event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined] - how scipy is told
    return events
