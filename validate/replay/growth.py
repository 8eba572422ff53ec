"""How much an error grows in the open loop: the largest gain of the state-transition product along a plan.

    growth = measure_growth(load_kernel(scene), scene, plan)
    growth.amplification        # 1500: an error of the state somewhere on the way is 1500 times larger somewhere later

The plan is cut into at most 50 blocks. Phi of a block is the exact derivative of the plan's own time step (of one that declares no scheme: of
steps so small that smaller ones tell the same), with the true contact law, from the block's first state on under the plan's inputs; Phi(j, i) is the product of the blocks i .. j - 1. The amplification is the largest 2-norm of
S^-1 Phi(j, i) S over i < j, with S the scene's nominals: a finite-time Lyapunov growth. Its rate is such that amplification = exp(rate T).

An exact plan lies on edges: a contact just touches, friction just sticks. The derivative there is that of one side, and rounding says of which. So the
number explains a verdict, and decides none.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from models.codegen.kernel import Kernel, KernelError
from models.contact_law import ContactLaw
from models.scene import Scene
from models.trajectory import Trajectory
from validate.replay.result import Growth
from validate.replay.subject import Subject

# Blocks in which a plan is cut: growth within one is told by the next product, and fifty keep the cost below that of one replay.
_BLOCKS = 50

# Parts of a plan's step, tried until twice in a row the growth is the same up to this factor.
_PARTS, _AGREE = (1, 8, 64, 512), 3.0


def nominals(subject: Subject) -> np.ndarray:
    """(2*nq,) typical size of each component of the state; a velocity's is that of its position, per second."""
    sizes = [item.nominal for item in subject.coordinates]
    return np.array(sizes + sizes)


def measure_growth(kernel: Kernel, scene: Scene, plan: Trajectory) -> Growth | None:
    """The growth along the plan; None where the true law leads out of every bound within a block, the mass matrix is singular, or, of a plan that
    declares no scheme, smaller steps keep telling another number: then it is the steps that are unstable."""
    if plan.scheme is not None:
        return _growth_in(1, kernel, scene, plan)
    before = None
    for parts in _PARTS:
        found = _growth_in(parts, kernel, scene, plan)
        if found is not None and before is not None and max(found.amplification, 1.0) / max(before.amplification, 1.0) >= 1.0 / _AGREE:
            return found
        before = found
    return None


def _growth_in(parts: int, kernel: Kernel, scene: Scene, plan: Trajectory) -> Growth | None:
    """With each step of the plan in so many parts."""
    h = np.diff(plan.t)
    uniform = bool(np.allclose(h, scene.task.step, rtol=1e-9, atol=0.0)) or plan.has_uniform_grid()
    edges = _edges(plan.steps) if uniform else np.arange(plan.steps + 1)
    of_length = {length: FlowDerivative(kernel, length * parts) for length in set(np.diff(edges).tolist())}
    try:
        blocks = [
            of_length[last - first].at(
                np.concatenate([plan.q[first], plan.v[first]]), np.repeat(plan.u[first:last], parts, axis=0), float(h[first]) / parts
            )[0]
            for first, last in pairwise(edges)
        ]
    except KernelError:
        return None
    return largest_growth(np.array(blocks), plan.t[edges], nominals(scene))


def largest_growth(steps: np.ndarray, t: np.ndarray, scale: np.ndarray) -> Growth | None:
    """Of transition matrices steps (n, nx, nx) from t[i] to t[i + 1] [s], t (n + 1,), taken in at most 50 blocks; scale (nx,). None where they are not
    finite."""
    scaled = steps * (scale[None, None, :] / scale[None, :, None])
    best = (0.0, 0, 0)
    products = np.empty((0, *steps.shape[1:]))
    edges = _edges(len(steps))
    t = t[edges]
    with np.errstate(over="ignore", invalid="ignore"):
        for end, (first, last) in enumerate(pairwise(edges), start=1):
            matrix = np.eye(len(scale))
            for step in scaled[first:last]:
                matrix = step @ matrix
            # Row i: from edge i to edge `end`.
            products = np.concatenate([matrix @ products, matrix[None]])
            if not np.isfinite(products).all():
                return None
            gains = np.linalg.norm(products, ord=2, axis=(1, 2))
            begin = int(gains.argmax())
            best = max(best, (float(gains[begin]), begin, end))
    amplification, begin, end = best
    return Growth(amplification=amplification, begin=float(t[begin]), end=float(t[end]), duration=float(t[-1] - t[0]))


def _edges(steps: int) -> np.ndarray:
    """(blocks + 1,) steps at which blocks begin, and the last end."""
    return np.unique(np.linspace(0, steps, min(steps, _BLOCKS) + 1).round().astype(int))


def flow_derivative(kernel: Kernel, state: np.ndarray, u: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the state after len(u) steps of h [s] under the true law, at `state` (2*nq,) and inputs u (n, nu): (2*nq, 2*nq) with respect
    to the state, (2*nq, nu) with respect to a change of all the inputs by the same. Raises KernelError where it does not stay finite."""
    return FlowDerivative(kernel, len(u)).at(state, u, h)


class FlowDerivative:
    """`flow_derivative` for many states and inputs of `steps` steps, in buffers whose addresses are looked up once."""

    def __init__(self, kernel: Kernel, steps: int) -> None:
        scene = kernel.scene
        self._scene, self._steps, self._functions = scene, steps, kernel.bound_functions()
        nq, nodes = scene.nq, (steps + 1, scene.nq)
        self._start, self._u = np.empty(2 * nq), np.empty((steps, scene.nu))
        self._u_bar, self._start_bar, self._end_bar = np.empty((steps, scene.nu)), np.empty(2 * nq), np.zeros(2 * nq)
        self._run = np.empty(nodes), np.empty(nodes), np.empty((steps, scene.nl))
        self._kernel = kernel
        start, u, *made = (array.ctypes.data for array in (self._start, self._u, *self._run))
        self._rollout_of = start, u, *made
        self._adjoint_of = *made, u, None, None, None, self._end_bar.ctypes.data, 0.0, self._u_bar.ctypes.data
        self._rows = self._start_bar.ctypes.data

    def at(self, state: np.ndarray, u: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        """As `flow_derivative` gives it. Raises KernelError."""
        scene, nq = self._scene, self._scene.nq
        self._start[:], self._u[:] = state, u
        head = (self._steps, h, self._kernel.parameters_of(h).ctypes.data, ContactLaw.RELU.value, 0.0)
        if self._functions.rollout(*head, *self._rollout_of) < self._steps:
            raise KernelError(f"scene {scene.name}: the true contact law leads out of every bound from {state.tolist()}.")
        by_state, by_input = np.empty((2 * nq, 2 * nq)), np.empty((2 * nq, u.shape[1]))
        for row in range(2 * nq):
            self._end_bar[row] = 1.0
            failed = self._functions.adjoint(*head, *self._adjoint_of, self._rows)
            self._end_bar[row] = 0.0
            if failed:
                raise KernelError(f"scene {scene.name}: the mass matrix is not positive definite along the rollout.")
            by_state[row], by_input[row] = self._start_bar, self._u_bar.sum(axis=0)
        return by_state, by_input
