"""Errors for the user: one sentence on what is wrong, where, what was expected and what to do."""

import difflib
import inspect
from collections.abc import Callable, Iterable
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

_Call = TypeVar("_Call", bound=Callable[..., Any])

# Compared characters of a name; the time grows with their square.
_LONGEST = 200


class TouchstoneError(Exception):
    """Base of all errors that a user can cause; the command line exits with `exit_code`."""

    exit_code = 2


class SceneError(TouchstoneError):
    """A scene or its file contradicts itself."""


class TrajectoryError(TouchstoneError):
    """A plan that cannot be read, or that does not fit the scene."""


class UnknownNameError(TouchstoneError):
    """An unknown scene, method, pipeline or option."""


class MachineError(TouchstoneError):
    """A requirement that this machine lacks (a compiler, write permission)."""

    exit_code = 3


def nearest(name: object, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """Return the most similar known name, or None.

    Cutoff: 0 accepts any name, 1 an identical one.
    """
    return next(
        iter(difflib.get_close_matches(str(name)[:_LONGEST], list(known), n=1, cutoff=cutoff)), None
    )


def did_you_mean(name: object, known: Iterable[str], otherwise: str, cutoff: float = 0.6) -> str:
    """Return the end of a sentence on an unknown name: a suggestion, or `otherwise`.

    The suggestion is the nearest name, or the only one that contains the unknown name.
    """
    known = list(known)
    around = [item for item in known if str(name).lower() in item.lower()]
    near = nearest(name, known, cutoff) or (around[0] if len(around) == 1 else None)
    return otherwise if near is None else f"did you mean {near}?"


def named_arguments(error: type[TouchstoneError]) -> Callable[[_Call], _Call]:
    """Make a function refuse unknown and missing arguments with this error, in a sentence."""

    def decorated(call: _Call) -> _Call:
        signature = inspect.signature(call)
        names = list(signature.parameters)

        @wraps(call)
        def checked(*values: Any, **given: Any) -> Any:
            unknown = next((name for name in given if name not in names), None)
            if unknown is not None:
                advice = did_you_mean(unknown, names, f"there are {', '.join(names)}.")
                raise error(f"{call.__name__}: there is no argument {unknown!r}; {advice}")
            try:
                signature.bind(*values, **given)
            except TypeError as problem:
                raise error(
                    f"{call.__name__}: {problem}; it takes {', '.join(names)}."
                ) from problem
            return call(*values, **given)

        return checked  # type: ignore[return-value]

    return decorated


def listed(value: Any) -> tuple[Any, ...]:
    """Return the items of an iterable, or a single value or text as the only item."""
    return tuple(value) if isinstance(value, Iterable) and not isinstance(value, str) else (value,)


def check_text(name: str, value: str | Path, *, empty: bool = False) -> None:
    """Raise TouchstoneError if a value is no text or path; empty: whether "" is accepted."""
    if not isinstance(value, (str, Path)) or not (empty or str(value)):
        raise TouchstoneError(f"{name}: {value!r} must be a name, as text or Path.")


def check_positive(name: str, value: float, kind: type | tuple[type, ...] = (int, float)) -> None:
    """Raise TouchstoneError if a value is no positive, finite number [s] of this kind."""
    if isinstance(value, bool) or not isinstance(value, kind) or not 0 < value < float("inf"):
        raise TouchstoneError(
            f"{name}: {value!r} must be a positive {'whole number' if kind is int else 'number of seconds'}."
        )
