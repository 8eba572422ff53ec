"""Our own FMUs as cells of a campaign: exported, checked, stored, told."""

import csv
import json
import time
import zipfile
from pathlib import Path

import pytest

import models.fmu
import validate.tasks.fmu_checks
from models.catalog import load_scene, scene_names
from reports.records.check_record import StoredRecord
from validate.execution.campaign import CampaignSettings, select
from validate.plan.runs import scene_cost
from validate.tasks.check import Course
from validate.tasks.fmu_checks import VERSIONS, check


def test_every_scene_in_every_version_is_checked_and_quick_says_what_it_leaves_out():
    chosen = CampaignSettings(out=Path(), expression="fmu_check")
    entries, _ = select(chosen)
    assert [(entry.task.scene, entry.task.arguments["version"]) for entry in entries] == [
        (scene, version)
        for version in VERSIONS
        for scene in sorted(scene_names(), key=lambda name: (name != "three_cart", scene_cost(load_scene(name))))
    ]
    assert len({entry.task.key for entry in entries}) == len(entries)
    quick, left_out = select(CampaignSettings(out=Path(), expression="fmu_check", quick=True))
    assert {entry.task.arguments["version"] for entry in quick} == {"2.0"}
    assert {entry.task.scene for entry in quick} == {name for name in scene_names() if load_scene(name).quick}
    assert left_out[-1] == f"FMU, FMI 3.0: {len(scene_names())} checks"


@pytest.mark.slow
def test_a_campaign_checks_an_fmu_stores_it_and_tells_of_it(cli, tmp_path):
    command = ("all", "--scene", "bouncing_mass", "-k", "fmi2", "--out", str(tmp_path))
    done = cli(*command)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FMU: 1 of 1 checks passed" in done.stdout
    assert "[1/1] FMU: bouncing_mass, FMI 2.0: passed, " in done.stderr
    (record,) = (StoredRecord.model_validate_json(path.read_bytes()).root for path in tmp_path.glob("runs/*/record.json"))
    assert record.fmu.count("failed") == 0
    assert record.fmu.count("passed") > 30
    assert len({(row.name, row.type) for row in record.fmu.rows}) == len(record.fmu.rows)
    (row,) = csv.DictReader((tmp_path / "checks.csv").read_text(encoding="utf-8").splitlines())
    assert (row["kind"], row["scene"], row["outcome"], row["passed"]) == ("FMU", "bouncing_mass", "answered", "True")
    assert json.loads((tmp_path / "campaign.json").read_text())["violation"] == [], "nothing was planned for"
    assert "bouncing_mass" in (tmp_path / "pages" / "fmus.html").read_text(encoding="utf-8")
    again = cli(*command, "--json")
    assert "1 stored, 0 to run" in again.stderr
    assert [item["passed"] for item in json.loads(again.stdout)["checks"]] == [True]


@pytest.mark.slow
def test_a_failed_check_of_our_own_is_found_and_named(monkeypatch, tmp_path):
    sound = models.fmu.build_fmu(load_scene("bouncing_mass"), "2.0")

    def defective(scene, version):
        """A description that gives another stiffness than the binary has."""
        path = tmp_path / "defective.fmu"
        with zipfile.ZipFile(sound) as source, zipfile.ZipFile(path, "w") as target:
            for name in source.namelist():
                data = source.read(name)
                if name == "modelDescription.xml":
                    place = data.index(b'start="', data.index(b'causality="parameter"'))
                    data = data[: place + 7] + b"1" + data[place + 7 :]
                target.writestr(name, data)
        return path

    monkeypatch.setattr(validate.tasks.fmu_checks, "build_fmu", defective)
    found = check({"scene": "bouncing_mass", "version": "2.0"}, Course(tmp_path, time.monotonic() + 100.0))
    assert not found.passed
    assert "start values are the XML's (CS)" in found.sentence
    assert found.details["fmu"].failed
    assert (tmp_path / "progress.txt").read_text() == "the check"


@pytest.mark.parametrize("version", VERSIONS)
def test_the_key_is_that_of_the_scene_and_its_sources(version):
    def key(scene: str) -> str:
        (entry,), _ = select(CampaignSettings(out=Path(), scenes=(scene,), expression=f"fmi{version[0]}"))
        return entry.task.key

    assert key("bouncing_mass") == key("bouncing_mass")
    assert key("bouncing_mass") != key("two_body_collision")
