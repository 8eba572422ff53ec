"""Views of a judged stage: metrics by question, its ends, and the cause of its verdict.

    questions_of(stage)[3].metrics[0].name, .alone.value, .followed.value  # "replay_error", 0.6, ..
    deciding(stage).name, cause_of(run).advice
    by_cause(runs)           # each cause once, with its runs, the most frequent first

The judge determines causes (`StageRecord.cause`); this module has their texts.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

from models.results.verdict import FEEDBACK, HOLD, TRACKED
from reports.wording import capital, measured, spaced

if TYPE_CHECKING:  # `replay` has stages that are no records, and does without pydantic: 0.4 s
    from models.results.check import CheckRecord
    from models.results.run import RunRecord, SceneRecord, StageRecord
    from models.results.verdict import Metric

SHOWN = "Shown, not judged"


@dataclass(frozen=True)
class MetricView:
    """One metric for the pages, without and with feedback; None if there is no value."""

    name: str
    alone: Metric | None
    followed: Metric | None

    @property
    def metric(self) -> Metric:
        """Return the metric with unit, limit and meaning."""
        found = self.alone or self.followed
        assert found is not None  # one of them exists
        return found

    @property
    def is_judged(self) -> bool:
        """Return whether either replay has a limit."""
        return any(
            metric is not None and metric.limit is not None
            for metric in (self.alone, self.followed)
        )

    @property
    def waived(self) -> str:
        """Return the scene's reason for waiving the limit, or ""."""
        metric = self.metric
        return (
            ""
            if self.is_judged or metric.value is None or metric.question.number is None
            else metric.reason
        )


@dataclass(frozen=True)
class QuestionView:
    """One question, its answer by the judged replay, and its metrics."""

    number: int | None
    text: str
    answer: str
    metrics: tuple[MetricView, ...]


def questions_of(stage: StageRecord) -> list[QuestionView]:
    """Return the questions in order, then metrics of the judge, and those only shown."""
    views = _views(stage)
    result = []
    for question, answer in stage.questions:
        mine = tuple(view for view in views if _belongs(view, question.number))
        result.append(QuestionView(question.number, question.value, answer, mine))
    used = {id(view) for question in result for view in question.metrics}
    rest = tuple(
        view
        for view in views
        if id(view) not in used and (view.metric.question.number is None or not stage.questions)
    )
    return [*result, QuestionView(None, SHOWN, "", rest)] if rest else result


def _belongs(view: MetricView, number: int | None) -> bool:
    if number is None:
        return view.metric.question.number is None and view.is_judged
    return view.metric.question.number == number and (
        view.is_judged or view.metric.value is not None
    )


def _views(stage: StageRecord) -> list[MetricView]:
    names = list(dict.fromkeys(metric.name.removeprefix(TRACKED) for metric in stage.metrics))
    views = []
    for name in names:
        alone, followed = stage.metric(name), stage.metric(f"{TRACKED}{name}")
        views.append(
            MetricView(name, None, alone)
            if name.startswith(FEEDBACK)
            else MetricView(name, alone, followed)
        )
    return views


def end_of(stage: StageRecord, scene: SceneRecord, *, tracked: bool | None = None) -> str:
    """Return the end of a replay: `position 0.11 m, velocity 0.10 m/s`, `free end`, or "".

    tracked: None takes the judged replay.
    """
    prefix = TRACKED if (stage.is_tracked if tracked is None else tracked) else ""
    distance = distance_of(stage, f"{prefix}replay_")
    if distance or stage.replay is None:
        return distance
    return "free end" if all(goal is None for goal in scene.goal) else ""


def distance_of(stage: StageRecord, prefix: str) -> str:
    """Return the distance of a motion's end from the goal, or "" if not measured.

    prefix: of the metrics: "" of the plan, `discrete_` of exact contact on its grid, `replay_`,
    `tracked_replay_`.
    """
    parts = []
    for part in ("position", "velocity"):
        metric = stage.metric(f"{prefix}terminal_{part}_error")
        if metric is not None and metric.value is not None:
            parts.append(f"{part} {measured(metric.value, metric.unit)}")
    whole = stage.metric(f"{prefix}terminal_error")
    if not parts and whole is not None and whole.value is not None:
        parts.append(f"error {measured(whole.value, whole.unit)}")
    return ", ".join(parts)


# best_exact is the one pipeline with exact contact that every scene with inputs has.
_EXACT = "Tighten eps, or plan with exact contact (best_exact)."
_FINER = "Plan on a finer grid, or by best_exact, which keeps the cheapest plan that is followed."
_ELSEWHERE = "A local optimum: start from another guess or a relaxed plan, or plan by best_exact."
_LOOK = "Look at the error over time on the page of the run."
_AWAY = "The plan itself does not reach the goal"
_DEAR = "The plan costs more than the scene allows"
_NOT_CONTACT = "The planned forces are not those of contact"
_OTHER_MOTION = "Exact contact on the plan's own grid gives another motion"
# (sentence, advice) by cause; other causes are metrics, named as such.
_CAUSES = {
    "start_error": ("The plan does not start where the task starts", "Plan from the task's start."),
    "duration_error": ("The plan does not last as long as the task", "Plan over the whole task."),
    "bound_violation": ("The inputs leave their bounds", "Give the bounds to the method."),
    "velocity_bound_violation": (
        "The planned velocities leave their bounds",
        "Give the bounds to the method.",
    ),
    "physics_scaled": (_NOT_CONTACT, _EXACT),
    "contact_law_error": (_NOT_CONTACT, _EXACT),
    "contact_force_error": (_NOT_CONTACT, _EXACT),
    "law_error": (_OTHER_MOTION, _EXACT),
    "discrete_terminal_position_error": (_OTHER_MOTION, _EXACT),
    "discrete_terminal_velocity_error": (_OTHER_MOTION, _EXACT),
    "force_sign_violation": (
        "A planned contact force pulls",
        "Bound the contact forces from below by zero.",
    ),
    "friction_violation": ("Planned friction exceeds its cone", _EXACT),
    "friction_dissipation_error": ("Planned friction does not oppose the slip", _EXACT),
    "max_penetration": (
        "Bodies penetrate deeper than the contact's model reaches",
        "Push more slowly, or give the scene a contact model that reaches deeper.",
    ),
    "ghost_impulse": (
        "Force at a distance: the plan is pushed where the replay touches nothing",
        _EXACT,
    ),
    "missed_impulse": (
        "The replay touches where the plan does not",
        "Plan with exact contact on a finer grid.",
    ),
    "defect": (
        "The plan does not solve its own discrete equations",
        "Tighten the solver's tolerance.",
    ),
    "relaxed contact": ("Relaxed contact: the plan's forces are not those of contact", _EXACT),
    "scaled forces": (
        "The planned forces are a multiple of those of contact",
        "Check the unit of the forces and the stiffness of the contacts.",
    ),
    "few digits": ("The plan has too few digits", "Write the plan with more digits."),
    "wrapped angles": ("An angle of the plan is wrapped", "Unwrap the angles (numpy.unwrap)."),
    "declaration": (
        "The plan holds with another declaration",
        "Change the lines `# hold:` or `# scheme:` of the plan.",
    ),
    "coarse grid": (
        "Coarse grid: contact is exact, but the time step is too long",
        "Take a smaller time step.",
    ),
    "unstable": (
        "Unstable in the open loop: small errors grow until the plan is lost",
        _FINER,
    ),
    "motion": ("The inputs do not give the planned motion", _LOOK),
}
# Advice for external plans, which have neither eps nor methods of ours.
_OF_OTHERS = {
    _EXACT: "Plan with exact contact; forces are pushes of at least 0, in the columns lam_..: without these columns the motion alone is judged.",
    _FINER: "Plan on a finer grid, or have the plan followed with feedback.",
    _ELSEWHERE: "Plan from another guess: the scene has a cheaper plan.",
    _LOOK: "Look at the error over time (`replay --html`).",
}
# Verdicts that need no cause.
_NO_CAUSE = (*HOLD, "not applicable", "consistent")
_AGAIN = "Read the end of the log on the page of the run, and run it again by the command there."


@dataclass(frozen=True)
class Cause:
    """A cause and an advice, each a sentence."""

    sentence: str
    advice: str


# Cause for a plan without positions, which claims no motion.
_NO_MOTION = Cause(
    "The inputs do not bring the motion to the goal",
    "Change the inputs; `replay --html` draws the motion that they give.",
)


def deciding(stage: StageRecord) -> Metric | None:
    """Return the metric that decided a verdict: the first failing or undecided one.

    For a plan that holds the metric nearest to its limit; None without judged metrics.
    """
    judged = sorted(
        (metric for metric in stage.metrics if metric.limit is not None),
        key=lambda metric: metric.question.number or 7,
    )
    alone = [metric for metric in judged if not metric.name.startswith((TRACKED, FEEDBACK))]
    if stage.verdict == "violates":
        return next(
            (
                metric
                for metric in (*(item for item in alone if item.question.number), *judged)
                if metric.ok is False
            ),
            None,
        )
    if stage.verdict == "undecided":
        unsure = [metric for metric in alone if metric.ok is not True]
        return next((metric for metric in unsure if metric.question.number is None), None) or next(
            iter(unsure), None
        )
    if stage.verdict in HOLD:
        counted = (
            [metric for metric in judged if metric.name.startswith((TRACKED, FEEDBACK))]
            if stage.is_tracked
            else alone
        )
        return max(
            (metric for metric in counted if metric.value is not None and metric.question.number),
            key=_share,
            default=None,
        )
    return None


def _share(metric: Metric) -> float:
    return abs(metric.value or 0.0) / metric.limit if metric.limit else 0.0


def cause_of(run: RunRecord) -> Cause | None:
    """Return why a run does not hold, None if it holds or has no goal."""
    stage = run.last
    if run.verdict in _NO_CAUSE:
        return None
    if stage is None or run.verdict == "no plan":
        advice = stage.advice if stage is not None and stage.outcome == run.outcome else _AGAIN
        return Cause(f"No plan: {spaced(run.outcome)}", advice)
    return cause_of_stage(stage)


def cause_of_stage(stage: StageRecord) -> Cause | None:
    """Why a judged plan does not hold; None where it does, or where nothing was asked of it."""
    if stage.verdict in _NO_CAUSE:
        return None
    cause = stage.cause
    if not cause:
        return Cause(
            f"{capital(stage.verdict)}: {stage.why.split('. ')[0].rstrip('.') or 'the record does not say why'}",
            stage.advice,
        )
    if stage.verdict == "undecided":
        return Cause(
            f"Undecided: the replay's own error leaves {spaced(cause)} open",
            "Replay with tighter tolerances.",
        )
    metric, moved = deciding(stage), stage.metric("replay_error")
    misses = metric is not None and metric.name.startswith("replay_terminal")
    if cause == "motion" and misses and (moved is None or moved.value is None):
        return _NO_MOTION
    if cause == "replay_cost":
        sentence, advice = f"{_DEAR} ({spaced(stage.outcome)})", stage.advice
        advice = _ELSEWHERE if stage.outcome in ("solved", "stalled") else advice
    elif cause.startswith("terminal"):
        sentence, advice = f"{_AWAY} ({spaced(stage.outcome)})", stage.advice
    else:
        sentence, advice = _CAUSES.get(
            cause, (f"A limit is exceeded: {spaced(cause)}", stage.advice)
        )
    is_best = stage.method == "best_exact" and advice in (_FINER, _ELSEWHERE)
    if stage.kind == "given" or is_best:
        advice = _OF_OTHERS.get(advice, advice)
    elif stage.kind == "direct" and advice is _EXACT:  # exact once solved
        advice = (
            "Tighten the solver's tolerance, or take a smaller time step."
            if stage.outcome == "solved"
            else stage.advice
        )
    return Cause(sentence, advice)


def by_cause(runs: Iterable[RunRecord]) -> list[tuple[Cause, list[RunRecord]]]:
    """Return each cause with its failing runs, the most frequent first."""
    groups: dict[Cause, list[RunRecord]] = {}
    for run in runs:
        cause = cause_of(run)
        if cause is not None:
            groups.setdefault(cause, []).append(run)
    return sorted(groups.items(), key=lambda item: -len(item[1]))


# Options that select a campaign's scenes, methods and time, and options with an argument.
_KEPT = ("--scene", "--plugin", "--time-limit")
_WITH_A_WORD = (*_KEPT, "-k", "-j", "--jobs", "--out", "--retry", "--engine")


def again(record: RunRecord | CheckRecord) -> str:
    """Return a command that repeats a run in its own folder, or the recorded command."""
    try:
        words = shlex.split(record.provenance.command)
    except ValueError:
        return record.provenance.command
    if words[1:3] != ["-m", "validate"] or words[3:4] not in (["all"], ["run"]):
        return record.provenance.command
    quoted = record.title.replace('"', '""')
    return shlex.join(
        [*words[:4], *_kept(words[4:]), "-k", f'="{quoted}"', "--fresh", "--out", "runs/again"]
    )


def _kept(words: list[str]) -> list[str]:
    """Return the words of a campaign's command that select its runs."""
    kept: list[str] = []
    rest = iter(words)
    for word in rest:
        words_of_option = [word, *islice(rest, 1 if word in _WITH_A_WORD else 0)]
        # A word without an option is the campaign's file.
        if (
            word in _KEPT
            or word.startswith(tuple(f"{option}=" for option in _KEPT))
            or not word.startswith("-")
        ):
            kept += words_of_option
    return kept
