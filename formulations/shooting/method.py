"""What the single shooting methods share: options, refusals, and how a session is opened."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from formulations.method import Method, OptionError, Options, Session, option
from models.contact_law import ContactLaw

if TYPE_CHECKING:
    import numpy as np

    from formulations.shooting.descent import Descent
    from formulations.shooting.objective import Loss, Objective
    from models.codegen.kernel import Kernel
    from models.scene import Scene


@dataclass(frozen=True, kw_only=True)
class DescentOptions(Options):
    learning_rate: float = option(
        500.0, "step along the gradient; 500 is the paper's scene's, other scenes and horizons may need less", lower=1e-12, upper=1e12
    )
    input_weight: float = option(5e-6, "weight of the running cost in the loss", lower=0.0, upper=1e12)
    terminal_weight: float = option(1.0, "weight of the mean squared terminal error in the loss", lower=1e-12, upper=1e12)
    iterations: int | None = option(
        None,
        "exactly so many iterations and the last plan (the paper's way); none: our stopping rule and the best plan",
        lower=1,
        upper=10**9,
    )
    max_iterations: int = option(20000, "most iterations under our stopping rule", lower=1, upper=10**9)
    tolerance: float = option(
        1e-4,
        "our stopping rule: relative decrease of the loss over the last quarter of the iterations that counts as none",
        lower=0.0,
        upper=1.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.iterations is not None and not isinstance(self.iterations, int):
            raise OptionError(f"option iterations is {self.iterations!r}, but must be a whole number or left out.")


@dataclass(frozen=True, kw_only=True)
class LbfgsOptions(Options):
    input_weight: float = option(5e-6, "weight of the running cost in the loss", lower=0.0, upper=1e12)
    terminal_weight: float = option(1.0, "weight of the mean squared terminal error in the loss", lower=1e-12, upper=1e12)
    memory: int = option(20, "pairs of steps and gradient differences that are kept", lower=1, upper=1000)
    max_iterations: int = option(2000, "most iterations, over all rounds", lower=1, upper=10**9)
    tolerance: float = option(
        1e-4, "our stopping rule: relative decrease of the loss over 20 iterations that counts as none", lower=0.0, upper=1.0
    )
    goal_rounds, goal_tolerance = 0, 0.0  # no options here: the goal is not displaced


@dataclass(frozen=True, kw_only=True)
class QuasiNewtonOptions(LbfgsOptions):
    goal_rounds: int = option(
        10,
        "how often the goal that is aimed at is displaced by what was missed (multipliers); 0: the loss of gradient descent",
        lower=0,
        upper=1000,
    )
    goal_tolerance: float = option(1e-6, "no more rounds where the goal is missed by less than this", lower=0.0)


_Options = TypeVar("_Options", bound=DescentOptions | LbfgsOptions)
_LbfgsOptions = TypeVar("_LbfgsOptions", bound=LbfgsOptions)


class ShootingMethod(Method[_Options]):
    """Single shooting under one contact law: a loss of the inputs alone, and a way to make it small."""

    law: ContactLaw

    def accepts(self, scene: Scene) -> str | None:
        if not scene.inputs:
            return f"scene {scene.name} has no inputs, so there is nothing to descend on."
        return None

    def session(self, scene: Scene, options: _Options, opening: tuple[float, float]) -> Session:
        from formulations.shooting.session import ShootingSession

        return ShootingSession(self, scene, options, opening)

    def objective(self, kernel: Kernel, eps: float | None, options: _Options) -> Objective:
        """The loss at this eps."""
        from formulations.shooting.objective import Objective, Weights

        weights = Weights(terminal=options.terminal_weight, running=options.input_weight)
        return Objective(kernel, law=self.law, eps=eps, weights=weights, loss=self.loss(kernel.scene))

    def loss(self, scene: Scene) -> Loss | None:
        """A loss of one's own, of a rollout and its inputs (formulations.shooting.objective); None: the paper's, by the weights among the options."""
        return None

    @abstractmethod
    def minimise(self, objective: Objective, u0: np.ndarray, options: _Options, time_limit: float) -> Descent:
        """From inputs u0 (steps, nu); time_limit: wall seconds."""


class DescentMethod(ShootingMethod[DescentOptions]):
    """By gradient descent."""

    options = DescentOptions

    def minimise(self, objective: Objective, u0: np.ndarray, options: DescentOptions, time_limit: float) -> Descent:
        from formulations.shooting.descent import descend

        return descend(objective, u0, options, time_limit)


class QuasiNewtonMethod(ShootingMethod[_LbfgsOptions]):
    """By L-BFGS within the bounds of the inputs."""

    def minimise(self, objective: Objective, u0: np.ndarray, options: _LbfgsOptions, time_limit: float) -> Descent:
        from formulations.shooting.quasi_newton import minimise

        return minimise(objective, u0, options, time_limit)
