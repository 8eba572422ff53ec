"""Arithmetic of the generated C: counted rightly, and about what the equations cost on paper."""

from __future__ import annotations

import pytest

from models.catalog import load_scene
from models.codegen.emit import emit_model
from models.codegen.operations import Operations, count_operations, solve_operations, step_operations
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
        ("a + b*c", Operations(add=1, multiply=1)),
        ("-a - (-b)", Operations(add=1)),
        ("(1.0/2.0)*a", Operations(multiply=1)),
        ("1.0/(a*a)", Operations(multiply=1, divide=1)),
        ("sqrt(a*a + 1.0e-12) + sin(2.0)", Operations(add=2, multiply=1, call=1)),
        ("pow(a, b + c)", Operations(add=1, call=1)),
        ("x[3] + x[i]*2.5e+3", Operations(add=1, multiply=1)),
        ("scene_energy(a*b, c)", Operations(multiply=1)),
        ("3.0*4.0", Operations()),
    ],
)
def test_every_form_of_arithmetic_is_counted(expression: str, expected: Operations):
    text = f"SCENE_FUNCTION double f(const double *x)\n{{\n    const double a = x[0];\n    return {expression};\n}}\n"
    assert count_operations(text) == {"f": expected}


def test_adding_to_a_result_is_an_addition():
    assert count_operations("SCENE_FUNCTION void f(double *y)\n{\n    y[0] += a*b;\n    (void)q;\n}\n") == {
        "f": Operations(add=1, multiply=1)
    }


def test_solving_costs_what_its_loops_do():
    """The loops of the generated factorisation, walked."""
    for n in range(1, 9):
        products = sum(j + (n - 1 - j) * j for j in range(n)) + 2 * sum(range(n))
        assert solve_operations(n) == Operations(add=products, multiply=products, divide=sum(n - 1 - j for j in range(n)) + 2 * n, call=n)


def test_no_trigonometry_where_there_is_none():
    assert count_operations(emit_model(load_scene("three_cart")))["scene_acceleration_vjp"].call == 0
    assert step_operations(load_scene("cart_pole_walls")).call > solve_operations(2).call
