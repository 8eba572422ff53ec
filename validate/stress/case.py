"""A stress case: what a correct system does, and a function that measures what happened.

    CASE = HardCase(name="h02_restitution", title="...", expected="...", measure=measure)

    def measure() -> CaseFinding:
        return CaseFinding(happened="...", figures=(at_most("...", 1e-9, 1e-6, reason="..."),), charts=(Chart(...),))

A case passes if each figure with a limit keeps it. A figure that is not a finite number fails, and so does a case without a figure.
A case may end in an honest refusal: that is then what its figures count.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One number and its limit: from above, or from below (at_least); None: no limit. reason: why this limit."""

    name: str
    value: float
    limit: float | None = None
    unit: str = "1"
    meaning: str = ""
    reason: str = ""
    at_least: bool = False

    @property
    def ok(self) -> bool | None:
        """None where there is nothing to keep; a number that is none keeps nothing."""
        if not math.isfinite(self.value):
            return False
        if self.limit is None:
            return None
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True, kw_only=True)
class Series:
    """name: for the legend; x, y: of equal length; values that are not finite are left out. line: joined, else points alone."""

    name: str
    x: Sequence[float] | np.ndarray
    y: Sequence[float] | np.ndarray
    line: bool = True


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Data of one plot. x, y: (quantity, unit); log_x, log_y: logarithmic axes; level: a horizontal line (value, words)."""

    title: str
    x: tuple[str, str]
    y: tuple[str, str]
    series: tuple[Series, ...]
    log_x: bool = False
    log_y: bool = False
    level: tuple[float, str] | None = None
    words: str = ""


@dataclass(frozen=True, kw_only=True)
class CaseFinding:
    """What happened, in a sentence or two, with figures and the data of plots."""

    happened: str
    figures: tuple[Figure, ...]
    charts: tuple[Chart, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether each figure with a limit keeps it, and there is one."""
        judged = [figure.ok for figure in self.figures if figure.ok is not None]
        return bool(judged) and all(judged)


@dataclass(frozen=True, kw_only=True)
class HardCase:
    """See the module docstring.

    name: that of its file, h<two digits>_<words>; quick: whether a quick campaign runs it; scenes, methods: names of those of the catalogs it uses, on
    which a stored result depends. All but `measure` are written as literals: they are read without importing.
    """

    name: str
    title: str
    expected: str
    measure: Callable[[], CaseFinding]
    quick: bool = False
    scenes: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()


def at_most(name: str, value: float, limit: float, unit: str = "1", *, reason: str, meaning: str = "") -> Figure:
    """A figure with a limit from above."""
    return Figure(name=name, value=float(value), limit=limit, unit=unit, reason=reason, meaning=meaning)


def at_least(name: str, value: float, limit: float, unit: str = "1", *, reason: str, meaning: str = "") -> Figure:
    """A figure with a limit from below."""
    return Figure(name=name, value=float(value), limit=limit, unit=unit, reason=reason, meaning=meaning, at_least=True)


def unlimited(name: str, value: float, unit: str = "1", *, meaning: str = "") -> Figure:
    """A figure without a limit."""
    return Figure(name=name, value=float(value), unit=unit, meaning=meaning)


def none_of(name: str, wrong: Sequence[str], *, reason: str) -> Figure:
    """How many things are wrong, which must be none; their words stand in the meaning."""
    return Figure(name=name, value=float(len(wrong)), limit=0.0, meaning="; ".join(wrong)[:400], reason=reason)
