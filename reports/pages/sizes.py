"""How large the models of a scene are: what each method gave its solver, beside the count on paper."""

from __future__ import annotations

from dataclasses import dataclass

from reports.pages.section import Report
from reports.records.record import SizeRecord


@dataclass(frozen=True)
class MethodSize:
    """The model of one method; agrees: both counts are those on paper."""

    method: str
    title: str
    size: SizeRecord

    @property
    def agrees(self) -> bool:
        """Whether the solver was given as many unknowns and equations as were counted on paper."""
        size = self.size
        return (size.unknowns, size.equations) == (size.paper_unknowns, size.paper_equations)


def method_sizes(report: Report, scene: str) -> tuple[MethodSize, ...]:
    """One row a method that solved a model of the scene, in the order of the runs; a size that differs between runs has a row of its own."""
    found: dict[tuple[str, SizeRecord], MethodSize] = {}
    for run in report.stored.runs:
        for stage in run.stages if run.scene.name == scene else ():
            if stage.size is not None:
                found.setdefault((stage.method, stage.size), MethodSize(stage.method, stage.method_title, stage.size))
    return tuple(found.values())
