"""The equations of motion of a scene, lambdified from the energies in its file: no kernel, no FMU, no `models.dynamics`.

    M dv/dt = Q - dV/dq + dT/dq - (dM/dt) v + J' lam + S' f        lam = k max(phi, 0),  |f| <= mu N

Plain numbers in lists: evaluated some hundred thousand times for a plan. Undamped contacts only.
"""

from __future__ import annotations

import numpy as np
import sympy as sp

from models.scene import Scene

# A friction sticks, slips one way (+1) or the other (-1); FREE: nothing presses it.
STICK = 0
FREE = None


class Equations:
    """The equations of one scene."""

    def __init__(self, scene: Scene) -> None:
        """Raises ValueError for a scene with damped contacts or without mass."""
        if scene.damped:
            raise ValueError(
                f"{scene.name}: its contacts are damped, which this integration does not know."
            )
        self.scene, self.nq, self.nc, self.nf = scene, scene.nq, scene.nc, scene.nf
        q = [item.symbol for item in scene.coordinates]
        v = [item.velocity for item in scene.coordinates]
        u = [item.symbol for item in scene.inputs]
        lam = list(sp.symbols(f"_lam0:{self.nc}")) if self.nc else []
        f = list(sp.symbols(f"_f0:{self.nf}")) if self.nf else []
        values = scene.parameter_values
        self.k = [float(sp.sympify(item.stiffness).subs(values)) for item in scene.contacts]

        # Lagrange: d/dt dT/dv - dT/dq + dV/dq = Q + J' lam + S' f, and d/dt dT/dv = M dv/dt +
        # (d2T/dv dq) v.
        T, V = (
            sp.sympify(scene.kinetic_energy).subs(values),
            sp.sympify(scene.potential_energy).subs(values),
        )
        momentum = sp.Matrix([T.diff(speed) for speed in v])
        M = momentum.jacobian(v)
        rest = sp.Matrix(
            [
                sp.sympify(force).subs(values) + (T - V).diff(place) - _rate(momentum[i], q, v)
                for i, (force, place) in enumerate(zip(scene.forces, q, strict=True))
            ]
        )
        phi = sp.Matrix(
            self.nc, 1, [sp.sympify(item.penetration).subs(values) for item in scene.contacts]
        )
        slip = sp.Matrix(
            self.nf, 1, [sp.sympify(item.slip).subs(values) for item in scene.frictions]
        )
        slip_by_v = slip.jacobian(v) if self.nf else sp.zeros(0, self.nq)
        force = rest
        if self.nc:
            force = force - phi.jacobian(q).T * sp.Matrix(lam)
        if self.nf:
            force = force + slip_by_v.T * sp.Matrix(f)
        pressed_by = {item.name: symbol for item, symbol in zip(scene.contacts, lam, strict=True)}
        limit = [
            sp.sympify(item.coefficient).subs(values)
            * (
                pressed_by[item.contact]
                if item.contact is not None
                else sp.sympify(item.normal_force).subs(values)
            )
            for item in scene.frictions
        ]
        self.phi = sp.lambdify([q], list(phi), modules="math", cse=True)
        self.slip = sp.lambdify([q, v], list(slip), modules="math", cse=True)
        self.limit = sp.lambdify([q, lam], limit, modules="math", cse=True)
        self._mass = None
        if M.free_symbols & set(q):
            self._mass = sp.lambdify([q], M.tolist(), modules="math", cse=True)
            self._force = sp.lambdify([q, v, u, lam, f], list(force), modules="math", cse=True)
        else:
            if M.rank() < self.nq:
                raise ValueError(
                    f"{scene.name}: a coordinate has no mass, which this integration does not know."
                )
            self._force = sp.lambdify(
                [q, v, u, lam, f], list(M.LUsolve(force)), modules="math", cse=True
            )
        # The rate of a slip: S dv/dt + (dS/dt) v.
        drift = sp.Matrix([_rate(item, q, v) for item in slip]) if self.nf else sp.zeros(0, 1)
        self._slip_by_v = sp.lambdify([q], slip_by_v.tolist(), modules="math", cse=True)
        self._slip_drift = sp.lambdify([q, v], list(drift), modules="math", cse=True)

    def acceleration(
        self, q: list[float], v: list[float], u: list[float], lam: list[float], f: list[float]
    ) -> list[float]:
        right = self._force(q, v, u, lam, f)
        return (
            right
            if self._mass is None
            else np.linalg.solve(np.array(self._mass(q)), np.array(right)).tolist()
        )

    def rates(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(2 nq,) rate of a state by the contact law as it stands, kink and all: what a simulator of a fixed step evaluates. Without friction."""
        values = state.tolist()
        q, v = values[: self.nq], values[self.nq :]
        lam = [k * max(depth, 0.0) for k, depth in zip(self.k, self.phi(q), strict=True)]
        return np.array([*v, *self.acceleration(q, v, np.asarray(u).tolist(), lam, [])])

    def forces(self, q: np.ndarray) -> np.ndarray:
        """(n, nc) contact forces at positions (n, nq)."""
        found = [
            [k * max(depth, 0.0) for k, depth in zip(self.k, self.phi(row), strict=True)]
            for row in np.asarray(q).tolist()
        ]
        return np.array(found).reshape(len(q), self.nc)

    def contact_forces(self, q: list[float], closed: list[bool]) -> list[float]:
        return [
            k * depth if shut else 0.0
            for k, depth, shut in zip(self.k, self.phi(q), closed, strict=True)
        ]

    def friction_forces(
        self, q: list[float], v: list[float], u: list[float], lam: list[float], modes: list
    ) -> list[float]:
        """Those that slip by the law, those that stick so that no slip has a rate."""
        if not self.nf:
            return []
        limit = self.limit(q, lam)
        f = [-mode * most if mode else 0.0 for mode, most in zip(modes, limit, strict=True)]
        stuck = [j for j, mode in enumerate(modes) if mode is STICK]
        if not stuck:
            return f

        def rates(forces: list[float]) -> np.ndarray:
            a = np.array(self.acceleration(q, v, u, lam, forces))
            return (np.array(self._slip_by_v(q)) @ a + np.array(self._slip_drift(q, v)))[stuck]

        here = rates(f)
        effect = np.empty((len(stuck), len(stuck)))
        for column, j in enumerate(stuck):
            effect[:, column] = (
                rates([value + (1.0 if i == j else 0.0) for i, value in enumerate(f)]) - here
            )
        for j, value in zip(stuck, np.linalg.solve(effect, -here), strict=True):
            f[j] = float(value)
        return f

    def settled(
        self,
        q: list[float],
        v: list[float],
        u: list[float],
        lam: list[float],
        modes: list,
        asked: list[int],
    ) -> list:
        """The modes of the frictions `asked`, whose slip is 0: stick if the force for it is there, else slip to where the rest drives."""
        modes = list(modes)
        for j in asked:
            if self.limit(q, lam)[j] <= 0.0:
                modes[j] = FREE
                continue
            modes[j] = STICK
            force = self.friction_forces(q, v, u, lam, modes)[j]
            if abs(force) > self.limit(q, lam)[j]:
                modes[j] = -1 if force > 0.0 else 1
        return modes


def _rate(expression: sp.Expr, q: list[sp.Symbol], v: list[sp.Symbol]) -> sp.Expr:
    """(d/dq) v of an expression: its rate but for accelerations."""
    return sum(
        (expression.diff(place) * speed for place, speed in zip(q, v, strict=True)), sp.S.Zero
    )
