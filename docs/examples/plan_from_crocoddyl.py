"""A plan of three_cart by crocoddyl: differential dynamic programming (FDDP), contact made smooth.

Written as a CSV.

pip install crocoddyl; python plan_from_crocoddyl.py && python -m validate replay plan.csv --scene
three_cart
"""

import crocoddyl
import numpy as np

h = 0.01
steps = 500
damping = 2.0
stiffness = 30.0
length = 0.5
start = np.array([2.0, 3, 4, 0, 0, 0])
goal = np.array([2.5, 3.5, 4.5, 0, 0, 0])
APART = np.array([[1.0, -1, 0], [0, 1, -1]])  # depth = length + APART q
DRIVEN = np.array([[1.0, 0], [0, 0], [0, 1]])


class Carts(crocoddyl.ActionModelAbstract):
    """One semi-implicit step.

    Contact force k log(1 + exp(s depth))/s. weight: of the distance from the goal; sharpness: s
    [1/m].
    """

    def __init__(self, weight: float, sharpness: float):
        super().__init__(crocoddyl.StateVector(6), 2, 0)
        self.weight, self.sharpness = weight, sharpness

    def calc(self, data, x, u=None):
        """The next state and the cost."""
        u = np.zeros(2) if u is None else u
        force = (
            stiffness
            / self.sharpness
            * np.logaddexp(0.0, self.sharpness * (length + APART @ x[:3]))
        )
        after = x[3:] + h * (DRIVEN @ u - APART.T @ force - damping * x[3:])
        data.xnext[:] = np.concatenate([x[:3] + h * after, after])
        data.cost = float(u @ u + self.weight * np.sum((x - goal) ** 2)) / 2

    def calcDiff(self, data, x, u=None):  # noqa: N802 - crocoddyl's name
        """Their derivatives."""
        u = np.zeros(2) if u is None else u
        slope = stiffness / (1.0 + np.exp(-self.sharpness * (length + APART @ x[:3])))
        after = np.hstack([-h * APART.T @ (slope[:, None] * APART), (1 - h * damping) * np.eye(3)])
        data.Fx[:] = np.vstack([np.eye(3, 6) + h * after, after])
        data.Fu[:] = np.vstack([h * h * DRIVEN, h * DRIVEN])
        data.Lx[:], data.Lu[:] = self.weight * (x - goal), u
        data.Lxx[:], data.Luu[:] = self.weight * np.eye(6), np.eye(2)


xs = [start] * (steps + 1)
us = [np.array([1.0, 0.1])] * steps
for sharpness in (10.0, 30.0, 100.0, 300.0):
    problem = crocoddyl.ShootingProblem(
        start, [Carts(0.0, sharpness)] * steps, Carts(1e6, sharpness)
    )
    solver = crocoddyl.SolverFDDP(problem)
    solver.solve(xs, us, 300, False)
    xs, us = solver.xs.tolist(), solver.us.tolist()

with open("plan.csv", "w", encoding="utf-8") as file:
    print("t,q1,q2,q3,v1,v2,v3,u1,u3", file=file)
    for n in range(steps + 1):
        print(
            ",".join(repr(float(cell)) for cell in [h * n, *xs[n], *(us[n] if n < steps else ())])
            + ("" if n < steps else ",,"),
            file=file,
        )
