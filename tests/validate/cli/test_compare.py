"""`compare`: what got worse stands first and makes the exit code 1; noise of times does not."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from reports.records.check_record import CheckRecord
from reports.records.load import Stored
from reports.records.record import MetricRecord, RunRecord, SecondsRecord, StageRecord
from tests.reports import record_factory as factory
from validate.cli.compare import Change, ChangeKind, Comparison, compare


@pytest.fixture(scope="module")
def runs() -> list[RunRecord]:
    return factory.runs()


def changed_last(run: RunRecord, **changes) -> RunRecord:
    """The run with other values in its last stage."""
    last = run.stages[-1].model_copy(update=changes)
    return run.model_copy(update={"stages": (*run.stages[:-1], last)})


def stored(runs: Sequence[RunRecord] = (), checks: Sequence[CheckRecord] = ()) -> Stored:
    return Stored(None, tuple(runs), checks=tuple(checks))


def compared(before: Sequence[RunRecord], after: Sequence[RunRecord]) -> Comparison:
    return compare(stored(before), stored(after))


def direct(runs: list[RunRecord]) -> RunRecord:
    """A run whose last plan is direct, holds, was solved and has a cost."""
    return next(
        run
        for run in runs
        if run.stages[-1].kind == "direct"
        and run.verdict == "holds"
        and run.stages[-1].outcome == "solved"
    )


def test_a_campaign_does_not_differ_from_itself(runs):
    found = compared(runs, runs)
    assert found.changes == ()
    assert found.pairs == sum(len(run.stages) for run in runs)


WHERE = "three_cart x strict, stage 1 strict_lcp"
LADDER = ("no plan", "undecided", "violates", "holds with feedback", "holds")
KINDS = [
    ChangeKind.REGRESSION, ChangeKind.GONE, ChangeKind.SLOWER, ChangeKind.OTHER, ChangeKind.NEW,
    ChangeKind.FASTER, ChangeKind.IMPROVEMENT,
]  # fmt: skip


def changes(before: dict, after: dict, kind: str = "direct") -> list[Change]:
    """What is said of a stage that had, and has, other values than this one."""

    def run(values: dict) -> RunRecord:
        stage = StageRecord(
            index=0,
            method="strict_lcp",
            method_title="",
            kind=kind,
            eps=None,
            outcome="solved",
            advice="",
            cost=10.0,
            verdict="holds",
        )  # type: ignore[arg-type]
        return factory.run("strict", None, "strict_lcp", stages=(stage.model_copy(update=values),))

    found = compared([run(before)], [run(after)])
    assert found.pairs == 1
    return list(found.changes)


@pytest.mark.parametrize("worse", range(4))
def test_each_verdict_is_worse_than_the_next(worse: int):
    low, high = LADDER[worse : worse + 2]
    (down,), (up,) = (
        changes({"verdict": high}, {"verdict": low}),
        changes({"verdict": low}, {"verdict": high}),
    )
    assert down == Change(
        kind=ChangeKind.REGRESSION, where=WHERE, what="verdict", before=high, after=low
    )
    assert up == Change(
        kind=ChangeKind.IMPROVEMENT, where=WHERE, what="verdict", before=low, after=high
    )


@pytest.mark.parametrize(
    ("kind", "before", "after", "said"),
    [
        ("direct", "holds", "consistent", ChangeKind.OTHER),
        ("direct", "not applicable", "no plan", ChangeKind.OTHER),
        ("indirect", "holds", "violates", ChangeKind.OTHER),
        ("indirect", "violates", "holds with feedback", ChangeKind.OTHER),
        ("indirect", "violates", "undecided", ChangeKind.REGRESSION),
        ("indirect", "no plan", "violates", ChangeKind.IMPROVEMENT),
    ],
)  # fmt: skip
def test_what_is_no_step_of_the_ladder_is_neither_better_nor_worse(
    kind: str, before: str, after: str, said: ChangeKind
):
    (change,) = changes({"verdict": before}, {"verdict": after}, kind)
    assert (change.kind, change.what) == (said, "verdict")


@pytest.mark.parametrize(
    ("before", "after", "kind"),
    [("solved", "stalled", ChangeKind.REGRESSION), ("stalled", "solved", ChangeKind.IMPROVEMENT),
     ("stalled", "time_limit", ChangeKind.OTHER)],
)  # fmt: skip
def test_an_outcome_is_better_if_it_solves(before: str, after: str, kind: ChangeKind):
    """Its costs are then not compared."""
    assert changes({"outcome": before, "cost": 1.0}, {"outcome": after, "cost": 2.0}) == [
        Change(kind=kind, where=WHERE, what="outcome", before=before, after=after)
    ]


@pytest.mark.parametrize(
    ("before", "after", "kind"),
    [
        (10.0, 10.0 * (1 + 1.01e-6), ChangeKind.REGRESSION),
        (10.0, 10.0 * (1 + 0.99e-6), None),
        (-10.0, -10.0 * (1 + 1.01e-6), ChangeKind.IMPROVEMENT),
        (10.0, 5.0, ChangeKind.IMPROVEMENT),
        # A millionth of the larger one, whichever was there first.
        (1e12, 1e12 * (1 + 1.0000005e-6), None),
        (1e12 * (1 + 1.0000005e-6), 1e12, None),
        (1e12, 1e12 * (1 + 1.0000015e-6), ChangeKind.REGRESSION),
        (1e12 * (1 + 1.0000015e-6), 1e12, ChangeKind.IMPROVEMENT),
        (0.0, 1.01e-9, ChangeKind.REGRESSION),
        (0.0, 0.99e-9, None),
        (None, 5.0, None),
        (5.0, None, None),
    ],
)
def test_costs_are_compared_beyond_rounding(
    before: float | None, after: float | None, kind: ChangeKind | None
):
    found = changes({"cost": before}, {"cost": after})
    expected = (
        []
        if kind is None
        else [
            Change(
                kind=kind, where=WHERE, what="cost", before=f"{before:.9g}", after=f"{after:.9g}"
            )
        ]
    )
    assert found == expected


def test_a_cheaper_plan_that_no_longer_holds_is_no_progress():
    assert [
        change.what for change in changes({"cost": 2.0}, {"cost": 1.0, "verdict": "violates"})
    ] == ["verdict"]


def metric(ok: bool | None, name: str = "defect") -> dict:
    return {"metrics": (MetricRecord(name=name, value=1.0, unit="1", meaning="", ok=ok),)}


@pytest.mark.parametrize("kind", ["direct", "indirect"])
def test_a_metric_that_left_its_limit_is_a_regression_where_a_plan_must_hold(kind: str):
    (down,), (up,) = (
        changes(metric(True), metric(False), kind),
        changes(metric(False), metric(True), kind),
    )
    worse, better = (
        (ChangeKind.REGRESSION, ChangeKind.IMPROVEMENT)
        if kind == "direct"
        else (ChangeKind.OTHER, ChangeKind.OTHER)
    )
    assert down == Change(
        kind=worse, where=WHERE, what="defect", before="within its limit", after="beyond its limit"
    )
    assert up == Change(
        kind=better, where=WHERE, what="defect", before="beyond its limit", after="within its limit"
    )


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (metric(None), metric(False)),
        (metric(True), metric(None)),
        (metric(True), metric(False, "other")),
        (metric(True), metric(True)),
    ],
)
def test_a_metric_that_was_or_is_open_is_not_compared(before: dict, after: dict):
    assert changes(before, after) == []


@pytest.mark.parametrize(
    ("slow", "fast", "told"),
    [
        (20.0, 10.0, True),
        (15.0, 10.0, False),
        (15.1, 10.0, True),
        (1.0, 0.0, False),
        (1.01, 0.0, True),
        (1.9, 1.0, False),
    ],
)
def test_a_time_is_told_beyond_a_second_and_a_half_as_much_again(
    slow: float, fast: float, told: bool
):
    """It is no regression: machines are shared."""
    first, second = ({"seconds": SecondsRecord(stage_cpu=seconds)} for seconds in (slow, fast))
    said = {"where": WHERE, "what": "CPU seconds"}
    up = Change(kind=ChangeKind.SLOWER, before=f"{fast:.3g}", after=f"{slow:.3g}", **said)
    down = Change(kind=ChangeKind.FASTER, before=f"{slow:.3g}", after=f"{fast:.3g}", **said)
    assert (changes(second, first), changes(first, second)) == (
        ([up], [down]) if told else ([], [])
    )


def check(passed: bool, name: str = "case", scene: str | None = None) -> CheckRecord:
    return CheckRecord(
        key=name, kind="stress", name=name, expected="", scene=scene, outcome="answered",
        passed=passed, wall_seconds=1.0, cpu_seconds=1.0,
        provenance=factory.provenance(),
    )  # fmt: skip


def test_a_check_that_no_longer_passes_is_a_regression():
    good, bad = (
        stored((), [check(True, scene="push_box")]),
        stored((), [check(False, scene="push_box")]),
    )
    where = "stress case push_box"
    down, up, same = compare(good, bad), compare(bad, good), compare(bad, bad)
    assert down.changes == (
        Change(
            kind=ChangeKind.REGRESSION, where=where, what="check", before="passed", after="failed"
        ),
    )
    assert up.changes == (
        Change(
            kind=ChangeKind.IMPROVEMENT, where=where, what="check", before="failed", after="passed"
        ),
    )
    assert (down.pairs, same.changes, down.regressions, up.regressions) == (1, (), down.changes, ())


def test_rows_that_are_gone_and_new_ones():
    first, second = (
        factory.run("strict", None, "strict_lcp"),
        factory.run("relu_gd", None, "relu_gd"),
    )
    found = compare(stored([first], [check(True, "one")]), stored([second], [check(True, "two")]))
    assert found.changes == (
        Change(kind=ChangeKind.GONE, where="stress one", what="row", before="there", after="gone"),
        Change(kind=ChangeKind.GONE, where=WHERE, what="row", before="there", after="gone"),
        Change(
            kind=ChangeKind.NEW, where="stress two", what="row", before="not there", after="new"
        ),
        Change(
            kind=ChangeKind.NEW,
            where="three_cart x relu_gd, stage 1 relu_gd",
            what="row",
            before="not there",
            after="new",
        ),
    )
    assert (found.pairs, found.regressions) == (0, found.changes[:2])


def test_a_stage_is_named_by_its_part_its_place_and_its_eps(runs):
    run = next(run for run in runs if run.pipeline == "relaxed+strict")
    (gone, *_) = compared(
        [run.model_copy(update={"part": 2, "parts": 3, "stages": run.stages[1:2]})], []
    ).changes
    assert gone.where == "three_cart x relaxed+strict part 2, stage 2 relaxed_lcp at 0.001"


def test_the_worst_change_stands_first():
    """Of a change of each kind, then by name; the kinds count from worst to best."""
    found = changes(
        {"verdict": "consistent", "cost": None, "seconds": SecondsRecord(stage_cpu=1.0)}
        | metric(True),
        {"verdict": "holds", "cost": None, "seconds": SecondsRecord(stage_cpu=9.0)} | metric(False),
    )
    assert [change.kind for change in found] == [
        ChangeKind.REGRESSION,
        ChangeKind.SLOWER,
        ChangeKind.OTHER,
    ]
    assert list(ChangeKind) == KINDS
    assert len(set(KINDS)) == 7


@pytest.fixture
def command(cli):
    return lambda *words: cli("compare", *map(str, words))


def test_the_command_says_it_and_exits_with_one(command, tmp_path, runs):
    run = direct(runs)
    before, after = (
        factory.store(tmp_path / "before", [run]),
        factory.store(tmp_path / "after", [changed_last(run, verdict="violates")]),
    )
    done = command(before, after)
    assert done.returncode == 1
    assert "holds" in done.stdout
    assert "violates" in done.stdout
    assert done.stdout.splitlines()[-1].endswith("in both campaigns; differences: 1 worse")
    assert command(before, before).returncode == 0
    told = json.loads(command(before, after, "--json").stdout)
    assert told["exit_code"] == 1
    assert told["changes"][0]["kind"] == "worse"


def test_what_is_no_campaign_is_one_sentence(command, tmp_path):
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "nowhere"):
        done = command(folder, folder)
        assert done.returncode == 2
        assert len(done.stderr.strip().splitlines()) == 1
        assert str(folder) in done.stderr


@pytest.mark.parametrize("text", ['{"x"', "{}", None])
def test_without_its_list_of_cells_nobody_knows_what_a_campaign_is(command, tmp_path, runs, text):
    """All records of the folder would be taken for it, those of campaigns before too, and what got worse be missed."""
    before, after = (factory.store(tmp_path / name, [direct(runs)]) for name in ("before", "after"))
    if text is None:
        (after / "campaign.json").unlink()
    else:
        (after / "campaign.json").write_text(text)
    done = command(before, after)
    assert (done.returncode, done.stdout) == (2, "")
    assert str(after / "campaign.json") in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_record_that_cannot_be_read_is_told(command, tmp_path, runs):
    run = direct(runs)
    before, after = (factory.store(tmp_path / name, [run]) for name in ("before", "after"))
    (after / "runs" / run.key / "record.json").write_text('{"x"')
    done = command(before, after)
    assert (done.returncode, done.stderr.startswith("warning: ")) == (2, True), (
        "nothing else is stored there"
    )
    assert str(Path("runs") / run.key / "record.json") in done.stderr
