"""The time steps of a scene one by one: linearised at states of their own, or run one after the other with feedback.

    steps = load_steps(scene)
    # x (n, 2*nq), u (n, nu) -> next, lam, A (n, 2*nq, 2*nq), B (n, 2*nq, nu)
    steps.linearise(x, u, step=0.01)
    steps.ends(x, u, step=0.01)  # next alone
    # u = clip(u_plan + gain (x - x_plan), lower, upper)
    steps.follow(start, x_plan, u_plan, gain, step=0.01)

The steps are those of models.codegen.kernel, bit for bit; the derivatives come from its adjoint.
State x = (q, v), positions first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.codegen.compiler import cached_library, load_library
from models.codegen.kernel import Kernel, address, kernel_sources
from models.contact_law import ContactLaw
from models.scene import Scene

_SIGNATURES = {
    "kernel_linearise": ("n", "ndpnd" + "p" * 6),
    "kernel_feedback_rollout": ("n", "ndpnd" + "p" * 10),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearised:
    """n steps. next (n, 2*nq): where each ends; lam (n, nc+nf) [N]; A (n, 2*nq, 2*nq) = d next/d x.

    B (n, 2*nq, nu) = d next/d u.
    """

    next: np.ndarray
    lam: np.ndarray
    A: np.ndarray
    B: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """x (steps+1, 2*nq), u (steps, nu) within the scene's bounds, lam (steps, nc+nf) [N].

    finite_steps: how many stayed finite.
    """

    x: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    finite_steps: int

    @property
    def diverged(self) -> bool:
        """Whether a state stopped being finite before the last step."""
        return self.finite_steps < len(self.u)


def load_steps(scene: Scene) -> Steps:
    """Compile (or find in the cache) the single steps of a scene.

    Raises MachineError without a compiler.
    """
    sources = kernel_sources(scene)
    sources["rollout.h"] = sources.pop("rollout.c")  # included by steps.c, not compiled beside it
    sources["steps.c"] = Path(__file__).with_name("steps.c").read_text(encoding="utf-8")
    return Steps(scene, cached_library(sources))


class Steps(Kernel):
    """A kernel with more functions; see the module docstring.

    All arrays are float64; shapes that do not fit raise KernelError.
    """

    def __init__(self, scene: Scene, library: Path) -> None:
        super().__init__(scene, library)
        self._single = load_library(library, _SIGNATURES)
        self._lower = np.array([item.lower for item in scene.inputs] or [0.0])
        self._upper = np.array([item.upper for item in scene.inputs] or [0.0])

    def linearise(
        self,
        x: np.ndarray,
        u: np.ndarray,
        step: float,
        law: ContactLaw = ContactLaw.RELU,
        eps: float | None = None,
    ) -> Linearised | None:
        """One step from each state, and its derivatives.

        Parameters
        ----------
        x
            States (n, 2*nq): positions [m, rad], then velocities [m/s, rad/s].
        u
            Inputs (n, nu) [N, N m].
        step
            Length of the step [s].
        law, eps
            The contact law, and the relaxation of a softplus [-].

        Returns
        -------
        Linearised | None
            None where one of the steps is not finite.

        Raises
        ------
        KernelError
            Where an array has another shape.
        RelaxationError
            Unless 0 < eps < 1, of a relaxed law.
        """
        scene, n = self.scene, len(u)
        x, u = self._array("x", x, n, 2 * scene.nq), self._array("u", u, n, scene.nu)
        after, lam = np.empty_like(x), np.empty((n, scene.nl))
        by_x, by_u = (
            np.empty((n, 2 * scene.nq, 2 * scene.nq)),
            np.empty((n, 2 * scene.nq, scene.nu)),
        )
        arrays = (x, u, after, lam, by_x, by_u)
        done = self._single.kernel_linearise(
            *self.head(n, step, law, eps), *(address(array) for array in arrays)
        )
        return Linearised(next=after, lam=lam, A=by_x, B=by_u) if done == n else None

    def ends(
        self,
        x: np.ndarray,
        u: np.ndarray,
        step: float,
        law: ContactLaw = ContactLaw.RELU,
        eps: float | None = None,
    ) -> np.ndarray | None:
        """Return the end of one step from each state: `next` (n, 2*nq) of `linearise`, without derivatives.

        Parameters and errors are those of `linearise`.
        """
        scene, n = self.scene, len(u)
        x, u = self._array("x", x, n, 2 * scene.nq), self._array("u", u, n, scene.nu)
        after, lam = np.empty_like(x), np.empty((n, scene.nl))
        done = self._single.kernel_linearise(
            *self.head(n, step, law, eps),
            *(address(array) for array in (x, u, after, lam)),
            None,
            None,
        )
        return after if done == n else None

    def follow(
        self,
        start: np.ndarray,
        x_plan: np.ndarray,
        u_plan: np.ndarray,
        gain: np.ndarray,
        step: float,
        law: ContactLaw = ContactLaw.RELU,
        eps: float | None = None,
        jump: np.ndarray | None = None,
    ) -> Followed:
        """Run with feedback u = u_plan + gain (x - x_plan), within the bounds of the inputs.

        Rows after a divergence are NaN.

        Parameters
        ----------
        start
            State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
        x_plan
            States (steps, 2*nq) of the plan.
        u_plan
            Inputs (steps, nu) of the plan [N, N m].
        gain
            Gains (steps, nu, 2*nq) [N/m, N s/m and so on].
        step
            Length of a step [s].
        law, eps
            The contact law, and the relaxation of a softplus [-].
        jump
            Added to the state after each step (steps, 2*nq); None for a motion without jumps.

        Returns
        -------
        Followed
            The motion, its inputs and forces.

        Raises
        ------
        KernelError
            Where an array has another shape.
        RelaxationError
            Unless 0 < eps < 1, of a relaxed law.
        """
        scene, n = self.scene, len(u_plan)
        x_plan, u_plan = (
            self._array("x_plan", x_plan, n, 2 * scene.nq),
            self._array("u_plan", u_plan, n, scene.nu),
        )
        gain, start = (
            self._array("gain", gain, n, scene.nu, 2 * scene.nq),
            self._array("start", start, 2 * scene.nq),
        )
        jump = None if jump is None else self._array("jump", jump, n, 2 * scene.nq)
        x, u, lam = (
            np.full((n + 1, 2 * scene.nq), np.nan),
            np.full((n, scene.nu), np.nan),
            np.full((n, scene.nl), np.nan),
        )
        given = (start, x_plan, u_plan, gain, self._lower, self._upper)
        done = self._single.kernel_feedback_rollout(
            *self.head(n, step, law, eps), *(address(array) for array in given),
            None if jump is None else address(jump),
            *(address(array) for array in (x, u, lam)),
        )  # fmt: skip
        return Followed(x=x, u=u, lam=lam, finite_steps=done)
