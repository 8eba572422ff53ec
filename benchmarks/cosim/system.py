"""The FMUs of a split scene, loaded and wired: what a master steps.

    with coupled(scene, inner_step=1e-5) as system:
        system.begin(start, u)
        motion = jacobi(system, h=1e-3, steps=1000)

All outputs of all parts stand in one vector `system.values`; each part knows which of them are its
inputs.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.fmu import build_fmu
from models.fmu.coupled import ContactPart, Parts, build_part, split
from models.scene import Scene
from validate.fmi.description import Package, read_package, unpacked
from validate.fmi.instance import Instance, References, load_instance


class Part:
    """One FMU of the system. reads (inputs,): places of its inputs in the vector of all outputs.

    writes: the slice that its outputs fill.
    """

    def __init__(
        self,
        package: Package,
        inputs: Sequence[str],
        outputs: Sequence[str],
        reads: Sequence[int],
        first: int,
    ) -> None:
        self._package = package
        self._by_name = {
            variable.name: int(variable.valueReference)
            for variable in package.description.modelVariables
        }
        self.inputs = References([self._by_name[name] for name in inputs])
        self.outputs = References([self._by_name[name] for name in outputs])
        self.input_names = tuple(inputs)
        self.reads = np.array(reads, dtype=int)
        self.writes = slice(first, first + len(outputs))
        self.fmu: Instance
        self._is_open = False
        self._saved: Any = ctypes.c_void_p()

    def begin(self, settings: dict[str, float]) -> None:
        """A fresh instance at t = 0 with these values; what the FMU does not have is left out."""
        self.close()
        self.fmu, self._is_open = load_instance(self._package, "CS"), True
        known = [
            (self._by_name[name], value)
            for name, value in settings.items()
            if name in self._by_name
        ]
        self.fmu.initialise(0.0, known, References([]), np.empty(0))

    def set_inputs(self, values: np.ndarray) -> None:
        """From the vector of all outputs."""
        self.fmu.write(self.inputs, values[self.reads])

    def set_slopes(self, rates: np.ndarray) -> None:
        """Let the inputs run as lines during the next step, at these rates of the vector of all outputs."""
        if self.inputs.count:
            self.fmu.fmu.setRealInputDerivatives(
                self.inputs.array, [1] * self.inputs.count, rates[self.reads]
            )

    def get_outputs(self, values: np.ndarray) -> None:
        values[self.writes] = self.fmu.read(self.outputs)

    def step(self, n: int, h: float) -> None:
        """Step n of length h [s]; times are taken from the grid, never summed up."""
        self.fmu.do_step(n * h, h)

    def save(self) -> None:
        self.fmu.save(self._saved)

    def restore(self) -> None:
        self.fmu.restore(self._saved)

    def close(self) -> None:
        if not self._is_open:
            return
        if self._saved:
            self.fmu.forget(self._saved)
        self.fmu.unload()
        self._is_open = False


@dataclass
class System:
    """bodies and contacts; values: all their outputs.

    States (2 nq,), forces: places in it of the scene's positions and velocities, of forces.

    inner_step: what the bodies integrate with, by their own fourth-order Runge-Kutta method [s].
    """

    scene: Scene
    bodies: list[Part]
    contacts: list[Part]
    values: np.ndarray
    states: np.ndarray
    forces: np.ndarray
    inner_step: float

    @property
    def parts(self) -> list[Part]:
        return [*self.bodies, *self.contacts]

    def begin(self, start: np.ndarray, u: np.ndarray) -> None:
        """All parts at t = 0: start (2 nq,) of the scene, u (nu,) held for the whole run.

        Outputs consistent with each other.
        """
        scene = self.scene
        names = [item.name for item in scene.coordinates] + [
            item.velocity_name for item in scene.coordinates
        ]
        settings = {item.name: item.value for item in scene.parameters} | dict(
            zip(names, start.tolist(), strict=True)
        )
        settings |= {
            item.name: float(value) for item, value in zip(scene.inputs, u, strict=True)
        } | {"internal_step": self.inner_step}
        for part in self.parts:
            part.begin(settings)
        for part in self.parts:
            part.get_outputs(self.values)


@contextmanager
def coupled(scene: Scene, inner_step: float) -> Iterator[System]:
    """The parts of a scene as FMUs for Co-Simulation. inner_step: the bodies' own step [s].

    Raises SceneError, MachineError, FmuError.
    """
    scene = scene.continuous()
    parts = split(scene)
    with ExitStack() as stack:
        outputs = _outputs(parts)
        place = {
            key: index
            for index, key in enumerate(
                (name, item) for name, items in outputs.items() for item in items
            )
        }
        made: dict[str, Part] = {}
        for source in (*parts.bodies, *parts.contacts):
            wires = [item for item in parts.connections if item.target == source.name]
            made[source.name] = Part(
                stack.enter_context(_opened(build_part(source))),
                [item.input for item in wires],
                outputs[source.name],
                [place[item.source, item.output] for item in wires],
                place[source.name, outputs[source.name][0]],
            )
            stack.callback(made[source.name].close)
        home = {item.name: body.name for body in parts.bodies for item in body.coordinates}
        states = [place[home[item.name], item.name] for item in scene.coordinates]
        states += [place[home[item.name], item.velocity_name] for item in scene.coordinates]
        yield System(
            scene=scene,
            bodies=[made[body.name] for body in parts.bodies],
            contacts=[made[part.name] for part in parts.contacts],
            values=np.zeros(len(place)),
            states=np.array(states),
            forces=np.array(
                [
                    index
                    for (name, _), index in place.items()
                    if name in {part.name for part in parts.contacts}
                ]
            ),
            inner_step=inner_step,
        )


@contextmanager
def whole(scene: Scene, inner_step: float) -> Iterator[System]:
    """The scene as one FMU, as a system of a single body: what it costs to keep the contact inside."""
    scene = scene.continuous()
    names = [item.name for item in scene.coordinates] + [
        item.velocity_name for item in scene.coordinates
    ]
    with _opened(build_fmu(scene)) as package:
        part = Part(package, [], names, [], 0)
        try:
            yield System(
                scene,
                [part],
                [],
                np.zeros(len(names)),
                np.arange(len(names)),
                np.empty(0, dtype=int),
                inner_step,
            )
        finally:
            part.close()


@contextmanager
def _opened(path: Path) -> Iterator[Package]:
    with unpacked(read_package(path)) as package:
        yield package


def _outputs(parts: Parts) -> dict[str, list[str]]:
    """Name of a part -> its outputs that something is connected to, and the state of bodies."""
    outputs = {
        body.name: [name for item in body.coordinates for name in (item.name, item.velocity_name)]
        for body in parts.bodies
    }
    return outputs | {part.name: _forces(part) for part in parts.contacts}


def _forces(part: ContactPart) -> list[str]:
    return [part.force_name(item) for item in part.coordinates]
