"""Single time steps of a scene: linearised at given states, or consecutive with feedback.

    steps.linearise(x, u, step=0.01)  # next, lam, A (n, 2*nq, 2*nq), B (n, 2*nq, nu)
    steps.ends(x, u, step=0.01)  # next only
    steps.follow(start, x_plan, u_plan, gain, step=0.01)  # u = clip(u_plan + gain (x - x_plan))

The steps are those of models.codegen.kernel, bit for bit. x = (q, v).
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
    """n steps: ends next (n, 2*nq), forces lam (n, nc+nf) [N], A = d next/d x, B = d next/d u."""

    next: np.ndarray
    lam: np.ndarray
    A: np.ndarray
    B: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """A motion: x (steps+1, 2*nq), u (steps, nu) within bounds, lam (steps, nc+nf) [N].

    finite_steps: number of finite steps
    """

    x: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    finite_steps: int

    @property
    def diverged(self) -> bool:
        """Return whether a state was not finite."""
        return self.finite_steps < len(self.u)


def load_steps(scene: Scene) -> Steps:
    """Compile the single steps of a scene, or load these from the cache.

    Raises MachineError without a compiler.
    """
    sources = kernel_sources(scene)
    sources["rollout.h"] = sources.pop("rollout.c")  # included by steps.c
    sources["steps.c"] = Path(__file__).with_name("steps.c").read_text(encoding="utf-8")
    return Steps(scene, cached_library(sources))


class Steps(Kernel):
    """A kernel with single steps."""

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
        """Return a step from each state x (n, 2*nq) [SI] with u (n, nu) [N, N m], and derivatives.

        None if a step is not finite. Raises KernelError for an array of another shape,
        RelaxationError unless 0 < eps < 1 for softplus.
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
        """Return the ends (n, 2*nq) [SI] of one step from each state, without derivatives.

        Raises as `linearise`.
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
        """Run with feedback u = u_plan + gain (x - x_plan) within the input bounds.

        Rows after a divergence are NaN.
        start: (2*nq,) [m, rad, m/s, rad/s]
        x_plan, u_plan: (steps, 2*nq) and (steps, nu) [N, N m]
        gain: (steps, nu, 2*nq) [N/m, N s/m and so on]
        step: length of a step [s]
        jump: added to the state after each step (steps, 2*nq), or None
        Raises KernelError for an array of another shape, RelaxationError unless 0 < eps < 1 for
        softplus.
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
        arrays = (start, x_plan, u_plan, gain, self._lower, self._upper)
        done = self._single.kernel_feedback_rollout(
            *self.head(n, step, law, eps), *(address(array) for array in arrays),
            None if jump is None else address(jump),
            *(address(array) for array in (x, u, lam)),
        )  # fmt: skip
        return Followed(x=x, u=u, lam=lam, finite_steps=done)
