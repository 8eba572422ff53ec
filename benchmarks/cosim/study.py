"""Energy, momentum and CPU time of coupled FMUs against the macro step, for every master and for the whole scene as one FMU.

    for case in CASES: told = study(case, steps=MACRO_STEPS)

The exact motion is that of the scene's Model Exchange FMU by CVODE at rtol 1e-12; all errors are
differences from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np

from benchmarks.cosim.libcosim import ECCO, FIXED, libcosim_refusal, run_libcosim
from benchmarks.cosim.masters import MASTERS, Master, jacobi
from benchmarks.cosim.system import System, coupled, whole
from models.catalog import load_scene
from models.dynamics import derive
from models.fmu import build_fmu
from models.scene import Scene
from models.trajectory import Trajectory
from validate.fmi.description import read_package, unpacked
from validate.judge.replay.reference import ExchangeModel, integrate
from validate.judge.replay.subject import find_variables
from validate.judge.replay.wiring import HeldInputs

MACRO_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)
# Bodies integrate ten times as finely as they meet, by a fourth-order method: what is wrong then
# comes from the coupling alone.
INNER_SHARE = 0.1
# When motions are compared [s]: the largest macro step, which all others divide.
EVERY = 1e-2
_EXACT = 1e-12


@dataclass(frozen=True, kw_only=True)
class Case:
    """A free motion with constant inputs. starts: h -> starts (2 nq,) of which the worst counts.

    U (nu,); horizon [s].
    """

    name: str
    title: str
    scene: Scene
    starts: Callable[[float], list[np.ndarray]]
    u: tuple[float, ...]
    horizon: float


def _head_on(h: float) -> list[np.ndarray]:
    """The first disc meets the second, at rest, at five places within a macro step: 30 ms and (j + 1/2) h/5."""
    radius, speed = 0.1, 2.0
    return [
        np.array([0.0, 2 * radius + speed * (0.03 + (j + 0.5) / 5 * h), speed, 0.0])
        for j in range(5)
    ]


def cases() -> tuple[Case, ...]:
    """The textbook impact, the paper's three carts, and the same carts with a contact as stiff as a real one."""
    pair, carts = load_scene("two_body_collision"), load_scene("three_cart")
    start = np.array(carts.task.start)
    pushed = {"u": (8.0, -5.0), "horizon": 1.0, "starts": lambda h: [start]}
    return (
        Case(
            name="head_on",
            title="Two masses of 1 kg meet at 2 m/s, k = 1e4 N/m, nothing else acts",
            scene=pair.with_parameters(m1=1.0, m2=1.0, k=1e4, r=0.1),
            starts=_head_on,
            u=(),
            horizon=0.2,
        ),
        Case(
            name="three_cart",
            title="Three carts pushed together by 8 N and 5 N, k = 30 N/m (the paper's)",
            scene=carts,
            **pushed,
        ),
        Case(
            name="three_cart_stiff",
            title="The same three carts with k = 1e4 N/m: several short contacts",
            scene=carts.with_parameters(k=1e4),
            **pushed,
        ),
    )


def contact_frequency(scene: Scene) -> float:
    """omega [rad/s]: the largest natural frequency of the bodies on all contacts closed, at the task's start; omega^2 of M^-1 J' k J."""
    d = derive(scene)
    q = np.array(scene.task.start[: scene.nq])
    M, J = d.function(d.mass_matrix, d.q)(q), d.function(d.gap_jacobian, d.q)(q)
    k = d.function(d.stiffness)().ravel()
    return float(np.sqrt(np.linalg.eigvals(np.linalg.solve(M, J.T @ np.diag(k) @ J)).real.max()))


def energy(scene: Scene) -> Callable[[np.ndarray], np.ndarray]:
    """motion (n, 2 nq) -> kinetic + potential + contact energy (n,) [J], from the scene's own equations."""
    d, nq = derive(scene), scene.nq
    smooth = d.function([d.kinetic_energy + d.potential_energy], d.q, d.v)
    phi, k = d.function(d.penetration, d.q), d.function(d.stiffness)().ravel()

    def total(motion: np.ndarray) -> np.ndarray:
        depth = np.array([np.maximum(phi(x[:nq]).ravel(), 0.0) for x in motion])
        return np.array([float(smooth(x[:nq], x[nq:]).item()) for x in motion]) + depth**2 @ k / 2

    return total


def momentum(scene: Scene) -> Callable[[np.ndarray], np.ndarray]:
    """motion (n, 2 nq) -> sum of M v (n,) [kg m/s], of bodies that move along one line."""
    d, nq = derive(scene), scene.nq
    M = d.function(d.mass_matrix, d.q)
    return lambda motion: np.array([float((M(x[:nq]) @ x[nq:]).sum()) for x in motion])


def exact_motion(
    scene: Scene, start: np.ndarray, u: Sequence[float], times: np.ndarray
) -> np.ndarray:
    """(n, 2 nq) at `times`, which begin after t = 0."""
    t = np.concatenate([[0.0], times])
    state, steps = np.tile(start, (len(t), 1)), len(times)
    inputs, forces = (
        np.tile(np.array(u, dtype=float), (steps, 1)).reshape(steps, scene.nu),
        np.zeros((steps, scene.nl)),
    )
    plan = Trajectory(t=t, q=state[:, : scene.nq], v=state[:, scene.nq :], u=inputs, lam=forces)
    with unpacked(read_package(build_fmu(scene))) as package:
        model = ExchangeModel(package, find_variables(package, scene))
        try:
            run = integrate(model, plan.start, HeldInputs(plan), _EXACT, 100_000)
        finally:
            model.close()
    return np.array(run.outputs)[run.knots, : 2 * scene.nq][1:]


@dataclass(frozen=True)
class Measured:
    """One run: times of comparison [s], motion there, CPU seconds of the stepping alone, macro steps made."""

    t: np.ndarray
    motion: np.ndarray
    cpu: float
    steps: int


def study(
    case: Case,
    steps: Sequence[float] = MACRO_STEPS,
    tell: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """All masters over all macro steps, as JSON: see benchmarks.records.CosimCase."""
    rows: dict[str, list[dict[str, float]]] = {}
    refusal = libcosim_refusal()
    failed: dict[str, str] = (
        {} if refusal is None else {"libcosim": refusal, "libcosim_ecco": refusal}
    )
    for h in steps:
        for name, runs in _runs(case, h, refusal is None):
            if isinstance(runs, str):
                failed[name] = f"{runs} at h = {h:g} s"
                continue
            row = _worst(case, h, runs)
            rows.setdefault(name, []).append(row)
            tell(
                f"{case.name} {name} h = {h:g} s: energy {row['energy_error']:+.3g}, momentum {row['momentum_error']:.1g}, {row['cpu_per_s']:.3g} CPU s a second"
            )
    return {
        "name": case.name,
        "title": case.title,
        "frequency": contact_frequency(case.scene),
        "horizon": case.horizon,
        "masters": [
            {"name": name, "rows": rows.get(name, []), "failed": failed.get(name, "")}
            for name in {**rows, **failed}
        ],
    }


def _runs(
    case: Case, h: float, with_libcosim: bool
) -> list[tuple[str, list[tuple[np.ndarray, Measured]] | str]]:
    """(name of the master, its runs from each start - or why there are none)."""
    inner, starts = h * INNER_SHARE, case.starts(h)
    told: list[tuple[str, list[tuple[np.ndarray, Measured]] | str]] = []
    with coupled(case.scene, inner) as system:
        for name, master in MASTERS.items():
            told.append((name, [(start, _run(case, system, master, start, h)) for start in starts]))
    with whole(case.scene, inner) as system:
        told.append(("whole", [(start, _run(case, system, jacobi, start, h)) for start in starts]))
    for name, algorithm in (("libcosim", FIXED), ("libcosim_ecco", ECCO)) if with_libcosim else ():
        times = EVERY * np.arange(1, round(case.horizon / EVERY) + 1)
        runs: list[tuple[np.ndarray, Measured]] = []
        for start in starts:
            result = run_libcosim(case.scene, start, np.array(case.u), h, times, inner, algorithm)
            if isinstance(result, str):
                told.append((name, result))
                break
            runs.append((start, Measured(*result)))
        else:
            told.append((name, runs))
    return told


def _run(case: Case, system: System, master: Master, start: np.ndarray, h: float) -> Measured:
    system.begin(start, np.array(case.u))
    count, stride = round(case.horizon / h), round(EVERY / h)
    began = process_time()
    motion = master(system, h, count)
    cpu = process_time() - began
    chosen = np.arange(stride, count + 1, stride)
    return Measured(chosen * h, motion[chosen], cpu, count)


def _worst(case: Case, h: float, runs: Sequence[tuple[np.ndarray, Measured]]) -> dict[str, float]:
    """The errors of the start with the largest energy error, and the mean CPU time.

    energy_error: largest difference of the total energy at the times of comparison, with its sign,
        over the largest exact energy.
    """
    total, impulse = energy(case.scene), momentum(case.scene)
    errors = []
    for start, run in runs:
        exact = exact_motion(case.scene, start, case.u, run.t)
        whole_energy = total(exact)
        difference = (total(run.motion) - whole_energy) / whole_energy.max()
        drift = np.abs(impulse(run.motion) - impulse(exact)).max()
        distance = np.abs(run.motion - exact)[:, : case.scene.nq].max()
        errors.append(
            (float(difference[np.abs(difference).argmax()]), float(drift), float(distance))
        )
    worst = max(errors, key=lambda error: abs(error[0]))
    simulated = len(runs) * case.horizon
    return {
        "h": h,
        "mean_step": simulated / sum(run.steps for _, run in runs),
        "energy_error": worst[0],
        "momentum_error": worst[1],
        "position_error": worst[2],
        "cpu_per_s": sum(run.cpu for _, run in runs) / simulated,
    }
