"""Checks of a scene's values: names, units, numbers, expressions; each error is one sentence.

    as_number("task: step", np.float32(0.01))              ->  0.01
    as_expression("scene small: potential_energy", 0)      ->  sympy.Integer(0)
    base_exponents("N s/m")                                ->  {"kg": 1, "s": -1}

Units are text: `m`, `kg`, `N s/m`, `rad/s^2`. The grammar suffices to find a missing or misspelt
unit and to write FMI base units.
"""

from __future__ import annotations

import math
import re
from dataclasses import MISSING, fields
from functools import wraps
from numbers import Real
from typing import Any, TypeVar

import sympy as sp

from models.errors import SceneError, did_you_mean

_Part = TypeVar("_Part")

# Exponents of (kg, m, s, rad) of every unit of a scene; FMI 2.0's BaseUnit has rad too.
_UNITS: dict[str, dict[str, int]] = {
    "1": {},
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "rad": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Hz": {"s": -1},
}
_FACTOR = re.compile(r"([A-Za-z]+|1)(?:\^(-?\d+))?\Z")


def base_exponents(unit: str) -> dict[str, int]:
    """Return the exponents of the base units, e.g. {"kg": 1, "s": -2} for "N/m".

    Raises ValueError with a sentence for an unknown unit.
    """
    if not isinstance(unit, str) or not unit.strip():
        raise ValueError(
            "the unit is missing; give it as text, for example 'm', 'N s/m' or '1' for a pure number."
        )
    total: dict[str, int] = {}
    for position, part in enumerate(unit.split("/")):
        sign = 1 if position == 0 else -1
        factors = part.split()
        if not factors:
            raise ValueError(
                f"the unit {unit!r} has nothing on one side of '/'; write for example 'N/m'."
            )
        for factor in factors:
            match = _FACTOR.match(factor)
            if match is None or match.group(1) not in _UNITS:
                raise ValueError(
                    f"the unit {unit!r} contains {factor!r}, which is not one of {', '.join(_UNITS)} (with ^n, spaces and /){_other_spelling(unit)}"
                )
            power = sign * int(match.group(2) or 1)
            for base, exponent in _UNITS[match.group(1)].items():
                total[base] = total.get(base, 0) + power * exponent
    return {base: exponent for base, exponent in total.items() if exponent}


# Powers in other spellings, and in ours.
_POWERS = (("**", "^"), ("\u00b2", "^2"), ("\u00b3", "^3"))
# Units that are multiples of ours.
_MULTIPLES = {"deg": "rad", "degree": "rad", "mm": "m", "cm": "m", "km": "m", "g": "kg", "kN": "N"}
_MULTIPLES |= {"mN": "N", "ms": "s", "min": "s", "h": "s", "lb": "kg", "in": "m", "ft": "m"}
_MULTIPLES |= {"kJ": "J", "kW": "W", "kHz": "Hz", "rpm": "rad/s", "rev": "rad", "kgf": "N"}
# Derived units without a name of ours, and their spelling.
_DERIVED = {"Pa": "N/m^2"}


def _other_spelling(unit: str) -> str:
    """Return the unit in our spelling, or the unit to convert to, for the end of a sentence."""
    found = next((part for part in re.split(r"[ /*^]", unit) if part in _MULTIPLES), None)
    if found is not None:
        return f"; convert the numbers from {found} to {_MULTIPLES[found]}."
    derived = next((part for part in re.split(r"[ /*^]", unit) if part in _DERIVED), None)
    if derived is not None:
        return f"; {derived} is {_DERIVED[derived]}."
    text = unit
    for other, ours in _POWERS:
        text = text.replace(other, ours)
    text = re.sub(r"[*\u00b7.]", " ", text)
    text = re.sub(r"([A-Za-z])(-?\d)", r"\1^\2", text)
    # Nm is two units without a space.
    parts = [
        f"{part[0]} {part[1:]}"
        if part not in _UNITS and part[:1] in _UNITS and part[1:] in _UNITS
        else part
        for part in re.split(r"([ /])", text)
    ]
    text = "".join(parts)
    if text != unit and all(
        (match := _FACTOR.match(part)) and match.group(1) in _UNITS
        for part in re.split(r"[ /]", text)
    ):
        return f"; did you mean {text!r}?"
    return "."


_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
# Assumptions that a moving quantity must not have. SymPy would simplify by them: Abs(q) of a
# "positive" q to q, sin(pi*q) of an "integer" q to 0.
_NARROWING = (
    "zero",
    "integer",
    "rational",
    "irrational",
    "positive",
    "negative",
    "nonnegative",
    "nonpositive",
    "nonzero",
    "imaginary",
)


# Value that means "none" for a field, by the field's name.
_NONE = {
    "contacts": "() if there are none",
    "inputs": "() if there are none",
    "parameters": "() if there are none",
    "goal": "() if any end will do",
}


_BOUND = "a position has no bounds: write a Contact; velocity_lower and velocity_upper bound v."
_BY_SYMBOL = "its name is that of its symbol."
# Fields that do not exist, and the places of their meaning.
_ELSEWHERE = {
    ("Coordinate", "lower"): _BOUND,
    ("Coordinate", "upper"): _BOUND,
    **{(kind, "name"): _BY_SYMBOL for kind in ("Coordinate", "Input", "Parameter")},
    ("Contact", "gap"): "penetration is the gap with the other sign: penetration=-gap.",
    **{
        ("Contact", name): "friction is written in Scene(frictions=(Friction(..),))."
        for name in ("friction", "mu", "coefficient")
    },
    **{
        ("Task", name): "a plan lasts steps * step seconds: give steps and step."
        for name in ("horizon", "duration", "time", "dt", "N")
    },
}


def named_fields(kind: type[_Part]) -> type[_Part]:
    """Make a dataclass raise a sentence for missing and unknown fields."""
    as_dataclass: Any = kind
    create, every = kind.__init__, fields(as_dataclass)
    needed = [
        each.name for each in every if each.default is MISSING and each.default_factory is MISSING
    ]
    names = [each.name for each in every]

    @wraps(create)
    def checked(self: Any, *unnamed: Any, **given: Any) -> None:
        if unnamed:
            raise SceneError(
                f"{kind.__name__}: {unnamed[0]!r} has no name; write {kind.__name__}({names[0]}=..)."
            )
        unknown = next((name for name in given if name not in names), None)
        if unknown is not None:
            otherwise = f"its fields are {', '.join(names)}."
            advice = _ELSEWHERE.get((kind.__name__, unknown)) or did_you_mean(
                unknown, names, otherwise
            )
            raise SceneError(f"{_called(kind, given)}: there is no field {unknown!r}; {advice}")
        missing = [name for name in needed if name not in given]
        if missing:
            verb = "is" if len(missing) == 1 else "are"
            advice = "".join(f"; {name}={_NONE[name]}" for name in missing if name in _NONE)
            raise SceneError(
                f"{_called(kind, given)}: {', '.join(missing)} {verb} missing{advice}."
            )
        create(self, **given)

    # A dataclass has no hook before its own __init__, in which Python refuses unknown names.
    kind.__init__ = checked  # type: ignore[method-assign]
    return kind


def _called(kind: type, given: dict[str, Any]) -> str:
    """Name an unfinished part in a message."""
    name = given.get("name", given.get("symbol", given.get("metric", "")))
    return f"{kind.__name__.lower()} {name}".rstrip()


def check_name(what: str, name: Any) -> None:
    """Raise SceneError unless `name` is an identifier."""
    if not isinstance(name, str) or not _IDENTIFIER.match(name):
        raise SceneError(
            f"{what}: the name {name!r} is not an identifier; use letters a to z, digits and _, starting with a letter."
        )


def check_text(what: str, text: Any, *, empty: bool = False) -> None:
    """Raise SceneError unless `text` is a string, not empty unless `empty`."""
    if not isinstance(text, str) or not (empty or text.strip()):
        raise SceneError(f"{what} must be words in quotes, not {text!r}.")


def check_unit(what: str, unit: Any) -> None:
    """Raise SceneError unless `unit` is one that is known."""
    try:
        base_exponents(unit)
    except ValueError as error:
        raise SceneError(f"{what}: {error}") from error


def check_symbol(what: str, symbol: Any) -> None:
    """Raise SceneError unless `symbol` is a SymPy Symbol."""
    if not isinstance(symbol, sp.Symbol):
        raise SceneError(f"{what} must be a SymPy Symbol, not {type(symbol).__name__}.")


def check_moving(what: str, symbol: Any) -> None:
    """Raise SceneError unless `symbol` may stand for a coordinate, a velocity or an input.

    Such a quantity has any value.
    """
    check_symbol(what, symbol)
    narrower = next((word for word in _NARROWING if symbol.assumptions0.get(word)), None)
    if narrower:
        raise SceneError(
            f"{what}: SymPy takes {symbol} to be {narrower} and would simplify by that, but it may have any value; "
            f"declare it with sp.symbols('{symbol}', real=True)."
        )


def settle(part: Any, field: str, value: Any) -> None:
    """Set a field of a frozen object while it is created."""
    object.__setattr__(part, field, value)


def settle_bounds(part: Any, where: str, lower: str, upper: str) -> None:
    """Settle two fields as numbers, possibly infinite; the first must be below the second."""
    for field in (lower, upper):
        settle(part, field, as_number(f"{where}: {field}", getattr(part, field), finite=False))
    least, most = getattr(part, lower), getattr(part, upper)
    if not least < most:
        raise SceneError(
            f"{where}: the bounds [{least:g}, {most:g}] are empty; {lower} must be below {upper}."
        )


def as_number(what: str, value: Any, *, finite: bool = True) -> float:
    """Return any real number as a Python float (also of NumPy or SymPy, such as pi/3).

    Infinite numbers need finite=False.
    """
    if isinstance(value, sp.Expr) and value.is_comparable:
        value = float(value)
    if isinstance(value, str):
        raise SceneError(f"{what}: {value!r} is text; write a number, without quotes.")
    if (
        isinstance(value, bool)
        or not isinstance(value, Real)
        or math.isnan(value)
        or (finite and math.isinf(value))
    ):
        raise SceneError(f"{what}: {value!r} is not a {'finite ' if finite else ''}number.")
    return float(value)


def as_expression(what: str, value: Any) -> sp.Expr:
    """Return a SymPy expression unchanged, and a number as an expression.

    Whole numbers become exact: 0.0 is nothing, and left out of every model.
    """
    expression: Any = value
    if isinstance(value, Real) and not isinstance(value, (bool, sp.Expr)):
        number = float(value)
        expression = sp.Integer(int(number)) if number.is_integer() else sp.Float(number)
    if not isinstance(expression, sp.Expr):
        raise SceneError(
            f"{what} must be a SymPy expression or a number, not {type(value).__name__} ({value!r})."
        )
    if expression.has(sp.I, sp.nan, sp.zoo, sp.oo, -sp.oo):
        raise SceneError(f"{what} is {expression}, which is not a finite real expression.")
    return expression
