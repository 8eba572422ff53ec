"""Errors that speak to the user: one sentence that says what is wrong, where, what was expected and what to do."""

import difflib
from collections.abc import Iterable


class TouchstoneError(Exception):
    """Base of every error a user can cause; the command line prints its text and exits with `exit_code`."""

    exit_code = 2


class SceneError(TouchstoneError):
    """A scene (or its file) contradicts itself; raised when the scene is created, loaded or first used."""


class TrajectoryError(TouchstoneError):
    """A plan cannot be read or does not fit the scene."""


class UnknownNameError(TouchstoneError):
    """A scene, method, pipeline or option of that name does not exist."""


class MachineError(TouchstoneError):
    """What was asked cannot be done on this machine (no compiler, no write permission); says how to get it."""

    exit_code = 3


def did_you_mean(name: object, known: Iterable[str], otherwise: str) -> str:
    """The end of a sentence about an unknown name: the nearest that is known, or else what there is."""
    close = difflib.get_close_matches(str(name), list(known), n=1)
    return f"did you mean {close[0]}?" if close else otherwise
