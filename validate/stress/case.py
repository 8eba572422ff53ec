"""Stress cases as checks of a campaign: the expected behaviour, and a measurement.

    CASE = StressCase(title="...", expected="...")

    def measure() -> Found:
        return finding("...", at_most("...", 1e-9, 1e-6, reason="..."), charts=(chart("...", ...),))

A case passes if it has figures with limits, and all are finite and within. Figures may count
correct refusals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from models.catalog import scene_path
from models.errors import TouchstoneError
from models.results.check import AxisRecord, ChartRecord, SeriesRecord
from models.results.verdict import Metric
from validate.stress.catalog import StressCase, case_names, describe_case, heading, load_case
from validate.tasks.check import Course, Found
from validate.tasks.task import CheckTask, SceneReference

KIND = "stress case"
# Sources of every case; scenes count by their text, methods one by one.
_SOURCES = (
    "models/",
    "formulations/",
    "validate/judge/",
    "validate/processes/isolated",
    "validate/processes/process.py",
    "validate/fmi/",
    "validate/stress/case.py",
    "validate/stress/motion.py",
    "validate/truth/problems.py",
)


def checks(scenes: Sequence[SceneReference]) -> list[CheckTask]:
    """Return all stress cases, for any scenes."""
    return [_check_of(name, describe_case(name)) for name in case_names()]


def _check_of(name: str, case: StressCase) -> CheckTask:
    return CheckTask(
        kind=KIND,
        name=heading(name),
        expected=case.expected,
        function="validate.stress.case:check",
        arguments={"case": name},
        content="\n".join(scene_path(scene).read_text(encoding="utf-8") for scene in case.scenes),
        sources=(*_SOURCES, f"validate/stress/cases/{name}.py"),
        methods=case.methods,
        quick=case.quick,
        words=(name,),
    )


def check(arguments: Mapping[str, Any], course: Course) -> Found:
    """Measure the case of that name, in the child."""
    name = str(arguments["case"])
    course.at(f"the measurement of {name}")
    return load_case(name)()


def finding(happened: str, *figures: Metric, charts: Sequence[ChartRecord] = ()) -> Found:
    """Return a finding with figures and charts; it passes if every limit is met, and one exists."""
    judged = [figure.ok for figure in figures if figure.ok is not None]
    return Found(
        bool(judged) and all(judged), " ".join(happened.split()), figures, {"charts": tuple(charts)}
    )


def at_most(
    name: str, value: float, limit: float, unit: str = "1", *, reason: str, meaning: str = ""
) -> Metric:
    """Return a figure with an upper limit and its reason."""
    return _figure(name, value, unit, meaning, limit=limit, reason=reason)


def at_least(name: str, value: float, limit: float, unit: str = "1", *, reason: str) -> Metric:
    """Return a figure with a lower limit and its reason."""
    return _figure(name, value, unit, limit=limit, reason=reason, at_least=True)


def unlimited(name: str, value: float, unit: str = "1") -> Metric:
    """Return a figure without a limit."""
    return _figure(name, value, unit)


def none_of(name: str, wrong: Sequence[str], *, reason: str) -> Metric:
    """Return the number of errors, which must be zero, with their texts as meaning."""
    return at_most(name, len(wrong), 0.0, meaning="; ".join(wrong)[:400], reason=reason)


def _figure(
    name: str,
    value: float,
    unit: str,
    meaning: str = "",
    *,
    limit: float | None = None,
    reason: str = "",
    at_least: bool = False,
) -> Metric:
    number = float(value) if math.isfinite(value) else None  # a value that is not finite is missing
    ok = (
        False
        if number is None
        else None
        if limit is None
        else number >= limit
        if at_least
        else number <= limit
    )
    return Metric(
        name=name,
        value=number,
        unit=unit,
        meaning=meaning,
        limit=limit,
        at_least=at_least,
        reason=reason,
        ok=ok,
    )


def refusal(what: str, words: Iterable[str], act: Callable[[], object]) -> list[str]:
    """Return what is wrong with a refusal, which must be one line with one of the words."""
    try:
        act()
    except TouchstoneError as error:
        named = any(word in str(error) for word in words) and "\n" not in str(error)
        return (
            []
            if named
            else [f"{what}: the sentence does not name {' or '.join(map(repr, words))}: {error}"]
        )
    except Exception as error:  # noqa: BLE001 - any other error is a finding
        return [f"{what}: {type(error).__name__} instead of a sentence: {error}"]
    return [f"{what} is taken"]


def chart(
    title: str,
    x: tuple[str, str],
    y: tuple[str, str],
    series: Mapping[str, tuple[Iterable[float], Iterable[float]]],
    *,
    log: str = "",
    level: tuple[float, str] | None = None,
    words: str = "",
) -> ChartRecord:
    """Return the data of one plot.

    - x, y: (quantity, unit).
    - series: (x, y) by name, only finite values are kept.
    - log: logarithmic axes, of "xy".
    - level: a horizontal line (value, words).
    """
    value, level_words = level or (None, "")
    return ChartRecord(
        title=title,
        x=AxisRecord(quantity=x[0], unit=x[1], log="x" in log),
        y=AxisRecord(quantity=y[0], unit=y[1], log="y" in log),
        series=tuple(_series(name, *values) for name, values in series.items()),
        level=value,
        level_words=level_words,
        words=words,
    )


def _series(name: str, x: Iterable[float], y: Iterable[float]) -> SeriesRecord:
    pairs = [
        (float(one), float(other))
        for one, other in zip(x, y, strict=False)
        if math.isfinite(one) and math.isfinite(other)
    ]
    return SeriesRecord(
        name=name, x=tuple(one for one, _ in pairs), y=tuple(other for _, other in pairs)
    )
