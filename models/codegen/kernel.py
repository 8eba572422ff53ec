"""The compiled time step of a scene and its adjoint, as numpy functions.

    kernel = load_kernel(scene)
    rollout = kernel.rollout(scene.task.start, u, step=0.01)  # true (ReLU) contact
    rollout = kernel.rollout(start, u, step=0.01, law=ContactLaw.SOFTPLUS, eps=1e-3)
    u_bar, start_bar = kernel.adjoint(rollout, u, q_bar=..., v_bar=...)  # gradient of a loss

Semi-implicit Euler: lam[t] = L(phi(q[t])), v[t+1] = v[t] + h a[t], q[t+1] = q[t] + h v[t+1].
Friction forces follow the contact forces in lam; they depend on the slip at the end of the step.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.codegen.compiler import cached_library, load_library
from models.codegen.emit import for_scene, force_sources, model_source
from models.contact_law import ContactLaw, sharpness
from models.errors import TouchstoneError
from models.scene import Scene

_SOURCE = Path(__file__).with_name("rollout.c")
# The adjoint takes 0.6 of its time at -O2, with equal bits; compilation takes a fifth longer.
_OPTIMISED = ("-O3",)

# Results and arguments of the C functions (models.codegen.compiler); n is also a law.
_SIGNATURES = {
    "kernel_rollout": ("n", "ndpndppppp"),
    "kernel_adjoint": ("n", "ndpndppppppppdpp"),
    "kernel_rollouts": ("", "nndpndppppppp"),
    "kernel_adjoints": ("n", "nndpnd" + "p" * 11),
    "kernel_penetration": ("", "nppp"),
    "kernel_contact_force": ("", "npndpp"),
    "kernel_stiffness": ("", "pp"),
    "kernel_acceleration": ("n", "npppppp"),
    "kernel_energy": ("", "npppp"),
    "kernel_power": ("", "nppppp"),
    "kernel_cost": ("d", "npppp"),
}
_FRICTION_SIGNATURES = {"kernel_slip": ("", "npppp"), "kernel_friction_limit": ("", "npppp")}
_DAMPING_SIGNATURES = {
    "kernel_damped_contact_force": ("", "npndppp"),
    "kernel_contact_push": ("", "npppp"),
}


class KernelError(TouchstoneError):
    """Arrays that do not fit the scene, or a mass matrix that is not positive definite."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rollout:
    """A motion: q, v (steps+1, nq); lam (steps, nc+nf) contact, then friction forces.

    finite_steps: number of finite steps; later rows are NaN
    step [s], law, eps: of the rollout
    """

    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    finite_steps: int
    step: float
    law: ContactLaw
    eps: float | None

    @property
    def diverged(self) -> bool:
        """Return whether a state was not finite."""
        return self.finite_steps < len(self.lam)


def load_kernel(scene: Scene) -> Kernel:
    """Compile the kernel of a scene, or load it from the cache.

    Raise MachineError without a compiler.
    """
    return Kernel(scene, cached_library(kernel_sources(scene), _OPTIMISED))


def kernel_sources(scene: Scene) -> dict[str, str]:
    """Return file name -> text of the C sources of a scene's kernel."""
    rollout = for_scene(scene, _SOURCE.read_text(encoding="utf-8"))
    return {"scene_model.h": model_source(scene), "rollout.c": rollout, **force_sources(scene)}


class Kernel:
    """Numpy functions of the compiled kernel of one scene, in float64.

    library: its C functions, for callers with buffers of their own (formulations.shooting.rollout,
        validate.judge.replay.tracking)
    """

    def __init__(self, scene: Scene, library: Path) -> None:
        self.scene = scene
        self.path = library
        signatures = (
            _SIGNATURES
            | (_FRICTION_SIGNATURES if scene.nf else {})
            | (_DAMPING_SIGNATURES if scene.damped else {})
        )
        self.library = load_library(library, signatures)
        self._columns = {"q": scene.nq, "v": scene.nq, "u": scene.nu, "lam": scene.nl}
        self._p = np.array([parameter.value for parameter in scene.parameters] or [0.0])
        self._p_of_step: dict[float, np.ndarray] = {}

    def with_parameters(self, values: np.ndarray) -> Kernel:
        """Return the functions for other parameter values (np,) [SI]; `scene` keeps the old values.

        A new scene would take a hundred times as long. Raises KernelError for another number of
        values.
        """
        other = copy(self)
        other._p, other._p_of_step = (
            self._array("parameters", values, len(self.scene.parameters)).copy(),
            {},
        )
        return other

    def parameters_of(self, step: float) -> np.ndarray:
        """Return the parameters (np,) [SI] for time steps of this length [s]. Raises nothing.

        The step replaces the relaxation time of a scene without inertia
        (models.scene.quasi_static).
        """
        index = self.scene.relaxation_index
        if index is None or self._p[index] == step:
            return self._p
        if (
            step not in self._p_of_step
        ):  # kept as long as the kernel, because callers have its address
            self._p_of_step[step] = self._p.copy()
            self._p_of_step[step][index] = step
        return self._p_of_step[step]

    def penetration(self, q: np.ndarray) -> np.ndarray:
        """Return phi (n, nc) [m] at q (n, nq) [m, rad], positive in contact.

        Raises KernelError for an array of another shape.
        """
        return self._by_row("kernel_penetration", self.scene.nc, q=q)

    def stiffness(self) -> np.ndarray:
        """Return the stiffnesses k (nc,) [N/m]. Raises nothing."""
        k = np.empty(self.scene.nc)
        self.library.kernel_stiffness(address(self._p), address(k))
        return k

    def contact_force(
        self,
        q: np.ndarray,
        law: ContactLaw = ContactLaw.RELU,
        eps: float | None = None,
        *,
        v: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return contact forces lam (n, nc) [N] at q (n, nq) [m, rad] under a law.

        v (n, nq) [m/s, rad/s] affects damped contacts; None is at rest. Raises KernelError for an
        array of another shape, RelaxationError unless 0 < eps < 1 for softplus.
        """
        law_of = (law.value, law_sharpness(law, eps, self.scene.length))
        if not self.scene.damped:
            return self._by_row("kernel_contact_force", self.scene.nc, *law_of, q=q)
        return self._by_row(
            "kernel_damped_contact_force",
            self.scene.nc,
            *law_of,
            q=q,
            v=np.zeros_like(q) if v is None else v,
        )

    def contact_push(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the pushes (n, nc) [N], with the true forces as positive parts.

        q, v are (n, nq) [m, rad, m/s, rad/s]. Raises KernelError for an array of another shape.
        """
        if not self.scene.damped:
            return self.stiffness() * self.penetration(q)
        return self._by_row("kernel_contact_push", self.scene.nc, q=q, v=v)

    def slip(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return slip speeds (n, nf) [m/s] at q, v (n, nq) [m, rad, m/s, rad/s].

        Raises KernelError for an array of another shape.
        """
        return self._by_row("kernel_slip", self.scene.nf, q=q, v=v)

    def friction_limit(self, q: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return the limits mu N (n, nf) [N] at q (n, nq) [m, rad], lam (n, nc+nf) [N].

        Raises KernelError for an array of another shape.
        """
        return self._by_row("kernel_friction_limit", self.scene.nf, q=q, lam=lam)

    def acceleration(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, lam: np.ndarray
    ) -> np.ndarray:
        """Return accelerations (n, nq) [m/s^2, rad/s^2] of M dv/dt = tau(q, v, u) + J' lam + S' f.

        q, v (n, nq), u (n, nu), lam (n, nc+nf) contact, then friction forces. Raises KernelError if
        M is not positive definite, or for an array of another shape.
        """
        return self._by_row("kernel_acceleration", self.scene.nq, q=q, v=v, u=u, lam=lam)

    def rollout(
        self,
        start: np.ndarray,
        u: np.ndarray,
        step: float,
        law: ContactLaw = ContactLaw.RELU,
        eps: float | None = None,
    ) -> Rollout:
        """Simulate with constant inputs per step; NaN after a divergence.

        start is (2*nq,) [m, rad, m/s, rad/s], u (steps, nu) [N, N m], step [s], eps of softplus
        [-]. Raises KernelError for an array of another shape, RelaxationError unless 0 < eps < 1
        for softplus.
        """
        u, start = (
            self._array("u", u, None, self.scene.nu),
            self._array("start", start, 2 * self.scene.nq),
        )
        steps = len(u)
        q, v = np.empty((steps + 1, self.scene.nq)), np.empty((steps + 1, self.scene.nq))
        lam = np.empty((steps, self.scene.nl))
        done = self.library.kernel_rollout(
            *self.head(steps, step, law, eps),
            address(start),
            address(u),
            address(q),
            address(v),
            address(lam),
        )
        if done < steps:
            q[done + 1 :] = v[done + 1 :] = np.nan
            lam[done + 1 :] = np.nan
        return Rollout(q=q, v=v, lam=lam, finite_steps=done, step=step, law=law, eps=eps)

    def rollouts(
        self, start: np.ndarray, u: np.ndarray, step: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Simulate several motions under the true contact law; NaN after a divergence.

        start (rows, 2*nq) [m, rad, m/s, rad/s], u (rows, steps, nu) [N, N m], step [s]. Return lam
        (rows, steps, nc+nf) [N] and the last states (rows, 2*nq). Raises KernelError for an array
        of another shape.
        """
        rows, steps, _ = u.shape
        start, u = (
            self._array("start", start, rows, 2 * self.scene.nq),
            self._array("u", u, rows, steps, self.scene.nu),
        )
        q, v = (np.empty((rows, steps + 1, self.scene.nq)) for _ in range(2))
        lam, costs, ends = (
            np.empty((rows, steps, self.scene.nl)),
            np.empty(rows),
            np.empty((rows, 2 * self.scene.nq)),
        )
        arrays = (start, u, q, v, lam, costs, ends)
        self.library.kernel_rollouts(
            rows, *self.head(steps, step, ContactLaw.RELU, None), *map(address, arrays)
        )
        return lam, ends

    def adjoint(
        self,
        rollout: Rollout,
        u: np.ndarray,
        q_bar: np.ndarray | None = None,
        v_bar: np.ndarray | None = None,
        lam_bar: np.ndarray | None = None,
        cost_bar: float = 0.0,
        end_bar: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients of a loss along a rollout by u (steps, nu) and start (2*nq,).

        Derivatives of the loss that are None count as zero.
        q_bar, v_bar: (steps+1, nq), by positions and velocities [1/m, s/m and so on]
        lam_bar: (steps, nc+nf), by forces [1/N]
        cost_bar: by the cost of the task [-]
        end_bar: (2*nq,), by the last state, in addition to q_bar and v_bar
        Raises KernelError if M is not positive definite along the rollout, or for another shape.
        """
        u = self._array("u", u, len(rollout.lam), self.scene.nu)
        loss_bars = (
            ("q_bar", q_bar, rollout.q.shape),
            ("v_bar", v_bar, rollout.v.shape),
            ("lam_bar", lam_bar, rollout.lam.shape),
            ("end_bar", end_bar, (2 * self.scene.nq,)),
        )
        bars = [
            None if bar is None else self._array(name, bar, *shape)
            for name, bar, shape in loss_bars
        ]
        u_bar, start_bar = np.empty_like(u), np.empty(2 * self.scene.nq)
        failed = self.library.kernel_adjoint(
            *self.head(len(u), rollout.step, rollout.law, rollout.eps), address(rollout.q),
            address(rollout.v), address(rollout.lam), address(u),
            *(None if bar is None else address(bar) for bar in bars), cost_bar, address(u_bar),
            address(start_bar),
        )  # fmt: skip
        if failed:
            raise KernelError(
                f"scene {self.scene.name}: the mass matrix is not positive definite along the rollout."
            )
        return u_bar, start_bar

    def end_derivatives(
        self, start: np.ndarray, u: np.ndarray, step: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the last state's derivatives by start (2*nq, 2*nq) and constant inputs (2*nq, nu).

        The motion has start (2*nq,), u (steps, nu) [N, N m], step [s] and true contact. Raises
        KernelError if it diverges, if M is not positive definite, or for an array of another shape.
        """
        rollout, states = self.rollout(start, u, step), 2 * self.scene.nq
        if rollout.diverged:
            raise KernelError(
                f"scene {self.scene.name}: the true contact law leads out of every bound from {start.tolist()}."
            )
        u = self._array("u", u, None, self.scene.nu)
        by_start, by_inputs = np.empty((states, states)), np.empty((states, self.scene.nu))
        end_bar, start_bar, u_bar = np.zeros(states), np.empty(states), np.empty_like(u)
        # Addresses are computed once: `adjoint` per row takes three times as long.
        arguments = (
            *self.head(len(u), step, rollout.law, rollout.eps), address(rollout.q),
            address(rollout.v), address(rollout.lam), address(u), None, None, None,
            address(end_bar), 0.0, address(u_bar), address(start_bar),
        )  # fmt: skip
        for row in range(states):
            end_bar[row] = 1.0
            if self.library.kernel_adjoint(*arguments):
                raise KernelError(
                    f"scene {self.scene.name}: the mass matrix is not positive definite along the rollout."
                )
            end_bar[row] = 0.0
            by_start[row], by_inputs[row] = start_bar, u_bar.sum(axis=0)
        return by_start, by_inputs

    def energy(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return kinetic and potential energy (n,) [J], without contacts.

        q, v are (n, nq) [m, rad, m/s, rad/s]. Raises KernelError for an array of another shape.
        """
        energy = self._by_row("kernel_energy", 2, q=q, v=v)
        return energy[:, 0], energy[:, 1]

    def power(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the power of the inputs and the dissipated power, (n,) [W].

        q, v are (n, nq), u (n, nu) [N, N m]. Raises KernelError for an array of another shape.
        """
        power = self._by_row("kernel_power", 2, q=q, v=v, u=u)
        return power[:, 0], power[:, 1]

    def cost(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> float:
        """Return the running cost over the steps plus the final cost [-].

        q, v are (steps+1, nq), u (steps, nu) [N, N m]. Raises KernelError for an array of another
        shape.
        """
        u = self._array("u", u, None, self.scene.nu)
        q, v = (
            self._array("q", q, len(u) + 1, self.scene.nq),
            self._array("v", v, len(u) + 1, self.scene.nq),
        )
        return float(
            self.library.kernel_cost(len(u), address(self._p), address(q), address(v), address(u))
        )

    def head(
        self, n: int, step: float, law: ContactLaw, eps: float | None
    ) -> tuple[int, float, int, int, float]:
        """Return the first arguments of C functions of n time steps, after a number of plans."""
        return (
            n,
            step,
            address(self.parameters_of(step)),
            law.value,
            law_sharpness(law, eps, self.scene.length),
        )

    def _by_row(
        self, function: str, columns: int, *settings: float, **inputs: np.ndarray
    ) -> np.ndarray:
        """Return the result (n, columns) of a C function at arrays by name, row by row.

        Without columns the function may not exist.
        """
        n: int | None = None
        arrays: list[np.ndarray] = []
        for name, value in inputs.items():
            arrays.append(self._array(name, value, n, self._columns[name]))
            n = len(arrays[0])
        result = np.empty((len(arrays[0]), columns))
        done = (
            getattr(self.library, function)(
                n, address(self._p), *settings, *map(address, arrays), address(result)
            )
            if columns
            else None
        )
        if done is not None and done < len(result):
            raise KernelError(
                f"scene {self.scene.name}: the mass matrix is not positive definite at q = {arrays[0][done].tolist()}."
            )
        return result

    def _array(self, name: str, value: np.ndarray, *shape: int | None) -> np.ndarray:
        array = np.ascontiguousarray(value, dtype=np.float64)
        if array.ndim != len(shape) or any(
            size not in (None, found) for size, found in zip(shape, array.shape, strict=True)
        ):
            expected = str(tuple("n" if size is None else size for size in shape)).replace("'", "")
            raise KernelError(
                f"scene {self.scene.name}: {name} has shape {array.shape}, but {expected} is needed."
            )
        return array


def address(array: np.ndarray) -> int:
    """Return the address of an array (n,) [SI] of any shape, for the C functions.

    Raises AttributeError for an object that is no array.
    """
    return array.ctypes.data


def law_sharpness(law: ContactLaw, eps: float | None, length: float) -> float:
    """Return the sharpness [1/m] of softplus for the C functions, 0 for the true law.

    Raises RelaxationError unless 0 < eps < 1.
    """
    return 0.0 if law is ContactLaw.RELU else sharpness(eps if eps is not None else 0.0, length)
