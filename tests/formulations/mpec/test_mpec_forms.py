"""Every form that `complements` accepts, wherever it stands, and one sentence for what it does not.

Models as strangers bring them; options that reach Ipopt, and those that are refused by name.
"""

import math

import pyomo.environ as pyo
import pytest
from pyomo.gdp import Disjunction
from pyomo.mpec import Complementarity, ComplementarityList, complements

from formulations.ipopt import MissingValueError, ModelRefusedError, UnknownOptionError
from formulations.mpec import certify, load, read_settings, solve_mpec
from tests.formulations.nearest import nearest, solver


def model(goal=(1.0, 2.0), bounds=(None, None)) -> pyo.ConcreteModel:
    """Nearest point to a goal; x and y without bounds of their own."""
    m = pyo.ConcreteModel(name="nearest")
    m.x = pyo.Var(bounds=bounds, initialize=0.5)
    m.y = pyo.Var(bounds=bounds, initialize=0.5)
    m.one = pyo.Param(initialize=1.0, mutable=True)
    m.cost = pyo.Objective(expr=(m.x - goal[0]) ** 2 + (m.y - goal[1]) ** 2)
    return m


# (the condition, goal, the nearest point that satisfies it)
FORMS = {
    "both >=": (lambda m: complements(m.x >= 0, m.y >= 0), (1, 2), (0, 2)),
    "0 <= on the left": (lambda m: complements(0 <= m.x, 0 <= m.y), (1, 2), (0, 2)),  # noqa: SIM300 - this order is what is tested
    "both <=": (lambda m: complements(m.x <= 0, m.y <= 0), (-1, -2), (0, -2)),
    "mixed": (lambda m: complements(m.x >= 0, m.y <= 0), (1, -2), (0, -2)),
    "mixed, the upper side held": (lambda m: complements(m.x >= 0, m.y <= 0), (3, -1), (3, 0)),
    "mixed, other order": (lambda m: complements(m.y <= 0, m.x >= 0), (1, -2), (0, -2)),
    "bounds that are not 0": (lambda m: complements(m.x >= 3, m.y <= 5), (4, 2), (3, 2)),
    "bounds that are Params": (
        lambda m: complements(m.x >= m.one, m.y >= 2 * m.one),
        (2, 4),
        (1, 4),
    ),
    "variables on both sides": (lambda m: complements(m.x >= m.y, m.y >= 0), (3, 1), (3, 0)),
    "nonlinear": (lambda m: complements(m.x**2 - m.y >= 0, m.y - 1 >= 0), (2, 1.5), (2, 1)),
    "two expressions": (
        lambda m: complements(m.x + m.y >= 2, m.x - m.y >= 0),
        (3, 1.5),
        (2.25, 2.25),
    ),
    "box first, at its lower bound": (
        lambda m: complements(pyo.inequality(-1, m.x, 2), m.y),
        (-3, 2),
        (-1, 2),
    ),
    "box first, at its upper bound": (
        lambda m: complements(pyo.inequality(-1, m.x, 2), m.y),
        (3, -2),
        (2, -2),
    ),
    "box first, between": (
        lambda m: complements(pyo.inequality(-1, m.x, 2), m.y),
        (0.5, 0.1),
        (0.5, 0),
    ),
    "box second": (lambda m: complements(m.y, pyo.inequality(-1, m.x, 2)), (3, -2), (2, -2)),
    "box of Params": (
        lambda m: complements(pyo.inequality(-m.one, m.x, 2 * m.one), m.y - 1),
        (3, -2),
        (2, -2),
    ),
    "box without width": (lambda m: complements(pyo.inequality(1, m.x, 1), m.y), (3, -2), (1, -2)),
    "half-open range": (
        lambda m: complements(pyo.inequality(0, m.x, math.inf), m.y >= 0),
        (1, 2),
        (0, 2),
    ),
    "range up to a number that is no bound": (
        lambda m: complements(pyo.inequality(0, m.x, 2e27), m.y >= 0),
        (1, 2),
        (0, 2),
    ),
    "equality first": (lambda m: complements(m.x == m.y, m.y), (1, 3), (2, 2)),
    "equality second": (lambda m: complements(m.y, m.x + m.y == 2), (2, 2), (1, 1)),
    "equality beside a bound, which holds too": (
        lambda m: complements(m.x == 1, m.y >= 3),
        (2, 2),
        (1, 3),
    ),
    "a tuple": (lambda m: (m.x >= 0, m.y >= 0), (1, 2), (0, 2)),
    "a fixed number on one side": (lambda m: complements(m.x >= 0, m.one >= 0), (1, 2), (0, 2)),
}


@pytest.mark.parametrize("bounded", [False, True], ids=["free", "bounded"])
@pytest.mark.parametrize("name", FORMS)
def test_form(name, bounded):
    """Bounded: where a side can be the user's variable itself instead of a slack."""
    condition, goal, point = FORMS[name]
    m = model(
        goal,
        bounds=(None, None) if not bounded else (0.0, 10.0) if min(point) >= 0 else (-10.0, 10.0),
    )
    m.pair = Complementarity(expr=condition(m))
    result = solve_mpec(m)
    assert result.solved, result.message
    load(result)
    assert (m.x.value, m.y.value) == pytest.approx(point, abs=1e-7)
    assert result.certificate.holds, result.certificate.sentence
    assert result.certificate.complementarity <= 1e-12
    assert result.has_multipliers
    assert result.certificate.given_dual <= 1e-6


def test_indexed_conditions_with_skipped_and_inactive_ones():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(4), initialize=1.0)
    m.y = pyo.Var(range(4), initialize=1.0)
    m.cost = pyo.Objective(expr=sum((m.x[i] - 1) ** 2 + (m.y[i] - 2) ** 2 for i in range(4)))
    m.pair = Complementarity(
        range(4),
        rule=lambda m, i: Complementarity.Skip if i == 1 else complements(m.x[i] >= 0, m.y[i] >= 0),
    )
    m.pair[2].deactivate()
    load(solve_mpec(m))
    assert [m.x[i].value for i in range(4)] == pytest.approx([0, 1, 1, 0], abs=1e-7)


def test_a_list_and_nested_blocks():
    m = model()
    m.rows = ComplementarityList(rule=(c for c in [complements(m.x >= 0, m.y >= 0)]))
    m.inner = pyo.Block()
    m.inner.deeper = pyo.Block([1, 2])
    m.inner.deeper[2].z = pyo.Var(initialize=1.0)
    m.inner.deeper[2].pair = Complementarity(expr=complements(m.inner.deeper[2].z >= 1, m.y <= 5))
    m.inner.off = pyo.Block()
    m.inner.off.pair = Complementarity(expr=complements(m.x >= 100, m.y >= 100))
    m.inner.off.deactivate()
    result = solve_mpec(m)
    load(result)
    assert (m.x.value, m.y.value, m.inner.deeper[2].z.value) == pytest.approx((0, 2, 1), abs=1e-7)
    assert {pair.name for pair in result.pairs} == {"rows[1]", "inner.deeper[2].pair"}


def test_a_variable_that_stands_in_a_condition_only():
    m = model()
    m.w = pyo.Var(bounds=(0, None), initialize=1.0)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.w >= 0))
    result = solve_mpec(m)
    load(result)
    assert (m.x.value, m.w.value) == pytest.approx((1, 0), abs=1e-7)


def test_a_block_of_a_larger_model_is_solved_alone():
    m = pyo.ConcreteModel()
    m.outside = pyo.Var(initialize=7.0)
    m.part = pyo.Block()
    m.part.x = pyo.Var(initialize=1.0)
    m.part.cost = pyo.Objective(expr=(m.part.x - 1) ** 2 + (m.outside - 2) ** 2)
    m.part.pair = Complementarity(expr=complements(m.part.x >= 0, m.outside >= 0))
    load(solve_mpec(m.part))
    assert (m.part.x.value, m.outside.value) == pytest.approx((0, 2), abs=1e-7)


# -- what is refused: (the change to the model, words of the sentence, error)
#   ------------------------------------------------------------
def _pair(first, second):
    return lambda m: m.add_component("pair", Complementarity(expr=complements(first(m), second(m))))


def _log_of_nothing(m):
    """A coefficient that has no value, in an objective with a name of its own."""
    m.nothing = pyo.Var(initialize=0.0)
    m.nothing.fix()
    next(m.component_objects(pyo.Objective)).deactivate()
    m.effort = pyo.Objective(expr=m.x * pyo.log(m.nothing))
    _pair(_nonnegative, lambda m: m.x >= 0)(m)


def _beside(change):
    """A change to a model whose pair is as it should be."""

    def both(m):
        m.pair = Complementarity(expr=complements(m.x >= 0, m.y >= 0))
        change(m)

    return both


def _nonnegative(m):
    return m.y >= 0


def _integer(m):
    m.n = pyo.Var(domain=pyo.NonNegativeIntegers)
    m.pair = Complementarity(expr=complements(m.x >= 0, m.n >= 0))


def _no_value(m):
    m.p = pyo.Param(mutable=True)
    m.pair = Complementarity(expr=complements(m.x >= m.p, m.y >= 0))


def _external(m):
    m.f = pyo.ExternalFunction(function=lambda a: 2 * a)
    m.pair = Complementarity(expr=complements(m.f(m.x) >= 0, m.y >= 0))


@pytest.mark.parametrize(("change", "words", "error"), [
    (_pair(lambda m: pyo.inequality(0, m.x, 1), _nonnegative),
     ["'pair'", "3 finite bounds", "two in all"], ModelRefusedError),
    (_pair(lambda m: m.x >= 0, lambda m: m.y), ["'pair'", "1 finite bounds", "two in all"],
     ModelRefusedError),
    (_pair(lambda m: m.x > 0, _nonnegative), ["'pair'", "strict"], ModelRefusedError),
    (_pair(lambda m: pyo.ceil(m.x) >= 1, _nonnegative), ["ceil"], ModelRefusedError),
    (_pair(lambda m: pyo.inequality(m.y, m.x, 3), lambda m: m.y), ["'pair'", "variable bound"],
     ModelRefusedError),
    (lambda m: m.add_component("pair", Complementarity()), ["'pair'", "no condition"],
     ModelRefusedError), (_integer, ["'n'"], ModelRefusedError),
    (_external, ["pair"], ModelRefusedError), (_no_value, ["p"], MissingValueError),
    (_beside(lambda m: m.add_component("either", Disjunction(expr=[[m.x >= 1], [m.y >= 1]]))),
     ["'either", "Disjunct"], ModelRefusedError),
    (_log_of_nothing, ["'effort'", "finite"], MissingValueError),
    (_beside(lambda m: m.x.set_value(math.nan, skip_validation=True)), ["'x'", "nan"],
     MissingValueError),
    (_beside(lambda m: m.add_component("more", pyo.Objective(expr=m.x))), ["2 objectives"],
     ModelRefusedError),
])  # fmt: skip
def test_refusals_are_one_sentence(change, words, error):
    m = model()
    change(m)
    with pytest.raises(error) as caught:
        solve_mpec(m)
    text = str(caught.value)
    for word in words:
        assert word in text
    assert "\n" not in text


def test_an_instance_of_an_abstract_model_which_is_refused_itself():
    abstract = pyo.AbstractModel()
    abstract.n = pyo.Param()
    abstract.i = pyo.RangeSet(abstract.n)
    abstract.goal = pyo.Param(abstract.i, mutable=True)
    abstract.x = pyo.Var(abstract.i, bounds=(0, None))
    abstract.cost = pyo.Objective(rule=lambda m: sum((m.x[i] - m.goal[i]) ** 2 for i in m.i))
    abstract.pair = Complementarity(
        abstract.i, rule=lambda m, i: complements(m.x[i] >= 0, m.x[i % pyo.value(m.n) + 1] >= 0)
    )
    with pytest.raises(ModelRefusedError, match="abstract"):
        solve_mpec(abstract)
    instance = abstract.create_instance({None: {"n": {None: 3}, "goal": {1: 1.0, 2: 5.0, 3: 2.0}}})
    pyo.assert_optimal_termination(solver().solve(instance))
    assert [instance.x[i].value for i in (1, 2, 3)] == pytest.approx(
        [0, 5, 0], abs=1e-8
    )  # of three in a ring two must be 0
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
    pyo.assert_optimal_termination(
        made.solve(nearest(), options_string="strategy=scholtes max_iter=500")
    )
    assert made.last_result.options["strategy"] == "scholtes"
    made.set_options("strategi=scholtes")
    with pytest.raises(UnknownOptionError, match="did you mean strategy"):
        made.solve(nearest())
    with pytest.raises(ValueError, match="name=value"):
        solver().solve(nearest(), options_string="tol")


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


@pytest.mark.parametrize(("options", "words"), [
    ({"strategy": "magic"}, ["'strategy'", "scholtes", "'magic'"]),
    ({"strateg": "scholtes"}, ["'strateg'", "did you mean strategy?"]),
    ({"zzzz": 1}, ["'zzzz'", "neither Ipopt's", "strategy, eps_start, eps_end"]),
    ({"eps_start": -1.0}, ["'eps_start'", "positive"]),
    ({"eps_end": "small"}, ["'eps_end'", "number"]),
    ({"polish": "maybe"}, ["'polish'", "True or False"]),
    ({"max_biactive": 1.5}, ["'max_biactive'", "whole"]),
    ({"max_biactive": float("nan")}, ["'max_biactive'", "whole"]),
    ({"search": float("inf")}, ["'search'", "whole"]), ({"starts": 0}, ["'starts'", "at least 1"]),
    ({"work": -1}, ["'work'", "at least 0"]),
    ({"linear_solver": "ma57"}, ["ma57"]),
])  # fmt: skip
def test_wrong_options_are_named(options, words):
    with pytest.raises(UnknownOptionError) as caught:
        solver(**options).solve(nearest())
    for word in words:
        assert word in str(caught.value)


def test_options_reach_ipopt_and_the_record():
    settings = read_settings({"strategy": "scholtes", "max_iter": 77, "polish": "no"})
    assert settings.ipopt == {"max_iter": 77}
    result = solve_mpec(nearest(), settings)
    assert result.options["max_iter"] == 77
    assert not result.polished
    assert result.residual < 1e-6


@pytest.mark.parametrize("sense", [pyo.minimize, pyo.maximize])
def test_multipliers_of_pairs_are_a_suffix(sense):
    """At (0, 2): the cost changes by -2 when x >= 0 becomes x >= 1e-3, and not with what y is compared with."""
    m, sign = nearest(), 1 if sense == pyo.minimize else -1
    m.cost.deactivate()
    m.signed = pyo.Objective(expr=sign * m.cost.expr, sense=sense)
    m.pair_dual = pyo.Suffix(direction=pyo.Suffix.IMPORT)
    solver().solve(m)
    assert m.pair_dual[m.pair] == pytest.approx((-2.0 * sign, 0.0), abs=1e-8)


@pytest.mark.parametrize("plugin", ["mpec_ipopt", "touchstone_ipopt"])
def test_arguments_of_another_kind_are_refused_in_a_sentence(plugin):
    m = nearest()
    m.pair.deactivate()
    for timelimit in ("10", True, 0.0, float("nan")):
        with pytest.raises(ValueError, match="timelimit is a positive number of seconds"):
            pyo.SolverFactory(plugin).solve(m, timelimit=timelimit)
    with pytest.raises(
        TypeError, match="options as a dict, not 'tol=1e-9'; options_string takes a text"
    ):
        pyo.SolverFactory(plugin).solve(m, options="tol=1e-9")
    pyo.SolverFactory(plugin).solve(m, options_string="tol=1e-9", timelimit=60)
