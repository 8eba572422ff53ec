"""Rollout and adjoint of one problem in buffers of their own, for loops that call them thousands of times.

    work = Workspace(kernel, start, steps=500, step=0.01, law=ContactLaw.RELU)
    work.rollout(u)                      # fills work.q, work.v, work.lam; work.finite_steps
    work.end_bar[:] = ...                # derivative of the loss with respect to the last state
    gradient = work.adjoint(cost_bar=5e-6)

Nothing is allocated and no address is looked up in a call, so that what remains is the compiled code. The values are those
of `Kernel.rollout` and `Kernel.adjoint`, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.codegen.kernel import Kernel, KernelError
from models.contact_law import ContactLaw, sharpness


class Workspace:
    """See the module docstring. All arrays are views that the next call overwrites.

    u (steps, nu), q, v (steps+1, nq), lam (steps, nc+nf): the last rollout; finite_steps: how many of its steps stayed finite.
    end_bar (2*nq,): derivative of the loss with respect to the last state, positions first; u_bar, start_bar: gradients. start (2*nq,), sharpness (0 for
    the true law) and functions are what the compiled code is called with; q_bar, v_bar (steps+1, nq) are zero but for their last rows, which a call of
    `adjoint` fills in.
    """

    def __init__(
        self, kernel: Kernel, start: Sequence[float] | np.ndarray, *, steps: int, step: float, law: ContactLaw, eps: float | None = None
    ):
        scene = kernel.scene
        self.kernel, self.steps, self.step, self.law, self.eps = kernel, steps, step, law, eps
        self.start = np.array(start, dtype=float)
        if self.start.shape != (2 * scene.nq,):
            raise KernelError(f"scene {scene.name}: start has shape {self.start.shape}, but ({2 * scene.nq},) is needed.")
        self.u = np.zeros((steps, scene.nu))
        self.q, self.v = np.zeros((steps + 1, scene.nq)), np.zeros((steps + 1, scene.nq))
        self.lam = np.zeros((steps, scene.nl))
        self.end_bar = np.zeros(2 * scene.nq)
        self.u_bar, self.start_bar = np.zeros((steps, scene.nu)), np.zeros(2 * scene.nq)
        self.finite_steps = 0
        self.q_bar, self.v_bar = np.zeros_like(self.q), np.zeros_like(self.v)
        self.functions = kernel.bound_functions()
        self.sharpness = 0.0 if law is ContactLaw.RELU else sharpness(eps if eps is not None else 0.0, scene.length)
        p = kernel.parameters_of(step).ctypes.data
        head, states = (steps, step, p, law.value, self.sharpness), [array.ctypes.data for array in (self.q, self.v, self.lam)]
        u = self.u.ctypes.data
        self._rollout_arguments = (*head, self.start.ctypes.data, u, *states)
        self._adjoint_arguments = (*head, *states, u, self.q_bar.ctypes.data, self.v_bar.ctypes.data, None)
        self._gradients = (self.u_bar.ctypes.data, self.start_bar.ctypes.data)
        self._cost_arguments = (steps, p, *states[:2], u)

    def rollout(self, u: np.ndarray) -> bool:
        """Simulate with inputs u (steps, nu); whether every step stayed finite (rows after the last finite one are left over)."""
        np.copyto(self.u, u)
        self.finite_steps = self.functions.rollout(*self._rollout_arguments)
        return self.finite_steps == self.steps

    def cost(self) -> float:
        """The cost of the last rollout."""
        return self.functions.cost(*self._cost_arguments)

    def adjoint(self, cost_bar: float = 0.0) -> np.ndarray:
        """u_bar (steps, nu) of a loss whose derivatives are `end_bar` and `cost_bar`, at the last rollout; fills start_bar too."""
        nq = self.kernel.scene.nq
        self.q_bar[-1], self.v_bar[-1] = self.end_bar[:nq], self.end_bar[nq:]
        if self.functions.adjoint(*self._adjoint_arguments, cost_bar, *self._gradients):
            raise KernelError(f"scene {self.kernel.scene.name}: the mass matrix is not positive definite along the rollout.")
        return self.u_bar
