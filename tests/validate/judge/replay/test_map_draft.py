"""The map that `new --map` writes has everything the FMU declares, loads, and takes its plan."""

import csv
import io
from pathlib import Path

import foreign_fmu
import pytest
from foreign_fmu import build_foreign

from models.catalog import load_scene
from models.fmu import build_fmu
from models.plan_table import PlanTable
from validate.fmi.description import read_package
from validate.judge.replay.map_draft import draft_map
from validate.judge.replay.map_schema import MapFile, read_map
from validate.judge.replay.mapping import wire

UNITS = """<UnitDefinitions>
  <Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>
  <Unit name="mm/s"><BaseUnit m="1" s="-1" factor="0.001"/></Unit>
  <Unit name="kN"><BaseUnit kg="1" m="1" s="-2" factor="1000"/></Unit>
</UnitDefinitions>
<DefaultExperiment startTime="2" stopTime="2.5" stepSize="0.05"/>
<ModelVariables>"""


def drafted(fmu: Path, folder: Path) -> tuple[MapFile, list[list[str]], str]:
    """The map as it is read, the plan's rows, and the text; the plan fits the map."""
    package = read_package(fmu)
    draft = draft_map(package)
    file, plan = folder / "draft.toml", folder / "draft.csv"
    file.write_text(draft.text, encoding="utf-8")
    plan.write_text(draft.plan, encoding="utf-8")
    wire(package, PlanTable(plan), read_map(file), None, f"map {file}")
    return read_map(file), list(csv.reader(io.StringIO(draft.plan))), draft.text


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_draft_of_a_scene_has_states_bounds_contacts_and_time(fmi: str, tmp_path: Path):
    scene = load_scene("three_cart")
    found, rows, text = drafted(build_fmu(scene, version=fmi), tmp_path)
    assert [item.name for item in scene.coordinates] == list(found.positions)
    assert [item.variable for item in found.velocities.values()] == ["v1", "v2", "v3"]
    assert {name: (item.lower, item.upper) for name, item in found.inputs.items()} == {
        item.name: (item.lower, item.upper) for item in scene.inputs
    }
    assert {name: entry.gap.variable for name, entry in found.contacts.items() if entry.gap} == {
        "left": "gap_left",
        "right": "gap_right",
    }
    assert found.task.duration == scene.task.horizon
    assert '# "q2" = 3.0' in text
    assert '# "k" = 30.0  # [N/m]' in text
    assert rows[0] == ["t", "u1", "u3"]
    assert float(rows[-1][0]) == scene.task.horizon


def test_draft_with_defined_units_scales_to_si(tmp_path: Path, monkeypatch):
    given = foreign_fmu.DESCRIPTION.replace("<ModelVariables>", UNITS).replace(
        'unit="kN" start="0"', 'unit="kN" start="0.5"'
    )
    monkeypatch.setattr(foreign_fmu, "DESCRIPTION", given)
    found, rows, _ = drafted(build_foreign(tmp_path / "cart.fmu"), tmp_path)
    force, place = found.inputs["drive.force"], found.positions["body.pos"]
    assert (force.scale, force.unit, force.lower, force.upper) == (0.001, "N", -1000.0, 1000.0)
    assert (place.scale, place.unit) == (0.001, "m")
    assert found.velocities["body.pos"].scale == 0.001
    assert found.task.duration == 0.5
    assert rows[1] == ["2.0", "500.0"]
    assert len(rows) == 12
    assert rows[-1] == ["2.5", ""]


def test_draft_leaves_undefined_units_to_the_user(tmp_path: Path):
    found, rows, text = drafted(build_foreign(tmp_path / "cart.fmu"), tmp_path)
    assert found.positions["body.pos"].scale == 1.0
    assert "# in kN, which the FMU does not define: choose scale and unit" in text
    assert "# stop.gap  # [mm]" in text
    assert found.task.duration is None
    assert len(rows) == 102


def test_draft_of_an_input_called_time_has_a_column_of_its_own(tmp_path: Path, monkeypatch):
    given = foreign_fmu.DESCRIPTION.replace('"drive.force"', '"Time"')
    monkeypatch.setattr(foreign_fmu, "DESCRIPTION", given)
    found, rows, _ = drafted(build_foreign(tmp_path / "cart.fmu"), tmp_path)
    assert found.inputs["fmu_Time"].variable == "Time"
    assert rows[0] == ["t", "fmu_Time"]


def test_draft_goals_and_limits_uncommented_load(tmp_path: Path):
    """All positions and velocities at the end, and a limit on each kind."""
    fmu = build_fmu(load_scene("two_body_collision"))
    found, _, text = drafted(fmu, tmp_path)
    head, ends = text.split("[goal]")
    ends = ends.split("\n\n# Further outputs")[0].replace("\n# ", "\n")
    file, plan = tmp_path / "chosen.toml", tmp_path / "draft.csv"
    file.write_text(f"{head}[goal]{ends}", encoding="utf-8")
    chosen = read_map(file)
    wire(read_package(fmu), PlanTable(plan), chosen, None, f"map {file}")
    rates = [item.column for item in found.velocities.values()]
    assert set(chosen.goal) == {*found.positions, *rates}
    assert len(rates) == 2
