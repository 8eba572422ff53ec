"""Plans and replays as the stress cases need them: a scene's own compiled step, or a method, for the plan, its FMU for the replay.

plan = rolled(scene, start=..., u=..., step=..., steps=...)  # a Trajectory by the compiled step
motion = replayed(scene, plan)                                      # a Replay by the scene's FMU
plan, motion = of_truth(problem)  # both, of a problem of the truth suite
solution = solved(scene, "mpcc", seconds=20.0)                      # what a method makes of it
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
    """The motion by the compiled step.

    Parameters
    ----------
    scene
        Its task gives what is not given here.
    start
        (2 nq,) first state [m, rad, m/s, rad/s].
    u
        (steps, nu) inputs [N, N m]; zeros unless given.
    step
        Of time [s].
    steps
        How many, where `u` does not say it.
    law, eps
        The contact law, and the eps of a relaxed one.
    every
        One node in so many is part of the plan; the inputs must be constant between them.

    Returns
    -------
    Trajectory
        (steps / every + 1) nodes.

    Raises
    ------
    KernelError
        If arrays do not fit the scene.
    RelaxationError
        If the law wants another eps.
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
    """What a method finds in so many seconds at this eps, from this plan.

    Raises OptionError, TrajectoryError, RelaxationError where it refuses.
    """
    with load_method(method).open(scene, options) as session:
        return session.solve(eps=eps, warm_start=plan, time_limit=seconds)


def replayed(scene: Scene, plan: Trajectory, like: Scene | None = None, **settings: Any) -> Replay:
    """Replay of a plan, without feedback, by the FMU of the scene, or of `like`: one with other parameter values, which the FMU is given."""
    return replay(
        scene, build_fmu(scene if like is None else like), plan, **{"track": False, **settings}
    )


def of_truth(problem: TruthProblem, like: Scene | None = None) -> tuple[Trajectory, Replay]:
    """A problem of the truth suite by the compiled step between its nodes, and its replay.

    `like` as of `replayed`. Raises KernelError, FmuError.
    """
    plan = rolled(problem.scene, u=problem.plan.u, step=problem.step)
    return plan, replayed(problem.scene, plan, like=like)


def wrong_by(problem: TruthProblem, motion: Trajectory | Replay) -> dict[str, float]:
    """Errors of a plan or a replay against the exact answer of its problem, by what is asked, as shares of its scales [-]; infinite where a replay stopped. Raises MotionError."""
    rows = motion.knots if isinstance(motion, Replay) else slice(None)
    q, v = motion.q[rows], motion.v[rows]
    if len(q) <= problem.nodes:
        return {"the end, which was not reached": math.inf}
    return problem.errors(problem.plan.t, q, v, problem.end())


def at_nodes(motion: Replay) -> np.ndarray:
    """States (nodes, 2 nq) of a replay at the plan's nodes that it reached [m, rad, m/s, rad/s]."""
    return np.hstack([motion.q[motion.knots], motion.v[motion.knots]])
