"""What the single shooting methods share: a loss of the inputs alone under one contact law, made small by gradient descent or by L-BFGS.

Light to import: no PyTorch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from formulations.method import AnyOptions, Clock, Method, Session
from formulations.shooting.options import DescentOptions, QuasiNewtonOptions
from models.contact_law import ContactLaw

if TYPE_CHECKING:
    from formulations.shooting.objective import Loss
    from models.scene import Scene


class ShootingMethod(Method[AnyOptions]):
    """Single shooting under one contact law. PyTorch is imported when a session is opened: 1.7 s that planning a campaign does without."""

    purpose = "descend on"
    law: ContactLaw

    def loss(self, scene: Scene) -> Loss | None:
        """Give a loss of one's own, of a rollout and its inputs (formulations.shooting.objective); None: the paper's, by the weights among the options."""
        return None


class DescentMethod(ShootingMethod[DescentOptions]):
    """By gradient descent."""

    options = DescentOptions

    def session(self, scene: Scene, options: DescentOptions, clock: Clock) -> Session:
        """Open a session, which imports PyTorch."""
        from formulations.shooting.session import ShootingSession, descend, paper_objective

        return ShootingSession(
            self, scene, options, clock, objective=paper_objective(options, self.law, self.loss(scene)), minimise=descend
        )


class QuasiNewtonMethod(ShootingMethod[QuasiNewtonOptions]):
    """By L-BFGS within the bounds of the inputs."""

    options = QuasiNewtonOptions

    def session(self, scene: Scene, options: QuasiNewtonOptions, clock: Clock) -> Session:
        """Open a session, which imports PyTorch."""
        from formulations.shooting.session import ShootingSession, paper_objective, quasi_newton

        return ShootingSession(
            self, scene, options, clock, objective=paper_objective(options, self.law, self.loss(scene)), minimise=quasi_newton
        )
