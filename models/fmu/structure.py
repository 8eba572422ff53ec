"""Compute the model structure of an FMU, the dependencies of its variables, from the equations.

dependencies(scene)["lam_left"]  # {"q1": FIXED, "q2": ...}
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from enum import StrEnum

import sympy as sp

from models.codegen.text_cache import cached_text
from models.dynamics import Dynamics, derive
from models.fmu.variables import Variable, VariableKind, variable_table
from models.scene import Scene

# Golden ratio minus 1.
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
# Relative difference far above the rounding of cancelling terms.
_CLEARLY = 1e-6


class Dependency(StrEnum):
    """FMI's kinds of dependencies."""

    DEPENDENT = "dependent"
    FIXED = "fixed"  # the factor is a parameter
    CONSTANT = "constant"  # the factor is a number


def dependencies(scene: Scene) -> dict[str, dict[str, Dependency]]:
    """Return the knowns of each calculated variable and state, cached, in table order.

    Differentiating the energies of a large scene takes seconds.
    """
    structure = json.loads(
        cached_text(scene, "structure.json", lambda: json.dumps(derived_dependencies(scene)))
    )
    return {
        name: {known: Dependency(kind) for known, kind in knowns.items()}
        for name, knowns in structure.items()
    }


def derived_dependencies(scene: Scene) -> dict[str, dict[str, Dependency]]:
    """Return the knowns of each calculated variable and state."""
    dynamics, table = derive(scene), variable_table(scene)
    names = {symbol: symbol.name for symbol in (*dynamics.q, *dynamics.v, *dynamics.u, *dynamics.p)}
    order = {variable.name: position for position, variable in enumerate(table)}
    result = {}
    for variable in table:
        knowns = _knowns(dynamics, variable)
        if knowns is not None:
            named = {names[symbol]: kind for symbol, kind in knowns.items()}
            result[variable.name] = dict(sorted(named.items(), key=lambda item: order[item[0]]))
    return result


def _knowns(d: Dynamics, variable: Variable) -> dict[sp.Symbol, Dependency] | None:
    index = variable.index
    match variable.kind:
        case VariableKind.POSITION:
            return _of_expression(d, d.q[index])
        case VariableKind.VELOCITY | VariableKind.POSITION_RATE:
            return _of_expression(d, d.v[index])
        case VariableKind.VELOCITY_RATE:
            return _of_acceleration(d, index)
        case VariableKind.FORCE:
            return _of_contact(d, index) if index < len(d.lam) else _of_everything(d)
        case VariableKind.SLIP:
            return _of_expression(d, d.slip[index])
        case VariableKind.RESERVE:
            return _of_everything(d)
        case VariableKind.PRESSING:
            return _of_contact(d, d.scene.damped[index - d.scene.nl])
        case VariableKind.GAP:
            return _of_expression(d, d.penetration[index])
        case VariableKind.KINETIC_ENERGY | VariableKind.POTENTIAL_ENERGY | VariableKind.INPUT_POWER:
            return _of_expression(d, getattr(d, variable.name))
        case VariableKind.CONTACT_ENERGY:
            return _merge(_of_spring(d, contact) for contact in range(len(d.lam)))
        case VariableKind.DISSIPATED_POWER if d.f:
            return _of_everything(d)
        case VariableKind.DISSIPATED_POWER:
            return _merge(
                [
                    _of_expression(d, d.dissipated_power),
                    *(_of_contact(d, contact) for contact in d.scene.damped),
                ]
            )
        case _:
            return None


def _of_expression(d: Dynamics, expression: sp.Expr) -> dict[sp.Symbol, Dependency]:
    parameters = set(d.p)
    kinds: dict[sp.Symbol, Dependency] = {}
    slopes = {symbol: sp.diff(expression, symbol) for symbol in _all_dependent(d, [expression])}
    varying = _seen_to_vary(slopes, parameters)
    for symbol, slope in slopes.items():
        if symbol in varying:
            kinds[symbol] = Dependency.DEPENDENT
            continue
        remaining = sp.expand(slope).free_symbols  # cancelled terms are no dependence
        kinds[symbol] = (
            Dependency.DEPENDENT
            if remaining - parameters
            else Dependency.FIXED
            if remaining
            else Dependency.CONSTANT
        )
    return kinds


def _seen_to_vary(
    slopes: Mapping[sp.Symbol, sp.Expr], parameters: set[sp.Symbol]
) -> set[sp.Symbol]:
    """Return symbols whose slope differs clearly at two points with equal parameters.

    This proves dependence without expansion, which takes minutes for the energies of several
    bodies. Other symbols may still be dependences.
    """
    symbols = sorted(set().union(*(slope.free_symbols for slope in slopes.values())), key=str)
    points = []
    for place in range(2):
        # Multiples of the golden ratio are distinct, and special for no angle or length.
        points.append(
            [
                0.3 + (_GOLDEN * (k + 1 + (0 if symbol in parameters else 100 * place))) % 1.0
                for k, symbol in enumerate(symbols)
            ]
        )
    try:
        values = sp.lambdify(symbols, list(slopes.values()), modules="math", cse=True)
        first, second = (values(*point) for point in points)
    except (
        ArithmeticError,
        ValueError,
        TypeError,
        NameError,
        SyntaxError,
    ):  # a function that Python lacks, or a point outside its domain
        return set()
    return {
        symbol
        for symbol, a, b in zip(slopes, first, second, strict=True)
        if _is_real(a) and _is_real(b) and abs(a - b) > _CLEARLY * (1.0 + abs(a) + abs(b))
    }


def _is_real(value: object) -> bool:
    """Return whether this is a finite number; powers of negative numbers are complex."""
    return isinstance(value, (int, float)) and math.isfinite(value)


def _symbols(entries: Iterable[sp.Expr]) -> set[sp.Basic]:
    return set().union(*(sp.sympify(entry).free_symbols for entry in entries))


def _all_dependent(d: Dynamics, entries: Iterable[sp.Expr]) -> dict[sp.Symbol, Dependency]:
    return dict.fromkeys(_symbols(entries) & {*d.q, *d.v, *d.u, *d.p}, Dependency.DEPENDENT)


def _of_contact(d: Dynamics, contact: int) -> dict[sp.Symbol, Dependency]:
    if not d.scene.contacts[contact].is_damped:
        return _of_spring(d, contact)
    return _all_dependent(d, [d.push[contact]])


def _of_spring(d: Dynamics, contact: int) -> dict[sp.Symbol, Dependency]:
    return _all_dependent(d, [d.penetration[contact], d.stiffness[contact]])


def _of_everything(d: Dynamics) -> dict[sp.Symbol, Dependency]:
    """Return the dependences of a friction force: while sticking, of all accelerations."""
    return _all_dependent(
        d,
        [*d.generalised_force, *d.mass_matrix, *d.slip, *d.friction_limit, *d.penetration, *d.push],
    )


def _merge(parts: Iterable[dict[sp.Symbol, Dependency]]) -> dict[sp.Symbol, Dependency]:
    merged: dict[sp.Symbol, Dependency] = {}
    for part in parts:
        for symbol, kind in part.items():
            merged[symbol] = Dependency.DEPENDENT if symbol in merged else kind
    return merged


def _of_acceleration(d: Dynamics, index: int) -> dict[sp.Symbol, Dependency]:
    """Return the dependences of row `index` of M^-1 (tau + J' lam), exact for a constant M."""
    if d.f:
        return _of_everything(d)
    if d.acceleration is not None:
        entries = [d.acceleration[index]]
        own = _of_expression(d, *entries)
    else:
        rows = next(
            sorted(block) for block in d.mass_matrix.connected_components() if index in block
        )
        entries = [d.generalised_force[i] for i in rows] + [
            d.mass_matrix[i, j] for i in rows for j in rows
        ]
        own = _all_dependent(d, entries)
    touched = _symbols(entries)
    return _merge(
        [own, *(_of_contact(d, contact) for contact, force in enumerate(d.lam) if force in touched)]
    )
