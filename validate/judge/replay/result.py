"""What a replay hands back: the true motion under the plan's inputs, and how far it can be trusted.

And what each of its simulations recorded.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np

from validate.judge.replay.wiring import Effort, Feedback

if TYPE_CHECKING:
    from fmpy.fmi1 import FMICallException

# Of an FMU whose error is known better; one that does may have been replayed by its own steps.
_EXCHANGE = "offers Model Exchange (without --own-step)"
# The status of FMI after which nothing of the FMU may be called any more.
_FATAL = 4


class ReplayOutcome(Enum):
    """How a replay ended; the value is a sentence."""

    OK = "The replay reached the end of the plan."
    DIVERGED = "The state left every bound."
    NOT_A_NUMBER = "The FMU gave a value that is not a finite number."
    INTEGRATION_FAILED = "The integrator could not go on within its tolerances."
    EVENT_BUDGET = "More contact events than the replay allows; the contact chatters."
    FMU_FAILED = "The FMU refused a call."
    FATAL = "The FMU reported a fatal status."
    TIME_LIMIT = "The FMU did not come to an end within the time limit."
    MEMORY_LIMIT = "The FMU wanted more memory than it may have."
    CRASHED = "The FMU crashed."
    ABORTED = "The FMU aborted the process."
    NO_RESULT = "The FMU ended the process, which left no result."


@dataclass(frozen=True, kw_only=True)
class Growth:
    """amplification: see validate.judge.replay.tracking.

    begin, end [s]: between which it is reached; duration [s]: of the plan.
    """

    amplification: float
    begin: float
    end: float
    duration: float

    @property
    def rate(self) -> float:
        """[1/s] with amplification = exp(rate * duration)."""
        return math.log(max(self.amplification, 1e-300)) / self.duration


@dataclass(frozen=True, kw_only=True)
class Event:
    """A gap that closed or opened at `time` [s].

    contact: its name; or the force's name of a friction that began to stick or to slip; or the name
        of the push of a damped contact that was released
    (closes, because its push fell below zero) or pressed again; or `indicator_<n>` where the FMU
        has indicators of its own.
    """

    time: float
    contact: str
    closes: bool


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Largest difference of two simulations over the plan's nodes.

    position: of any one coordinate [m or rad]; state: Euclidean norm over positions and velocities;
        gap: of any one gap [m].
    """

    position: float
    state: float
    gap: float


@dataclass(frozen=True, kw_only=True)
class ReplayError:
    """How wrong the judged trajectory may be, and what that is made of (None: not measured).

    estimate: what verdicts use; None where nothing is known.
    tolerance: the reference, Model Exchange by CVODE, at two tolerances. It overstates the error of
        the tighter run, which is judged.
    step: of the everyday replay, Co-Simulation. With a reference its two finest steps; without one
        the largest difference among its four finest, if the three finer of them differ by less than
        the three coarser.
    everyday: the everyday replay against the reference.
    stated: what the map says that the results of Co-Simulation are good to ([accuracy]); infinite
        in what is not stated.
    lag: of scenes without inertia the motion at twice the relaxation time against the judged one:
        to first order what is left of it.

    With a reference the estimate is `tolerance`, unless the everyday replay, an independent method,
    differs from it by more than `step` or `stated` explains; then `everyday`. Where the looser
    reference did not get to the end it is the larger of `everyday` and `step`.
    Without a reference it is `step`, and at least what is stated, or else the tolerance that the
    FMU declares for its own solver. What is stated stands alone where no convergence is seen.
    `lag` is added.
    """

    estimate: Difference | None
    tolerance: Difference | None = None
    step: Difference | None = None
    everyday: Difference | None = None
    lag: Difference | None = None
    stated: Difference | None = None

    @property
    def would_decide(self) -> str:
        """What would make this error smaller or known.

        Empty where there was a reference to compare with.
        """
        if self.tolerance is not None or self.everyday is not None:
            return ""
        if self.estimate is None:
            return (
                "state how good its results are in the map ([accuracy] position = ..), or take an FMU that names its internal step "
                f"(internal_step = ..) or {_EXCHANGE}"
            )
        parts = (
            ("position", self.estimate.position),
            ("velocity", self.estimate.state),
            ("gap", self.estimate.gap),
        )
        unknown = [name for name, value in parts if math.isinf(value)]
        if unknown:
            # The norm of the state is unknown where the position is, whatever is stated of the
            # velocity.
            unknown = [name for name in unknown if name != "velocity" or "position" not in unknown]
            return f"state [accuracy] {' and '.join(unknown)} in the map too, or take an FMU that {_EXCHANGE}"
        if self.stated is not None:
            return f"a better stated accuracy ([accuracy] in the map), if its author can vouch for it, or an FMU that {_EXCHANGE}"
        return f"a plan with shorter steps, or an FMU that {_EXCHANGE}"

    def as_json(self) -> dict[str, Any]:
        """Its numbers by name; what is infinite is null, as JSON knows no such number."""
        numbers = asdict(self)
        for item in numbers.values():
            if isinstance(item, dict):
                item |= {
                    name: value if math.isfinite(value) else None for name, value in item.items()
                }
        return numbers


@dataclass(frozen=True, kw_only=True, eq=False)
class Recorded:
    """A motion row by row, and what belongs to it.

    q, v (n, nq); lam, gap (n, nc) [N, m] with gap = -penetration; friction (n, nf) [N]; kinetic,
    potential, contact_energy (n,) [J]; input_work, dissipated_work (n,) [J] and contact_impulse (n,
    nc) [N s], accumulated from the start - None where the FMU has no such output.
    """

    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    gap: np.ndarray
    friction: np.ndarray
    kinetic_energy: np.ndarray
    potential_energy: np.ndarray
    contact_energy: np.ndarray
    input_work: np.ndarray | None
    dissipated_work: np.ndarray | None
    contact_impulse: np.ndarray | None

    def rows(self, chosen: np.ndarray) -> Recorded:
        """Some of its rows, by their numbers (m,) [-]. Raises IndexError."""
        arrays = ((item.name, getattr(self, item.name)) for item in fields(Recorded))
        taken: dict[str, Any] = {
            name: array if array is None else array[chosen] for name, array in arrays
        }
        return Recorded(**taken)


@dataclass(frozen=True, kw_only=True, eq=False)
class Replay(Recorded):
    """The plan's inputs applied, from the task's start, to the true continuous contact dynamics.

    t (n,) [s]: every node of the plan, points between them, and every event, to which the rows of
    `Recorded` belong; knots (nodes,): rows of t that are plan nodes. Every number is finite; a
    replay that did not get to the end holds what came before (`outcome`, `message`).

    growth: of an error in the open loop (None: not measured). tracked: the replay with feedback
        around the plan, where there is one; it has feedback
    (the law, in the plan's units), applied (steps, nu), the inputs at the start of each step that
        it made, and effort, which an open one has not.
    lagging: the motion at twice the relaxation time, of scenes without inertia (`ReplayError.lag`).
    """

    scene: str
    outcome: ReplayOutcome
    message: str
    method: str  # "reference" (Model Exchange, CVODE) or "everyday" (Co-Simulation)
    t: np.ndarray
    knots: np.ndarray
    events: tuple[Event, ...]
    event_budget: int
    error: ReplayError
    seconds_reference: float
    seconds_everyday: float
    fmu: str  # SHA-256 of the FMU file
    growth: Growth | None = None
    feedback: Feedback | None = None
    applied: np.ndarray | None = None
    effort: Effort | None = None
    tracked: Replay | None = None
    lagging: Replay | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                if not np.isfinite(value).all():
                    raise ValueError(
                        "a replay holds finite numbers only; what is not finite belongs into its outcome."
                    )
                value.setflags(write=False)

    @property
    def ok(self) -> bool:
        """Whether it reached the end of the plan."""
        return self.outcome is ReplayOutcome.OK

    @property
    def end(self) -> np.ndarray:
        """State where the replay ended, (2*nq,) positions [m or rad], then velocities [m/s or rad/s]. Raises IndexError for a replay without a row."""
        return np.concatenate([self.q[-1], self.v[-1]])

    @property
    def energy(self) -> np.ndarray:
        """Kinetic, potential and contact energy at each row, (n,) [J].

        Raises TypeError where one of them is missing.
        """
        return self.kinetic_energy + self.potential_energy + self.contact_energy


# A state this many times its nominal (and its start) has left every bound; in Co-Simulation, which
# tells no nominals, this itself.
DIVERGENCE = 1e9


@dataclass(kw_only=True)
class Run:
    """What one simulation recorded, point by point.

    Times, outputs of the model and accumulated quantities per point; rows that are nodes; events as
    (time, indicator, closes); with feedback the inputs applied from the start of each step on.
    """

    t: list[float] = field(default_factory=list)
    outputs: list[np.ndarray] = field(default_factory=list)
    accumulated: list[np.ndarray] = field(default_factory=list)
    knots: list[int] = field(default_factory=list)
    events: list[tuple[float, int, bool]] = field(default_factory=list)
    applied: list[np.ndarray] = field(default_factory=list)
    outcome: ReplayOutcome = ReplayOutcome.OK
    message: str = ""

    def end_without_number(self, time: float) -> None:
        """The outputs at a time [s] are not all finite."""
        self.outcome, self.message = (
            ReplayOutcome.NOT_A_NUMBER,
            f"An output was not a finite number at t = {time:.6g} s.",
        )

    def end_out_of_bounds(self, time: float) -> None:
        """A state is beyond any bound at a time [s] that was stepped to."""
        self.outcome, self.message = (
            ReplayOutcome.DIVERGED,
            f"A state left every bound by t = {time:.6g} s.",
        )

    def end_refused(self, error: FMICallException, begin: float) -> None:
        """The FMU refused a call; begin: the first time of the run [s]."""
        self.outcome = ReplayOutcome.FATAL if error.status == _FATAL else ReplayOutcome.FMU_FAILED
        self.message = (
            f"{str(error).rstrip('.')} (after t = {self.t[-1] if self.t else begin:.6g} s)."
        )


class Stop(Exception):  # noqa: N818 - it ends a run, and is no error of the program
    """A run cannot go on: its outcome, and a sentence."""

    def __init__(self, outcome: ReplayOutcome, message: str) -> None:
        super().__init__(message)
        self.outcome = outcome
        self.message = message
