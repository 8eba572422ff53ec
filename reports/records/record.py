"""RunRecord: what is stored of one run (scene x pipeline), and the numbers that the report knows.

    record = RunRecord.model_validate_json(path.read_text())

Numbers are plain JSON: NaN and infinities are refused when written and when read. Motions do not
live here but in the NetCDF files beside the record, which `stage_files` names and reports.traces
reads; of arrays a record has the columns of an iteration history alone, `thin` as plots show them.

Such columns are tuples in memory and in JSON the base64 of their bytes (float64, little-endian):
read ten times as fast as digits, and a third as long. A list of numbers is read as well. The
equations of a scene are compressed text there.
"""

from __future__ import annotations

import base64
import json
import sys
import zlib
from array import array
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    PlainSerializer,
    model_validator,
)

from reports.wording import FEEDBACK as FEEDBACK
from reports.wording import HOLD as HOLD
from reports.wording import TRACKED as TRACKED

if TYPE_CHECKING:  # a fifth of `show`, which needs no more of it
    import numpy as np
    from numpy.typing import NDArray

Finite = Annotated[float, Field(allow_inf_nan=False)]


def _in_order(numbers: array[float]) -> array[float]:
    """Of a machine with its bytes in the other order, as they are stored, and back."""
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


def _text(values: Sequence[Any]) -> str:
    return base64.b64encode(_in_order(array("d", values)).tobytes()).decode("ascii")


def _floats(value: Any) -> Any:
    """The numbers of a text, which raises ValueError where it holds none.

    Anything else as it is.
    """
    return (
        tuple(_in_order(array("d", base64.b64decode(value, validate=True))))
        if isinstance(value, str)
        else value
    )


_written = PlainSerializer(_text, return_type=str, when_used="json")
Floats = Annotated[tuple[FiniteFloat, ...], BeforeValidator(_floats), _written]

# More points than this no plot can show.
LONGEST = 1500
# Width of the plot of an iteration history [pixel].
LONGEST_HISTORY = 340
# What the files of a stage hold.
_FILES = ("trajectory", "replay", "tracked")


def thin(points: int, longest: int = LONGEST) -> NDArray[np.int64]:
    """Indices of at most `longest` of `points` points, evenly spread, with the first and the last.

    Returns
    -------
    indices : (min(points, longest),) [-], increasing
    """
    import numpy as np

    return np.unique(np.linspace(0, points - 1, min(points, longest)).round().astype(int))


def stage_files(index: int, stages: int) -> dict[str, str]:
    """The files of stage `index` (from 0) of a run of so many stages, by what they hold.

    Those of the last stage have no number.
    """
    ending = "" if index == stages - 1 else f"_{index + 1}"
    return {what: f"{what}{ending}.nc" for what in _FILES}


# Increment it with every change of a stored field: a store of another version is refused.
SCHEMA_VERSION = 8

Verdict = Literal[
    "holds",
    "holds with feedback",
    "violates",
    "undecided",
    "no plan",
    "not applicable",
    "consistent",
]


class Model(BaseModel):
    """Stored: without unknown fields, and never changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class QuantityRecord(Model):
    """A named quantity: column name in files, unit, words."""

    name: str
    unit: str
    description: str = ""
    value: Finite | None = None


class ContactRecord(QuantityRecord):
    """A contact.

    The value is its stiffness. bodies: the two it acts between, by the names of their shapes; what
    has none, as a joint, is not drawn.
    """

    bodies: tuple[str, str] = ("", "")


class ShapeRecord(Model):
    """How a body is drawn.

    place: x, y [m] and angle [rad] of its pose: a number that never changes, the name of a
        coordinate, or None: a column of the NetCDF files, by the shape's number.
    goal: x, y [m] and angle [rad] at the goal, the angle None where the goal leaves it open; None
        where it leaves the place open, or the body never moves.
    """

    name: str
    kind: str
    size: tuple[Finite, ...]
    place: tuple[Finite | str | None, Finite | str | None, Finite | str | None] = (None, None, None)
    goal: tuple[Finite, Finite, Finite | None] | None = None


class EquationRecord(Model):
    """One equation of the scene as presentation MathML, with a caption."""

    caption: str
    mathml: str


def _packed(equations: Sequence[EquationRecord]) -> str:
    text = json.dumps([[item.caption, item.mathml] for item in equations])
    return base64.b64encode(zlib.compress(text.encode())).decode("ascii")


def _unpacked(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    try:
        text = zlib.decompress(base64.b64decode(value, validate=True))
        return [{"caption": caption, "mathml": mathml} for caption, mathml in json.loads(text)]
    except (zlib.error, TypeError, RecursionError) as error:
        raise ValueError("the equations are damaged") from error


# In JSON the base64 of compressed text: a fifth of the MathML, which would be a third of a record.
Equations = Annotated[
    tuple[EquationRecord, ...],
    BeforeValidator(_unpacked),
    PlainSerializer(_packed, return_type=str, when_used="json"),
]

# Caption of the equation that a scene has whose cost is not of its steps alone.
FINAL_COST = "cost of the last state, added to that sum"


class SceneRecord(Model):
    """A scene as it was planned for: its quantities, task, equations and shapes."""

    name: str
    title: str
    source: str
    coordinates: tuple[QuantityRecord, ...]
    velocities: tuple[QuantityRecord, ...]
    inputs: tuple[QuantityRecord, ...]
    contacts: tuple[ContactRecord, ...]
    frictions: tuple[
        QuantityRecord, ...
    ] = ()  # by the names of their forces; the value is the coefficient
    parameters: tuple[QuantityRecord, ...]
    start: tuple[Finite, ...]
    goal: tuple[Finite | None, ...]  # None: this component of the end is free
    step: Finite
    steps: int
    equations: Equations = ()
    absent: tuple[str, ...] = ()
    answers: tuple[QuantityRecord, ...] = ()
    shapes: tuple[ShapeRecord, ...] = ()
    waived: tuple[str, ...] = ()  # limits that the scene waives, with its reasons
    unstable: str = ""  # why feedback belongs to this scene
    operations: dict[str, int] = {}  # of the equations one time step evaluates, by kind


class MetricRecord(Model):
    """One metric of the score, or one figure of a check.

    `value` is None where it was not asked or not measured (`reason` says why).

    question: 1 to 6, None for what is of the judge or only shown; error: how wrong the value may be
        by the replay's own error, None: not known;
    ok: None where there is no limit, or the error leaves it open; default: whether the limit is the
        metric's own, not the scene's; at_least: the limit is one from below.
    """

    name: str
    value: Finite | None
    unit: str
    meaning: str
    question: int | None = None
    error: Finite | None = 0.0
    limit: Finite | None = None
    reason: str = ""
    ok: bool | None = None
    default: bool = False
    at_least: bool = False


class TrackedRecord(Model):
    """Facts about the replay with feedback.

    rms, peak: what the feedback added to the plan's inputs, of each input in its unit; rms_share,
        peak_share: the largest over the inputs as a share of
    half the input's range; plan_share: of all, as a share of what the plan's own inputs do (None:
        those are 0); saturated: share of the steps at a bound by the
    feedback; the rest as in ReplayRecord.
    """

    error_estimate: Finite | None
    events: int = 0
    seconds_reference: Finite = 0.0
    seconds_everyday: Finite = 0.0
    message: str = ""
    rms: tuple[Finite, ...] = ()
    peak: tuple[Finite, ...] = ()
    rms_share: Finite = 0.0
    peak_share: Finite = 0.0
    plan_share: Finite | None = 0.0
    saturated: Finite = 0.0


class ReplayRecord(Model):
    """Facts about the replay of one stage: the error estimate [m or rad] and what it is made of, seconds, FMU hash; judged: or the tracked one."""

    error_estimate: Finite | None
    tolerance_difference: Finite | None = None  # reference at two tolerances
    step_difference: Finite | None = None  # everyday replay at two steps
    everyday_difference: Finite | None = None  # everyday against reference
    events: int = 0
    seconds_reference: Finite = 0.0
    seconds_everyday: Finite = 0.0
    fmu: str = ""
    message: str = ""
    judged: Literal["open", "feedback"] = "open"
    growth_rate: Finite | None = None  # of an error in the open loop [1/s]
    tracked: TrackedRecord | None = None


class SecondsRecord(Model):
    """Seconds of one stage.

    `total` counts the stages before it, `replay` the replay and scoring.
    """

    build: Finite = 0.0
    translate: Finite = 0.0
    evaluate: Finite = 0.0
    linear_algebra: Finite = 0.0
    solve: Finite = 0.0
    stage: Finite = 0.0
    stage_cpu: Finite = 0.0
    total: Finite = 0.0
    replay: Finite = 0.0


class CertificateRecord(Model):
    """A plan judged in the strict Pyomo model of its scene, without the multipliers of its method.

    All residuals unscaled.

    primal: largest violation [units of the scene], worst: of which constraint
    complementarity: largest min(lam, lam - k phi) [N]
    dual: part of the gradient that the multipliers leave (relative; None if it is not known)
    biactive: pairs with both sides zero, of `pairs`
    strong: whether the plan is S-stationary; if not, `obstacle` is what prevents it
    b_stationary: whether no direction goes down to first order; None if that is not known
    """

    holds: bool
    feasible: bool
    primal: Finite | None
    worst: str = ""
    complementarity: Finite | None
    dual: Finite | None
    strong: bool
    obstacle: str = ""
    pairs: int
    biactive: int
    b_stationary: bool | None = None
    sentence: str


class SizeRecord(Model):
    """Unknowns and equations of the model a solver was given, and the same counted on paper."""

    unknowns: int
    equations: int
    paper_unknowns: int
    paper_equations: int


class FoundRecord(BaseModel):
    """Made of what validate.judge.robustness found, of which it takes what it has a field for."""

    model_config = ConfigDict(extra="ignore", frozen=True, from_attributes=True)


class ShareRecord(FoundRecord):
    """In how many of the perturbed worlds a plan arrives; interval: Wilson's, of 95 %."""

    arrived: int
    samples: int
    share: Finite
    interval: tuple[Finite, Finite]

    @property
    def words(self) -> str:
        """71.5 % (68.6 to 74.2 %) of 1,000 worlds."""
        if not self.samples:
            return "none, as no world was tried"
        low, high = self.interval
        return f"{100 * self.share:.1f} % ({100 * low:.1f} to {100 * high:.1f} %) of {self.samples:,} worlds"


class SurveyRecord(Model):
    """How a plan that holds fares in perturbed worlds (validate.judge.robustness.robustness.survey).

    alone, feedback: how many worlds it arrives in; checked, differ: worlds that the reference was
        asked about too, and in how many it says otherwise; weakest:
    of which perturbation by itself it takes the fewest sizes, how far [unit], and by what it fails
        there; message: why it was not tried; sources: digest of the code that made it.
    """

    alone: ShareRecord | None = None
    feedback: ShareRecord | None = None
    checked: int = 0
    differ: int = 0
    weakest: str = ""
    sizes: Finite | None = None
    amount: Finite | None = None
    unit: str = ""
    by: str = ""
    message: str = ""
    sources: str = ""


class QuestionRecord(Model):
    """One question of the judge, and its answer."""

    number: int | None  # None: whether the judge is well
    text: str
    answer: Literal["yes", "no", "undecided", "not asked"]


class StageRecord(Model):
    """One stage of a pipeline: one method at one eps."""

    index: int
    method: str
    method_title: str
    kind: Literal[
        "indirect", "direct", "given"
    ]  # given: somebody's plan, which no method of ours found
    eps: Finite | None
    outcome: str  # name of the Outcome, lower case
    advice: str  # its sentence
    message: str = ""
    cost: Finite | None = None
    iterations: int = 0
    solver: str = ""  # name and version of what ran underneath
    residuals: dict[str, Finite] = {}
    size: SizeRecord | None = None
    options: dict[str, str | int | bool | Finite | list[Finite] | None] = {}
    history: dict[str, Floats] = {}
    certificate: CertificateRecord | None = None
    certificate_missing: bool = False  # the run ended while it was made
    seconds: SecondsRecord = SecondsRecord()
    metrics: tuple[MetricRecord, ...] = ()
    verdict: Verdict = "no plan"
    why: str = ""
    # the same in one word: the metric that failed or is open, or why the inputs do not give the
    # motion
    cause: str = ""
    questions: tuple[QuestionRecord, ...] = ()
    not_asked: tuple[str, ...] = ()
    replay: ReplayRecord | None = None
    survey: SurveyRecord | None = None  # None if the plan was not selected for it
    has_plan: bool = False  # whether a plan came back: the files of the stage are there
    paper: dict[
        str, Finite
    ] = {}  # the paper's numbers for this row: cost, stability, physics, time
    # the pipeline in whose run this stage ran, where that was another: its seconds were spent there
    shared_from: str = ""

    def metric(self, name: str) -> MetricRecord | None:
        """The metric of this name; None where it was not measured."""
        return next((metric for metric in self.metrics if metric.name == name), None)

    def judged(self, name: str) -> MetricRecord | None:
        """A metric; where it is of a replay, that of the replay which is judged."""
        return (self.metric(f"{TRACKED}{name}") if self.is_tracked else None) or self.metric(name)

    @property
    def is_followed(self) -> bool:
        """Whether there is a replay with feedback."""
        return self.replay is not None and self.replay.tracked is not None

    @property
    def is_tracked(self) -> bool:
        """Whether the verdict is of the replay with feedback."""
        return self.replay is not None and self.replay.judged == "feedback"

    @property
    def is_empty(self) -> bool:
        """Whether it left nothing to draw or to score: the reason stands in its sentence."""
        return not (self.metrics or self.replay or self.has_plan)


class LegRecord(Model):
    """What a leg found (validate.tasks.leg).

    pipeline: in whose run it was made; stages: as if there were no other legs; files: SHA-256 of
        its files by name; limit [s]: of the run whose time it
    used up, if it did; profile [s]: where the time of that run had gone when this was written.
    """

    key: str
    pipeline: str
    stages: tuple[StageRecord, ...] = Field(min_length=1)
    files: dict[str, str]
    limit: Finite | None = None
    profile: dict[str, Finite] = {}

    @model_validator(mode="after")
    def _has_its_stages_in_order(self) -> Self:
        if [stage.index for stage in self.stages] != list(range(len(self.stages))):
            raise ValueError("its stages are not in order")
        return self


class ProvenanceRecord(Model):
    """Where a record came from."""

    touchstone: str
    commit: str
    python: str
    platform: str
    cpu: str
    cores: int
    threads: int
    packages: dict[str, str]
    compiler: str
    seed: int
    started: str  # ISO 8601 UTC
    command: str


class RunRecord(Model):
    """One run: a scene by a pipeline."""

    schema_version: Literal[8] = SCHEMA_VERSION
    key: str
    scene: SceneRecord
    pipeline: str
    pipeline_title: str
    stages: tuple[StageRecord, ...]
    outcome: str  # of the run: that of its last stage, or crashed / time_limit / refused
    message: str = ""
    verdict: Verdict = "no plan"  # of the last stage
    # the last stage is a direct method: where it says `solved`, its plan must hold (reports.rule)
    must_hold: bool
    wall_seconds: Finite
    cpu_seconds: Finite
    profile: dict[
        str, Finite
    ] = {}  # wall seconds by phase, in order; their sum is wall_seconds; empty where the run left no answer
    provenance: ProvenanceRecord
    log_tail: str = ""

    @property
    def title(self) -> str:
        """Scene and pipeline, by which the campaign and `show` know it."""
        return f"{self.scene.name} x {self.pipeline}"

    @property
    def last(self) -> StageRecord | None:
        """The last stage, by which the run is judged; None where there is none."""
        return self.stages[-1] if self.stages else None

    @property
    def cost(self) -> float | None:
        """What the plan costs that the run is judged by; None where there is none."""
        return self.last.cost if self.last else None

    @property
    def integral_cost(self) -> float | None:
        """That cost times the time step, which does not depend on the grid as a sum over steps does; None where the last state is in the cost."""
        ends = any(equation.caption == FINAL_COST for equation in self.scene.equations)
        return None if self.cost is None or ends else self.cost * self.scene.step

    @property
    def solving_cpu(self) -> float:
        """CPU seconds [s] of solving, over all stages, wherever they ran."""
        return sum(stage.seconds.stage_cpu for stage in self.stages)


class ViolationPoint(Model):
    """Worst-case violation D of a relaxation at eps (Fig. 2 of the paper) [N^2].

    D = max over phi of lam*(lam - k*phi).
    """

    law: str  # "softplus" or "relaxed_lcp"
    eps: Finite
    measured: Finite
    closed_form: Finite


class TimeStepRecord(Model):
    """Whether the time step of a scene is stable while contacts are closed, found out before anything ran.

    radius: spectral radius of the step's Jacobian with these contacts closed; growth [1/s] of the
        motion itself there; largest_step [s]: below it the step is stable with every set of
        contacts (None: always); warning: a sentence, empty where it is stable; digest:
    of the scene, so that it is looked at once.
    """

    scene: str
    digest: str
    step: Finite
    radius: Finite
    contacts: tuple[str, ...]
    growth: Finite
    largest_step: Finite | None
    warning: str = ""


class CampaignRecord(Model):
    """What belongs to the campaign as a whole; stored as DIR/campaign.json."""

    schema_version: Literal[8] = SCHEMA_VERSION
    title: str
    command: str
    started: str
    quick: bool = False
    left_out: tuple[str, ...] = ()  # what a quick campaign did not run, in words
    keys: tuple[str, ...]  # of the runs, in order
    violation: tuple[ViolationPoint, ...] = ()
    time_steps: tuple[TimeStepRecord, ...] = ()  # of the scenes planned for
    provenance: ProvenanceRecord
