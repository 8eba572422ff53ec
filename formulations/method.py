"""A method: one way to find a plan.

ONE FILE = ONE METHOD in formulations/methods; the file defines `METHOD`.

    class SoftplusDC(Method):
        name = "softplus_dc"
        kind = Kind.INDIRECT
        ...
    METHOD = SoftplusDC()

A method is opened once on a scene and may then be run for several eps, so that what can be kept
between them (model, structure, duals) is kept:

    with METHOD.open(scene, options) as session:
        for eps in (1e-3, 1e-5, 1e-7):
            solution = session.solve(eps=eps, warm_start=plan, time_limit=60.0)
            plan = solution.trajectory

Options of methods: a frozen dataclass each, whose fields say what they mean and which values they
take.

    @dataclass(frozen=True, kw_only=True)
    class GlobalOptions(Options):
        seconds: float = option(200.0, "time after which the best bound is reported", unit="s", lower=1e-3, upper=1e7)

A value is kept as it was given, a whole number also where any number will do: keys of stored
results are made from it.
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
    """An option or eps that the method does not know or that is out of range.

    One sentence says which and what was expected.
    """


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
    """Declare a field of `Options`. lower, upper: bounds of a number, inclusive.

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
    """The options of a method; the base is for one that has none.

    Raises OptionError for an impossible value.
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
    """Give the reason why a method that chooses inputs does not apply to a scene that has none, or None; wanted: what it would do."""
    return (
        None
        if scene.inputs
        else f"scene {scene.name} has no inputs, so there is nothing to {wanted}."
    )


class Kind(Enum):
    """Indirect methods cheat on contact (and are expected to violate physics).

    Direct methods do not. A given plan comes from a file.
    """

    INDIRECT = "indirect"
    DIRECT = "direct"
    GIVEN = "given"


# Return the stored Solutions of the last leg of a path from a cold start on the session's scene;
# None if the leg is not stored.
StoredStages: TypeAlias = "Callable[[Sequence[Leg]], Sequence[Solution] | None]"


class Clock:
    """Wall and CPU seconds that opening a session takes.

    Its first stage pays for them; the stages after it find it open.
    """

    def __init__(self) -> None:
        self._wall, self._cpu = perf_counter(), process_time()
        self._spent = (0.0, 0.0)

    def stop(self) -> None:
        """The session is open."""
        self._spent = (perf_counter() - self._wall, process_time() - self._cpu)

    def pay(self) -> tuple[float, float]:
        """Give the wall and CPU seconds of opening the first time it is asked, and zero ever after."""
        spent, self._spent = self._spent, (0.0, 0.0)
        return spent


class Session(ABC):
    """A method opened on a scene."""

    @abstractmethod
    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Run one stage.

        eps: the relaxation (None for methods without one); warm_start: a plan on the same grid, or
            None for the paper's first guess (initial state held,
        u = lam = 0); time_limit: wall seconds. Raises OptionError for an eps or a time limit that
            is none.
        """

    def start_used(self, warm_start: Trajectory | None) -> Trajectory | None:
        """Give what the first stage of this session would really start from: None where it would leave the plan for the first guess.

        The stage is then the same whatever plan it was given, and a campaign runs it once.
        """
        return warm_start

    def use_stored(self, stored: StoredStages) -> None:  # noqa: B027 - most sessions run no pipelines
        """Read stages of other pipelines from `stored` instead of solving them. Results do not change."""

    def close(self) -> None:  # noqa: B027 - most sessions hold nothing that needs freeing
        """Free what the session holds."""

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
    """One way to find a plan; see the module docstring."""

    name: str
    title: str
    kind: Kind
    needs_eps: bool  # whether `solve` takes a relaxation eps
    # whether its plan claims to solve the exact contact problem: a campaign then certifies it
    exact: bool = False
    # Pipelines that the method runs itself; a campaign gives it their stored stages.
    ways: tuple[Pipeline, ...] = ()
    options: type[AnyOptions] = Options  # pyright: ignore[reportAssignmentType] - of a method that has none

    def accepts(self, scene: Scene) -> str | None:
        """Give None, or the reason why this method does not apply to the scene: that there are no inputs, unless the method says otherwise."""
        return without_inputs(scene, "plan")

    @abstractmethod
    def session(self, scene: Scene, options: AnyOptions, clock: Clock) -> Session:
        """Open a session on a scene that the method accepts.

        clock: runs since opening began, before anything was imported for it, until the session is
        open.
        """

    def open(
        self, scene: Scene, options: AnyOptions | Mapping[str, object] = MappingProxyType({})
    ) -> Session:
        """Open on a scene. options: such an object, or values by name.

        Raises OptionError for unknown or impossible options, and for a scene that the method does
        not accept.
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
        """Raise OptionError if eps is missing, superfluous or out of range (0 < eps < 1 unless the method says otherwise)."""
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
        """Raise OptionError for an impossible eps or a time limit [s] that is not positive."""
        self.check_eps(eps)
        if not time_limit > 0.0:
            raise OptionError(
                f"method {self.name}: the time limit is {time_limit!r}, but must be a positive number of seconds."
            )

    def read_options(self, given: AnyOptions | Mapping[str, object]) -> AnyOptions:
        """Fill in the defaults of the options.

        Raises OptionError for unknown names and values out of range.
        """
        kind, where = self.options, f"method {self.name}"
        if isinstance(given, Options):
            if type(given) is not kind:
                raise OptionError(
                    f"{where}: its options are {kind.__name__}, but {type(given).__name__} were given."
                )
            return given
        names = [item.name for item in fields(kind)]
        for name in given:
            if name not in names:
                hint = did_you_mean(name, names, f"it has {', '.join(names) or 'none'}.")
                raise OptionError(f"{where}: there is no option {name!r}; {hint}")
        try:
            return kind(**given)
        except OptionError as error:
            raise OptionError(f"{where}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A run of one method over a schedule: the eps in order (one None for a method without eps), with its options.

    `stage_options[i]` overrides `options` in stage i (e.g. the paper's iteration counts).
    """

    method: str
    schedule: tuple[float | None, ...] = (None,)
    options: Mapping[str, object] = field(default_factory=dict)
    stage_options: tuple[Mapping[str, object], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """A chain of legs; each stage starts from the plan of the stage before it.

    only: the scene that a campaign runs it on by default; "" for every scene.
    """

    name: str
    title: str
    legs: tuple[Leg, ...]
    source: str = ""
    only: str = ""
