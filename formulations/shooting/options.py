"""Options of gradient descent and of L-BFGS; light to import (no PyTorch)."""

from __future__ import annotations

from dataclasses import dataclass

from formulations.method import OptionError, Options, option


@dataclass(frozen=True, kw_only=True)
class WeightOptions(Options):
    """Weights of the paper's loss."""

    input_weight: float = option(
        5e-6, "weight of the running cost in the loss", lower=0.0, upper=1e12
    )
    terminal_weight: float = option(
        1.0, "weight of the mean squared terminal error in the loss", lower=1e-12, upper=1e12
    )


@dataclass(frozen=True, kw_only=True)
class DescentOptions(WeightOptions):
    """Options of gradient descent."""

    learning_rate: float = option(
        500.0,
        "step along the gradient; 500 is the paper's scene's, other scenes and horizons may need less",
        lower=1e-12,
        upper=1e12,
    )
    iterations: int | None = option(
        None,
        "exactly so many iterations and the last plan (the paper's way); none: our stopping rule and the best plan",
        lower=1,
        upper=10**9,
    )
    max_iterations: int = option(
        20000, "most iterations under our stopping rule", lower=1, upper=10**9
    )
    tolerance: float = option(
        1e-4,
        "our stopping rule: relative decrease of the loss over the last quarter of the iterations that counts as none",
        lower=0.0,
        upper=1.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.iterations is not None and not isinstance(self.iterations, int):
            raise OptionError(
                f"option iterations is {self.iterations!r}, but must be a whole number or left out."
            )


@dataclass(frozen=True, kw_only=True)
class QuasiNewtonOptions(WeightOptions):
    """Options of L-BFGS, which meets the goal by multipliers."""

    memory: int = option(
        20, "pairs of steps and gradient differences that are kept", lower=1, upper=1000
    )
    max_iterations: int = option(2000, "most iterations, over all rounds", lower=1, upper=10**9)
    tolerance: float = option(
        1e-4,
        "our stopping rule: relative decrease of the loss over 20 iterations that counts as none",
        lower=0.0,
        upper=1.0,
    )
    goal_rounds: int = option(
        10,
        "how often the goal that is aimed at is displaced by what was missed (multipliers); 0: the loss of gradient descent",
        lower=0,
        upper=1000,
    )
    goal_tolerance: float = option(
        1e-6, "no more rounds where the goal is missed by less than this", lower=0.0
    )
