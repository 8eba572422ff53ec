"""RunRecord: the stored result of one run, scene by pipeline.

    record = from_json(RunRecord, path.read_text())  # models.results.stored

Numbers are plain JSON without NaN and infinities. Motions are in the NetCDF files of `stage_files`,
read by reports.traces. Equations are compressed text.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

from models.results.fields import Encoded, Floats, OrInfinite, Result
from models.results.robustness import Survey
from models.results.verdict import TRACKED, Answer, Metric, Question, Verdict

if TYPE_CHECKING:  # a fifth of the time of `show`, which does not need them
    import numpy as np
    from numpy.typing import NDArray

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
SCHEMA_VERSION = 10


@dataclass(frozen=True, kw_only=True)
class QuantityRecord(Result):
    """A named quantity: column name in files, unit, words."""

    name: str
    unit: str
    description: str = ""
    value: float | None = None


@dataclass(frozen=True, kw_only=True)
class ContactRecord(QuantityRecord):
    """A contact with its stiffness; bodies: names of shapes, "" for undrawn ones, as of a joint."""

    bodies: tuple[str, str] = ("", "")


@dataclass(frozen=True, kw_only=True)
class ShapeRecord(Result):
    """A drawn body.

    - place: x, y [m] and angle [rad] of its pose, each a constant, the name of a coordinate, or
      None: a column of the NetCDF files.
    - goal: pose at the goal, angle None if free; None if the place is free, or the body is fixed.
    """

    name: str
    kind: str
    size: tuple[float, ...]
    place: tuple[float | str | None, float | str | None, float | str | None] = (None, None, None)
    goal: tuple[float, float, float | None] | None = None


@dataclass(frozen=True, kw_only=True)
class EquationRecord(Result):
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
Equations = Annotated[tuple[EquationRecord, ...], Encoded(_packed, _unpacked)]

# Caption of the final cost, if a scene has one.
FINAL_COST = "cost of the last state, added to that sum"


@dataclass(frozen=True, kw_only=True)
class SceneRecord(Result):
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
    start: tuple[float, ...]
    goal: tuple[float | None, ...]  # None: free
    step: float
    steps: int
    equations: Equations = ()
    absent: tuple[str, ...] = ()
    answers: tuple[QuantityRecord, ...] = ()
    shapes: tuple[ShapeRecord, ...] = ()
    waived: tuple[str, ...] = ()  # waived limits with reasons
    unstable: str = ""  # why the scene needs feedback
    operations: dict[str, int] = field(
        default_factory=dict
    )  # of the equations of a time step, by kind


@dataclass(frozen=True, kw_only=True)
class Effort(Result):
    """Corrections by feedback.

    - rms, peak: of each input over time, in its unit.
    - rms_share, peak_share: largest over the inputs, of half their range.
    - plan_share: rms of corrections over rms of the plan's inputs, averaged over windows
      (models.trajectory.input_share); None: those inputs are 0.
    - saturated: fraction of steps at a bound because of a correction.
    """

    rms: tuple[float, ...] = ()
    peak: tuple[float, ...] = ()
    rms_share: float = 0.0
    peak_share: float = 0.0
    plan_share: float | None = 0.0
    saturated: float = 0.0


@dataclass(frozen=True, kw_only=True)
class TrackedRecord(Effort):
    """Facts about the replay with feedback; further fields: as in ReplayRecord."""

    error_estimate: float | None
    events: int = 0
    seconds_reference: float = 0.0
    seconds_everyday: float = 0.0
    message: str = ""


@dataclass(frozen=True, kw_only=True)
class ReplayRecord(Result):
    """Facts about the replay of one stage; errors [m or rad]; fmu: hash; judged: of the verdict."""

    error_estimate: float | None
    tolerance_difference: float | None = None  # reference at two tolerances
    step_difference: float | None = None  # everyday replay at two steps
    everyday_difference: float | None = None  # everyday replay against reference
    events: int = 0
    seconds_reference: float = 0.0
    seconds_everyday: float = 0.0
    fmu: str = ""
    message: str = ""
    judged: Literal["open", "feedback"] = "open"
    growth_rate: float | None = None  # of an error without feedback [1/s]
    tracked: TrackedRecord | None = None


@dataclass(frozen=True, kw_only=True)
class Seconds(Result):
    """Wall and CPU seconds of one stage.

    - build: making the model.
    - translate: model -> solver.
    - evaluate: functions and derivatives.
    - linear_algebra: the rest of the solver.
    - wall, cpu: the whole stage.
    - total: wall seconds with earlier stages.
    - replay: replay and scoring.
    """

    build: float = 0.0
    translate: float = 0.0
    evaluate: float = 0.0
    linear_algebra: float = 0.0
    wall: float = 0.0
    cpu: float = 0.0
    total: float = 0.0
    replay: float = 0.0

    def __add__(self, other: Seconds) -> Seconds:
        return Seconds(**{name: value + getattr(other, name) for name, value in vars(self).items()})

    @property
    def solve(self) -> float:
        """Return the seconds in the solver."""
        return self.evaluate + self.linear_algebra


@dataclass(frozen=True, kw_only=True)
class CertificateRecord(Result):
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
    primal: float | None
    worst: str = ""
    complementarity: float | None
    dual: float | None
    strong: bool
    obstacle: str = ""
    pairs: int
    biactive: int
    b_stationary: bool | None = None
    sentence: str


@dataclass(frozen=True, kw_only=True)
class ModelSize(Result):
    """Unknowns and equations (without bounds) of a solver's model."""

    unknowns: int
    equations: int


@dataclass(frozen=True, kw_only=True)
class StageRecord(Result):
    """One stage of a pipeline: one method at one eps."""

    index: int
    method: str
    method_title: str
    kind: Literal["indirect", "direct", "given"]  # given: an external plan
    eps: float | None
    outcome: str  # name of the Outcome, lower case
    advice: str  # its sentence
    message: str = ""
    cost: float | None = None
    iterations: int = 0
    solver: str = ""  # name and version of the solver
    residuals: dict[str, float] = field(default_factory=dict)
    size: ModelSize | None = None
    paper_size: ModelSize | None = None  # counted by hand
    options: dict[str, str | int | bool | float | list[float] | None] = field(default_factory=dict)
    history: dict[str, Floats] = field(default_factory=dict)
    certificate: CertificateRecord | None = None
    certificate_missing: bool = False  # the run ended before
    seconds: Seconds = field(default_factory=Seconds)
    metrics: tuple[Metric, ...] = ()
    verdict: Verdict = Verdict.NO_PLAN
    why: str = ""
    # The same in one word: the failing or undecided metric, or the cause.
    cause: str = ""
    questions: tuple[tuple[Question, Answer], ...] = ()
    not_asked: tuple[str, ...] = ()
    replay: ReplayRecord | None = None
    survey: Survey | None = None  # None if not selected
    has_plan: bool = False  # whether the files of a plan exist
    paper: dict[str, float] = field(
        default_factory=dict
    )  # the paper's numbers: cost, stability, physics, time
    # The pipeline whose run solved this stage, if another.
    shared_from: str = ""

    def metric(self, name: str) -> Metric | None:
        """Return the metric of this name, None if not measured."""
        return next((metric for metric in self.metrics if metric.name == name), None)

    def judged(self, name: str) -> Metric | None:
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


@dataclass(frozen=True, kw_only=True)
class LegRecord(Result):
    """Result of a leg (validate.tasks.leg).

    - pipeline: of the run that made it.
    - stages: as if alone.
    - files: SHA-256 by name.
    - limit [s]: of the run, if it timed out.
    - profile [s]: of that run so far.
    """

    key: str
    pipeline: str
    stages: tuple[StageRecord, ...]
    files: dict[str, str]
    limit: float | None = None
    profile: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if [stage.index for stage in self.stages] != list(range(len(self.stages))):
            raise ValueError("its stages are not in order")
        if not self.stages:
            raise ValueError("it has no stages")


@dataclass(frozen=True, kw_only=True)
class ProvenanceRecord(Result):
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


@dataclass(frozen=True, kw_only=True)
class RunRecord(Result):
    """One run: a scene by a pipeline."""

    schema_version: Literal[10] = SCHEMA_VERSION
    key: str
    scene: SceneRecord
    pipeline: str
    pipeline_title: str
    stages: tuple[StageRecord, ...]
    outcome: str  # of its last stage, or crashed / time_limit / refused
    message: str = ""
    verdict: Verdict = Verdict.NO_PLAN  # of the last stage
    # Instance of a campaign of foreign plans; empty for other campaigns.
    instance: str = ""
    # The physics, or the plan's own equations.
    judged_by: Literal["", "scene", "model"] = ""
    # The last stage is direct: if it is `solved`, its plan must hold (reports.rule).
    must_hold: bool
    wall_seconds: float
    cpu_seconds: float
    profile: dict[str, float] = field(
        default_factory=dict
    )  # wall seconds by phase, whose sum is wall_seconds; empty without an answer
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
        return sum(stage.seconds.cpu for stage in self.stages)


@dataclass(frozen=True, kw_only=True)
class ViolationPoint(Result):
    """Worst violation D = max over phi of lam*(lam - k*phi) at eps (Fig. 2 of the paper) [N^2]."""

    law: str  # "softplus" or "relaxed_lcp"
    eps: float
    measured: float
    closed_form: float


@dataclass(frozen=True, kw_only=True)
class StepStability(Result):
    """Stability of a time step while contacts are closed.

    - step: [s].
    - radius: spectral radius of the step's Jacobian, for the worst set of contacts.
    - contacts: names of that set.
    - growth: growth rate of the motion itself there [1/s], or 0.
    - largest_step: limit of stable steps [s], may be infinite.
    """

    scene: str
    step: float
    radius: float
    contacts: tuple[str, ...]
    growth: float
    largest_step: OrInfinite

    @property
    def is_stable(self) -> bool:
        """Return whether the step is below the largest stable one."""
        return self.step < self.largest_step

    @property
    def sentence(self) -> str:
        """Return a warning for the user, or ""."""
        if self.is_stable:
            return ""
        closed = " and ".join(self.contacts) or "no contact"
        return (
            f"scene {self.scene}: with {closed} closed, a step of {self.step:g} s lies past the stability limit of semi-implicit Euler "
            f"(spectral radius {self.radius:.4g}); plans of this grid blow up in contact: take a step below {self.largest_step:.3g} s, or softer contact."
        )


@dataclass(frozen=True, kw_only=True)
class TimeStepRecord(StepStability):
    """Stability of the time step of a planned scene; digest: of the scene."""

    digest: str


@dataclass(frozen=True, kw_only=True)
class CampaignRecord(Result):
    """The campaign as a whole, stored as DIR/campaign.json."""

    schema_version: Literal[10] = SCHEMA_VERSION
    title: str
    command: str
    started: str
    quick: bool = False
    left_out: tuple[str, ...] = ()  # parts that a quick campaign omits
    keys: tuple[str, ...]  # of the runs, in order
    violation: tuple[ViolationPoint, ...] = ()
    time_steps: tuple[TimeStepRecord, ...] = ()  # of the planned scenes
    provenance: ProvenanceRecord
