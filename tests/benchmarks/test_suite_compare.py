"""Two runs of the suite: a regression is told from noise, from a busier machine, and from a peer that got slower."""

import json

import pytest

from benchmarks.records import SuiteRecord, SuiteRow, spread
from benchmarks.suite.cases import YARDSTICK
from benchmarks.suite.compare import Kind, compare
from validate.store.provenance import gather

STEADY = (1.00, 1.02, 0.99, 1.01, 0.98)


def row(stage: str, cpu, by: str = "touchstone", memory=(50.0,) * 5, **more) -> SuiteRow:
    values = {
        "stage": stage,
        "title": stage,
        "by": by,
        "n": 3,
        "steps": 500,
        "cpu_s": cpu,
        "memory_mib": memory,
    }
    return SuiteRow.model_validate(values | more)


@pytest.fixture(scope="module")
def suite():
    provenance = gather("test")

    def made(*rows: SuiteRow, yardstick=STEADY) -> SuiteRecord:
        return SuiteRecord(
            kind="suite",
            rows=(row(YARDSTICK, yardstick), *rows),
            figures=(),
            repeats=5,
            provenance=provenance,
        )

    return made


def times(factor: float, samples=STEADY) -> tuple[float, ...]:
    return tuple(factor * sample for sample in samples)


def test_a_stage_that_got_slower_is_a_regression(suite):
    comparison = compare(suite(row("replay", STEADY)), suite(row("replay", times(1.3))))
    (change,) = comparison.regressions
    assert change.quantity == "CPU s"
    assert change.factor == pytest.approx(1.3)
    back = compare(suite(row("replay", times(1.3))), suite(row("replay", STEADY)))
    assert [change.kind for change in back.changes] == [Kind.IMPROVEMENT]
    assert not back.regressions


@pytest.mark.parametrize(
    "now",
    [
        times(1.10),  # less than 15 %
        (0.9, 2.0, 0.95, 1.9, 1.8),  # its median is twice as high, but so it comes out by chance
    ],
)
def test_noise_is_no_regression(suite, now):
    assert not compare(suite(row("replay", STEADY)), suite(row("replay", now))).changes


def test_a_busier_machine_is_no_slower_code(suite):
    comparison = compare(
        suite(row("replay", STEADY)), suite(row("replay", times(2.0)), yardstick=times(2.0))
    )
    assert not comparison.changes
    assert comparison.speed == pytest.approx(2.0)
    hidden = compare(
        suite(row("replay", STEADY)), suite(row("replay", times(1.0)), yardstick=times(0.5))
    )
    assert len(hidden.regressions) == 1, "as fast as before, on a machine twice as fast"


def test_memory_is_not_a_matter_of_the_machine(suite):
    before = suite(row("replay", STEADY))
    (change,) = compare(
        before,
        suite(
            row("replay", times(3.0), memory=(80.0, 81.0, 79.0, 80.0, 80.0)), yardstick=times(3.0)
        ),
    ).regressions
    assert change.quantity == "MiB"
    small = (
        suite(row("replay", STEADY, memory=(1.0,) * 5)),
        suite(row("replay", STEADY, memory=(2.0,) * 5)),
    )
    assert not compare(*small).changes


def test_an_answer_that_is_gone_is_a_regression_and_a_peers_is_not(suite):
    lost = {"cpu": (), "memory": (), "failed": "it crashed."}
    comparison = compare(
        suite(row("replay", STEADY), row("cs_replay", STEADY, by="fmpy")),
        suite(row("replay", **lost), row("cs_replay", **lost, by="fmpy")),
    )
    assert [(change.kind, change.row.stage) for change in comparison.changes] == [
        (Kind.REGRESSION, "replay"),
        (Kind.PEER, "cs_replay"),
    ]
    slower = compare(
        suite(row("cs_replay", STEADY, by="fmpy")), suite(row("cs_replay", times(2.0), by="fmpy"))
    )
    assert [change.kind for change in slower.changes] == [Kind.PEER]


def test_too_few_samples_are_said(suite):
    comparison = compare(suite(row("replay", STEADY[:2])), suite(row("replay", times(3.0)[:2])))
    assert [change.kind for change in comparison.changes] == [Kind.UNTOLD]
    assert "too few" in comparison.changes[0].why


def test_rows_of_one_run_only_are_passed_over(suite):
    comparison = compare(suite(row("replay", STEADY)), suite(row("translate", STEADY)))
    assert (comparison.pairs, comparison.changes) == (0, ())


def test_the_spread_is_that_of_the_middle_half():
    assert spread((1.0, 2.0, 3.0, 4.0, 100.0)) == pytest.approx(2.0 / 3.0)
    assert spread((1.0, 2.0)) is None


@pytest.mark.slow
def test_the_command_measures_compares_and_fails_on_a_regression(cli, tmp_path, suite):
    """`list` against a file in which it took a ten-thousandth of the yardstick."""
    (tmp_path / "earlier.json").write_text(
        suite(row("list", times(1e-4), n=0, steps=0), yardstick=STEADY).model_dump_json()
    )
    chosen = ("-k", "list", "--size", "3x5", "--repeats", "5", "--out", str(tmp_path))
    done = cli("suite", *chosen, "--compare", str(tmp_path / "earlier.json"))
    assert done.returncode == 1, done.stdout + done.stderr
    assert "1 row is in both: 1 regression" in done.stdout
    record = SuiteRecord.model_validate_json((tmp_path / "suite.json").read_text())
    assert [row.stage for row in record.rows] == [YARDSTICK, "list"]
    assert all(len(row.cpu_s) == 5 and min(row.cpu_s) > 0 for row in record.rows)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--size", "3"), "is no size"), (("--size", "2x50"), "3 to 20 carts"),
        (("-k", "nosuchstage"), "nothing is selected"),
        (("-k", "("), "error"), (("--compare", "nosuchfile.json"), "cannot be read"),
    ],
)  # fmt: skip
def test_bad_words_are_one_sentence(cli, tmp_path, words, sentence):
    done = cli("suite", "--quick", "--out", str(tmp_path), *words)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_file_of_another_kind_is_refused(cli, tmp_path):
    (tmp_path / "other.json").write_text(json.dumps({"kind": "scaling", "stages": []}))
    done = cli(
        "suite",
        "-k",
        "translate",
        "--compare",
        str(tmp_path / "other.json"),
        "--out",
        str(tmp_path),
    )
    assert done.returncode == 2
    assert "no record of this suite" in done.stderr
