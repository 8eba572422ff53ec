"""Models as strangers bring them: abstract ones, half transformed ones, the examples of Pyomo's own documentation, solved by habit."""

import pyomo.environ as pyo
import pytest
from pyomo.mpec import Complementarity, ComplementarityList, complements

from formulations.ipopt import MissingValueError, ModelRefusedError, UnknownOptionError
from formulations.mpec import certify
from tests.formulations.mpec.nearest import nearest, solver


def test_an_instance_of_an_abstract_model():
    abstract = pyo.AbstractModel()
    abstract.n = pyo.Param()
    abstract.i = pyo.RangeSet(abstract.n)
    abstract.goal = pyo.Param(abstract.i, mutable=True)
    abstract.x = pyo.Var(abstract.i, bounds=(0, None))
    abstract.cost = pyo.Objective(rule=lambda m: sum((m.x[i] - m.goal[i]) ** 2 for i in m.i))
    abstract.pair = Complementarity(abstract.i, rule=lambda m, i: complements(m.x[i] >= 0, m.x[i % pyo.value(m.n) + 1] >= 0))
    instance = abstract.create_instance({None: {"n": {None: 3}, "goal": {1: 1.0, 2: 5.0, 3: 2.0}}})
    pyo.assert_optimal_termination(solver().solve(instance))
    assert [instance.x[i].value for i in (1, 2, 3)] == pytest.approx([0, 5, 0], abs=1e-8)  # of three in a ring two must be 0
    instance.goal[1] = 9.0
    pyo.assert_optimal_termination(solver().solve(instance))
    assert certify(instance).holds


def test_the_mpec_of_pyomos_documentation():
    """munson1 and a list, as Pyomo's manual writes them."""
    m = pyo.ConcreteModel()
    m.x1, m.x2, m.x3 = pyo.Var(), pyo.Var(), pyo.Var()
    m.f1 = Complementarity(expr=complements(m.x1 >= 0, m.x1 + 2 * m.x2 + 3 * m.x3 >= 1))
    m.f2 = Complementarity(expr=complements(m.x2 >= 0, m.x2 - m.x3 >= -1))
    m.f3 = Complementarity(expr=complements(m.x3 >= 0, m.x1 + m.x2 >= -1))
    pyo.assert_optimal_termination(solver().solve(m))
    assert certify(m).feasible

    n = pyo.ConcreteModel()
    n.y, n.x1 = pyo.Var(initialize=1.0), pyo.Var(initialize=1.0)
    n.cc = ComplementarityList(rule=[complements(n.y + 2 * n.x1 >= 0, n.x1 >= 0)])
    n.cost = pyo.Objective(expr=(n.y - 1) ** 2 + (n.x1 - 1) ** 2)
    pyo.assert_optimal_termination(solver().solve(n))
    assert min(n.x1.value, n.y.value + 2 * n.x1.value) == pytest.approx(0, abs=1e-10)


def half_transformed(transformation: str) -> pyo.ConcreteModel:
    m = nearest()
    m.part = pyo.Block()
    m.part.z = pyo.Var(bounds=(0, None), initialize=0.5)
    m.part.w = pyo.Var(bounds=(0, None), initialize=0.5)
    m.part.pair = Complementarity(expr=complements(m.part.z >= 0, m.part.w >= 0))
    m.part.row = pyo.Constraint(expr=m.part.z + m.part.w == 1)
    pyo.TransformationFactory(transformation).apply_to(m.part)
    return m


@pytest.mark.parametrize("name", ["mpec_ipopt", "touchstone_ipopt"])
@pytest.mark.parametrize("transformation", ["mpec.nl", "mpec.standard_form"])
def test_a_row_that_is_half_a_complementarity_is_refused(transformation, name):
    """These transformations leave rows that mean a complementarity to a file's reader: solved as rows they would drop it in silence."""
    m = half_transformed(transformation)
    if name == "touchstone_ipopt":
        m.pair.deactivate()
    with pytest.raises(ModelRefusedError, match=r"part\.pair"):
        pyo.SolverFactory(name).solve(m)


def test_a_model_of_which_a_part_is_relaxed_already():
    m = half_transformed("mpec.simple_nonlinear")
    pyo.assert_optimal_termination(solver().solve(m))
    assert (m.x.value, m.y.value) == pytest.approx((0, 2), abs=1e-7)
    assert m.part.z.value * m.part.w.value <= 1e-5


def test_options_in_one_string_and_its_misspellings():
    made = solver()
    pyo.assert_optimal_termination(made.solve(nearest(), options_string="strategy=scholtes max_iter=500"))
    assert made.last_result.options["strategy"] == "scholtes"
    made.set_options("strategi=scholtes")
    with pytest.raises(UnknownOptionError, match="did you mean strategy"):
        made.solve(nearest())
    with pytest.raises(ValueError, match="name=value"):
        solver().solve(nearest(), options_string="tol")
    with pytest.raises(UnknownOptionError, match="max_iter"):
        solver().solve(nearest(), options={"max_itr": 3})


def test_special_ordered_sets_are_refused():
    m = nearest()
    m.z = pyo.Var([1, 2], bounds=(0, 1))
    m.sos = pyo.SOSConstraint(var=m.z, sos=1)
    with pytest.raises(ModelRefusedError, match="special ordered sets"):
        solver().solve(m)


def test_the_start_is_taken_and_one_that_is_not_a_number_is_named():
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(bounds=(0, 4)), pyo.Var(bounds=(0, 4))
    m.cost = pyo.Objective(expr=(m.x - 2) ** 2 + (m.y - 2) ** 2)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    m.x.value, m.y.value = 2.0, 0.0
    solver().solve(m, warmstart=True)
    assert sorted((m.x.value, m.y.value)) == pytest.approx([0, 2], abs=1e-8)
    m.x.set_value(float("nan"), skip_validation=True)
    with pytest.raises(MissingValueError, match="'x'"):
        solver().solve(m, warmstart=True)
