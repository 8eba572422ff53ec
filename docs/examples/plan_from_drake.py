"""A plan of three_cart by Drake: direct collocation, inputs as lines, contact made smooth.

Written as a CSV.

pip install drake; python plan_from_drake.py && python -m validate replay plan.csv --scene
three_cart
"""

import numpy as np
from pydrake.planning import DirectCollocation
from pydrake.solvers import SnoptSolver
from pydrake.symbolic import Variable, exp, log
from pydrake.systems.primitives import SymbolicVectorSystem
from pydrake.trajectories import PiecewisePolynomial

duration = 5.0
nodes = 101
damping = 2.0
stiffness = 30.0
length = 0.5
q, v, u = (
    [Variable(f"{name}{i}") for i in range(count)] for name, count in (("q", 3), ("v", 3), ("u", 2))
)
start = np.array([2.0, 3, 4, 0, 0, 0])
goal = np.array([2.5, 3.5, 4.5, 0, 0, 0])


def planned(
    sharpness: float, guess: tuple[PiecewisePolynomial, PiecewisePolynomial]
) -> tuple[DirectCollocation, SymbolicVectorSystem]:
    """The problem with a contact force k log(1 + exp(s depth))/s, which is the true one where s is large; and its system, to be kept while it is used."""
    left, right = (
        stiffness / sharpness * log(1 + exp(sharpness * (length - (b - a))))
        for a, b in ((q[0], q[1]), (q[1], q[2]))
    )
    forces = [u[0] - left, left - right, u[1] + right]
    system = SymbolicVectorSystem(
        state=[*q, *v],
        input=u,
        dynamics=[*v, *(f - damping * x for f, x in zip(forces, v, strict=True))],
        output=[],
    )
    problem = DirectCollocation(
        system, system.CreateDefaultContext(), nodes, duration / (nodes - 1), duration / (nodes - 1)
    )
    problem.AddEqualTimeIntervalsConstraints()
    program = problem.prog()
    program.AddBoundingBoxConstraint(start, start, problem.initial_state())
    program.AddBoundingBoxConstraint(goal, goal, problem.final_state())
    for place in (0, 1):
        program.AddBoundingBoxConstraint(-10, 10, [problem.input(n)[place] for n in range(nodes)])
    problem.AddRunningCost(problem.input()[0] ** 2 + problem.input()[1] ** 2)
    problem.SetInitialTrajectory(*guess)
    return problem, system


times = np.linspace(0.0, duration, nodes)
guess = (
    PiecewisePolynomial.FirstOrderHold(times, np.full((2, nodes), 0.1)),
    PiecewisePolynomial.FirstOrderHold(times, np.linspace(start, goal, nodes).T),
)
for sharpness in (10.0, 30.0, 100.0, 300.0):
    problem, system = planned(sharpness, guess)
    result = SnoptSolver().Solve(problem.prog())
    assert result.is_success(), f"sharpness {sharpness}: {result.get_solution_result()}"
    guess = problem.ReconstructInputTrajectory(result), problem.ReconstructStateTrajectory(result)

with open("plan.csv", "w", encoding="utf-8") as file:
    print("# hold: linear\nt,q1,q2,q3,v1,v2,v3,u1,u3", file=file)
    for time in problem.GetSampleTimes(result):
        cells = [time, *guess[1].value(time).ravel(), *guess[0].value(time).ravel()]
        print(",".join(repr(float(cell)) for cell in cells), file=file)
