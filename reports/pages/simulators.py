"""What other simulators say: of one plan (`replay --engine`), and of a campaign's cheapest plan on each scene (`report --engine`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from reports.pages.section import Report, Section
from reports.records.record import RunRecord
from reports.records.simulators_record import EngineRecord
from reports.wording import count, listing


def of_plan(rows: Sequence[Mapping[str, Any]]) -> list[Section]:
    """The section of one plan; none where no engine was asked."""
    return [Section("engines", "What other simulators say", "simulators.html#plan", {"rows": rows})] if rows else []


def build(report: Report) -> Section | None:
    """The section of a campaign: scenes by engines, and why where one says otherwise; None where none was asked of a run that is still there."""
    told = report.stored.simulators
    if told is None:
        return None
    asked = [
        (run, report.link(run), {row.engine: row for row in told.plans[run.key]}) for run in report.stored.runs if run.key in told.plans
    ]
    if not asked:
        return None
    engines = {name: words for name, words in told.engines.items() if any(name in rows for _, _, rows in asked)}
    said = [sentence(name, [(run, rows[name]) for run, _, rows in asked if name in rows]) for name in engines]
    otherwise = [(run, link, row) for run, link, rows in asked for row in rows.values() if not row.agrees]
    values = {"said": said, "engines": engines, "asked": asked, "otherwise": otherwise}
    return Section("simulators", "What other simulators say", "simulators.html#campaign", values, said=said[0])


def sentence(engine: str, rows: Sequence[tuple[RunRecord, EngineRecord]]) -> str:
    """In how many plans an engine agrees with us, why not in the others, and what it could not be asked."""
    compared = [row for _, row in rows if row.agrees is not None]
    same = sum(bool(row.agrees) for row in compared)
    kinds = Counter(row.kind or "no class" for row in compared if not row.agrees)
    untold = [f"{run.scene.name} ({row.verdict})" for run, row in rows if row.agrees is None]
    words = [f"{engine} gives our verdict on {same} of {count(len(compared), 'plan')} that it can step"]
    words += [f"otherwise by {listing([f'{kind} ({number})' for kind, number in kinds.most_common()])}"] if kinds else []
    words += [f"no answer on {listing(untold)}"] if untold else []
    return f"{'; '.join(words)}."
