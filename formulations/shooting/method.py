"""What the single shooting methods share: options, refusals, and how a session is opened."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

from formulations.method import Method, OptionError, OptionSpec, Session
from models.contact_law import ContactLaw

if TYPE_CHECKING:
    import numpy as np

    from formulations.shooting.descent import Descent
    from formulations.shooting.objective import Loss, Objective
    from models.codegen.kernel import Kernel
    from models.scene import Scene

WEIGHTS = (
    OptionSpec(name="input_weight", default=5e-6, description="weight of the running cost in the loss", lower=0.0, upper=1e12),
    OptionSpec(
        name="terminal_weight", default=1.0, description="weight of the mean squared terminal error in the loss", lower=1e-12, upper=1e12
    ),
)

OPTIONS = (
    OptionSpec(
        name="learning_rate",
        default=500.0,
        description="step along the gradient; 500 is the paper's scene's, other scenes and horizons may need less",
        lower=1e-12,
        upper=1e12,
    ),
    *WEIGHTS,
    OptionSpec(
        name="iterations",
        default=None,
        description="exactly so many iterations and the last plan (the paper's way); none: our stopping rule and the best plan",
        lower=1,
        upper=10**9,
    ),
    OptionSpec(name="max_iterations", default=20000, description="most iterations under our stopping rule", lower=1, upper=10**9),
    OptionSpec(
        name="tolerance",
        default=1e-4,
        description="our stopping rule: relative decrease of the loss over the last quarter of the iterations that counts as none",
        lower=0.0,
        upper=1.0,
    ),
)


QUASI_NEWTON = (
    *WEIGHTS,
    OptionSpec(name="memory", default=20, description="pairs of steps and gradient differences that are kept", lower=1, upper=1000),
    OptionSpec(name="max_iterations", default=2000, description="most iterations, over all rounds", lower=1, upper=10**9),
    OptionSpec(
        name="tolerance",
        default=1e-4,
        description="our stopping rule: relative decrease of the loss over 20 iterations that counts as none",
        lower=0.0,
        upper=1.0,
    ),
    OptionSpec(
        name="goal_rounds",
        default=10,
        description="how often the goal that is aimed at is displaced by what was missed (multipliers); 0: the loss of gradient descent",
        lower=0,
        upper=1000,
    ),
    OptionSpec(name="goal_tolerance", default=1e-6, description="no more rounds where the goal is missed by less than this", lower=0.0),
)


class ShootingMethod(Method):
    """Single shooting under one contact law: a loss of the inputs alone, and a way to make it small."""

    law: ContactLaw

    def accepts(self, scene: Scene) -> str | None:
        if not scene.inputs:
            return f"scene {scene.name} has no inputs, so there is nothing to descend on."
        return None

    def session(self, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> Session:
        from formulations.shooting.session import ShootingSession

        return ShootingSession(self, scene, options, opening)

    def objective(self, kernel: Kernel, eps: float | None, options: Mapping[str, object]) -> Objective:
        """The loss at this eps."""
        from formulations.shooting.objective import Objective, Weights

        weights = Weights(terminal=_number(options["terminal_weight"]), running=_number(options["input_weight"]))
        return Objective(kernel, law=self.law, eps=eps, weights=weights, loss=self.loss(kernel.scene))

    def loss(self, scene: Scene) -> Loss | None:
        """A loss of one's own, of a rollout and its inputs (formulations.shooting.objective); None: the paper's, by the weights among the options."""
        return None

    @abstractmethod
    def minimise(self, objective: Objective, u0: np.ndarray, options: Mapping[str, object], time_limit: float) -> Descent:
        """From inputs u0 (steps, nu); time_limit: wall seconds."""


class DescentMethod(ShootingMethod):
    """By gradient descent."""

    options = OPTIONS

    def filled_options(self, options: Mapping[str, object]) -> dict[str, object]:
        filled = super().filled_options(options)
        iterations = filled["iterations"]
        if iterations is not None and not isinstance(iterations, int):
            raise OptionError(f"method {self.name}: option iterations is {iterations!r}, but must be a whole number or left out.")
        return filled

    def minimise(self, objective: Objective, u0: np.ndarray, options: Mapping[str, object], time_limit: float) -> Descent:
        from formulations.shooting.descent import Settings, descend

        iterations = options["iterations"]
        settings = Settings(
            learning_rate=_number(options["learning_rate"]),
            iterations=None if iterations is None else int(_number(iterations)),
            max_iterations=int(_number(options["max_iterations"])),
            tolerance=_number(options["tolerance"]),
        )
        return descend(objective, u0, settings, time_limit)


class QuasiNewtonMethod(ShootingMethod):
    """By L-BFGS within the bounds of the inputs."""

    options = QUASI_NEWTON

    def minimise(self, objective: Objective, u0: np.ndarray, options: Mapping[str, object], time_limit: float) -> Descent:
        from formulations.shooting.quasi_newton import Settings, minimise

        settings = Settings(
            memory=int(_number(options["memory"])),
            max_iterations=int(_number(options["max_iterations"])),
            tolerance=_number(options["tolerance"]),
            goal_rounds=int(_number(options.get("goal_rounds", 0))),
            goal_tolerance=_number(options.get("goal_tolerance", 0.0)),
        )
        return minimise(objective, u0, settings, time_limit)


def _number(value: object) -> float:
    return float(cast(float, value))  # checked by filled_options
