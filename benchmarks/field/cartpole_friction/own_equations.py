"""The published equations of the cart-pole with friction, in continuous time.

The published momentum step converges to d/dt(M v) + C v + dV/dq = B u + friction. Lagrange's
equations of the energies are M dv/dt + C v + dV/dq = B u + friction. So the published equations are
Lagrange's with a further force, minus dM/dt v.
"""

from dataclasses import replace

import scene
import sympy as sp

PHYSICS = scene.SCENE
q = sp.Matrix([item.symbol for item in PHYSICS.coordinates])
v = sp.Matrix([item.velocity for item in PHYSICS.coordinates])
momentum = sp.Matrix([sp.diff(PHYSICS.kinetic_energy, rate) for rate in v])
FURTHER_FORCE = -(momentum.jacobian(q) * v)

SCENE = replace(
    PHYSICS,
    name="own_equations",
    title="The published equations of the cart-pole with friction",
    source="InteriorPointDDP.jl, experiments/models/cartpole.jl, lines 49, 50 and 54",
    forces=tuple(
        sp.simplify(force + further)
        for force, further in zip(PHYSICS.forces, FURTHER_FORCE, strict=True)
    ),
)
