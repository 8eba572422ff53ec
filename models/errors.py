"""Errors that speak to the user: one sentence that says what is wrong, where, what was expected and what to do."""

import difflib
import inspect
from collections.abc import Callable, Iterable
from functools import wraps
from typing import Any, TypeVar

_Call = TypeVar("_Call", bound=Callable[..., Any])

# Of a name no more characters are compared: that takes their square.
_LONGEST = 200


class TouchstoneError(Exception):
    """Base of every error a user can cause.

    The command line prints its text and exits with `exit_code`.
    """

    exit_code = 2


class SceneError(TouchstoneError):
    """A scene (or its file) contradicts itself.

    Raised when the scene is created, loaded or first used.
    """


class TrajectoryError(TouchstoneError):
    """A plan cannot be read or does not fit the scene."""


class UnknownNameError(TouchstoneError):
    """A scene, method, pipeline or option of that name does not exist."""


class MachineError(TouchstoneError):
    """What was asked cannot be done on this machine (no compiler, no write permission).

    Says how to get it.
    """

    exit_code = 3


def nearest(name: object, known: Iterable[str], alike: float = 0.6) -> str | None:
    """The known name that is most like another.

    None where none is. alike: 0 takes any, 1 none but the same.
    """
    return next(
        iter(difflib.get_close_matches(str(name)[:_LONGEST], list(known), n=1, cutoff=alike)), None
    )


def did_you_mean(name: object, known: Iterable[str], otherwise: str, alike: float = 0.6) -> str:
    """The end of a sentence about an unknown name: the nearest that is known, or the only one with it inside, or else what there is."""
    known = list(known)
    around = [item for item in known if str(name).lower() in item.lower()]
    near = nearest(name, known, alike) or (around[0] if len(around) == 1 else None)
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
