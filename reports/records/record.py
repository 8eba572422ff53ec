"""RunRecord: the stored result of one run, scene by pipeline.

    record = RunRecord.model_validate_json(path.read_text())

Numbers are plain JSON without NaN and infinities. Motions are in the NetCDF files of `stage_files`,
read by reports.traces. Columns of iteration histories are base64 of little-endian float64, read ten
times as fast as digits and a third as long; lists are accepted too. Equations are compressed text.
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

from reports.names import FEEDBACK as FEEDBACK
from reports.names import HOLD as HOLD
from reports.names import TRACKED as TRACKED

if TYPE_CHECKING:  # a fifth of the time of `show`, which does not need them
    import numpy as np
    from numpy.typing import NDArray

Finite = Annotated[float, Field(allow_inf_nan=False)]


def _in_order(numbers: array[float]) -> array[float]:
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


def _text(values: Sequence[Any]) -> str:
    return base64.b64encode(_in_order(array("d", values)).tobytes()).decode("ascii")


def _floats(value: Any) -> Any:
    """Return the numbers of a text, or the value; raise ValueError for an invalid text."""
    return (
        tuple(_in_order(array("d", base64.b64decode(value, validate=True))))
        if isinstance(value, str)
        else value
    )


_written = PlainSerializer(_text, return_type=str, when_used="json")
Floats = Annotated[tuple[FiniteFloat, ...], BeforeValidator(_floats), _written]

# Largest number of points that a plot can show.
LONGEST = 1500
# Width of the plot of an iteration history [pixel].
LONGEST_HISTORY = 340
_FILES = ("trajectory", "replay", "tracked")


def thin(points: int, longest: int = LONGEST) -> NDArray[np.int64]:
    """Return at most `longest` even indices (k,) [-] of points, first and last included.

    Raises nothing.
    """
    import numpy as np

    return np.unique(np.linspace(0, points - 1, min(points, longest)).round().astype(int))


def stage_files(index: int, stages: int) -> dict[str, str]:
    """Return the files of stage `index` (from 0) by content; the last stage has no number."""
    ending = "" if index == stages - 1 else f"_{index + 1}"
    return {what: f"{what}{ending}.nc" for what in _FILES}


# Residual of a plan from a file: its largest miss of its own time step, over the allowed miss.
OWN_STEP = "own_time_step"

# Increment on every change of a stored field; stores of other versions are refused.
SCHEMA_VERSION = 9

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
    """A stored, immutable record without unknown fields."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class QuantityRecord(Model):
    """A named quantity: column name in files, unit, words."""

    name: str
    unit: str
    description: str = ""
    value: Finite | None = None


class ContactRecord(QuantityRecord):
    """A contact with its stiffness; bodies: names of shapes, "" for undrawn ones, as of a joint."""

    bodies: tuple[str, str] = ("", "")


class ShapeRecord(Model):
    """A drawn body.

    - place: x, y [m] and angle [rad] of its pose, each a constant, the name of a coordinate, or
      None: a column of the NetCDF files.
    - goal: pose at the goal, angle None if free; None if the place is free, or the body is fixed.
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


# Base64 of compressed text: a fifth of the MathML, a third of a record otherwise.
Equations = Annotated[
    tuple[EquationRecord, ...],
    BeforeValidator(_unpacked),
    PlainSerializer(_packed, return_type=str, when_used="json"),
]

# Caption of the final cost, if a scene has one.
FINAL_COST = "cost of the last state, added to that sum"


class SceneRecord(Model):
    """A scene as planned for: quantities, task, equations and shapes."""

    name: str
    title: str
    source: str
    coordinates: tuple[QuantityRecord, ...]
    velocities: tuple[QuantityRecord, ...]
    inputs: tuple[QuantityRecord, ...]
    contacts: tuple[ContactRecord, ...]
    frictions: tuple[QuantityRecord, ...] = ()  # by names of forces; values are coefficients
    parameters: tuple[QuantityRecord, ...]
    start: tuple[Finite, ...]
    goal: tuple[Finite | None, ...]  # None: free
    step: Finite
    steps: int
    equations: Equations = ()
    absent: tuple[str, ...] = ()
    answers: tuple[QuantityRecord, ...] = ()
    shapes: tuple[ShapeRecord, ...] = ()
    waived: tuple[str, ...] = ()  # waived limits with reasons
    unstable: str = ""  # why the scene needs feedback
    operations: dict[str, int] = {}  # of the equations of a time step, by kind


class MetricRecord(Model):
    """One metric of the score, or one figure of a check.

    - value: None if not measured, with `reason`.
    - question: 1 to 6, None for the judge's and shown ones.
    - error: by the replay's error, None: unknown.
    - ok: None without a limit, or undecided.
    - default: the limit is the metric's own.
    - at_least: a lower limit.
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

    - rms, peak: corrections of each input, in its unit.
    - rms_share, peak_share: largest over the inputs, of half their range.
    - plan_share: of the plan's inputs (None: those are 0).
    - saturated: share of steps at a bound.
    - Further fields: as in ReplayRecord.
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
    """Facts about the replay of one stage; errors [m or rad]; fmu: hash; judged: of the verdict."""

    error_estimate: Finite | None
    tolerance_difference: Finite | None = None  # reference at two tolerances
    step_difference: Finite | None = None  # everyday replay at two steps
    everyday_difference: Finite | None = None  # everyday replay against reference
    events: int = 0
    seconds_reference: Finite = 0.0
    seconds_everyday: Finite = 0.0
    fmu: str = ""
    message: str = ""
    judged: Literal["open", "feedback"] = "open"
    growth_rate: Finite | None = None  # of an error without feedback [1/s]
    tracked: TrackedRecord | None = None


class SecondsRecord(Model):
    """Seconds of one stage; `total` includes earlier stages, `replay` is replay and scoring."""

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
    """A plan judged in the strict Pyomo model of its scene, without its method's multipliers.

    - primal: largest violation [units of the scene], of constraint `worst`.
    - complementarity: largest min(lam, lam - k phi) [N].
    - dual: remaining gradient (relative; None: unknown).
    - biactive: of `pairs`.
    - strong: S-stationary, else `obstacle`.
    - b_stationary: no first-order descent, None: unknown.

    All values are unscaled.
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
    """Unknowns and equations of the solver's model, and of the paper's."""

    unknowns: int
    equations: int
    paper_unknowns: int
    paper_equations: int


class FoundRecord(BaseModel):
    """A record from an object of validate.judge.robustness, by equal-named fields."""

    model_config = ConfigDict(extra="ignore", frozen=True, from_attributes=True)


class ShareRecord(FoundRecord):
    """Number of perturbed worlds in which a plan arrives, with Wilson's 95 % interval."""

    arrived: int
    samples: int
    share: Finite
    interval: tuple[Finite, Finite]

    @property
    def words(self) -> str:
        """Return `71.5 % (68.6 to 74.2 %) of 1,000 worlds`."""
        if not self.samples:
            return "none, as no world was tried"
        low, high = self.interval
        return f"{100 * self.share:.1f} % ({100 * low:.1f} to {100 * high:.1f} %) of {self.samples:,} worlds"


class SurveyRecord(Model):
    """Robustness of a plan that holds (validate.judge.robustness.robustness.survey).

    - checked, differ: worlds repeated by the reference, and those that differ.
    - weakest: perturbation tolerated least, its amount [unit] and failing metric.
    - message: why not tried.
    - sources: digest of the code.
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
    kind: Literal["indirect", "direct", "given"]  # given: an external plan
    eps: Finite | None
    outcome: str  # name of the Outcome, lower case
    advice: str  # its sentence
    message: str = ""
    cost: Finite | None = None
    iterations: int = 0
    solver: str = ""  # name and version of the solver
    residuals: dict[str, Finite] = {}
    size: SizeRecord | None = None
    options: dict[str, str | int | bool | Finite | list[Finite] | None] = {}
    history: dict[str, Floats] = {}
    certificate: CertificateRecord | None = None
    certificate_missing: bool = False  # the run ended before
    seconds: SecondsRecord = SecondsRecord()
    metrics: tuple[MetricRecord, ...] = ()
    verdict: Verdict = "no plan"
    why: str = ""
    # The same in one word: the failing or undecided metric, or the cause.
    cause: str = ""
    questions: tuple[QuestionRecord, ...] = ()
    not_asked: tuple[str, ...] = ()
    replay: ReplayRecord | None = None
    survey: SurveyRecord | None = None  # None if not selected
    has_plan: bool = False  # whether the files of a plan exist
    paper: dict[str, Finite] = {}  # the paper's numbers: cost, stability, physics, time
    # The pipeline whose run solved this stage, if another.
    shared_from: str = ""

    def metric(self, name: str) -> MetricRecord | None:
        """Return the metric of this name, None if not measured."""
        return next((metric for metric in self.metrics if metric.name == name), None)

    def judged(self, name: str) -> MetricRecord | None:
        """Return a metric, of the judged replay if there are two."""
        return (self.metric(f"{TRACKED}{name}") if self.is_tracked else None) or self.metric(name)

    @property
    def is_followed(self) -> bool:
        """Return whether there is a replay with feedback."""
        return self.replay is not None and self.replay.tracked is not None

    @property
    def is_tracked(self) -> bool:
        """Return whether the verdict is by the replay with feedback."""
        return self.replay is not None and self.replay.judged == "feedback"

    @property
    def is_empty(self) -> bool:
        """Return whether there is nothing to draw or score."""
        return not (self.metrics or self.replay or self.has_plan)


class LegRecord(Model):
    """Result of a leg (validate.tasks.leg).

    - pipeline: of the run that made it.
    - stages: as if alone.
    - files: SHA-256 by name.
    - limit [s]: of the run, if it timed out.
    - profile [s]: of that run so far.
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
    """Origin of a record."""

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

    schema_version: Literal[9] = SCHEMA_VERSION
    key: str
    scene: SceneRecord
    pipeline: str
    pipeline_title: str
    stages: tuple[StageRecord, ...]
    outcome: str  # of its last stage, or crashed / time_limit / refused
    message: str = ""
    verdict: Verdict = "no plan"  # of the last stage
    # Instance of a campaign of foreign plans; empty for other campaigns.
    instance: str = ""
    # The physics, or the plan's own equations.
    judged_by: Literal["", "scene", "model"] = ""
    # The last stage is direct: if it is `solved`, its plan must hold (reports.rule).
    must_hold: bool
    wall_seconds: Finite
    cpu_seconds: Finite
    profile: dict[
        str, Finite
    ] = {}  # wall seconds by phase, whose sum is wall_seconds; empty without an answer
    provenance: ProvenanceRecord
    log_tail: str = ""

    @property
    def title(self) -> str:
        """Return scene and pipeline, as in campaigns and `show`."""
        return f"{self.scene.name} x {self.pipeline}"

    @property
    def last(self) -> StageRecord | None:
        """Return the last stage, which decides the run, if there is one."""
        return self.stages[-1] if self.stages else None

    @property
    def cost(self) -> float | None:
        """Return the cost of the last stage, if there is one."""
        return self.last.cost if self.last else None

    @property
    def integral_cost(self) -> float | None:
        """Return the cost times the time step, independent of the grid; None with a final cost."""
        ends = any(equation.caption == FINAL_COST for equation in self.scene.equations)
        return None if self.cost is None or ends else self.cost * self.scene.step

    @property
    def solving_cpu(self) -> float:
        """Return the CPU seconds [s] of solving all stages, wherever they ran."""
        return sum(stage.seconds.stage_cpu for stage in self.stages)


class ViolationPoint(Model):
    """Worst violation D = max over phi of lam*(lam - k*phi) at eps (Fig. 2 of the paper) [N^2]."""

    law: str  # "softplus" or "relaxed_lcp"
    eps: Finite
    measured: Finite
    closed_form: Finite


class TimeStepRecord(Model):
    """Stability of a scene's time step with closed contacts.

    - radius: spectral radius of the step's Jacobian.
    - growth [1/s]: of the motion itself.
    - largest_step [s]: stable below with any contacts (None: always).
    - warning: "" if stable.
    - digest: of the scene.
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
    """The campaign as a whole, stored as DIR/campaign.json."""

    schema_version: Literal[9] = SCHEMA_VERSION
    title: str
    command: str
    started: str
    quick: bool = False
    left_out: tuple[str, ...] = ()  # parts that a quick campaign omits
    keys: tuple[str, ...]  # of the runs, in order
    violation: tuple[ViolationPoint, ...] = ()
    time_steps: tuple[TimeStepRecord, ...] = ()  # of the planned scenes
    provenance: ProvenanceRecord
