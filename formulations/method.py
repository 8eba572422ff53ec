"""A method: one way to find a plan, in one file of formulations/methods that defines `METHOD`.

A session is opened once on a scene and keeps model, structure and duals between several eps:

    with METHOD.open(scene, options) as session:
        for eps in (1e-3, 1e-5, 1e-7):
            solution = session.solve(eps=eps, warm_start=plan, time_limit=60.0)
            plan = solution.trajectory

Options are a frozen dataclass of `option` fields. Values are stored unchanged, because keys of
stored results depend on them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from enum import Enum
from time import perf_counter, process_time
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar

from models.errors import TouchstoneError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from formulations.solution import Solution
    from models.scene import Scene
    from models.trajectory import Trajectory


class OptionError(TouchstoneError):
    """An option or eps that is unknown or out of range."""


def option(
    default: Any,
    description: str,
    *,
    lower: float = -math.inf,
    upper: float = math.inf,
    unit: str = "1",
    choices: tuple[object, ...] = (),
    place: bool = False,
) -> Any:
    """Declare a field of `Options`; lower and upper are inclusive bounds.

    place: the path of a file. Another field holds the digest of the file, so that the path is no
    part of a key.
    """
    choices = choices or ((True, False) if isinstance(default, bool) else ())
    return field(
        default=default,
        metadata={
            "description": description,
            "lower": lower,
            "upper": upper,
            "unit": unit,
            "choices": choices,
            "place": place,
        },
    )


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of a method without options, and the base class.

    Raises OptionError for an invalid value.
    """

    def __post_init__(self) -> None:
        for item in fields(self):
            _check(item, getattr(self, item.name))


AnyOptions = TypeVar("AnyOptions", bound=Options)


def _check(item: Field[Any], value: object) -> None:
    if not item.metadata or (value is None and item.default is None):
        return
    lower, upper, unit, choices = (
        item.metadata[key] for key in ("lower", "upper", "unit", "choices")
    )
    wrong = f"option {item.name} is {value!r}, but must be"
    if choices and value not in choices:
        raise OptionError(f"{wrong} one of {', '.join(map(repr, choices))}.")
    if lower > -math.inf or upper < math.inf:
        if (
            isinstance(value, bool)
            or not isinstance(value, (int, float))
            or not lower <= value <= upper
        ):
            raise OptionError(
                f"{wrong} a number in [{lower:g}, {upper:g}]{'' if unit == '1' else f' {unit}'}."
            )
        if isinstance(item.default, int) and not isinstance(value, int):
            raise OptionError(f"{wrong} a whole number.")


def without_inputs(scene: Scene, wanted: str) -> str | None:
    """Return a reason if the scene has no inputs to `wanted` (a verb), else None."""
    return (
        None
        if scene.inputs
        else f"scene {scene.name} has no inputs, so there is nothing to {wanted}."
    )


class Kind(Enum):
    """Indirect methods relax contact, direct ones do not; a given plan comes from a file."""

    INDIRECT = "indirect"
    DIRECT = "direct"
    GIVEN = "given"


# Return the stored Solutions of the last leg of a path from a cold start, or None.
StoredStages: TypeAlias = "Callable[[Sequence[Leg]], Sequence[Solution] | None]"


class Clock:
    """Wall and CPU seconds of opening a session, which count for its first stage."""

    def __init__(self) -> None:
        self._wall, self._cpu = perf_counter(), process_time()
        self._spent = (0.0, 0.0)

    def stop(self) -> None:
        """Stop when the session is open."""
        self._spent = (perf_counter() - self._wall, process_time() - self._cpu)

    def pay(self) -> tuple[float, float]:
        """Return the wall and CPU seconds at the first call, later zeros."""
        spent, self._spent = self._spent, (0.0, 0.0)
        return spent


class Session(ABC):
    """A method opened on a scene."""

    @abstractmethod
    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Run one stage.

        eps: the relaxation (None for methods without one)
        warm_start: a plan on the same grid, or None for the paper's first guess (start state, u =
            lam = 0)
        time_limit: wall seconds
        Raises OptionError for an invalid eps or time limit.
        """

    def start_used(self, warm_start: Trajectory | None) -> Trajectory | None:
        """Return the actual start of the first stage: None if it would reject the plan.

        A campaign runs equal stages once.
        """
        return warm_start

    def use_stored(self, stored: StoredStages) -> None:  # noqa: B027 - most sessions run no pipelines
        """Read stages of other pipelines from `stored` instead of solving them.

        Results do not change.
        """

    def close(self) -> None:  # noqa: B027 - most sessions hold nothing that needs freeing
        """Release resources."""

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class Method(ABC, Generic[AnyOptions]):
    """One way to find a plan."""

    name: str
    title: str
    kind: Kind
    needs_eps: bool  # whether `solve` takes an eps
    # True if the plan is exact; a campaign then certifies it.
    exact: bool = False
    # Pipelines that the method runs; a campaign provides their stored stages.
    ways: tuple[Pipeline, ...] = ()
    options: type[AnyOptions] = Options  # pyright: ignore[reportAssignmentType] - of a method that has none

    def accepts(self, scene: Scene) -> str | None:
        """Return the reason why this method does not apply to the scene, or None."""
        return without_inputs(scene, "plan")

    @abstractmethod
    def session(self, scene: Scene, options: AnyOptions, clock: Clock) -> Session:
        """Open a session on an accepted scene.

        The clock runs until it is open, including imports.
        """

    def open(
        self, scene: Scene, options: AnyOptions | Mapping[str, object] = MappingProxyType({})
    ) -> Session:
        """Open the method on a scene, with an options object or values by name.

        Raises OptionError for invalid options, and for a scene that the method does not accept.
        """
        clock = Clock()
        read = self.read_options(options)
        reason = self.accepts(scene)
        if reason is not None:
            raise OptionError(f"method {self.name}: {reason}")
        opened = self.session(scene, read, clock)
        clock.stop()
        return opened

    def check_eps(self, eps: float | None) -> None:
        """Raise OptionError if eps is missing, superfluous or not in (0, 1)."""
        if not self.needs_eps:
            if eps is not None:
                raise OptionError(
                    f"method {self.name}: it takes no eps, but {eps!r} was given; leave it out."
                )
            return
        if (
            eps is None
            or isinstance(eps, bool)
            or not isinstance(eps, (int, float))
            or not 0.0 < eps < 1.0
        ):
            raise OptionError(
                f"method {self.name}: eps is {eps!r}, but must be a number with 0 < eps < 1."
            )

    def check_stage(self, eps: float | None, time_limit: float) -> None:
        """Raise OptionError for an invalid eps or time limit [s]."""
        self.check_eps(eps)
        if not time_limit > 0.0:
            raise OptionError(
                f"method {self.name}: the time limit is {time_limit!r}, but must be a positive number of seconds."
            )

    def read_options(self, options: AnyOptions | Mapping[str, object]) -> AnyOptions:
        """Return options with defaults; raise OptionError for unknown names and invalid values."""
        kind, where = self.options, f"method {self.name}"
        if isinstance(options, Options):
            if type(options) is not kind:
                raise OptionError(
                    f"{where}: its options are {kind.__name__}, but {type(options).__name__} were given."
                )
            return options
        names = [item.name for item in fields(kind)]
        for name in options:
            if name not in names:
                hint = did_you_mean(name, names, f"it has {', '.join(names) or 'none'}.")
                raise OptionError(f"{where}: there is no option {name!r}; {hint}")
        try:
            return kind(**options)
        except OptionError as error:
            raise OptionError(f"{where}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A run of one method over a schedule of eps (one None without eps), with its options.

    `stage_options[i]` overrides `options` in stage i (such as the paper's iteration counts).
    """

    method: str
    schedule: tuple[float | None, ...] = (None,)
    options: Mapping[str, object] = field(default_factory=dict)
    stage_options: tuple[Mapping[str, object], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """A chain of legs; each stage starts from the plan of the previous one.

    only: the scene of campaigns by default; "" for every scene
    """

    name: str
    title: str
    legs: tuple[Leg, ...]
    source: str = ""
    only: str = ""
