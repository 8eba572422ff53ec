"""Causes of a failure: a code with fields, and one sentence template each.

    find_cause(scored, first)  # Cause(code="unstable", fields={"amplification": "550"})
    .sentence                  # "; unstable in the open loop (amplification 550)"

A cause is named only if its own test passes; the first one in the order of CAUSES is named. A
failure without a cause has the name of its metric as code. A plan that holds has no cause.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from models.codegen.kernel import KernelError
from models.scene import Scene
from validate.judge.score.evidence import Evidence
from validate.judge.score.measures import LEAST_ORDER, is_relaxed, times_the_law
from validate.judge.score.verdict import Answer, Metric, Question, Unmeasured, Verdict

# Growth of an error from which instability is named as a cause; a good plan's step errs by 1e-3.
_UNSTABLE = 100.0
# Largest deviation of a jump from whole turns [rad].
_NEAR_A_TURN = 0.1
_IMPULSES = ("ghost_impulse", "missed_impulse")
_OF_FORCES = ("physics_scaled", "contact_law_error", "contact_force_error")
_OF_LAW = ("law_error", "discrete_terminal_position_error", "discrete_terminal_velocity_error")


@dataclass(frozen=True, kw_only=True)
class ScoredPlan:
    """A plan with its evidence, metrics, verdict and answers.

    holds_as: another declaration with which the plan holds, else "".
    """

    case: Evidence
    metrics: Mapping[str, Metric]
    verdict: Verdict
    questions: Mapping[Question, Answer]
    waived: tuple[str, ...] = ()
    holds_as: str = ""

    def value(self, name: str) -> float | None:
        """Return a metric's value, None if not measured."""
        metric = self.metrics.get(name)
        return None if metric is None else metric.value

    def asks_for_motion(self, first: Metric) -> bool:
        """Return whether the failure is one of motion, or of impulses of correct forces."""
        if first.name in _IMPULSES:
            return self.questions.get(Question.FORCES) == "yes"
        return first.question is Question.MOTION and first.name != "replay_cost"

    def asks_for_forces(self, first: Metric) -> bool:
        """Return whether the failure is one of contact forces or of the contact law."""
        # A wrong law never gives the true motion.
        moves = self.questions.get(Question.MOTION) == "yes"
        return first.name in _OF_FORCES or (first.name in _OF_LAW and not moves)


Fields: TypeAlias = dict[str, str]


@dataclass(frozen=True)
class Cause:
    """A cause: its code in CAUSES, or a metric's name, and the fields of its sentence."""

    code: str
    fields: Fields = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        """Return the end of a sentence that states the failure, "" without fields."""
        return CAUSES[self.code][0].format(**self.fields) if self.fields else ""


def find_cause(scored: ScoredPlan, first: Metric, codes: Iterable[str] = ()) -> Cause:
    """Return the cause of a failure.

    first: the deciding metric; codes: those to try, all if empty
    """
    for code in codes or CAUSES:
        found = CAUSES[code][1](scored, first)
        if found is not None:
            return Cause(code, found)
    return Cause(first.name)


def _wrapped(scored: ScoredPlan, first: Metric) -> Fields | None:
    """Return the angle that jumps by whole turns, from the start or from its velocity."""
    plan, scene = scored.case.trajectory, scored.case.scene
    asked = (Question.GOAL, Question.FORCES, Question.MOTION)
    if first.name != "start_error" and first.question not in asked:
        return None
    if not isinstance(scene, Scene) or not plan.has_states:
        return None
    jumps = np.diff(plan.q, axis=0, prepend=[scene.task.start[: scene.nq]])
    moved = jumps.copy()
    if "v" not in plan.missing:
        moved[1:] -= np.diff(plan.t)[:, None] * (plan.v[:-1] + plan.v[1:]) / 2.0
    turns = np.round(moved / (2.0 * math.pi)) * [item.unit == "rad" for item in scene.coordinates]
    # An angle must jump; a velocity in another unit must not count as a turn.
    off = np.abs(moved - 2.0 * math.pi * turns) >= _NEAR_A_TURN
    jumped = (turns != 0.0) & ~off & (np.abs(jumps - 2.0 * math.pi * turns) < math.pi)
    if not jumped.any():
        return None
    return {"angle": scene.coordinates[int(jumped.any(axis=0).argmax())].name}


def _duration(scored: ScoredPlan, first: Metric) -> Fields | None:
    if first.name != "duration_error":
        return None
    plan, task = scored.case.trajectory, scored.case.scene.task
    return {"plan": f"{plan.duration:.6g}", "task": f"{task.horizon or 0.0:.6g}"}


def _depth(scored: ScoredPlan, first: Metric) -> Fields | None:
    scene, replay = scored.case.scene, scored.case.replayed
    if first.name != "max_penetration" or not isinstance(scene, Scene):
        return None
    if replay is None or not replay.ok:
        return None
    share = np.maximum(-replay.gap, 0.0).max(axis=0) / np.array(scene.depths)
    contact = scene.contacts[int(share.argmax())]
    one, other = contact.bodies
    return {"contact": contact.name, "one": one, "other": other, "why": contact.depth_reason}


def _declaration(scored: ScoredPlan, first: Metric) -> Fields | None:
    named = scored.holds_as and first.question in (Question.MOTION, Question.SCHEME)
    return {"line": scored.holds_as} if named else None


def _defect(scored: ScoredPlan, first: Metric) -> Fields | None:
    defect = scored.metrics.get("defect")
    if defect is None or defect.ok is not False or not scored.asks_for_motion(first):
        return None
    return {"residual": number(defect.value or 0.0, defect.unit)}


def _scaled(scored: ScoredPlan, first: Metric) -> Fields | None:
    if not scored.asks_for_forces(first):
        return None
    try:
        times = times_the_law(scored.case)
    except (Unmeasured, KernelError):
        return None
    if (times <= 0.0).any():  # no unit makes forces vanish or pull
        return None
    if np.ptp(times) <= 0.01 * float(times.max()):
        return {"times": rounded(float(times.mean()))}
    contacts = scored.case.scene.contacts
    each = [f"{rounded(float(x))} ({c.name})" for x, c in zip(times, contacts, strict=True)]
    return {"times": ", ".join(each)}


def _relaxed(scored: ScoredPlan, first: Metric) -> Fields | None:
    """Test whether forces fall with the gap, or exact contact moves the plan more than its grid."""
    advice = {"pipeline": "best_exact"}  # every scene with inputs has it
    if scored.asks_for_forces(first):
        return advice if is_relaxed(scored.case) else None
    grid = scored.value("grid_error")
    if grid is None or not scored.asks_for_motion(first):
        return None
    is_lost = (scored.value("law_error") or 0.0) > grid
    blames_growth = _growth(scored) >= _UNSTABLE and scored.questions.get(Question.FORCES) == "yes"
    return advice if is_lost and not blames_growth else None


def _few_digits(scored: ScoredPlan, first: Metric) -> Fields | None:
    if first.name != "velocity_error" and not scored.asks_for_forces(first):
        return None
    q = scored.case.trajectory.q
    few = [n for n in range(4) if np.allclose(q, np.round(q, n), rtol=0.0, atol=1e-12)]
    return {"digits": f"{10.0 ** -few[0]:g}"} if few else None


def _unstable(scored: ScoredPlan, first: Metric) -> Fields | None:
    growth = _growth(scored)
    if growth < _UNSTABLE or not scored.asks_for_motion(first):
        return None
    return {"amplification": rounded(growth)}


def _growth(scored: ScoredPlan) -> float:
    replay = scored.case.replayed
    return 0.0 if replay is None or replay.growth is None else replay.growth.amplification


def _coarse_grid(scored: ScoredPlan, first: Metric) -> Fields | None:
    """Test whether the discretisation error shrinks as the step is halved, with held inputs."""
    order = scored.value("grid_order")
    if order is None or order < LEAST_ORDER or not scored.asks_for_motion(first):
        return None
    plan, errors = scored.case.trajectory, scored.case.grid_errors
    error, finer = (number(errors[at], scored.metrics["grid_error"].unit) for at in (0, -1))
    step = plan.duration / plan.steps / 2 ** (len(errors) - 1)
    return {"error": error, "finer": finer, "step": f"{step:.2g}"}


def _motion(scored: ScoredPlan, first: Metric) -> Fields | None:
    """Return where the replay leaves the plan, no fields if the plan has no positions."""
    plan, replay = scored.case.trajectory, scored.case.replayed
    if first.question is not Question.MOTION or not scored.asks_for_motion(first):
        return None
    metric = scored.metrics.get("replay_error")
    if replay is None or not replay.ok or metric is None or metric.limit is None or metric.ok:
        return {}
    beyond = np.abs(plan.q - replay.q[replay.knots]) > metric.limit
    if not beyond.any():
        return {}
    node = int(np.argmax(beyond.any(axis=1)))
    name = scored.case.scene.coordinates[int(np.argmax(beyond[node]))].name
    return {"name": name, "limit": number(metric.limit, metric.unit), "time": f"{plan.t[node]:.3g}"}


# Template and test of each cause, by code, in the order of the tests.
CAUSES: dict[str, tuple[str, Callable[[ScoredPlan, Metric], Fields | None]]] = {
    "wrapped angles": (
        "; angle {angle} is wrapped: angles run on from the task's start (numpy.unwrap)",
        _wrapped,
    ),
    "duration_error": (" (it lasts {plan} s, the task {task} s)", _duration),
    "max_penetration": (
        ": beyond the depth at which the model of contact {contact} ({one} and {other}) ends, {why}",
        _depth,
    ),
    "declaration": ("; it holds with another declaration: {line}", _declaration),
    "defect": ("; it does not solve its declared scheme (residual {residual})", _defect),
    "scaled forces": (
        ": they are {times} times what the contact law gives, as of another stiffness or unit",
        _scaled,
    ),
    "relaxed contact": (
        ": a relaxed contact law; tighten eps, or plan with exact contact (`{pipeline}`)",
        _relaxed,
    ),
    "few digits": (
        "; it may be the plan's own digits: its positions are given to {digits}",
        _few_digits,
    ),
    "unstable": ("; unstable in the open loop (amplification {amplification})", _unstable),
    "coarse grid": (
        ": discretisation error {error}; at h = {step} s with these inputs held it is {finer}",
        _coarse_grid,
    ),
    "motion": ("; {name} is more than {limit} from the plan from t = {time} s on", _motion),
}


def number(value: float, unit: str, digits: int = 3) -> str:
    """Return a number with its unit; norms over several units have none."""
    return f"{value:.{digits}g}" if unit == "1" or "," in unit else f"{value:.{digits}g} {unit}"


def rounded(value: float, digits: int = 2) -> str:
    """Return the value without a power of ten up to a million: 5600, 0.34."""
    text = float(f"{value:.{digits}g}")
    return f"{text:.0f}" if 10.0 <= text < 1e6 else f"{text:g}"
