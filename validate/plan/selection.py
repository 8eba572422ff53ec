"""`-k EXPR`: which tasks of a campaign are meant.

    matches("strict and not relaxed", ["three_cart", "softplus_dc+strict", "strict_lcp"])   # True

A word is true if it is part of one of the task's names (its scene, its pipeline, its methods), upper and lower case alike, and `=word` (or `="some words"`)
if it is all of one, or all of what the task is called (`="three_cart x strict"`); words are joined with `and`, `or`, `not` and parentheses, as in pytest.
A quotation mark between quotation marks is written twice.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

from models.errors import TouchstoneError

_TOKEN = re.compile(r'\s*(?:([()])|(="(?:[^"]|"")*"|[^\s()]+))')


# Of the names that are near a word, so many are shown.
_NEAR = 4


class SelectionError(TouchstoneError):
    """An expression that cannot be read."""


def matches(expression: str, names: Iterable[str], title: str = "") -> bool:
    """Whether the expression is true of a task of these names and this title. Raises SelectionError."""
    try:
        return _Parser(expression, tuple(name.lower() for name in names), title.lower()).result()
    except RecursionError:
        raise SelectionError(f"-k {expression[:20]!r}..: it is nested deeper than can be read; write it with fewer parentheses.") from None


def words_of(expression: str) -> list[str]:
    """The names in an expression, each as it is written, each once."""
    return list(dict.fromkeys(word for _, word in _TOKEN.findall(expression) if word and word not in ("and", "or", "not")))


def near(word: str, names: Iterable[str]) -> list[str]:
    """The names of which a part is most like a word that is in none of them; the nearest first, at least one."""
    wanted = _unquoted(word.removeprefix("=")).lower()

    def likeness(name: str) -> float:
        parts = [name, *re.split(r"[^a-z0-9]+", name.lower())]
        return max(difflib.SequenceMatcher(None, wanted, part.lower()).ratio() for part in parts if part)

    names = list(names)
    ranked = sorted([name for name in names if " " not in name] or names, key=lambda name: (-likeness(name), len(name)))
    return [name for name in ranked[:_NEAR] if likeness(name) >= 0.6] or ranked[:1]


class _Parser:
    """Recursive descent over: either = both ("or" both)*; both = item ("and" item)*; item = "not" item | "(" either ")" | word."""

    def __init__(self, expression: str, names: tuple[str, ...], title: str) -> None:
        self._expression, self._names, self._whole = expression, names, (*names, title)
        self._tokens = [mark or word for mark, word in _TOKEN.findall(expression)]
        self._place = 0

    def result(self) -> bool:
        value = self._either()
        if self._place < len(self._tokens):
            raise self._error(f"{self._tokens[self._place]!r} was not expected there")
        return value

    def _either(self) -> bool:
        value = self._both()
        while self._take("or"):
            value = self._both() or value
        return value

    def _both(self) -> bool:
        value = self._item()
        while self._take("and"):
            value = self._item() and value
        return value

    def _item(self) -> bool:
        if self._take("not"):
            return not self._item()
        if self._take("("):
            value = self._either()
            if not self._take(")"):
                raise self._error("a ')' is missing")
            return value
        if self._place >= len(self._tokens):
            raise self._error("a name is missing at its end")
        word = self._tokens[self._place]
        if word in {"and", "or", ")"}:
            raise self._error(f"a name is missing before {word!r}")
        self._place += 1
        if word.startswith("="):
            return _unquoted(word[1:]).lower() in self._whole
        return any(word.lower() in name for name in self._names)

    def _take(self, token: str) -> bool:
        if self._place < len(self._tokens) and self._tokens[self._place] == token:
            self._place += 1
            return True
        return False

    def _error(self, problem: str) -> SelectionError:
        return SelectionError(
            f"-k {self._expression!r}: {problem}; write names joined with and, or, not, for example -k 'strict and not relaxed'."
        )


def _unquoted(word: str) -> str:
    return word[1:-1].replace('""', '"') if len(word) > 1 and word[0] == word[-1] == '"' else word.strip('"')
