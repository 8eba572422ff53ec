"""Models that the tests of the bridge share."""

import math

import pyomo.environ as pyo


def three_carts(steps: int = 500, eps: float = 1e-3) -> pyo.ConcreteModel:
    """Three carts in a row that push one another through softplus springs.

    semi-implicit Euler, h = 0.01 s.

    Positions q [m], velocities v [m/s], inputs u on the outer carts [N], contact forces lam [N].
    Known costs at 500 steps: 197.86, 261.23, 339.52 N^2 at eps = 1e-3, 1e-5, 1e-7 (independently
    with CasADi and Ipopt). Fewer steps have a nearer goal, so that it stays in reach.
    """
    h, stiffness, damping, width = 0.01, 30.0, 2.0, 0.5
    m = pyo.ConcreteModel()
    m.b = pyo.Param(initialize=abs(math.log(eps)), mutable=True)
    nodes, grid = range(steps + 1), range(steps)
    shift = 0.5 * steps / 500
    goal = {1: (2.0, 2.0 + shift), 2: (3.0, 3.0 + shift), 3: (4.0, 4.0 + shift)}
    m.q = pyo.Var(
        goal, nodes, initialize=lambda m, i, t: goal[i][0] + (goal[i][1] - goal[i][0]) * t / steps
    )
    m.v = pyo.Var(goal, nodes, initialize=0.0)
    m.u = pyo.Var([1, 3], grid, bounds=(-10, 10), initialize=0.0)
    m.lam = pyo.Var([1, 3], grid, initialize=0.0)
    for i in goal:
        m.q[i, 0].fix(goal[i][0])
        m.v[i, 0].fix(0.0)
    force = {
        1: lambda t: -m.lam[1, t] + m.u[1, t],
        2: lambda t: m.lam[1, t] - m.lam[3, t],
        3: lambda t: m.lam[3, t] + m.u[3, t],
    }
    m.position = pyo.Constraint(
        goal, grid, rule=lambda m, i, t: m.q[i, t + 1] == m.q[i, t] + h * m.v[i, t + 1]
    )
    m.velocity = pyo.Constraint(
        goal,
        grid,
        rule=lambda m, i, t: m.v[i, t + 1] == m.v[i, t] + h * (-damping * m.v[i, t] + force[i](t)),
    )
    right = {1: 2, 3: 3}
    m.contact = pyo.Constraint(
        [1, 3],
        grid,
        rule=lambda m, c, t: (
            m.lam[c, t]
            == stiffness
            / m.b
            * pyo.log(1 + pyo.exp(m.b * (width - (m.q[right[c], t] - m.q[right[c] - 1, t]))))
        ),
    )
    m.goal_q = pyo.Constraint(goal, rule=lambda m, i: m.q[i, steps] == goal[i][1])
    m.goal_v = pyo.Constraint(goal, rule=lambda m, i: m.v[i, steps] == 0)
    m.cost = pyo.Objective(expr=sum(m.u[c, t] ** 2 for c in (1, 3) for t in grid))
    return m


def quadratic(**keywords) -> pyo.ConcreteModel:
    """The distance to (1, 2), squared. keywords: of the variables."""
    m = pyo.ConcreteModel()
    m.x = pyo.Var([1, 2], initialize=0.5, **keywords)
    m.cost = pyo.Objective(expr=(m.x[1] - 1) ** 2 + (m.x[2] - 2) ** 2)
    return m
