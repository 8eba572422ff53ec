"""The sentence of a verdict: its deciding metric, the cause, and advice.

Causes follow from metrics, never from a method's name: defect, bounds, relaxed contact, coarse
grid, unstable motion, penetration, inexact replay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Hold, Trajectory
from validate.judge.replay.result import Replay
from validate.judge.replay.subject import Subject
from validate.judge.score.measures import IDLE
from validate.judge.score.table import FEEDBACK, TABLE
from validate.judge.score.verdict import (
    EFFORT,
    MARGIN,
    SHARE,
    TRACKED,
    Answer,
    Metric,
    Question,
    Unmeasured,
    Verdict,
    is_of_feedback,
)

_ENTRIES = {entry.name: entry for entry in (*TABLE, *FEEDBACK)}
# Growth of an error from which instability is named as a cause; a good plan's step errs by 1e-3.
_UNSTABLE = 100.0
# Aimed share of the limit, so that an advised step is a little smaller than predicted.
_SAFETY = 0.8
# Most additional digits to print a value apart from its limit.
_MORE_DIGITS = 7
# Largest deviation of a jump from whole turns [rad].
_NEAR_A_TURN = 0.1
_CAUSES = {
    "defect": "; if another integrator made it, leave the declaration of the scheme out",
}


@dataclass(frozen=True, kw_only=True)
class ScoredPlan:
    """One plan with its metrics and answers.

    - other_hold: the plan holds with the other hold.
    - halved: yields grid errors [m or rad] with the step halved repeatedly; raises Unmeasured.
    - times_the_law: (nc,) [-] planned forces over the law's; raises Unmeasured.
    - is_relaxed: the planned forces follow a relaxed law.
    """

    scene: Subject
    trajectory: Trajectory
    replay: Replay | None
    metrics: Mapping[str, Metric]
    verdict: Verdict
    questions: Mapping[Question, Answer]
    waived: tuple[str, ...] = ()
    other_hold: bool = False
    halved: Callable[[float], Iterator[float]] = lambda near: iter(())
    times_the_law: Callable[[], np.ndarray] = lambda: np.ones(0)
    is_relaxed: Callable[[], bool] = lambda: False

    def value(self, name: str) -> float | None:
        """Return a metric's value, None if not measured."""
        metric = self.metrics.get(name)
        return None if metric is None else metric.value

    def fails(self, name: str) -> bool:
        """Return whether a metric is certainly above its limit."""
        metric = self.metrics.get(name)
        return metric is not None and metric.is_judged and metric.ok is False


def explain(scored: ScoredPlan) -> str:
    """Return the reason of the verdict in one or two sentences."""
    sentence = {
        Verdict.VIOLATES: _violates,
        Verdict.UNDECIDED: _undecided,
        Verdict.HOLDS: _holds,
        Verdict.HOLDS_WITH_FEEDBACK: _holds_with_feedback,
        Verdict.CONSISTENT: _consistent,
        Verdict.NOT_APPLICABLE: lambda scored: (
            f"inputs alone claim nothing, and {_who_asks(scored)} asks for nothing: {_mend(scored)}."
        ),
    }[scored.verdict](scored)
    return sentence + (
        f" Waived: {', '.join(text.partition(':')[0] for text in scored.waived)}."
        if scored.waived
        else ""
    )


def cause_of(scored: ScoredPlan) -> str:
    """Return the cause in one word, see `Score.cause`."""
    if scored.verdict is Verdict.UNDECIDED:
        return next(
            (
                metric.name
                for metric in (*_unwell(scored), *_judged(scored, None), *_judged(scored, False))
            ),
            "",
        )
    if scored.verdict is not Verdict.VIOLATES:
        return ""
    first = _above(scored)[0]
    of_motion = first.question is Question.MOTION and first.name not in _NAMED
    return (
        _cause_of_motion(scored) if of_motion or _is_by_the_grid(first.name, scored) else first.name
    )


_IMPULSES = ("ghost_impulse", "missed_impulse")
# Metrics of the motion that are their own cause.
_NAMED = ("replay_cost",)


def _cause_of_motion(scored: ScoredPlan) -> str:
    growth = scored.value("amplification")
    unstable = growth is not None and growth >= _UNSTABLE
    if scored.fails("defect"):
        return "defect"
    if _is_lost_on_its_grid(scored) and not (
        unstable and scored.questions.get(Question.FORCES) == "yes"
    ):
        return "relaxed contact"
    if unstable:
        return "unstable"
    return "motion" if scored.value("grid_error") is None else "coarse grid"


def _is_lost_on_its_grid(scored: ScoredPlan) -> bool:
    """Return whether exact contact on the plan's grid moves it more than a finer grid does."""
    grid = scored.value("grid_error")
    return grid is not None and (scored.value("law_error") or 0.0) > grid


def _is_by_the_grid(name: str, scored: ScoredPlan) -> bool:
    """Return whether contact differs by an error of the grid, although planned forces are right."""
    return (
        name in _IMPULSES and scored.questions.get(Question.FORCES) == "yes" and _has_order(scored)
    )


def _has_order(scored: ScoredPlan) -> bool:
    """Return whether the grid's error is known to shrink with the step."""
    return None not in (scored.value("grid_error"), scored.value("grid_order"))


def _above(scored: ScoredPlan) -> list[Metric]:
    return [metric for metric in _judged(scored, False) if metric.question is not Question.JUDGE]


def _unwell(scored: ScoredPlan) -> list[Metric]:
    return [
        metric
        for metric in scored.metrics.values()
        if metric.question is Question.JUDGE and metric.is_judged and metric.ok is not True
    ]


def _judged(scored: ScoredPlan, ok: bool | None) -> list[Metric]:
    metrics = [
        metric
        for metric in scored.metrics.values()
        if metric.is_judged and metric.ok is ok and not is_of_feedback(metric.name)
    ]
    return sorted(metrics, key=lambda metric: list(Question).index(metric.question))


def _of_feedback(scored: ScoredPlan, ok: bool | None) -> list[Metric]:
    return [
        metric
        for metric in scored.metrics.values()
        if metric.is_judged and metric.ok is ok and is_of_feedback(metric.name)
    ]


def _violates(scored: ScoredPlan) -> str:
    above = _above(scored)
    first = above[0]
    text, quoted = _quote(first) + _cause(first, scored), [first.name]
    consequence = next((metric for metric in above if metric.question is Question.MOTION), None)
    if first.question in (Question.TASK, Question.FORCES) and consequence is not None:
        text += f"; {_quote(consequence)}"
        quoted.append(consequence.name)
    others = [metric.name for metric in above if metric.name not in quoted]
    if others:
        text += f"; also above their limits: {', '.join(others)}"
    text += "."
    if (
        scored.questions.get(Question.MOTION) != "yes"
        and scored.replay is not None
        and scored.replay.tracked is not None
    ):
        missed = _of_feedback(scored, False)
        text += f" With feedback too: {_quote(missed[0])}." if missed else ""
    return text


def _undecided(scored: ScoredPlan) -> str:
    unwell = _unwell(scored)
    if unwell:
        known = (
            f", known to {number(unwell[0].error, unwell[0].unit)}"
            if unwell[0].ok is None and unwell[0].value is not None
            else ""
        )
        return f"the judge is not well, so nothing is said of the plan: {_quote(unwell[0])}{known}."
    unsure = _judged(scored, None)
    if not unsure:
        alone = _judged(scored, False)
        open_with = _of_feedback(scored, None)
        why = f": {_what_is_unknown(open_with[0])}" if open_with else ""
        return (
            f"{_quote(alone[0])}; whether feedback would help could not be decided{why}."
            if alone
            else "no question could be decided."
        )
    first, text = unsure[0], _what_is_unknown(unsure[0])
    others = [metric.name for metric in unsure[1:]]
    text += f"; nor decided: {', '.join(others)}." if others else "."
    needed = (
        "" if scored.replay is None or first.value is None else scored.replay.error.would_decide
    )
    return f"{text} What would decide it: {needed}." if needed else text


def _what_is_unknown(metric: Metric) -> str:
    if metric.value is None:
        return f"{metric.name} could not be measured: {metric.reason.rstrip('.')}"
    if math.isinf(metric.error):
        return f"{_quote(metric)}, but the replay has no error estimate"
    return f"{_quote(metric)}, but the replay's own error of {number(metric.error, metric.unit)} is not {MARGIN:g} times below the distance between them"


def _holds(scored: ScoredPlan) -> str:
    judged = _judged(scored, True)
    closest = max(
        judged,
        key=lambda metric: (metric.value or 0.0) / metric.limit if metric.limit else 0.0,
        default=None,
    )
    text = (
        "every question asked is answered yes"
        if isinstance(scored.scene, Scene)
        else f"holds {_of_what_is_shown(scored)}"
    )
    if closest is None or closest.value is None:
        return f"{text}."
    text += f"; closest to its limit: {_quote(closest)}"
    grid = scored.value("grid_error")
    if grid is not None and closest.name.startswith("replay_"):
        text += f", of which the grid's discretisation error is {number(grid, scored.metrics['grid_error'].unit)}"
    return text + "."


def _of_what_is_shown(scored: ScoredPlan) -> str:
    asked = [
        str(question.number)
        for question, word in scored.questions.items()
        if question.number and word != "not asked"
    ]
    return f"for what this FMU shows (question{'s' if len(asked) > 1 else ''} {', '.join(asked)})"


def _who_asks(scored: ScoredPlan) -> str:
    return "the scene" if isinstance(scored.scene, Scene) else "the map"


def _consistent(scored: ScoredPlan) -> str:
    shown = "" if isinstance(scored.scene, Scene) else f" {_of_what_is_shown(scored)}"
    return f"consistent{shown}; {_who_asks(scored)} asks for nothing: {_mend(scored)}."


def _mend(scored: ScoredPlan) -> str:
    """Advise a goal or limit that asks for something."""
    if scored.scene.task.has_goal:
        return "no limit on its goal counts for this plan; set one, with a reason"
    if isinstance(scored.scene, Scene):
        return "give it a goal, or a limit on its cost"
    return "give it a [goal] with its limits"


def _holds_with_feedback(scored: ScoredPlan) -> str:
    failing = [
        metric
        for metric in (*_judged(scored, False), *_judged(scored, None))
        if metric.question is Question.MOTION
    ]
    text = (
        f"not for the inputs alone: {_quote(failing[0])}" if failing else "not for the inputs alone"
    )
    growth = scored.value("amplification")
    if scored.other_hold:
        text += f" ({_held_the_other_way(scored)})"
    elif growth is not None and growth > _UNSTABLE:
        text += f", unstable in the open loop (amplification {rounded(growth)})"
    effort, share = scored.value(EFFORT), scored.value(SHARE)
    took = [] if effort is None else [f"{percent(effort)} of the half-range"]
    took += [] if share is None else [f"{percent(share)} of what the plan's own inputs do"]
    text += f"; with LQR feedback, RMS effort {' and '.join(took)}, it holds"
    end = next(
        (
            scored.metrics[name]
            for name in _ENDS
            if name in scored.metrics and scored.metrics[name].value is not None
        ),
        None,
    )
    return text + ("." if end is None else f": {_quote(end)}.")


_ENDS = tuple(
    f"{TRACKED}{name}"
    for name in ("replay_terminal_position_error", "replay_terminal_velocity_error", "replay_error")
)


def _cause(first: Metric, scored: ScoredPlan) -> str:
    if (
        first.name == "start_error"
        or first.question in (Question.GOAL, Question.FORCES, Question.MOTION)
    ) and _jumps_by_turns(scored):
        return "; its angles are wrapped, where those of a plan run on from the task's start (numpy.unwrap)"
    if first.name == "duration_error" and scored.scene.task.horizon is not None:
        return f" (it lasts {scored.trajectory.duration:.6g} s, the task {scored.scene.task.horizon:.6g} s)"
    if first.question is Question.TASK or first.question is Question.GOAL:
        return ""
    if first.name in ("physics_scaled", "contact_law_error", "contact_force_error"):
        return _of_forces(scored)
    if first.name == "velocity_error":
        few = _few_digits(scored.trajectory)
        return f"; it may be {few}" if few else ""
    if first.name in _CAUSES:
        return _CAUSES[first.name]
    if first.name == "max_penetration":
        return _of_depth(scored)
    if first.name in (
        "law_error",
        "discrete_terminal_position_error",
        "discrete_terminal_velocity_error",
    ):
        if (
            scored.questions.get(Question.MOTION) == "yes"
        ):  # a relaxed law never gives the true motion
            return "; its inputs give its motion all the same: if another integrator made it, leave the declaration of the scheme out"
        return _of_forces(scored)
    if first.question is Question.MOTION:
        return _of_motion(first, scored)
    by_the_grid = _is_by_the_grid(first.name, scored)
    if by_the_grid or (
        first.name not in _IMPULSES and first.question is Question.POSSIBLE and _has_order(scored)
    ):
        grid = scored.metrics["grid_error"]
        text = f": discretisation error {number(grid.value or 0.0, grid.unit)}"
        return f"{text}; the contact forces are correct{_unstable(scored)}" if by_the_grid else text
    return ": force at a distance" if first.name == "ghost_impulse" else ""


def _jumps_by_turns(scored: ScoredPlan) -> bool:
    """Return whether an angle jumps by whole turns, from the start or from its velocity."""
    plan, scene = scored.trajectory, scored.scene
    if not isinstance(scene, Scene) or not plan.has_states:
        return False
    jumps = np.vstack(
        [plan.start[: scene.nq] - np.array(scene.task.start[: scene.nq]), np.diff(plan.q, axis=0)]
    )
    moved = jumps.copy()
    moved[1:] -= (
        np.diff(plan.t)[:, None] * (plan.v[:-1] + plan.v[1:]) / 2.0 * ("v" not in plan.missing)
    )
    turns = np.round(moved / (2.0 * math.pi)) * [item.unit == "rad" for item in scene.coordinates]
    # An angle must jump; a velocity in another unit must not count as a turn.
    near = (np.abs(moved - 2.0 * math.pi * turns) < _NEAR_A_TURN) & (
        np.abs(jumps - 2.0 * math.pi * turns) < math.pi
    )
    return bool(((turns != 0.0) & near).any())


def _of_forces(scored: ScoredPlan) -> str:
    if multiple := _multiple_of_the_law(scored):
        return multiple
    if scored.is_relaxed():
        return f": a relaxed contact law; {_exact_contact(scored)}"
    few = _few_digits(scored.trajectory)
    return f"; it may be {few}" if few else ""


def _exact_contact(scored: ScoredPlan) -> str:
    """Advise exact contact; of a scene by the pipeline that every scene with inputs has."""
    pipeline = " (`best_exact`)" if isinstance(scored.scene, Scene) else ""
    return f"tighten eps, or plan with exact contact{pipeline}"


def _departure(scored: ScoredPlan) -> str:
    plan, replay, scene = scored.trajectory, scored.replay, scored.scene
    metric = scored.metrics.get("replay_error")
    if replay is None or not replay.ok or metric is None or metric.limit is None or metric.ok:
        return ""
    beyond = np.abs(plan.q - replay.q[replay.knots]) > metric.limit
    if not beyond.any():
        return ""
    node = int(np.argmax(beyond.any(axis=1)))
    name = scene.coordinates[int(np.argmax(beyond[node]))].name
    return f"; {name} is beyond that limit from t = {plan.t[node]:.3g} s on"


def _multiple_of_the_law(scored: ScoredPlan) -> str:
    """Return the factor between planned forces and the contact law's, or ""."""
    try:
        times = scored.times_the_law()
    except Unmeasured:
        return ""
    if not times.size:
        return ""
    alike = np.ptp(times) <= 0.01 * float(np.abs(times).max())
    each = [
        f"{rounded(float(x))} ({item.name})"
        for x, item in zip(times, scored.scene.contacts, strict=True)
    ]
    factor = rounded(float(times.mean())) if alike else ", ".join(each)
    return f": they are {factor} times what the contact law gives, as of another stiffness or another unit"


def _few_digits(plan: Trajectory) -> str:
    """Return whether too few digits of the plan may be the cause, or ""."""
    few = next(
        (
            digits
            for digits in range(4)
            if np.allclose(plan.q, np.round(plan.q, digits), rtol=0.0, atol=1e-12)
        ),
        None,
    )
    return (
        "" if few is None else f"the plan's own digits: its positions are given to {10.0**-few:g}"
    )


def _of_depth(scored: ScoredPlan) -> str:
    if not isinstance(scored.scene, Scene) or scored.replay is None or not scored.replay.ok:
        return ""
    share = np.maximum(-scored.replay.gap, 0.0).max(axis=0) / np.array(scored.scene.depths)
    contact = scored.scene.contacts[int(share.argmax())]
    return f": beyond the depth at which the model of contact {contact.name} ({contact.bodies[0]} and {contact.bodies[1]}) ends, {contact.depth_reason}"


def _held_the_other_way(scored: ScoredPlan) -> str:
    other = "linear" if scored.trajectory.hold is Hold.ZERO_ORDER else "zero"
    return f"with its inputs held the other way it does not: declare `# hold: {other}`"


def _of_motion(first: Metric, scored: ScoredPlan) -> str:
    plan = scored.trajectory
    if scored.other_hold:
        return f"; {_held_the_other_way(scored)}"
    if not plan.has_states or first.value is None:
        return ""
    unstable = _unstable(scored)
    if plan.scheme is None:
        return f"{_departure(scored)}{unstable}{_may_declare(scored)}"
    grid = scored.metrics.get("grid_error")
    if grid is None or grid.value is None:
        return unstable
    cause = _cause_of_motion(scored)
    if cause == "defect":
        return f": {_quote(scored.metrics['defect'])}"
    if _is_lost_on_its_grid(scored):
        lost = f"{number(scored.value('law_error') or 0.0, grid.unit)} on its own grid already"
        if cause == "relaxed contact":
            return f": a relaxed contact law ({lost}); {_exact_contact(scored)}"
        return f": off by {lost}; the contact forces are correct{unstable}"
    correct = (
        "; the contact forces are correct" if plan.lam.size and "lam" not in plan.missing else ""
    )
    text = f": discretisation error {number(grid.value, grid.unit)}{correct}{unstable}"
    if any(
        scored.fails(name)
        for name in (
            "physics_scaled",
            "contact_law_error",
            "friction_violation",
            "friction_dissipation_error",
        )
    ):
        return f": discretisation error {number(grid.value, grid.unit)}{unstable}"
    return text + _finer(first, grid.value, scored)


def _may_declare(scored: ScoredPlan) -> str:
    """Advise a declaration of the scheme; an FMU keeps its equations to itself."""
    if not isinstance(scored.scene, Scene):
        return ""
    return "; if semi-implicit Euler made the plan, declare it (a line `# scheme: semi_implicit_euler`)"


def _unstable(scored: ScoredPlan) -> str:
    growth = scored.value("amplification")
    return (
        ""
        if growth is None or growth < _UNSTABLE
        else f"; unstable in the open loop (amplification {rounded(growth)})"
    )


def _finer(first: Metric, grid: float, scored: ScoredPlan) -> str:
    plan = scored.trajectory
    if first.limit is None or first.limit <= 0.0 or plan.scheme is None or grid <= 0.0:
        return ""
    # A kink of the contact force limits any scheme to order two.
    first_order = plan.scheme is Scheme.SEMI_IMPLICIT_EULER
    order = 1.0 if first_order else 2.0
    step, error, near = (
        plan.duration / plan.steps,
        grid,
        _SAFETY * first.limit * min(1.0, grid / max(grid, first.value or 0.0)),
    )
    # Far too long steps predict little: they are halved first, with held inputs.
    nearer = True
    with suppress(Unmeasured):
        for finer in scored.halved(near):
            order = (
                max(order, math.log2(error / finer))
                if finer <= near and 0.0 < finer < error
                else order
            )
            nearer = finer <= max(near, (1.0 - IDLE) * error)
            step, error = step / 2.0, finer
    if not nearer:
        return "; half the step, these inputs held, brings it no nearer"
    if error > 0.0:
        step *= min(2.0 if error <= near else 1.0, (near / error) ** (1.0 / order))
    smooth = (
        isinstance(scored.scene, Scene)
        and not scored.scene.nf
        and not scored.scene.damped
        and scored.scene.relaxation_index is None
    )
    other = ", or `collocation`" if first_order and smooth else ""
    return f". Try h = {step:.2g} s (predicted with these inputs held){other}"


def _quote(metric: Metric) -> str:
    """Return `the motion ends 0.3 m from the goal, limit 0.06 m`, or why there is no number."""
    name = metric.name.removeprefix(TRACKED)
    if metric.value is None:
        return f"{metric.name}: {metric.reason.rstrip('.')}"
    value, limit = _told_apart(
        metric.value,
        metric.limit or 0.0,
        None if name in (EFFORT, SHARE) else metric.unit,
    )
    phrase = _ENTRIES[name].quote(value)
    if name != metric.name:
        phrase = "with feedback " + phrase.replace("driven by its inputs ", "")
    return f"{phrase}, limit {limit}" if metric.is_judged else phrase


def _told_apart(value: float, limit: float, unit: str | None) -> tuple[str, str]:
    """Return both with enough digits to differ; percentages without a unit."""
    for more in range(_MORE_DIGITS):
        texts = [
            percent(of, 2 + more) if unit is None else number(of, unit, 3 + more)
            for of in (value, limit)
        ]
        if texts[0] != texts[1]:
            break
    return texts[0], texts[1]


def number(value: float, unit: str, digits: int = 3) -> str:
    """Return a number with its unit; norms over several units have none."""
    return f"{value:.{digits}g}" if unit == "1" or "," in unit else f"{value:.{digits}g} {unit}"


def percent(share: float, digits: int = 2) -> str:
    """Return `24 %`."""
    return f"{100 * share:.{digits}g} %" if abs(share) < 10 else f"{rounded(100 * share, digits)} %"


def rounded(value: float, digits: int = 2) -> str:
    """Return the value without a power of ten up to a million: 5600, 0.34."""
    text = float(f"{value:.{digits}g}")
    return f"{text:.0f}" if 10.0 <= text < 1e6 else f"{text:g}"
