"""Result of a replay: the true motion under the plan's inputs, and its error."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np

from validate.judge.replay.wiring import Effort, Feedback

if TYPE_CHECKING:
    from fmpy.fmi1 import FMICallException

# Advice for an FMU without Model Exchange, or replayed with --own-step.
_EXCHANGE = "offers Model Exchange (without --own-step)"
# FMI status after which no call is allowed.
_FATAL = 4


class ReplayOutcome(Enum):
    """Ending of a replay, as a sentence."""

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
    """Growth of an error (validate.judge.replay.tracking), largest between begin and end [s].

    duration: of the plan [s].
    """

    amplification: float
    begin: float
    end: float
    duration: float

    @property
    def rate(self) -> float:
        """Return the rate [1/s] with amplification = exp(rate * duration)."""
        return math.log(max(self.amplification, 1e-300)) / self.duration


@dataclass(frozen=True, kw_only=True)
class Event:
    """A contact that closed or opened at `time` [s].

    contact: its name, or

    - the force's name if friction began to stick or slip.
    - the push's name if a damped contact was released (closes) or pressed again.
    - `indicator_<n>` in an external FMU.
    """

    time: float
    contact: str
    closes: bool


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Largest difference of two simulations over the plan's nodes.

    - position: of one coordinate [m or rad].
    - state: Euclidean norm of positions and velocities.
    - gap: of one gap [m].
    """

    position: float
    state: float
    gap: float


@dataclass(frozen=True, kw_only=True)
class ReplayError:
    """Error of the judged trajectory and its parts; None: not measured.

    - estimate: the error that verdicts use.
    - tolerance: difference of the reference at two tolerances; overstates the tighter run's error.
    - step: difference of everyday runs. With a reference of the two finest; without one the largest
      of the four finest, if the three finer differ less than the three coarser.
    - everyday: difference of everyday replay and reference.
    - stated: errors that the map states ([accuracy]); infinite if not stated.
    - lag: difference from the motion at twice the relaxation time, the first-order error.

    With a reference the estimate is `tolerance`, or `everyday` if `step` and `stated` do not
    explain the difference of the methods. Without the looser reference it is the larger of
    `everyday` and `step`. Without a reference it is `step`, at least `stated`, else the FMU's
    declared tolerance; `stated` alone if the steps do not converge. `lag` is added.
    """

    estimate: Difference | None
    tolerance: Difference | None = None
    step: Difference | None = None
    everyday: Difference | None = None
    lag: Difference | None = None
    stated: Difference | None = None

    @property
    def would_decide(self) -> str:
        """Return what would reduce this error, or make it known; "" with a reference."""
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
            # Without a known position the state's norm is unknown, whatever the velocity's accuracy
            # is.
            unknown = [name for name in unknown if name != "velocity" or "position" not in unknown]
            return f"state [accuracy] {' and '.join(unknown)} in the map too, or take an FMU that {_EXCHANGE}"
        if self.stated is not None:
            return f"a better stated accuracy ([accuracy] in the map), if its author can vouch for it, or an FMU that {_EXCHANGE}"
        return f"a plan with shorter steps, or an FMU that {_EXCHANGE}"

    def as_json(self) -> dict[str, Any]:
        """Return the numbers by name; infinite ones are null."""
        numbers = asdict(self)
        for item in numbers.values():
            if isinstance(item, dict):
                item |= {
                    name: value if math.isfinite(value) else None for name, value in item.items()
                }
        return numbers


@dataclass(frozen=True, kw_only=True, eq=False)
class Recorded:
    """A motion by rows; sums are None if the FMU lacks them.

    q, v (n, nq); lam, gap (n, nc) [N, m] with gap = -penetration; friction (n, nf) [N]; kinetic,
    potential, contact_energy (n,) [J]. Since the start: input_work, dissipated_work (n,) [J],
    contact_impulse (n, nc) [N s].
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
        """Return the rows chosen (m,) [-]. Raises IndexError."""
        arrays = ((item.name, getattr(self, item.name)) for item in fields(Recorded))
        taken: dict[str, Any] = {
            name: array if array is None else array[chosen] for name, array in arrays
        }
        return Recorded(**taken)


@dataclass(frozen=True, kw_only=True, eq=False)
class Replay(Recorded):
    """The true contact dynamics under the plan's inputs, from the task's start.

    t (n,) [s]: nodes of the plan, points between, events; knots (nodes,): rows of the nodes. All
    numbers are finite; a failed replay holds the rows before (`outcome`, `message`).

    - growth: of an error without feedback.
    - tracked: replay with feedback, which has feedback (in the plan's units), applied (steps, nu)
      at the start of each step, and effort.
    - lagging: motion at twice the relaxation time.
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
        """Return whether the replay reached the end of the plan."""
        return self.outcome is ReplayOutcome.OK

    @property
    def end(self) -> np.ndarray:
        """Return the last state (2*nq,) [m or rad, m/s or rad/s]. Raises IndexError."""
        return np.concatenate([self.q[-1], self.v[-1]])

    @property
    def energy(self) -> np.ndarray:
        """Return the energy of each row (n,) [J]. Raises TypeError if a part is missing."""
        return self.kinetic_energy + self.potential_energy + self.contact_energy


# Divergence of a state in nominals and starts; in Co-Simulation, without nominals, its value.
DIVERGENCE = 1e9


@dataclass(kw_only=True)
class Run:
    """Record of one simulation, by points.

    knots: rows of nodes; events: (time, indicator, closes); applied: inputs with feedback.
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
        """End the run at a time [s] with outputs that are not finite."""
        self.outcome, self.message = (
            ReplayOutcome.NOT_A_NUMBER,
            f"An output was not a finite number at t = {time:.6g} s.",
        )

    def end_out_of_bounds(self, time: float) -> None:
        """End the run at a time [s] with a state out of bounds."""
        self.outcome, self.message = (
            ReplayOutcome.DIVERGED,
            f"A state left every bound by t = {time:.6g} s.",
        )

    def end_refused(self, error: FMICallException, begin: float) -> None:
        """End the run at a refused call; begin: first time of the run [s]."""
        self.outcome = ReplayOutcome.FATAL if error.status == _FATAL else ReplayOutcome.FMU_FAILED
        self.message = (
            f"{str(error).rstrip('.')} (after t = {self.t[-1] if self.t else begin:.6g} s)."
        )


class Stop(Exception):  # noqa: N818 - an ending, no error of the program
    """The run cannot continue: its outcome, and a sentence."""

    def __init__(self, outcome: ReplayOutcome, message: str) -> None:
        super().__init__(message)
        self.outcome = outcome
        self.message = message
