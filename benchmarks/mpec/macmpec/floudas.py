"""Linear and quadratic bilevel programs of the handbook by Floudas and others, chapter 9, through optimality conditions of the lower level.
Mathematics of MacMPEC (S. Leyffer), written anew for Pyomo.

In all of them l_i >= 0 multiplies a row of the lower level whose slack is s_i >= 0: `_variables`
adds both and l complements s.
"""

from __future__ import annotations

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

from benchmarks.mpec.macmpec.problem import problem


def _variables(
    m: pyo.ConcreteModel, pairs: int, **bounds: float | tuple[float, float] | None
) -> list:
    """Variables by name with their bounds (a number is a lower bound), and pairs of slacks s and multipliers l; the variables, and l behind them."""
    for name, bound in bounds.items():
        m.add_component(name, pyo.Var(bounds=bound if isinstance(bound, tuple) else (bound, None)))
    m.s = pyo.Var(range(1, pairs + 1), bounds=(0, None))
    m.l = pyo.Var(range(1, pairs + 1), bounds=(0, None))
    m.pair = Complementarity(
        range(1, pairs + 1), rule=lambda m, i: complements(m.l[i] >= 0, m.s[i] >= 0)
    )
    return [*(m.component(name) for name in bounds), m.l]


def _finish(m: pyo.ConcreteModel, cost, rows, *, slope) -> None:
    """rows: (expression, right-hand side), row i with slack s_i.

    slope: expressions that are 0 at the lower level's solution.
    """
    m.cost = pyo.Objective(expr=cost)
    m.row = pyo.Constraint(
        range(len(rows)), rule=lambda m, k: rows[k][0] + m.s[k + 1] == rows[k][1]
    )
    m.slope = pyo.Constraint(range(len(slope)), rule=lambda m, k: slope[k] == 0)


@problem(-13.0)
def ex9_1_1(m: pyo.ConcreteModel) -> None:
    x, y, z, m_l = _variables(m, 5, x=0, y=None, z=None)
    rows = [
        (-2 * x + y + 4 * z, 16),
        (8 * x + 3 * y - 2 * z, 48),
        (-2 * x + y - 3 * z, -12),
        (-y, 0),
        (y, 4),
    ]
    slope = [-1 + m_l[1] + 3 * m_l[2] + m_l[3] - m_l[4] + m_l[5], 2 * m_l[2] - 3 * m_l[3]]
    _finish(m, -x - 3 * y + 2 * z, rows, slope=slope)


@problem(-29.2)
def ex9_1_3(m: pyo.ConcreteModel) -> None:
    m.x = pyo.Var([1, 2], bounds=(0, None))
    m.y, m.s, m.l = (pyo.Var(range(1, 7), bounds=(0, None)) for _ in range(3))
    m.mu = pyo.Var([1, 2, 3])
    x, y, mu = m.x, m.y, m.mu
    m.cost = pyo.Objective(expr=4 * y[1] - 40 * y[2] - 4 * y[3] - 8 * x[1] - 4 * x[2])
    rows = (
        -y[1] + y[2] + y[3] + y[4] - 1,
        -y[1] + 2 * y[2] - 0.5 * y[3] + y[5] + 2 * x[1] - 1,
        2 * y[1] - y[2] - 0.5 * y[3] + y[6] + 2 * x[2] - 1,
        1 - mu[1] - mu[2] + 2 * mu[3] - m.l[1],
        1 + mu[1] + 2 * mu[2] - mu[3] - m.l[2],
        2 + mu[1] - 0.5 * mu[2] - 0.5 * mu[3] - m.l[3],
        *(mu[k] - m.l[3 + k] for k in (1, 2, 3)),
    )
    m.row = pyo.Constraint(range(len(rows)), rule=lambda m, k: rows[k] == 0)
    m.slack = pyo.Constraint(range(1, 7), rule=lambda m, i: m.s[i] == m.y[i])
    m.pair = Complementarity(range(1, 7), rule=lambda m, i: complements(m.l[i] >= 0, m.s[i] >= 0))


@problem(-37.0)
def ex9_1_4(m: pyo.ConcreteModel) -> None:
    x, y, m_l = _variables(m, 4, x=0, y=0)
    rows = [(-2 * x + y, 0), (2 * x + 5 * y, 108), (2 * x - 3 * y, -4), (-y, 0)]
    _finish(m, x - 4 * y, rows, slope=[m_l[1] + 5 * m_l[2] - 3 * m_l[3] - m_l[4] + 1])


@problem(-1.0)
def ex9_1_5(m: pyo.ConcreteModel) -> None:
    x, y, z, m_l = _variables(m, 5, x=0, y=0, z=0)
    rows = [(x + y, 1), (x + z, 1), (y + z, 1), (-y, 0), (-z, 0)]
    _finish(
        m, -x + 10 * y - z, rows, slope=[m_l[1] + m_l[3] - m_l[4] - 1, m_l[2] + m_l[3] - m_l[5] - 1]
    )


@problem(-49.0)
def ex9_1_6(m: pyo.ConcreteModel) -> None:
    x, y, m_l = _variables(m, 6, x=0, y=0)
    rows = [
        (-x - 2 * y, -10),
        (x - 2 * y, 6),
        (2 * x - y, 21),
        (x + 2 * y, 38),
        (-x + 2 * y, 18),
        (-y, 0),
    ]
    slope = [3 - 2 * m_l[1] - 2 * m_l[2] - m_l[3] + 2 * m_l[4] + 2 * m_l[5] - m_l[6]]
    _finish(m, -x - 3 * y, rows, slope=slope)


@problem(-26.0)
def ex9_1_7(m: pyo.ConcreteModel) -> None:
    a, b, u, v, w, m_l = _variables(m, 6, a=0, b=0, u=0, v=0, w=0)
    rows = [
        (-u + v + w, 1), (2 * a - u + 2 * v - 0.5 * w, 1), (2 * b + 2 * u - v - 0.5 * w, 1),
        (-u, 0), (-v, 0), (-w, 0),
    ]  # fmt: skip
    slope = [
        -m_l[1] - m_l[2] + 2 * m_l[3] - m_l[4] + 1,
        m_l[1] + 2 * m_l[2] - m_l[3] - m_l[5] + 1,
        m_l[1] - 0.5 * m_l[2] - 0.5 * m_l[3] - m_l[6] + 2,
    ]
    _finish(m, -8 * a - 4 * b + 4 * u - 40 * v + 4 * w, rows, slope=slope)


def _four_rows(m: pyo.ConcreteModel, **bounds) -> None:
    a, b, u, v, *_, m_l = _variables(m, 5, a=0, b=0, u=0, v=0, **bounds)
    m.leader = pyo.Constraint(expr=a + b <= 2)
    m.unused = pyo.Constraint(
        expr=m.s[5] == 0
    )  # the published model declares a fifth pair that stands in no row
    rows = [(-2 * a + u - v, -2.5), (a - 3 * b + v, 2), (-u, 0), (-v, 0)]
    _finish(
        m, -2 * a + b + 0.5 * u, rows, slope=[m_l[1] - m_l[3] - 4, m_l[1] + m_l[2] - m_l[4] + 1]
    )


problem(-3.25, "ex9_1_8")(_four_rows)


@problem(-3.25)
def ex9_1_10(m: pyo.ConcreteModel) -> None:
    _four_rows(m, w=0)


@problem(3.11111)
def ex9_1_9(m: pyo.ConcreteModel) -> None:
    x, y, m_l = _variables(m, 5, x=0, y=0)
    rows = [(-x - 0.5 * y, -2), (-0.25 * x + y, 2), (x + 0.5 * y, 8), (x - 2 * y, 2), (-y, 0)]
    _finish(m, x + y, rows, slope=[-0.5 * m_l[1] + m_l[2] + 0.5 * m_l[3] - 2 * m_l[4] - m_l[5] - 1])


def _with_slope(m: pyo.ConcreteModel) -> None:
    x, y, m_l = _variables(m, 4, x=0, y=0)
    rows = [(-3 * x + y, -3), (x - 0.5 * y, 4), (x + y, 7), (-y, 0)]
    slope = [2 * (y - 1) - 1.5 * x + m_l[1] - 0.5 * m_l[2] + m_l[3] - m_l[4]]
    _finish(m, (x - 5) ** 2 + (2 * y + 1) ** 2, rows, slope=slope)


for _name in ("ex9_2_1", "ex9_2_7"):
    problem(17.0, _name)(_with_slope)


@problem(100.0)
def ex9_2_2(m: pyo.ConcreteModel) -> None:
    x, y, m_l = _variables(m, 4, x=0, y=0)
    m.leader = pyo.ConstraintList()
    m.leader.add(x <= 15)
    m.leader.add(y <= x)
    m.leader.add(-x <= 0)
    rows = [(x + y, 20), (-y, 0), (y, 20)]
    _finish(m, x**2 + (y - 10) ** 2, rows, slope=[2 * (x + 2 * y - 30) + m_l[1] - m_l[2] + m_l[3]])


@problem(-55.0)
def ex9_2_3(m: pyo.ConcreteModel) -> None:
    a, b, y, z, m_l = _variables(m, 6, a=(1, 50), b=(1, 50), y=-8, z=-8)
    m.leader = pyo.Constraint(expr=a + b + y - 2 * z <= 40)
    rows = [(2 * y - a, -10), (2 * z - b, -10), (-y, 10), (y, 20), (-z, 10), (z, 20)]
    slope = [
        2 * (y - a + 20) + 2 * m_l[1] - m_l[3] + m_l[4],
        2 * (z - b + 20) + 2 * m_l[2] - m_l[5] + m_l[6],
    ]
    _finish(m, 2 * a + 2 * b - 3 * y - 3 * z - 60, rows, slope=slope)


@problem(0.5)
def ex9_2_4(m: pyo.ConcreteModel) -> None:
    _variables(m, 2, free=None, x=0, y=0, z=0)
    m.sum = pyo.Constraint(expr=m.y + m.z == m.x)
    slope = [m.y + m.free - m.l[1], 1 + m.free - m.l[2]]
    _finish(m, (m.y - 2) ** 2 / 2 + (m.z - 2) ** 2 / 2, [(-m.y, 0), (-m.z, 0)], slope=slope)


@problem(6.0)
def ex9_2_5(m: pyo.ConcreteModel) -> None:
    x, y, m_l = _variables(m, 3, x=(0, 8), y=None)
    rows = [(-2 * x + y, 1), (x - 2 * y, 2), (x + 2 * y, 14)]
    _finish(
        m, (x - 3) ** 2 + (y - 2) ** 2, rows, slope=[2 * (y - 5) + m_l[1] - 2 * m_l[2] + 2 * m_l[3]]
    )


@problem(-1.0)
def ex9_2_6(m: pyo.ConcreteModel) -> None:
    """Two of the six published pairs stand in no row."""
    a, b, y, z, m_l = _variables(m, 6, a=0, b=0, y=0, z=0)
    rows = [(0.5 - y, 0), (0.5 - z, 0), (y - 1.5, 0), (z - 1.5, 0)]
    slope = [2 * (y - a) - m_l[1] + m_l[3], 2 * (z - b) - m_l[2] + m_l[4]]
    _finish(m, a**2 - 2 * a + b**2 - 2 * b + y**2 + z**2, rows, slope=slope)


@problem(1.5)
def ex9_2_8(m: pyo.ConcreteModel) -> None:
    x, y, m_l = _variables(m, 2, x=(0, 1), y=0)
    _finish(
        m, -4 * x * y + 3 * y + 2 * x + 1, [(-y, 0), (y, 1)], slope=[-(1 - 4 * x) - m_l[1] + m_l[2]]
    )


@problem(2.0)
def ex9_2_9(m: pyo.ConcreteModel) -> None:
    x, y, z, m_l = _variables(m, 3, x=(2, 4), y=0, z=0)
    _finish(
        m,
        x + z,
        [(x - y - z, -4), (-y, 0), (-z, 0)],
        slope=[2 - m_l[1] - m_l[2], x - m_l[1] - m_l[3]],
    )
