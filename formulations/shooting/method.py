"""The base of single shooting methods: a loss of the inputs under one contact law.

No PyTorch import.
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
    """Single shooting under one contact law; opening a session imports PyTorch (1.7 s)."""

    law: ContactLaw

    def loss(self, scene: Scene) -> Loss | None:
        """Return a custom loss of a rollout and its inputs, or None for the paper's."""
        return None

    def session(self, scene: Scene, options: _Weighted, clock: Clock) -> Session:
        """Open a session."""
        from formulations.shooting.session import ShootingSession

        return ShootingSession(self, scene, options, clock, self.law, self.loss(scene))


class DescentMethod(ShootingMethod[DescentOptions]):
    """Single shooting by gradient descent."""

    options = DescentOptions


class QuasiNewtonMethod(ShootingMethod[QuasiNewtonOptions]):
    """Single shooting by L-BFGS within the input bounds."""

    options = QuasiNewtonOptions
