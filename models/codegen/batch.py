"""Several plans of one scene in one call of the compiled kernel: rollouts and their adjoints, row by row.

    found = rollouts(kernel, start, u, step=0.01)              # start (rows, 2*nq), u (rows, steps, nu)
    u_bar, start_bar = adjoints(kernel, found, u, q_bar, v_bar, lam_bar, cost_bar)

Each row is that of `Kernel.rollout` and `Kernel.adjoint`, bit for bit. A row that diverges is NaN from there on, and so are its gradients; the others do not notice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.codegen.kernel import Kernel, KernelError
from models.contact_law import ContactLaw


@dataclass(frozen=True, kw_only=True, eq=False)
class Rollouts:
    """q, v: (rows, steps+1, nq) [m, rad]; lam: (rows, steps, nc+nf) [N]; cost: (rows,), NaN where diverged; finite_steps: (rows,).

    step [s], law and eps are those they were made with.
    """

    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    cost: np.ndarray
    finite_steps: np.ndarray
    step: float
    law: ContactLaw
    eps: float | None


def rollouts(
    kernel: Kernel, start: np.ndarray, u: np.ndarray, step: float, law: ContactLaw = ContactLaw.RELU, eps: float | None = None
) -> Rollouts:
    """Simulate from each start (rows, 2*nq) with inputs u (rows, steps, nu). Raises KernelError for other shapes."""
    scene = kernel.scene
    rows, steps = u.shape[:2] if u.ndim == 3 else (len(start), -1)
    start, u = _array(kernel, "start", start, (rows, 2 * scene.nq)), _array(kernel, "u", u, (rows, steps, scene.nu))
    q, v = (np.empty((rows, steps + 1, scene.nq)) for _ in range(2))
    lam, cost, finite = np.empty((rows, steps, scene.nl)), np.empty(rows), np.empty(rows, dtype=np.intc)
    outputs = (array.ctypes.data for array in (start, u, q, v, lam, cost, finite))
    functions = kernel.batch_functions(steps, step, law, eps)
    functions.rollouts(rows, *functions.head, *outputs)
    for row in np.flatnonzero(finite < steps):
        after = finite[row] + 1
        q[row, after:] = v[row, after:] = np.nan
        lam[row, after:] = np.nan
    return Rollouts(q=q, v=v, lam=lam, cost=cost, finite_steps=finite, step=step, law=law, eps=eps)


def adjoints(
    kernel: Kernel, found: Rollouts, u: np.ndarray, q_bar: np.ndarray, v_bar: np.ndarray, lam_bar: np.ndarray, cost_bar: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients u_bar (rows, steps, nu), start_bar (rows, 2*nq) of a loss whose derivatives are q_bar, v_bar (rows, steps+1, nq), lam_bar
    (rows, steps, nc+nf) and cost_bar (rows,). Raises KernelError where a mass matrix is not positive definite."""
    rows, steps = found.lam.shape[:2]
    u = _array(kernel, "u", u, (rows, steps, kernel.scene.nu))
    bars = [
        _array(kernel, name, bar, like.shape)
        for name, bar, like in (
            ("q_bar", q_bar, found.q),
            ("v_bar", v_bar, found.v),
            ("lam_bar", lam_bar, found.lam),
            ("cost_bar", cost_bar, found.cost),
        )
    ]
    u_bar, start_bar = np.empty_like(u), np.empty((rows, 2 * kernel.scene.nq))
    arrays = (found.q, found.v, found.lam, u, found.finite_steps, *bars, u_bar, start_bar)
    functions = kernel.batch_functions(steps, found.step, found.law, found.eps)
    done = functions.adjoints(rows, *functions.head, *(array.ctypes.data for array in arrays))
    if done < rows:
        raise KernelError(f"scene {kernel.scene.name}: the mass matrix is not positive definite along rollout {done}.")
    return u_bar, start_bar


def _array(kernel: Kernel, name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        wanted = ", ".join("n" if size < 0 else str(size) for size in shape)
        raise KernelError(f"scene {kernel.scene.name}: {name} has shape {array.shape}, but ({wanted}) is needed.")
    return array
