"""The suite: ways through one stage end at the same answer, rounds take turns, what cannot be measured is said."""

import importlib
import json
from pathlib import Path

import click
import pytest
from wording import unsaid

from benchmarks.measure import Size
from benchmarks.suite.cases import CASES, OURS, RATIOS, Case, Ratio, Row
from benchmarks.suite.command import measured, selected

SIZE = Size(3, 12)
HERE = "suite_works"


def value_of(case: Case, folder: Path, size: Size = SIZE) -> float:
    module, _, name = case.function.partition(":")
    told = getattr(importlib.import_module(module), name)(size, folder)()
    assert told.get("outcome", "ok") in ("ok", "solved", "completed")
    return told["value"]


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["softplus_chain", "cold_step", "gd_iteration", "cs_replay"])
def test_all_ways_through_a_stage_end_at_the_same_answer(stage: str, tmp_path: Path):
    """A faster way to another answer is no faster way: cost of the plan, norm of the gradient, position at the end."""
    cases = [case for case in CASES if case.stage == stage and not case.missing()]
    if len(cases) < 2:
        pytest.skip("no peer is installed: pip install -e '.[bench]'")
    values = {case.by: value_of(case, tmp_path, Size(3, 50)) for case in cases}
    loose = 1e-3 if "drake_snopt" in values else 1e-6  # SNOPT's feasibility of 1e-6 moves the cost
    assert values == pytest.approx(dict.fromkeys(values, values[OURS]), rel=loose)


def test_selected_names_match_and_missing_peers_are_said(monkeypatch: pytest.MonkeyPatch):
    cases, left_out = selected("gd_iteration")
    assert {case.stage for case in cases} == {"gd_iteration"}
    assert not left_out
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    cases, left_out = selected("cs_replay or softplus_chain")
    assert {case.by for case in cases} == {OURS, "fmpy"}
    assert not unsaid(
        left_out, "softplus_chain by casadi … casadi is not installed (pip install -e '.[bench]')"
    )
    for expression in ("nosuchstage", "casadi"):
        with pytest.raises(click.UsageError, match="nothing is selected"):
            selected(expression)


def work(name: str, by: str = OURS) -> Case:
    return Case(stage=name, by=by, function=f"{HERE}:{name}")


@pytest.mark.slow
def test_rounds_take_turns_and_a_failure_costs_only_its_row(monkeypatch, tmp_path: Path):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    monkeypatch.setenv("BENCH_LOG", str(tmp_path / "log"))
    cases = (work("steady"), work("other"), work("broken"), work("dies", by="peer"))
    rows = {row.stage: row for row in measured(cases, [SIZE], 2)}
    assert (tmp_path / "log").read_text().split() == ["steady", "other"] * 2
    assert len(rows["steady"].cpu_s) == 2
    assert 0.001 < max(rows["steady"].cpu_s) < 0.05, (
        "short work is repeated, and the seconds are those of one call"
    )
    assert (rows["other"].cpu_s, rows["other"].outcome) == ((7.0, 7.0), "solved"), "its own clock"
    assert rows["broken"].failed.endswith("it cannot.")
    assert "SIGSEGV" in rows["dies"].failed
    assert rows["dies"].cpu_s == ()


def row(stage: str, by: str = OURS, cpu: tuple[float, ...] = (1.0,) * 5) -> Row:
    return Row(stage=stage, by=by, n=3, steps=12, cpu_s=cpu)


def test_ratio_of_rounds_a_slow_round_changes_nothing():
    """Both were three times as slow in one round: the ratio does not see it."""
    ratio = Ratio("two by one", 0.5, (("a", OURS), ("b", OURS)), ("a", "peer"))
    rows = [row("a", cpu=(1.0, 3.0, 1.0)), row("b", cpu=(1.0, 3.0, 1.0))]
    assert ratio.of(rows, SIZE) is None
    rows.append(row("a", "peer", cpu=(4.0, 12.0, 4.0)))
    assert ratio.of(rows, SIZE) == pytest.approx(0.5)
    assert ratio.of(rows, Size(3, 500)) is None
    assert ratio.of([*rows[:2], row("a", "peer", cpu=())], SIZE) is None


def test_ratios_are_of_stages_that_there_are():
    known = {(case.stage, case.by) for case in CASES}
    assert {way for ratio in RATIOS for way in (*ratio.over, ratio.under)} <= known


@pytest.mark.slow
def test_suite_command_prints_and_stores_its_rows(cli, tmp_path: Path):
    chosen = ("-k", "eps_step or cold_step", "--size", "3x5", "--rounds", "1")
    done = cli("suite", *chosen, "--out", str(tmp_path))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "a step of eps against building" in done.stdout  # the column breaks
    stored = json.loads((tmp_path / "suite.json").read_text())
    assert {row["stage"] for row in stored["rows"]} == {"eps_step", "cold_step"}
    assert all(row["cpu_s"] for row in stored["rows"] if row["by"] == OURS)
    assert stored["provenance"]["command"].startswith("python -m benchmarks suite")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--size", "3"), "is no size"), (("--size", "2x50"), "3 to 20 carts"),
        (("-k", "nosuchstage"), "nothing is selected"), (("-k", "("), "error"),
    ],
)  # fmt: skip
def test_bad_words_are_one_sentence(cli, tmp_path, words, sentence):
    done = cli("suite", "--out", str(tmp_path), *words)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())
