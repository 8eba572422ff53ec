"""Values, gradients and Hessians against two independent roads: Pyomo's own differentiation, and mpmath at 40 digits."""

import math

import mpmath
import numpy as np
import pyomo.environ as pyo
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyomo.core.expr.calculus.derivatives import Modes, differentiate

from formulations.ipopt import compile_model

# Both roads round each operation once or twice; a dozen nested operations lose at most four of sixteen digits.
RELATIVE = 1e-10


def dense(problem, x, multipliers, factor):
    hessian = np.zeros((problem.n, problem.n))
    rows, columns = problem.hessianstructure()
    hessian[rows, columns] = problem.hessian(x, multipliers, factor)
    return hessian + np.tril(hessian, -1).T


def one_expression(build, values):
    """(model, variables, problem, x) of an objective built from variables that start at values; x in the problem's order."""
    m = pyo.ConcreteModel()
    m.x = pyo.Var(range(len(values)), initialize=dict(enumerate(values)))
    m.p = pyo.Param([0, 1], initialize={0: 1.5, 1: 0.5}, mutable=True)
    m.cost = pyo.Objective(expr=build(m))
    problem = compile_model(m)
    return m, problem, problem.start()[0]


_UNARY = [pyo.sin, pyo.cos, pyo.atan]  # those that Pyomo can differentiate; the others are compared with mpmath below
_POSITIVE = [pyo.log, pyo.sqrt, pyo.log10]


@st.composite
def recipes(draw, depth=4):
    """A nested tuple that `assemble` turns into an expression with values of moderate size."""
    kind = draw(
        st.sampled_from(["x", "x", "p", "n"] if depth == 0 else ["x", "n", "f", "g", "e", "+", "-", "*", "/", "^", "v", "s", "neg"])
    )
    if kind in ("x", "p"):
        return kind, draw(st.integers(0, 2 if kind == "x" else 1))
    if kind == "n":
        return kind, draw(st.sampled_from([1, 2, -1, 0.5, 3.25, -0.75]))
    if kind in ("f", "g"):
        return kind, draw(st.integers(0, len(_UNARY if kind == "f" else _POSITIVE) - 1)), draw(recipes(depth - 1))
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


@settings(max_examples=120, deadline=None, derandomize=True)
@given(recipes(), st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3))
def test_random_expressions_equal_pyomos_symbolic_derivatives(recipe, values):
    m, problem, x = one_expression(lambda m: assemble(m, recipe) + m.x[0] * m.x[1], values)
    expression, order = m.cost.expr, list(problem.variables)
    scale = max(1.0, abs(pyo.value(expression)))
    assert problem.objective(x) == pytest.approx(pyo.value(expression), rel=RELATIVE, abs=RELATIVE * scale)
    slopes = differentiate(expression, wrt_list=order, mode=Modes.reverse_symbolic)
    gradient = np.array([pyo.value(s) for s in slopes])
    size = max(1.0, np.abs(gradient).max())
    np.testing.assert_allclose(problem.gradient(x), gradient, rtol=RELATIVE, atol=RELATIVE * size)
    reference = np.zeros((problem.n, problem.n))
    for i, slope in enumerate(slopes):
        if hasattr(slope, "is_potentially_variable") and slope.is_potentially_variable():
            reference[i] = [float(v) for v in differentiate(slope, wrt_list=order, mode=Modes.reverse_numeric)]
    size = max(1.0, np.abs(reference).max())
    np.testing.assert_allclose(dense(problem, x, np.zeros(0), 1.0), reference, rtol=RELATIVE, atol=RELATIVE * size)


_POINTS = {
    "exp": (-3.0, 0.0, 2.5), "log": (0.01, 1.0, 40.0), "log10": (0.01, 1.0, 40.0), "sqrt": (0.01, 2.0), "sin": (0.0, 2.0), "cos": (0.0, 2.0),
    "tan": (0.0, 1.2), "asin": (-0.9, 0.3), "acos": (-0.9, 0.3), "atan": (-4.0, 0.2), "sinh": (-2.0, 0.5), "cosh": (-2.0, 0.5),
    "tanh": (-3.0, 0.0, 20.0), "asinh": (-2.0, 30.0), "acosh": (1.01, 5.0), "atanh": (-0.7, 0.95),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(_POINTS))
def test_every_intrinsic_function_to_twelve_digits(name):
    exact = getattr(mpmath, name)
    for point in _POINTS[name]:
        _, problem, x = one_expression(lambda m: getattr(pyo, name)(m.x[0]), [point])
        with mpmath.workdps(40):
            value, first, second = (float(mpmath.diff(exact, mpmath.mpf(point), n)) for n in range(3))
        assert problem.objective(x) == pytest.approx(value, rel=1e-12, abs=1e-15)
        assert problem.gradient(x)[0] == pytest.approx(first, rel=1e-12, abs=1e-15)
        assert dense(problem, x, np.zeros(0), 1.0)[0, 0] == pytest.approx(second, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize(
    "write",
    [
        lambda z: pyo.log(1 + pyo.exp(z)),
        lambda z: pyo.log(pyo.exp(z) + 1),
        lambda z: pyo.log(1.0 + pyo.exp(0.25 * z + 0.75 * z)),
        lambda z: pyo.log(pyo.exp(z) + pyo.exp(0 * z)),
        lambda z: pyo.log10(1 + pyo.exp(z)) * math.log(10.0),
    ],
)
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
    assert dense(problem, x, np.zeros(0), 1.0)[0, 0] == pytest.approx(float(second), rel=1e-13, abs=1e-300)


def test_the_logarithm_of_two_exponentials_is_a_smooth_maximum():
    _, problem, x = one_expression(lambda m: pyo.log(pyo.exp(m.x[0]) + pyo.exp(3 * m.x[1])), [800.0, 267.0])
    # max(800, 801) + log(1 + e^-1), and the weights of a softmax
    assert problem.objective(x) == pytest.approx(801 + math.log1p(math.exp(-1)), rel=1e-14)
    share = 1 / (1 + math.exp(-1))
    assert problem.gradient(x) == pytest.approx([1 - share, 3 * share], rel=1e-13)


def test_a_data_factor_is_carried_through_a_difference():
    m, problem, x = one_expression(lambda m: m.p[0] * (m.x[0] - 2 * m.x[1] - m.p[1]) / m.p[1], [3.0, 5.0])
    assert problem.objective(x) == pytest.approx(pyo.value(m.cost))
    assert problem.gradient(x) == pytest.approx([3.0, -6.0])
    assert len(problem.hessianstructure()[0]) == 0


def test_logistic_survives_a_huge_argument():
    _, problem, x = one_expression(lambda m: 3 / (1 + pyo.exp(m.x[0])), [900.0])
    assert problem.objective(x) == pytest.approx(0.0, abs=1e-300)
    assert np.isfinite(problem.gradient(x)).all()
    assert np.isfinite(problem.hessian(x, np.zeros(0), 1.0)).all()


@pytest.mark.parametrize(
    ("write", "expected"),
    [
        (lambda m: m.x[0] ** 2, (0.0, 0.0, 2.0)),
        (lambda m: m.x[0] ** 3, (0.0, 0.0, 0.0)),
        (lambda m: m.x[0] ** 1, (0.0, 1.0, 0.0)),
        (lambda m: m.x[0] ** 2.5, (0.0, 0.0, 0.0)),
        (lambda m: (m.x[0] - 2) ** 3, (-8.0, 12.0, -12.0)),
        (lambda m: m.x[0] ** (2 * m.p[0] - 1), (0.0, 0.0, 2.0)),  # data exponents 2, 1 and 0
        (lambda m: m.x[0] ** (2 * m.p[1]), (0.0, 1.0, 0.0)),
        (lambda m: m.x[0] ** (m.p[0] - 1.5), (1.0, 0.0, 0.0)),
    ],
)
def test_powers_are_right_at_zero(write, expected):
    _, problem, x = one_expression(lambda m: write(m) + 0 * m.x[0] ** 2, [0.0])
    found = (problem.objective(x), problem.gradient(x)[0], dense(problem, x, np.zeros(0), 1.0)[0, 0])
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
    m.cost = pyo.Objective(expr=m.p * m.x[0] ** 4 + m.x[1] * m.x[3], sense=pyo.maximize)
    problem = compile_model(m)
    x, _ = problem.start()
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
        differences[:, k] = (problem.constraints(x + shift) - problem.constraints(x - shift)) / (2 * step)
        curvature[:, k] = (lagrangian_slope(x + shift) - lagrangian_slope(x - shift)) / (2 * step)
    # Central differences with step 1e-6: truncation 1e-12, rounding 1e-10.
    np.testing.assert_allclose(jacobian, differences, atol=1e-8)
    np.testing.assert_allclose(dense(problem, x, multipliers, 2.0), curvature, atol=1e-8)
    assert problem.objective(x) == pytest.approx(-pyo.value(m.cost))
