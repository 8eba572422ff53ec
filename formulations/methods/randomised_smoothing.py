"""Single shooting by L-BFGS on the loss averaged over random inputs: a relaxation by noise, with eps as its size, through the true contact law."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from formulations.method import Clock, Kind, Method, OptionError, Session, option
from formulations.shooting.options import SearchOptions, WeightOptions
from models.contact_law import ContactLaw
from models.scene import Scene


# The goal is not displaced: what the mean misses is as much the noise as the plan.
@dataclass(frozen=True, kw_only=True)
class RandomisedSmoothingOptions(SearchOptions, WeightOptions):
    """Options of `randomised_smoothing`."""

    samples: int = option(
        16, "rollouts with noise; an even number, in pairs of opposite noise", lower=2, upper=10**6
    )
    pieces: int = option(
        5, "noise is held over so many equal parts of the horizon", lower=1, upper=10**9
    )
    seed: int = option(0, "of the noise", lower=0)
    unbounded: float = option(
        1.0,
        "what stands for half the range of an input without bounds, in its unit",
        lower=1e-12,
        upper=1e12,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.samples % 2:
            raise OptionError(f"option samples is {self.samples!r}, but must be an even number.")


class RandomisedSmoothing(Method[RandomisedSmoothingOptions]):
    """L-BFGS on the mean loss over random inputs, with eps as the size of the noise."""

    name = "randomised_smoothing"
    title = "L-BFGS on ReLU contact, averaged over random inputs"
    kind = Kind.INDIRECT
    needs_eps = True  # standard deviation of the noise, in half ranges of the inputs
    options = RandomisedSmoothingOptions

    def session(self, scene: Scene, options: RandomisedSmoothingOptions, clock: Clock) -> Session:
        """Open a session, which imports PyTorch."""
        from formulations.shooting.session import (
            ShootingSession,
            noise,
            paper_objective,
        )  # imports PyTorch

        drawn = partial(
            noise,
            scene,
            unbounded=options.unbounded,
            samples=options.samples,
            pieces=options.pieces,
            seed=options.seed,
        )  # of the deviation
        return ShootingSession(
            self, scene, options, clock, paper_objective(options, ContactLaw.RELU, noise=drawn)
        )


METHOD = RandomisedSmoothing()
