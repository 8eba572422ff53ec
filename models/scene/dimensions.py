"""Check that the units of a scene fit together.

    # "kinetic_energy: m*v**2/2 is in kg m^3/s^4, but an energy must be in J; is the unit of
    # parameter m ('N') right? 'kg' would be."
    dimension_problem(scene)

Energies are in J, forces in J per unit of their coordinate, penetrations in m. Parameters, inputs
and coordinates declare units. Numbers have none, and often hide one, as in "a mass of 1 kg". Scenes
that leave units out are accepted:

- A number that is added has the unit of the other terms (q - 2). But 1 beside variables may be pure
  (1 - q). A number alone has any unit.
- A number that multiplies is pure if formulas have it (1/2, 1/12, 2/5). Any other may be a measured
  number (9.81) and hides its unit.
- A term without parameter and input (v**2/2, 4*q) may be multiplied by 1 kg, 1 N/m, .. Its own sums
  must agree only if a parameter multiplies it. In penetrations and slips only a number beside it
  may hide a unit (0.2*omega), and omega alone is no slip.
- Functions that SymPy does not define hide their units.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import sympy as sp

from models.scene import Scene
from models.scene.functions import FUNCTIONS, is_longer, shortened
from models.scene.scene import NamedExpression, depth_expressions, named_expressions
from models.scene.values import base_exponents

# Exponents of kg, m and s; a radian is a pure number here.
_Powers = tuple[Fraction, ...]
_BASES = ("kg", "m", "s")
_PURE: _Powers = (Fraction(0),) * len(_BASES)

# Functions of pure numbers with pure values.
_ELEMENTARY = tuple(function for function in FUNCTIONS if function is not sp.atan2)
# Functions whose value has the unit of their arguments.
_CHOOSING = (sp.Abs, sp.Max, sp.Min, sp.floor, sp.ceiling, sp.Mod)
# Denominators of the numbers in formulas: moments of inertia, means, squares of halves. Their
# numerators have one digit.
_DENOMINATORS = (1, 2, 3, 4, 5, 6, 8, 12, 16, 24, 32, 48)
# Names of the most frequent units; also tried as replacements of a wrong unit.
_NAMED = (
    *("1", "kg", "m", "s", "N", "N m", "N/m", "N s/m", "N m s", "kg m^2"),
    *("m/s", "m/s^2", "1/m", "1/s", "s/m", "m^2", "1/m^2", "N s^2/m^2"),
)
# If more units than this would fit, none of them is suggested.
_MOST_MENDS = 3
# Larger expressions have no suggested unit: each try takes as long as the check itself.
_MOST_PARTS = 3000

_NUMBER, _BARE, _DECLARED = range(3)


@dataclass(frozen=True)
class _Mixed:
    """A sum of variables with different units: a factor 1 is missing, as the arm in v + omega."""

    words: str


class _Found(NamedTuple):
    """The unit of an expression.

    - kind: whether a parameter or input takes part, or at least a variable
    - powers: None if something hides its unit
    """

    kind: int
    powers: _Powers | _Mixed | None


class _MismatchError(Exception):
    """Units that do not fit; the text is a clause."""


def dimension_problem(scene: Scene) -> str | None:
    """Return a sentence on the first expression with a wrong unit, and a fitting unit, or None."""
    asked = named_expressions(scene) + depth_expressions(scene)
    declared = [
        *(("parameter", item) for item in scene.parameters),
        *(("input", item) for item in scene.inputs),
    ]
    units = {item.symbol: _Found(_DECLARED, _powers(item.unit)) for _, item in declared}
    for coordinate in scene.coordinates:
        units[coordinate.symbol] = _Found(_BARE, _powers(coordinate.unit))
        units[coordinate.velocity] = _Found(_BARE, _powers(coordinate.velocity_unit))
    misfit = next(_misfits(asked, units), None)
    if misfit is None:
        return None
    quantity, words = misfit
    mends, used = (
        [],
        set() if is_longer(quantity.expression, _MOST_PARTS) else quantity.expression.free_symbols,
    )
    for kind, item in declared:
        if item.symbol in used:
            for unit in _NAMED:
                others = units | {item.symbol: _Found(_DECLARED, _powers(unit))}
                if not any(_misfits([quantity], others)) and not any(_misfits(asked, others)):
                    mends.append(f"of {kind} {item.name} ({item.unit!r}) right? {unit!r} would be")
    if 0 < len(mends) <= _MOST_MENDS:
        return f"{quantity.field}: {words}; is the unit {', or is that '.join(mends)}."
    return f"{quantity.field}: {words}; is a unit wrong, or was a quantity left out that is 1 here, as an arm of 1 m? It must be a parameter."


def _misfits(
    asked: Sequence[NamedExpression], units: Mapping[sp.Symbol, _Found]
) -> Iterator[tuple[NamedExpression, str]]:
    reader = _Reader(units)
    for quantity in asked:
        if quantity.unit is None:
            continue
        expected = _powers(quantity.unit)
        try:
            for term in sp.Add.make_args(quantity.expression):
                kind, powers = reader.of(term)
                declared = kind == _DECLARED or (kind == _BARE and _is_length(quantity, term))
                if declared and isinstance(powers, tuple) and powers != expected:
                    yield (
                        quantity,
                        f"{shortened(term)} is in {_text(powers)}, but {quantity.what} must be in {quantity.unit}",
                    )
        except _MismatchError as mismatch:
            yield quantity, str(mismatch)


def _is_length(quantity: NamedExpression, term: sp.Expr) -> bool:
    """Return whether a term of variables alone must have its unit: no number in it may hide one."""
    return (
        quantity.field.endswith((": penetration", ": slip"))
        and not term.atoms(sp.Float)
        and (term.as_coeff_Mul()[0] in (1, -1))
    )


class _Reader:
    """Units of expressions; each shared part is read once."""

    def __init__(self, units: Mapping[sp.Symbol, _Found]) -> None:
        self._known: dict[sp.Basic, _Found] = dict(units)

    def of(self, expression: sp.Basic) -> _Found:
        found = self._known.get(expression)
        if found is None:
            found = self._known[expression] = self._read(expression)
        return found

    def _read(self, expression: sp.Basic) -> _Found:
        if isinstance(expression, (sp.Number, sp.NumberSymbol)):
            return _Found(_NUMBER, _PURE if _is_of_formulas(expression) else None)
        if isinstance(expression, sp.Mul):
            return self._product(expression.args)
        if isinstance(expression, sp.Add):
            return self._sum(expression.args)
        if isinstance(expression, sp.Pow):
            return (
                self._power(*expression.as_base_exp())
                if expression.exp.is_Number
                else self._exponential(expression)
            )
        if isinstance(expression, _CHOOSING):
            return self._sum(expression.args)
        if isinstance(expression, sp.Piecewise):
            return self._sum([value for value, _ in expression.args])
        arguments = [self.of(argument) for argument in expression.args]
        kind = max((argument.kind for argument in arguments), default=_BARE)
        if expression.func in _ELEMENTARY:
            for argument, found in zip(expression.args, arguments, strict=True):
                _must_be_pure(expression.func.__name__, argument, found)
            return _Found(kind, _PURE)
        if isinstance(expression, sp.atan2):
            self._sum(expression.args)
            return _Found(kind, _PURE)
        return _Found(kind, _PURE if isinstance(expression, (sp.sign, sp.Heaviside)) else None)

    def _product(self, factors: Sequence[sp.Basic]) -> _Found:
        found = [self.of(factor) for factor in factors]
        kind = max(each.kind for each in found)
        mixed = next((each.powers for each in found if isinstance(each.powers, _Mixed)), None)
        if mixed is not None and kind == _DECLARED:
            raise _MismatchError(mixed.words)
        known = [each.powers for each in found if isinstance(each.powers, tuple)]
        if len(known) < len(found):
            return _Found(kind, mixed)
        return _Found(kind, tuple(sum(column, Fraction(0)) for column in zip(*known, strict=True)))

    def _sum(self, terms: Sequence[sp.Basic]) -> _Found:
        """Return the unit of the terms that declare theirs, else of the variables.

        Numbers have any unit.
        """
        found = [(term, self.of(term)) for term in terms]
        kind = max(each.kind for _, each in found)
        of_kind = [(term, each.powers) for term, each in found if each.kind == kind]
        mixed = next((powers for _, powers in of_kind if isinstance(powers, _Mixed)), None)
        if mixed is not None:
            return _Found(kind, mixed)
        known = [(term, powers) for term, powers in of_kind if isinstance(powers, tuple)]
        if kind != _NUMBER:
            for term, powers in known[1:]:
                if powers != known[0][1]:
                    words = f"{shortened(known[0][0])} is in {_text(known[0][1])} and {shortened(term)} in {_text(powers)}, but they are added"
                    if kind == _DECLARED:
                        raise _MismatchError(words)
                    return _Found(kind, _Mixed(words))
        hides = kind != _DECLARED and (
            len(known) < len(of_kind) or (kind == _BARE and any(term in (1, -1) for term in terms))
        )
        return _Found(kind, known[0][1] if known and not hides else None)

    def _power(self, base: sp.Expr, exponent: sp.Expr) -> _Found:
        kind, powers = self.of(base)
        if powers is None or isinstance(powers, _Mixed):
            return _Found(kind, powers)
        by = (
            Fraction(float(exponent)).limit_denominator(1000)
            if not exponent.is_Rational
            else Fraction(int(exponent.p), int(exponent.q))
        )
        return _Found(kind, tuple(each * by for each in powers))

    def _exponential(self, expression: sp.Pow) -> _Found:
        """Return the unit of a power whose exponent is no number."""
        base, exponent = self.of(expression.base), self.of(expression.exp)
        _must_be_pure("an exponent", expression.exp, exponent)
        _must_be_pure("what is raised to a power that varies", expression.base, base)
        return _Found(max(base.kind, exponent.kind), _PURE if base.powers == _PURE else None)


def _must_be_pure(what: str, argument: sp.Basic, found: _Found) -> None:
    if found.kind == _DECLARED and isinstance(found.powers, tuple) and found.powers != _PURE:
        verb = "is" if " " in what else "takes"
        raise _MismatchError(
            f"{what} {verb} a pure number, but {shortened(argument)} is in {_text(found.powers)}"
        )


def _is_of_formulas(number: sp.Basic) -> bool:
    if not isinstance(number, (sp.Rational, sp.Float)):
        return True  # pi, E
    value = abs(float(number))
    return any(
        round(value * below) in range(1, 10) and abs(value * below - round(value * below)) < 1e-12
        for below in _DENOMINATORS
    )


def _powers(unit: str) -> _Powers:
    exponents = base_exponents(unit)
    return tuple(Fraction(exponents.get(base, 0)) for base in _BASES)


def _text(powers: _Powers) -> str:
    named = next((unit for unit in _NAMED if _powers(unit) == powers), None)
    if named is not None:
        return named
    above = [
        base if power == 1 else f"{base}^{power}"
        for base, power in zip(_BASES, powers, strict=True)
        if power > 0
    ]
    below = [
        f"/{base}" if power == -1 else f"/{base}^{-power}"
        for base, power in zip(_BASES, powers, strict=True)
        if power < 0
    ]
    return " ".join(above or ["1"]) + "".join(below)
