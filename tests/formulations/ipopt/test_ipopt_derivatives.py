"""Values, gradients and Hessians against two independent roads.

Terms that are deep, wide, shared or all different; the algebra alone.
"""

import math
import operator

import mpmath
import numpy as np
import pyomo.environ as pyo
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyomo.core.expr.calculus.derivatives import Modes, differentiate

from formulations.ipopt import compile_model, shapes
from formulations.ipopt.graph import Graph, hessian_sparsity
from formulations.ipopt.shapes import column_groups, hoist
from formulations.ipopt.tape import record

# Both roads round each operation once or twice; a dozen nested operations lose at most four of
# sixteen digits.
RELATIVE = 1e-10


def dense(problem, x, multipliers=None, factor=1.0):
    multipliers = np.zeros(problem.m) if multipliers is None else multipliers
    hessian = np.zeros((problem.n, problem.n))
    rows, columns = problem.hessianstructure()
    hessian[rows, columns] = problem.hessian(x, multipliers, factor)
    return hessian + np.tril(hessian, -1).T


def one_expression(build, values):
    """(model, variables, problem, x) of an objective built from variables that start at values.

    X in the problem's order.
    """
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(len(values)), initialize=dict(enumerate(values)))
    m.p = pyo.Param([0, 1], initialize={0: 1.5, 1: 0.5}, mutable=True)
    m.cost = pyo.Objective(expr=build(m))
    problem = compile_model(m)
    return m, problem, problem.start()[0]


_UNARY = [
    pyo.sin,
    pyo.cos,
    pyo.atan,
]  # those that Pyomo can differentiate; the others are compared with mpmath below
_POSITIVE = [pyo.log, pyo.sqrt, pyo.log10]


@st.composite
def recipes(draw, depth=4):
    """A nested tuple that `assemble` turns into an expression with values of moderate size."""
    kind = draw(
        st.sampled_from(
            ["x", "x", "p", "n"]
            if depth == 0
            else ["x", "n", "f", "g", "e", "+", "-", "*", "/", "^", "v", "s", "neg"]
        )
    )
    if kind in ("x", "p"):
        return kind, draw(st.integers(0, 2 if kind == "x" else 1))
    if kind == "n":
        return kind, draw(st.sampled_from([1, 2, -1, 0.5, 3.25, -0.75]))
    if kind in ("f", "g"):
        return (
            kind,
            draw(st.integers(0, len(_UNARY if kind == "f" else _POSITIVE) - 1)),
            draw(recipes(depth - 1)),
        )
    if kind in ("e", "s", "neg"):
        return kind, draw(recipes(depth - 1))
    if kind == "^":
        return kind, draw(st.sampled_from([2, 3, 4, 0.5, -1, -2, 1.7])), draw(recipes(depth - 1))
    return kind, draw(recipes(depth - 1)), draw(recipes(depth - 1))


def assemble(m, recipe):
    kind, *rest = recipe
    if kind == "x":
        return m.x[rest[0]]
    if kind == "p":
        return m.p[rest[0]]
    if kind == "n":
        return rest[0]
    if kind == "f":
        return _UNARY[rest[0]](assemble(m, rest[1]))
    if kind == "g":
        return _POSITIVE[rest[0]](1.5 + pyo.sin(assemble(m, rest[1])))
    if kind == "e":
        return pyo.exp(pyo.sin(assemble(m, rest[0])))
    if kind == "s":
        return pyo.log(pyo.exp(pyo.cos(assemble(m, rest[0]))) + 1)
    if kind == "neg":
        return -assemble(m, rest[0])
    if kind == "^":
        return (1.25 + pyo.sin(assemble(m, rest[1]))) ** rest[0]
    left, right = (assemble(m, r) for r in rest)
    if kind == "+":
        return left + right
    if kind == "-":
        return left - right
    if kind == "*":
        return left * right
    if kind == "/":
        return left / (2 + pyo.cos(right))
    return (1.25 + pyo.sin(left)) ** right


@pytest.mark.slow
@settings(max_examples=120, deadline=None, derandomize=True)
@given(recipes(), st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3))
def test_random_expressions_equal_pyomos_symbolic_derivatives(recipe, values):
    m, problem, x = one_expression(lambda m: assemble(m, recipe) + m.x[0] * m.x[1], values)
    expression, order = m.cost.expr, list(problem.variables)
    scale = max(1.0, abs(pyo.value(expression)))
    assert problem.objective(x) == pytest.approx(
        pyo.value(expression), rel=RELATIVE, abs=RELATIVE * scale
    )
    slopes = differentiate(expression, wrt_list=order, mode=Modes.reverse_symbolic)
    gradient = np.array([pyo.value(s) for s in slopes])
    size = max(1.0, np.abs(gradient).max())
    np.testing.assert_allclose(problem.gradient(x), gradient, rtol=RELATIVE, atol=RELATIVE * size)
    reference = np.zeros((problem.n, problem.n))
    for i, slope in enumerate(slopes):
        if hasattr(slope, "is_potentially_variable") and slope.is_potentially_variable():
            reference[i] = [
                float(v) for v in differentiate(slope, wrt_list=order, mode=Modes.reverse_numeric)
            ]
    size = max(1.0, np.abs(reference).max())
    np.testing.assert_allclose(dense(problem, x), reference, rtol=RELATIVE, atol=RELATIVE * size)


_POINTS = {
    "exp": (-3.0, 0.0, 2.5), "log": (0.01, 1.0, 40.0), "log10": (0.01, 1.0, 40.0),
    "sqrt": (0.01, 2.0), "sin": (0.0, 2.0), "cos": (0.0, 2.0),
    "tan": (0.0, 1.2), "asin": (-0.9, 0.3), "acos": (-0.9, 0.3), "atan": (-4.0, 0.2),
    "sinh": (-2.0, 0.5), "cosh": (-2.0, 0.5),
    "tanh": (-3.0, 0.0, 20.0), "asinh": (-2.0, 30.0), "acosh": (1.01, 5.0), "atanh": (-0.7, 0.95),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(_POINTS))
def test_every_intrinsic_function_to_twelve_digits(name):
    exact = getattr(mpmath, name)
    for point in _POINTS[name]:
        _, problem, x = one_expression(lambda m: getattr(pyo, name)(m.x[0]), [point])
        with mpmath.workdps(40):
            value, first, second = (
                float(mpmath.diff(exact, mpmath.mpf(point), n)) for n in range(3)
            )
        graph = Graph()
        assert graph.constant_value(graph.call(name, graph.constant(point))) == pytest.approx(
            value, rel=1e-12, abs=1e-15
        )
        assert problem.objective(x) == pytest.approx(value, rel=1e-12, abs=1e-15)
        assert problem.gradient(x)[0] == pytest.approx(first, rel=1e-12, abs=1e-15)
        assert dense(problem, x)[0, 0] == pytest.approx(second, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("write", [
    lambda z: pyo.log(1 + pyo.exp(z)), lambda z: pyo.log(pyo.exp(z) + 1),
    lambda z: pyo.log(1.0 + pyo.exp(0.25 * z + 0.75 * z)),
    lambda z: pyo.log(pyo.exp(z) + pyo.exp(0 * z)),
    lambda z: pyo.log10(1 + pyo.exp(z)) * math.log(10.0),
])  # fmt: skip
@pytest.mark.parametrize("z", [-900.0, -40.0, -1.0, 0.0, 3.0, 40.0, 900.0])
def test_softplus_never_overflows_and_keeps_its_digits(write, z):
    _, problem, x = one_expression(lambda m: write(m.x[0]), [z])
    with mpmath.workdps(60):
        e = mpmath.exp(-abs(mpmath.mpf(z)))
        value = max(z, 0) + mpmath.log1p(e)
        first = (1 if z >= 0 else e) / (1 + e)
        second = e / (1 + e) ** 2
    assert problem.objective(x) == pytest.approx(float(value), rel=1e-13)
    assert problem.gradient(x)[0] == pytest.approx(float(first), rel=1e-13, abs=1e-300)
    assert dense(problem, x)[0, 0] == pytest.approx(float(second), rel=1e-13, abs=1e-300)


def test_the_logarithm_of_two_exponentials_is_a_smooth_maximum():
    _, problem, x = one_expression(
        lambda m: pyo.log(pyo.exp(m.x[0]) + pyo.exp(3 * m.x[1])), [800.0, 267.0]
    )
    # max(800, 801) + log(1 + e^-1), and the weights of a softmax
    assert problem.objective(x) == pytest.approx(801 + math.log1p(math.exp(-1)), rel=1e-14)
    share = 1 / (1 + math.exp(-1))
    assert problem.gradient(x) == pytest.approx([1 - share, 3 * share], rel=1e-13)


def test_a_data_factor_is_carried_through_a_difference():
    m, problem, x = one_expression(
        lambda m: m.p[0] * (m.x[0] - 2 * m.x[1] - m.p[1]) / m.p[1], [3.0, 5.0]
    )
    assert problem.objective(x) == pytest.approx(pyo.value(m.cost))
    assert problem.gradient(x) == pytest.approx([3.0, -6.0])
    assert len(problem.hessianstructure()[0]) == 0


def test_logistic_survives_a_huge_argument():
    _, problem, x = one_expression(lambda m: 3 / (1 + pyo.exp(m.x[0])), [900.0])
    assert problem.objective(x) == pytest.approx(0.0, abs=1e-300)
    assert np.isfinite(problem.gradient(x)).all()
    assert np.isfinite(problem.hessian(x, np.zeros(0), 1.0)).all()


@pytest.mark.parametrize("z", [-2.0, 0.5, 800.0, 1e5])
@pytest.mark.parametrize("write", [
    lambda m, e: m.x[1] / (7 * (1 + e)),
    lambda m, e: m.x[1] / ((e + 1) * (5 + m.x[1] ** 2)),
    lambda m, e: m.p[0] * m.x[1] / (1 + e) ** 2,
])  # fmt: skip
def test_quotient_by_logistic_product_finite_slopes(write, z):
    model, problem, x = one_expression(lambda m: write(m, pyo.exp(m.x[0])), [z, 3.0])
    if z < 700.0:  # exp(z) of a double is finite
        assert problem.objective(x) == pytest.approx(pyo.value(model.cost), rel=1e-14)
    else:
        assert problem.objective(x) == pytest.approx(0.0, abs=1e-300)
    assert np.isfinite(problem.gradient(x)).all()
    assert np.isfinite(problem.hessian(x, np.zeros(0), 1.0)).all()


@pytest.mark.parametrize(("write", "expected"), [
    (lambda m: m.x[0] ** 2, (0.0, 0.0, 2.0)),
    (lambda m: m.x[0] ** 3, (0.0, 0.0, 0.0)),
    (lambda m: m.x[0] ** 1, (0.0, 1.0, 0.0)),
    (lambda m: m.x[0] ** 2.5, (0.0, 0.0, 0.0)),
    (lambda m: (m.x[0] - 2) ** 3, (-8.0, 12.0, -12.0)),
    (lambda m: m.x[0] ** (2 * m.p[0] - 1), (0.0, 0.0, 2.0)),  # data exponents 2, 1 and 0
    (lambda m: m.x[0] ** (2 * m.p[1]), (0.0, 1.0, 0.0)),
    (lambda m: m.x[0] ** (m.p[0] - 1.5), (1.0, 0.0, 0.0)),
])  # fmt: skip
def test_powers_are_right_at_zero(write, expected):
    _, problem, x = one_expression(lambda m: write(m) + 0 * m.x[0] ** 2, [0.0])
    found = (problem.objective(x), problem.gradient(x)[0], dense(problem, x)[0, 0])
    assert found == pytest.approx(expected)


def test_the_root_at_zero_is_reported_not_invented():
    _, problem, x = one_expression(lambda m: m.x[0] ** 0.5, [0.0])
    assert problem.objective(x) == 0.0
    assert np.isinf(problem.gradient(x)[0])


def test_jacobian_and_hessian_of_a_whole_model_against_differences():
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(4), initialize=lambda m, i: 0.3 + 0.2 * i)
    m.p = pyo.Param(initialize=0.7, mutable=True)
    m.a = pyo.Constraint(expr=m.x[0] * m.x[1] * m.x[2] + pyo.exp(m.p * m.x[3]) - m.p * m.x[0] == 1)
    m.b = pyo.Constraint(expr=(m.x[3] - m.x[0]) ** 2 / m.x[1] <= m.x[2] ** m.x[1])
    m.c = pyo.Constraint(expr=3 * m.x[0] - m.x[2] >= -m.p)
    problem, x = compiled(m, m.p * m.x[0] ** 4 + m.x[1] * m.x[3], sense=pyo.maximize)
    multipliers = np.array([0.5, -1.5, 2.0])
    rows, columns = problem.jacobianstructure()
    jacobian = np.zeros((problem.m, problem.n))
    jacobian[rows, columns] = problem.jacobian(x)
    step = 1e-6

    def lagrangian_slope(y):
        full = np.zeros((problem.m, problem.n))
        full[rows, columns] = problem.jacobian(y)
        return 2.0 * problem.gradient(y) + multipliers @ full

    differences = np.zeros_like(jacobian)
    curvature = np.zeros((problem.n, problem.n))
    for k in range(problem.n):
        shift = np.zeros(problem.n)
        shift[k] = step
        differences[:, k] = (problem.constraints(x + shift) - problem.constraints(x - shift)) / (
            2 * step
        )
        curvature[:, k] = (lagrangian_slope(x + shift) - lagrangian_slope(x - shift)) / (2 * step)
    # Central differences with step 1e-6: truncation 1e-12, rounding 1e-10.
    np.testing.assert_allclose(jacobian, differences, atol=1e-8)
    np.testing.assert_allclose(dense(problem, x, multipliers, 2.0), curvature, atol=1e-8)
    assert problem.objective(x) == pytest.approx(-pyo.value(m.cost))


def model_with(count, initial):
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(count), initialize=initial)
    return m


def compiled(m, cost, **options):
    """(problem, its start) of a model with this objective."""
    m.cost = pyo.Objective(expr=cost, **options)
    problem = compile_model(m)
    return problem, problem.start()[0]


def test_a_product_of_two_hundred_variables_has_the_exact_dense_hessian():
    m = model_with(200, lambda m, i: 1.0 + 0.01 * (i % 7))
    product = 1.0
    for i in range(200):
        product = product * m.x[i]
    problem, x = compiled(m, product)
    value = np.prod(x)
    expected = value / np.outer(x, x)
    np.fill_diagonal(expected, 0.0)
    np.testing.assert_allclose(problem.gradient(x), value / x, rtol=1e-12)
    np.testing.assert_allclose(dense(problem, x), expected, rtol=1e-11)


@pytest.mark.slow
def test_a_chain_of_five_thousand_operations_needs_no_recursion():
    m = model_with(2, 0.3)
    chain = m.x[0]
    for _ in range(5000):
        chain = 0.5 * m.x[1] * (1 + chain)
    problem, x = compiled(m, chain)
    y = x[list(problem.variables).index(m.x[1])]  # the chain converges to r / (1 - r), r = y / 2
    r = y / 2
    by_name = {v.name: k for k, v in enumerate(problem.variables)}
    assert problem.objective(x) == pytest.approx(r / (1 - r), rel=1e-13)
    assert problem.gradient(x)[by_name["x[1]"]] == pytest.approx(0.5 / (1 - r) ** 2, rel=1e-12)
    assert dense(problem, x)[by_name["x[1]"], by_name["x[1]"]] == pytest.approx(
        0.5 / (1 - r) ** 3, rel=1e-12
    )


@pytest.mark.slow
def test_a_nested_sum_of_five_thousand_terms():
    m = model_with(5000, 0.1)
    m.partial = pyo.Expression(range(5000))
    for i in range(5000):  # every partial sum is a named expression or a negated one of its own
        square = m.x[i] ** 2
        m.partial[i] = (
            square
            if i == 0
            else m.partial[i - 1] + square
            if i % 3
            else -(-m.partial[i - 1] - square)
        )
    problem, x = compiled(m, m.partial[4999])
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
    problem, x = compiled(m, m.e[300])

    def shoot(y):
        slope = 1.0
        for _ in range(300):
            y, slope = (
                0.9 * (0.5 * np.sin(y) + 0.5 * y) + 0.1,
                slope * 0.9 * (0.5 * np.cos(y) + 0.5),
            )
        return y, slope

    value, slope = shoot(0.3)
    assert problem.objective(x) == pytest.approx(value, rel=1e-13)
    assert problem.gradient(x)[0] == pytest.approx(slope, rel=1e-11)


def test_sums_that_contain_themselves_twice_do_not_explode():
    m = model_with(1, 0.3)
    total = m.x[0]
    for _ in range(60):
        total = total + 0.1 * total
    problem, x = compiled(m, total)
    assert problem.objective(x) == pytest.approx(0.3 * 1.1**60, rel=1e-12)


def test_data_in_front_of_a_wide_sum_keeps_the_terms_apart():
    m = model_with(3000, 0.4)
    m.p = pyo.Param(initialize=2.0, mutable=True)
    problem, x = compiled(
        m, -m.p * (3 * sum(pyo.sin(m.x[i]) for i in range(3000)) + m.p) / (m.p + 1)
    )
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
    m.cost = pyo.Objective(
        expr=sum(m.x[i] * row if first else row * m.x[i] for i, row in enumerate(rows))
    )
    problem = compile_model(m)
    assert len(problem._groups) == 2, "x[i] * x[j] and x[i] * x[i]"
    assert problem.objective(start) == pytest.approx(
        start @ matrix @ start - 2 * start.sum(), rel=1e-12
    )
    np.testing.assert_allclose(
        problem.gradient(start), (matrix + matrix.T) @ start - 2, rtol=1e-10, atol=1e-12
    )
    np.testing.assert_allclose(dense(problem, start), matrix + matrix.T, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("first", [True, False])
def test_a_sparse_hessian_of_a_large_term_is_found_sparse(first):
    m = model_with(300, 0.4)
    m.y = pyo.Var(initialize=0.7)
    cubes = sum(m.x[i] ** 3 for i in range(300))
    factor = m.y + 1
    problem, x = compiled(m, factor * cubes if first else cubes * factor)
    assert len(problem.hessianstructure()[0]) == 600
    where = {v.name: k for k, v in enumerate(problem.variables)}
    full = dense(problem, x)
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


def test_equal_shapes_are_compiled_once_per_process():
    def build():
        m = model_with(30, 0.5)
        m.c = pyo.Constraint(
            range(29),
            rule=lambda m, i: pyo.sinh(m.x[i] * m.x[i + 1]) + pyo.acosh(2 + m.x[i]) <= i + 2,
        )
        return compile_model(m)

    build()
    before = shapes.shape_of.cache_info().misses
    problem = build()
    assert shapes.shape_of.cache_info().misses == before
    assert problem.m == 29


X = 0.625
P = -1.75
PLAIN = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "pow": operator.pow,
}

leaves = st.sampled_from([("x", X), ("p", P), *((c, c) for c in (0.0, 1.0, -1.0, 2.0, 0.5, -3.0))])
steps = st.lists(
    st.tuples(
        st.sampled_from(["add", "sub", "mul", "div", "neg", "pow"]),
        st.integers(0, 50),
        st.integers(0, 50),
    ),
    max_size=12,
)


def leaf(graph, name):
    if name == "x":
        return graph.variable(0)
    return graph.datum(0) if name == "p" else graph.constant(name)


def evaluate(graph, node):
    hoisted = hoist(graph, [node])
    data = {n: graph.args[n][0] for n in range(len(graph.op)) if graph.op[n] == "datum"}
    prepared = outputs_of(record(graph, list(hoisted), data, {}), [[]], [[P]])
    return outputs_of(record(graph, [node], hoisted, {0: 0}), [[X]], prepared.reshape(-1, 1))[0]


def outputs_of(tape, x, data):
    """Outputs (outputs * instances,) for variables x and data, each with one row an instance."""
    points, rows = np.array(x, dtype=float), np.array(data, dtype=float)
    columns = np.arange(points.size, dtype=np.int32).reshape(points.shape).T.copy()
    count = len(points)
    total = np.zeros(tape.outputs * count)
    places = np.arange(len(total), dtype=np.int32)
    tape.run(points.ravel(), columns, rows.T.copy(), np.ones(count), places, total)
    return total


@pytest.mark.slow
@settings(max_examples=400, deadline=None, derandomize=True)
@given(st.lists(leaves, min_size=2, max_size=5), steps)
def test_simplification_changes_no_value(start, program):
    graph = Graph()
    nodes, values = [leaf(graph, name) for name, _ in start], [value for _, value in start]
    for operation, i, j in program:
        a, b = i % len(nodes), j % len(nodes)
        u, v = values[a], values[b]
        try:
            value = -u if operation == "neg" else PLAIN[operation](u, v)
        except (ArithmeticError, ValueError):
            continue
        if isinstance(value, complex) or not 1e-6 < abs(value) + 1e-5 < 1e6:
            continue
        nodes.append(
            graph.neg(nodes[a])
            if operation == "neg"
            else getattr(graph, operation)(nodes[a], nodes[b])
        )
        values.append(value)
    for node, value in zip(nodes, values, strict=True):
        assert evaluate(graph, node) == pytest.approx(value, rel=1e-9, abs=1e-9)


def test_equal_expressions_are_one_node():
    graph = Graph()
    x, p = graph.variable(0), graph.datum(0)
    assert graph.mul(x, p) == graph.mul(p, x)
    assert graph.add(graph.call("sin", x), p) == graph.add(p, graph.call("sin", x))
    assert graph.sub(x, x) == graph.zero
    assert graph.neg(graph.sub(x, p)) == graph.sub(p, x)
    assert graph.mul(graph.constant(2), graph.mul(graph.constant(3), x)) == graph.mul(
        graph.constant(6), x
    )
    assert graph.call("cos", graph.constant(0.0)) == graph.one


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_the_sparsity_of_a_product_has_both_triangles(order):
    graph = Graph()
    x = {i: graph.variable(i) for i in order}
    curved = graph.call("exp", graph.add(x[1], x[2]))
    found = {tuple(pair) for pair in hessian_sparsity(graph, graph.mul(x[0], curved)).T.tolist()}
    assert found == {(1, 0), (2, 0), (1, 1), (2, 1), (2, 2)}


def test_what_has_no_value_is_kept_for_the_evaluation_to_report():
    graph = Graph()
    assert math.isinf(evaluate(graph, graph.call("log", graph.zero)))
    assert math.isnan(evaluate(graph, graph.pow(graph.constant(-8.0), graph.constant(0.3))))
    assert math.isinf(evaluate(graph, graph.div(graph.one, graph.zero)))
