"""Terms that are deep, wide, shared or all different: cost stays bounded and derivatives stay right."""

import numpy as np
import pyomo.environ as pyo
import pytest

from formulations.ipopt import compile_model, shapes
from formulations.ipopt.shapes import column_groups


def model_with(count, initial):
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(count), initialize=initial)
    return m


def hessian_of(problem, x):
    rows, columns = problem.hessianstructure()
    full = np.zeros((problem.n, problem.n))
    full[rows, columns] = problem.hessian(x, np.zeros(problem.m), 1.0)
    return full + np.tril(full, -1).T


def test_a_product_of_two_hundred_variables_has_the_exact_dense_hessian():
    m = model_with(200, lambda m, i: 1.0 + 0.01 * (i % 7))
    product = 1.0
    for i in range(200):
        product = product * m.x[i]
    m.cost = pyo.Objective(expr=product)
    problem = compile_model(m)
    x, _ = problem.start()
    value = np.prod(x)
    expected = value / np.outer(x, x)
    np.fill_diagonal(expected, 0.0)
    np.testing.assert_allclose(problem.gradient(x), value / x, rtol=1e-12)
    np.testing.assert_allclose(hessian_of(problem, x), expected, rtol=1e-11)


@pytest.mark.slow
def test_a_chain_of_five_thousand_operations_needs_no_recursion():
    m = model_with(2, 0.3)
    chain = m.x[0]
    for _ in range(5000):
        chain = 0.5 * m.x[1] * (1 + chain)
    m.cost = pyo.Objective(expr=chain)
    problem = compile_model(m)
    x, _ = problem.start()
    y = x[list(problem.variables).index(m.x[1])]  # the chain converges to r / (1 - r), r = y / 2
    r = y / 2
    by_name = {v.name: k for k, v in enumerate(problem.variables)}
    assert problem.objective(x) == pytest.approx(r / (1 - r), rel=1e-13)
    assert problem.gradient(x)[by_name["x[1]"]] == pytest.approx(0.5 / (1 - r) ** 2, rel=1e-12)
    assert hessian_of(problem, x)[by_name["x[1]"], by_name["x[1]"]] == pytest.approx(0.5 / (1 - r) ** 3, rel=1e-12)


def test_a_nested_sum_of_five_thousand_terms():
    m = model_with(5000, 0.1)
    m.partial = pyo.Expression(range(5000))
    for i in range(5000):  # every partial sum is a named expression or a negated one of its own
        square = m.x[i] ** 2
        m.partial[i] = square if i == 0 else m.partial[i - 1] + square if i % 3 else -(-m.partial[i - 1] - square)
    m.cost = pyo.Objective(expr=m.partial[4999])
    problem = compile_model(m)
    x, _ = problem.start()
    assert problem.objective(x) == pytest.approx(50.0)
    assert len(problem.hessianstructure()[0]) == 5000


def test_expressions_built_by_substitution_are_read_once():
    """Single shooting: a tree of 2**300 nodes, a graph of some hundreds."""
    m = model_with(1, 0.3)
    m.p = pyo.Param(initialize=0.9, mutable=True)
    m.e = pyo.Expression(range(301))
    m.e[0] = m.x[0]
    for i in range(300):
        m.e[i + 1] = m.p * (0.5 * pyo.sin(m.e[i]) + 0.5 * m.e[i]) + 0.1
    m.cost = pyo.Objective(expr=m.e[300])
    problem = compile_model(m)
    x, _ = problem.start()

    def shoot(y):
        slope = 1.0
        for _ in range(300):
            y, slope = 0.9 * (0.5 * np.sin(y) + 0.5 * y) + 0.1, slope * 0.9 * (0.5 * np.cos(y) + 0.5)
        return y, slope

    value, slope = shoot(0.3)
    assert problem.objective(x) == pytest.approx(value, rel=1e-13)
    assert problem.gradient(x)[0] == pytest.approx(slope, rel=1e-11)


def test_sums_that_contain_themselves_twice_do_not_explode():
    m = model_with(1, 0.3)
    total = m.x[0]
    for _ in range(60):
        total = total + 0.1 * total
    m.cost = pyo.Objective(expr=total)
    problem = compile_model(m)
    x, _ = problem.start()
    assert problem.objective(x) == pytest.approx(0.3 * 1.1**60, rel=1e-12)


def test_data_in_front_of_a_wide_sum_keeps_the_terms_apart():
    m = model_with(3000, 0.4)
    m.p = pyo.Param(initialize=2.0, mutable=True)
    m.cost = pyo.Objective(expr=-m.p * (3 * sum(pyo.sin(m.x[i]) for i in range(3000)) + m.p) / (m.p + 1))
    problem = compile_model(m)
    x, _ = problem.start()
    assert len(problem.hessianstructure()[0]) == 3000
    assert problem.objective(x) == pytest.approx(pyo.value(m.cost), rel=1e-12)
    m.p.value = 5.0
    problem.refresh()
    assert problem.objective(x) == pytest.approx(pyo.value(m.cost), rel=1e-12)


@pytest.mark.parametrize("first", [True, False])
def test_rows_of_a_quadratic_form_are_terms_of_one_shape(first):
    """x' A x as sum x[i] * (A x)[i]: whole, each row would be a shape with a dense Hessian."""
    random = np.random.default_rng(1)
    count, start = 30, random.normal(size=30)
    matrix = random.normal(size=(count, count))
    m = model_with(count, 0.0)
    rows = [sum(matrix[i, j] * m.x[j] for j in range(count)) - 2.0 for i in range(count)]
    m.cost = pyo.Objective(expr=sum(m.x[i] * row if first else row * m.x[i] for i, row in enumerate(rows)))
    problem = compile_model(m)
    assert len(problem._groups) == 2, "x[i] * x[j] and x[i] * x[i]"
    assert problem.objective(start) == pytest.approx(start @ matrix @ start - 2 * start.sum(), rel=1e-12)
    np.testing.assert_allclose(problem.gradient(start), (matrix + matrix.T) @ start - 2, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(hessian_of(problem, start), matrix + matrix.T, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("first", [True, False])
def test_a_sparse_hessian_of_a_large_term_is_found_sparse(first):
    m = model_with(300, 0.4)
    m.y = pyo.Var(initialize=0.7)
    cubes = sum(m.x[i] ** 3 for i in range(300))
    factor = m.y + 1
    m.cost = pyo.Objective(expr=factor * cubes if first else cubes * factor)
    problem = compile_model(m)
    x, _ = problem.start()
    assert len(problem.hessianstructure()[0]) == 600
    where = {v.name: k for k, v in enumerate(problem.variables)}
    full = hessian_of(problem, x)
    assert full[where["x[7]"], where["x[7]"]] == pytest.approx(1.7 * 6 * 0.4)
    assert full[where["y"], where["x[7]"]] == pytest.approx(3 * 0.4**2)


def test_columns_of_one_group_share_no_row():
    rng = np.random.default_rng(3)
    mask = np.tril(rng.random((40, 40)) < 0.05) | np.eye(40, dtype=bool)
    pairs = np.array(np.nonzero(mask))
    groups = column_groups(pairs, 40)
    full = mask | mask.T
    for group in range(groups.max() + 1):
        assert (full[:, groups == group].sum(axis=1) <= 1).all()
    assert groups.max() + 1 < 40


def test_a_model_of_all_different_constraints():
    rng = np.random.default_rng(0)
    m = model_with(20, 0.3)
    m.c = pyo.ConstraintList()
    functions = [pyo.sin, pyo.exp, pyo.cos, pyo.tanh, pyo.atan]
    for _ in range(150):
        e = m.x[int(rng.integers(20))]
        for _ in range(int(rng.integers(2, 10))):
            f, other = functions[int(rng.integers(5))], m.x[int(rng.integers(20))]
            e = [f(e), e * other, e + f(other), e / (1 + other**2)][int(rng.integers(4))]
        m.c.add(e <= 3)
    m.cost = pyo.Objective(expr=sum(m.x[i] ** 2 for i in range(20)))
    problem = compile_model(m)
    x, _ = problem.start()
    np.testing.assert_allclose(problem.constraints(x), [pyo.value(c.body) for c in problem.equations], rtol=1e-12)


def test_equal_shapes_are_compiled_once_per_process():
    def build():
        m = model_with(30, 0.5)
        m.c = pyo.Constraint(range(29), rule=lambda m, i: pyo.sinh(m.x[i] * m.x[i + 1]) + pyo.acosh(2 + m.x[i]) <= i + 2)
        return compile_model(m)

    build()
    before = shapes.shape_of.cache_info().misses
    problem = build()
    assert shapes.shape_of.cache_info().misses == before
    assert problem.m == 29
