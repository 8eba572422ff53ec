"""Plans and replays for stress cases.

plan = rolled(scene, start=..., u=..., step=..., steps=...)  # Trajectory by the compiled step
motion = replayed(scene, plan)                               # Replay by the scene's FMU
plan, motion = of_truth(problem)                             # of a problem of the truth suite
solution = solved(scene, "mpcc", seconds=20.0)               # Solution by a method
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from formulations.pipelines import load_method
from formulations.solution import Solution
from models.codegen.kernel import load_kernel
from models.contact_law import ContactLaw
from models.fmu import build_fmu
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid
from validate.judge.replay import Replay
from validate.judge.replay.run import replay
from validate.truth.problems import TruthProblem


def rolled(
    scene: Scene,
    *,
    start: Any = None,
    u: np.ndarray | None = None,
    step: float | None = None,
    steps: int | None = None,
    law: ContactLaw = ContactLaw.RELU,
    eps: float | None = None,
    every: int = 1,
) -> Trajectory:
    """Return the motion by the compiled step, by default of the scene's task.

    Parameters
    ----------
    start
        (2 nq,) first state [m, rad, m/s, rad/s].
    u
        (steps, nu) inputs [N, N m], default zero.
    step
        Time step [s].
    law, eps
        Contact law, and eps of a relaxed one.
    every
        Keep one node of this many; inputs must be constant between.

    Raises
    ------
    KernelError
        If arrays do not fit the scene.
    RelaxationError
        For an eps that the law does not allow.
    """
    h = scene.task.step if step is None else step
    count = (scene.task.steps if steps is None else steps) if u is None else len(u)
    inputs = np.zeros((count, scene.nu)) if u is None else u
    plan = load_kernel(scene).rollout(
        np.array(scene.task.start if start is None else start, dtype=float), inputs, h, law, eps
    )
    return Trajectory(
        t=uniform_grid(h * every, count // every),
        q=plan.q[::every],
        v=plan.v[::every],
        u=inputs[::every],
        lam=plan.lam[::every],
        scheme=Scheme.SEMI_IMPLICIT_EULER,
    )


def solved(
    scene: Scene,
    method: str,
    eps: float | None = None,
    plan: Trajectory | None = None,
    *,
    seconds: float,
    **options: Any,
) -> Solution:
    """Return a method's solution at this eps, from this plan, within seconds [s].

    Raises OptionError, TrajectoryError, RelaxationError.
    """
    with load_method(method).open(scene, options) as session:
        return session.solve(eps=eps, warm_start=plan, time_limit=seconds)


def replayed(scene: Scene, plan: Trajectory, like: Scene | None = None, **settings: Any) -> Replay:
    """Return the replay without feedback; like: scene whose FMU takes other parameters."""
    return replay(
        scene, build_fmu(scene if like is None else like), plan, **{"track": False, **settings}
    )


def of_truth(problem: TruthProblem, like: Scene | None = None) -> tuple[Trajectory, Replay]:
    """Return a truth problem's motion by the compiled step, and its replay.

    Raises KernelError, FmuError.
    """
    plan = rolled(problem.scene, u=problem.plan.u, step=problem.step)
    return plan, replayed(problem.scene, plan, like=like)


def wrong_by(problem: TruthProblem, motion: Trajectory | Replay) -> dict[str, float]:
    """Return errors against a problem's exact answer, in its scales [-]; infinite if stopped.

    Raises MotionError.
    """
    rows = motion.knots if isinstance(motion, Replay) else slice(None)
    q, v = motion.q[rows], motion.v[rows]
    if len(q) <= problem.nodes:
        return {"the end, which was not reached": math.inf}
    return problem.errors(problem.plan.t, q, v, problem.end())


def at_nodes(motion: Replay) -> np.ndarray:
    """Return a replay's states (nodes, 2 nq) [m, rad, m/s, rad/s] at nodes. Raises nothing."""
    return np.hstack([motion.q[motion.knots], motion.v[motion.knots]])
