"""Equilibrium problems: Outrata's, Nash and Cournot-Nash games, quadratic programs with complementarity, an inverse problem, a design
problem. Mathematics of MacMPEC (S. Leyffer), written anew for Pyomo.
"""

from __future__ import annotations

import pyomo.environ as pyo
from pyomo.mpec import Complementarity, complements

from benchmarks.mpec.macmpec.problem import problem


def _outrata(m: pyo.ConcreteModel, cost) -> None:
    m.x = pyo.Var([1, 2, 3, 4], bounds=(0, None))
    m.y = pyo.Var(bounds=(0, 10))
    x, y = m.x, m.y
    m.cost = pyo.Objective(expr=cost(x, y) / 2)
    sides = (
        (1 + 0.2 * y) * x[1] - (3 + 1.333 * y) - 0.333 * x[3] + 2 * x[1] * x[4],
        (1 + 0.1 * y) * x[2] - y + x[3] + 2 * x[2] * x[4],
        0.333 * x[1] - x[2] + 1 - 0.1 * y,
        9 + 0.1 * y - x[1] ** 2 - x[2] ** 2,
    )
    m.pair = Complementarity(
        [1, 2, 3, 4], rule=lambda m, i: complements(sides[i - 1] >= 0, m.x[i] >= 0)
    )


def _near(x):
    return (x[1] - 3) ** 2 + (x[2] - 4) ** 2


for _name, _optimum, _cost in (
    ("outrata31", 3.2077, lambda x, y: _near(x)),
    ("outrata32", 3.4494, lambda x, y: _near(x) + (x[3] - 1) ** 2),
    ("outrata33", 4.60425, lambda x, y: _near(x) + 10 * x[4] ** 2),
    ("outrata34", 6.59268, lambda x, y: _near(x) + (x[3] - 1) ** 2 + (x[4] - 1) ** 2 + y**2),
):
    problem(_optimum, _name, _cost)(_outrata)


def nash1(m: pyo.ConcreteModel, start: tuple[float, float]) -> None:
    m.x = pyo.Var([1, 2], bounds=(0, 10), initialize=dict(zip((1, 2), start, strict=True)))
    m.y = pyo.Var([1, 2])
    m.l = pyo.Var([1, 2], bounds=(0, None))
    m.cost = pyo.Objective(expr=sum((m.x[i] - m.y[i]) ** 2 for i in (1, 2)) / 2)
    m.first = pyo.Constraint(expr=-34 + 2 * m.y[1] + 8 / 3 * m.y[2] + m.l[1] == 0)
    m.second = pyo.Constraint(expr=-24.25 + 1.25 * m.y[1] + 2 * m.y[2] + m.l[2] == 0)
    m.pair = Complementarity(
        [1, 2], rule=lambda m, i: complements(15 - m.x[3 - i] - m.y[i] >= 0, m.l[i] >= 0)
    )


for _letter, _start in {
    "a": (0, 0),
    "b": (5, 5),
    "c": (10, 10),
    "d": (10, 0),
    "e": (0, 10),
}.items():
    problem(0.0, f"nash1{_letter}", _start)(nash1)


_COST = {1: 10.0, 2: 8.0, 3: 6.0, 4: 4.0, 5: 2.0}
_BETA = {1: 1.2, 2: 1.1, 3: 1.0, 4: 0.9, 5: 0.8}


def gnash(m: pyo.ConcreteModel, limit: float, elasticity: float, mixed: bool) -> None:
    """Leader and four followers in a Cournot market.

    mixed: one multiplier for both bounds of a follower.
    """
    firms = [2, 3, 4, 5]
    m.x = pyo.Var(bounds=(0, limit), initialize=min(75.0, limit))
    m.y = pyo.Var(firms, initialize=1.0)
    m.total = pyo.Expression(expr=m.x + sum(m.y.values()))
    scale = 5000 ** (1 / elasticity)
    m.price = pyo.Expression(expr=scale * m.total ** (-1 / elasticity))
    m.fall = pyo.Expression(expr=-scale / elasticity * m.total ** (-1 - 1 / elasticity))
    b = _BETA[1]
    m.cost = pyo.Objective(
        expr=_COST[1] * m.x + b / (b + 1) * 5 ** (-1 / b) * m.x ** ((1 + b) / b) - m.x * m.price
    )
    if mixed:
        m.l = pyo.Var(firms)
        m.box = Complementarity(
            firms, rule=lambda m, i: complements(pyo.inequality(0, m.y[i], limit), m.l[i])
        )
        force = {i: m.l[i] for i in firms}
    else:
        m.low, m.high = pyo.Var(firms, bounds=(0, None)), pyo.Var(firms, bounds=(0, None))
        m.bottom = Complementarity(firms, rule=lambda m, i: complements(m.y[i] >= 0, m.low[i] >= 0))
        m.top = Complementarity(
            firms, rule=lambda m, i: complements(limit - m.y[i] >= 0, m.high[i] >= 0)
        )
        force = {i: m.low[i] - m.high[i] for i in firms}
    m.follower = pyo.Constraint(
        firms,
        rule=lambda m, i: (
            _COST[i] + 5 ** (-1 / _BETA[i]) * m.y[i] - m.price - m.y[i] * m.fall - force[i] == 0
        ),
    )


_GNASH = {
    10: (150.0, 1.0, -230.823), 11: (150.0, 1.1, -129.912), 12: (150.0, 1.3, -36.9331),
    13: (150.0, 1.5, -7.06178), 14: (150.0, 1.7, -0.179046),
    15: (50.0, 1.0, -354.699), 16: (40.0, 1.1, -241.442), 17: (30.0, 1.3, -90.7491),
    18: (25.0, 1.5, -25.6982), 19: (20.0, 1.7, -6.11671),
}  # fmt: skip
for _suffix, _mixed in (("", False), ("m", True)):
    for _number, (_limit, _power, _optimum) in _GNASH.items():
        problem(_optimum, f"gnash{_number}{_suffix}", _limit, _power, _mixed)(gnash)


def _qpec(m: pyo.ConcreteModel, shift: float) -> None:
    m.x = pyo.Var(range(1, 11), initialize=1)
    m.y = pyo.Var(range(1, 21), bounds=(0, None), initialize=1)
    m.cost = pyo.Objective(
        expr=sum((v + shift) ** 2 for v in m.x.values())
        + sum((v + 2 * shift) ** 2 for v in m.y.values())
    )
    m.pair = Complementarity(
        range(1, 11), rule=lambda m, i: complements(m.y[i] - m.x[i] >= 0, m.y[i] >= 0)
    )
    m.same = Complementarity(range(11, 21), rule=lambda m, i: complements(m.y[i] >= 0, m.y[i] >= 0))


problem(80.0, "qpec1", 1.0)(_qpec)
problem(45.0, "qpec2", -1.0)(_qpec)


@problem(1.86065)
def design_cent_1(m: pyo.ConcreteModel) -> None:
    """The largest disc inside a body with three curved or straight sides."""
    m.x = pyo.Var([1, 2, 3], initialize={1: 0, 2: 0, 3: 1})
    touch = {
        (1, 1): -1.0,
        (1, 2): 0.2425356,
        (1, 3): 0.0,
        (2, 1): 0.0,
        (2, 2): 0.9701425,
        (2, 3): -1.0,
    }
    m.y = pyo.Var(list(touch), initialize=touch)
    m.l = pyo.Var([1, 2, 3], bounds=(0, None), initialize=0.5)
    m.volume = pyo.Objective(expr=3.141592654 * m.x[3] ** 2, sense=pyo.maximize)
    m.g = pyo.Constraint(expr=-m.y[1, 1] - m.y[2, 1] ** 2 <= 0)
    m.h = pyo.Constraint(expr=m.y[1, 2] / 4 + m.y[2, 2] <= 0.75)
    m.k = pyo.Constraint(expr=-m.y[2, 3] <= 1)
    slope = {
        (1, 1): 1.0,
        (2, 1): 2 * m.y[2, 1],
        (1, 2): -0.25,
        (2, 2): -1.0,
        (1, 3): 0.0,
        (2, 3): 1.0,
    }
    m.touching = pyo.Constraint(
        list(touch), rule=lambda m, j, k: slope[j, k] + 2 * (m.y[j, k] - m.x[j]) * m.l[k] == 0
    )
    m.disc = Complementarity(
        [1, 2, 3],
        rule=lambda m, k: complements(
            m.l[k] >= 0, (m.y[1, k] - m.x[1]) ** 2 + (m.y[2, k] - m.x[2]) ** 2 - m.x[3] ** 2 <= 0
        ),
    )


@problem(15.6178)
def hs044_i(m: pyo.ConcreteModel) -> None:
    """Which perturbation of Hock and Schittkowski's problem 44 brings its solution nearest to (0, 3, 0, 4). l[i] as published, not l[j]."""
    wanted, slope = (0, 3, 0, 4), (1, -1, -1, 0)
    rows = (
        (-1, -2, 0, 0),
        (-4, -1, 0, 0),
        (-3, -4, 0, 0),
        (0, 0, -2, -1),
        (0, 0, -1, -2),
        (0, 0, -1, -1),
    )
    right, curved = (
        (8, 12, 12, 8, 8, 5),
        ((0, 0, -1, 1), (0, 0, 1, -1), (-1, 1, 0, 0), (1, -1, 0, 0)),
    )
    low, high = (0.01, -10, 0.1, -1, -1, 0.001), (10, -0.01, 1, -0.1, 1, 10)
    on_slope, on_right = (0.2, 1.2, 2, 0.1, 0.1, -0.1), (1.2, 0.2, 0.1, 2, 10, -0.2)
    m.x, m.m = pyo.Var(range(4), bounds=(0, None)), pyo.Var(range(4), bounds=(0, None))
    m.l, m.z = (
        pyo.Var(range(6), bounds=(0, None)),
        pyo.Var(range(6), bounds=lambda m, k: (low[k], high[k])),
    )
    m.cost = pyo.Objective(expr=sum((wanted[i] - m.x[i]) ** 2 for i in range(4)))
    m.slope = pyo.Constraint(
        range(4),
        rule=lambda m, i: (
            sum(curved[i][k] * m.x[k] for k in range(4))
            + slope[i]
            + on_slope[i] * m.z[i]
            - sum(row[i] for row in rows) * m.l[i]
            - m.m[i]
            == 0
        ),
    )
    m.row = Complementarity(
        range(6),
        rule=lambda m, j: complements(
            m.l[j] >= 0,
            right[j] - on_right[j] * m.z[j] + sum(rows[j][i] * m.x[i] for i in range(4)) >= 0,
        ),
    )
    m.bound = Complementarity(range(4), rule=lambda m, i: complements(m.x[i] >= 0, m.m[i] >= 0))
