"""Table of metrics: name, question, unit, meaning, measure and default limit.

Metrics of question `SHOWN` are not judged. A scene may replace or waive a limit, with a reason.
Metrics of the replay have a twin with feedback and the same limits (`tracked_replay_error`). The
feedback's effort is limited too, because large corrections make another plan.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from models.scene import Scene
from models.scene.default_limits import FEEDBACK_EFFORT, FEEDBACK_SHARE, IMPULSE, REPLAY_ERROR
from validate.judge.replay.subject import Subject
from validate.judge.replay.wiring import Effort
from validate.judge.score import measures
from validate.judge.score.evidence import Evidence
from validate.judge.score.measures import DEFECT, Measured
from validate.judge.score.verdict import EFFORT, SHARE, TRACKED, LeavesBounds, Question, Unmeasured


@dataclass(frozen=True, kw_only=True)
class MetricEntry:
    """One metric; measure raises Unmeasured with a reason.

    - name: the measure's own if empty; units: of each component, or those of a norm.
    - quoted: phrase of the verdict, {} is the value; default `NAME is {}`.
    - default: limit as a factor of the scale, and reason; None: only a scene's limit judges.
    - needs: groups of the plan, of "q", "v", "lam", "friction", "scheme", "no scheme".
    - of_replay: has a twin with feedback.
    - limit_of: metric whose limit is used.
    """

    measure: Callable[[Evidence], Measured | tuple[float, float] | float]
    meaning: str
    name: str = ""
    question: Question = Question.SHOWN
    units: Callable[[Subject], tuple[str, ...]] = lambda scene: ("1",)
    applies: Callable[[Subject], bool] = lambda scene: True
    needs: tuple[str, ...] = ()
    default: tuple[float, str] | None = None
    of_replay: bool = False
    quoted: str = ""
    limit_of: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.name or getattr(self.measure, "__name__", ""))

    @property
    def limited_by(self) -> str:
        """Return the metric whose limit is used."""
        return self.limit_of or self.name.removeprefix(TRACKED)

    def unit(self, scene: Subject) -> str:
        """Return the units of all components, each once."""
        return ", ".join(dict.fromkeys(self.units(scene)))

    def quote(self, value: str) -> str:
        """Return the phrase of the verdict; value: with its unit."""
        return self.quoted.format(value) if self.quoted else f"{self.name} is {value}"


def _positions(scene: Subject) -> tuple[str, ...]:
    return tuple(item.unit for item in scene.coordinates)


def _velocities(scene: Subject) -> tuple[str, ...]:
    return tuple(item.velocity_unit for item in scene.coordinates)


def _states(scene: Subject) -> tuple[str, ...]:
    return (*_positions(scene), *_velocities(scene))


def _inputs(scene: Subject) -> tuple[str, ...]:
    return tuple(item.unit for item in scene.inputs)


def _unit(text: str) -> Callable[[Subject], tuple[str, ...]]:
    return lambda scene: (text,)


def _has_contacts(scene: Subject) -> bool:
    return scene.nc > 0


def _has_friction(scene: Subject) -> bool:
    return scene.nf > 0


def _has_velocity_bounds(scene: Subject) -> bool:
    return any(item.has_velocity_bounds for item in scene.coordinates)


def _bounded(which: Callable[..., bool]) -> Callable[[Subject], bool]:
    return lambda scene: any(which(np.isfinite((i.lower, i.upper))) for i in scene.inputs)


def _is_scene(scene: Subject) -> bool:
    return isinstance(scene, Scene)


_QUOTED = {
    "position": "{} from the goal",
    "velocity": "with {} more or less than the goal's velocity",
}


def _ends(
    of: str,
    question: Question,
    where: str,
    subject: str,
    needs: tuple[tuple[str, ...], ...] = ((), (), ()),
    default: tuple[float, str] | None = None,
) -> Iterator[MetricEntry]:
    """Yield the distances of an end from the goal: of positions, of velocities, of both (shown).

    of: prefix of the names; where, subject: of meanings and phrases; needs: of the three.
    """
    for part, groups in zip(("position", "velocity", ""), needs, strict=True):

        def units(scene: Subject, part: str = part) -> tuple[str, ...]:
            parts = ["position"] * scene.nq + ["velocity"] * scene.nq
            states = zip(parts, _states(scene), scene.task.goal, strict=True)
            return tuple(u for of, u, value in states if part in (of, "") and value is not None)

        yield MetricEntry(
            name=f"{of}terminal_{part}{'_' * bool(part)}error",
            question=question if part else Question.SHOWN,
            units=units,
            measure=partial(measures.end_error, of=of, part=part),
            applies=lambda scene, units=units: (
                bool(units(scene)) and (of != "discrete_" or _is_scene(scene))
            ),
            needs=groups,
            default=default if part else None,
            of_replay=of == "replay_",
            limit_of="" if of or not part else f"replay_terminal_{part}_error",
            meaning=f"distance of the {part or 'state'} from the goal {where}",
            quoted=f"{subject} ends {_QUOTED[part]}" if part else "",
        )


_OF_IMPULSE = (
    IMPULSE,
    "1 % of the common contact impulse, at least that of a fiftieth of the plan",
)

TABLE = (
    MetricEntry(
        question=Question.TASK,
        units=_states,
        measure=measures.start_error,
        needs=("q",),
        default=(1e-6, "1e-6 of the nominal, or of the way to the goal if that is shorter"),
        meaning="largest distance of the plan's first state from the task's start",
        quoted="the plan starts {} away from the task's start",
    ),
    MetricEntry(
        question=Question.TASK,
        units=_unit("s"),
        measure=measures.duration_error,
        applies=lambda scene: scene.task.horizon is not None,
        default=(0.5, "half a step of the task, of an FMU a thousandth of its duration"),
        meaning="by how much the plan is longer or shorter than the task",
        quoted="the plan and the task differ in duration by {}",
    ),
    MetricEntry(
        question=Question.TASK,
        units=_inputs,
        measure=measures.bound_violation,
        applies=_bounded(np.any),
        default=(1e-6, "1e-6 of the range, the solvers' own tolerance: the actuators give no more"),
        meaning="by how much the plan's inputs leave their bounds",
        quoted="the inputs leave their bounds by {}",
    ),
    MetricEntry(
        question=Question.TASK,
        units=_velocities,
        measure=measures.velocity_bound_violation,
        applies=_has_velocity_bounds,
        needs=("v",),
        default=(1e-6, "1e-6 of the range, the solvers' own tolerance"),
        meaning="by how much the plan's velocities leave their bounds at the start of a step",
        quoted="the plan's velocities leave their bounds by {}",
    ),
    *_ends("", Question.GOAL, "in the plan", "the plan itself", (("q",), ("v",), ("q",))),
    MetricEntry(
        question=Question.FORCES,
        units=_positions,
        measure=measures.velocity_error,
        needs=("q", "v", "no scheme"),
        limit_of="replay_error",
        default=(REPLAY_ERROR, "1e-2 of the nominal, as the replay may differ from the plan"),
        meaning="largest integral of |v - dq/dt| over a tenth of the plan",
        quoted="its velocities are not those of its positions: they would move it {} elsewhere in a tenth of the plan",
    ),
    MetricEntry(
        question=Question.FORCES,
        units=_unit("N s"),
        measure=measures.contact_law_error,
        applies=lambda scene: _is_scene(scene) and _has_contacts(scene),
        needs=("lam", "q", "no scheme"),
        default=_OF_IMPULSE,
        meaning="impulse by which the planned contact forces miss the true law at the start, the middle or the end of their steps, or in the mean: one of these for the whole plan",
        quoted="its contact forces are not those of its own motion: impulse {} from what the contact law gives",
    ),
    MetricEntry(
        question=Question.FORCES,
        units=_unit("N"),
        measure=measures.contact_force_error,
        applies=lambda scene: _is_scene(scene) and _has_contacts(scene),
        needs=("lam", "q", "no scheme"),
        default=(5e-3, "0.5 % of a typical force: the one under which the scene rests"),
        meaning="largest planned contact force above or below all that the contact law gives within a step of it",
        quoted="a planned contact force is {} from what the contact law gives within a step of it",
    ),
    MetricEntry(
        question=Question.FORCES,
        units=_unit("s"),
        measure=measures.physics_scaled,
        applies=lambda scene: _is_scene(scene) and _has_contacts(scene),
        needs=("lam", "q", "scheme"),
        default=(2e-6, "a thousandth of k L if the gap is just closed, less at a distance"),
        meaning="sum of h |lam (lam - k phi)| / (k L)^2, with L the nominal penetration of the contact: complementarity violation, the same on any grid",
        quoted="its contact forces are not those of contact: complementarity violation {} (scaled)",
    ),
    MetricEntry(
        question=Question.FORCES,
        units=_unit("N"),
        measure=measures.force_sign_violation,
        applies=_has_contacts,
        needs=("lam",),
        default=(1e-6, "1e-6 of a typical force: contact does not pull"),
        meaning="largest planned contact force that pulls",
        quoted="a planned contact force pulls with {}",
    ),
    MetricEntry(
        question=Question.FORCES,
        units=_unit("N"),
        measure=measures.friction_violation,
        applies=_has_friction,
        needs=("friction", "q"),
        default=(1e-4, "1e-4 of mu N of a typical force"),
        meaning="by how much a planned friction force exceeds mu N, with N what the plan itself presses with, or the contact law where it states no contact forces",
        quoted="a planned friction force exceeds mu N by {}",
    ),
    MetricEntry(
        question=Question.FORCES,
        units=_unit("W"),
        measure=measures.friction_dissipation_error,
        applies=_has_friction,
        needs=("friction", "q", "v"),
        default=(1e-4, "1e-4 of mu N of a typical force times the nominal slip: more is creep"),
        meaning="largest mu N |s| + f s in the plan: slip that is not held back by all of mu N, as in creep",
        quoted="it slips without all of mu N holding it back, by {}",
    ),
    MetricEntry(
        question=Question.MOTION,
        units=_positions,
        measure=measures.replay_error,
        needs=("q",),
        of_replay=True,
        default=(REPLAY_ERROR, "1e-2 of the nominal"),
        meaning="largest position difference between plan and replay at the plan's nodes",
        quoted="driven by its inputs the motion departs from the plan by {}",
    ),
    *_ends("replay_", Question.MOTION, "in the replay", "driven by its inputs the motion"),
    MetricEntry(
        question=Question.MOTION,
        measure=measures.replay_cost,
        applies=_is_scene,
        of_replay=True,
        meaning="the task's cost of the replay: the integral of its running cost for each step of the task, and the final cost",
        quoted="driven by its inputs the motion costs {}",
    ),
    MetricEntry(
        question=Question.POSSIBLE,
        units=_unit("m"),
        measure=measures.max_penetration,
        applies=lambda scene: scene.nc > 0 and any(depth is not None for depth in scene.depths),
        of_replay=True,
        default=(1.0, "the depth at which the model of the contact ends"),
        meaning="deepest penetration in the replay, of the contact that is nearest to the depth at which its model ends",
        quoted="the bodies penetrate by {}",
    ),
    MetricEntry(
        question=Question.POSSIBLE,
        units=_unit("N s"),
        measure=measures.ghost_impulse,
        applies=_has_contacts,
        needs=("lam",),
        of_replay=True,
        default=_OF_IMPULSE,
        meaning="impulse of planned contact force that the replay has at no time within a step of it: force at a distance",
        quoted="contact that the replay does not have: impulse {}",
    ),
    MetricEntry(
        question=Question.POSSIBLE,
        units=_unit("N s"),
        measure=measures.missed_impulse,
        applies=_has_contacts,
        needs=("lam",),
        of_replay=True,
        default=_OF_IMPULSE,
        meaning="impulse of the replay's contact force beyond what is planned at any time within a step of it",
        quoted="contact that the plan does not have: impulse {}",
    ),
    MetricEntry(
        question=Question.POSSIBLE,
        units=_unit("N s"),
        measure=measures.friction_impulse_error,
        applies=lambda scene: _is_scene(scene) and _has_friction(scene),
        needs=("friction", "q", "no scheme"),
        of_replay=True,
        default=(
            0.1,
            "a tenth of the replay's friction impulse, at least of a fiftieth of the plan",
        ),
        meaning="impulse of planned friction beyond what the replay has within a step of it, or below",
        quoted="friction that the replay does not have: impulse {}",
    ),
    MetricEntry(
        question=Question.POSSIBLE,
        units=_velocities,
        measure=measures.replay_velocity_bound_violation,
        applies=_has_velocity_bounds,
        of_replay=True,
        default=(1e-2, "1e-2 of the nominal, as the replay may differ from the plan"),
        meaning="by how much the replay's velocities leave their bounds",
        quoted="driven by its inputs the velocities leave their bounds by {}",
    ),
    MetricEntry(
        question=Question.SCHEME,
        units=_states,
        measure=measures.defect,
        applies=_is_scene,
        needs=("q", "v", "lam", "friction", "scheme"),
        default=(DEFECT, "1e-6 of the nominal, the solvers' own tolerance"),
        meaning="largest residual of the plan in its declared scheme, with its own contact forces (a collocation: with those of the true law at its stages)",
        quoted="it does not satisfy its declared scheme (residual {})",
    ),
    MetricEntry(
        question=Question.SCHEME,
        units=_positions,
        measure=measures.law_error,
        applies=_is_scene,
        needs=("q", "v", "scheme"),
        default=(10.0, "ten times what a defect of 1e-6 in every step explains"),
        meaning="largest position difference between the plan and its inputs under the true law on the same grid: the contact law's share of replay_error",
        quoted="with exact contact on its own grid the motion departs from the plan by {}",
    ),
    *_ends(
        "discrete_",
        Question.SCHEME,
        "in the plan's own time step with the true contact law",
        "with exact contact on its own grid the motion",
        (("q", "v", "scheme"), ("q", "v", "scheme"), ("q", "v")),
        (10.0, "the plan's own limit, and ten times what a defect of 1e-6 a step explains"),
    ),
    MetricEntry(
        question=Question.JUDGE,
        measure=measures.answer_error,
        applies=lambda scene: any(answer.measure for answer in scene.answers),
        default=(1.0, "the tolerance of the closed form"),
        meaning="largest distance of the replay from a closed form of the scene, in units of that answer's tolerance",
        quoted="the replay is {} tolerances off a closed form of the scene",
    ),
    MetricEntry(
        question=Question.JUDGE,
        measure=measures.energy_residual_relative,
        applies=_is_scene,
        of_replay=True,
        default=(1e-6, "a replay whose energy does not balance to a millionth is wrong"),
        meaning="energy_residual over the largest energy that is there to be turned over",
        quoted="the replay's energy does not balance by {} of what is turned over",
    ),
    MetricEntry(
        measure=measures.cost,
        applies=_is_scene,
        needs=("q", "v"),
        meaning="the task's cost as methods minimise it: the running cost at the starts of the plan's steps, and the final cost",
    ),
    MetricEntry(
        units=_unit("N^2"),
        measure=measures.physics,
        applies=lambda scene: _is_scene(scene) and _has_contacts(scene),
        needs=("lam", "q"),
        meaning="sum over steps and contacts of |lam (lam - k phi)|, k phi with its damping: the paper's physics",
    ),
)
# Metrics that explain a failure; a plan that holds has none.
EXPLAINING = (
    MetricEntry(
        units=_positions,
        measure=measures.grid_error,
        applies=_is_scene,
        needs=("q", "v", "scheme"),
        meaning="largest position difference between the true law on the plan's grid and in continuous time: the discretisation error",
    ),
    MetricEntry(
        measure=measures.grid_order,
        applies=_is_scene,
        needs=("q", "v", "scheme"),
        meaning="order with which the discretisation error shrinks as the plan's own grid is refined under its inputs",
    ),
)


def _twin(entry: MetricEntry) -> MetricEntry:
    return replace(
        entry, name=f"{TRACKED}{entry.name}", meaning=f"with feedback: {entry.meaning}",
        of_replay=False,
        measure=lambda case: entry.measure(case.tracked),
    )  # fmt: skip


def _effort(case: Evidence) -> Effort:
    replay = case.opened.tracked
    if replay is None or replay.effort is None:
        raise Unmeasured("the replay had no feedback.")
    return replay.effort


def _plan_share(case: Evidence) -> float:
    share = _effort(case).plan_share
    if share is None:
        raise LeavesBounds("the plan's own inputs are zero: all that moves it is the feedback's.")
    return share


# Feedback for exact plans on coarse grids (h w = 0.9) needs up to 0.23 through an impact, for
# other plans some hundredths. Plans with force at a distance need 0.65 to 1.1.
FEEDBACK = (
    MetricEntry(
        name=EFFORT,
        question=Question.MOTION,
        measure=lambda case: _effort(case).rms_share,
        applies=_bounded(np.all),
        default=(FEEDBACK_EFFORT, "a quarter of the inputs' half-range; more makes another plan"),
        meaning="root mean square of what the feedback added to the plan's inputs, as a share of half their range; the largest over the inputs",
        quoted="the RMS effort of the feedback is {} of the half-range of the inputs",
    ),
    MetricEntry(
        name=SHARE,
        question=Question.MOTION,
        measure=_plan_share,
        default=(FEEDBACK_SHARE, "a quarter of the plan's own inputs; more makes another plan"),
        meaning="root mean square of what the feedback added, as a share of that of the plan's own inputs, all inputs in halves of their ranges and averaged over a fiftieth of the plan",
        quoted="the RMS effort of the feedback is {} of what the plan's own inputs do",
    ),
)
FOLLOWED = (*(_twin(entry) for entry in TABLE if entry.of_replay), *FEEDBACK)
