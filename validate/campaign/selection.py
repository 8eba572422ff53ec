"""Select tasks of a campaign by `-k EXPR`.

    matches("strict and not relaxed", ["three_cart", "softplus_dc+strict", "strict_lcp"])   # True

The names of a task are its scene, its pipeline and its methods. Case is ignored.

- `word`: part of a name
- `=word`, `="some words"`: a whole name, or the whole title (`="three_cart x strict"`)
- `and`, `or`, `not`, parentheses: as in pytest

A quotation mark inside quotation marks is doubled.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence

from models.errors import TouchstoneError

_TOKEN = re.compile(r'\s*(?:([()])|(="(?:[^"]|"")*"|[^\s()]+))')


# Largest number of suggested names.
_NEAR = 4


class SelectionError(TouchstoneError):
    """An expression that cannot be parsed."""


def matches(expression: str, names: Iterable[str], title: str = "") -> bool:
    """Return whether the expression is true for a task with these names and this title.

    Raises SelectionError.
    """
    names = tuple(name.lower() for name in names)
    truth, wants_name, opened = [], True, 0
    for mark, word in _TOKEN.findall(expression):
        token = mark or word
        ends = token in ("and", "or", ")")
        if wants_name and ends:
            raise _error(expression, f"a name is missing before {token!r}")
        if not wants_name and (not ends or (token == ")" and not opened)):
            raise _error(
                expression, "a ')' is missing" if opened else f"{token!r} was not expected there"
            )
        wants_name = token in ("and", "or", "not", "(")
        opened += {"(": 1, ")": -1}.get(token, 0)
        truth.append(token if wants_name or ends else str(_is_meant(token, names, title.lower())))
    if wants_name:
        raise _error(expression, "a name is missing at its end")
    if opened:
        raise _error(expression, "a ')' is missing")
    try:
        # The text contains only True, False, and, or, not and parentheses, in a checked order.
        return eval(" ".join(truth))
    except (SyntaxError, RecursionError, MemoryError):  # raised by Python for deep nesting
        raise SelectionError(
            f"-k {expression[:20]!r}..: it is nested deeper than can be read; write it with fewer parentheses."
        ) from None


def _is_meant(word: str, names: Sequence[str], title: str) -> bool:
    if word.startswith("="):
        return _unquoted(word[1:]).lower() in (*names, title)
    return any(word.lower() in name for name in names)


def _error(expression: str, problem: str) -> SelectionError:
    return SelectionError(
        f"-k {expression!r}: {problem}; write names joined with and, or, not, for example -k 'strict and not relaxed'."
    )


def words_of(expression: str) -> list[str]:
    """Return the distinct words of an expression, as written."""
    return list(
        dict.fromkeys(
            word
            for _, word in _TOKEN.findall(expression)
            if word and word not in ("and", "or", "not")
        )
    )


def near(word: str, names: Iterable[str]) -> list[str]:
    """Return names similar to a word that is in no name, most similar first; at least one."""
    wanted = _unquoted(word.removeprefix("=")).lower()

    def likeness(name: str) -> float:
        parts = [name, *re.split(r"[^a-z0-9]+", name.lower())]
        return max(
            difflib.SequenceMatcher(None, wanted, part.lower()).ratio() for part in parts if part
        )

    names = list(names)
    ranked = sorted(
        [name for name in names if " " not in name] or names,
        key=lambda name: (-likeness(name), len(name)),
    )
    return [name for name in ranked[:_NEAR] if likeness(name) >= 0.6] or ranked[:1]


def _unquoted(word: str) -> str:
    return (
        word[1:-1].replace('""', '"')
        if len(word) > 1 and word[0] == word[-1] == '"'
        else word.strip('"')
    )
