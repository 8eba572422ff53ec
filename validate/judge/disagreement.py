"""Why an engine is wrong, or disagrees: a class, by measurement, and what was measured.

The same of a problem with an exact answer and of a plan.

    # errors: of its motions by these drives, the coarsest first; wrong: of one more motion
    kind, sentence = why("mujoco", drives, errors, wrong)

In this order: its step made shorter, its own softness of friction changed, the motion's own
instability, all contacts stiffened.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum

import numpy as np

from models.codegen.kernel import load_kernel
from models.dynamics import derive
from validate.judge.replay.wiring import HeldInputs
from validate.judge.simulator import (
    Came,
    Drive,
    EngineAnswer,
    SimulatedMotion,
    describe_engine,
    run_engine,
)

REFERENCE = "fmu"
# An error falls if the last is so small a share of the first, over three halvings of the step at
# least.
_FALLS = 0.25
# What the last step is shortened by where that has not decided, or to so many radians of the
# stiffest contact, while its steps are no more than these; a tolerance by the square, to that at
# least. What softness and stiffness are changed by.
_MUCH = 16
_RADIANS = 0.01
_MOST = 1_000_000
_TIGHTEST = 1e-14
_SOFTER = 4.0
_STIFFER = (8.0, 64.0)


class Otherwise(Enum):
    """Why an engine says something else."""

    NONE = ""
    STEP = "step error"
    FRICTION = "friction regularisation"
    UNSTABLE = "unstable motion"
    LAW = "contact law"
    GEOMETRY = "geometry"
    LOST = "it diverges"


def level_of(drive: Drive, engine: str) -> float:
    """The step [s] or the tolerance of a drive, whichever this engine is told.

    Raises UnknownNameError.
    """
    return drive.tolerance if describe_engine(engine).adaptive else drive.step


def why(
    engine: str,
    drives: Sequence[Drive],
    errors: Sequence[float],
    wrong: Callable[[SimulatedMotion], float],
    *,
    settled: bool = False,
    unstable: Callable[[], str] = lambda: "",
    ask: Callable[[str, Sequence[Drive]], EngineAnswer] = run_engine,
) -> tuple[Otherwise, str]:
    """The class of a disagreement, and what was measured.

    Parameters
    ----------
    engine
        Who disagrees.
    drives, errors
        Its levels, the coarsest first, and how wrong each motion is, in what unit ever; infinite
        where it diverged.
    wrong
        The same of another motion of the engine.
    settled
        Whether the finest level does not disagree any more.
    unstable
        In words, that the motion itself makes this of a small error; empty: it does not, or nobody
        knows.
    ask
        How engines are asked.

    Returns
    -------
    tuple
        The class and a sentence.

    Raises
    ------
    UnknownNameError
        For an engine that there is not.
    """
    about, finest, (first, last) = describe_engine(engine), drives[-1], (errors[0], errors[-1])
    named = "tolerance" if about.adaptive else "step"

    def again(drive: Drive) -> float:
        answer = ask(engine, [drive])
        error = wrong(answer.motions[0]) if answer.came is Came.DONE else math.inf
        return error if math.isfinite(error) else math.inf

    begun = f"{size(first)} at a {named} of {level_of(drives[0], engine):.2g}, {size(last)} at {level_of(finest, engine):.2g}"
    if settled or last <= _FALLS * first < math.inf or math.isfinite(last) > math.isfinite(first):
        return Otherwise.STEP, begun
    factor = (
        _MUCH
        if about.adaptive
        else min(
            max(_MUCH, math.ceil(_radians(finest) / _RADIANS)),
            _MOST // (finest.plan.steps * finest.parts),
        )
    )
    if factor > 1:
        much = replace(
            finest,
            parts=finest.parts * factor,
            tolerance=max(finest.tolerance / factor**2, _TIGHTEST),
        )
        more = again(much)
        begun += f", {size(more)} at {level_of(much, engine):.2g}"
        if more <= last / 2.0 < math.inf or math.isfinite(more) > math.isfinite(last):
            return Otherwise.STEP, begun
    if not math.isfinite(last):
        return Otherwise.LOST, begun
    if about.softens and finest.scene.nf:
        soft = again(replace(finest, soft=_SOFTER))
        if max(soft, last) >= _SOFTER / 2.0 * min(soft, last):
            return (
                Otherwise.FRICTION,
                f"{begun}; with its friction {_SOFTER:g} times as soft {size(soft)}",
            )
    if words := unstable():
        return Otherwise.UNSTABLE, f"{begun}; {words}"
    # What contacts give is less the stiffer they are; where they meet is not.
    soft, stiff = (_depths_apart(engine, finest, factor, ask) for factor in _STIFFER)
    kind = Otherwise.LAW if stiff < soft / 2.0 else Otherwise.GEOMETRY
    said = f"its contacts are {size(soft)} m deeper or less deep than our reference's, with {_STIFFER[1] / _STIFFER[0]:g} times the stiffness {size(stiff)} m"
    return kind, f"{begun}; all contacts {_STIFFER[0]:g} times as stiff {said}"


def _radians(drive: Drive) -> float:
    """How many radians of the stiffest contact, at the start, a step is."""
    d = derive(drive.scene)
    gap, mass, k = (
        d.function(part, d.q)(drive.start[: drive.scene.nq])
        for part in (d.gap_jacobian, d.mass_matrix, d.stiffness)
    )
    return drive.step * math.sqrt(
        float((k.ravel() * np.diag(gap @ np.linalg.solve(mass, gap.T))).max())
    )


def _depths_apart(
    engine: str, drive: Drive, stiffer: float, ask: Callable[[str, Sequence[Drive]], EngineAnswer]
) -> float:
    """How much deeper, or less deep, an engine's contacts are than our reference's at their deepest, or at any time where they are closed at the start, all so much stiffer [m]; infinite without a number."""
    contacts = tuple(
        replace(contact, stiffness=stiffer * contact.stiffness) for contact in drive.scene.contacts
    )
    held, plan, part = HeldInputs(drive.plan), drive.plan, np.arange(drive.rows) / drive.rows
    # Each row a node of its own: our FMU gives nothing between them.
    h = np.diff(plan.t)[:, None]
    t = np.append((plan.t[:-1, None] + h * part).ravel(), plan.t[-1])
    u = (held.values[:, None] + held.slopes[:, None] * (h * part)[:, :, None]).reshape(
        len(t) - 1, -1
    )
    nothing = np.zeros((len(t), 0))
    fine = replace(plan, t=t, u=u, q=nothing, v=nothing, lam=nothing[1:], scheme=None)
    # What rests on a contact at the start does so on a stiffer one too.
    kernel, d = load_kernel(drive.scene), derive(drive.scene)
    q, v = np.split(drive.start, 2)
    lift = (1.0 - 1.0 / stiffer) * np.maximum(kernel.penetration(q[None])[0], 0.0)
    start = np.append(q + np.linalg.pinv(d.function(d.gap_jacobian, d.q)(q)) @ lift, v)
    scene = replace(drive.scene, contacts=contacts)
    asked = replace(
        drive, scene=scene, plan=fine, start=start, parts=drive.parts // drive.rows, rows=1
    )
    told = (
        ask(engine, [asked]),
        ask(REFERENCE, [replace(asked, tolerance=describe_engine(REFERENCE).tolerances[-1])]),
    )
    if any(answer.came is not Came.DONE for answer in told):
        return math.inf
    one, other = (kernel.penetration(answer.motions[0].q) for answer in told)
    apart = one - other if lift.any() else one.max(axis=0) - other.max(axis=0)
    return float(np.nan_to_num(np.abs(apart), nan=np.inf).max())


def size(error: float) -> str:
    """An error in a sentence."""
    return f"{error:.2g}" if math.isfinite(error) else "out of every bound"
