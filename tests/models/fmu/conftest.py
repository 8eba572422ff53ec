"""FMUs under test: built once a scene, driven through FMPy's low-level classes, compared with numpy."""

from __future__ import annotations

import runpy
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import fmpy
import numpy as np
import pytest
from example_scenes import example_scene
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Model, FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Model, FMU3Slave

from models.catalog import scene_path
from models.dynamics import derive
from models.fmu import build_fmu, variable_names
from models.scene import Scene

NAMES = ("three_cart", "bouncing_mass", "two_body_collision", "two_link_arm", "oscillator")


class Driver:
    """One instance of an FMU, by variable names. `log` collects (status, category, message)."""

    # in the names of FMI's functions
    prefix = "fmi2"
    doubles = "Real"
    rates = "GetDerivatives"

    def __init__(
        self,
        scene: Scene,
        folder: str,
        kind: type,
        *,
        guid: str | None = None,
        logging: bool = False,
    ) -> None:
        self._prepare(scene, folder, kind, guid)
        self._callbacks = fmi2CallbackFunctions()
        self._callbacks.logger = fmi2CallbackLoggerTYPE(
            lambda environment, name, status, category, message: self.log.append(
                (status, category.decode(), message.decode())
            )
        )
        self.fmu.instantiate(callbacks=self._callbacks, loggingOn=logging)

    def _prepare(self, scene: Scene, folder: str, kind: type, guid: str | None = None) -> None:
        self.scene, self.names = scene, variable_names(scene)
        self.description = fmpy.read_model_description(folder)
        self.references = {
            variable.name: variable.valueReference for variable in self.description.modelVariables
        }
        self.log: list[tuple[int, str, str]] = []
        guid = guid or self.description.guid or self.description.instantiationToken
        self.fmu: Any = kind(
            guid=guid,
            unzipDirectory=folder,
            modelIdentifier=scene.name,
            instanceName="under 100 % test",
        )

    def close(self) -> None:
        if self.fmu.component is not None:
            getattr(self.fmu, f"{self.prefix}FreeInstance")(self.fmu.component)
            self.fmu.component = None

    def vr(self, names: tuple[str, ...] | list[str]) -> list[int]:
        return [self.references[name] for name in names]

    def get(self, *names: str) -> np.ndarray:
        return np.array(getattr(self.fmu, f"get{self.doubles}")(self.vr(names)))

    def set(self, **values: float) -> None:
        getattr(self.fmu, f"set{self.doubles}")(self.vr(list(values)), list(values.values()))

    def set_all(self, names: tuple[str, ...], values: np.ndarray) -> None:
        if names:
            self.set(**dict(zip(names, map(float, values), strict=True)))

    def directional(
        self, unknowns: tuple[str, ...], knowns: tuple[str, ...], seed: np.ndarray
    ) -> np.ndarray:
        return np.array(
            self.fmu.getDirectionalDerivative(self.vr(unknowns), self.vr(knowns), list(seed))
        )

    def enter_initialization(self, stop: float | None) -> None:
        self.fmu.setupExperiment(startTime=0.0, stopTime=stop)
        self.fmu.enterInitializationMode()

    def initialise(
        self,
        q: Any = None,
        v: Any = None,
        u: Any = None,
        stop: float | None = None,
        **values: float,
    ) -> Driver:
        self.enter_initialization(stop)
        for names, given in ((self.names.q, q), (self.names.v, v), (self.names.u, u)):
            if given is not None:
                self.set_all(names, given)
        self.set(**values)
        self.fmu.exitInitializationMode()
        return self

    # Model Exchange

    def continuous(self, q: Any = None, v: Any = None, u: Any = None) -> Driver:
        self.initialise(q, v, u)
        self.update_modes()
        self.fmu.enterContinuousTimeMode()
        return self

    def update_modes(self) -> None:
        self.fmu.newDiscreteStates()

    def _array(self, call: str, size: int) -> np.ndarray:
        array = np.full(size, np.nan)
        getattr(self.fmu, self.prefix + call)(
            self.fmu.component, array.ctypes.data_as(_DOUBLES), size
        )
        return array

    @property
    def states(self) -> np.ndarray:
        return self._array("GetContinuousStates", 2 * self.scene.nq)

    @states.setter
    def states(self, x: np.ndarray) -> None:
        array = np.ascontiguousarray(x, dtype=float)
        getattr(self.fmu, f"{self.prefix}SetContinuousStates")(
            self.fmu.component, array.ctypes.data_as(_DOUBLES), array.size
        )

    @property
    def derivatives(self) -> np.ndarray:
        return self._array(self.rates, 2 * self.scene.nq)

    @property
    def indicators(self) -> np.ndarray:
        return self._array("GetEventIndicators", self.scene.nc)

    @property
    def nominals(self) -> np.ndarray:
        return self._array("GetNominalsOfContinuousStates", 2 * self.scene.nq)

    def event(self) -> None:
        self.fmu.enterEventMode()
        self.update_modes()
        self.fmu.enterContinuousTimeMode()

    # Co-Simulation

    def run(self, end: float, steps: int, start: float = 0.0) -> Driver:
        for n in range(steps):
            begin = start + (end - start) * n / steps
            self.fmu.doStep(begin, start + (end - start) * (n + 1) / steps - begin)
        return self

    def state(self) -> np.ndarray:
        return self.get(*self.names.q, *self.names.v)

    def refused(self, call: Callable[[], Any], *words: str) -> None:
        """The call must return an error and log one sentence with these words."""
        count = len(self.log)
        with pytest.raises(FMICallException):
            call()
        assert len(self.log) == count + 1, self.log[count:]
        status, category, message = self.log[-1]
        assert (status, category) == (3, "logStatusError")
        assert message.endswith(".")
        for word in words:
            assert word in message, message


class Driver3(Driver):
    """As Driver, for FMI 3.0."""

    prefix = "fmi3"
    doubles = "Float64"
    rates = "GetContinuousStateDerivatives"

    def __init__(self, scene: Scene, folder: str, kind: type, **options: Any) -> None:
        self._prepare(scene, folder, kind)

        def log(environment: Any, status: int, category: bytes, message: bytes) -> None:
            self.log.append((status, category.decode(), message.decode()))

        self.fmu.instantiate(logMessage=log, **options)

    def adjoint(
        self, unknowns: tuple[str, ...], knowns: tuple[str, ...], seed: np.ndarray
    ) -> np.ndarray:
        return np.array(
            self.fmu.getAdjointDerivative(
                self.vr(unknowns), self.vr(knowns), list(seed), nSensitivity=len(knowns)
            )
        )

    def enter_initialization(self, stop: float | None) -> None:
        self.fmu.enterInitializationMode(startTime=0.0, stopTime=stop)

    def update_modes(self) -> None:
        self.fmu.updateDiscreteStates()


_DOUBLES = fmpy.fmi2.POINTER(fmpy.fmi2.c_double)
_KINDS = {
    ("2.0", "me"): (Driver, FMU2Model),
    ("2.0", "cs"): (Driver, FMU2Slave),
    ("3.0", "me"): (Driver3, FMU3Model),
    ("3.0", "cs"): (Driver3, FMU3Slave),
}


@dataclass(frozen=True)
class Reference:
    """The scene's equations in numpy, with the true contact law."""

    scene: Scene

    def value(self, what: str, *groups: str) -> Callable[..., np.ndarray]:
        d = derive(self.scene)
        expression = getattr(d, what)
        return d.function(
            expression if hasattr(expression, "shape") else [expression],
            *(getattr(d, group) for group in groups),
        )

    def penetration(self, q: np.ndarray) -> np.ndarray:
        return self.value("penetration", "q")(q).ravel()

    def force(self, q: np.ndarray) -> np.ndarray:
        return self.value("stiffness")().ravel() * np.maximum(self.penetration(q), 0.0)

    def acceleration(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, lam: np.ndarray
    ) -> np.ndarray:
        mass = self.value("mass_matrix", "q")(q)
        return np.linalg.solve(
            mass, self.value("generalised_force", "q", "v", "u", "lam")(q, v, u, lam).ravel()
        )


def probes(scene: Scene) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(q, v, u) at zeros, ones, 0101, 0123 and at random: index mistakes show."""
    n = 2 * scene.nq + scene.nu
    rows = [np.zeros(n), np.ones(n), np.arange(n) % 2.0, np.arange(n) % 4.0]
    rows += list(np.random.default_rng(7).uniform(-1.5, 1.5, (6, n)))
    return [(row[: scene.nq], row[scene.nq : 2 * scene.nq], row[2 * scene.nq :]) for row in rows]


@pytest.fixture(params=NAMES)
def any_scene(request: pytest.FixtureRequest) -> Scene:
    return example_scene(request.param)


@pytest.fixture
def scene_of() -> Callable[[str], Scene]:
    return example_scene


@pytest.fixture
def constants() -> Callable[[str], types.SimpleNamespace]:
    """Scene name -> the numbers that its file states about itself, by their names there."""
    return lambda name: types.SimpleNamespace(**runpy.run_path(str(scene_path(name))))


@pytest.fixture(scope="session")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """unpacked(scene, version="2.0") -> folder of its unpacked FMU."""

    @cache
    def unpack(scene: Scene, version: str = "2.0") -> str:
        folder = tmp_path_factory.mktemp(scene.name)
        return fmpy.extract(str(build_fmu(scene, version)), unzipdir=str(folder))

    return unpack


@pytest.fixture
def drive(unpacked: Callable[..., str]) -> Iterator[Callable[..., Driver]]:
    """drive(scene, "me" | "cs", version="2.0", ...) -> a fresh instance, freed after the test."""
    made: list[Driver] = []

    def new(scene: Scene, kind: str, version: str = "2.0", **options: Any) -> Driver:
        driver, importer = _KINDS[version, kind]
        made.append(driver(scene, unpacked(scene, version), importer, **options))
        return made[-1]

    yield new
    for driver in made:
        driver.close()


@pytest.fixture
def reference() -> Callable[[Scene], Reference]:
    return Reference


@pytest.fixture
def probe_points() -> Callable[[Scene], list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    return probes
