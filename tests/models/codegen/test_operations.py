"""Arithmetic of the generated C: counted rightly, and about what the equations cost on paper."""

import ctypes

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene
from models.codegen.compiler import compile_shared, find_compiler
from models.codegen.emit import Operations, cholesky_function, count_operations, emit_model, step_operations
from models.dynamics import derive
from models.scenes.cart_chain import cart_chain

# Counted by hand from the equations as one would write them: (additions, multiplications, divisions, roots and sines).
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
    # x and y of the finger from the box turned; D with two cosh, two exp, one log; its gradient with two sinh; slip: two relative velocities turned,
    # omega times the arms, over the sum; gap and slip Jacobians of x, y and turn, times lam and f; drag and drive over m, over m c^2
    "push_box": (5 + 12 + 12 + 9, 12 + 22 + 1 + 26 + 18, 1 + 1 + 4, 7 + 8 + 8),
    # leg sqrt(dx^2 + dz^2 + e^2); thrust less damping along it, hip across, spring; body, foot, gravity, over the masses; mu N
    "hopper_planar": (2 + 2 + 3 + 2 + 2 + 6, 3 + 2 + 2 + 4 + 2 + 1 + 4 + 2 + 1, 3 + 1 + 3, 1),
    # gaps: tip of a finger four products and five sums, distance; M: inertias, two cosines; forces: sine of a, w^2, moments of lam/d about
    # two joints; disc; solve: two blocks of two
    "two_finger": (17 + 5 + 34 + 6, 13 + 13 + 46 + 6, 2 + 16, 10 + 2 + 12 + 7),
    # the same; table; slips: velocity of the tip across the line of centres, turning; mu N; gravity of links and disc; friction at three bodies
    "two_finger_lift": (19 + 29 + 57 + 5 + 6, 13 + 30 + 2 + 77 + 13 + 6, 4 + 6 + 16, 10 + 10 + 12 + 2 + 7),
    # tip x + l sin; M: m_c + m_p, l m_p cos, l l m_p; forces; 2 x 2 Cholesky. Sine and cosine are called by each function that needs them
    "cart_pole_walls": (3 + 1 + 4 + 3, 1 + 1 + 2 + 8 + 3, 5, 4 + 2),
    # gaps; M with one cosine; forces with three sines; 2 x 2 Cholesky
    "acrobot_limits": (2 + 4 + 8 + 3, 2 + 8 + 17 + 3, 5, 4 + 2),
}


@pytest.mark.parametrize("name", PAPER)
def test_generated_arithmetic_is_that_on_paper(name: str):
    """Never a kind of operation that the paper does not have, and at most a fifth more in all: signs and shared terms fall differently."""
    found, paper = step_operations(load_scene(name)), Operations(*PAPER[name])
    assert found.divide <= paper.divide
    assert found.call <= paper.call
    assert found.total <= 1.2 * paper.total


@pytest.mark.parametrize("n", [2, 3, 8, 20])
def test_a_chain_costs_a_fixed_number_of_operations_a_cart(n: int):
    """n - 1 gaps of two additions; each cart c v, 1/m and two additions (damping; at the ends input and one contact, else two contacts); 1/m once."""
    assert step_operations(cart_chain(n)) == Operations(add=2 * (n - 1) + 2 * n, multiply=2 * n, divide=1)


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("a + b*c", Operations(add=1, multiply=1)), ("-a - (-b)", Operations(add=1)), ("(1.0/2.0)*a", Operations(multiply=1)),
        ("1.0/(a*a)", Operations(multiply=1, divide=1)), ("sqrt(a*a + 1.0e-12) + sin(2.0)", Operations(add=2, multiply=1, call=1)),
        ("pow(a, b + c)", Operations(add=1, call=1)), ("x[3] + x[i]*2.5e+3", Operations(add=1, multiply=1)), ("scene_energy(a*b, c)", Operations(multiply=1)),
        ("3.0*4.0", Operations()),
    ],
)  # fmt: skip
def test_every_form_of_arithmetic_is_counted(expression: str, expected: Operations):
    text = f"SCENE_FUNCTION double f(const double *x)\n{{\n    const double a = x[0];\n    return {expression};\n}}\n"
    assert count_operations(text) == {"f": expected}


@pytest.mark.slow
def test_squared_factors_are_computed_once():
    """Of two fingers: eight sines and cosines and two roots for both gaps."""
    assert count_operations(emit_model(load_scene("two_finger")))["scene_penetration"] == Operations(add=17, multiply=13, call=10)


def test_adding_to_a_result_is_an_addition():
    assert count_operations("SCENE_FUNCTION void f(double *y)\n{\n    y[0] += a*b;\n    (void)q;\n}\n") == {
        "f": Operations(add=1, multiply=1)
    }


def cholesky_on_paper(n: int) -> Operations:
    """The loops of a dense factorisation and of its two triangular solves, walked."""
    products = sum(j + (n - 1 - j) * j for j in range(n)) + 2 * sum(range(n))
    return Operations(add=products, multiply=products, divide=sum(n - 1 - j for j in range(n)) + 2 * n, call=n)


def solve_operations(mass: sp.Matrix) -> Operations:
    return count_operations(cholesky_function(mass))["scene_solve"]


def test_solving_costs_what_a_dense_factorisation_does_where_the_mass_matrix_is_dense():
    for n in range(1, 9):
        assert solve_operations(sp.ones(n)) == cholesky_on_paper(n)


def test_zeros_of_the_mass_matrix_cost_nothing():
    """Two fingers and a disc: two blocks of two, three numbers on the diagonal. An arrow costs as its point is first (fill) or last (none)."""
    block = sp.ones(2)
    fingers = sum([cholesky_on_paper(2), cholesky_on_paper(2), *[cholesky_on_paper(1)] * 3], Operations())
    assert solve_operations(sp.diag(block, block, 1, 1, 1)) == fingers
    assert solve_operations(derive(load_scene("two_finger")).mass_matrix) == fingers
    last = sp.eye(5)
    last[4, :] = sp.ones(1, 5)
    last[:, 4] = sp.ones(5, 1)
    assert solve_operations(last[::-1, ::-1]) == cholesky_on_paper(5)
    assert solve_operations(last).multiply == 4 + 2 * 4


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
    assert count_operations(emit_model(load_scene("three_cart")))["scene_acceleration_vjp"].call == 0
    assert step_operations(load_scene("cart_pole_walls")).call > cholesky_on_paper(2).call
