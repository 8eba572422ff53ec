"""What the single shooting methods share: a loss of the inputs alone under one contact law, made small by gradient descent or by L-BFGS.

Light to import: no PyTorch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from formulations.method import Clock, Method, Session
from formulations.shooting.options import DescentOptions, QuasiNewtonOptions
from models.contact_law import ContactLaw

if TYPE_CHECKING:
    from formulations.shooting.rollout import Loss
    from models.scene import Scene

_Weighted = TypeVar("_Weighted", bound=DescentOptions | QuasiNewtonOptions)


class ShootingMethod(Method[_Weighted]):
    """Single shooting under one contact law.

    PyTorch is imported when a session is opened: 1.7 s that planning a campaign does without.
    """

    law: ContactLaw

    def loss(self, scene: Scene) -> Loss | None:
        """Give a loss of one's own, of a rollout and its inputs (formulations.shooting.objective).

        None: the paper's, by the weights among the options.
        """
        return None

    def session(self, scene: Scene, options: _Weighted, clock: Clock) -> Session:
        """Open a session, which imports PyTorch."""
        from formulations.shooting.session import ShootingSession

        return ShootingSession(self, scene, options, clock, self.law, self.loss(scene))


class DescentMethod(ShootingMethod[DescentOptions]):
    """By gradient descent."""

    options = DescentOptions


class QuasiNewtonMethod(ShootingMethod[QuasiNewtonOptions]):
    """By L-BFGS within the bounds of the inputs."""

    options = QuasiNewtonOptions
