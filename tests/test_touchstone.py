"""`import touchstone`: what it costs, what it gives, and what it says when something is wrong."""

import doctest
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from wording import unsaid

import touchstone as ts
from formulations.method import OptionError
from models.errors import SceneError, TouchstoneError, UnknownNameError
from models.plan_table import ArrayTable
from models.trajectory import Trajectory, trajectory_from
from validate.campaign import shown

ROOT = Path(__file__).parents[1]


def python(code: str, folder: Path, *, path: str = str(ROOT)) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": path}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.process
def test_importing_it_imports_neither_solvers_nor_simulators(tmp_path: Path):
    heavy = (
        "pyomo",
        "torch",
        "casadi",
        "fmpy",
        "sympy",
        "scipy",
        "h5py",
        "pydantic",
        "pandas",
        "matplotlib",
        "click",
    )
    found = python(
        f"import sys, touchstone; print([name for name in {heavy} if name in sys.modules])",
        tmp_path,
    )
    assert found.stdout == "[]\n", found.stderr


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("package", ["touchstone", "formulations"])
@pytest.mark.parametrize(
    "first", ["import {}; import pyomo.environ as pyo", "import pyomo.environ as pyo; import {}"]
)
def test_it_registers_both_solvers_before_and_after_pyomo(first: str, package: str, tmp_path: Path):
    code = f"""{first.format(package)}
import sys
from pyomo.contrib.solver.common.factory import SolverFactory
assert "cyipopt" not in sys.modules, "a solver is imported when it is asked for"
from pyomo.mpec import Complementarity, complements
model = pyo.ConcreteModel()
model.x, model.y = pyo.Var(initialize=1.0), pyo.Var(initialize=1.0)
model.distance = pyo.Objective(expr=(model.x - 1) ** 2 + (model.y - 2) ** 2)
pyo.SolverFactory("touchstone_ipopt").solve(model)
print(round(model.x.value, 6), round(model.y.value, 6))
model.contact = Complementarity(expr=complements(model.x >= 0, model.y >= 0))
pyo.SolverFactory("mpec_ipopt").solve(model)
print(round(abs(model.x.value), 6), round(model.y.value, 6))
print(SolverFactory("mpec_ipopt").name, SolverFactory("touchstone_ipopt").name)
"""
    found = python(code, tmp_path)
    assert found.stdout == "1.0 2.0\n0.0 2.0\nmpec_ipopt touchstone_ipopt\n", found.stderr


def test_every_name_is_there_and_says_what_it_is():
    assert dir(ts) == sorted(ts.__all__)
    for name in ts.__all__:
        assert getattr(ts, name).__doc__, name
    with pytest.raises(AttributeError, match=r"no attribute 'slove'.*solve"):
        _ = ts.slove


@pytest.mark.slow
def test_its_examples_run():
    assert doctest.testmod(ts, extraglobs={"ts": ts}).failed == 0
    plan = ts.solve("three_cart", "softplus_dc", eps=1e-3)
    assert doctest.testmod(shown, extraglobs={"ts": ts, "plan": plan}).failed == 0


@pytest.fixture(scope="module")
def plan() -> ts.Solution:
    return ts.solve("three_cart", "softplus_dc", eps=1e-3)


@pytest.mark.slow
def test_a_method_and_a_pipeline_give_the_plans_of_a_campaign(plan: ts.Solution):
    scene = ts.scene("three_cart")
    whole = ts.solve(scene)
    assert whole.method == "strict_lcp"
    again = ts.solve(scene, "softplus_dc", eps=1e-3)
    assert np.array_equal(plan.trajectory.q, again.trajectory.q)
    verdict = ts.judge(scene, whole)
    assert verdict.holds
    assert str(verdict).startswith("holds: ")
    assert not ts.judge(scene, plan).holds, "it is relaxed"


@pytest.mark.slow
def test_a_warm_start_and_options_reach_the_method(plan: ts.Solution):
    short = ts.solve("three_cart", "softplus_gd", eps=1e-3, start=plan, iterations=1)
    assert short.outcome is ts.Outcome.ITERATION_LIMIT
    assert short.iterations == 1
    assert short.cost == pytest.approx(plan.cost, rel=0.05), "one step from the plan it was given"


def columns(unit: float = 1.0) -> dict[str, np.ndarray]:
    """Of a plan of three_cart at rest, its times in this unit [s]."""
    start, t = ts.scene("three_cart").task.start, np.linspace(0.0, 5.0 / unit, 501)
    still = dict(zip(("q1", "q2", "q3", "v1", "v2", "v3"), np.tile(start, (501, 1)).T, strict=True))
    return {"t": t, **still, "u1": np.zeros(501), "u3": np.zeros(501)}


def resting() -> Trajectory:
    scene = ts.scene("three_cart")
    return trajectory_from(ArrayTable(columns()), scene)


def test_a_plan_whose_times_are_in_another_unit_is_refused_before_it_is_replayed():
    with pytest.raises(TouchstoneError) as caught:
        ts.judge("three_cart", columns(1e-9))
    assert not unsaid(
        str(caught.value), "plan", "5e+09 s", "three_cart lasts 5 s", "Give t in seconds"
    )


def test_a_scene_is_itself():
    scene = ts.scene("three_cart")
    assert ts.scene(scene) is scene


@pytest.mark.parametrize(
    ("call", "kind", "parts"),
    [
        (
            lambda: ts.solve("three_cart", "softplus_dc"),
            OptionError,
            ("softplus_dc", "eps", "0 < eps < 1"),
        ),
        (
            lambda: ts.solve("three_cart", "strict_lcpp"),
            UnknownNameError,
            ("'strict_lcpp'", "did you mean strict_lcp"),
        ),
        (
            lambda: ts.solve("three_cart", "nothing_like_it"),
            UnknownNameError,
            ("pipelines", "methods", "mpcc"),
        ),
        (
            lambda: ts.solve("three_cart", "softplus_dc+strict", eps=1e-3),
            OptionError,
            ("pipeline softplus_dc+strict", "leave them out"),
        ),
        (lambda: ts.solve("three_cart", "mpcc", wrong=1), OptionError, ("mpcc", "'wrong'")),
        (
            lambda: ts.solve("three_cart", "mpcc", start="no_such.csv"),
            TouchstoneError,
            ("no_such.csv",),
        ),
        (
            lambda: ts.solve("three_cart", "mpcc", start=7),
            TouchstoneError,
            ("int is no plan", "CSV"),
        ),
        (lambda: ts.scene("three_carts"), TouchstoneError, ("three_carts", "three_cart")),
        (lambda: ts.judge("three_cart", "plan.csv", map="map.toml"), SceneError, ("map", "FMU")),
        (lambda: ts.read_plan("no_such.csv", "three_cart"), TouchstoneError, ("no_such.csv",)),
        (lambda: ts.judge("no_such.fmu", "plan.csv"), TouchstoneError, ("no_such.fmu",)),
        (lambda: ts.campaign("out", scenes=["three_carts"]), TouchstoneError, ("three_carts",)),
        (lambda: ts.campaign("out", scenes="three_carts"), TouchstoneError, ("'three_carts'",)),
        (lambda: ts.campaign(""), TouchstoneError, ("out: '' must be a name",)),
        (lambda: ts.campaign("out", select=3), TouchstoneError, ("select: 3",)),
        (lambda: ts.campaign("out", jobs=1.5), TouchstoneError, ("jobs: 1.5", "whole number")),
        (
            lambda: ts.campaign("out", time_limit=float("nan")),
            TouchstoneError,
            ("time_limit: nan", "seconds"),
        ),
        (lambda: ts.solve(3, "mpcc"), SceneError, ("a int is no scene",)),
        (lambda: ts.solve("three_cart", []), UnknownNameError, ("'[]'", "mpcc")),
        (
            lambda: ts.solve("three_cart", "mpcc", time_limit="x"),
            TouchstoneError,
            ("time_limit: 'x'", "seconds"),
        ),
        (lambda: ts.read_plan("plan.csv", None), SceneError, ("NoneType is no scene",)),
        (lambda: ts.export_fmu(3, "out.fmu"), SceneError, ("a int is no scene",)),
        (lambda: ts.export_fmu("hopper", None), TouchstoneError, ("path: None",)),
        (
            lambda: resting().to_dataframe("three_cart"),
            TouchstoneError,
            ("a str is no scene", "touchstone.scene"),
        ),
        (lambda: ts.judge("three_cart", {**columns(), "q1": {0: 1.0}}), TouchstoneError, ("q1",)),
    ],
    ids=lambda value: "",
)
def test_a_mistake_is_one_sentence(
    call,
    kind: type[Exception],
    parts: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(kind) as caught:
        call()
    for part in parts:
        assert not unsaid(str(caught.value), part)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_table_has_the_columns_of_a_csv():
    scene = ts.scene("three_cart")
    t = np.linspace(0.0, 1.0, 3)
    q, v = np.arange(9.0).reshape(3, 3), 10.0 + np.arange(9.0).reshape(3, 3)
    trajectory = ts.Trajectory(
        t=t, q=q, v=v, u=np.array([[1.0, 2.0], [3.0, 4.0]]), lam=np.array([[5.0, 6.0], [7.0, 8.0]])
    )
    table = trajectory.to_dataframe(scene)
    assert list(table) == [
        "t",
        "q1",
        "q2",
        "q3",
        "v1",
        "v2",
        "v3",
        "u1",
        "u3",
        "lam_left",
        "lam_right",
    ]
    assert table.iloc[1].tolist() == [0.5, 3.0, 4.0, 5.0, 13.0, 14.0, 15.0, 3.0, 4.0, 7.0, 8.0]
    assert table.iloc[2, 7:].isna().all()
    assert (
        repr(trajectory)
        == "Trajectory(2 steps, 1 s, 3 positions, 2 inputs, 2 contact forces, zero_order, no scheme declared)"
    )


@pytest.mark.slow
def test_an_exported_fmu_is_the_scenes(tmp_path: Path):
    written = ts.export_fmu("two_body_collision", tmp_path / "collision.fmu")
    assert written == tmp_path / "collision.fmu"
    with pytest.raises(TouchstoneError, match="cannot be written"):
        ts.export_fmu("two_body_collision", tmp_path / "nowhere" / "collision.fmu")


@pytest.mark.slow
def test_arrays_by_name_are_judged_on_somebodys_fmu(tmp_path: Path):
    """The FMU of a scene as anybody's: by equal names, from a file, from arrays and from a DataFrame."""
    pandas = pytest.importorskip("pandas")
    scene = ts.scene("three_cart")
    fmu = ts.export_fmu(scene, tmp_path / "carts.fmu")
    t = np.linspace(0.0, 0.5, 51)
    columns = {"t": t, "u1": np.sin(t)[:-1], "u3": np.cos(t)[:-1]}
    arrays = ts.judge(fmu, columns)
    padded = {
        name: np.append(values, np.nan) if len(values) < len(t) else values
        for name, values in columns.items()
    }
    frame = pandas.DataFrame(padded)
    frame.to_csv(tmp_path / "plan.csv", index=False)
    assert str(arrays).startswith("not applicable: inputs alone claim nothing")
    for again in (ts.judge(fmu, frame), ts.judge(str(fmu), tmp_path / "plan.csv")):
        assert str(again) == str(arrays)
        assert np.array_equal(again.replay.q, arrays.replay.q)
    with pytest.raises(TouchstoneError, match=r"no names.*FMU.*arrays by column name"):
        ts.judge(
            fmu,
            ts.Trajectory(
                t=t,
                q=np.zeros((51, 3)),
                v=np.zeros((51, 3)),
                u=np.zeros((50, 2)),
                lam=np.zeros((50, 2)),
            ),
        )


@pytest.mark.process
@pytest.mark.parametrize("name", ["models", "formulations", "validate", "reports"])
@pytest.mark.parametrize(
    "code", ["import touchstone", "import runpy; runpy.run_module('touchstone')"]
)
def test_a_package_of_the_same_name_is_named_in_one_sentence(name: str, code: str, tmp_path: Path):
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("")
    found = python(code, tmp_path, path=f"{tmp_path}{os.pathsep}{ROOT}")
    last = found.stderr.strip().splitlines()[-1]
    assert last.startswith("ImportError: touchstone needs its own package")
    for part in (repr(name), str(tmp_path / name), "rename", "`touchstone`"):
        assert part in last


@pytest.mark.process
@pytest.mark.parametrize("name", ["models", "formulations", "reports"])
def test_a_command_says_so_too(name: str, tmp_path: Path):
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    found = subprocess.run(
        [sys.executable, "-m", "validate", "list"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (found.returncode, found.stdout) == (2, "")
    assert found.stderr.startswith("touchstone needs its own package")
    assert str(tmp_path / name) in found.stderr
    assert found.stderr.count("\n") == 1


@pytest.mark.process
def test_the_installed_command_works_beside_them(tmp_path: Path):
    for name in ("models", "formulations", "validate", "reports"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError")
    code = "import sys; sys.argv = ['touchstone', 'list']; sys.path.remove(''); from validate.__main__ import main; main()"
    found = python(code, tmp_path)
    assert found.returncode == 0, found.stderr
    assert "three_cart" in found.stdout
