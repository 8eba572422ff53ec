"""Published problems, typed again: the finding by computer algebra and by energy, the identity of one instance, what the folder has."""

import csv
import importlib.util
import re
from pathlib import Path

import pytest
import sympy as sp

from benchmarks import ROOT
from models.catalog import load_scene
from models.dynamics import derive
from validate.judge.time_step import energy_test

HOME = ROOT / "benchmarks" / "field" / "cartpole_friction"


def rows(name: str) -> list[dict[str, str]]:
    with open(HOME / name, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def scene(name: str):
    return load_scene(str(HOME / f"{name}.py"))


def test_published_step_continuous_limit_counts_coriolis_twice():
    """M v of the next node minus M v of this node, plus h (C v + dV/dq): its limit for h -> 0 is Lagrange's equations plus dM/dt v."""
    t = sp.Symbol("t")
    m_c, m_p, l, g = sp.symbols("m_c m_p l g", positive=True)  # noqa: E741
    x, theta = sp.Function("x")(t), sp.Function("theta")(t)
    q = sp.Matrix([x, theta])
    v = q.diff(t)
    mass = sp.Matrix([[m_c + m_p, m_p * l * sp.cos(theta)], [m_p * l * sp.cos(theta), m_p * l**2]])
    # As published, cartpole.jl lines 35 to 39.
    c_func = sp.Matrix([-m_p * v[1] * l * sp.sin(theta) * v[1], m_p * g * l * sp.sin(theta)])
    published = (mass * v).diff(t) + c_func
    kinetic = (v.T * mass * v)[0] / 2
    potential = -m_p * g * l * sp.cos(theta)
    lagrange = sp.Matrix(
        [
            sp.diff(sp.diff(kinetic, rate), t) - sp.diff(kinetic - potential, place)
            for place, rate in zip(q, v, strict=True)
        ]
    )
    further = sp.simplify(published - lagrange)
    assert further != sp.zeros(2, 1)
    assert sp.simplify(further - mass.diff(t) * v) == sp.zeros(2, 1)
    # M dv/dt in the place of d/dt (M v) leaves no difference: C v itself is right.
    assert sp.simplify(mass * v.diff(t) + c_func - lagrange) == sp.zeros(2, 1)


def test_own_equations_are_the_published_ones():
    physics, own = derive(scene("scene")), derive(scene("own_equations"))
    v = sp.Matrix(physics.v)
    rate = sum((physics.mass_matrix.diff(q) * w for q, w in zip(physics.q, v, strict=True)), sp.zeros(2, 2))  # fmt: skip
    assert own.mass_matrix == physics.mass_matrix
    assert sp.simplify(own.tau - physics.tau + rate * v) == sp.zeros(2, 1)


@pytest.mark.parametrize(("form", "vanishes"), [("published", False), ("corrected", True)])
def test_steps_energy(form: str, vanishes: bool):
    found = energy_test(scene("scene"), f"{HOME / 'steps.py'}:{form}")
    assert found.vanishes == vanishes, found.sentence
    # The published step is a right step of its own continuous equations.
    assert energy_test(scene("own_equations"), f"{HOME / 'steps.py'}:published").vanishes


def test_folder_data_and_source_complete():
    published, table = rows("published.csv"), rows("table.csv")
    assert len(published) == len(table) == 100
    assert [row["name"] for row in published] == [row["instance"] for row in table]
    assert all(row["ipopt_success"] == "true" for row in published)
    text = (HOME / "README.md").read_text(encoding="utf-8")
    assert re.search(r"[0-9a-f]{40}", text)
    for words in ("experiments/models/cartpole.jl", "line 49", "have not been heard", "licence"):
        assert words in text, words


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("casadi") is None, reason="CasADi is not installed")
def test_identity_cost_is_the_published_cost():
    from benchmarks.field.cartpole_friction.problem import PARAMETERS, Form, solve

    row = rows("published.csv")[6]
    found = solve({name: float(row[name]) for name in PARAMETERS}, Form.PUBLISHED)
    assert found.success
    assert found.cost == pytest.approx(float(row["ipopt_cost"]), rel=1e-6)


def test_command_folder_has_no_machine(tmp_path: Path):
    """What is committed names no place of a machine."""
    for path in HOME.iterdir():
        if path.is_file():
            assert "/tmp/" not in path.read_text(encoding="utf-8"), path.name
