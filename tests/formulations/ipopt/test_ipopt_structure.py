"""What is read once, what is read again, and what is refused."""

import numpy as np
import pyomo.environ as pyo
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.gdp import Disjunct, Disjunction
from pyomo.mpec import Complementarity, complements

from formulations.ipopt import (
    MissingValueError,
    ModelRefusedError,
    StructureChangedError,
    compile_model,
    load,
    solve,
)


def small():
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], bounds=(-5, 5), initialize=1.0)
    m.z = pyo.Var(initialize=2.0)
    m.z.fix()
    m.p = pyo.Param(initialize=3.0, mutable=True)
    m.e = pyo.Expression(expr=m.p * m.x[1] + m.z * pyo.sin(m.x[2]))
    m.c = pyo.Constraint(expr=m.e == m.p)
    m.d = pyo.Constraint(expr=(-m.p, m.x[1] * m.z, m.p**2))
    m.cost = pyo.Objective(expr=m.x[1] ** 2 + m.z * m.x[2] ** 2 + m.p)
    return m


def agrees(m, problem):
    x, _ = problem.start()
    sense = problem.sense
    assert problem.objective(x) == pytest.approx(sense * pyo.value(m.cost), rel=1e-14)
    for k, constraint in enumerate(problem.equations):
        gap = problem.constraints(x)[k] - problem.constraint_lower[k]
        assert gap == pytest.approx(
            pyo.value(constraint.body) - (-np.inf if constraint.lb is None else constraint.lb),
            rel=1e-13,
        )
        upper = problem.constraint_upper[k] - problem.constraints(x)[k]
        assert upper == pytest.approx(
            (np.inf if constraint.ub is None else constraint.ub) - pyo.value(constraint.body),
            rel=1e-13,
        )


def test_params_fixed_values_and_bounds_are_read_again_without_analysis():
    m = small()
    problem = compile_model(m)
    agrees(m, problem)
    structure = problem.jacobianstructure()
    m.p.value = -0.5
    m.z.value = 7.0
    m.x[1].setlb(-2)
    m.x[2].setub(None)
    m.x[2].value = 0.25
    problem.refresh()
    agrees(m, problem)
    assert problem.jacobianstructure()[0] is structure[0]
    column = {v.name: k for k, v in enumerate(problem.variables)}
    assert problem.lower[column["x[1]"]] == -2
    assert problem.upper[column["x[2]"]] == np.inf


def test_values_are_as_of_the_last_refresh():
    m = small()
    problem = compile_model(m)
    x, _ = problem.start()
    before = problem.objective(x)
    m.p.value = 100.0
    assert problem.objective(x) == before
    problem.refresh()
    assert problem.objective(x) == pytest.approx(before + 97.0)


@pytest.mark.parametrize(("change", "named"), [
    (lambda m: m.x[1].fix(), "x[1]"), (lambda m: m.z.unfix(), "'z'"),
    (lambda m: m.c.deactivate(), "1 constraints"),
    (lambda m: m.add_component("new", pyo.Constraint(expr=m.x[1] >= 0)), "3 constraints"),
    (lambda m: m.c.set_value(m.x[1] == 0), "'c'"),
    (lambda m: m.e.set_value(m.x[1]), "'e'"),
    (lambda m: setattr(m.cost, "sense", pyo.maximize), "objective"),
    (lambda m: m.cost.deactivate(), "objective"),
])  # fmt: skip
def test_a_change_of_structure_is_named(change, named):
    m = small()
    problem = compile_model(m)
    change(m)
    with pytest.raises(StructureChangedError, match="compile the model again") as error:
        problem.refresh()
    assert named in str(error.value)
    compile_model(m)


def refused(build):
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=1.0)
    m.y = pyo.Var(initialize=2.0)
    build(m)
    with pytest.raises(ModelRefusedError) as error:
        compile_model(m)
    message = str(error.value)
    assert "\n" not in message
    return message


def _disjunction(m):
    m.d1, m.d2 = Disjunct(), Disjunct()
    m.d1.c, m.d2.c = pyo.Constraint(expr=m.x <= 0), pyo.Constraint(expr=m.x >= 1)
    m.either = Disjunction(expr=[m.d1, m.d2])


def _external(m):
    m.f = pyo.ExternalFunction(function=lambda a, *rest: a, gradient=lambda a, fixed: [1.0])
    m.cost = pyo.Objective(expr=m.f(m.x))


@pytest.mark.parametrize(("build", "words"), [
    (lambda m: m.add_component("cost", pyo.Objective(expr=abs(m.x))), ["cost", "abs", "sqrt"]),
    (lambda m: m.add_component("c", pyo.Constraint(expr=pyo.Expr_if(m.x >= 0, m.x, 0) == 1)),
     ["'c'", "Expr_if"]),
    (lambda m: m.add_component("c", pyo.Constraint(expr=pyo.ceil(m.x) == 1)), ["'c'", "ceil"]),
    (lambda m: m.add_component("c", Complementarity(expr=complements(m.x >= 0, m.y >= 0))),
     ["'c'", "Complementarity", "mpec_ipopt"]),
    (_disjunction, ["Disjunct"]), (_external, ["cost", "variable"]),
    (lambda m: m.add_component("s", pyo.SOSConstraint(rule=lambda m: ([m.x, m.y], [1, 2]), sos=1)),
     ["'s'", "SOSConstraint", "special ordered sets"]),
    (lambda m: (m.add_component("o1", pyo.Objective(expr=m.x)),
                m.add_component("o2", pyo.Objective(expr=m.y))), ["'o1'", "'o2'"]),
    (lambda m: (m.add_component("n", pyo.Var(domain=pyo.Integers)),
                m.add_component("c", pyo.Constraint(expr=m.n >= m.x))), ["'n'", "Integers"]),
    (lambda m: (m.add_component("e", pyo.Expression()),
                m.add_component("o", pyo.Objective(expr=m.x + m.e))), ["'e'", "'o'"]),
    (lambda m: m.add_component("r", pyo.Constraint(expr=(m.y, m.x, 3))), ["'r'"]),
    (lambda m: (m.add_component("b", pyo.BooleanVar()),
                m.add_component("l", pyo.LogicalConstraint(expr=m.b))),
                ["'l'", "LogicalConstraint"]),
])  # fmt: skip
def test_what_cannot_be_treated_is_refused_by_name(build, words):
    message = refused(build)
    for word in words:
        assert word in message


def test_what_is_deactivated_or_data_is_not_refused():
    m = small()
    m.n = pyo.Var(domain=pyo.Binary, initialize=1)
    m.n.fix()
    m.inactive = Complementarity(expr=complements(m.x[1] >= 0, m.x[2] >= 0))
    m.inactive.deactivate()
    m.more = pyo.Constraint(
        expr=abs(m.p) * m.x[1] + m.n * pyo.Expr_if(m.z >= 1, m.x[2] * 0 + 1, 2) >= pyo.ceil(m.p)
    )
    problem = compile_model(m)
    agrees(m, problem)
    m.p.value = -2.5
    problem.refresh()
    agrees(m, problem)


def test_data_behind_a_condition_is_watched_too():
    m = small()
    m.more = pyo.Constraint(expr=abs(m.z) * m.x[1] <= 9)
    problem = compile_model(m)
    m.z.value = -4.0
    problem.refresh()
    agrees(m, problem)
    m.z.unfix()
    with pytest.raises(StructureChangedError):
        problem.refresh()


def test_nested_and_indexed_blocks_are_walked_and_inactive_ones_left():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(initialize=1.0)

    @m.Block([1, 2])
    def part(b, i):
        b.y = pyo.Var(initialize=i)
        b.c = pyo.Constraint(expr=b.y**2 + m.x == i)
        b.inner = pyo.Block()
        b.inner.c = pyo.Constraint(expr=b.y >= -i)

    m.cost = pyo.Objective(expr=m.x)
    assert [c.name for c in compile_model(m).equations] == [
        "part[1].c",
        "part[1].inner.c",
        "part[2].c",
        "part[2].inner.c",
    ]
    m.part[2].deactivate()
    assert [c.name for c in compile_model(m).equations] == ["part[1].c", "part[1].inner.c"]
    assert compile_model(m.part[1]).m == 2


@pytest.mark.parametrize("value", [None, float("nan")])
def test_a_missing_number_is_named(value):
    m = small()
    m.z.set_value(value, skip_validation=True)
    with pytest.raises(MissingValueError, match="'z'"):
        compile_model(m)


def test_why_a_number_is_missing_is_told():
    m = small()
    m.z.set_value("many", skip_validation=True)
    with pytest.raises(
        MissingValueError, match=r"'z' has no value .*could not convert string to float: 'many'"
    ):
        compile_model(m)


@pytest.mark.parametrize(("place", "named"), [
    (lambda m: m.add_component("more", pyo.Constraint(expr=m.r * m.x[1] <= 1)), "'r' has no value"),
    (lambda m: m.add_component("more", pyo.Constraint(expr=m.x[1] <= m.r)),
     "a bound of constraint 'more' has no value"),
    (lambda m: m.x[1].setub(2 * m.r), "a bound of variable 'x\\[1\\]' has no value"),
])  # fmt: skip
def test_a_param_without_value_is_named_by_where_it_stands(place, named):
    m = small()
    m.r = pyo.Param(mutable=True, domain=pyo.Any)
    place(m)
    with pytest.raises(MissingValueError, match=named):
        compile_model(m)


def test_constraints_without_variables_are_checked_not_sent():
    m = small()
    m.true = pyo.Constraint(expr=m.z * m.p <= 100)
    problem = compile_model(m)
    assert [c.name for c in problem.trivial] == ["true"]
    assert problem.trivial_violation() == (0.0, "")
    m.z.value = 50.0
    problem.refresh()
    assert problem.trivial_violation() == (50.0, "true")
    result = solve(problem)
    assert result.outcome.name == "INFEASIBLE"
    assert "'true'" in result.message


def test_something_else_than_a_constructed_model_is_refused():
    with pytest.raises(ModelRefusedError, match="ConcreteModel"):
        compile_model({"not": "a model"})
    abstract = pyo.AbstractModel()
    abstract.x = pyo.Var()
    with pytest.raises(ModelRefusedError, match="create_instance"):
        compile_model(abstract)


def test_a_differential_equation_needs_its_discretisation():
    m = pyo.ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x = pyo.Var(m.t, initialize=1.0)
    m.slope = DerivativeVar(m.x, wrt=m.t)
    m.decay = pyo.Constraint(m.t, rule=lambda m, t: m.slope[t] == -m.x[t])
    m.x[0].fix(1.0)
    with pytest.raises(ModelRefusedError, match=r"DerivativeVar.*dae\.collocation"):
        compile_model(m)
    pyo.TransformationFactory("dae.collocation").apply_to(m, nfe=5, ncp=3)
    problem = compile_model(m)
    load(problem, solve(problem))
    assert m.x[1].value == pytest.approx(np.exp(-1.0), abs=1e-6)


def test_a_transformed_complementarity_follows_its_bound():
    """min (x-1)^2 + (y-2)^2 with 0 <= x, 0 <= y, xy <= eps: 1 at eps = 0, and less by the multiplier 1 * eps to first order."""
    m = pyo.ConcreteModel()
    m.x, m.y = pyo.Var(initialize=1.0), pyo.Var(initialize=1.0)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
    m.cost = pyo.Objective(expr=(m.x - 1) ** 2 + (m.y - 2) ** 2)
    relaxed = pyo.TransformationFactory("mpec.simple_nonlinear").create_using(m)
    bound = next(p for p in relaxed.component_data_objects(pyo.Param) if "mpec_bound" in p.name)
    problem = compile_model(relaxed)
    costs = []
    for eps in (1e-2, 1e-4, 1e-6):
        bound.value = eps
        problem.refresh()
        costs.append(solve(problem).objective)
    assert costs == pytest.approx([1 - 1e-2, 1 - 1e-4, 1 - 1e-6], abs=1e-4)
    assert costs[0] < costs[1] < costs[2]


def test_compiling_and_refreshing_leave_the_model_as_it_was():
    m = small()
    components = [c.name for c in m.component_objects()]
    before = {
        v.name: (v.value, v.fixed, v.lb, v.ub, v.stale) for v in m.component_data_objects(pyo.Var)
    }
    problem = compile_model(m)
    problem.refresh()
    solve(problem)
    assert {
        v.name: (v.value, v.fixed, v.lb, v.ub, v.stale) for v in m.component_data_objects(pyo.Var)
    } == before
    assert [c.name for c in m.component_objects()] == components
