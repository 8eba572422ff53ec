"""Check arguments of public functions; a wrong one raises one sentence.

check_text("fmu", None)  # TouchstoneError: fmu: None must be a name, as text or Path.
check_positive("seconds", -1)
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from models.errors import TouchstoneError


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
