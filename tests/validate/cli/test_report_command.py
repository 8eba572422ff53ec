"""`report` a second time: the same files, whatever happened to them meanwhile, and what changed is told."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from wording import unsaid

from validate.cli.report import command

pytestmark = pytest.mark.slow

FAKES = ("--plugin", "campaign_fakes:PLUGIN", "--scene", "three_cart")
NAMES = ("report.html", "results.csv", "violation.csv")


@pytest.fixture(scope="module")
def ran(cli, tmp_path_factory) -> Path:
    """A campaign of two cells, and the same again."""
    out = tmp_path_factory.mktemp("told") / "out"
    for _ in range(2):
        done = cli("all", *FAKES, "--out", str(out), "-k", "only_good or soft_alone")
        assert done.returncode == 0, done.stderr
    return out


@pytest.fixture
def folder(ran: Path, tmp_path: Path) -> Path:
    shutil.copytree(ran, tmp_path / "out")
    return tmp_path / "out"


def _report(folder: Path, *options: str) -> Result:
    return CliRunner().invoke(command, [str(folder), *options], standalone_mode=False)


def _texts(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in NAMES}


def test_the_same_files_whatever_happened_to_them(folder: Path):
    tables = {
        name: text for name, text in _texts(folder).items() if name != "report.html"
    }  # the fakes' own report is none
    _report(folder)
    of_campaign = _texts(folder)
    assert tables.items() <= of_campaign.items()
    for name in NAMES:
        (folder / name).unlink() if name != "results.csv" else (folder / name).write_text("edited")
    told = _report(folder)
    assert told.exception is None
    assert _texts(folder) == of_campaign
    rows = json.loads(_report(folder, "--json").stdout)["results"]
    assert sorted({row["pipeline"] for row in rows}) == ["only_good", "soft_alone"]


def test_pages_or_one_file(folder: Path):
    told = _report(folder, "-j", "1")
    assert told.exception is None
    assert f"report:  {folder / 'report.html'}" in told.stdout
    assert {path.name for path in (folder / "pages").iterdir()} == {
        *(
            "scene-three_cart.html",
            "runs.html",
            "robustness.html",
            "time-spent.html",
            "provenance.html",
        ),
        *(f"three_cart--{name}.html" for name in ("only_good", "soft_alone")),
        *("report.css", "report.js"),
    }
    shutil.rmtree(folder / "pages")
    assert f"report:  {folder / 'single.html'}" in _report(folder, "--single-file").stdout
    assert (folder / "single.html").read_text(encoding="utf-8").count('<article class="run"') == 2
    assert not (folder / "pages").exists()


@pytest.mark.parametrize("text", ["{", "{}", "[]"], ids=range(3))
def test_runs_of_a_campaign_whose_own_record_is_damaged_are_shown_all_the_same(
    folder: Path, text: str
):
    (folder / "campaign.json").write_text(text)
    told = _report(folder)
    assert (told.exit_code, told.exception) == (0, None)
    assert not unsaid(told.stderr, "campaign.json cannot be read", "shows the 2 records")
    assert "own record is missing or unreadable" in (folder / "report.html").read_text(
        encoding="utf-8"
    )
    shutil.rmtree(folder / "runs")
    refused = _report(folder)
    assert refused.exit_code != 0, "there is nothing to show"


def test_a_record_that_is_gone_is_told(folder: Path):
    _report(folder)
    shutil.rmtree(next(folder.glob("runs/*")))
    told = _report(folder)
    assert "1 of 2 runs have no readable record" in told.stderr
    assert len((folder / "results.csv").read_text().splitlines()) == 2
    assert "1 of 2 runs have no readable record" in _report(folder).stderr


def test_a_motion_that_is_gone_is_told_and_its_page_drawn_anew(folder: Path):
    _report(folder)
    (lost, *_) = sorted(folder.glob("runs/*/trajectory.nc"))
    name = json.loads((lost.parent / "record.json").read_bytes())["pipeline"]
    page = folder / "pages" / f"three_cart--{name}.html"
    before = page.read_text(encoding="utf-8")
    lost.unlink()
    told = _report(folder)
    assert not unsaid(told.stderr, f"{lost} is gone")
    assert page.read_text(encoding="utf-8") != before


def test_a_campaign_that_ran_nothing_leaves_the_folder_as_it_was(ran: Path, cli):
    before = {
        path: path.read_bytes()
        for path in ran.rglob("*")
        if path.is_file() and path.suffix not in {".csv"}
    }
    done = cli("all", *FAKES, "--out", str(ran), "-k", "soft_alone or only_good", "-j", "1")
    assert "2 stored, 0 to run" in done.stderr
    assert {path: path.read_bytes() for path in before} == before
    part = cli("all", *FAKES, "--out", str(ran), "-k", "only_good")
    assert part.returncode == 0
    assert {path: path.read_bytes() for path in before} == before, (
        "a part leaves the others where they are"
    )


def test_where_no_record_can_be_read_the_tables_are_left_as_they_are(folder: Path):
    tables = {name: text for name, text in _texts(folder).items() if name.endswith(".csv")}
    shutil.rmtree(folder / "runs")
    told = _report(folder)
    assert told.exception is None
    assert not unsaid(told.stderr, "2 of 2 runs have no readable record", "runs them")
    assert {name: text for name, text in _texts(folder).items() if name.endswith(".csv")} == tables
