"""Single shooting by L-BFGS on the loss averaged over random inputs: a relaxation by noise, with eps as its size, through the true contact law."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

from formulations.method import Kind, OptionError, OptionSpec
from formulations.shooting.method import QUASI_NEWTON, QuasiNewtonMethod
from models.contact_law import ContactLaw

if TYPE_CHECKING:
    from formulations.shooting.objective import Objective
    from models.codegen.kernel import Kernel

# The goal is not displaced: what the mean misses is as much the noise as the plan.
_SHARED = tuple(option for option in QUASI_NEWTON if option.name not in ("goal_rounds", "goal_tolerance"))


class RandomisedSmoothing(QuasiNewtonMethod):
    name = "randomised_smoothing"
    title = "L-BFGS on ReLU contact, averaged over random inputs"
    kind = Kind.INDIRECT
    needs_eps = True  # standard deviation of the noise, in half ranges of the inputs
    law = ContactLaw.RELU
    options = (
        *_SHARED,
        OptionSpec(
            name="samples", default=16, description="rollouts with noise; an even number, in pairs of opposite noise", lower=2, upper=10**6
        ),
        OptionSpec(name="pieces", default=5, description="noise is held over so many equal parts of the horizon", lower=1, upper=10**9),
        OptionSpec(name="seed", default=0, description="of the noise", lower=0),
        OptionSpec(
            name="unbounded",
            default=1.0,
            description="what stands for half the range of an input without bounds, in its unit",
            lower=1e-12,
            upper=1e12,
        ),
    )

    def filled_options(self, options: Mapping[str, object]) -> dict[str, object]:
        filled = super().filled_options(options)
        if cast(int, filled["samples"]) % 2:
            raise OptionError(f"method {self.name}: option samples is {filled['samples']!r}, but must be an even number.")
        return filled

    def objective(self, kernel: Kernel, eps: float | None, options: Mapping[str, object]) -> Objective:
        from formulations.shooting.objective import Objective, Weights
        from formulations.shooting.smoothed import noise

        number = {name: cast(float, value) for name, value in options.items()}
        drawn = noise(
            kernel.scene,
            deviation=eps or 0.0,
            unbounded=number["unbounded"],
            samples=int(number["samples"]),
            pieces=int(number["pieces"]),
            seed=int(number["seed"]),
        )
        weights = Weights(terminal=number["terminal_weight"], running=number["input_weight"])
        return Objective(kernel, law=self.law, weights=weights, noise=drawn)


METHOD = RandomisedSmoothing()
