"""Campaigns of foreign plans: instances and their plans become scenes with a leg that reads; a mistake refuses its instance alone; a whole path to the three answers."""

import csv
import math
import re
from pathlib import Path

import numpy as np
import pytest

from models.catalog import load_scene
from models.trajectory import Trajectory
from models.trajectory_netcdf import write_netcdf
from validate.campaign.campaign import CampaignResult
from validate.campaign.foreign import foreign_references
from validate.campaign.read import RESOLVED, ConfigError, read_campaign
from validate.campaign.runs import CampaignSettings, select

HANGING = '''"""A point on a spring, pushed; the model has a further force."""
import sympy as sp
from models.scene import Coordinate, Input, Parameter, Scene, Task
from models.scene.parts import limits
x, vx, u = sp.symbols("x vx u", real=True)
m, k = sp.symbols("m k", positive=True)
SCENE = Scene(
    name="{name}", title="A point on a spring", source="a test",
    coordinates=(Coordinate(symbol={coordinate}, velocity=vx, unit="m", nominal=1.0),),
    inputs=(Input(symbol=u, unit="N", lower=-5.0, upper=5.0),),
    parameters=(
        Parameter(symbol=m, value=1.0, unit="kg", lower=0.1),
        Parameter(symbol=k, value=4.0, unit="N/m", lower=0.0),
    ),
    kinetic_energy=m * vx**2 / 2, potential_energy=k * {coordinate}**2 / 2,
    forces=({force},), contacts=(),
    task=Task(start=(0.0, 0.0), goal=(), running_cost=u**2, step=0.02, steps=50),
    limits=limits(replay_error=(0.02, "twice the error of the grid")),
)
'''
STEP = """def step(q, v, u, h, p):
    v = v + h * ({force}) / p["m"]
    return q + h * v, v


def nonsense(q, v, u, h, p):
    return q
"""
# The plans' own equations: half the force of the spring is missing.
OWN = "u[0] - p['k'] * q / 2"


def write_plan(path: Path, m: float, k: float, start: float = 0.0, head: str = "") -> None:
    """The steps of `OWN` from a start at rest."""
    h, q, v = 0.02, start, 0.0
    lines = [f"{head}t,x,vx,u"]
    for row in range(51):
        u = 3.0 * math.sin(0.1 * row)
        lines.append(f"{row * h!r},{q!r},{v!r},{u!r}")
        v += h * (u - k * q / 2) / m
        q += h * v
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def field(tmp_path: Path) -> Path:
    """A folder with a scene, a model, a step, three instances and their plans."""
    write = {
        "spring.py": HANGING.format(name="spring", coordinate="x", force="u"),
        "own.py": HANGING.format(name="own", coordinate="x", force="u + k * x / 2"),
        "turned.py": HANGING.format(name="turned", coordinate="x", force="u").replace(
            '"x vx u"', '"y vx u"'
        ),
        "step.py": STEP.format(force=OWN),
        "instances.csv": "name,m,k\na,1.0,4.0\nb,2.0,3.0\nc-3,1.5,5.0\n",
    }
    for name, text in write.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "plans").mkdir()
    for name, m, k in (("a", 1.0, 4.0), ("b", 2.0, 3.0), ("c-3", 1.5, 5.0)):
        write_plan(tmp_path / "plans" / f"{name}.csv", m, k)
    return tmp_path


def campaign(field: Path, head: str = "", **changes: str | None) -> CampaignSettings:
    """The settings of a campaign file. changes: keys of [[plans]], None to leave one out."""
    keys = {
        "scene": "spring.py",
        "instances": "instances.csv",
        "plans": "plans/{name}.csv",
        **changes,
    }
    lines = [head, "[[plans]]"]
    lines += [f'{key} = "{value}"' for key, value in keys.items() if value is not None]
    (field / "field.toml").write_text("\n".join(lines) + "\n")
    return read_campaign(field / "field.toml", out=field / "out")


def names(settings: CampaignSettings) -> list[str]:
    return [entry.task.title for entry in select(settings)[0]]


def test_read_instances_scenes_have_names_and_numbers(field: Path):
    settings = campaign(field, model="own.py")
    assert settings.refused == ()
    assert names(settings) == [
        *("a x plan", "a_own_equations x plan", "b x plan", "b_own_equations x plan"),
        *("c_3 x plan", "c_3_own_equations x plan"),
    ]
    second = settings.chosen[2]
    assert (second.instance, second.judged_by) == ("b", "scene")
    assert {item.name: item.value for item in second.scene.parameters} == {"m": 2.0, "k": 3.0}


def test_read_folder_without_instances_names_from_files(field: Path):
    (field / "plans" / "7.csv").write_bytes((field / "plans" / "a.csv").read_bytes())
    settings = campaign(field, instances=None, plans="plans/*.csv")
    assert names(settings) == ["spring_7 x plan", "a x plan", "b x plan", "c_3 x plan"]


def test_read_resolved_same_keys(field: Path):
    settings = campaign(field, model="own.py", time_step="step.py:step")
    (field / "elsewhere").mkdir()
    resolved = field / "elsewhere" / "again.toml"
    resolved.write_text(settings.files[RESOLVED])
    again = read_campaign(resolved, out=field / "out")
    keys = [[entry.task.key for entry in select(one)[0]] for one in (settings, again)]
    assert keys[0] == keys[1]


def test_read_changed_plan_changed_key_moved_plan_same_key(field: Path):
    before = [entry.task.key for entry in select(campaign(field))[0]]
    (field / "plans").rename(field / "moved")
    moved = [entry.task.key for entry in select(campaign(field, plans="moved/{name}.csv"))[0]]
    assert moved == before
    write_plan(field / "moved" / "b.csv", 2.0, 3.1)
    changed = [entry.task.key for entry in select(campaign(field, plans="moved/{name}.csv"))[0]]
    assert [one == other for one, other in zip(changed, before, strict=True)] == [True, False, True]


def test_read_pipelines_start_from_plan(field: Path):
    settings = campaign(
        field, 'pipelines = ["strict"]', start="plans/a.csv", plans=None, instances="instances.csv"
    )
    assert names(settings) == ["a x strict", "b x strict", "c_3 x strict"]
    methods = [leg.method for leg in settings.chosen[0].pipelines[0].legs]
    assert methods == ["given_plan", "strict_lcp"]


def test_read_two_entries_of_one_instance_share_its_scene(field: Path):
    (field / "field.toml").write_text(
        "".join(
            f'[[plans]]\nname = "{name}"\nscene = "spring.py"\ninstances = "instances.csv"\nplans = "plans/{{name}}.csv"\n'
            for name in ("one", "two")
        )
    )
    settings = read_campaign(field / "field.toml", out=field / "out")
    assert names(settings)[:2] == ["a x one", "b x one"]
    assert "a x two" in names(settings)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("d,1.0,4.0", "instance d: its plan .*d.csv is missing"),
        ("a,1.0,4.0", "instance a: another scene or plan has this name"),
        ("d,-1.0,4.0", "instance d: parameter m: the value -1 kg lies outside its range"),
        ("d,heavy,4.0", "instance d: m is 'heavy', expected a number"),
        ("three_cart,1.0,4.0", "instance three_cart: another scene or plan has this name"),
    ],
)
def test_read_wrong_line_refused_alone(field: Path, line: str, told: str):
    with open(field / "instances.csv", "a") as file:
        file.write(f"{line}\n")
    settings = campaign(field)
    (sentence,) = settings.refused
    assert_told(sentence, told)
    assert len(names(settings)) == 3


def assert_told(sentence: str, told: str) -> None:
    assert re.search(told, sentence), sentence
    assert "\n" not in sentence


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"model": "turned.py"}, r"plans\[1\].model: .*y \[m\].*x \[m\]"),
        ({"instances": "unknown.csv"}, r"plans\[1\].instances: scene spring has no .*'mass'"),
        ({"time_step": "step.py:nonsense"}, "instance e: time step .*shape"),
        ({"time_step": "step.py:none"}, "instance e: .*no function 'none'"),
        ({"plans": "no/{name}.csv", "instances": "bare.csv"}, "instance e: its plan .* is missing"),
        ({"instances": "headless.csv"}, r"plans\[1\].instances: .*column 'name'"),
    ],
)
def test_read_wrong_entry_others_run(field: Path, changes: dict[str, str], told: str):
    (field / "unknown.csv").write_text("name,mass\ne,1.0\n")
    (field / "headless.csv").write_text("m,k\n1.0,4.0\n")
    (field / "bare.csv").write_text("name\ne\n")
    (field / "one.csv").write_text("name,plan\ne,plans/a.csv\n")
    right = (
        '[[plans]]\nscene = "spring.py"\ninstances = "instances.csv"\nplans = "plans/{name}.csv"'
    )
    settings = campaign(field, right, **({"instances": "one.csv", "plans": None} | changes))
    (sentence,) = settings.refused
    assert_told(sentence, told)
    assert names(settings) == ["a x plan", "b x plan", "c_3 x plan"]


def test_read_plan_of_another_instance_refused(field: Path):
    write_plan(field / "plans" / "b.csv", 2.0, 3.0, head="# instance: a\n")
    (sentence,) = campaign(field).refused
    assert_told(sentence, "instance b: plan .* states that it is of 'a'")
    # By the start.
    (field / "instances.csv").write_text("name,m,k,start.x\na,1.0,4.0,0.1\nb,2.0,3.0,0.2\n")
    for name in "ab":
        write_plan(field / "plans" / f"{name}.csv", 1.0, 4.0, start=0.1)
    (sentence,) = campaign(field).refused
    assert_told(sentence, "instance b: its plan starts where instance a starts")


def test_read_netcdf_of_another_instance_refused(field: Path):
    scene = load_scene(str(field / "spring.py"))
    plan = Trajectory(
        t=0.02 * np.arange(51), q=np.zeros((51, 1)), v=np.zeros((51, 1)),
        u=np.zeros((50, 1)), lam=np.zeros((50, 0)),
    )  # fmt: skip
    write_netcdf(field / "plans" / "a.nc", plan, scene)  # written for the scene itself
    write_netcdf(field / "plans" / "b.nc", plan, scene)
    settings = campaign(field, plans="plans/{name}.nc")
    assert [sentence.split(":")[0] for sentence in settings.refused] == ["instance c_3"]


def test_read_nothing_right_is_a_mistake(field: Path):
    with pytest.raises(ConfigError, match="model"):
        campaign(field, model="turned.py")
    with pytest.raises(ConfigError, match="pipeline of ours"):
        campaign(field, name="strict")
    with pytest.raises(ConfigError, match="neither a plan to judge nor a pipeline"):
        campaign(field, plans=None)
    (field / "field.toml").write_text('title = "nothing"\n')
    with pytest.raises(ConfigError, match="scenes: there is none"):
        read_campaign(field / "field.toml")


def test_foreign_references_nothing_planned_nothing_returned(tmp_path: Path):
    assert foreign_references([], tmp_path, ()) == ([], [])


def test_exit_code_refused_instances():
    result = CampaignResult((), (), ("it fails",), (), (), (), None, ("instance a: ..",))
    assert result.exit_code == 2


@pytest.mark.slow
@pytest.mark.whole
def test_run_three_answers_and_resume(cli, field: Path):
    """From a folder of plans to the table: exit code 2 for a refused instance, the others run."""
    with open(field / "instances.csv", "a") as file:
        file.write("d,1.0,4.0\n")
    (field / "field.toml").write_text(
        'pipelines = []\n[[plans]]\nname = "theirs"\nscene = "spring.py"\nmodel = "own.py"\n'
        'instances = "instances.csv"\nplans = "plans/{name}.csv"\ntime_step = "step.py:step"\n'
    )
    command = ("run", str(field / "field.toml"), "--out", str(field / "out"))
    first = cli(*command)
    assert first.returncode == 2, first.stderr
    assert first.stderr.count("instance d: its plan") == 1
    said = (
        "3 foreign plans: 3 solve their own time step, 3 are consistent under their own equations"
    )
    assert said in " ".join(first.stdout.split())
    table = (field / "out" / "plans.csv").read_bytes()
    rows = list(csv.DictReader(table.decode().splitlines()))
    assert [(row["instance"], row["own_time_step"], row["own_equations"]) for row in rows] == [
        (name, "yes", "consistent") for name in ("a", "b", "c_3")
    ]
    assert {(row["physics"], row["meaning"]) for row in rows} == {("violates", "wrong model")}
    page = (field / "out" / "pages" / "plans.html").read_text()
    assert "wrong model" in page
    again = cli(*command)
    assert "6 stored, 0 to run" in again.stderr
    assert (field / "out" / "plans.csv").read_bytes() == table
