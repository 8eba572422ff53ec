"""Derive the equations of motion of a scene by computer algebra (Lagrange).

    M(q) dv/dt = tau(q, v, u) + J(q)' lam + S(q)' f
    lam_i = k_i * max(phi_i(q), 0) (damped: models.scene.contacts),   |f_j| <= mu_j N_j
    M = d2T/dv2,   tau = Q - dV/dq + dT/dq - (d2T/dv dq) v,   J = -d phi/dq   (Jacobian of the gap)
    S = d s/dv (s: slip speed of a friction, linear in v),    N_j: a contact's force, or given

T and V are the kinetic and potential energy, Q the generalised forces. All back ends use `derive`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
import sympy as sp

from models.scene import Scene
from models.scene.checks import check_expressions
from models.scene.contacts import Contact, DampingLaw

_DERIVED: WeakKeyDictionary[Scene, Dynamics] = WeakKeyDictionary()


@dataclass(frozen=True)
class Structure:
    """The features of a scene; absent ones are omitted from generated models."""

    constant_mass: bool
    diagonal_mass: bool
    linear: bool  # tau is affine in (q, v, u), every penetration in q, every slip in (q, v)
    conservative_forces: bool  # a potential energy depends on q
    dissipation: bool  # forces remain when the inputs are zero
    inputs: bool
    contacts: bool
    friction: bool
    contact_damping: bool  # damped contacts exist


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Symbolic equations of one scene, as SymPy column matrices.

    q, v: nq symbols; u: nu; lam: nc contact forces [N]; f: nf friction forces [N]; p: np parameters
    mass_matrix: (nq, nq); tau: (nq, 1); penetration, stiffness: (nc, 1); gap_jacobian: (nc, nq)
    damping: (nc, 1) coefficients, or 0
    push: (nc, 1) [N], whose positive part is the force
    slip [m/s], friction_limit (mu N [N]): (nf, 1); slip_jacobian: (nf, nq)
    kinetic_energy, potential_energy [J]; input_power, dissipated_power [W], without contacts
    """

    scene: Scene
    q: tuple[sp.Symbol, ...]
    v: tuple[sp.Symbol, ...]
    u: tuple[sp.Symbol, ...]
    lam: tuple[sp.Symbol, ...]
    f: tuple[sp.Symbol, ...]
    p: tuple[sp.Symbol, ...]
    mass_matrix: sp.Matrix
    tau: sp.Matrix
    penetration: sp.Matrix
    stiffness: sp.Matrix
    damping: sp.Matrix
    push: sp.Matrix
    gap_jacobian: sp.Matrix
    slip: sp.Matrix
    friction_limit: sp.Matrix
    slip_jacobian: sp.Matrix
    kinetic_energy: sp.Expr
    potential_energy: sp.Expr
    input_power: sp.Expr
    dissipated_power: sp.Expr
    running_cost: sp.Expr
    final_cost: sp.Expr
    structure: Structure

    @property
    def absent(self) -> tuple[str, ...]:
        """Return the features that this scene does not need, as text."""
        has = self.structure
        words = {
            "a mass matrix that depends on q": has.constant_mass,
            "inertial coupling": has.diagonal_mass,
            "nonlinear forces or gaps": has.linear,
            "a potential": not has.conservative_forces,
            "damping": not (has.dissipation or has.contact_damping),
            "inputs": not has.inputs,
            "contacts": not has.contacts,
            "friction": not has.friction,
        }
        return tuple(word for word, is_absent in words.items() if is_absent)

    @cached_property
    def generalised_force(self) -> sp.Matrix:
        """Return tau(q, v, u) + J(q)' lam + S(q)' f: (nq, 1)."""
        contact = self.gap_jacobian.T * sp.Matrix(len(self.lam), 1, list(self.lam))
        return self.tau + contact + self.slip_jacobian.T * sp.Matrix(len(self.f), 1, list(self.f))

    @cached_property
    def acceleration(self) -> sp.Matrix | None:
        """Return M^-1 (tau + J' lam + S' f) in closed form, (nq, 1), or None if M depends on q."""
        if not self.structure.constant_mass:
            return None
        solved = self.mass_matrix.LUsolve(self.generalised_force)
        return solved.applyfunc(
            lambda entry: (
                sp.expand_mul(sp.cancel(entry)) if not self.structure.diagonal_mass else entry
            )
        )

    @cached_property
    def parameter_values(self) -> np.ndarray:
        """Return the default parameter values (np,), in the order of `p` [SI]. Raises nothing."""
        return np.array([parameter.value for parameter in self.scene.parameters], dtype=float)

    def function(
        self, expressions: sp.Matrix | Sequence[sp.Expr], *groups: Sequence[sp.Symbol]
    ) -> Callable[..., np.ndarray]:
        """Return a numpy function: `f = d.function(d.tau, d.q, d.v, d.u); f(q, v, u)`.

        It maps arrays (len(group),) to an array shaped like the matrix [SI], with default
        parameters; for tests, not for inner loops. A call raises NameError for a symbol that is in
        no group.
        """
        matrix = sp.Matrix(expressions).subs(self.scene.parameter_values)
        compiled = sp.lambdify([list(group) for group in groups], matrix, modules=[np], cse=True)
        shape = matrix.shape
        return lambda *values: np.asarray(
            compiled(*(np.asarray(value, dtype=float) for value in values)), dtype=float
        ).reshape(shape)


def derive(scene: Scene) -> Dynamics:
    """Return the equations of motion of a scene, cached with the scene object.

    Raises SceneError for impossible physics.
    """
    cached = _DERIVED.get(scene)
    if cached is None:
        check_expressions(scene)
        cached = _DERIVED[scene] = _build(scene)
    return cached


def _build(scene: Scene) -> Dynamics:
    q = tuple(coordinate.symbol for coordinate in scene.coordinates)
    v = tuple(coordinate.velocity for coordinate in scene.coordinates)
    u = tuple(item.symbol for item in scene.inputs)
    lam = tuple(sp.Symbol(contact.force_name, real=True) for contact in scene.contacts)
    f = tuple(sp.Symbol(friction.force_name, real=True) for friction in scene.frictions)
    p = tuple(parameter.symbol for parameter in scene.parameters)
    kinetic, potential, forces = (
        scene.kinetic_energy,
        scene.potential_energy,
        sp.Matrix(scene.nq, 1, scene.forces),
    )

    mass = sp.hessian(kinetic, v)
    momentum = sp.Matrix([sp.diff(kinetic, velocity) for velocity in v])
    coriolis = momentum.jacobian(q) * sp.Matrix(v) - sp.Matrix(
        [sp.diff(kinetic, position) for position in q]
    )
    gravity = sp.Matrix([sp.diff(potential, position) for position in q])
    # Derivatives leave common factors behind.
    tau = (forces - gravity - coriolis).applyfunc(sp.factor_terms)

    phi = sp.Matrix(scene.nc, 1, [contact.penetration for contact in scene.contacts])
    stiffness = sp.Matrix(scene.nc, 1, [contact.stiffness for contact in scene.contacts])
    jacobian = -phi.jacobian(q) if scene.nc else sp.zeros(0, scene.nq)
    damping = sp.Matrix(scene.nc, 1, [contact.damping for contact in scene.contacts])
    push = sp.Matrix(
        scene.nc,
        1,
        [
            _push(contact, -(jacobian[i, :] * sp.Matrix(v))[0])
            for i, contact in enumerate(scene.contacts)
        ],
    )

    pressing = {contact.name: force for contact, force in zip(scene.contacts, lam, strict=True)}
    slip = sp.Matrix(scene.nf, 1, [friction.slip for friction in scene.frictions])
    limit = [
        item.coefficient
        * sp.Add(
            *(pressing[name] for name in item.pressing),
            0 if item.normal_force is None else item.normal_force,
        )
        for item in scene.frictions
    ]

    passive = forces.subs(dict.fromkeys(u, 0))
    velocity, variables = sp.Matrix(v), {*q, *v, *u}

    def affine(matrix: sp.Matrix) -> bool:
        return all(
            not sp.diff(entry, variable).free_symbols & variables
            for entry in matrix
            for variable in entry.free_symbols & variables
        )

    constant_mass = not mass.free_symbols & variables
    structure = Structure(
        constant_mass=constant_mass,
        diagonal_mass=mass.is_diagonal(),
        linear=constant_mass and affine(tau) and affine(phi) and affine(slip),
        conservative_forces=any(entry != 0 for entry in gravity),
        dissipation=any(entry != 0 for entry in passive),
        inputs=bool(u),
        contacts=scene.nc > 0,
        friction=scene.nf > 0,
        contact_damping=bool(scene.damped),
    )
    return Dynamics(
        scene=scene, q=q, v=v, u=u, lam=lam, f=f, p=p, mass_matrix=mass, tau=tau, penetration=phi,
        stiffness=stiffness, damping=damping, push=push,
        gap_jacobian=jacobian, slip=slip, friction_limit=sp.Matrix(scene.nf, 1, limit),
        slip_jacobian=slip.jacobian(v) if scene.nf else sp.zeros(0, scene.nq),
        kinetic_energy=kinetic, potential_energy=potential,
        input_power=sp.expand((velocity.T * (forces - passive))[0]),
        dissipated_power=sp.expand(-(velocity.T * passive)[0]),
        running_cost=scene.task.running_cost, final_cost=scene.task.final_cost, structure=structure,
    )  # fmt: skip


def _push(contact: Contact, rate: sp.Expr) -> sp.Expr:
    spring = contact.stiffness * contact.penetration
    return (
        spring + contact.damping * rate
        if contact.damping_law is DampingLaw.KELVIN_VOIGT
        else spring * (1 + contact.damping * rate)
    )
