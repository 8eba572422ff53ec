"""The argument vectors of the generated C, and a scene's equations written in their entries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp

from models.codegen.c_function import Vector
from models.dynamics import Dynamics


@dataclass(frozen=True)
class SceneVectors:
    """The argument vectors of one scene, and its equations written in their entries.

    lam holds all contact forces, then all friction forces: both act linearly, so the accelerations treat them alike.
    """

    dynamics: Dynamics
    q: Vector
    v: Vector
    u: Vector
    lam: Vector
    p: Vector

    @classmethod
    def of(cls, d: Dynamics) -> SceneVectors:
        def vector(name: str, symbols: Sequence[sp.Symbol]) -> Vector:
            return Vector.of(name, [symbol.name for symbol in symbols])

        lam = Vector.of("lam", [contact.name for contact in d.scene.contacts] + [friction.force_name for friction in d.scene.frictions])
        return cls(d, q=vector("q", d.q), v=vector("v", d.v), u=vector("u", d.u), lam=lam, p=vector("p", d.p))

    @property
    def arguments(self) -> tuple[Vector, ...]:
        """(q, v, u, lam, p): what an acceleration depends on."""
        return (self.q, self.v, self.u, self.lam, self.p)

    @property
    def contacts(self) -> tuple[str, ...]:
        """The names of the contacts, in the order of the penetrations."""
        return tuple(contact.name for contact in self.dynamics.scene.contacts)

    def local(self, expression: sp.Expr | sp.Matrix) -> sp.Matrix:
        """An expression or matrix of the scene, in the entries of these vectors."""
        d = self.dynamics
        pairs = zip((*d.q, *d.v, *d.u, *d.lam, *d.f, *d.p), (s for vector in self.arguments for s in vector.symbols), strict=True)
        matrix = expression if isinstance(expression, sp.MatrixBase) else sp.Matrix([[expression]])
        mapping = dict(pairs)
        return matrix.applyfunc(lambda entry: sp.sympify(entry).xreplace(mapping))
