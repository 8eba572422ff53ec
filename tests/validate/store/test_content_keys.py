"""The key of a cell: another one for every option, eps, order and scene, and for a changed module beside a scene's file, the same for the same; scenes and plans as the report reads them."""

import ast
import math
import os
import platform
from dataclasses import Field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from killed_campaigns import FAKES_FOLDER

from formulations.method import Leg, Pipeline
from formulations.pipelines import load_method, method_names
from models.catalog import load_scene
from models.kinematics import pose_columns, shape_places
from models.netcdf import read_columns
from models.scene.text import scene_text
from models.trajectory import Trajectory, uniform_grid
from models.trajectory_netcdf import write_netcdf
from validate.campaign.campaign import run_campaign
from validate.campaign.runs import CampaignSettings, select, with_stored
from validate.cli.narrator import PlainNarrator
from validate.processes.process import ROOT
from validate.store import provenance
from validate.store.provenance import content_key, source_digests
from validate.store.store import Store
from validate.tasks.check import check_key
from validate.tasks.task import CheckTask


def key(
    *legs: Leg, scene: str = "wall_pendulum", name: str = "same", title: str = "one title"
) -> str:
    entries, _ = select(
        CampaignSettings(
            out=Path("nowhere"),
            scenes=(scene,),
            expression="same",
            pipelines=(Pipeline(name=name, title=title, legs=legs),),
        )
    )
    (entry,) = entries
    return entry.task.key


def others(item: Field[Any]) -> list[object]:
    """Values of an option that are not its default: all others of a choice, the nearest numbers (two away where they may have to be even)."""
    default, bounds = item.default, (item.metadata["lower"], item.metadata["upper"])
    if item.metadata["choices"]:
        return [choice for choice in item.metadata["choices"] if choice != default]
    if default is None:
        return [bound for bound in bounds if math.isfinite(bound)]
    if isinstance(default, tuple):
        return [default[:-1], (*default[:-1], math.nextafter(default[-1], math.inf))]
    near = (
        [default - 2, default + 2]
        if isinstance(default, int)
        else [math.nextafter(default, -math.inf), math.nextafter(default, math.inf)]
    )
    return [value for value in near if bounds[0] <= value <= bounds[1]]


@pytest.mark.slow
@pytest.mark.parametrize("name", method_names())
def test_every_option_of_every_method_has_a_key_of_its_own(name: str):
    method = load_method(name)
    asked = Leg(method=name, schedule=(1e-2 if method.needs_eps else None,))
    options = fields(method.options)
    changed = [{item.name: value} for item in options for value in others(item)]
    assert {name for variant in changed for name in variant} == {item.name for item in options}, (
        "each option in turn"
    )
    keys = [key(replace(asked, options=variant)) for variant in changed]
    assert len({key(asked), *keys}) == 1 + len(changed)
    by_stage = [key(replace(asked, stage_options=(variant,))) for variant in changed]
    assert by_stage == keys, "it is what a stage is given that counts, not how"
    assert key(replace(asked, options={item.name: item.default for item in options})) == key(asked)


SOFT = Leg(method="softplus_dc", schedule=(1e-3, 1e-5))
STRICT = Leg(method="strict_lcp")


@pytest.mark.slow
def test_whatever_is_asked_otherwise_has_another_key():
    variants = {
        "as it is": key(SOFT, STRICT),
        "another eps": key(replace(SOFT, schedule=(1e-3, math.nextafter(1e-5, 1.0))), STRICT),
        "the same eps in another order": key(replace(SOFT, schedule=(1e-5, 1e-3)), STRICT),
        "a stage less": key(replace(SOFT, schedule=(1e-3,)), STRICT), "a method less": key(SOFT),
        "the methods the other way round": key(STRICT, SOFT),
        "an option of one stage": key(replace(SOFT, stage_options=({"max_iterations": 7},)),
                                      STRICT),
        "an option of the other stage": key(replace(SOFT,
            stage_options=({}, {"max_iterations": 7})), STRICT),
        "another scene": key(SOFT, STRICT, scene="three_cart"),
        "another name": key(SOFT, STRICT, name="same_otherwise"),
    }  # fmt: skip
    assert len(set(variants.values())) == len(variants)
    assert key(SOFT, STRICT) == variants["as it is"]


@pytest.mark.slow
def test_another_linear_solver_or_library_has_another_key(monkeypatch: pytest.MonkeyPatch):
    ours = key(STRICT)
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "mumps")
    theirs = key(STRICT)
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "another")
    assert len({ours, theirs, key(STRICT)}) == 3
    monkeypatch.delenv("TOUCHSTONE_LINEAR_SOLVER")
    assert key(STRICT) == ours
    versions = provenance.library_versions()
    for name in versions:
        monkeypatch.setattr(
            provenance, "library_versions", lambda name=name: {**versions, name: "another"}
        )
        assert key(STRICT) != ours, name


SOURCES = provenance._source_digests()
# A file of ours, and whether it decides: a run of strict_lcp, a check of nothing but models/fmu,
# one that names no sources, which has all.
DECIDES = {
    "models/fmu/package.py": (True, True, True), "models/dynamics.py": (True, False, True),
    "formulations/methods/strict_lcp.py": (True, False, False),
    "formulations/methods/mpcc.py": (False, False, False),
    "models/scenes/three_cart.py": (False, False, False),
    "validate/tasks/check.py": (False, True, True),
    "validate/judge/score/measures.py": (True, False, True),
    "models/results/run.py": (True, True, True),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("changed", DECIDES)
def test_a_key_is_of_the_sources_that_decide_and_of_no_others(
    changed: str, monkeypatch: pytest.MonkeyPatch
):
    assert changed in SOURCES, "or nothing would be changed"
    one = CheckTask(kind="k", name="n", expected="e", function="f", sources=("models/fmu",))
    whole = replace(one, sources=())

    def keys() -> tuple[str, ...]:
        return key(STRICT), check_key(one), check_key(whole)

    before = keys()
    monkeypatch.setattr(
        provenance, "_source_digests", lambda: {**SOURCES, changed: "another digest"}
    )
    monkeypatch.setattr(provenance, "_digest_of_sources", provenance._digest_of_sources.__wrapped__)
    assert tuple(now != then for now, then in zip(keys(), before, strict=True)) == DECIDES[changed]


def test_a_record_says_where_it_came_from():
    told = provenance.gather("python -m validate all")
    assert told.platform == platform.platform()
    assert told.python.split() == [platform.python_implementation(), platform.python_version()]
    assert told.cores == len(os.sched_getaffinity(0))
    assert told.threads == 1
    assert told.command == "python -m validate all"
    assert told.packages == {
        name: version for name, version in provenance.library_versions().items() if name != "python"
    }
    information = Path("/proc/cpuinfo")
    if information.exists():
        models = {
            line.partition(":")[2].strip()
            for line in information.read_text(encoding="utf-8").splitlines()
            if line.startswith("model name")
        }
        assert not models or any(model in told.cpu for model in models)


SCENE = load_scene("three_cart")
OSCILLATOR = Path(__file__).parents[2] / "scenes" / "oscillator.py"


def _plan(steps: int = 500) -> Trajectory:
    q = np.tile([2.0, 2.6, 3.0], (steps + 1, 1))  # gaps 0.1 and -0.1
    q[:, 0] += np.linspace(0.0, 0.05, steps + 1)
    return Trajectory(
        t=uniform_grid(0.01, steps),
        q=q,
        v=np.zeros_like(q),
        u=np.ones((steps, 2)),
        lam=np.full((steps, 2), 2.0),
    )


def test_files_of_plans_have_gaps_and_poses(tmp_path):
    write_netcdf(tmp_path / "trajectory.nc", _plan(), SCENE)
    columns, _ = read_columns(tmp_path / "trajectory.nc")
    assert columns["gap_left"].values[0] == pytest.approx(0.1)
    assert columns["gap_left"].values[-1] == pytest.approx(0.05)
    assert columns["gap_right"].values[0] == pytest.approx(-0.1)
    # Of a cart x is a coordinate, and the rest never changes.
    assert shape_places(SCENE)[0] == ("q1", 0.25, 0.0)
    assert not [name for name in columns if name.startswith("pose_")]


def test_files_hold_poses_that_are_functions_of_coordinates(tmp_path):
    scene = load_scene("cart_pole_walls")
    q = np.array([[0.5, 0.0], [0.5, np.pi / 2]])
    assert shape_places(scene)[0] == ("x", -0.05, 0.0)
    assert shape_places(scene)[1] == (None, None, None)
    columns = {column.name: column for column in pose_columns(scene, q, "node")}
    length = scene.parameter_values[next(p.symbol for p in scene.parameters if p.name == "l")]
    assert columns.keys() == {"pose_x_2", "pose_y_2", "pose_angle_2"}
    assert columns["pose_x_2"].values == pytest.approx([0.5, 0.5 + length / 2])
    assert columns["pose_y_2"].values == pytest.approx([length / 2, 0.0], abs=1e-6)
    assert columns["pose_angle_2"].values == pytest.approx([np.pi / 2, 0.0], abs=1e-5)
    assert (columns["pose_x_2"].description, columns["pose_angle_2"].unit) == ("x of pole", "rad")


def test_a_key_is_content():
    stages = [("strict_lcp", None, {"a": "1"})]
    key = content_key(SCENE, stages, ["strict_lcp"])
    assert key == content_key(load_scene("three_cart"), [list(stages[0])], ["strict_lcp"])
    others = [
        content_key(SCENE.with_parameters(k=31.0), stages, ["strict_lcp"]),
        content_key(SCENE.with_task(steps=499), stages, ["strict_lcp"]),
        content_key(SCENE, [("strict_lcp", None, {"a": "2"})], ["strict_lcp"]),
        content_key(SCENE, stages, ["strict_lcp"], "another judge"),
    ]  # fmt: skip
    assert len({key, *others}) == 5


def test_a_scene_text_sees_assumptions_and_every_field():
    contact = SCENE.contacts[0]
    weaker = replace(contact, penetration=sp.Symbol("d") - sp.Symbol("q2"))
    stronger = replace(contact, penetration=sp.Symbol("d", positive=True) - sp.Symbol("q2"))
    assert scene_text(weaker) != scene_text(stronger)
    assert "replay_terminal_velocity_error" in scene_text(SCENE)


def _imported_reports(name: str) -> set[str]:
    """Modules of the room of reports that a file of ours imports when it runs."""
    tree = ast.parse((ROOT / name).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = [ast.Pass()]
    found = {
        node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module
    }
    return {f"{module.replace('.', '/')}.py" for module in found if module.startswith("reports.")}


@pytest.mark.slow
def test_whatever_writes_records_is_part_of_their_keys():
    """Of the files that count, each imports of the room of reports only what counts too, or what tells of records that are written already."""
    counted = provenance._source_digests()
    # the last is of a page of one plan, which no run stores
    telling = {"reports/load.py", "reports/render.py"}
    imported = {name: _imported_reports(name) for name in counted if name.endswith(".py")}
    assert "reports/paper.py" in imported["validate/tasks/paper.py"]
    assert {
        name: missing
        for name, modules in imported.items()
        if (missing := modules - set(counted) - telling)
    } == {}
    # a cell's record holds columns of numbers and the paper's figures
    assert {"models/results/run.py", "reports/paper.py"} <= set(source_digests(["strict_lcp"]))
    assert "models/results/check.py" not in source_digests(["strict_lcp"])


def test_the_file_of_a_scene_without_contacts_or_inputs_has_its_motion_alone(tmp_path):
    scene = load_scene(str(OSCILLATOR))
    assert (scene.nc, scene.nu) == (0, 0)
    nodes = 4
    q = np.linspace(0.0, 0.3, nodes)[:, None]
    write_netcdf(
        tmp_path / "trajectory.nc",
        Trajectory(t=uniform_grid(0.1, 3), q=q, v=0 * q, u=np.zeros((3, 0)), lam=np.zeros((3, 0))),
        scene,
    )
    columns, _ = read_columns(tmp_path / "trajectory.nc")
    assert columns.keys() == {"t", scene.coordinates[0].name, scene.coordinates[0].velocity_name}
    assert columns[scene.coordinates[0].name].values == pytest.approx(q[:, 0])


OWN_SCENE = """
import sympy as sp
from dataclasses import replace
from models.catalog import load_scene
from parts_ import Soft, START

scene = load_scene("three_cart")
SCENE = replace(scene, name="own", potential_energy=Soft(scene.coordinates[0].symbol), task=replace(scene.task, start=START))
"""
PARTS = """
import sympy as sp
START = (0.0, 1.0, 2.0, 0.0, 0.0, 0.0)

class Soft(sp.Function):
    def fdiff(self, argindex=1):
        return {stiffness} * self.args[0]

    def _ccode(self, printer):
        return f"({stiffness} * pow({{printer._print(self.args[0])}}, 2) / 2)"

    def _eval_evalf(self, prec):
        return ({stiffness} * self.args[0] ** 2 / 2).evalf()
"""


@pytest.mark.slow
def test_a_changed_module_is_noticed_and_the_old_one_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("PYTHONPATH", str(FAKES_FOLDER))
    monkeypatch.chdir(tmp_path)
    scene, parts, out = (
        tmp_path / "scenes" / "own.py",
        tmp_path / "scenes" / "parts_.py",
        tmp_path / "out",
    )
    scene.parent.mkdir()
    scene.write_text(OWN_SCENE)

    def settings(stiffness: float) -> CampaignSettings:
        parts.write_text(PARTS.format(stiffness=stiffness))
        return CampaignSettings(
            out=out,
            plugin="campaign_fakes:PLUGIN",
            scenes=("scenes/own.py",),
            expression="=only_good",
        )

    (first,) = run_campaign(settings(1.0), PlainNarrator()).records
    assert first.outcome == "solved", first.log_tail
    (harder,) = run_campaign(
        settings(2.0), PlainNarrator()
    ).records  # of which the expressions of the scene say nothing
    assert first.key != harder.key
    assert len(list((out / "runs").iterdir())) == 2
    (back,) = with_stored(select(settings(1.0))[0], Store(out), settings(1.0))
    assert back.stored == first
