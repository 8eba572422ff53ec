"""The numbers a simulation recorded, taken apart by name; what the FMU does not give is computed from the scene's own equations."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from models.codegen.kernel import Kernel, load_kernel
from models.scene import Scene
from validate.replay.reference import Run
from validate.replay.subject import Subject
from validate.replay.wiring import ENERGIES, Variables


class Outputs:
    """q, v (n, nq), lam, gap (n, nc), friction (n, nf), zero where the FMU does not give it,, kinetic, potential, contact energy (n,) of a run, at all its points or at some rows."""

    def __init__(self, scene: Subject, variables: Variables, run: Run, rows: list[int] | None = None) -> None:
        self._scene, self._variables = scene, variables
        known = isinstance(scene, Scene)
        chosen = slice(None) if rows is None else rows
        values = np.array(run.outputs).reshape(len(run.t), len(variables.outputs))[chosen]
        self._count = len(values)
        references = variables.outputs
        nq, nc = scene.nq, scene.nc
        first = nq + len(variables.v)
        at = first + len(variables.lam)
        zeros = np.zeros((self._count, nc))  # of a foreign model, for what its `lacks` names
        self.q = values[:, :nq].copy()
        self.v = values[:, nq:first].copy() if variables.v or not nq else np.zeros((self._count, nq))
        self.lam = (
            values[:, first:at].copy() if variables.lam or not nc else self._kernel.contact_force(self.q, v=self.v) if known else zeros
        )
        self.gap = values[:, at : at + nc].copy() if variables.gap or not nc else -self._kernel.penetration(self.q) if known else zeros
        at += len(variables.gap)
        self.friction = values[:, at : at + scene.nf].copy() if variables.friction else np.zeros((self._count, scene.nf))
        first_energy = len(references) - len(variables.energies)
        given = {name: values[:, first_energy + index].copy() for index, name in enumerate(variables.energies)}
        self.kinetic, self.potential, self.contact = (self._energy(name, given) for name in ENERGIES)
        self._accumulated = None
        if run.accumulated:
            self._accumulated = np.array(run.accumulated).reshape(len(run.t), len(variables.rates))[chosen]

    @property
    def contact_impulse(self) -> np.ndarray | None:
        """(n, nc) since the start; None where it was not integrated."""
        if self._accumulated is None or len(self._variables.lam) != self._scene.nc:
            return None
        return self._accumulated[:, : self._scene.nc].copy()

    def work(self, power: str) -> np.ndarray | None:
        """(n,) since the start, of one of the powers; None where it was not integrated."""
        if power in self._variables.zero:
            return np.zeros(self._count)
        if self._accumulated is None or power not in self._variables.powers:
            return None
        return self._accumulated[:, len(self._variables.lam) + list(self._variables.powers).index(power)].copy()

    def _energy(self, name: str, given: dict[str, np.ndarray]) -> np.ndarray:
        if name in given:
            return given[name]
        if name in self._variables.zero or not isinstance(self._scene, Scene):
            return np.zeros(self._count)
        if name == "contact_energy":
            return (np.maximum(-self.gap, 0.0) ** 2 @ self._kernel.stiffness()) / 2
        kinetic, potential = self._kernel.energy(self.q, self.v)
        return np.array(kinetic if name == "kinetic_energy" else potential)

    @cached_property
    def _kernel(self) -> Kernel:
        if not isinstance(self._scene, Scene):
            raise TypeError(f"{self._scene.name} is no scene: it has no equations to compute from.")
        return load_kernel(self._scene)
