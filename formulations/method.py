"""A method: one way to find a plan. ONE FILE = ONE METHOD in formulations/methods; the file defines `METHOD`.

    class SoftplusDC(Method):
        name = "softplus_dc"
        kind = Kind.INDIRECT
        ...
    METHOD = SoftplusDC()

A method is opened once on a scene and may then be run for several eps, so that what can be kept between them
(model, structure, duals) is kept:

    with METHOD.open(scene, options) as session:
        for eps in (1e-3, 1e-5, 1e-7):
            solution = session.solve(eps=eps, warm_start=plan, time_limit=60.0)
            plan = solution.trajectory
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from time import perf_counter, process_time
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Generic

from formulations.options import AnyOptions, OptionError, Options, read_options

if TYPE_CHECKING:  # pipelines are data: naming them must not cost SymPy and numpy
    from formulations.solution import Solution
    from models.scene import Scene
    from models.trajectory import Trajectory


class Kind(Enum):
    """Indirect methods cheat on contact (and are expected to violate physics); direct methods do not."""

    INDIRECT = "indirect"
    DIRECT = "direct"


class Session(ABC):
    """A method opened on a scene."""

    @abstractmethod
    def solve(self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float) -> Solution:
        """One stage. eps: the relaxation (None for methods without one); warm_start: a plan on the same grid, or None for the
        paper's first guess (initial state held, u = lam = 0); time_limit: wall seconds."""

    def start_used(self, warm_start: Trajectory | None) -> Trajectory | None:
        """What the first stage of this session would really start from: None where it would leave the plan for the first guess. The stage
        is then the same whatever plan it was given, and a campaign runs it once."""
        return warm_start

    def close(self) -> None:  # noqa: B027 - most sessions hold nothing that needs freeing
        """Free what the session holds."""

    def __enter__(self) -> Session:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


class Method(ABC, Generic[AnyOptions]):
    """See the module docstring."""

    name: str
    title: str
    kind: Kind
    needs_eps: bool  # whether `solve` takes a relaxation eps
    exact: bool = False  # whether its plan claims to solve the exact contact problem: a campaign then certifies it
    options: type[AnyOptions] = Options  # pyright: ignore[reportAssignmentType] - of a method that has none

    @abstractmethod
    def accepts(self, scene: Scene) -> str | None:
        """None, or the reason why this method does not apply to the scene."""

    @abstractmethod
    def session(self, scene: Scene, options: AnyOptions, opening: tuple[float, float]) -> Session:
        """A session on a scene that the method accepts; opening: wall and CPU clock when opening began, before anything was imported for it."""

    def open(self, scene: Scene, options: AnyOptions | Mapping[str, object] = MappingProxyType({})) -> Session:
        """Open on a scene. options: such an object, or values by name. Raises OptionError for unknown or impossible options, and for a scene
        that the method does not accept."""
        opening = (perf_counter(), process_time())
        read = self.read_options(options)
        reason = self.accepts(scene)
        if reason is not None:
            raise OptionError(f"method {self.name}: {reason}")
        return self.session(scene, read, opening)

    def check_eps(self, eps: float | None) -> None:
        """Raise OptionError if eps is missing, superfluous or out of range (0 < eps < 1 unless the method says otherwise)."""
        if not self.needs_eps:
            if eps is not None:
                raise OptionError(f"method {self.name}: it takes no eps, but {eps!r} was given; leave it out.")
            return
        if eps is None or isinstance(eps, bool) or not isinstance(eps, (int, float)) or not 0.0 < eps < 1.0:
            raise OptionError(f"method {self.name}: eps is {eps!r}, but must be a number with 0 < eps < 1.")

    def read_options(self, options: AnyOptions | Mapping[str, object]) -> AnyOptions:
        """All options with defaults filled in. Raises OptionError for unknown names and values out of range."""
        return read_options(self.options, options, self.name)


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A run of one method over a schedule: the eps in order (one None for a method without eps), with its options.

    `stage_options[i]` overrides `options` in stage i (e.g. the paper's iteration counts).
    """

    method: str
    schedule: tuple[float | None, ...] = (None,)
    options: Mapping[str, object] = field(default_factory=lambda: MappingProxyType({}))
    stage_options: tuple[Mapping[str, object], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """A chain of legs; each stage starts from the plan of the stage before it.

    parts: a pipeline of many independent solves may be run as several cells, each with its own options laid over those of every leg; what
    they find is told as one run. part: (number from 1, of how many) of such a cell, None for the whole.
    """

    name: str
    title: str
    legs: tuple[Leg, ...]
    source: str = ""
    parts: tuple[Mapping[str, object], ...] = ()
    part: tuple[int, int] | None = None
