"""A hard case in a campaign: selected by its name, measured in a child, stored, used again, and a row of the report."""

from __future__ import annotations

import json

import pytest

from validate.stress.catalog import case_names, describe_case


@pytest.fixture(scope="module")
def campaign(cli, tmp_path_factory):
    out = tmp_path_factory.mktemp("hard")
    return out, cli("all", "-k", "h13 or h12", "--out", str(out))


@pytest.mark.slow
def test_the_cases_are_run_and_pass(campaign):
    out, done = campaign
    assert done.returncode == 0, done.stderr
    assert "hard case: 2 of 2 checks passed" in done.stdout
    records = [json.loads(path.read_text()) for path in out.glob("runs/*/record.json")]
    assert sorted(record["name"][:2] for record in records) == ["12", "13"]
    assert all(record["passed"] and record["figures"] for record in records)


def test_the_report_has_their_rows(campaign):
    text = (campaign[0] / "report.html").read_text(encoding="utf-8")
    assert 'id="stability"' in text
    assert 'id="hard-case-12"' in text
    assert "2 of 2 hard cases pass" in text


@pytest.mark.slow
def test_they_are_used_again(campaign, cli):
    out, _ = campaign
    again = cli("all", "-k", "h13 or h12", "--out", str(out))
    assert again.returncode == 0
    assert "2 stored, 0 to run" in again.stderr


@pytest.mark.slow
def test_a_quick_campaign_says_that_it_leaves_cases_out(cli, tmp_path):
    done = cli("all", "--quick", "-k", "h13 or h03", "--out", str(tmp_path))
    assert "left out by --quick: hard case: 03 Mass ratio 1e-4 .. 1e4" in done.stdout


def test_list_names_them(cli):
    told = json.loads(cli("list", "--json").stdout)["hard cases"]
    assert [item["name"] for item in told] == list(case_names())
    assert {item["name"] for item in told if item["quick"]} == {name for name in case_names() if describe_case(name).quick}
