"""A judge that replays by the scene's own time step, 128 times in each step of the plan."""

from dataclasses import replace

import numpy as np

from models.codegen.kernel import load_kernel
from models.scene import Limit
from validate.judge.judgement import Judgement
from validate.judge.replay import Difference, Replay, ReplayError, ReplayOutcome
from validate.judge.score import score
from validate.tasks.plugins import DEFAULT

PARTS = 128  # small steps in a step of the plan
KEPT = 8  # recorded small steps in a step of the plan


def motion(scene, plan, parts):
    """Return positions and velocities after each small step."""
    h = plan.duration / plan.steps / parts
    return load_kernel(scene).rollout(plan.start, np.repeat(plan.u, parts, axis=0), h)


def judge(scene, fmu, plan):
    """Return the verdict. Questions on friction and on the work of forces stay unanswered."""
    kernel, fine, coarse = (
        load_kernel(scene),
        motion(scene, plan, PARTS),
        motion(scene, plan, PARTS // 2),
    )
    ok = not (fine.diverged or coarse.diverged)
    every = slice(None, None, PARTS // KEPT) if ok else slice(0, 1)
    q, v = fine.q[every], fine.v[every]
    lam, gap = kernel.contact_force(q, v=v), -kernel.penetration(q)
    error = None
    if ok:
        far_q, far_v = fine.q[::2] - coarse.q, fine.v[::2] - coarse.v
        state = np.linalg.norm(np.hstack([far_q, far_v]), axis=1).max()
        far_gap = np.abs(kernel.penetration(fine.q[::2]) - kernel.penetration(coarse.q)).max(
            initial=0.0
        )
        error = Difference(
            position=float(np.abs(far_q).max()), state=float(state), gap=float(far_gap)
        )
    kinetic, potential = kernel.energy(q, v)
    replay = Replay(
        scene=scene.name,
        outcome=ReplayOutcome.OK if ok else ReplayOutcome.DIVERGED,
        message="",
        method="everyday",
        t=np.linspace(0.0, plan.duration, KEPT * plan.steps + 1)[: len(q)],
        q=q,
        v=v,
        lam=lam,
        gap=gap,
        friction=np.zeros((len(q), scene.nf)),
        knots=np.arange(0, len(q), KEPT),
        kinetic_energy=kinetic,
        potential_energy=potential,
        contact_energy=(lam**2 / kernel.stiffness() / 2).sum(axis=1),
        input_work=None,
        dissipated_work=None,
        contact_impulse=None,
        events=(),
        event_budget=0,
        error=ReplayError(estimate=error, step=error),
        seconds_reference=0.0,
        seconds_everyday=0.0,
        fmu="small_steps",
    )
    unasked = Limit(
        metric="energy_residual_relative",
        value=None,
        reason="it does not report the work of its forces",
    )
    waived = replace(scene, limits=(*scene.limits, unasked))
    return Judgement(scene=scene, plan=plan, replay=replay, score=score(waived, plan, replay))


PLUGIN = replace(DEFAULT, judge=judge)
