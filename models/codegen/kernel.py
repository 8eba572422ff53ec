"""The compiled time step of a scene and its adjoint, as numpy functions.

    kernel = load_kernel(scene)
    rollout = kernel.rollout(scene.task.start, u, step=0.01)                     # true (ReLU) contact
    rollout = kernel.rollout(start, u, step=0.01, law=ContactLaw.SOFTPLUS, eps=1e-3)
    u_bar, start_bar = kernel.adjoint(rollout, u, q_bar=..., v_bar=...)          # gradient of any loss of q, v, lam

Semi-implicit Euler with the paper's indices: lam[t] = L(phi(q[t])), v[t+1] = v[t] + h a[t], q[t+1] = q[t] + h v[t+1];
friction forces belong to the slip at the end of the step (friction.h) and stand behind the contact forces in lam.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from models.codegen.cache import cached
from models.codegen.compiler import FLAGS, compile_shared, find_compiler
from models.codegen.emit import damping_source, for_scene, friction_source, model_source
from models.contact_law import ContactLaw, sharpness
from models.errors import TouchstoneError
from models.scene import Scene

_SOURCE = Path(__file__).with_name("rollout.c")
# The adjoint takes 0.6 of its time at -O2, and the same operations in the same order: equal bits. Compiling takes a fifth longer.
_OPTIMISED = ("-O3",)

# Result and arguments of the C functions: n a count or law, d a double, p the address of doubles. Addresses are passed as
# plain integers: a ctypes pointer object for each of them would cost more than the rollout itself.
_TYPES = {"n": ctypes.c_int, "d": ctypes.c_double, "p": ctypes.c_void_p}
_FRICTION_SIGNATURES = {"slip": (None, "npppp"), "friction_limit": (None, "npppp")}
_DAMPING_SIGNATURES = {"damped_contact_force": (None, "npndppp"), "contact_push": (None, "npppp")}
_SIGNATURES = {
    "rollout": (ctypes.c_int, "ndpndppppp"),
    "adjoint": (ctypes.c_int, "ndpndppppppppdpp"),
    "rollouts": (None, "nndpndppppppp"),
    "adjoints": (ctypes.c_int, "nndpnd" + "p" * 11),
    "penetration": (None, "nppp"),
    "contact_force": (None, "npndpp"),
    "stiffness": (None, "pp"),
    "acceleration": (ctypes.c_int, "npppppp"),
    "acceleration_jvp": (ctypes.c_int, "p" * 10),
    "penetration_jvp": (None, "pppp"),
    "energy": (None, "npppp"),
    "power": (None, "nppppp"),
    "cost": (ctypes.c_double, "npppp"),
}


class KernelError(TouchstoneError):
    """Arrays that do not fit the scene, or a mass matrix that is not positive definite."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rollout:
    """q, v: (steps+1, nq); lam: (steps, nc+nf) contact, then friction forces; finite_steps: how many steps stayed finite (all, unless it diverged).

    step [s], law and eps are those it was made with; rows after a divergence are NaN.
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
        """Whether a state stopped being finite before the last step."""
        return self.finite_steps < len(self.lam)


class BoundFunctions(NamedTuple):
    """The C functions of rollout.c: counts and numbers as they are, arrays as addresses of float64, row-major."""

    rollout: Callable[..., int]
    adjoint: Callable[..., int]


class BatchFunctions(NamedTuple):
    """The same for several plans in one call. head: the arguments of both after the number of rows. Addresses of gradients may be None: zero."""

    rollouts: Callable[..., None]
    adjoints: Callable[..., int]
    head: tuple[int, float, int, int, float]


def load_kernel(scene: Scene) -> Kernel:
    """Compile (or find in the cache) the kernel of a scene. Raises MachineError without a compiler."""
    compiler, sources = find_compiler(), kernel_sources(scene)
    key = "\n".join([compiler.describe(), " ".join((*FLAGS, *_OPTIMISED)), *(f"{name}\n{text}" for name, text in sorted(sources.items()))])
    library = cached(key, ".so", lambda path: compile_shared(compiler, sources, path, extra_flags=_OPTIMISED))
    return Kernel(scene, library)


def kernel_sources(scene: Scene) -> dict[str, str]:
    """File name -> text of the C sources of a scene's kernel."""
    sources = {"scene_model.h": model_source(scene), "rollout.c": for_scene(scene, _SOURCE.read_text(encoding="utf-8"))}
    if scene.nf:
        sources["friction.h"] = friction_source()
    if scene.damped:
        sources["damping.h"] = damping_source()
    return sources


class Kernel:
    """Numpy functions over the compiled kernel of one scene; see the module docstring. All arrays are float64."""

    def __init__(self, scene: Scene, library: Path) -> None:
        self.scene = scene
        self.path = library
        self._library = ctypes.CDLL(str(library))
        signatures = _SIGNATURES | (_FRICTION_SIGNATURES if scene.nf else {}) | (_DAMPING_SIGNATURES if scene.damped else {})
        for name, (result, arguments) in signatures.items():
            function = getattr(self._library, f"kernel_{name}")
            function.restype, function.argtypes = result, [_TYPES[letter] for letter in arguments]
        values = [parameter.value for parameter in scene.parameters]
        self._p = np.array(values or [0.0])
        self._p_of_step: dict[float, np.ndarray] = {}

    def parameters_of(self, step: float) -> np.ndarray:
        """`parameters` for time steps of that length, which is the relaxation time of a scene without inertia (models.scene.quasi_static).

        Parameters
        ----------
        step
            Length of a step [s].

        Returns
        -------
        np.ndarray
            Values (np,), each in its own unit [SI]; kept as long as the kernel, for callers that hold its address.
        """
        index = self.scene.relaxation_index
        if index is None or self._p[index] == step:
            return self._p
        if step not in self._p_of_step:  # kept as long as the kernel: others have its address
            self._p_of_step[step] = self._p.copy()
            self._p_of_step[step][index] = step
        return self._p_of_step[step]

    @property
    def parameters(self) -> np.ndarray:
        """Parameter values (np,) of the scene, each in its own unit [SI], as the C functions read them."""
        return self._p

    def bound_functions(self) -> BoundFunctions:
        """The C functions themselves, for callers that keep their own buffers and addresses (validate.judge.replay.tracking)."""
        return BoundFunctions(self._library.kernel_rollout, self._library.kernel_adjoint)

    def batch_functions(self, steps: int, step: float, law: ContactLaw, eps: float | None) -> BatchFunctions:
        """The C functions for several plans in one call (formulations.shooting.rollout)."""
        head = (steps, step, address(self.parameters_of(step)), law.value, law_sharpness(law, eps, self.scene.length))
        return BatchFunctions(self._library.kernel_rollouts, self._library.kernel_adjoints, head)

    def penetration(self, q: np.ndarray) -> np.ndarray:
        """Penetration of each contact, positive in contact.

        Parameters
        ----------
        q
            Positions (n, nq) [m, rad].

        Returns
        -------
        np.ndarray
            phi (n, nc) [m].

        Raises
        ------
        KernelError
            Where an array has another shape.
        """
        q = self._array("q", q, self.scene.nq)
        phi = np.empty((len(q), self.scene.nc))
        self._library.kernel_penetration(len(q), address(self._p), address(q), address(phi))
        return phi

    def stiffness(self) -> np.ndarray:
        """Stiffness k (nc,) of each contact [N/m]."""
        k = np.empty(self.scene.nc)
        self._library.kernel_stiffness(address(self._p), address(k))
        return k

    def contact_force(
        self, q: np.ndarray, law: ContactLaw = ContactLaw.RELU, eps: float | None = None, *, v: np.ndarray | None = None
    ) -> np.ndarray:
        """Contact forces under a law.

        Parameters
        ----------
        q
            Positions (n, nq) [m, rad].
        law, eps
            The contact law, and the relaxation of a softplus [-].
        v
            Velocities (n, nq) [m/s, rad/s], which damped contacts depend on; None is at rest.

        Returns
        -------
        np.ndarray
            lam (n, nc) [N].

        Raises
        ------
        KernelError
            Where an array has another shape.
        RelaxationError
            Unless 0 < eps < 1, of a relaxed law.
        """
        q = self._array("q", q, self.scene.nq)
        lam = np.empty((len(q), self.scene.nc))
        head = (len(q), address(self._p), law.value, law_sharpness(law, eps, self.scene.length), address(q))
        if self.scene.damped:
            v = self._array("v", np.zeros_like(q) if v is None else v, self.scene.nq, len(q))
            self._library.kernel_damped_contact_force(*head, address(v), address(lam))
        else:
            self._library.kernel_contact_force(*head, address(lam))
        return lam

    def contact_push(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """What the true contact force is the positive part of: k phi without damping.

        Parameters
        ----------
        q
            Positions (n, nq) [m, rad].
        v
            Velocities (n, nq) [m/s, rad/s].

        Returns
        -------
        np.ndarray
            Pushes (n, nc) [N].

        Raises
        ------
        KernelError
            Where an array has another shape.
        """
        q, v = self._array("q", q, self.scene.nq), self._array("v", v, self.scene.nq)
        if not self.scene.damped:
            return self.stiffness() * self.penetration(q)
        push = np.empty((len(q), self.scene.nc))
        self._library.kernel_contact_push(len(q), address(self._p), address(q), address(v), address(push))
        return push

    def slip(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Slip speed of each friction.

        Parameters
        ----------
        q
            Positions (n, nq) [m, rad].
        v
            Velocities (n, nq) [m/s, rad/s].

        Returns
        -------
        np.ndarray
            s (n, nf) [m/s].

        Raises
        ------
        KernelError
            Where an array has another shape.
        """
        q, v = self._array("q", q, self.scene.nq), self._array("v", v, self.scene.nq)
        slip = np.empty((len(q), self.scene.nf))
        if self.scene.nf:
            self._library.kernel_slip(len(q), address(self._p), address(q), address(v), address(slip))
        return slip

    def friction_limit(self, q: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """The largest friction forces, mu N.

        Parameters
        ----------
        q
            Positions (n, nq) [m, rad].
        lam
            Contact, then friction forces (n, nc+nf) [N].

        Returns
        -------
        np.ndarray
            Limits (n, nf) [N].

        Raises
        ------
        KernelError
            Where an array has another shape.
        """
        q = self._array("q", q, self.scene.nq)
        lam, limit = self._array("lam", lam, self.scene.nl, len(q)), np.empty((len(q), self.scene.nf))
        if self.scene.nf:
            self._library.kernel_friction_limit(len(q), address(self._p), address(q), address(lam), address(limit))
        return limit

    def acceleration(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Accelerations dv/dt of M dv/dt = tau(q, v, u) + J' lam + S' f, row by row.

        Parameters
        ----------
        q
            Positions (n, nq) [m, rad].
        v
            Velocities (n, nq) [m/s, rad/s].
        u
            Inputs (n, nu) [N, N m].
        lam
            Contact, then friction forces (n, nc+nf) [N].

        Returns
        -------
        np.ndarray
            Accelerations (n, nq) [m/s^2, rad/s^2].

        Raises
        ------
        KernelError
            Where M is not positive definite, or an array has another shape.
        """
        q, v = self._array("q", q, self.scene.nq), self._array("v", v, self.scene.nq)
        u, lam = self._array("u", u, self.scene.nu, len(q)), self._array("lam", lam, self.scene.nl, len(q))
        a = np.empty((len(q), self.scene.nq))
        done = self._library.kernel_acceleration(len(q), address(self._p), address(q), address(v), address(u), address(lam), address(a))
        if done < len(q):
            raise KernelError(f"scene {self.scene.name}: the mass matrix is not positive definite at q = {q[done].tolist()}.")
        return a

    def rollout(
        self, start: np.ndarray, u: np.ndarray, step: float, law: ContactLaw = ContactLaw.RELU, eps: float | None = None
    ) -> Rollout:
        """Simulate with inputs that are held over each step.

        Parameters
        ----------
        start
            State (2*nq,): positions [m, rad], then velocities [m/s, rad/s].
        u
            Inputs (steps, nu) [N, N m].
        step
            Length of a step [s].
        law, eps
            The contact law, and the relaxation of a softplus [-].

        Returns
        -------
        Rollout
            The motion and its forces; NaN behind a divergence.

        Raises
        ------
        KernelError
            Where an array has another shape.
        RelaxationError
            Unless 0 < eps < 1, of a relaxed law.
        """
        u = self._array("u", u, self.scene.nu)
        start = self._array("start", np.atleast_2d(start), 2 * self.scene.nq)
        steps = len(u)
        q, v = np.empty((steps + 1, self.scene.nq)), np.empty((steps + 1, self.scene.nq))
        lam = np.empty((steps, self.scene.nl))
        done = self._library.kernel_rollout(
            steps, step, address(self.parameters_of(step)), law.value, law_sharpness(law, eps, self.scene.length), address(start), address(u), address(q), address(v), address(lam)
        )  # fmt: skip
        if done < steps:
            q[done + 1 :] = v[done + 1 :] = np.nan
            lam[done + 1 :] = np.nan
        return Rollout(q=q, v=v, lam=lam, finite_steps=done, step=step, law=law, eps=eps)

    def rollouts(self, start: np.ndarray, u: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Simulate several motions under the true contact law; a row that diverges is NaN from there on.

        Parameters
        ----------
        start
            States (rows, 2*nq): positions [m, rad], then velocities [m/s, rad/s].
        u
            Inputs (rows, steps, nu) [N, N m].
        step
            Length of a step [s].

        Returns
        -------
        lam
            Forces (rows, steps, nc+nf) [N].
        ends
            Last states (rows, 2*nq).

        Raises
        ------
        KernelError
            Where an array has another shape.
        """
        rows, steps, _ = u.shape
        start, u = self._array("start", start, 2 * self.scene.nq, rows), np.ascontiguousarray(u, dtype=np.float64)
        q, v = (np.empty((rows, steps + 1, self.scene.nq)) for _ in range(2))
        lam, costs, ends = np.empty((rows, steps, self.scene.nl)), np.empty(rows), np.empty((rows, 2 * self.scene.nq))
        functions = self.batch_functions(steps, step, ContactLaw.RELU, None)
        functions.rollouts(rows, *functions.head, *(address(array) for array in (start, u, q, v, lam, costs, ends)))
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
        """Gradients of a loss along a rollout, from its derivatives by what the rollout gave; None where it does not depend on that.

        Parameters
        ----------
        rollout
            The rollout, whose step and law are taken.
        u
            Its inputs (steps, nu) [N, N m].
        q_bar, v_bar
            Derivatives (steps+1, nq) by positions and velocities [1/m, s/m and so on, per unit of the loss].
        lam_bar
            Derivatives (steps, nc+nf) by forces [1/N].
        cost_bar
            Derivative by the cost of the task [-].
        end_bar
            Derivatives (2*nq,) by the last state, beside q_bar and v_bar.

        Returns
        -------
        u_bar
            Gradient (steps, nu) by the inputs.
        start_bar
            Gradient (2*nq,) by the start.

        Raises
        ------
        KernelError
            Where M is not positive definite along the rollout, or an array has another shape.
        """
        u = self._array("u", u, self.scene.nu, len(rollout.lam))
        given = (
            ("q_bar", q_bar, rollout.q.shape),
            ("v_bar", v_bar, rollout.v.shape),
            ("lam_bar", lam_bar, rollout.lam.shape),
            ("end_bar", None if end_bar is None else np.atleast_2d(end_bar), (1, 2 * self.scene.nq)),
        )
        bars = [None if bar is None else self._array(name, bar, columns, rows) for name, bar, (rows, columns) in given]
        u_bar, start_bar = np.empty_like(u), np.empty(2 * self.scene.nq)
        failed = self._library.kernel_adjoint(
            len(u), rollout.step, address(self.parameters_of(rollout.step)), rollout.law.value, law_sharpness(rollout.law, rollout.eps, self.scene.length), address(rollout.q), address(rollout.v),
            address(rollout.lam), address(u), *(None if bar is None else address(bar) for bar in bars), cost_bar, address(u_bar), address(start_bar),
        )  # fmt: skip
        if failed:
            raise KernelError(f"scene {self.scene.name}: the mass matrix is not positive definite along the rollout.")
        return u_bar, start_bar

    def acceleration_jvp(self, point: tuple[np.ndarray, ...], tangent: tuple[np.ndarray, ...]) -> np.ndarray:
        """Directional derivative of the acceleration.

        Parameters
        ----------
        point
            q, v (nq,), u (nu,), lam (nc+nf,), where it is taken [m, m/s, N, N].
        tangent
            dq, dv, du, dlam of the same shapes.

        Returns
        -------
        np.ndarray
            Derivative (nq,) of the acceleration [m/s^2, rad/s^2].

        Raises
        ------
        KernelError
            Where an array has another shape.
        """
        sizes = (self.scene.nq, self.scene.nq, self.scene.nu, self.scene.nl)
        arrays = [self._array("point", np.atleast_2d(part), size) for part, size in zip((*point, *tangent), sizes * 2, strict=True)]
        result = np.empty(self.scene.nq)
        self._library.kernel_acceleration_jvp(address(self._p), *(address(array) for array in arrays), address(result))
        return result

    def energy(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Kinetic and potential energy, without what contacts store.

        Parameters
        ----------
        q
            Positions (n, nq) [m, rad].
        v
            Velocities (n, nq) [m/s, rad/s].

        Returns
        -------
        kinetic, potential
            Energies (n,) [J].

        Raises
        ------
        KernelError
            Where an array has another shape.
        """
        q, v = self._array("q", q, self.scene.nq), self._array("v", v, self.scene.nq)
        energy = np.empty((len(q), 2))
        self._library.kernel_energy(len(q), address(self._p), address(q), address(v), address(energy))
        return energy[:, 0], energy[:, 1]

    def power(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Power of the inputs, and dissipated power.

        Parameters
        ----------
        q
            Positions (n, nq) [m, rad].
        v
            Velocities (n, nq) [m/s, rad/s].
        u
            Inputs (n, nu) [N, N m].

        Returns
        -------
        inputs, dissipated
            Powers (n,) [W].

        Raises
        ------
        KernelError
            Where an array has another shape.
        """
        q, v, u = self._array("q", q, self.scene.nq), self._array("v", v, self.scene.nq), self._array("u", u, self.scene.nu)
        power = np.empty((len(q), 2))
        self._library.kernel_power(len(q), address(self._p), address(q), address(v), address(u), address(power))
        return power[:, 0], power[:, 1]

    def cost(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> float:
        """Sum of the running cost over the steps, and the cost of the last state.

        Parameters
        ----------
        q, v
            Positions and velocities (steps+1, nq) [m, rad, m/s, rad/s].
        u
            Inputs (steps, nu) [N, N m].

        Returns
        -------
        float
            The cost, in the unit that the task weighs with [-].

        Raises
        ------
        KernelError
            Where an array has another shape.
        """
        u = self._array("u", u, self.scene.nu)
        q, v = self._array("q", q, self.scene.nq, len(u) + 1), self._array("v", v, self.scene.nq, len(u) + 1)
        return float(self._library.kernel_cost(len(u), address(self._p), address(q), address(v), address(u)))

    def _array(self, name: str, value: np.ndarray, columns: int, rows: int | None = None) -> np.ndarray:
        array = np.ascontiguousarray(value, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] != columns or (rows is not None and array.shape[0] != rows):
            expected = f"({'n' if rows is None else rows}, {columns})"
            raise KernelError(f"scene {self.scene.name}: {name} has shape {array.shape}, but {expected} is needed.")
        return array


def address(array: np.ndarray) -> int:
    """Address of the first entry of an array of any shape (n, ..) and unit, as the C functions take it."""
    return array.ctypes.data


def law_sharpness(law: ContactLaw, eps: float | None, length: float) -> float:
    """Sharpness [1/m] of a relaxed law, as the C functions take it; 0 of the true one. Raises RelaxationError unless 0 < eps < 1."""
    return 0.0 if law is ContactLaw.RELU else sharpness(eps if eps is not None else 0.0, length)
