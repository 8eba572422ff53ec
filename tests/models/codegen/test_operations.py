"""Arithmetic of the generated C: counted rightly, and about what the equations cost on paper.

Products with Jacobians over what expressions share; and single steps, linearised one by one and run
with feedback.
"""

import ctypes
import re
from collections import Counter
from functools import cache

import numpy as np
import pytest
import sympy as sp
from example_scenes import example_scene

from models.catalog import load_scene, scene_names
from models.codegen.c_function import (
    Definitions,
    SceneVectors,
    Vector,
    backward_function,
    forward_function,
    pull_back,
    push_forward,
    tangent,
)
from models.codegen.compiler import compile_shared, find_compiler
from models.codegen.emit import cholesky_function, count_operations, emit_model, step_operations
from models.codegen.kernel import KernelError, load_kernel
from models.codegen.steps import Steps, load_steps
from models.contact_law import ContactLaw
from models.dynamics import derive
from models.scenes.cart_chain import cart_chain

# Counted by hand from the equations as one would write them: (additions, multiplications,
# divisions, roots and sines).
PAPER = {
    # a = (lam - m g) / m
    "bouncing_mass": (1, 1, 1, 0),
    # gap 2 r - (q2 - q1); -lam / m1, lam / m2
    "two_body_collision": (2, 1, 2, 0),
    # two gaps of two additions; 1/m once; each cart: damping, two more forces, times 1/m
    "three_cart": (4 + 6, 6, 1, 0),
    # gap l theta - w; (u + m g l theta - l lam) / (m l^2)
    "wall_pendulum": (1 + 2, 1 + 4 + 2, 1, 0),
    # spring k (l0 - (z - y)); body: spring + u - m g; foot: lam - spring - u - m g; over the masses
    "hopper": (2 + 2 + 3, 1 + 2, 2, 0),
    # two gaps of two additions, slip, mu m g, forces on the cargo; cargo, cart
    "transport": (4 + 1 + 2 + 1, 2, 2, 0),
    # gap 2 r - |d|; again |d| for the direction, lam / |d|, forces, times 1/m
    "two_discs": (2 + 2 + 1 + 2 + 2 + 2, 2 + 1 + 2 + 4 + 4, 2, 2),
    # x and y of the finger from the box turned; D with two cosh, two exp, one log; its gradient
    # with two sinh; slip: two relative velocities turned, omega times the arms, over the sum; gap
    # and slip Jacobians of x, y and turn, times lam and f; drag and drive over m, over m c^2
    "push_box": (5 + 12 + 12 + 9, 12 + 22 + 1 + 26 + 18, 1 + 1 + 4, 7 + 8 + 8),
    # leg sqrt(dx^2 + dz^2 + e^2); thrust less damping along it, hip across, spring; body, foot,
    # gravity, over the masses; mu N
    "hopper_planar": (2 + 2 + 3 + 2 + 2 + 6, 3 + 2 + 2 + 4 + 2 + 1 + 4 + 2 + 1, 3 + 1 + 3, 1),
    # gaps: tip of a finger four products and five sums, distance; M: inertias, two cosines; forces:
    # sine of a, w^2, moments of lam/d about two joints; disc; solve: two blocks of two
    "two_finger": (17 + 5 + 34 + 6, 13 + 13 + 46 + 6, 2 + 16, 10 + 2 + 12 + 7),
    # the same; table; slips: velocity of the tip across the line of centres, turning; mu N; gravity
    # of links and disc; friction at three bodies
    "two_finger_lift": (
        19 + 29 + 57 + 5 + 6,
        13 + 30 + 2 + 77 + 13 + 6,
        4 + 6 + 16,
        10 + 10 + 12 + 2 + 7,
    ),
    # tip x + l sin; M: m_c + m_p, l m_p cos, l l m_p; forces; 2 x 2 Cholesky. Sine and cosine are
    # called by each function that needs them
    "cart_pole_walls": (3 + 1 + 4 + 3, 1 + 1 + 2 + 8 + 3, 5, 4 + 2),
    # gaps; M with one cosine; forces with three sines; 2 x 2 Cholesky
    "acrobot_limits": (2 + 4 + 8 + 3, 2 + 8 + 17 + 3, 5, 4 + 2),
}


@pytest.mark.parametrize("name", PAPER)
def test_generated_arithmetic_is_that_on_paper(name: str):
    """Never a kind of operation that the paper does not have, and at most a fifth more in all: signs and shared terms fall differently."""
    found, paper = step_operations(load_scene(name)), PAPER[name]
    assert found["divide"] <= paper[2]
    assert found["call"] <= paper[3]
    assert sum(found.values()) <= 1.2 * sum(paper)


@pytest.mark.parametrize("n", [2, 3, 8, 20])
def test_a_chain_costs_a_fixed_number_of_operations_a_cart(n: int):
    """n - 1 gaps of two additions.

    Each cart c v, 1/m and two additions (damping; at the ends input and one contact, else two
    contacts); 1/m once.
    """
    assert step_operations(cart_chain(n)) == {
        "add": 2 * (n - 1) + 2 * n,
        "multiply": 2 * n,
        "divide": 1,
        "call": 0,
    }


@pytest.mark.parametrize(("expression", "expected"), [
    ("a + b*c", Counter(add=1, multiply=1)), ("-a - (-b)", Counter(add=1)),
    ("(1.0/2.0)*a", Counter(multiply=1)),
    ("1.0/(a*a)", Counter(multiply=1, divide=1)),
    ("sqrt(a*a + 1.0e-12) + sin(2.0)", Counter(add=2, multiply=1, call=1)),
    ("pow(a, b + c)", Counter(add=1, call=1)), ("x[3] + x[i]*2.5e+3", Counter(add=1, multiply=1)),
    ("scene_energy(a*b, c)", Counter(multiply=1)),
    ("3.0*4.0", Counter()),
])  # fmt: skip
def test_every_form_of_arithmetic_is_counted(expression: str, expected: Counter):
    text = f"SCENE_FUNCTION double f(const double *x)\n{{\n    const double a = x[0];\n    return {expression};\n}}\n"
    assert count_operations(text) == {"f": expected}


@pytest.mark.slow
def test_squared_factors_are_computed_once():
    """Of two fingers: eight sines and cosines and two roots for both gaps."""
    assert count_operations(emit_model(load_scene("two_finger")))["scene_penetration"] == Counter(
        add=17, multiply=13, call=10
    )


def test_adding_to_a_result_is_an_addition():
    assert count_operations(
        "SCENE_FUNCTION void f(double *y)\n{\n    y[0] += a*b;\n    (void)q;\n}\n"
    ) == {"f": Counter(add=1, multiply=1)}


def cholesky_on_paper(n: int) -> Counter:
    """The loops of a dense factorisation and of its two triangular solves, walked."""
    products = sum(j + (n - 1 - j) * j for j in range(n)) + 2 * sum(range(n))
    return Counter(
        add=products, multiply=products, divide=sum(n - 1 - j for j in range(n)) + 2 * n, call=n
    )


def solve_operations(mass: sp.Matrix) -> Counter:
    return count_operations(cholesky_function(mass))["scene_solve"]


def test_solving_costs_what_a_dense_factorisation_does_where_the_mass_matrix_is_dense():
    for n in range(1, 9):
        assert solve_operations(sp.ones(n)) == cholesky_on_paper(n)


def test_zeros_of_the_mass_matrix_cost_nothing():
    """Two fingers and a disc: two blocks of two, three numbers on the diagonal.

    An arrow costs as its point is first (fill) or last (none).
    """
    block = sp.ones(2)
    fingers = sum(
        [cholesky_on_paper(2), cholesky_on_paper(2), *[cholesky_on_paper(1)] * 3], Counter()
    )
    assert solve_operations(sp.diag(block, block, 1, 1, 1)) == fingers
    assert solve_operations(derive(load_scene("two_finger")).mass_matrix) == fingers
    last = sp.eye(5)
    last[4, :] = sp.ones(1, 5)
    last[:, 4] = sp.ones(5, 1)
    assert solve_operations(last[::-1, ::-1]) == cholesky_on_paper(5)
    assert solve_operations(last)["multiply"] == 4 + 2 * 4


@pytest.mark.parametrize("seed", range(4))
def test_a_sparse_factorisation_solves_what_a_dense_one_does(seed: int, tmp_path):
    """Compiled, against numpy, for random patterns."""
    rng = np.random.default_rng(seed)
    n = 6
    factor = np.tril(rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.4)) + 2 * np.eye(n)
    mass, b = factor @ factor.T, rng.normal(size=n)
    head = '#include <math.h>\n#define NQ 6\n#define SCENE_INLINE __attribute__((visibility("default")))\n'
    library = tmp_path / "solve.so"
    compile_shared(find_compiler(), {"solve.c": head + cholesky_function(sp.Matrix(mass))}, library)
    solve = ctypes.CDLL(str(library)).scene_solve
    M, x = mass.copy(), b.copy()
    assert solve(M.ctypes.data_as(ctypes.c_void_p), x.ctypes.data_as(ctypes.c_void_p)) == 0
    assert x == pytest.approx(np.linalg.solve(mass, b), rel=1e-12, abs=1e-12)
    M = -mass
    assert solve(M.ctypes.data_as(ctypes.c_void_p), x.ctypes.data_as(ctypes.c_void_p)) == 1


def test_no_trigonometry_where_there_is_none():
    assert (
        count_operations(emit_model(load_scene("three_cart")))["scene_acceleration_vjp"]["call"]
        == 0
    )
    assert step_operations(load_scene("cart_pole_walls"))["call"] > cholesky_on_paper(2)["call"]


X = Vector.of("x", ("a", "b", "c"))
P = Vector.of("p", ("k",))
W = Vector.of("w", ("0", "1", "2"))


def _numbers(
    definitions: Definitions, columns: list[sp.Matrix], values: dict[sp.Symbol, float]
) -> list[np.ndarray]:
    known = dict(values)
    for symbol, value in definitions:
        known[symbol] = float(value.xreplace(known))
    return [
        np.array([float(sp.sympify(entry).xreplace(known)) for entry in column])
        for column in columns
    ]


def _pushed(
    function: sp.Matrix, vectors: list[Vector], values: dict[sp.Symbol, float]
) -> np.ndarray:
    definitions, column = push_forward(function, vectors)
    return _numbers(definitions, [column], values)[0]


def _values(random: np.random.Generator, *vectors: Vector) -> dict[sp.Symbol, float]:
    return {
        symbol: float(value)
        for vector in vectors
        for symbol, value in zip(vector.symbols, random.normal(size=9), strict=False)
    }


def _column() -> sp.Matrix:
    a, b, c = X.symbols
    (k,) = P.symbols
    shared = sp.sin(a * b) + k * c**2
    return sp.Matrix(
        [
            shared**3 * sp.exp(-shared),
            shared / (1 + sp.cos(c) ** 2) + a,
            k * sp.tanh(shared) * sp.sqrt(1 + b**2),
        ]
    )


def test_both_products_are_those_of_the_jacobian():
    function, random = _column(), np.random.default_rng(3)
    values = _values(random, X, P, W, tangent(X), tangent(P))
    jacobian = [
        np.array(function.jacobian(x.column).xreplace(values).tolist(), dtype=float) for x in (X, P)
    ]
    along, weights = (
        [np.array([values[s] for s in tangent(x).symbols]) for x in (X, P)],
        np.array([values[s] for s in W.symbols]),
    )

    assert _pushed(function, [X, P], values) == pytest.approx(
        jacobian[0] @ along[0] + jacobian[1] @ along[1], rel=1e-13
    )
    pulled = _numbers(*pull_back(function, W, [X, P]), values)
    assert pulled[0] == pytest.approx(jacobian[0].T @ weights, rel=1e-13)
    assert pulled[1] == pytest.approx(jacobian[1].T @ weights, rel=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", scene_names())
def test_products_of_the_equations_of_motion_are_each_others_transposes(name: str):
    """w .

    (df/dx dx) = (df/dx' w) . dx for the residual f - M a of every scene, along everything it
    depends on.
    """
    x = SceneVectors.of(derive(load_scene(name)))
    a = x.q.like("a")
    residual = x.local(x.dynamics.generalised_force) - x.local(x.dynamics.mass_matrix) * a.column
    moving = [vector for vector in (*x.arguments, a) if vector.symbols]
    weights, random = x.q.like("w"), np.random.default_rng(7)
    values = {
        symbol: float(random.uniform(0.3, 1.3))
        for vector in (*moving, *map(tangent, moving), weights)
        for symbol in vector.symbols
    }
    pulled = _numbers(*pull_back(residual, weights, moving), values)
    forward = _pushed(residual, moving, values) @ np.array(
        [values[symbol] for symbol in weights.symbols]
    )
    terms = [
        bar @ np.array([values[s] for s in tangent(vector).symbols])
        for vector, bar in zip(moving, pulled, strict=True)
    ]
    assert abs(forward) > 1e-3
    assert sum(terms) == pytest.approx(forward, rel=1e-10, abs=1e-10 * sum(map(abs, terms)))


def test_shared_subexpressions_are_differentiated_once():
    """Thirty nested products: written out they have 2^30 terms."""
    (x,) = (vector := Vector.of("x", ("a",))).symbols
    value: sp.Expr = x
    for _ in range(30):
        value = sp.sin(value) * value
    for definitions, _ in (
        push_forward(sp.Matrix([value]), [vector]),
        pull_back(sp.Matrix([value]), Vector.of("w", ("0",)), [vector]),
    ):
        assert sum(int(sp.count_ops(term)) for _, term in definitions) < 30 * 12


def test_c_functions_define_before_they_use_and_leave_out_what_nothing_needs():
    pushed = forward_function("void push", (X, P, tangent(X)), "df", _column(), [X])
    pulled = backward_function(
        "void pull",
        (X, P, W),
        sp.Matrix([X.symbols[0] ** 2 * P.symbols[0], 0, sp.sin(P.symbols[0])]),
        W,
        [X],
    )
    for text in (pushed, pulled):
        lines = text.splitlines()
        defined = {
            line.split()[2]: number
            for number, line in enumerate(lines)
            if line.startswith("    const double ")
        }
        used = {
            name: [
                n
                for n, line in enumerate(lines)
                if re.search(rf"\b{name}\b", line.partition("=")[2])
            ]
            for name in defined
        }
        assert all(numbers and min(numbers) > defined[name] for name, numbers in used.items()), text
    assert "sin" in pushed
    assert "sin" not in pulled  # sin(k) does not depend on x


def test_derivatives_of_empty_columns_are_empty():
    nothing, empty = sp.zeros(0, 1), Vector.of("w", ())
    assert push_forward(nothing, [X])[1].shape == (0, 1)
    assert pull_back(nothing, empty, [X])[1] == [sp.zeros(3, 1)]


LAWS = ((ContactLaw.RELU, None), (ContactLaw.SOFTPLUS, 1e-3))
# States in contact, away from kinks: (positions, velocities).
STATES = {
    "three_cart": (2.0, 2.4, 2.8, 0.3, -0.2, 0.1), "acrobot_limits": (0.3, -0.5, 0.7, -0.4),
    "transport": (2.2, 1.0, 0.5, -0.4),
    "cart_pole_walls": (0.7, 0.5, 0.2, -0.3), "damped_arm": (0.2, -0.06, 0.5, 0.3, -0.2, 0.4),
}  # fmt: skip


@cache
def steps_of(name: str) -> Steps:
    return load_steps(example_scene(name))


@pytest.mark.parametrize("name", STATES)
@pytest.mark.parametrize(("law", "eps"), LAWS)
def test_jacobians_are_finite_differences_of_the_step(
    name: str, law: ContactLaw, eps: float | None
):
    steps = steps_of(name)
    random = np.random.default_rng(1)
    x = np.array(STATES[name]) + 0.01 * random.normal(size=(3, len(STATES[name])))
    u = random.normal(size=(3, steps.scene.nu))
    h = 0.005
    found = steps.linearise(x, u, h, law, eps)
    assert found is not None
    delta = 1e-6
    for index in range(x.shape[1]):
        side = delta * np.eye(x.shape[1])[index]
        ends = [steps.linearise(x + sign * side, u, h, law, eps) for sign in (1.0, -1.0)]
        slope = (ends[0].next - ends[1].next) / (2 * delta)
        np.testing.assert_allclose(found.A[:, :, index], slope, rtol=1e-6, atol=1e-7)
    for index in range(steps.scene.nu):
        side = delta * np.eye(steps.scene.nu)[index]
        ends = [steps.linearise(x, u + sign * side, h, law, eps) for sign in (1.0, -1.0)]
        slope = (ends[0].next - ends[1].next) / (2 * delta)
        np.testing.assert_allclose(found.B[:, :, index], slope, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", STATES)
def test_steps_one_by_one_are_the_rollout_bit_for_bit(name: str):
    steps, scene = steps_of(name), example_scene(name)
    u = np.random.default_rng(2).normal(size=(40, scene.nu))
    whole = load_kernel(scene).rollout(np.array(STATES[name]), u, 0.005)
    x = np.hstack([whole.q, whole.v])
    alone = steps.linearise(x[:-1], u, 0.005)
    assert np.array_equal(alone.next, x[1:])
    assert np.array_equal(alone.lam, whole.lam)
    assert np.array_equal(steps.ends(x[:-1], u, 0.005), x[1:])
    run = steps.follow(
        x[0], np.zeros((40, x.shape[1])), u, np.zeros((40, scene.nu, x.shape[1])), 0.005
    )
    assert np.array_equal(run.x, x)
    assert np.array_equal(run.u, u)
    assert not run.diverged


def test_feedback_jumps_and_bounds_are_what_the_docstring_says():
    steps, scene = steps_of("cart_pole_walls"), load_scene("cart_pole_walls")
    n, h, random = 20, scene.task.step, np.random.default_rng(3)
    x_plan, u_plan = random.normal(size=(n, 4)), 3.0 * random.normal(size=(n, 1))
    gain, jump = 5.0 * random.normal(size=(n, 1, 4)), 1e-3 * random.normal(size=(n, 4))
    run = steps.follow(np.array(scene.task.start), x_plan, u_plan, gain, h, jump=jump)
    asked = u_plan + np.einsum("tij,tj->ti", gain, run.x[:-1] - x_plan)
    np.testing.assert_allclose(run.u, np.clip(asked, -4.0, 4.0), rtol=1e-12)
    assert (np.abs(asked) > 4.0).any()
    assert (np.abs(asked) < 4.0).any()
    alone = steps.linearise(run.x[:-1], run.u, h)
    np.testing.assert_allclose(run.x[1:], alone.next + jump, rtol=1e-12, atol=1e-14)


def test_non_finite_steps_are_reported():
    steps = steps_of("three_cart")
    x = np.array([STATES["three_cart"]])
    assert steps.linearise(x, np.array([[np.inf, 0.0]]), 0.01) is None
    assert steps.ends(x, np.array([[np.inf, 0.0]]), 0.01) is None
    run = steps.follow(
        x[0],
        np.zeros((3, 6)),
        np.array([[0.0, 0.0], [np.nan, 0.0], [0.0, 0.0]]),
        np.zeros((3, 2, 6)),
        0.01,
    )
    assert run.diverged
    assert run.finite_steps == 1
    with pytest.raises(KernelError, match=r"x has shape \(1, 5\)"):
        steps.linearise(x[:, :5], np.zeros((1, 2)), 0.01)


@pytest.mark.parametrize(
    ("entries", "others"),
    [
        (("y", "bar_y"), ("y",)),
        (("bar",), ()),
        (("friction_rail", "friction_rail"), ()),
    ],
)
def test_vector_confusable_entries_distinct_symbols(
    entries: tuple[str, ...], others: tuple[str, ...]
):
    symbols = [*Vector.of("a", entries).symbols, *Vector.of("a_bar", others).symbols]
    names = ["a", "a_bar", *(symbol.name for symbol in symbols)]
    assert len(set(names)) == len(names)
