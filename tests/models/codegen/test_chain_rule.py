"""Products with Jacobians over what expressions share: against the Jacobian itself, against each other, and no longer than they must be."""

import re

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene, scene_names
from models.codegen.c_function import (
    Derivative,
    SceneVectors,
    Vector,
    backward_function,
    forward_function,
    pull_back,
    push_forward,
    tangent,
)
from models.dynamics import derive

X, P, W = Vector.of("x", ("a", "b", "c")), Vector.of("p", ("k",)), Vector.of("w", ("0", "1", "2"))


def _numbers(derivative: Derivative, values: dict[sp.Symbol, float]) -> list[np.ndarray]:
    known = dict(values)
    for symbol, value in derivative.definitions:
        known[symbol] = float(value.xreplace(known))
    return [np.array([float(sp.sympify(entry).xreplace(known)) for entry in column]) for column in derivative.columns]


def _values(random: np.random.Generator, *vectors: Vector) -> dict[sp.Symbol, float]:
    return {symbol: float(value) for vector in vectors for symbol, value in zip(vector.symbols, random.normal(size=9), strict=False)}


def _column() -> sp.Matrix:
    a, b, c = X.symbols
    (k,) = P.symbols
    shared = sp.sin(a * b) + k * c**2
    return sp.Matrix([shared**3 * sp.exp(-shared), shared / (1 + sp.cos(c) ** 2) + a, k * sp.tanh(shared) * sp.sqrt(1 + b**2)])


def test_both_products_are_those_of_the_jacobian():
    function, random = _column(), np.random.default_rng(3)
    values = _values(random, X, P, W, tangent(X), tangent(P))
    jacobian = [np.array(function.jacobian(x.column).xreplace(values).tolist(), dtype=float) for x in (X, P)]
    along, weights = ([np.array([values[s] for s in tangent(x).symbols]) for x in (X, P)], np.array([values[s] for s in W.symbols]))

    (pushed,) = _numbers(push_forward(function, [(X, tangent(X)), (P, tangent(P))]), values)
    assert pushed == pytest.approx(jacobian[0] @ along[0] + jacobian[1] @ along[1], rel=1e-13)
    pulled = _numbers(pull_back(function, W, [X, P]), values)
    assert pulled[0] == pytest.approx(jacobian[0].T @ weights, rel=1e-13)
    assert pulled[1] == pytest.approx(jacobian[1].T @ weights, rel=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", scene_names())
def test_products_of_the_equations_of_motion_are_each_others_transposes(name: str):
    """w . (df/dx dx) = (df/dx' w) . dx for the residual f - M a of every scene, along everything it depends on."""
    x = SceneVectors.of(derive(load_scene(name)))
    a = x.q.like("a")
    residual = x.local(x.dynamics.generalised_force) - x.local(x.dynamics.mass_matrix) * a.column
    moving = [vector for vector in (*x.arguments, a) if vector.symbols]
    weights, random = x.q.like("w"), np.random.default_rng(7)
    values = {symbol: float(random.uniform(0.3, 1.3)) for vector in (*moving, *map(tangent, moving), weights) for symbol in vector.symbols}
    (pushed,) = _numbers(push_forward(residual, [(vector, tangent(vector)) for vector in moving]), values)
    pulled = _numbers(pull_back(residual, weights, moving), values)
    forward = pushed @ np.array([values[symbol] for symbol in weights.symbols])
    terms = [bar @ np.array([values[s] for s in tangent(vector).symbols]) for vector, bar in zip(moving, pulled, strict=True)]
    assert abs(forward) > 1e-3
    assert sum(terms) == pytest.approx(forward, rel=1e-10, abs=1e-10 * sum(map(abs, terms)))


def test_shared_subexpressions_are_differentiated_once():
    """Thirty nested products: written out they have 2^30 terms."""
    (x,) = (vector := Vector.of("x", ("a",))).symbols
    value: sp.Expr = x
    for _ in range(30):
        value = sp.sin(value) * value
    for derivative in (
        push_forward(sp.Matrix([value]), [(vector, tangent(vector))]),
        pull_back(sp.Matrix([value]), Vector.of("w", ("0",)), [vector]),
    ):
        assert sum(int(sp.count_ops(term)) for _, term in derivative.definitions) < 30 * 12


def test_c_functions_define_before_they_use_and_leave_out_what_nothing_needs():
    pushed = forward_function("void push", (X, P, tangent(X)), "df", _column(), [X])
    pulled = backward_function("void pull", (X, P, W), sp.Matrix([X.symbols[0] ** 2 * P.symbols[0], 0, sp.sin(P.symbols[0])]), W, [X])
    for text in (pushed, pulled):
        lines = text.splitlines()
        defined = {line.split()[2]: number for number, line in enumerate(lines) if line.startswith("    const double ")}
        used = {name: [n for n, line in enumerate(lines) if re.search(rf"\b{name}\b", line.partition("=")[2])] for name in defined}
        assert all(numbers and min(numbers) > defined[name] for name, numbers in used.items()), text
    assert "sin" in pushed
    assert "sin" not in pulled  # sin(k) does not depend on x


def test_derivatives_of_empty_columns_are_empty():
    nothing, empty = sp.zeros(0, 1), Vector.of("w", ())
    assert push_forward(nothing, [(X, tangent(X))]).columns[0].shape == (0, 1)
    assert pull_back(nothing, empty, [X]).columns[0] == sp.zeros(3, 1)
