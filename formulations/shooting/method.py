"""What the two gradient methods share: options, refusals, and how a session is opened. PyTorch is imported when one is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from formulations.method import Method, OptionError, OptionSpec, Session
from models.contact_law import ContactLaw

if TYPE_CHECKING:
    from models.scene import Scene

OPTIONS = (
    OptionSpec(
        name="learning_rate",
        default=500.0,
        description="step along the gradient; 500 is the paper's scene's, other scenes and horizons may need less",
        lower=1e-12,
        upper=1e12,
    ),
    OptionSpec(name="input_weight", default=5e-6, description="weight of the running cost in the loss", lower=0.0, upper=1e12),
    OptionSpec(
        name="terminal_weight", default=1.0, description="weight of the mean squared terminal error in the loss", lower=1e-12, upper=1e12
    ),
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


class DescentMethod(Method):
    """Single shooting by gradient descent under one contact law."""

    law: ContactLaw
    options = OPTIONS

    def accepts(self, scene: Scene) -> str | None:
        if not scene.inputs:
            return f"scene {scene.name} has no inputs, so there is nothing to descend on."
        return None

    def filled_options(self, options: Mapping[str, object]) -> dict[str, object]:
        filled = super().filled_options(options)
        iterations = filled["iterations"]
        if iterations is not None and not isinstance(iterations, int):
            raise OptionError(f"method {self.name}: option iterations is {iterations!r}, but must be a whole number or left out.")
        return filled

    def session(self, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> Session:
        from formulations.shooting.session import DescentSession

        return DescentSession(self, scene, options, opening)
