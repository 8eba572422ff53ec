"""`compare`: two campaigns beside each other: what got worse, what got better, what is only in one of them.

    comparison = compare(load(Path("runs/before")), load(Path("runs/after")))
    comparison.regressions        # tuple of Change, worst first

Stages are paired by scene, pipeline, part, place in the pipeline, method and eps; checks by kind,
name and scene. Costs are compared where both stages ended with a plan of the same verdict: a
cheaper plan that does not hold is no progress.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import click

from reports.records.check_record import CheckRecord
from reports.records.load import ReportError, Stored, load
from reports.records.record import HOLD, RunRecord, StageRecord
from validate.cli.table import one_line, print_table, say, wide_option

_EPILOG = """\b
Examples:
  python -m validate compare runs/before runs/after
  python -m validate compare runs/before runs/after --json

A regression is a worse verdict or outcome, a metric that left its limit, a
dearer plan of the same verdict, a check that failed, or a row that is
gone. Times that differ by more than half and more than a second are listed, but are no regressions.

Exit codes: 0 no regression; 1 at least one; 2 a folder that is no campaign.
"""
# Verdicts from worst to best; a relaxed stage is expected to violate, and is neither better nor
# worse for it. "not applicable" and "consistent" are no steps of the ladder: a change to or from
# them is neither better nor worse.
_VERDICTS = ("no plan", "undecided", "violates", "holds with feedback", "holds")
# A cost that differs by less (relative to the larger one, and in its own unit) is the same; so is a
# time that differs by less than this factor or these seconds.
COST_TOLERANCE = 1e-6
COST_FLOOR = 1e-9
TIME_FACTOR = 1.5
TIME_FLOOR = 1.0

_Item = TypeVar("_Item")


class ChangeKind(Enum):
    """Worst first; the value is what it is called in the table, and in JSON."""

    REGRESSION = "worse"
    GONE = "gone"
    SLOWER = "slower"
    OTHER = "other"
    NEW = "new"
    FASTER = "faster"
    IMPROVEMENT = "better"


_COLOURS = {"worse": "red", "gone": "red", "slower": "yellow", "faster": "green", "better": "green"}


@click.command(epilog=_EPILOG)
@click.argument("before", type=click.Path(path_type=Path), metavar="A")
@click.argument("after", type=click.Path(path_type=Path), metavar="B")
@click.option("--json", "as_json", is_flag=True, help="The differences as JSON on stdout.")
@wide_option
def command(before: Path, after: Path, as_json: bool) -> int:
    """What differs between the campaigns in the folders A (before) and B (after), regressions first."""
    comparison = compare(_loaded(before), _loaded(after))
    code = 1 if comparison.regressions else 0
    changes = [asdict(change) | {"kind": change.kind.value} for change in comparison.changes]
    if as_json:
        click.echo(
            json.dumps({"pairs": comparison.pairs, "changes": changes, "exit_code": code}, indent=1)
        )
        return code
    if changes:
        rows = [list(change.values()) for change in changes]
        print_table(
            ["", "where", "what", "before", "after"], rows, drop=("before",), colours=_COLOURS
        )
        click.echo()
    counts = Counter(change["kind"] for change in changes)
    found = ", ".join(f"{count} {word}" for word, count in counts.items()) or "none"
    both = "1 row is" if comparison.pairs == 1 else f"{comparison.pairs} rows are"
    click.echo(f"{both} in both campaigns; differences: {found}")
    return code


def _loaded(folder: Path) -> Stored:
    try:
        stored = load(folder)
    except ReportError as problem:
        raise click.UsageError(str(problem)) from problem
    if (
        stored.campaign is None
    ):  # without it nobody knows which of the records are this campaign's, and which of one before
        (why,) = (item.sentence for item in stored.unreadable if item.path == "campaign.json")
        raise click.UsageError(one_line(f"{folder / 'campaign.json'}: {why}"))
    for item in stored.unreadable:
        say(f"warning: {folder / item.path}: {item.sentence}", err=True)
    if not stored.runs and not stored.checks:
        raise click.UsageError(
            f"{folder}: there is no readable record; give the folder of a campaign (it holds campaign.json and runs/)."
        )
    return stored


@dataclass(frozen=True, kw_only=True)
class Change:
    """One difference. where: which stage or check; what: the quantity.

    before, after: its values as they are shown.
    """

    kind: ChangeKind
    where: str
    what: str
    before: str
    after: str


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """changes: worst first; pairs: how many stages and checks stand in both."""

    changes: tuple[Change, ...]
    pairs: int

    @property
    def regressions(self) -> tuple[Change, ...]:
        """What got worse, and what is gone."""
        return tuple(
            change
            for change in self.changes
            if change.kind in (ChangeKind.REGRESSION, ChangeKind.GONE)
        )


def compare(before: Stored, after: Stored) -> Comparison:
    """Everything that differs between two campaigns."""
    stages = _pair(_stages(before.runs), _stages(after.runs), _stage_changes)
    checks = _pair(_checks(before.checks), _checks(after.checks), _check_changes)
    worst_first = list(ChangeKind)
    changes = sorted(
        [*stages[0], *checks[0]], key=lambda change: (worst_first.index(change.kind), change.where)
    )
    return Comparison(changes=tuple(changes), pairs=stages[1] + checks[1])


def _stages(runs: Iterable[RunRecord]) -> dict[Hashable, StageRecord]:
    return {
        (run.scene.name, run.pipeline, run.part, stage.index, stage.method, stage.eps): stage
        for run in runs
        for stage in run.stages
    }


def _checks(records: Iterable[CheckRecord]) -> dict[Hashable, CheckRecord]:
    return {(record.kind, record.name, record.scene): record for record in records}


def _pair(
    before: Mapping[Hashable, _Item],
    after: Mapping[Hashable, _Item],
    changes: Callable[[str, _Item, _Item], Iterable[Change]],
) -> tuple[list[Change], int]:
    found: list[Change] = []
    for key in dict.fromkeys([*before, *after]):
        where = _where(key)
        if key not in after:
            found.append(
                Change(kind=ChangeKind.GONE, where=where, what="row", before="there", after="gone")
            )
        elif key not in before:
            found.append(
                Change(
                    kind=ChangeKind.NEW, where=where, what="row", before="not there", after="new"
                )
            )
        else:
            found.extend(changes(where, before[key], after[key]))
    return found, len(set(before) & set(after))


def _where(key: Any) -> str:
    if len(key) == 3:
        return " ".join(str(part) for part in key if part)
    scene, pipeline, part, index, method, eps = key
    several = f" part {part}" if part > 1 else ""
    return f"{scene} x {pipeline}{several}, stage {index + 1} {method}" + (
        f" at {eps:g}" if eps is not None else ""
    )


def _stage_changes(where: str, before: StageRecord, after: StageRecord) -> Iterable[Change]:
    expected = before.kind == after.kind == "indirect"
    if before.verdict != after.verdict:
        on_ladder = before.verdict in _VERDICTS and after.verdict in _VERDICTS
        better = (
            _VERDICTS.index(after.verdict) - _VERDICTS.index(before.verdict) if on_ladder else 0
        )
        relaxed = expected and {before.verdict, after.verdict}.issubset((*HOLD, "violates"))
        kind = (
            ChangeKind.OTHER
            if relaxed or not better
            else ChangeKind.IMPROVEMENT
            if better > 0
            else ChangeKind.REGRESSION
        )
        yield Change(
            kind=kind, where=where, what="verdict", before=before.verdict, after=after.verdict
        )
    if before.outcome != after.outcome:
        solved = ChangeKind.IMPROVEMENT if after.outcome == "solved" else ChangeKind.OTHER
        kind = ChangeKind.REGRESSION if before.outcome == "solved" else solved
        yield Change(
            kind=kind, where=where, what="outcome", before=before.outcome, after=after.outcome
        )
    elif before.verdict == after.verdict and before.cost is not None and after.cost is not None:
        yield from _cost_change(where, before.cost, after.cost)
    for metric in after.metrics:
        was = before.metric(metric.name)
        if was is not None and was.ok is not None and metric.ok is not None and was.ok != metric.ok:
            kind = (
                ChangeKind.OTHER
                if expected
                else ChangeKind.IMPROVEMENT
                if metric.ok
                else ChangeKind.REGRESSION
            )
            words = ("within its limit", "beyond its limit")
            yield Change(
                kind=kind,
                where=where,
                what=metric.name,
                before=words[not was.ok],
                after=words[not metric.ok],
            )
    yield from _time_change(where, before.seconds.stage_cpu, after.seconds.stage_cpu)


def _cost_change(where: str, before: float, after: float) -> Iterable[Change]:
    if abs(after - before) > COST_TOLERANCE * max(abs(before), abs(after)) + COST_FLOOR:
        kind = ChangeKind.REGRESSION if after > before else ChangeKind.IMPROVEMENT
        yield Change(
            kind=kind, where=where, what="cost", before=f"{before:.9g}", after=f"{after:.9g}"
        )


def _time_change(where: str, before: float, after: float) -> Iterable[Change]:
    """A time is not a regression by itself: machines are shared."""
    slow, fast = max(before, after), min(before, after)
    if slow - fast > TIME_FLOOR and slow > TIME_FACTOR * fast:
        kind = ChangeKind.SLOWER if after > before else ChangeKind.FASTER
        yield Change(
            kind=kind, where=where, what="CPU seconds", before=f"{before:.3g}", after=f"{after:.3g}"
        )


def _check_changes(where: str, before: CheckRecord, after: CheckRecord) -> Iterable[Change]:
    if before.passed != after.passed:
        words = {True: "passed", False: "failed"}
        kind = ChangeKind.IMPROVEMENT if after.passed else ChangeKind.REGRESSION
        yield Change(
            kind=kind,
            where=where,
            what="check",
            before=words[before.passed],
            after=words[after.passed],
        )
