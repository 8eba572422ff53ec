"""Every stress case: described without being imported, measured (with cheaper parameters where it is long), in a record that passes.

In a campaign it is selected by its name, measured in a child, stored, used again, and a row of the
report.
"""

import importlib
import json
import math
import re

import pytest

from formulations.pipelines import method_names
from models.catalog import scene_names
from models.errors import TouchstoneError, UnknownNameError
from models.results.check import CheckRecord
from models.results.stored import from_json, to_json
from reports.rule import failures
from validate.store.provenance import gather
from validate.stress.case import (
    at_least,
    at_most,
    chart,
    checks,
    finding,
    none_of,
    refusal,
    unlimited,
)
from validate.stress.catalog import FOLDER, case_names, describe_case, heading, load_case
from validate.tasks.check import Found
from validate.tasks.task import task_to_json

NAMES = case_names()
# What is made shorter here; a campaign runs all of it.
CHEAP: dict[str, dict[str, object]] = {
    "h01_stiffness": {"STIFFNESSES": (1.0, 1e4, 1e6), "SWEPT": 2},
    "h02_restitution": {"SWEEP": (0.5, 1.2)},
    "h03_mass_ratio": {"RATIOS": (1e-4, 1e4), "PLANNED": (1e-1, 1e1)},
    "h07_unstable": {"ITERATIONS": 20},
    "h08_long_horizon": {
        "LENGTHS": (500, 2000),
        "MODEL_LENGTHS": (50, 100),
        "EXPONENT": 100.0,
        "TIME_EXPONENT": 100.0,
    },  # seconds are for the campaign
    "h14_creep": {"COEFFICIENTS": (0.05, 0.8), "STEPS": (0.01, 0.005)},
    "h18_hold": {"COUNTS": (10, 40), "FINE": 320},
}


def record_of(name: str, found: Found) -> CheckRecord:
    """The record that a campaign would store, through JSON and back."""
    record = CheckRecord(
        key="0" * 64, kind="stress case", name=heading(name), expected=describe_case(name).expected,
        outcome="answered",
        passed=found.passed, found=found.sentence, figures=found.figures, wall_seconds=1.0,
        cpu_seconds=1.0,
        provenance=gather("a test"), **found.details,
    )  # fmt: skip
    return from_json(CheckRecord, to_json(record))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_case_passes_and_its_record_is_whole(name: str, monkeypatch):
    module = importlib.import_module(f"validate.stress.cases.{name}")
    for constant, value in CHEAP.get(name, {}).items():
        monkeypatch.setattr(module, constant, value)
    found = load_case(name)()
    assert found.passed, [
        f"{figure.name} = {figure.value} (limit {figure.limit}): {figure.meaning}"
        for figure in found.figures
        if not figure.ok
    ]
    record = record_of(name, found)
    assert record.passed
    assert record.found
    assert "\n" not in record.found
    assert failures((), (record,)) == ()
    for figure in record.figures:
        assert figure.value is not None
        assert figure.reason or figure.limit is None, f"{figure.name} has a limit without a reason"
    for drawn in record.charts:
        assert all(len(series.x) == len(series.y) > 0 for series in drawn.series)


@pytest.mark.parametrize("name", NAMES)
def test_a_case_says_what_it_depends_on(name: str):
    """A stored result is used again only while these are the same: names that the file loads must be among them."""
    text, said = (FOLDER / f"{name}.py").read_text(encoding="utf-8"), describe_case(name)
    loaded = set(re.findall(r'load_scene\("(\w+)"\)', text)) | set(
        re.findall(r"from models\.scenes\.(\w+) import", text)
    )
    assert loaded <= set(said.scenes) <= set(scene_names())
    assert (
        set(re.findall(r'(?:load_method\(|solved\(.+?, )"(\w+)"', text))
        <= set(said.methods)
        <= set(method_names())
    )
    module = importlib.import_module(f"validate.stress.cases.{name}")
    assert (module.CASE, module.measure) == (said, load_case(name))


def test_all_rows_are_there_once_and_offered_to_a_campaign():
    assert [int(name[1:3]) for name in NAMES] == sorted({*range(1, 22)} - {13, 15, 17, 20})
    offered = checks(())
    assert [item.name for item in offered] == [heading(name) for name in NAMES]
    assert 0 < sum(item.quick for item in offered) < len(offered)
    assert all(json.dumps(task_to_json(item)) for item in offered)


@pytest.mark.parametrize(
    ("figure", "ok"),
    [
        (at_most("error", 1.0, 1.0, reason="r"), True),
        (at_most("error", 1.1, 1.0, reason="r"), False),
        (at_most("error", math.nan, 1.0, reason="r"), False),
        (at_most("error", -math.inf, 1.0, reason="r"), False),
        (at_least("order", 1.9, 2.0, reason="r"), False),
        (at_least("order", 2.0, 2.0, reason="r"), True),
        (none_of("wrong", ["one thing"], reason="r"), False),
        (none_of("wrong", [], reason="r"), True),
        (unlimited("only told", 5.0), None), (unlimited("only told", math.nan), False),
    ],
)  # fmt: skip
def test_a_figure_keeps_its_limit_or_does_not(figure, ok: bool | None):
    assert figure.ok is ok


def test_a_case_without_a_judged_figure_has_not_passed():
    assert not finding("").passed
    assert not finding("", unlimited("only told", 1.0)).passed


def test_numbers_that_are_none_get_into_no_record():
    drawn = chart(
        "t", x=("x", ""), y=("y", ""), series={"s": ([1.0, 2.0, 3.0], [1.0, math.nan, math.inf])}
    )
    record = record_of(
        NAMES[0],
        finding("two\nlines", at_most("error", math.nan, 1.0, reason="r"), charts=(drawn,)),
    )
    assert not record.passed
    assert record.figures[0].value is None
    assert record.charts[0].series[0].x == (1.0,)
    assert len(failures((), (record,))) == 1


def _raise(error: Exception) -> None:
    raise error


@pytest.mark.parametrize(
    ("act", "wrong"),
    [
        (lambda: _raise(TouchstoneError("eps must be below 1.")), None),
        (
            lambda: _raise(TouchstoneError("eps\nmust be below 1.")),
            "does not name 'eps' or 'sharpness'",
        ),
        (
            lambda: _raise(TouchstoneError("it must be below 1.")),
            "does not name 'eps' or 'sharpness'",
        ),
        (lambda: _raise(ValueError("eps")), "ValueError instead of a sentence"),
        (lambda: None, "it is taken"),
    ],
)
def test_a_refusal_is_one_sentence_that_names_what_is_wrong(act, wrong: str | None):
    found = refusal("it", ["eps", "sharpness"], act)
    assert found == [] if wrong is None else (len(found) == 1 and wrong in found[0])


@pytest.fixture(scope="module")
def campaign(cli, tmp_path_factory):
    out = tmp_path_factory.mktemp("hard")
    return out, cli("all", "-k", "h04 or h12", "--out", str(out))


@pytest.mark.slow
def test_the_cases_are_run_and_pass(campaign):
    out, done = campaign
    assert done.returncode == 0, done.stderr
    assert "stress case: 2 of 2 checks passed" in done.stdout
    records = [json.loads(path.read_text()) for path in out.glob("runs/*/record.json")]
    assert sorted(record["name"][:2] for record in records) == ["04", "12"]
    assert all(record["passed"] and record["figures"] for record in records)


@pytest.mark.slow
def test_the_report_has_their_rows(campaign):
    text = (campaign[0] / "pages" / "stress-cases.html").read_text(encoding="utf-8")
    assert 'id="stress-cases"' in text
    assert 'id="stress-case-12"' in text
    assert "2 of 2 stress cases pass" in text


@pytest.mark.slow
def test_they_are_used_again(campaign, cli):
    out, _ = campaign
    again = cli("all", "-k", "h04 or h12", "--out", str(out))
    assert again.returncode == 0
    assert "2 stored, 0 to run" in again.stderr


@pytest.mark.slow
def test_a_quick_campaign_says_that_it_leaves_cases_out(campaign, cli):
    done = cli("all", "--quick", "-k", "h12 or h03", "--out", str(campaign[0]))
    assert "left out by --quick: stress case: 03 Mass ratio 1e-4 .. 1e4" in done.stdout


def test_list_names_them(cli):
    listed = json.loads(cli("list", "--json").stdout)["stress cases"]
    assert [item["name"] for item in listed] == list(case_names())
    assert {item["name"] for item in listed if item["quick"]} == {
        name for name in case_names() if describe_case(name).quick
    }


def test_a_case_that_there_is_not():
    with pytest.raises(
        UnknownNameError, match=r"no stress case 'stiffness'; did you mean h01_stiffness\?"
    ):
        describe_case("stiffness")
    with pytest.raises(UnknownNameError, match="no stress case 'wrong'; there are h01_stiffness, "):
        describe_case("wrong")
