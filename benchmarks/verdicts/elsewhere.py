"""Three carts in other people's tools: the motion that MuJoCo or Drake gives for inputs, and a plan that Drake finds itself.

    python benchmarks/verdicts/elsewhere.py mujoco|drake|drake-plan INPUTS.csv MOTION.csv STEP

INPUTS: rows of t, u1, u3, each held to the next row's time, the last as long as the one before it.
    MOTION: rows of t, q1, q2, q3, v1, v2, v3, u1, u3.
Run by a Python that has the tool (`--mujoco`, `--drake` of `python -m benchmarks verdicts` name
    one), which needs nothing of ours: `pip install mujoco`
or `pip install drake`.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import sys

import numpy as np

MASS = 1.0
DAMPING = 2.0
STIFFNESS = 30.0
LENGTH = 0.5
START = (2.0, 3.0, 4.0)
GOAL = (2.5, 3.5, 4.5)
BOUND = 10.0

# A fixed tendon between neighbours is a spring with a dead band: it pushes below LENGTH, and never
# pulls.
CARTS = f"""
<mujoco>
  <option timestep="STEP" gravity="0 0 0" integrator="Euler"><flag contact="disable"/></option>
  <worldbody>
    {"".join(f'<body name="c{i}"><joint name="q{i}" type="slide" axis="1 0 0" damping="{DAMPING}"/><geom type="box" size="0.25 0.1 0.1" mass="{MASS}"/></body>' for i in (1, 2, 3))}
  </worldbody>
  <tendon>
    {"".join(f'<fixed name="t{i}" stiffness="{STIFFNESS}" springlength="{LENGTH} 1000"><joint joint="q{i}" coef="-1"/><joint joint="q{i + 1}" coef="1"/></fixed>' for i in (1, 2))}
  </tendon>
  <actuator><motor joint="q1"/><motor joint="q3"/></actuator>
</mujoco>
"""


def mujoco_motion(t: np.ndarray, u: np.ndarray, step: float) -> np.ndarray:
    import mujoco

    model = mujoco.MjModel.from_xml_string(CARTS.replace("STEP", repr(step)))
    data = mujoco.MjData(model)
    data.qpos[:] = START
    parts = round((t[1] - t[0]) / step)
    rows = []
    for index, held in enumerate(np.repeat(u, parts, axis=0)):
        rows.append([t[0] + index * step, *data.qpos, *data.qvel, *held])
        data.ctrl[:] = held
        mujoco.mj_step(model, data)
    return np.array([*rows, [t[0] + len(rows) * step, *data.qpos, *data.qvel, 0.0, 0.0]])


def _drake_carts():
    from pydrake.symbolic import Variable, max
    from pydrake.systems.primitives import SymbolicVectorSystem

    q, v, u = (
        [Variable(f"{letter}{i}") for i in range(count)]
        for letter, count in (("q", 3), ("v", 3), ("u", 2))
    )
    left, right = (STIFFNESS * max(LENGTH - (q[i + 1] - q[i]), 0.0) for i in (0, 1))
    rates = [
        *v,
        (u[0] - DAMPING * v[0] - left) / MASS,
        (-DAMPING * v[1] + left - right) / MASS,
        (u[1] - DAMPING * v[2] + right) / MASS,
    ]
    return SymbolicVectorSystem(state=[*q, *v], input=u, dynamics=rates, output=[*q, *v])


def drake_motion(t: np.ndarray, u: np.ndarray, step: float) -> np.ndarray:
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import TrajectorySource
    from pydrake.trajectories import PiecewisePolynomial

    end = 2 * t[-1] - t[-2]
    builder = DiagramBuilder()
    carts = builder.AddSystem(_drake_carts())
    source = builder.AddSystem(
        TrajectorySource(
            PiecewisePolynomial.ZeroOrderHold(np.append(t, end), np.vstack([u, u[-1:]]).T)
        )
    )
    builder.Connect(source.get_output_port(), carts.get_input_port())
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-4)
    state = simulator.get_mutable_context().get_mutable_continuous_state_vector()
    state.SetFromVector([*START, 0.0, 0.0, 0.0])
    rows = []
    for time, held in zip(np.append(t, end), np.vstack([u, u[-1:]]), strict=True):
        simulator.AdvanceTo(time)
        rows.append(
            [time, *simulator.get_context().get_continuous_state_vector().CopyToVector(), *held]
        )
    return np.array(rows)


def drake_plan(t: np.ndarray, u: np.ndarray, step: float) -> np.ndarray:
    """A plan of Drake's direct collocation, whose inputs change linearly from node to node, begun at the motion of the given inputs."""
    from pydrake.planning import DirectCollocation
    from pydrake.solvers import Solve
    from pydrake.trajectories import PiecewisePolynomial

    first = drake_motion(t, u, step)
    end, carts = first[-1, 0], _drake_carts()
    samples = round((end - t[0]) / step) + 1
    problem = DirectCollocation(
        carts,
        carts.CreateDefaultContext(),
        num_time_samples=samples,
        minimum_time_step=step,
        maximum_time_step=step,
    )
    program = problem.prog()
    program.AddBoundingBoxConstraint([*START, 0, 0, 0], [*START, 0, 0, 0], problem.initial_state())
    program.AddBoundingBoxConstraint([*GOAL, 0, 0, 0], [*GOAL, 0, 0, 0], problem.final_state())
    problem.AddConstraintToAllKnotPoints(problem.input()[0] <= BOUND)
    problem.AddConstraintToAllKnotPoints(problem.input()[0] >= -BOUND)
    problem.AddConstraintToAllKnotPoints(problem.input()[1] <= BOUND)
    problem.AddConstraintToAllKnotPoints(problem.input()[1] >= -BOUND)
    problem.AddRunningCost(problem.input()[0] ** 2 + problem.input()[1] ** 2)
    guess = [
        PiecewisePolynomial.FirstOrderHold(first[:, 0], first[:, columns].T)
        for columns in (slice(7, 9), slice(1, 7))
    ]
    problem.SetInitialTrajectory(*guess)
    result = Solve(program)
    # SNOPT gives up on the cost at the kinks of the contact forces; what counts here is that its
    # plan meets Drake's own equations.
    if not result.is_success() and result.GetInfeasibleConstraintNames(program, 1e-6):
        raise SystemExit(
            f"Drake's solver {result.get_solver_id().name()} finds no plan: {result.get_solution_result()}"
        )
    times = problem.GetSampleTimes(result)
    return np.column_stack(
        [times, problem.GetStateSamples(result).T, problem.GetInputSamples(result).T]
    )


TOOLS = {"mujoco": mujoco_motion, "drake": drake_motion, "drake-plan": drake_plan}


if __name__ == "__main__":
    tool, given, out, step = sys.argv[1:]
    table = np.loadtxt(given, delimiter=",")
    np.savetxt(out, TOOLS[tool](table[:, 0], table[:, 1:], float(step)), delimiter=",", fmt="%.17g")
