"""The models that a window search asks for, built and translated once for a scene: other starts and other radii of its goal change numbers in them.

A model is put into the same state before every use (`load_plan`, `load_first_guess`, modes, ball, sharpness): what is found with it does not depend on
what it was used for before.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from formulations.transcription.workbench import Account
from formulations.windows.homotopy import SoftplusHomotopy
from formulations.windows.linear_scene import linear_scene, why_not_linear
from formulations.windows.nonlinear import NonlinearModes
from formulations.windows.quadratic import ModesProblem
from models.codegen.kernel import Kernel
from models.scene import Scene

if TYPE_CHECKING:
    from formulations.mpec.certificate.plan import PlanJudge


class Structures:
    """Of one scene. A goal that is a point and one that is a ball are two models, balls of any radius one."""

    def __init__(self, scene: Scene, kernel: Kernel) -> None:
        self._scene, self._kernel = scene, kernel
        self._homotopies: dict[tuple[bool, tuple[float, ...]], SoftplusHomotopy] = {}
        self._nonlinear: dict[bool, NonlinearModes] = {}
        self._linear: ModesProblem | None = None
        self._coarser: dict[int, Structures] = {}
        self._judge: PlanJudge | None = None
        self.is_linear = why_not_linear(scene) is None

    def coarser(self, scene: Scene) -> Structures:
        """Those of the same scene with fewer steps."""
        if scene.task.steps not in self._coarser:
            self._coarser[scene.task.steps] = Structures(scene, self._kernel)
        return self._coarser[scene.task.steps]

    def homotopy(self, ball: float, schedule: tuple[float, ...]) -> SoftplusHomotopy:
        """The softplus homotopy with this ball around the goal."""
        key = (ball > 0.0, schedule)
        if key not in self._homotopies:
            self._homotopies[key] = SoftplusHomotopy(self._scene, ball, schedule)
        self._homotopies[key].move_ball(ball)
        return self._homotopies[key]

    def modes(self, ball: float, account: Account, options: Mapping[str, Any]) -> ModesProblem | NonlinearModes:
        """The problem with modes fixed, with this ball; account, options: of the runs of Ipopt that a nonlinear scene needs."""
        if self.is_linear:
            if self._linear is None:
                self._linear = ModesProblem(linear_scene(self._scene), ball)
            self._linear.ball = ball
            return self._linear
        is_ball = ball > 0.0
        if is_ball not in self._nonlinear:
            self._nonlinear[is_ball] = NonlinearModes(self._scene, self._kernel, ball, account, options)
        else:
            self._nonlinear[is_ball].begin(ball, account, options)
        return self._nonlinear[is_ball]

    def judge(self) -> PlanJudge:
        """What certifies plans of this scene."""
        if self._judge is None:
            from formulations.mpec.certificate.plan import PlanJudge

            self._judge = PlanJudge(self._scene)
        return self._judge
