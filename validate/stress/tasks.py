"""Hard cases as checks of a campaign: which there are, and how one is measured in its child and recorded.

plugin.CHECKS = (..., "validate.stress.tasks:checks")
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from models.catalog import scene_path
from reports.records.check_record import AxisRecord, ChartRecord, SeriesRecord
from reports.records.record import MetricRecord
from validate.stress.catalog import case_names, describe_case, load_case
from validate.tasks.check import Course, Found
from validate.tasks.task import CheckTask
from validate.tasks.variant import SceneReference

if TYPE_CHECKING:
    from validate.stress.case import CaseFinding, Chart, Figure

KIND = "hard case"
# What a case's numbers depend on beside its own file; scenes by their text, methods one by one.
_SOURCES = (
    "models/",
    "formulations/",
    "validate/judge/",
    "validate/execution/isolated",
    "validate/execution/process.py",
    "validate/fmi/",
    "validate/stress/case.py",
    "validate/stress/tasks.py",
    "validate/stress/motion.py",
)


def checks(scenes: Sequence[SceneReference]) -> list[CheckTask]:
    """All hard cases, whatever the scenes of the campaign."""
    found = []
    for name in case_names():
        case = describe_case(name)
        found.append(
            CheckTask(
                kind=KIND,
                name=case.heading,
                expected=case.expected,
                function="validate.stress.tasks:check",
                arguments={"case": name},
                content="\n".join(scene_path(scene).read_text(encoding="utf-8") for scene in case.scenes),
                sources=(*_SOURCES, f"validate/stress/cases/{name}.py"),
                methods=case.methods,
                quick=case.quick,
                words=(name,),
            )
        )
    return found


def check(arguments: Mapping[str, Any], course: Course) -> Found:
    """Measure the case of that name, in the child."""
    case = load_case(str(arguments["case"]))
    course.at(f"the measurement of {case.name}")
    return found_of(case.measure())


def found_of(finding: CaseFinding) -> Found:
    """What is stored of a finding."""
    return Found(
        passed=finding.passed,
        sentence=" ".join(finding.happened.split()),
        figures=tuple(_figure(figure) for figure in finding.figures),
        details={"charts": tuple(_chart(chart) for chart in finding.charts)},
    )


def _figure(figure: Figure) -> MetricRecord:
    return MetricRecord(
        name=figure.name,
        value=figure.value if math.isfinite(figure.value) else None,
        unit=figure.unit,
        meaning=figure.meaning,
        limit=figure.limit,
        at_least=figure.at_least,
        reason=figure.reason,
        ok=figure.ok,
    )


def _chart(chart: Chart) -> ChartRecord:
    series = []
    for item in chart.series:
        pairs = [(float(x), float(y)) for x, y in zip(item.x, item.y, strict=False) if math.isfinite(x) and math.isfinite(y)]
        series.append(SeriesRecord(name=item.name, x=tuple(x for x, _ in pairs), y=tuple(y for _, y in pairs), line=item.line))
    return ChartRecord(
        title=chart.title,
        x=AxisRecord(quantity=chart.x[0], unit=chart.x[1], log=chart.log_x),
        y=AxisRecord(quantity=chart.y[0], unit=chart.y[1], log=chart.log_y),
        series=tuple(series),
        level=None if chart.level is None else chart.level[0],
        level_words="" if chart.level is None else chart.level[1],
        words=chart.words,
    )
